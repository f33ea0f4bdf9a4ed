"""All hinges of a mechanism together: what they store, and how they pull."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._utils.types import Poses, Scalar, Wrenches
from ..energies.base import AbstractEnergy
from ..energies.damping import ViscousDamping
from ..geometry.twistors import Displacement
from . import hinge_forces
from .hinge_groups import HingeGroup
from .hinge_kinematics import End, mid_frame
from .scatter import coordinates_of, places_of_lines, places_of_pairs, summed


class Tangent(NamedTuple):
    """How the forces of all hinges follow the free coordinates; see `pull.Tangent`.

    Args:
        stiffness: by displacements, the stretches following them; N m/rad, N/m.
        damping: by their rates; N m s/rad, N s/m.
        stretching: of the stretches, by displacements.
        bearing: of the forces, by the stretches.
    """

    stiffness: Float[Array, "free free"]
    damping: Float[Array, "free free"]
    stretching: Float[Array, "free stretches"]
    bearing: Float[Array, "free stretches"]


class HingeAssembly(eqx.Module):
    """The hinges of a mechanism, as functions of how far its bodies have moved.

    Args:
        bodies: how many there are.
        ends: the two bodies of each hinge, by their places.
        arms: from each body's origin to the hinge at rest, in world axes; m.
        axes: cosine and sine of each hinge's angle at rest.
        stacks: the energies, the like of them together.
        sums: for each hinge whose energy is a sum that energy and its damping, as they
            were given.
    """

    bodies: int = eqx.field(static=True)
    ends: tuple[tuple[int, int], ...] = eqx.field(static=True)
    arms: Float[Array, "hinges 2 2"]
    axes: Float[Array, "hinges 2"]
    groups: tuple[HingeGroup, ...]
    sums: tuple[tuple[AbstractEnergy, ViscousDamping | Scalar | None] | None, ...]

    def lever(self, free: tuple[int, ...]) -> Scalar:
        """Root mean square of the distances from origins of bodies to their hinges; m.

        Args:
            free: the free coordinates. Of bodies that cannot move the origin may be
                anywhere.
        """
        moving = np.isin(np.array(self.ends), np.array(free, int) // 3)
        arms = jax.lax.stop_gradient(self.arms)[moving]
        return jnp.sqrt(jnp.sum(arms**2) / max(1, len(arms)))

    def energy_of(self, row: int) -> AbstractEnergy:
        """The energy of one hinge, by its place in the mechanism's list."""
        return self.energy_and_damping_of(row)[0]

    def energy_and_damping_of(
        self, row: int
    ) -> tuple[AbstractEnergy, ViscousDamping | Scalar | None]:
        """The energy of one hinge and what it dissipates, if anything.

        The damping of a sum is as it was given: a time, if it is one; s.
        """
        if (given := self.sums[row]) is not None:
            return given
        stack = next(stack for stack in self.groups if row in stack.members)
        place = stack.members.index(row)
        leaves, tree = jax.tree.flatten((stack.energy, stack.damping))
        own = [
            leaf if axis is None else leaf[place]
            for leaf, axis in zip(leaves, stack.axes, strict=True)
        ]
        return jax.tree.unflatten(tree, own)

    def displacement_of(self, row: int, displacements: Poses) -> Displacement:
        """How far one hinge is displaced, without loss of digits.

        Args:
            row: its place in the mechanism's list.
            displacements: of each body from rest; rad, m, m.
        """
        angle, x, y = displacements.T
        cos, sin = jnp.cos(angle / 2), jnp.sin(angle / 2)
        first, second = (
            End(*(values[body] for values in (angle, x, y, cos, sin)), *arm)
            for body, arm in zip(self.ends[row], self.arms[row], strict=True)
        )
        return mid_frame(
            first, second, (self.axes[row, 0], self.axes[row, 1])
        ).displacement

    def energy(self, displacements: Poses) -> Scalar:
        """What all hinges store; J."""

        def stored_energy(energy, damping, first, second, axis):
            del damping
            return energy.stored_energy(mid_frame(first, second, axis).displacement)

        return sum(
            (
                jnp.sum(self._map(stored_energy, stack, displacements))
                for stack in self.groups
            ),
            start=jnp.zeros(()),
        )

    def forces(self, displacements: Poses) -> Wrenches:
        """Derivative of the energy by each body's displacement; N m/rad, N, N."""
        local = self._local(_elastic(hinge_forces.forces), displacements)
        return self._gathered(local).reshape(displacements.shape)

    def tension(
        self, displacements: Poses, borne: Float[Array, "3 hinges"] | None = None
    ) -> Float[Array, "3 hinges"]:
        """What each hinge bears, in its energy's own coordinates; N m, N, N.

        `borne` is that which was foreseen, as for the `tangent`.
        """
        more = () if borne is None else (tuple(borne),)
        return jnp.stack(
            self._local(_elastic(hinge_forces.tension), displacements, *more)
        )

    def out_of_range(self, displacements: Poses) -> Bool[Array, " hinges"]:
        """Whether each hinge is displaced beyond the range of its energy."""

        def out_of_range(energy, damping, first, second, axis):
            del damping
            return energy.out_of_range(mid_frame(first, second, axis).displacement)

        answer = jnp.zeros(len(self.ends), bool)
        for stack in self.groups:
            mine = self._map(out_of_range, stack, displacements)
            if mine is not None:
                answer = answer.at[np.array(stack.members)].max(mine)
        return answer

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
        forces, pairs, work = self.pairs(displacements, borne)
        return forces, self._assembled(pairs, rows, columns), work

    def pairs(
        self, displacements: Poses, borne: Float[Array, "3 hinges"] | None = None
    ) -> tuple[Float[Array, " coordinates"], Float[Array, "6 6 hinges"], Scalar]:
        """The forces, and each hinge's derivatives among the coordinates of its bodies.

        Args:
            displacements: of each body from rest; rad, m, m.
            borne: as for the `tangent`.

        Returns:
            The forces on all coordinates; the derivatives, in the order of the stacks;
            and a measure of the energy at work in the hinges, never negative; J.
        """
        more = () if borne is None else (tuple(borne),)
        local, pairs, work = self._local(
            _elastic(hinge_forces.tangent), displacements, *more
        )
        matrix = jnp.stack([jnp.stack(line) for line in pairs])
        return self._gathered(local), matrix, jnp.sum(work)

    def applied(
        self,
        pairs: Float[Array, "6 6 hinges"],
        vector: Float[Array, " coordinates"],
    ) -> Float[Array, " coordinates"]:
        """The product of the stiffness of all hinges, as `pairs`, with a displacement."""
        own = vector[self._coordinates()]
        return self._gathered(jnp.sum(pairs * own[None], axis=1))

    def pair_coordinates(self) -> Int[np.ndarray, "2 entries"]:
        """The row and the column of each entry of `pairs`, flattened."""
        own = self._coordinates()
        return np.stack(
            [
                np.broadcast_to(own[:, None], (6, *own.shape)).reshape(-1),
                np.broadcast_to(own[None], (6, *own.shape)).reshape(-1),
            ]
        )

    def factored(
        self, displacements: Poses, free: tuple[int, ...]
    ) -> tuple[
        Float[Array, "rows free"], Float[Array, " rows"], Float[Array, "free free"]
    ]:
        """The stiffness of the `tangent` among some coordinates, in factors.

        Args:
            displacements: of each body from rest; rad, m, m.
            free: the coordinates, three a body, in order.

        Returns:
            Three rows for each term of each hinge; the stiffness against each row; and
            what the forces that the hinges bear add as they turn. The stiffness is
            `rows.T diag(stiffness) rows`, and that.
        """
        local = self._local(_elastic(hinge_forces.factored), displacements)
        source, target = places_of_lines(self.ends, self._order(), free, 3)
        size = (len(free), 3 * len(self._order()))
        entries = jnp.moveaxis(local.rows, 0, -1).reshape(-1)
        rows = summed(entries, source, target, size[0] * size[1]).reshape(size).T
        reference = self._assembled(jnp.moveaxis(local.reference, 0, -1), free, free)
        return rows, local.weights.reshape(-1), reference

    def forces_in_motion(
        self,
        displacements: Poses,
        rates: Poses,
        stretches: Float[Array, "hinges 2"] | None = None,
    ) -> tuple[Wrenches, Float[Array, "hinges 2"], Scalar]:
        """What resists the motion of each body, and the power that is dissipated.

        Args:
            displacements: of each body from rest; rad, m, m.
            rates: of the displacements; rad/s, m/s, m/s.
            stretches: the half-way translations that the hinges are taken to bear, by
                default their own; m. In the order of the `stacks`.

        Returns:
            Elastic and viscous forces together; N m/rad, N, N; how much the hinges' own
            translations exceed the stretches; m; and the power; W.
        """
        more = self._moving(rates, stretches)
        local, excess, power = self._local(
            hinge_forces.forces_in_motion, displacements, *more
        )
        forces = self._gathered(local).reshape(displacements.shape)
        return forces, jnp.stack(excess, axis=1), jnp.sum(power)

    def tangent_in_motion(
        self,
        displacements: Poses,
        rates: Poses,
        free: tuple[int, ...],
        stretches: Float[Array, "hinges 2"] | None = None,
    ) -> Tangent:
        """Derivatives of `forces_in_motion` among some coordinates.

        Args:
            displacements: of each body from rest; rad, m, m.
            rates: of the displacements; rad/s, m/s, m/s.
            free: the coordinates whose forces are differentiated, and by which.
            stretches: as for the forces.
        """
        more = self._moving(rates, stretches)
        local = self._local(hinge_forces.tangent_in_motion, displacements, *more)
        source, target = places_of_lines(self.ends, self._order(), free)
        size = (len(free), 2 * len(self._order()))

        def lined(lines) -> Float[Array, "free stretches"]:
            entries = jnp.moveaxis(lines, 0, -1).reshape(-1)
            return summed(entries, source, target, size[0] * size[1]).reshape(size)

        def assembled(pairs) -> Float[Array, "free free"]:
            return self._assembled(jnp.moveaxis(pairs, 0, -1), free, free)

        return Tangent(
            stiffness=assembled(local.stiffness),
            damping=assembled(local.damping),
            stretching=lined(local.stretching),
            bearing=lined(local.bearing),
        )

    def stretches(self, displacements: Poses) -> Float[Array, "hinges 2"]:
        """The translation of each hinge seen half way, in the order of the stacks; m."""

        def stretch(energy, damping, *hinge):
            del energy, damping
            at = mid_frame(*hinge).displacement
            return 2 * at.x1, 2 * at.x2

        return jnp.stack(self._local(stretch, displacements), axis=1)

    def _moving(self, rates: Poses, stretches: Array | None):
        both = self._of(rates)
        return (both,) if stretches is None else (both, tuple(stretches.T))

    def _of(self, rates: Poses):
        """The rates of both bodies of each hinge, in `_order`."""
        ends = np.array(self.ends).reshape(-1, 2)[list(self._order())]
        return tuple(tuple(rates[body].T) for body in ends.T)

    def _gathered(self, local) -> Float[Array, " coordinates"]:
        target = self._coordinates().reshape(-1)
        entries = jnp.stack([*local]).reshape(-1)
        return summed(entries, np.arange(target.size), target, 3 * self.bodies)

    def _assembled(
        self, pairs: Array, rows: tuple[int, ...], columns: tuple[int, ...]
    ) -> Float[Array, "rows columns"]:
        entries = pairs.reshape(-1)
        source, target = places_of_pairs(self.ends, self._order(), rows, columns)
        size = (len(rows), len(columns))
        return summed(entries, source, target, size[0] * size[1]).reshape(size)

    def _order(self) -> tuple[int, ...]:
        return tuple(member for stack in self.groups for member in stack.members)

    def _coordinates(self) -> np.ndarray:
        return coordinates_of(self.ends, self._order())

    def _local(self, function, displacements: Poses, *more):
        """A function of each hinge: trees of scalars, a row for each in `_order`."""
        parts, done = [], 0
        for stack in self.groups:
            end = done + len(stack.members)
            mine = jax.tree.map(lambda row, done=done, end=end: row[done:end], more)
            parts.append(self._map(function, stack, displacements, *mine))
            done = end
        if len(parts) == 1:
            return parts[0]
        return jax.tree.map(lambda *values: jnp.concatenate(values), *parts)

    def _map(self, function, stack: HingeGroup, displacements: Poses, *more):
        members = np.array(stack.members)
        first, second = np.array(self.ends)[members].T
        angle, x, y = displacements.T
        cos, sin = jnp.cos(angle / 2), jnp.sin(angle / 2)
        arms, axes = self.arms[members], self.axes[members]

        def end(body: np.ndarray, arm: Array) -> End:
            moved = (values[body] for values in (angle, x, y, cos, sin))
            return End(*moved, arm_x=arm[:, 0], arm_y=arm[:, 1])

        leaves, tree = jax.tree.flatten((stack.energy, stack.damping))

        def one(leaves, *hinge):
            return function(*jax.tree.unflatten(tree, leaves), *hinge)

        return jax.vmap(one, in_axes=(list(stack.axes), *(3 + len(more)) * (0,)))(
            leaves,
            end(first, arms[:, 0]),
            end(second, arms[:, 1]),
            (axes[:, 0], axes[:, 1]),
            *more,
        )


def _elastic(function):
    """A function of energies alone, where dampings are handed over as well."""
    return lambda energy, _, *hinge: function(energy, *hinge)
