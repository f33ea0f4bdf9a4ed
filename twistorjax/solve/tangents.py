"""Tangent stiffness of a mechanism: dense, with constraints, or in blocks."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import Flag
from ..mechanism.hinge_assembly import HingeAssembly
from ..mechanism.scatter import sum_entries
from .block_factorization import BlockFactors, Layout
from .dofs import DofPartition
from .factorization import ConstrainedFactors, Factors


def add_load_stiffness(
    matrix: Float[Array, "rows columns"],
    by_angle: Float[Array, " dofs"],
    loaded: Sequence[int],
    rows: tuple[int, ...],
    columns: tuple[int, ...],
) -> Float[Array, "rows columns"]:
    """Add the stiffness of loads, whose moments or directions change with the angle.

    Args:
        matrix: Stiffness to which that of the loads is added.
        by_angle: Derivative of the load on each degree of freedom by the angle of its own
            body, the only coordinate on which it depends; N m/rad, N/rad.
        loaded: Indices of the bodies with loads.
        rows: Degrees of freedom of the rows.
        columns: Degrees of freedom of the columns.
    """
    column_of = {dof: column for column, dof in enumerate(columns)}
    entries = [
        (row, column_of[3 * (dof // 3)], dof)
        for row, dof in enumerate(rows)
        if dof // 3 in loaded and 3 * (dof // 3) in column_of
    ]
    if not entries:
        return matrix
    row, column, dof = np.array(entries).T
    return matrix.at[row, column].add(-by_angle[dof])


class DenseTangent(eqx.Module):
    """Tangent stiffness of the free degrees of freedom, as one matrix.

    Args:
        matrix: Derivatives by the free degrees of freedom, then by the prescribed ones;
            N m/rad, N/rad, N/m.
    """

    matrix: Float[Array, "free free_and_prescribed"]

    def push(self, move: Float[Array, " prescribed"]) -> Float[Array, " free"]:
        """Compute the forces that prescribed displacements cause; N m, N."""
        return self.matrix[:, len(self.matrix) :] @ move

    def factors(self, symmetric: bool) -> Factors:
        """Factor the stiffness of the free degrees of freedom."""
        return Factors.of(self.matrix[:, : len(self.matrix)], symmetric)

    def finite(self) -> Flag:
        """Decide whether all entries are finite."""
        return jnp.all(jnp.isfinite(self.matrix))

    def where(self, found: Flag) -> "DenseTangent":
        """Replace the matrix by an identity matrix if no solution was found."""
        return DenseTangent(jnp.where(found, self.matrix, _identity(self.matrix)))


class ConstrainedTangent(eqx.Module):
    """Tangent of a mechanism with constraints: stiffness and constraint Jacobian.

    Vectors of forces and displacements have the entries of the free degrees of freedom,
    then an entry for each constraint equation: its violation, or the negative change of
    its constraint force.

    Args:
        stiffness: Derivatives of the forces, constraint forces included, by the free
            degrees of freedom, then by the prescribed ones.
        jacobian: Derivatives of the violations by the same.
        units: Unit of each free degree of freedom; rad, m.
    """

    stiffness: Float[Array, "free free_and_prescribed"]
    jacobian: Float[Array, "entries free_and_prescribed"]
    units: Float[Array, " free"]

    def push(self, move: Float[Array, " prescribed"]) -> Float[Array, " unknowns"]:
        """Compute the forces and the violations that prescribed displacements cause."""
        count = len(self.stiffness)
        return jnp.concatenate(
            [self.stiffness[:, count:] @ move, self.jacobian[:, count:] @ move]
        )

    def factors(self, symmetric: bool) -> ConstrainedFactors:
        """Factor the stiffness on the displacements that the constraints allow."""
        count = len(self.stiffness)
        return ConstrainedFactors.of(
            self.stiffness[:, :count], self.jacobian[:, :count], self.units, symmetric
        )

    def finite(self) -> Flag:
        """Decide whether all entries are finite."""
        stiffness = jnp.all(jnp.isfinite(self.stiffness))
        return stiffness & jnp.all(jnp.isfinite(self.jacobian))

    def where(self, found: Flag) -> "ConstrainedTangent":
        """Replace both matrices by identity matrices if no solution was found."""
        stiffness, jacobian = (
            jnp.where(found, matrix, _identity(matrix))
            for matrix in (self.stiffness, self.jacobian)
        )
        return ConstrainedTangent(stiffness, jacobian, self.units)


class BlockTangent(eqx.Module):
    """Tangent stiffness of the free degrees of freedom of a mechanism of many bodies.

    Args:
        hinges: The hinges.
        pairs: Stiffness of each hinge among the degrees of freedom of its two bodies.
        by_angle: Derivatives of the loads by the angle of their own body.
        dofs: Partition of the degrees of freedom.
        layout: Layout of the blocks of the matrix.
    """

    hinges: HingeAssembly
    pairs: Float[Array, "6 6 hinges"]
    by_angle: Float[Array, " dofs"]
    dofs: DofPartition = eqx.field(static=True)
    layout: Layout = eqx.field(static=True)

    def push(self, move: Float[Array, " prescribed"]) -> Float[Array, " free"]:
        """Compute the forces that prescribed displacements cause; N m, N."""
        prescribed = np.array(self.dofs.prescribed, int)
        moved = jnp.zeros_like(self.by_angle).at[prescribed].set(move)
        forces = self.hinges.applied(self.pairs, moved)
        rotations = jnp.repeat(moved[::3], 3)
        return (forces - self.by_angle * rotations)[np.array(self.dofs.free, int)]

    def factors(self, symmetric: bool) -> BlockFactors:
        """Factor the stiffness of the free degrees of freedom."""
        layout, count = self.layout, 3 * self.layout.blocks * self.layout.size**2
        source, target = self._block_entries()
        entries = jnp.concatenate([self.pairs.reshape(-1), -self.by_angle])
        blocks = sum_entries(entries, source, target, count)
        shape = (3, layout.blocks, layout.size, layout.size)
        return BlockFactors.of(blocks.reshape(shape), layout, symmetric)

    def finite(self) -> Flag:
        """Decide whether all entries are finite."""
        return jnp.all(jnp.isfinite(self.pairs)) & jnp.all(jnp.isfinite(self.by_angle))

    def where(self, found: Flag) -> "BlockTangent":
        """Replace the stiffness by that of unit springs if no solution was found."""
        pairs = jnp.where(found, self.pairs, jnp.asarray(np.eye(6)[:, :, None]))
        by_angle = jnp.where(found, self.by_angle, 0.0)
        return BlockTangent(self.hinges, pairs, by_angle, self.dofs, self.layout)

    def _block_entries(self) -> tuple[np.ndarray, np.ndarray]:
        """Find the entries that are used, and the position of each among the blocks.

        Entries are those of `pairs`, then those of `by_angle`.
        """
        every = np.arange(self.dofs.total)
        of_loads = np.stack([every, 3 * (every // 3)])
        dofs = np.concatenate([self.hinges.pair_dofs(), of_loads], axis=1)
        row = np.full(self.dofs.total, -1)
        row[list(self.dofs.free)] = np.arange(len(self.dofs.free))
        rows, columns = row[dofs]
        source = np.flatnonzero((rows >= 0) & (columns >= 0))
        return source, self.layout.flat_indices(rows[source], columns[source])


Tangent = DenseTangent | ConstrainedTangent | BlockTangent


def _identity(matrix: Float[Array, "rows columns"]) -> Float[Array, "rows columns"]:
    """Ones on the diagonal of a matrix of the same shape."""
    rows, columns = matrix.shape
    return jnp.eye(rows, columns)
