"""Factors of a dense matrix, which solve linear systems with it."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .elimination import eliminate


# A resistance below this fraction of the diagonal may be a rounding error.
_SMALLEST_PIVOT = 1e-14

# LAPACK is faster for larger matrices. For a single one of this size, it would save five
# microseconds in each solution (`benchmarks.statics`).
_LARGEST_ELIMINATED = 24


class Factors(NamedTuple):
    """Factors of a matrix that is scaled by its diagonal, so that units do not matter.

    A symmetric matrix has a Cholesky factor. If the matrix is not positive definite, the
    equilibrium is unstable, and this factor and all solutions are NaN. Other matrices
    have the two factors of Gaussian elimination.
    """

    scale: Float[Array, " n"]  # Reciprocal square roots of the diagonal
    # The Cholesky factor, or both factors of Gaussian elimination
    triangle: Float[Array, "n n"]
    # Rows that Gaussian elimination exchanged; None for a Cholesky factor
    pivots: Int[Array, " n"] | None

    @classmethod
    def of(cls, matrix: Float[Array, "n n"], symmetric: bool) -> "Factors":
        scale = diagonal_scale(jnp.diagonal(matrix))
        return cls.of_scaled(scale[:, None] * matrix * scale[None], symmetric, scale)

    @classmethod
    def of_scaled(
        cls, matrix: Float[Array, "n n"], symmetric: bool, scale: Float[Array, " n"]
    ) -> "Factors":
        """Factorize a matrix that has been scaled by `scale`."""
        if symmetric:
            return cls(scale, jnp.linalg.cholesky(matrix, symmetrize_input=False), None)
        return cls(scale, *jax.scipy.linalg.lu_factor(matrix))

    def solve(self, right: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
        return scale_rows(self.scale, self.solve_scaled(scale_rows(self.scale, right)))

    def solve_scaled(self, right: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
        """Solve the scaled linear system for one or more right-hand sides."""
        if self.pivots is None:
            return jax.scipy.linalg.cho_solve((self.triangle, True), right)
        return jax.scipy.linalg.lu_solve((self.triangle, self.pivots), right)

    def solve_and_check(
        self, right: Float[Array, " n"]
    ) -> tuple[Float[Array, " n"], Bool[Array, ""]]:
        """Solve the linear system, and decide whether the stiffness is stable."""
        return self.solve(right), self.is_stable()

    def is_stable(self) -> Bool[Array, ""]:
        """Decide whether the stiffness resists every displacement.

        A resistance that may be a rounding error does not count. With follower loads,
        only the sign of the determinant is tested. It changes when the stiffness against
        one displacement becomes zero.
        """
        return is_stable(self.triangle, self.pivots)


class Elimination(NamedTuple):
    """A small symmetric matrix whose linear systems are solved by elimination.

    Each solution eliminates the matrix again. This takes a few microseconds, and in a
    batch less time than factors by LAPACK. If the matrix is not positive definite, the
    equilibrium is unstable, and all solutions are NaN.
    """

    matrix: Float[Array, "n n"]

    def solve(self, right: Float[Array, " n"]) -> Float[Array, " n"]:
        def solve(_, right: Array) -> Array:
            (solution,), stable = _eliminate_symmetric(self.matrix, right[None])
            return jnp.where(stable, solution, jnp.nan)

        # JAX can transpose this call, which derivatives in reverse mode need.
        return jax.lax.custom_linear_solve(
            lambda solution: self.matrix @ solution, right, solve, symmetric=True
        )

    def solve_and_check(
        self, right: Float[Array, " n"]
    ) -> tuple[Float[Array, " n"], Bool[Array, ""]]:
        """Solve the linear system, and decide whether the stiffness is stable.

        One elimination does both; see `Factors.is_stable`.
        """
        (solution,), stable = _solve_symmetric(self.matrix, right[None])
        # A product, so that derivatives are NaN as well
        return solution * jnp.where(stable, 1.0, jnp.nan), stable


def factorize(matrix: Float[Array, "n n"], symmetric: bool) -> Factors | Elimination:
    """Factorize a stiffness, unless it is solved by elimination."""
    if is_eliminated(len(matrix), symmetric):
        return Elimination(matrix)
    return Factors.of(matrix, symmetric)


def is_eliminated(size: int, symmetric: bool) -> bool:
    """Decide whether elimination of a stiffness of this size is faster than LAPACK."""
    return symmetric and 0 < size <= _LARGEST_ELIMINATED


def solve_once(
    matrix: Float[Array, "n n"], rights: Float[Array, "rights n"], symmetric: bool
) -> tuple[Float[Array, "rights n"], Bool[Array, ""]]:
    """Solve linear systems with a stiffness that is not needed again.

    Systems with a small symmetric matrix are solved by elimination, which takes a third
    of the time of LAPACK in a batch. The second result is whether the stiffness is stable
    (see `Factors.is_stable`); otherwise the solutions have no meaning.
    """
    if is_eliminated(len(matrix), symmetric):
        return _solve_symmetric(matrix, rights)
    factors = Factors.of(matrix, symmetric)
    return jax.vmap(factors.solve)(rights), factors.is_stable()


@jax.custom_jvp
def _solve_symmetric(matrix: Array, rights: Array) -> tuple[Array, Array]:
    return _eliminate_symmetric(matrix, rights)


@_solve_symmetric.defjvp
def _(primals, tangents):
    # With the rule for batches only, JAX would have no derivative in reverse mode. In
    # forward mode, it would return one solution for each member of a batch of changes.
    (matrix, _), (matrix_change, rights_change) = primals, tangents
    solutions, stable = _solve_symmetric(*primals)
    rights_change = rights_change - solutions @ matrix_change
    changes = jax.vmap(Elimination(matrix).solve)(rights_change)
    no_change: Any = np.zeros(stable.shape, jax.dtypes.float0)
    return (solutions, stable), (changes, no_change)


def _eliminate_symmetric(matrix: Array, rights: Array) -> tuple[Array, Array]:
    solutions, pivots = eliminate(matrix, rights)
    diagonal = jnp.abs(jnp.diagonal(matrix))
    return solutions, jnp.all(pivots > _SMALLEST_PIVOT * diagonal)


def diagonal_scale(diagonal: Float[Array, "*blocks n"]) -> Float[Array, "*blocks n"]:
    """Compute the reciprocal square roots of a diagonal; 1 where it is zero."""
    size = jnp.abs(diagonal)
    return jax.lax.rsqrt(jnp.where(size > 0, size, 1.0))


def scale_rows(
    scale: Float[Array, " n"], columns: Float[Array, "n ..."]
) -> Float[Array, "n ..."]:
    """Multiply the rows of one or more columns."""
    return scale.reshape(-1, *(1,) * (columns.ndim - 1)) * columns


def is_stable(
    triangle: Float[Array, "*blocks n n"], pivots: Int[Array, "*blocks n"] | None
) -> Bool[Array, ""]:
    """Decide whether a matrix, or all blocks of one, resist every displacement.

    See `Factors` for the arguments, and `Factors.is_stable` for the criterion.
    """
    diagonal = jnp.diagonal(triangle, axis1=-2, axis2=-1)
    if pivots is None:
        # The diagonal of a Cholesky factor has the square roots of the pivots.
        return jnp.all(diagonal > np.sqrt(_SMALLEST_PIVOT))
    large = jnp.all(jnp.abs(diagonal) > _SMALLEST_PIVOT)
    return (determinant_sign(triangle, pivots) > 0) & large


def determinant_sign(
    triangle: Float[Array, "*blocks n n"], pivots: Int[Array, "*blocks n"]
) -> Float[Array, ""]:
    """Return the sign of a determinant from the factors of Gaussian elimination.

    That of several blocks is the sign of the product of their determinants.
    """
    rows = np.arange(pivots.shape[-1], dtype=np.int32)
    exchanges = jnp.sum(pivots != jnp.broadcast_to(rows, pivots.shape))
    negative = jnp.sum(jnp.diagonal(triangle, axis1=-2, axis2=-1) < 0)
    return jnp.where((exchanges + negative) % 2 == 0, 1.0, -1.0)
