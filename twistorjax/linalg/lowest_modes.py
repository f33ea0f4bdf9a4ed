"""The lowest modes of a symmetric operator with many unknowns."""

from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._utils.pytrees import stop_gradient
from .._utils.types import Flag, Scalar
from .eigenvalues import change_of_modes, jacobi_eigenvalues, Modes


# Vectors that converge together: a multiple of `_MULTIPLE`, with some more than are asked
# for, because the last ones converge slowly.
_MORE, _MULTIPLE = 4, 8
_BLOCKS = 4  # Blocks of vectors in a subspace
# Largest residual of the inverse, relative to its eigenvalue; eigenvalues err by its
# square.
_LARGEST_RESIDUAL, _MOST_CYCLES = 1e-9, 100
# The first shift, relative to the largest entry on the diagonal, and the factor by which
# it grows until the shifted operator is positive definite.
_SHIFT, _SHIFT_GROWTH, _MOST_SHIFTS = 1e-12, 100.0, 8
_SHIFT_SHARE = 0.01  # Shift as a fraction of the largest eigenvalue that is sought
# Largest residual of a response, relative to its right-hand side.
_LARGEST_RESPONSE_RESIDUAL, _MOST_STEPS = 1e-12, 500


@runtime_checkable
class Inverse(Protocol):
    """Inverse of an operator plus a multiple of the identity."""

    def solve(self, right: Float[Array, "n rights"]) -> Float[Array, "n rights"]: ...

    def is_positive(self) -> Flag:
        """Decide whether the operator is positive definite."""
        ...


@runtime_checkable
class Operator(Protocol):
    """A symmetric operator; its derivatives are those by its arrays."""

    def diagonal(self) -> Float[Array, " n"]: ...

    def times(self, vectors: Float[Array, "n vectors"]) -> Float[Array, "n vectors"]: ...

    def gram(self, vectors: Float[Array, "n vectors"]) -> Float[Array, "vectors vectors"]:
        """Compute `vectors.T @ times(vectors)`, with accurate small entries."""
        ...

    def inverse(self, shift: Scalar) -> Inverse: ...


def has_subspace(size: int, count: int) -> bool:
    """Decide whether an operator is large enough for `lowest_modes`."""
    return _BLOCKS * _width(count) <= size


@eqx.filter_custom_jvp
def lowest_modes(operator: Operator, *, count: int) -> Modes:
    """Compute the lowest angular frequencies, and their vectors; see `modes`.

    The results are NaN if the operator is not finite. Derivatives of the vectors are NaN
    if the last frequency is equal to the next one, because then they do not exist.

    The vectors are those of the inverse in Krylov subspaces of several vectors, so that
    equal eigenvalues are found.

    Source:
        Golub and Underwood, The block Lanczos method for computing eigenvalues, in:
        Mathematical Software III, 1977.
    """
    vectors, converged = _converged_modes(operator, count)
    squares, rotation = jacobi_eigenvalues(operator.gram(vectors))
    root = jnp.sign(squares) * jnp.sqrt(jnp.abs(squares))
    nan_unless_found = jnp.where(converged, 0.0, jnp.nan)
    root, vectors = root[:count], (vectors @ rotation)[:, :count]
    return Modes(jnp.diag(root + nan_unless_found), vectors + nan_unless_found)


@lowest_modes.def_jvp
def _(primals, tangents, *, count):
    solution = lowest_modes(*primals, count=count)
    root, vectors = solution

    def products(operator: Operator) -> tuple[Array, Array]:
        return operator.times(vectors), operator.gram(vectors)

    _, (change, gram_change) = eqx.filter_jvp(products, primals, tangents)
    root_change, rotation = change_of_modes(root, gram_change)
    squares = jnp.diagonal(root) * jnp.abs(jnp.diagonal(root))
    outside = response(primals[0], vectors, squares, -change)
    return solution, Modes(root_change, vectors @ rotation + outside)


def response(
    operator: Operator,
    vectors: Float[Array, "n modes"],
    squares: Float[Array, " rights"],
    right: Float[Array, "n rights"],
) -> Float[Array, "n rights"]:
    """Solve `(operator - square) x = right` for each column, orthogonal to given modes.

    The modes are all those with smaller eigenvalues than the squares. Only the part of
    the right-hand side that is orthogonal to the modes enters. A response that does not
    exist is NaN.
    """
    known, largest = stop_gradient((operator, jnp.max(squares)))
    inverse, _ = _positive_inverse(known, _SHIFT_SHARE * largest)

    def project(columns: Array) -> Array:
        return columns - vectors @ (vectors.T @ columns)

    def apply(columns: Array) -> Array:
        outside = project(columns)
        image = project(operator.times(outside) - outside * squares[None])
        return image + (columns - outside)

    def precondition(columns: Array) -> Array:
        outside = project(columns)
        return project(inverse.solve(outside)) + (columns - outside)

    def solve(apply, right: Array) -> Array:
        return _conjugate_gradients(apply, precondition, right)

    return jax.lax.custom_linear_solve(apply, project(right), solve, symmetric=True)


def _width(count: int) -> int:
    """Number of vectors that converge together."""
    return -(-(count + _MORE) // _MULTIPLE) * _MULTIPLE


def _positive_inverse(operator: Operator, smallest: Scalar) -> tuple[Inverse, Scalar]:
    """Invert an operator with a shift for which it is positive definite.

    The shift is the smallest one or a negligible one, if that is enough.
    """

    def unfinished(state: tuple[Inverse, Array, Array]) -> Array:
        inverse, _, trials = state
        return ~inverse.is_positive() & (trials < _MOST_SHIFTS)

    def shift_more(state: tuple[Inverse, Array, Array]) -> tuple[Inverse, Array, Array]:
        _, shift, trials = state
        shift = _SHIFT_GROWTH * shift
        return operator.inverse(shift), shift, trials + 1

    negligible = _SHIFT * jnp.max(jnp.abs(operator.diagonal()))
    shift = jnp.maximum(negligible, smallest)
    state = operator.inverse(shift), shift, jnp.zeros((), int)
    inverse, shift, _ = jax.lax.while_loop(unfinished, shift_more, state)
    return inverse, shift


def _converged_modes(
    operator: Operator, count: int
) -> tuple[Float[Array, "n width"], Bool[Array, ""]]:
    """Compute the vectors of the lowest eigenvalues, of which `count` converge."""
    size = len(operator.diagonal())
    inverse, shift = _positive_inverse(operator, jnp.zeros(()))
    vectors, values = _first_cycle(inverse.solve, size, count)
    # With a shift that is not small compared with the eigenvalues, rigid motions do not
    # dominate the rounding errors of all vectors.
    shift = jnp.maximum(shift, _SHIFT_SHARE * (1 / values[count - 1] - shift))
    inverse = operator.inverse(shift)
    _, vectors, converged = _improved(inverse.solve, vectors, count)
    return vectors, converged


def dominant_modes(
    apply: Callable[[Array], Array], size: int, count: int, negligible: float = 0.0
) -> tuple[Float[Array, " count"], Float[Array, "n count"], Flag]:
    """Compute the eigenvalues of largest magnitude of a symmetric matrix.

    Args:
        apply: Function that multiplies the matrix and several columns.
        size: Number of rows of the matrix, for which `has_subspace` holds.
        negligible: Smaller eigenvalues, as a fraction of the largest one, need not be
            accurate.

    Returns:
        The eigenvalues, the largest magnitude first; their vectors as columns; and
        whether they have converged.
    """
    vectors, _ = _first_cycle(apply, size, count)
    values, vectors, converged = _improved(apply, vectors, count, negligible)
    return values[:count], vectors[:, :count], converged


def _first_cycle(
    apply: Callable[[Array], Array], size: int, count: int
) -> tuple[Float[Array, "n width"], Float[Array, " width"]]:
    """Compute vectors and eigenvalues of a first Krylov subspace."""
    start = np.random.default_rng(0).normal(size=(size, _width(count)))
    start = jnp.linalg.qr(jnp.asarray(start))[0]
    cycle = _cycle(apply, start, apply(start))
    return cycle.vectors, cycle.values


def _improved(
    apply: Callable[[Array], Array],
    vectors: Float[Array, "n width"],
    count: int,
    negligible: float = 0.0,
) -> tuple[Float[Array, " width"], Float[Array, "n width"], Flag]:
    """Repeat Krylov subspaces until `count` vectors have converged."""

    def errors(cycle: _Cycle) -> Array:
        sizes = jnp.abs(cycle.values[:count])
        sizes = jnp.maximum(sizes, negligible * sizes[0])
        return cycle.residuals[:count] - _LARGEST_RESIDUAL * sizes

    def advance(state: tuple[_Cycle, Array]) -> tuple[_Cycle, Array]:
        cycle, cycles = state
        return _cycle(apply, cycle.vectors, cycle.images), cycles + 1

    def unfinished(state: tuple[_Cycle, Array]) -> Array:
        cycle, cycles = state
        return jnp.any(errors(cycle) > 0) & (cycles < _MOST_CYCLES)

    infinite = jnp.full(vectors.shape[1], jnp.inf)
    start = _Cycle(vectors, apply(vectors), jnp.zeros_like(infinite), infinite)
    state = start, jnp.zeros((), int)
    cycle, _ = jax.lax.while_loop(unfinished, advance, state)
    return cycle.values, cycle.vectors, jnp.all(errors(cycle) <= 0)


class _Cycle(NamedTuple):
    """Approximate eigenvectors of a matrix."""

    vectors: Float[Array, "n width"]
    images: Float[Array, "n width"]  # Products of the matrix and the vectors
    values: Float[Array, " width"]  # Eigenvalues, the largest magnitude first
    residuals: Float[Array, " width"]


def _cycle(
    apply: Callable[[Array], Array],
    vectors: Float[Array, "n width"],
    image: Float[Array, "n width"],
) -> _Cycle:
    """Solve the eigenvalue problem in a Krylov subspace that begins with some vectors."""
    basis, images, width = [vectors], [image], vectors.shape[1]
    for _ in range(_BLOCKS - 1):
        basis.append(_orthonormal(images[-1], jnp.concatenate(basis, axis=1)))
        images.append(apply(basis[-1]))
    basis, images = (jnp.concatenate(part, axis=1) for part in (basis, images))
    gram = basis.T @ images
    values, rotation = jnp.linalg.eigh((gram + gram.T) / 2)
    order = jnp.argsort(-jnp.abs(values))[:width]
    values, rotation = values[order], rotation[:, order]
    vectors, images = basis @ rotation, images @ rotation
    residuals = jnp.linalg.norm(images - vectors * values[None], axis=0)
    return _Cycle(vectors, images, values, residuals)


def _orthonormal(
    columns: Float[Array, "n width"], basis: Float[Array, "n others"]
) -> Float[Array, "n width"]:
    """Make columns orthonormal to each other and to a basis.

    This is done twice, because columns that are nearly in the span of the basis leave
    rounding errors at first.
    """
    for _ in range(2):
        columns = columns - basis @ (basis.T @ columns)
        columns, _ = jnp.linalg.qr(columns)
    return columns


def _conjugate_gradients(
    apply, precondition, right: Float[Array, "n rights"]
) -> Float[Array, "n rights"]:
    """Solve with the same operator for several columns; NaN if a column fails."""

    def unfinished(state) -> Array:
        *_, product, steps = state
        return jnp.any(product > bound) & (steps < _MOST_STEPS)

    def step(state):
        solution, residual, direction, product, steps = state
        image = apply(direction)
        length = _ratio(product, jnp.sum(direction * image, axis=0))
        solution = solution + length[None] * direction
        residual = residual - length[None] * image
        improved = precondition(residual)
        next_product = jnp.sum(residual * improved, axis=0)
        direction = improved + _ratio(next_product, product)[None] * direction
        return solution, residual, direction, next_product, steps + 1

    direction = precondition(right)
    product = jnp.sum(right * direction, axis=0)
    bound = _LARGEST_RESPONSE_RESIDUAL**2 * product
    state = jnp.zeros_like(right), right, direction, product, jnp.zeros((), int)
    solution, *_, product, _ = jax.lax.while_loop(unfinished, step, state)
    return jnp.where((product <= bound)[None], solution, jnp.nan)


def _ratio(numerator: Array, denominator: Array) -> Array:
    """Divide; zero if the denominator is zero."""
    zero = denominator == 0
    return jnp.where(zero, 0.0, numerator / jnp.where(zero, 1.0, denominator))
