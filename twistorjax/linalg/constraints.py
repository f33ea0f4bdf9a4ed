"""Elimination of linear constraints by a null space."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Inexact

from .block_factors import BlockFactors, Layout
from .elimination import inverse
from .factors import diagonal_scale, Elimination, factorize, Factors


# Stiffness of the springs in place of constraints, relative to that of the bodies
_SPRINGS = 1e3


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


class AllowedDisplacements(NamedTuple):
    """Displacements that linear constraints allow, and those that violations impose."""

    # The allowed displacements as columns, orthonormal in units; None without constraints
    basis: Inexact[Array, "n allowed"] | None
    # Pseudo-inverse of the constraint Jacobian in these units
    pseudo_inverse: Inexact[Array, "n entries"]

    @classmethod
    def of(
        cls, jacobian: Float[Array, "entries n"], units: Float[Array, " n"]
    ) -> "AllowedDisplacements":
        """Eliminate constraints whose violations have this Jacobian."""
        if not len(jacobian):
            return cls(None, jnp.zeros((len(units), 0)))
        pseudo_inverse, basis = null_space(jacobian * units[None])
        return cls(units[:, None] * basis, units[:, None] * pseudo_inverse)

    def reduced(self, matrix: Inexact[Array, "n n"]) -> Inexact[Array, "allowed allowed"]:
        """Return the stiffness against allowed displacements."""
        return matrix if self.basis is None else self.basis.T @ matrix @ self.basis

    def projected(self, force: Inexact[Array, " n"]) -> Inexact[Array, " allowed"]:
        """Return the work of a force for a unit of each allowed displacement."""
        return force if self.basis is None else self.basis.T @ force

    def expanded(self, allowed: Inexact[Array, " allowed"]) -> Inexact[Array, " n"]:
        """Return a sum of allowed displacements."""
        return allowed if self.basis is None else self.basis @ allowed

    def imposed(self, violation: Inexact[Array, " entries"]) -> Inexact[Array, " n"]:
        """Return the smallest displacement that has a violation."""
        return self.pseudo_inverse @ violation

    def multipliers(self, force: Inexact[Array, " n"]) -> Inexact[Array, " entries"]:
        """Return the constraint forces that balance a force without allowed work."""
        return self.pseudo_inverse.T @ force


class ConstrainedFactors(NamedTuple):
    """Factors of a stiffness on the displacements that constraints allow.

    They solve `[K G^T; G 0]` for displacements and constraint forces by the null-space
    method (Nocedal and Wright, Numerical Optimization, 2006, section 16.2).
    """

    stiffness: Float[Array, "n n"]
    allowed: AllowedDisplacements
    reduced: Factors | Elimination  # of the stiffness against allowed displacements

    @classmethod
    def of(
        cls,
        stiffness: Float[Array, "n n"],
        allowed: AllowedDisplacements,
        symmetric: bool,
    ) -> "ConstrainedFactors":
        """Factorize a stiffness; N m/rad, N/rad, N/m."""
        return cls(stiffness, allowed, factorize(allowed.reduced(stiffness), symmetric))

    def solve(self, right: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
        """Solve for displacements, then constraint forces, of one right-hand side."""
        imposed, imbalance = self._reduce(right)
        return self._expand(right, imposed, self.reduced.solve(imbalance))

    def solve_and_check(
        self, right: Float[Array, " unknowns"]
    ) -> tuple[Float[Array, " unknowns"], Bool[Array, ""]]:
        """Solve, and decide whether the stiffness resists all allowed displacements."""
        imposed, imbalance = self._reduce(right)
        coordinates, stable = self.reduced.solve_and_check(imbalance)
        stable &= jnp.all(jnp.isfinite(self.allowed.pseudo_inverse))
        return self._expand(right, imposed, coordinates), stable

    def _reduce(
        self, right: Float[Array, " unknowns"]
    ) -> tuple[Float[Array, " n"], Float[Array, " allowed"]]:
        """Return the displacement that constraints impose, and the imbalance in it."""
        force, violation = jnp.split(right, [len(self.stiffness)])
        imposed = self.allowed.imposed(violation)
        return imposed, self.allowed.projected(force - self.stiffness @ imposed)

    def _expand(
        self,
        right: Float[Array, " unknowns"],
        imposed: Float[Array, " n"],
        coordinates: Float[Array, " allowed"],
    ) -> Float[Array, " unknowns"]:
        """Return the displacement, and the constraint forces that balance the rest."""
        displacement = imposed + self.allowed.expanded(coordinates)
        rest = right[: len(self.stiffness)] - self.stiffness @ displacement
        return jnp.concatenate([displacement, self.allowed.multipliers(rest)])


class BorderedFactors(NamedTuple):
    """Factors of the stiffness of many bodies in blocks, and of its constraints.

    They solve the same equations as `ConstrainedFactors`, by the constraint forces. The
    stiffness is that of springs in place of the constraints, because without them it may
    be singular (Nocedal and Wright, Numerical Optimization, 2006, section 17.3).
    """

    stiffness: Float[Array, "n n"]
    jacobian: Float[Array, "entries n"]
    springs: Float[Array, " entries"]
    sprung: BlockFactors  # of the stiffness with the springs
    response: Float[Array, "n entries"]  # Displacements under unit constraint forces
    flexibility: Factors  # Changes of the violations under these

    @classmethod
    def of(
        cls,
        stiffness: Float[Array, "n n"],
        jacobian: Float[Array, "entries n"],
        layout: Layout,
        symmetric: bool,
    ) -> "BorderedFactors":
        """Factorize a stiffness; N m/rad, N/rad, N/m.

        The layout has the pairs of bodies that a constraint couples.
        """
        # A diagonal entry may vanish under loads, but not its coupling with others.
        diagonal = jnp.abs(jnp.diagonal(stiffness))
        others = jnp.where(diagonal > 0, diagonal, jnp.inf)
        resistance = jnp.max(stiffness**2 / others[None], axis=1)
        scaled = jacobian * diagonal_scale(resistance)[None]
        size = jnp.sum(scaled**2, axis=1)
        springs = _SPRINGS / jnp.where(size > 0, size, 1.0)
        sprung = stiffness + jacobian.T @ (springs[:, None] * jacobian)
        factors = BlockFactors.of(layout.of_dense(sprung), layout, symmetric)
        response = factors.solve(jacobian.T)
        flexibility = Factors.of(jacobian @ response, symmetric)
        return cls(stiffness, jacobian, springs, factors, response, flexibility)

    def solve(self, right: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
        """Solve for displacements, then constraint forces, of one right-hand side."""
        solution = self._solve(right)
        count = len(self.stiffness)
        displacement, forces = solution[:count], solution[count:]
        product = self.stiffness @ displacement + forces @ self.jacobian
        residual = right - jnp.append(product, self.jacobian @ displacement)
        return solution + self._solve(residual)  # The springs are stiff.

    def solve_and_check(
        self, right: Float[Array, " unknowns"]
    ) -> tuple[Float[Array, " unknowns"], Bool[Array, ""]]:
        """Solve, and decide whether the stiffness resists all allowed displacements."""
        stable = self.sprung.is_stable() & self.flexibility.is_stable()
        return self.solve(right), stable

    def _solve(self, right: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
        force, violation = jnp.split(right, [len(self.stiffness)])
        force = force + self.jacobian.T @ (self.springs * violation)
        free = self.sprung.solve(force)
        forces = self.flexibility.solve(self.jacobian @ free - violation)
        return jnp.concatenate([free - self.response @ forces, forces])
