"""All hinges of a mechanism together: what they store, and how they pull."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from . import hinge
from ._checks import all_known
from ._types import Poses, Scalar, Wrenches
from .energy import AbstractEnergy
from .hinge import End


class Stack(eqx.Module):
    """Hinges whose energies are of one kind, evaluated as one array operation.

    Args:
        members: their places in the mechanism's list of hinges.
        energy: their energies, stacked; what all of them share stands once.
        axes: for each array of the energy 0 where it is stacked, or nothing.
    """

    members: tuple[int, ...] = eqx.field(static=True)
    energy: AbstractEnergy
    axes: tuple[int | None, ...] = eqx.field(static=True)


class Couplings(eqx.Module):
    """The hinges of a mechanism, as functions of how far its bodies have moved.

    Args:
        ends: the two bodies of each hinge, by their places.
        arms: from each body's origin to the hinge at rest, in world axes; m.
        axes: cosine and sine of each hinge's angle at rest.
        stacks: the energies, the like of them together.
    """

    ends: tuple[tuple[int, int], ...] = eqx.field(static=True)
    arms: Float[Array, "hinges 2 2"]
    axes: Float[Array, "hinges 2"]
    stacks: tuple[Stack, ...]

    def energy_of(self, row: int) -> AbstractEnergy:
        """The energy of one hinge, by its place in the mechanism's list."""
        stack = next(stack for stack in self.stacks if row in stack.members)
        place = stack.members.index(row)
        leaves, tree = jax.tree.flatten(stack.energy)
        own = [
            leaf if axis is None else leaf[place]
            for leaf, axis in zip(leaves, stack.axes, strict=True)
        ]
        return jax.tree.unflatten(tree, own)

    def energy(self, displacements: Poses) -> Scalar:
        """What all hinges store; J."""

        def stored(energy, first, second, axis):
            return energy.stored(hinge.halfway(first, second, axis).displacement)

        return sum(
            (jnp.sum(self._map(stored, stack, displacements)) for stack in self.stacks),
            start=jnp.zeros(()),
        )

    def forces(self, displacements: Poses) -> Wrenches:
        """Derivative of the energy by each body's displacement; N m/rad, N, N."""
        local = self._local(hinge.forces, displacements)
        total = jnp.zeros(displacements.size).at[self._coordinates()]
        return total.add(jnp.stack(local)).reshape(displacements.shape)

    def tension(self, displacements: Poses) -> Float[Array, "3 hinges"]:
        """What each hinge bears, in its energy's own coordinates; N m, N, N."""
        return jnp.stack(self._local(hinge.tension, displacements))

    def tangent(
        self,
        displacements: Poses,
        rows: tuple[int, ...],
        columns: tuple[int, ...],
        borne: Float[Array, "3 hinges"] | None = None,
    ) -> tuple[Float[Array, " coordinates"], Float[Array, "rows columns"], Scalar]:
        """The forces, and their derivatives among some coordinates.

        Args:
            displacements: of each body from rest; rad, m, m.
            rows: coordinates whose forces are differentiated: three a body, in order.
            columns: coordinates by which they are.
            borne: the `tension` with which hinges stiffen as they turn, by default
                that which they have.

        Returns:
            The forces on all coordinates; the derivatives; and a measure of the energy
            at work in the hinges, never negative; J.
        """
        local, pairs, work = self._local(hinge.tangent, displacements, borne)
        forces = jnp.zeros(displacements.size).at[self._coordinates()]
        forces = forces.add(jnp.stack(local))
        entries = jnp.stack([jnp.stack(line) for line in pairs]).reshape(-1)
        source, target = _places(self.ends, self._order(), rows, columns)
        size = (len(rows), len(columns))
        matrix = jnp.zeros(size[0] * size[1]).at[target].add(entries[source])
        return forces, matrix.reshape(size), jnp.sum(work)

    def _order(self) -> tuple[int, ...]:
        return tuple(member for stack in self.stacks for member in stack.members)

    def _coordinates(self) -> np.ndarray:
        return _coordinates(self.ends, self._order())

    def _local(self, function, displacements: Poses, *more: Array | None):
        """A function of each hinge: trees of scalars, a row for each in `_order`."""
        parts, done = [], 0
        for stack in self.stacks:
            end = done + len(stack.members)
            mine = [tuple(each[:, done:end]) for each in more if each is not None]
            parts.append(self._map(function, stack, displacements, *mine))
            done = end
        if len(parts) == 1:
            return parts[0]
        return jax.tree.map(lambda *values: jnp.concatenate(values), *parts)

    def _map(self, function, stack: Stack, displacements: Poses, *more):
        members = np.array(stack.members)
        first, second = np.array(self.ends)[members].T
        angle, x, y = displacements.T
        cos, sin = jnp.cos(angle / 2), jnp.sin(angle / 2)
        arms, axes = self.arms[members], self.axes[members]

        def end(body: np.ndarray, arm: Array) -> End:
            moved = (values[body] for values in (angle, x, y, cos, sin))
            return End(*moved, arm_x=arm[:, 0], arm_y=arm[:, 1])

        leaves, tree = jax.tree.flatten(stack.energy)

        def one(leaves, *hinge):
            return function(jax.tree.unflatten(tree, leaves), *hinge)

        return jax.vmap(one, in_axes=(list(stack.axes), *(3 + len(more)) * (0,)))(
            leaves,
            end(first, arms[:, 0]),
            end(second, arms[:, 1]),
            (axes[:, 0], axes[:, 1]),
            *more,
        )


def stack_energies(energies: Sequence[AbstractEnergy]) -> tuple[Stack, ...]:
    """Sorts energies by their kind, and stacks the like of them."""
    kinds: dict[Any, list[int]] = {}
    for place, energy in enumerate(energies):
        leaves, tree = jax.tree.flatten(energy)
        kind = (tree, tuple((np.shape(leaf), jnp.result_type(leaf)) for leaf in leaves))
        kinds.setdefault(kind, []).append(place)
    stacks = []
    for (tree, _), members in kinds.items():
        rows = zip(*(jax.tree.leaves(energies[place]) for place in members), strict=True)
        leaves, axes = [], []
        for row in rows:
            shared = all(leaf is row[0] for leaf in row)
            axes.append(None if shared else 0)
            leaves.append(row[0] if shared else _stacked(row))
        energy = jax.tree.unflatten(tree, leaves)
        stacks.append(Stack(tuple(members), energy, tuple(axes)))
    return tuple(stacks)


def _stacked(row: Sequence[Array]) -> Array:
    # a thousand traced rows would be a thousand operations to compile
    values = all_known(row)
    return jnp.stack(row) if values is None else jnp.asarray(np.stack(values))


@lru_cache(maxsize=256)
def _coordinates(ends: tuple[tuple[int, int], ...], order: tuple[int, ...]) -> np.ndarray:
    """The six coordinates of each hinge's two bodies, a column for each hinge."""
    bodies = np.array(ends).reshape(-1, 2)[list(order)]
    return (3 * bodies[:, :, None] + np.arange(3)).reshape(-1, 6).T


@lru_cache(maxsize=256)
def _places(
    ends: tuple[tuple[int, int], ...],
    order: tuple[int, ...],
    rows: tuple[int, ...],
    columns: tuple[int, ...],
) -> tuple[np.ndarray, np.ndarray]:
    """Which entries of all hinges' matrices go where in the matrix of a mechanism."""
    coordinates = _coordinates(ends, order)
    size = 1 + max(coordinates.max(initial=0), *rows, *columns, 0)
    row_of, column_of = np.full(size, -1), np.full(size, -1)
    row_of[list(rows)] = np.arange(len(rows))
    column_of[list(columns)] = np.arange(len(columns))
    row = np.broadcast_to(row_of[coordinates][:, None], (6, *coordinates.shape))
    column = np.broadcast_to(column_of[coordinates][None], (6, *coordinates.shape))
    source = np.flatnonzero((row >= 0) & (column >= 0))
    target = row.reshape(-1)[source] * len(columns) + column.reshape(-1)[source]
    return source, target
