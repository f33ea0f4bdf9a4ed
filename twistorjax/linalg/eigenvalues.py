"""Eigenvalue problem of vibrations, accurate for small eigenvalues and differentiable."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float


# Two frequencies are treated as equal if their relative difference is at most this.
_EQUAL = 1e-8
# Jacobi's method stops if the off-diagonal entries are below this, relative to those on
# the diagonal. The relative errors of the eigenvalues are then the square of this bound.
_LARGEST_OFF_DIAGONAL = 1e-10
_MOST_SWEEPS = 30  # Jacobi's method needs six to ten of them
# Relative error of the entries of an eigenvector, and of the sum of the terms in its
# stiffness, which may have the error of an equilibrium
_ROUNDING, _LARGEST_ERROR = 16 * np.finfo(float).eps, 1e-11


class Stiffness(NamedTuple):
    """Stiffness in factors: `rows.T diag(weights) rows + remainder`."""

    # Linear combinations of displacements against which hinges have stiffness
    rows: Float[Array, "rows n"]
    weights: Float[Array, " rows"]  # Stiffness against each of these combinations
    # Geometric stiffness, stiffness of the loads, and the part of the hinge stiffness
    # that is not positive semidefinite
    remainder: Float[Array, "n n"]

    def reduced(self, basis: Float[Array, "n allowed"]) -> "Stiffness":
        """Return the stiffness against the displacements in the columns of a basis."""
        remainder = basis.T @ self.remainder @ basis
        return Stiffness(self.rows @ basis, self.weights, remainder)

    def plus(self, matrix: Float[Array, "n n"]) -> "Stiffness":
        """Add a matrix whose small entries need not be accurate."""
        return self._replace(remainder=self.remainder + matrix)

    def rounding_errors(
        self, displacements: Float[Array, "n modes"]
    ) -> Float[Array, " modes"]:
        """Bound the errors of the stiffness against each displacement."""
        rows, weights, remainder = self
        sizes = jnp.abs(displacements)
        of_remainder = jnp.sum(sizes * (jnp.abs(remainder) @ sizes), axis=0)
        strains, bounds = rows @ displacements, jnp.abs(rows) @ sizes
        return rounding_errors(weights, strains, bounds, of_remainder)


def rounding_errors(
    weights: Float[Array, " rows"],
    strains: Float[Array, "rows modes"],
    bounds: Float[Array, "rows modes"],
    of_remainder: Float[Array, " modes"],
) -> Float[Array, " modes"]:
    """Bound the rounding errors of the stiffness against each of several displacements.

    A displacement may be softer than others by any factor, so the bound follows from the
    terms of its own stiffness, not from the largest eigenvalue.

    Args:
        weights: Stiffness against each row of the factors.
        strains: Products of the rows and the displacements.
        bounds: The same products of the absolute values.
        of_remainder: Products of the absolute values of the remainder and of the
            displacements.
    """
    terms = weights @ strains**2 + of_remainder
    return _LARGEST_ERROR * terms + weights @ (_ROUNDING * bounds) ** 2


class Modes(NamedTuple):
    """Eigenvectors of a stiffness, and its square root in their basis."""

    # Diagonal matrix of the angular frequencies, the smallest first; rad/s. An entry is
    # negative if its stiffness is negative. The derivative of the matrix has off-diagonal
    # entries for equal frequencies.
    root: Float[Array, "n n"]
    vectors: Float[Array, "n n"]  # Orthonormal eigenvectors, one in each column


@jax.custom_jvp
def modes(stiffness: Stiffness) -> Modes:
    """Compute angular frequencies and eigenvectors; NaN if the stiffness is not finite.

    Small frequencies have the same relative accuracy as large ones, because the factors
    are multiplied in a basis that is close to the eigenvectors. An eigenvalue solver for
    the assembled matrix would have errors in proportion to the largest eigenvalue.

    The first derivatives of equal frequencies and of their eigenvectors are those for one
    of the possible bases. Symmetric functions of equal frequencies have correct first
    derivatives. Their sum, the trace of `root`, has correct second derivatives as well.

    Source:
        Demmel and Veselic, Jacobi's method is more accurate than QR, SIAM J. Matrix Anal.
        Appl. 13, 1992.
    """
    rows, weights, remainder = stiffness
    matrix = rows.T @ (weights[:, None] * rows) + (remainder + remainder.T) / 2
    finite = jnp.all(jnp.isfinite(matrix))
    _, basis = jnp.linalg.eigh(jnp.where(finite, matrix, jnp.eye(len(matrix))))
    # The basis is that of the eigenvectors, up to rounding errors of the assembled
    # matrix. If the factors are multiplied in this basis, small entries are as accurate
    # as large ones.
    rows, _, remainder = stiffness.reduced(basis)
    matrix = rows.T @ (weights[:, None] * rows) + (remainder + remainder.T) / 2
    matrix = jnp.where(finite, matrix, jnp.eye(len(matrix)))
    squares, vectors = jacobi_eigenvalues(matrix)
    root = jnp.sign(squares) * jnp.sqrt(jnp.abs(squares))
    nan_if_failed = jnp.where(finite, 0.0, jnp.nan)
    return Modes(jnp.diag(root + nan_if_failed), basis @ vectors + nan_if_failed)


def jacobi_eigenvalues(
    matrix: Float[Array, "n n"],
) -> tuple[Float[Array, " n"], Float[Array, "n n"]]:
    """Compute eigenvalues and eigenvectors of a symmetric matrix by Jacobi's method.

    The eigenvalues are in ascending order, with one eigenvector in each column. If the
    matrix is nearly diagonal, small eigenvalues are as accurate as large ones. Each step
    rotates all coordinates in pairs, those of the first half with those of the second,
    and then permutes them, so that every pair occurs once in a sweep. This is the
    schedule of a round-robin tournament.
    """
    size = len(matrix)
    half = (size + 1) // 2
    padded = jnp.zeros((2 * half, 2 * half)).at[:size, :size].set(matrix)
    if size % 2:
        padded = padded.at[size, size].set(1.0)  # a coordinate without coupling
    permutation = np.arange(2 * half)
    if half > 1:
        first = [0, half, *range(1, half - 1)]
        permutation = np.array([*first, *range(half + 1, 2 * half), half - 1])

    def rotate_pairs(_, both: tuple[Array, Array]) -> tuple[Array, Array]:
        """Set the entries that couple the two coordinates of each pair to zero."""
        matrix, vectors = both
        p, q = np.arange(half), half + np.arange(half)
        a, b, c = matrix[p, p], matrix[q, q], matrix[p, q]
        coupled = c != 0
        cotangent = (b - a) / jnp.where(coupled, 2 * c, 1.0)  # of twice the angle
        sign = jnp.where(cotangent < 0, -1.0, 1.0)
        tangent = sign / (jnp.abs(cotangent) + jnp.sqrt(1 + cotangent**2))
        tangent = jnp.where(coupled, tangent, 0.0)
        cos = 1 / jnp.sqrt(1 + tangent**2)
        sin = tangent * cos

        def rotate_rows(rows: Array) -> Array:
            upper, lower = rows[:half], rows[half:]
            first = cos[:, None] * upper - sin[:, None] * lower
            second = sin[:, None] * upper + cos[:, None] * lower
            return jnp.concatenate([first, second])

        matrix = rotate_rows(rotate_rows(matrix).T)
        matrix = matrix.at[p, p].set(a - tangent * c).at[q, q].set(b + tangent * c)
        matrix = matrix.at[p, q].set(0.0).at[q, p].set(0.0)
        return matrix[permutation][:, permutation], rotate_rows(vectors)[permutation]

    def unfinished(state: tuple[Array, Array, Array]) -> Array:
        """Decide whether an off-diagonal entry is still too large."""
        matrix, _, sweeps = state
        diagonal = jnp.abs(jnp.diagonal(matrix))
        unit = jnp.sqrt(diagonal[:, None]) * jnp.sqrt(diagonal[None])
        off_diagonal = jnp.abs(matrix - jnp.diag(jnp.diagonal(matrix)))
        too_large = jnp.any(off_diagonal > _LARGEST_OFF_DIAGONAL * unit)
        return too_large & (sweeps < _MOST_SWEEPS)

    def sweep(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        """Rotate every pair once."""
        matrix, vectors, sweeps = state
        # The permutations of one sweep restore the order of the coordinates.
        steps = max(1, 2 * half - 1)
        matrix, vectors = jax.lax.fori_loop(0, steps, rotate_pairs, (matrix, vectors))
        return matrix, vectors, sweeps + 1

    state = padded, jnp.eye(2 * half), jnp.zeros((), int)
    diagonalized, vectors, _ = jax.lax.while_loop(unfinished, sweep, state)
    values = jnp.diagonal(diagonalized)[:size]
    order = jnp.argsort(values)
    return values[order], vectors[:size, :size].T[:, order]


@modes.defjvp
def _(primals, tangents):
    (stiffness,), (change,) = primals, tangents
    rows, weights, _ = stiffness
    solution = modes(stiffness)
    root, vectors = solution
    rows, row_changes = rows @ vectors, change.rows @ vectors
    half = rows.T @ (weights[:, None] * row_changes)
    derivative = half + half.T + rows.T @ (change.weights[:, None] * rows)
    derivative = derivative + vectors.T @ change.remainder @ vectors
    root_change, rotation = change_of_modes(root, derivative)
    return solution, Modes(root_change, vectors @ rotation)


def change_of_modes(
    root: Float[Array, "n n"], change: Float[Array, "n n"]
) -> tuple[Float[Array, "n n"], Float[Array, "n n"]]:
    """Compute the change of `Modes` from that of the matrix in their basis.

    Returns:
        The change of the root, and that of the vectors in their basis.
    """
    derivative = _root_derivative(root, change)
    frequencies = jnp.diagonal(root)
    difference = frequencies[None] - frequencies[:, None]
    size = jnp.abs(frequencies[None]) + jnp.abs(frequencies[:, None])
    equal = jnp.abs(difference) <= _EQUAL * size
    rotation = jnp.where(equal, 0.0, derivative / jnp.where(equal, 1.0, difference))
    return jnp.where(equal, derivative, 0.0), rotation


@jax.custom_jvp
def hermitian_modes(
    matrix: Complex[Array, "n n"],
) -> tuple[Float[Array, " n"], Complex[Array, "n n"]]:
    """Compute eigenvalues in ascending order, and orthonormal eigenvectors in columns.

    Derivatives of equal eigenvalues and of their vectors are as those of `modes`.
    """
    values, vectors = jnp.linalg.eigh(matrix)
    return values, vectors


@hermitian_modes.defjvp
def _(primals, tangents):
    values, vectors = hermitian_modes(*primals)
    change = vectors.conj().T @ tangents[0] @ vectors
    difference = values[None] - values[:, None]
    size = jnp.abs(values[None]) + jnp.abs(values[:, None])
    equal = jnp.abs(difference) <= _EQUAL * size
    divisor = jnp.where(equal, 1.0, difference).astype(change.dtype)
    rotation = jnp.where(equal, jnp.zeros_like(change), change / divisor)
    return (values, vectors), (jnp.real(jnp.diagonal(change)), vectors @ rotation)


def _root_derivative(
    root: Float[Array, "n n"], derivative: Float[Array, "n n"]
) -> Float[Array, "n n"]:
    """Compute the derivative X of the square root of a matrix from that of the matrix.

    It solves `root X + X root = derivative`. If two frequencies are zero, the square root
    has no derivative and their entry of X is set to zero. The root is diagonal, but its
    derivative is not, so second derivatives follow from the derivative of the equation.
    """

    def apply(x: Array) -> Array:
        return root @ x + x @ root

    def solve(_, right: Array) -> Array:
        frequencies = jnp.diagonal(root)
        total = frequencies[None] + frequencies[:, None]
        singular = total == 0
        return jnp.where(singular, 0.0, right / jnp.where(singular, 1.0, total))

    return jax.lax.custom_linear_solve(apply, derivative, solve, symmetric=True)
