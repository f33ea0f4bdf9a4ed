"""The lowest modes of a symmetric operator with many unknowns."""

from typing import Protocol, runtime_checkable

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
    size, width = len(operator.diagonal()), _width(count)
    start = np.random.default_rng(0).normal(size=(size, width))
    start = jnp.linalg.qr(jnp.asarray(start))[0]
    inverse, shift = _positive_inverse(operator, jnp.zeros(()))
    vectors, _, values, _ = _cycle(inverse, start, inverse.solve(start), count)
    # With a shift that is not small compared with the eigenvalues, rigid motions do not
    # dominate the rounding errors of all vectors.
    shift = jnp.maximum(shift, _SHIFT_SHARE * (1 / values[count - 1] - shift))
    inverse = operator.inverse(shift)

    def advance(state: tuple[Array, Array, Array, Array]):
        vectors, image, _, cycles = state
        vectors, image, _, residual = _cycle(inverse, vectors, image, count)
        return vectors, image, residual, cycles + 1

    def unfinished(state: tuple[Array, Array, Array, Array]) -> Array:
        _, _, residual, cycles = state
        return (residual > _LARGEST_RESIDUAL) & (cycles < _MOST_CYCLES)

    infinite, none = jnp.array(jnp.inf), jnp.zeros((), int)
    state = vectors, inverse.solve(vectors), infinite, none
    vectors, _, residual, _ = jax.lax.while_loop(unfinished, advance, state)
    return vectors, residual <= _LARGEST_RESIDUAL


def _cycle(
    inverse: Inverse,
    vectors: Float[Array, "n width"],
    image: Float[Array, "n width"],
    count: int,
) -> tuple[Array, Array, Array, Array]:
    """Solve the eigenvalue problem in a Krylov subspace that begins with some vectors.

    Returns:
        Better vectors, their images by the inverse, its eigenvalues, and the largest
        relative residual of the first `count` ones.
    """
    basis, images, width = [vectors], [image], vectors.shape[1]
    for _ in range(_BLOCKS - 1):
        basis.append(_orthonormal(images[-1], jnp.concatenate(basis, axis=1)))
        images.append(inverse.solve(basis[-1]))
    basis, images = (jnp.concatenate(part, axis=1) for part in (basis, images))
    gram = basis.T @ images
    values, rotation = jnp.linalg.eigh((gram + gram.T) / 2)
    values, rotation = values[::-1][:width], rotation[:, ::-1][:, :width]
    vectors, image = basis @ rotation, images @ rotation
    residual = jnp.linalg.norm(image - vectors * values[None], axis=0) / values
    return vectors, image, values, jnp.max(residual[:count])


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
