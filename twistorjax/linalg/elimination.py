"""Inverses of small matrices, and linear equations, without LAPACK.

LAPACK takes longer for a small matrix, and the first program that calls it imports
`scipy.linalg`, which takes a third of the time of `import jax` (`benchmarks.sweeps`,
`benchmarks.first_calls`).
"""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Inexact


# LAPACK inverts a larger matrix with row exchanges in a fraction of the time
# (`benchmarks.lattices`).
_LARGEST_WITHOUT_LAPACK = 100

# Real numbers, or their real and imaginary parts; rows, columns, batch.
_Parts = tuple[Inexact[Array, "_ _ _"], ...]


@jax.custom_jvp
def inverse(matrix: Inexact[Array, "... n n"]) -> Inexact[Array, "... n n"]:
    """Invert matrices by Gauss-Jordan elimination without pivoting.

    Pivoting is not needed if the symmetric part of a matrix is positive definite, nor for
    matrices [M, -G^T; G, 0] of inertia and independent constraints, whose Schur
    complement has this property. If there is no inverse, the result is not finite.

    For small matrices this is faster than LAPACK. In addition, batches of LAPACK calls
    can block each other in the threads of XLA, which causes a deadlock of two batches on
    two cores (jaxlib 0.10).

    Example:
        >>> inverse(jnp.array([[2.0, 1.0], [1.0, 1.0]]))
        Array([[ 1., -1.],
               [-1.,  2.]], dtype=float64)
    """
    if not matrix.size:
        return matrix
    if matrix.ndim == 2:
        return _inverse(matrix)
    flat = matrix.reshape(-1, *matrix.shape[-2:])
    return jax.vmap(_inverse)(flat).reshape(matrix.shape)


@inverse.defjvp
def _(primals, tangents):
    (matrix,), (change,) = primals, tangents
    found = inverse(matrix)
    return found, -found @ change @ found


@jax.custom_batching.custom_vmap
def _inverse(matrix: Inexact[Array, "n n"]) -> Inexact[Array, "n n"]:
    (found,) = _gauss_jordan((matrix[..., None],))
    return found[..., 0]


@_inverse.def_vmap
def _(axis_size: int, in_batched: Sequence[bool], matrices: Array):
    """Invert a batch as the last axis, and without complex numbers.

    XLA processes four or more real numbers with one instruction, but not complex ones.
    """
    del axis_size, in_batched
    last = jnp.moveaxis(matrices, 0, -1)
    if jnp.iscomplexobj(last):
        real, imaginary = _gauss_jordan((jnp.real(last), jnp.imag(last)))
        last = jax.lax.complex(real, imaginary)
    else:
        (last,) = _gauss_jordan((last,))
    return jnp.moveaxis(last, -1, 0), True


def _gauss_jordan(matrices: _Parts) -> _Parts:
    """Invert matrices, which are given by their parts."""
    size = len(matrices[0])

    def step(k: Array, remaining: _Parts) -> _Parts:
        """Eliminate one unknown, and write the inverse over its row and column."""
        row, column = (
            tuple(jax.lax.dynamic_index_in_dim(part, k, axis) for part in remaining)
            for axis in (0, 1)
        )
        pivot = tuple(jax.lax.dynamic_index_in_dim(part, k, 1) for part in row)
        factor = _reciprocal(pivot)
        row, scaled = _multiply(row, factor), _multiply(column, factor)
        products = _multiply(column, row)
        eliminated = jnp.arange(size) == k
        in_row, in_column = eliminated[:, None, None], eliminated[None, :, None]

        def written(factor, row, scaled, remaining, products):
            others = jnp.where(in_column, -scaled, remaining - products)
            return jnp.where(in_row, jnp.where(in_column, factor, row), others)

        return _combine(written, factor, row, scaled, remaining, products)

    return jax.lax.fori_loop(0, size, step, matrices)


def _combine(function: Callable[..., Array], *numbers: _Parts) -> _Parts:
    """Apply a function to the real parts, and to the imaginary parts, of numbers."""
    return tuple(map(function, *numbers))


def _multiply(first: _Parts, second: _Parts) -> _Parts:
    """Multiply numbers that are given by their parts."""
    if len(first) == 1:
        return _combine(jnp.multiply, first, second)
    (a, b), (c, d) = first, second
    return a * c - b * d, a * d + b * c


def _reciprocal(number: _Parts) -> _Parts:
    """Invert numbers that are given by their parts."""
    if len(number) == 1:
        return _combine(jnp.reciprocal, number)
    a, b = number
    scale = 1 / (a * a + b * b)
    return a * scale, -b * scale


@jax.custom_batching.custom_vmap
def eliminate(
    matrix: Float[Array, "n n"], rights: Float[Array, "rights n"]
) -> tuple[Float[Array, "rights n"], Float[Array, " n"]]:
    """Solve linear systems by Gauss-Jordan elimination without pivoting.

    The second result contains the pivots. Those of a symmetric matrix are positive if and
    only if it is positive definite.

    Example:
        >>> eliminate(jnp.array([[2.0, 1.0], [1.0, 1.0]]), jnp.array([[3.0, 2.0]]))
        (Array([[1., 1.]], dtype=float64), Array([2. , 0.5], dtype=float64))
    """
    size = len(matrix)
    rows = jnp.arange(size)

    def step(k: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        remaining, pivots = state
        pivot, row = remaining[k, k], remaining[k]
        row = row / pivot
        others = remaining - remaining[:, k][:, None] * row[None]
        chosen = rows == k
        remaining = jnp.where(chosen[:, None], row[None], others)
        return remaining, jnp.where(chosen, pivot, pivots)

    remaining = jnp.concatenate([matrix, rights.T], axis=1)
    state = remaining, jnp.zeros(size, remaining.dtype)
    remaining, pivots = jax.lax.fori_loop(0, size, step, state)
    return remaining[:, size:].T, pivots


@eliminate.def_vmap
def _(axis_size: int, in_batched: Sequence[bool], matrices: Array, rights: Array):
    """Solve a batch as the last axis, by a program without a loop.

    It takes less time, and more to compile.
    """
    if not in_batched[0]:
        flat = rights.reshape(-1, len(matrices))
        solutions, pivots = eliminate(matrices, flat)
        return (solutions.reshape(rights.shape), pivots), (True, False)
    matrices, rights = (
        jnp.moveaxis(values, 0, -1)
        if batched
        else jnp.broadcast_to(values[..., None], (*values.shape, axis_size))
        for values, batched in zip((matrices, rights), in_batched, strict=True)
    )
    remaining = jnp.concatenate([matrices, jnp.swapaxes(rights, 0, 1)], axis=1)
    pivots = []
    for k in range(len(matrices)):
        # Without a barrier, XLA would compute each row several times.
        remaining = jax.lax.optimization_barrier(remaining)
        column, row = remaining[:, :1], remaining[k, 1:] / remaining[k, :1]
        others = remaining[:, 1:] - column * row[None]
        remaining = jnp.concatenate([others[:k], row[None], others[k + 1 :]])
        pivots.append(column[k, 0])
    return (jnp.transpose(remaining, (2, 1, 0)), jnp.stack(pivots, 1)), (True, True)


@jax.custom_jvp
def pivoted_inverse(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Invert a matrix by Gauss-Jordan elimination with row exchanges.

    It replaces LAPACK where several batches of calls could run at the same time; see
    `inverse`. Large matrices are inverted by LAPACK, one after the other. If there is no
    inverse, the result is not finite.

    Example:
        >>> pivoted_inverse(jnp.array([[0.0, 1.0], [2.0, 0.0]]))
        Array([[0. , 0.5],
               [1. , 0. ]], dtype=float64)
    """
    size = len(matrix)
    if size > _LARGEST_WITHOUT_LAPACK:
        return _one_inverse(matrix)
    rows = jnp.arange(size)

    def step(k: Array, augmented: Array) -> Array:
        column = augmented[:, k]
        pivot = jnp.argmax(jnp.where(rows >= k, jnp.abs(column), -1.0))
        chosen = augmented[pivot]
        chosen = chosen / chosen[k]
        exchanged = jnp.where((rows == pivot)[:, None], augmented[k][None], augmented)
        others = exchanged - exchanged[:, k][:, None] * chosen[None]
        return jnp.where((rows == k)[:, None], chosen[None], others)

    augmented = jnp.concatenate([matrix, jnp.eye(size)], axis=1)
    return jax.lax.fori_loop(0, size, step, augmented)[:, size:]


@pivoted_inverse.defjvp
def _(primals, tangents):
    (matrix,), (change,) = primals, tangents
    found = pivoted_inverse(matrix)
    return found, -found @ change @ found


@jax.custom_batching.custom_vmap
def _one_inverse(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    return jnp.linalg.inv(matrix)


@_one_inverse.def_vmap
def _(axis_size: int, in_batched: Sequence[bool], matrices: Array):
    del axis_size, in_batched
    return jax.lax.map(_one_inverse, matrices), True


def solve(matrix: Float[Array, "n n"], right: Float[Array, " n"]) -> Float[Array, " n"]:
    """Solve linear equations with `pivoted_inverse`, and one correction.

    Each equation is divided by its largest coefficient.

    Example:
        >>> solve(jnp.array([[0.0, 1.0], [2.0, 0.0]]), jnp.array([1.0, 4.0]))
        Array([2., 1.], dtype=float64)
    """
    scale = jax.lax.stop_gradient(jnp.max(jnp.abs(matrix), axis=1))
    scale = jnp.where(scale > 0, scale, 1.0)
    matrix, right = matrix / scale[:, None], right / scale
    found = pivoted_inverse(matrix)
    solution = found @ right
    return solution + found @ (right - matrix @ solution)
