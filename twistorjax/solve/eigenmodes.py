"""Vibrations as an eigenvalue problem, accurate to small ones and differentiable."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


# Frequencies that differ by less, relative to both, are taken for equal.
_EQUAL = 1e-8
# Jacobi's method ends where entries beside the diagonal are below this, relative to those
# on it, for eigenvalues change by their squares; or after so many sweeps, of which it
# takes six to ten.
_SMALL = 1e-10
_SWEEPS = 30


class Stiffness(NamedTuple):
    """A stiffness divided by inertia, in factors: `rows.T diag(weights) rows + reference`.

    Args:
        rows: combinations of displacements that hinges resist.
        weights: stiffness against each of them.
        reference: of the forces that hinges and loads bear; symmetric.
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

    Small frequencies keep their digits beside large ones, because the factors are not
    multiplied before the axes are known. The eigenvalues of the stiffness as one matrix
    have errors in proportion to the largest of them.

    First derivatives of equal frequencies, and of their vectors, are those in one of the
    possible systems of axes. Symmetric functions of them have their first derivatives,
    and their sum, the trace of the root, its second ones as well.

    Source:
        Demmel and Veselic, Jacobi's method is more accurate than QR, SIAM J. Matrix Anal.
        Appl. 13, 1992.
    """
    rows, weights, rest = stiffness
    whole = rows.T @ (weights[:, None] * rows) + (rest + rest.T) / 2
    finite = jnp.all(jnp.isfinite(whole))
    _, first = jnp.linalg.eigh(jnp.where(finite, whole, jnp.eye(len(whole))))
    # The axes of the product are those of the stiffness up to rounding. Along them the
    # factors are multiplied again, by which small entries beside large ones keep digits.
    own = rows @ first
    left = first.T @ rest @ first
    matrix = own.T @ (weights[:, None] * own) + (left + left.T) / 2
    squares, vectors = _diagonalized(jnp.where(finite, matrix, jnp.eye(len(whole))))
    root = jnp.sign(squares) * jnp.sqrt(jnp.abs(squares))
    lost = jnp.where(finite, 0.0, jnp.nan)
    return Modes(jnp.diag(root + lost), first @ vectors + lost)


def _diagonalized(
    matrix: Float[Array, "n n"],
) -> tuple[Float[Array, " n"], Float[Array, "n n"]]:
    """Find eigenvalues and eigenvectors of a symmetric matrix, the smallest first.

    By Jacobi's rotations, which keep the digits of small eigenvalues beside large ones
    where the matrix is nearly diagonal. They rotate all coordinates at once, in pairs:
    the first half with the second, after which the coordinates change places as the
    players of a tournament do. Where entries beside the diagonal are so small that their
    squares are lost in those on it, there is no rotation.
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
        """Decide whether an entry beside the diagonal is still too large."""
        diagonal = jnp.abs(jnp.diagonal(matrix))
        unit = jnp.sqrt(diagonal[:, None]) * jnp.sqrt(diagonal[None])
        beside = jnp.abs(matrix - jnp.diag(jnp.diagonal(matrix)))
        return jnp.any(beside > _SMALL * unit)

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
