"""The equilibrium of a mechanism as a system of equations, and its tangent stiffness."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._utils.types import Poses, Scalar
from ..mechanism.hinge_assembly import HingeAssembly
from ..mechanism.loads import LoadSet
from ..mechanism.scatter import summed
from .factorization import block_layout, BlockFactors, Factors, Layout


class DofPartition(NamedTuple):
    """Which coordinates are free and which are driven; the others are held."""

    free: tuple[int, ...]
    driven: tuple[int, ...]


class Problem(eqx.Module):
    """The equilibrium of couplings under loads, with some coordinates given.

    Coordinates are the bodies' displacements from rest, three a body. Those neither free
    nor driven are held where they start.

    Args:
        hinge_assembly: the hinges.
        loads: at their full size.
        targets: what the driven coordinates come to.
        places: of the free and of the driven coordinates.
    """

    hinge_assembly: HingeAssembly
    loads: LoadSet
    targets: Float[Array, " driven"]
    places: DofPartition = eqx.field(static=True)

    @property
    def free(self) -> np.ndarray:
        """Places of the free coordinates."""
        return np.array(self.places.free, int)

    @property
    def symmetric(self) -> bool:
        """Whether the loads have a potential, as all do that keep their direction."""
        return not any(self.loads.follower)

    @property
    def driven(self) -> np.ndarray:
        """Places of the driven coordinates."""
        return np.array(self.places.driven, int)

    def residual(self, displacements: Poses) -> Float[Array, " coordinates"]:
        """What hinges and loads leave unbalanced: the reactions where it is held."""
        applied, _ = self.loads.apply(displacements)
        return (self.hinge_assembly.forces(displacements) - applied).reshape(-1)

    def tangent(
        self,
        displacements: Poses,
        fraction: Scalar | float = 1.0,
        borne: Float[Array, "3 hinges"] | None = None,
    ) -> tuple[Float[Array, " coordinates"], "DenseTangent | BlockTangent", Scalar]:
        """The residual under a fraction of the loads, its slope, and the work in hinges.

        Args:
            displacements: of each body from rest; rad, m, m.
            fraction: of the loads.
            borne: the tension with which the hinges stiffen as they turn, by default
                their own.
        """
        layout = block_layout(self.hinge_assembly.ends, self.places.free)
        if layout is None:
            residual, matrix, work = self.matrix(displacements, fraction, borne)
            return residual, DenseTangent(matrix), work
        forces, pairs, work = self.hinge_assembly.pairs(displacements, borne)
        applied, by_angle = (
            fraction * value.reshape(-1) for value in self.loads.apply(displacements)
        )
        slope = BlockTangent(self.hinge_assembly, pairs, by_angle, self.places, layout)
        return forces - applied, slope, work

    def matrix(
        self,
        displacements: Poses,
        fraction: Scalar | float = 1.0,
        borne: Float[Array, "3 hinges"] | None = None,
    ) -> tuple[
        Float[Array, " coordinates"], Float[Array, "free free_and_driven"], Scalar
    ]:
        """The same as the `tangent`, with the slope as one matrix."""
        columns = self.places.free + self.places.driven
        forces, matrix, work = self.hinge_assembly.tangent(
            displacements, self.places.free, columns, borne
        )
        if not self.loads.bodies:
            return forces, matrix, work
        applied, by_angle = (
            fraction * value.reshape(-1) for value in self.loads.apply(displacements)
        )
        if pairs := self._turning(columns):
            rows, where, which = np.array(pairs).T
            matrix = matrix.at[rows, where].add(-by_angle[which])
        return forces - applied, matrix, work

    def _turning(self, columns: tuple[int, ...]) -> list[tuple[int, int, int]]:
        """Entries of the tangent to which the loads add, as they turn with their bodies.

        A load's wrench depends on the angle of its own body alone.

        Args:
            columns: coordinates of the tangent's columns.

        Returns:
            For each entry its row, its column, and the coordinate of the row.
        """
        place = {coordinate: column for column, coordinate in enumerate(columns)}
        return [
            (row, place[3 * (coordinate // 3)], coordinate)
            for row, coordinate in enumerate(self.places.free)
            if coordinate // 3 in self.loads.bodies and 3 * (coordinate // 3) in place
        ]

    def place(
        self,
        displacements: Poses,
        free: Array | None = None,
        driven: Array | None = None,
    ) -> Poses:
        """The displacements with new values of the free or the driven coordinates."""
        flat = displacements.reshape(-1)
        if free is not None:
            flat = flat.at[self.free].set(free)
        if driven is not None:
            flat = flat.at[self.driven].set(driven)
        return flat.reshape(displacements.shape)


class DenseTangent(eqx.Module):
    """Tangent stiffness of the free coordinates.

    Args:
        matrix: by the free coordinates, and then by the driven ones.
    """

    matrix: Float[Array, "free free_and_driven"]

    def push(self, move: Float[Array, " driven"]) -> Float[Array, " free"]:
        """The forces that displacements of the driven coordinates cause; N m, N."""
        return self.matrix[:, len(self.matrix) :] @ move

    def factors(self, symmetric: bool) -> Factors:
        """Factor the stiffness of the free coordinates."""
        return Factors.of(self.matrix[:, : len(self.matrix)], symmetric)

    def finite(self) -> Bool[Array, ""]:
        """Decide whether all entries are finite."""
        return jnp.all(jnp.isfinite(self.matrix))

    def where(self, found: Bool[Array, ""]) -> "DenseTangent":
        """The same, or a matrix of ones on the diagonal where nothing was found."""
        rows, columns = self.matrix.shape
        one = jnp.eye(rows, columns)
        return DenseTangent(jnp.where(found, self.matrix, one))


class BlockTangent(eqx.Module):
    """Tangent stiffness of the free coordinates of a mechanism of many bodies.

    Args:
        hinge_assembly: the hinges.
        pairs: stiffness of each hinge, among the coordinates of its two bodies.
        by_angle: derivatives of the loads by the angle of their own body.
        places: of the free and of the driven coordinates.
        layout: of the blocks of the matrix.
    """

    hinge_assembly: HingeAssembly
    pairs: Float[Array, "6 6 hinges"]
    by_angle: Float[Array, " coordinates"]
    places: DofPartition = eqx.field(static=True)
    layout: Layout = eqx.field(static=True)

    def push(self, move: Float[Array, " driven"]) -> Float[Array, " free"]:
        """The forces that displacements of the driven coordinates cause; N m, N."""
        free, driven = (np.array(chosen, int) for chosen in self.places)
        moved = jnp.zeros_like(self.by_angle).at[driven].set(move)
        forces = self.hinge_assembly.applied(self.pairs, moved)
        turned = jnp.repeat(moved[::3], 3)
        return (forces - self.by_angle * turned)[free]

    def factors(self, symmetric: bool) -> BlockFactors:
        """Factor the stiffness of the free coordinates."""
        layout, count = self.layout, 3 * self.layout.blocks * self.layout.size**2
        source, target = _block_places(self.hinge_assembly, self.places.free, layout)
        entries = jnp.concatenate([self.pairs.reshape(-1), -self.by_angle])
        blocks = summed(entries, source, target, count)
        shape = (3, layout.blocks, layout.size, layout.size)
        return BlockFactors.of(blocks.reshape(shape), layout, symmetric)

    def finite(self) -> Bool[Array, ""]:
        """Decide whether all entries are finite."""
        return jnp.all(jnp.isfinite(self.pairs)) & jnp.all(jnp.isfinite(self.by_angle))

    def where(self, found: Bool[Array, ""]) -> "BlockTangent":
        """The same, or that of hinges of unit stiffness where nothing was found."""
        one = jnp.asarray(np.eye(6)[:, :, None])
        pairs = jnp.where(found, self.pairs, one)
        by_angle = jnp.where(found, self.by_angle, 0.0)
        return BlockTangent(
            self.hinge_assembly, pairs, by_angle, self.places, self.layout
        )


def _block_places(
    hinge_assembly: HingeAssembly, free: tuple[int, ...], layout: Layout
) -> tuple[np.ndarray, np.ndarray]:
    """Which entries of `BlockTangent` go where in the array of blocks.

    Args:
        hinge_assembly: the hinges, whose `pairs` come first among the entries.
        free: the free coordinates; the derivatives of the loads come last.
        layout: of the blocks.

    Returns:
        The entries that are used, and for each its place.
    """
    size = 3 * hinge_assembly.bodies
    every = np.arange(size)
    of_loads = np.stack([every, 3 * (every // 3)])
    coordinates = np.concatenate([hinge_assembly.pair_coordinates(), of_loads], axis=1)
    row = np.full(size, -1)
    row[list(free)] = np.arange(len(free))
    rows, columns = row[coordinates]
    source = np.flatnonzero((rows >= 0) & (columns >= 0))
    return source, layout.places(rows[source], columns[source])
