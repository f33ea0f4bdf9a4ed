"""Tangent stiffness of a mechanism: dense, with constraints, or in blocks."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.types import Flag
from ...assembly.assembly import HingeAssembly
from ...linalg.block_factors import BlockFactors, Layout
from ...linalg.constraints import (
    AllowedDisplacements,
    BorderedFactors,
    ConstrainedFactors,
)
from ...linalg.factors import Elimination, factorize, Factors, solve_once
from .dofs import DofPartition


def add_load_stiffness(
    matrix: Float[Array, "*matrix"],
    by_angle: Float[Array, " dofs"],
    conservative: bool,
    rows: tuple[int, ...],
    columns: tuple[int, ...],
    layout: Layout | None = None,
) -> Float[Array, "*matrix"]:
    """Add the stiffness of loads, whose moments or directions change with the angle.

    Args:
        matrix: Stiffness to which that of the loads is added, in the shape of the layout
            if there is one; N m/rad, N/rad, N/m.
        by_angle: Derivative of the load on each degree of freedom with respect to the
            angle of its body, the only coordinate on which it depends; N m/rad, N/rad.
        conservative: Whether the loads have a potential, so that only their moments
            depend on the angle.

    Returns:
        The sum; N m/rad, N/rad, N/m.
    """
    column_of = {dof: column for column, dof in enumerate(columns)}
    entries = [
        (row, column_of[3 * (dof // 3)], dof)
        for row, dof in enumerate(rows)
        if 3 * (dof // 3) in column_of and not (conservative and dof % 3)
    ]
    if not entries:
        return matrix
    row, column, dof = np.array(entries).T
    if layout is None:
        return matrix.at[row, column].add(-by_angle[dof])
    flat = matrix.reshape(-1).at[layout.flat_indices(row, column)].add(-by_angle[dof])
    return flat.reshape(matrix.shape)


class DenseTangent(eqx.Module):
    """Tangent stiffness of the free degrees of freedom, as one matrix."""

    # Derivatives with respect to the free degrees of freedom, then with respect to the
    # prescribed ones; N m/rad, N/rad, N/m
    matrix: Float[Array, "free free_and_prescribed"]

    def prescribed_forces(
        self, change: Float[Array, " prescribed"]
    ) -> Float[Array, " free"]:
        """Compute the forces that prescribed displacements cause; N m, N."""
        return self.matrix[:, len(self.matrix) :] @ change

    def factors(self, symmetric: bool) -> Factors | Elimination:
        """Factorize the stiffness of the free degrees of freedom."""
        return factorize(self.matrix[:, : len(self.matrix)], symmetric)

    def solve_and_check(
        self, rights: Float[Array, "rights free"], symmetric: bool
    ) -> tuple[Float[Array, "rights free"], Flag]:
        """Solve linear systems, and decide whether the stiffness is stable."""
        return solve_once(self.matrix[:, : len(self.matrix)], rights, symmetric)

    def identity_unless(self, found: Flag) -> "DenseTangent":
        """Replace the matrix by an identity matrix if no solution was found."""
        return DenseTangent(jnp.where(found, self.matrix, _identity(self.matrix)))


class ConstrainedTangent(eqx.Module):
    """Tangent of a mechanism with constraints: stiffness and constraint Jacobian.

    Vectors of forces and displacements have the entries of the free degrees of freedom,
    then an entry for each constraint equation: its violation, or the negative change of
    its constraint force.
    """

    # Derivatives of the forces, including constraint forces, with respect to the free
    # degrees of freedom, then with respect to the prescribed ones
    stiffness: Float[Array, "free free_and_prescribed"]
    # Derivatives of the violations with respect to the same
    jacobian: Float[Array, "entries free_and_prescribed"]
    units: Float[Array, " free"]  # Unit of each free degree of freedom; rad, m
    # Layout of the stiffness of many bodies with constraints; None if it is dense
    layout: Layout | None = eqx.field(static=True)

    def prescribed_forces(
        self, change: Float[Array, " prescribed"]
    ) -> Float[Array, " unknowns"]:
        """Compute the forces and the violations that prescribed displacements cause."""
        count = len(self.stiffness)
        return jnp.concatenate(
            [self.stiffness[:, count:] @ change, self.jacobian[:, count:] @ change]
        )

    def factors(self, symmetric: bool) -> ConstrainedFactors | BorderedFactors:
        """Factorize the stiffness on the displacements that the constraints allow."""
        count = len(self.stiffness)
        stiffness, jacobian = self.stiffness[:, :count], self.jacobian[:, :count]
        if self.layout is not None:
            return BorderedFactors.of(stiffness, jacobian, self.layout, symmetric)
        allowed = AllowedDisplacements.of(jacobian, self.units)
        return ConstrainedFactors.of(stiffness, allowed, symmetric)

    def solve_and_check(
        self, rights: Float[Array, "rights unknowns"], symmetric: bool
    ) -> tuple[Float[Array, "rights unknowns"], Flag]:
        """Solve linear systems, and decide whether the stiffness is stable."""
        return _solve_with_factors(self.factors(symmetric), rights)

    def identity_unless(self, found: Flag) -> "ConstrainedTangent":
        """Replace both matrices by identity matrices if no solution was found."""
        stiffness, jacobian = (
            jnp.where(found, matrix, _identity(matrix))
            for matrix in (self.stiffness, self.jacobian)
        )
        return ConstrainedTangent(stiffness, jacobian, self.units, self.layout)


class BlockTangent(eqx.Module):
    """Tangent stiffness of the free degrees of freedom of a mechanism of many bodies."""

    hinges: HingeAssembly
    # Stiffness of each hinge with respect to the six degrees of freedom of its two
    # bodies; N m/rad, N/rad, N/m
    hinge_stiffness: Float[Array, "6 6 members"]
    # Derivatives of the loads with respect to the angle of their body; N m/rad, N/rad
    by_angle: Float[Array, " dofs"]
    dofs: DofPartition = eqx.field(static=True)  # Partition of the degrees of freedom
    layout: Layout = eqx.field(static=True)  # Layout of the blocks of the matrix

    def prescribed_forces(
        self, change: Float[Array, " prescribed"]
    ) -> Float[Array, " free"]:
        """Compute the forces that prescribed displacements cause; N m, N."""
        prescribed = np.array(self.dofs.prescribed, int)
        displacements = jnp.zeros_like(self.by_angle).at[prescribed].set(change)
        forces = self.hinges.multiply_stiffness(self.hinge_stiffness, displacements)
        rotations = jnp.repeat(displacements[::3], 3)
        return (forces - self.by_angle * rotations)[np.array(self.dofs.free, int)]

    def factors(self, symmetric: bool) -> BlockFactors:
        """Factorize the stiffness of the free degrees of freedom."""
        layout, free = self.layout, self.dofs.free
        blocks = self.hinges.assemble(self.hinge_stiffness, free, layout)
        # Without follower loads, the matrix is symmetric.
        blocks = add_load_stiffness(blocks, self.by_angle, symmetric, free, free, layout)
        return BlockFactors.of(blocks, layout, symmetric)

    def solve_and_check(
        self, rights: Float[Array, "rights free"], symmetric: bool
    ) -> tuple[Float[Array, "rights free"], Flag]:
        """Solve linear systems, and decide whether the stiffness is stable."""
        return _solve_with_factors(self.factors(symmetric), rights)

    def identity_unless(self, found: Flag) -> "BlockTangent":
        """Replace the stiffness of each hinge by an identity matrix if not `found`."""
        identity = jnp.asarray(np.eye(6)[:, :, None])
        stiffness = jnp.where(found, self.hinge_stiffness, identity)
        by_angle = jnp.where(found, self.by_angle, 0.0)
        return BlockTangent(self.hinges, stiffness, by_angle, self.dofs, self.layout)


def _solve_with_factors(
    factors: ConstrainedFactors | BorderedFactors | BlockFactors,
    rights: Float[Array, "rights unknowns"],
) -> tuple[Float[Array, "rights unknowns"], Flag]:
    """Solve linear systems, and decide whether the stiffness is stable."""
    solutions, stable = jax.vmap(factors.solve_and_check)(rights)
    return solutions, jnp.all(stable)


Tangent = DenseTangent | ConstrainedTangent | BlockTangent


def _identity(matrix: Float[Array, "rows columns"]) -> Float[Array, "rows columns"]:
    """Return a matrix of the same shape with ones on the diagonal."""
    rows, columns = matrix.shape
    return jnp.eye(rows, columns)
