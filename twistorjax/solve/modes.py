"""Vibrations as an eigenvalue problem, accurate to small ones and differentiable."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


# Frequencies that differ by less, relative to both, are taken for equal.
_EQUAL = 1e-8
# Jacobi's method ends where entries beside the diagonal are below this, relative to those
# on it, or after so many sweeps; it takes six to ten.
_ROUNDING = 1e-15
_SWEEPS = 30


class Stiffness(NamedTuple):
    """A stiffness divided by inertia, in factors: `rows.T diag(weights) rows + rest`.

    Args:
        rows: combinations of displacements that hinges resist.
        weights: stiffness against each of them.
        rest: of the forces that hinges and loads bear; symmetric.
    """

    rows: Float[Array, "rows n"]
    weights: Float[Array, " rows"]
    rest: Float[Array, "n n"]


class Modes(NamedTuple):
    """Square root of a stiffness, in the axes in which it is diagonal.

    Args:
        root: diagonal matrix of angular frequencies, the smallest first; rad/s. Negative
            where the stiffness is. Its derivative has entries beside the diagonal, among
            equal frequencies.
        vectors: orthonormal, a column for each frequency.
    """

    root: Float[Array, "n n"]
    vectors: Float[Array, "n n"]


@jax.custom_jvp
def modes(stiffness: Stiffness) -> Modes:
    """Compute angular frequencies and shapes.

    The relative error of a frequency is that of rounding times its ratio to the largest
    one, because the singular values of the factors are found first, and are the
    frequencies where the `rest` is zero. The eigenvalues of the stiffness itself would
    have the square of that ratio.

    First derivatives of equal frequencies, and of their vectors, are those in one of the
    possible systems of axes; symmetric functions of them, such as their sum, have their
    first and second derivatives.

    Source:
        Demmel and Veselic, Jacobi's method is more accurate than QR, SIAM J. Matrix Anal.
        Appl. 13, 1992.
    """
    rows, weights, rest = stiffness
    size = rows.shape[1]
    finite = jnp.all(jnp.isfinite(rows)) & jnp.all(jnp.isfinite(weights))
    scale = jnp.sqrt(jnp.maximum(weights, 0.0))
    graded = jnp.where(finite, scale[:, None] * rows, 0.0)
    # rows of zeros, so that there are as many vectors as columns
    graded = jnp.concatenate([graded, jnp.zeros((size, size))])
    _, singular, across = jnp.linalg.svd(graded, full_matrices=False)
    below = rows.T @ (jnp.minimum(weights, 0.0)[:, None] * rows)
    left = across @ (rest + below) @ across.T
    matrix = jnp.diag(singular**2) + (left + left.T) / 2
    matrix = jnp.where(jnp.all(jnp.isfinite(matrix)), matrix, jnp.eye(size))
    squares, vectors = _diagonalized(matrix)
    root = jnp.sign(squares) * jnp.sqrt(jnp.abs(squares))
    lost = jnp.where(finite & jnp.all(jnp.isfinite(rest)), 0.0, jnp.nan)
    return Modes(jnp.diag(root + lost), across.T @ vectors + lost)


def _diagonalized(
    matrix: Float[Array, "n n"],
) -> tuple[Float[Array, " n"], Float[Array, "n n"]]:
    """Find eigenvalues and eigenvectors of a symmetric matrix, the smallest first.

    By Jacobi's rotations, which keep the digits of small eigenvalues beside large ones
    where the matrix is nearly diagonal. They rotate all coordinates at once, in pairs:
    the first half with the second, after which the coordinates change places as the
    players of a tournament do. A matrix that is diagonal takes no rotation.
    """
    size = len(matrix)
    half = (size + 1) // 2
    full = jnp.zeros((2 * half, 2 * half)).at[:size, :size].set(matrix)
    if size % 2:
        full = full.at[size, size].set(1.0)  # a coordinate by itself
    seats = np.arange(2 * half)
    if half > 1:
        first = [0, half, *range(1, half - 1)]
        seats = np.array([*first, *range(half + 1, 2 * half), half - 1])

    def rotate(_, both: tuple[Array, Array]) -> tuple[Array, Array]:
        matrix, vectors = both
        p, q = np.arange(half), half + np.arange(half)
        a, b, c = matrix[p, p], matrix[q, q], matrix[p, q]
        some = c != 0
        lean = (b - a) / jnp.where(some, 2 * c, 1.0)
        sign = jnp.where(lean < 0, -1.0, 1.0)
        tangent = sign / (jnp.abs(lean) + jnp.sqrt(1 + lean**2))
        tangent = jnp.where(some, tangent, 0.0)
        cos = 1 / jnp.sqrt(1 + tangent**2)
        sin = tangent * cos

        def turned(rows: Array) -> Array:
            above, below = rows[:half], rows[half:]
            first = cos[:, None] * above - sin[:, None] * below
            second = sin[:, None] * above + cos[:, None] * below
            return jnp.concatenate([first, second])

        matrix = turned(turned(matrix).T)
        matrix = matrix.at[p, p].set(a - tangent * c).at[q, q].set(b + tangent * c)
        matrix = matrix.at[p, q].set(0.0).at[q, p].set(0.0)
        return matrix[seats][:, seats], turned(vectors)[seats]

    def apart(matrix: Array) -> Array:
        """The largest entry beside the diagonal, in units of those on it."""
        diagonal = jnp.abs(jnp.diagonal(matrix))
        unit = jnp.sqrt(diagonal[:, None]) * jnp.sqrt(diagonal[None])
        beside = jnp.abs(matrix - jnp.diag(jnp.diagonal(matrix)))
        return jnp.any(beside > _ROUNDING * unit)

    def sweep(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        matrix, vectors, count = state
        rounds = max(1, 2 * half - 1)  # after which all are where they began
        matrix, vectors = jax.lax.fori_loop(0, rounds, rotate, (matrix, vectors))
        return matrix, vectors, count + 1

    state = full, jnp.eye(2 * half), jnp.zeros((), int)
    full, vectors, _ = jax.lax.while_loop(
        lambda state: apart(state[0]) & (state[2] < _SWEEPS), sweep, state
    )
    values = jnp.diagonal(full)[:size]
    order = jnp.argsort(values)
    return values[order], vectors[:size, :size].T[:, order]


@modes.defjvp
def _(primals, tangents):
    (stiffness,), (change,) = primals, tangents
    rows, weights, _ = stiffness
    found = modes(stiffness)
    root, vectors = found
    own, moved = rows @ vectors, change.rows @ vectors
    mixed = own.T @ (weights[:, None] * moved)
    slope = mixed + mixed.T + own.T @ (change.weights[:, None] * own)
    slope = slope + vectors.T @ change.rest @ vectors
    slope = _halved(root, slope)
    frequencies = jnp.diagonal(root)
    apart = frequencies[None] - frequencies[:, None]
    size = jnp.abs(frequencies[None]) + jnp.abs(frequencies[:, None])
    equal = jnp.abs(apart) <= _EQUAL * size
    turning = jnp.where(equal, 0.0, slope / jnp.where(equal, 1.0, apart))
    return found, Modes(jnp.where(equal, slope, 0.0), vectors @ turning)


def _halved(root: Float[Array, "n n"], slope: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Solve `root X + X root = slope` for X, the slope of a square root.

    Zero where both frequencies are zero, for there the square root has no slope. The root
    is diagonal, but its derivative is not, so that the equation itself is differentiated.
    """

    def apply(half: Array) -> Array:
        return root @ half + half @ root

    def solve(_, right: Array) -> Array:
        frequencies = jnp.diagonal(root)
        total = frequencies[None] + frequencies[:, None]
        none = total == 0
        return jnp.where(none, 0.0, right / jnp.where(none, 1.0, total))

    return jax.lax.custom_linear_solve(apply, slope, solve, symmetric=True)
