"""Elimination of linear constraints by a null space."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .elimination import inverse
from .factors import Elimination, factorize, Factors


def null_space(
    jacobian: Float[Array, "entries n"],
) -> tuple[Float[Array, "n entries"], Float[Array, "n allowed"]]:
    """Compute the pseudo-inverse of a constraint Jacobian and a basis of its null space.

    The rows of the Jacobian must be linearly independent. The basis is orthonormal. Both
    results are differentiable. The derivative of the basis follows from a projection: the
    basis at one point is projected onto the null space at a point nearby, and made
    orthonormal there.
    """
    entries = len(jacobian)
    rotation, _ = jnp.linalg.qr(jax.lax.stop_gradient(jacobian).T, mode="complete")
    basis = rotation[:, entries:]
    size = jnp.linalg.norm(jacobian, axis=1)
    size = jnp.where(size > 0, size, 1.0)
    rows = jacobian / size[:, None]
    pseudo_inverse = rows.T @ inverse(rows @ rows.T)
    # The first inverse has errors in proportion to the square of the condition number.
    error = jnp.eye(entries) - rows @ pseudo_inverse
    pseudo_inverse = pseudo_inverse + pseudo_inverse @ error
    basis = basis - pseudo_inverse @ (rows @ basis)
    if basis.shape[1]:
        lower = jnp.linalg.cholesky(basis.T @ basis)
        basis = jax.scipy.linalg.solve_triangular(lower, basis.T, lower=True).T
    return pseudo_inverse / size[None], basis


class ConstrainedFactors(NamedTuple):
    """Factors of a stiffness on the displacements that constraints allow.

    They solve `[K G^T; G 0]` for displacements and constraint forces by the null-space
    method (Nocedal and Wright, Numerical Optimization, 2006, section 16.2).
    """

    units: Float[Array, " n"]  # Unit of each degree of freedom; rad, m
    stiffness: Float[Array, "n n"]  # The stiffness K in these units
    # Pseudo-inverse of the constraint Jacobian G in these units
    pseudo_inverse: Float[Array, "n entries"]
    # Orthonormal basis of the null space of G in these units
    basis: Float[Array, "n allowed"]
    reduced: Factors | Elimination  # Factors of the stiffness in this basis

    @classmethod
    def of(
        cls,
        stiffness: Float[Array, "n n"],
        jacobian: Float[Array, "entries n"],
        units: Float[Array, " n"],
        symmetric: bool,
    ) -> "ConstrainedFactors":
        """Factorize a stiffness (N m/rad, N/rad, N/m) with a constraint Jacobian."""
        scaled = units[:, None] * stiffness * units[None]
        pseudo_inverse, basis = null_space(jacobian * units[None])
        reduced = factorize(basis.T @ scaled @ basis, symmetric)
        return cls(units, scaled, pseudo_inverse, basis, reduced)

    def solve(self, right: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
        """Solve for displacements, then constraint forces, of one right-hand side."""
        imposed, imbalance = self._reduce(right)
        return self._expand(right, imposed + self.basis @ self.reduced.solve(imbalance))

    def solve_and_check(
        self, right: Float[Array, " unknowns"]
    ) -> tuple[Float[Array, " unknowns"], Bool[Array, ""]]:
        """Solve, and decide whether the stiffness resists all allowed displacements."""
        imposed, imbalance = self._reduce(right)
        allowed, stable = self.reduced.solve_and_check(imbalance)
        solution = self._expand(right, imposed + self.basis @ allowed)
        return solution, stable & jnp.all(jnp.isfinite(self.pseudo_inverse))

    def _reduce(
        self, right: Float[Array, " unknowns"]
    ) -> tuple[Float[Array, " n"], Float[Array, " allowed"]]:
        """Return the displacement that constraints impose, and the imbalance in it."""
        count = len(self.units)
        force, violation = self.units * right[:count], right[count:]
        imposed = self.pseudo_inverse @ violation
        return imposed, self.basis.T @ (force - self.stiffness @ imposed)

    def _expand(
        self, right: Float[Array, " unknowns"], displacement: Float[Array, " n"]
    ) -> Float[Array, " unknowns"]:
        """Add the constraint forces, and return to units of displacements."""
        force = self.units * right[: len(self.units)]
        multipliers = self.pseudo_inverse.T @ (force - self.stiffness @ displacement)
        return jnp.concatenate([self.units * displacement, multipliers])
