"""All hinges of a mechanism: their energy, forces, and stiffness."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._compile.batching import map_rows
from .._utils.host import as_float, on_host
from .._utils.stacking import PerPart
from .._utils.types import Poses, Scalar, Wrenches
from ..energies.base import AbstractEnergy, out_of_range, range_share
from ..energies.contact import is_contact
from ..energies.natural_curvature import NaturallyCurved
from ..geometry.twistors import Displacement
from ..linalg.block_factors import Layout
from ..linalg.sums import gather_entries, sum_entries
from . import forces as hinge_forces, motion_forces
from .factored import FactoredStiffness
from .groups import DampedEnergy, HingeGroup
from .kinematics import Axis, End, mid_frame, Misfit, misfit_numbers
from .scatter import hinge_dofs, sum_matrices
from .tangent import AssemblyMotionTangent, AssemblyTangent


class HingeAssembly(eqx.Module):
    """The hinges of a mechanism, as functions of the displacements of its bodies.

    Displacements are those from the reference poses; rad, m, m. Hinges are evaluated in
    the order of the members of the groups. Degrees of freedom are numbered by bodies,
    three for each: angle, x, y.
    """

    bodies: int = eqx.field(static=True)
    # Indices of the two bodies of each hinge
    ends: tuple[tuple[int, int], ...] = eqx.field(static=True)
    # Vector from the origin of each of the two bodies to the hinge, in the reference
    # configuration and world axes; m
    arms: Float[Array, "hinges 2 2"]
    # Cosine and sine of the angle of each hinge in the reference configuration
    directions: Float[Array, "hinges 2"]
    # The six numbers of each hinge from which its `Misfit` is created; None if there are
    # none; rad, m, m, m, m, rad
    misfits: Float[Array, "hinges 6"] | None
    groups: tuple[HingeGroup, ...]  # Groups of hinges with the same kind of energy
    # Energy and damping of each hinge whose energy is a sum; None for others
    sums: PerPart
    # Time derivatives of the misfits; None if they are constant
    misfit_rates: Float[Array, "hinges 6"] | None = None

    def characteristic_length(self, free: tuple[int, ...]) -> Scalar | np.float64:
        """Compute the root mean square distance from origins of bodies to hinges; m.

        Bodies without `free` degrees of freedom do not count, because their origins are
        arbitrary.
        """
        moving = np.isin(np.array(self.ends), np.array(free, int) // 3)
        xp, (arms,) = on_host(jax.lax.stop_gradient(self.arms))
        arms = arms[moving]
        return xp.sqrt(xp.sum(arms**2) / max(1, len(arms)))

    def energy_of(self, row: int) -> AbstractEnergy:
        """Return the energy of one hinge, by its index."""
        return self.energy_and_damping_of(row)[0]

    def energy_and_damping_of(self, row: int) -> DampedEnergy:
        """Return the energy of one hinge and its damping, by its index.

        The damping of a sum is returned as it was given, perhaps as a time; s.
        """
        if (given := self.sums[row]) is not None:
            return given
        group = next(group for group in self.groups if row in group.members)
        return group.of_member(group.members.index(row))

    def bent_energy_of(self, row: int) -> AbstractEnergy:
        """Return the energy of one hinge with its natural curvature, by its index."""
        energy = self.energy_of(row)
        loads = [
            group.curvature_loads[member]
            for group in self.groups
            if group.curvature_loads is not None
            for member, hinge in enumerate(group.members)
            if hinge == row
        ]
        if not loads or self.misfits is None:
            return energy
        total = sum(loads, start=jnp.zeros(4))
        return NaturallyCurved(energy, Misfit.of(self.misfits[row]).turn, total)

    def with_strokes(
        self,
        strokes: Float[Array, "hinges 3"],
        rates: Float[Array, "hinges 3"] | None = None,
    ) -> "HingeAssembly":
        """Add strokes to the misfits, and their time derivatives; rad, m, m, 1/s."""
        if rates is None:
            return self.with_more_misfit(misfit_numbers(strokes))
        numbers = jax.jvp(misfit_numbers, (strokes,), (rates,))
        return self.with_more_misfit(*numbers)

    @property
    def member_count(self) -> int:
        """Number of hinges, of which one with a sum of energies counts for each term."""
        return len(self._order())

    @property
    def contacts(self) -> Int[np.ndarray, " contacts"]:
        """Indices of the members that are contacts."""
        flags = [len(group.members) * [is_contact(group.energy)] for group in self.groups]
        return np.flatnonzero(np.concatenate([np.zeros(0, bool), *flags]))

    def with_more_misfit(
        self, numbers: Float[Array, "hinges 6"], rates: Array | None = None
    ) -> "HingeAssembly":
        """Add to the six numbers of the misfits, and set their time derivatives."""
        if self.misfits is not None:
            _, (old, added) = on_host(self.misfits, numbers)
            numbers = as_float(old + added)
        return replace(self, misfits=numbers, misfit_rates=rates)

    def displacement_of(
        self, row: int, displacements: Poses, of_frames: bool = False
    ) -> Displacement:
        """Compute the displacement of one hinge, by its index.

        It is measured from the state in which the hinge is not loaded, or that of frame b
        relative to frame a (`of_frames`), which is the same without a misfit.
        """
        angle, x, y = displacements.T
        cos, sin = jnp.cos(angle / 2), jnp.sin(angle / 2)
        first, second = (
            End(*(values[body] for values in (angle, x, y, cos, sin)), *arm)
            for body, arm in zip(self.ends[row], self.arms[row], strict=True)
        )
        misfit = None
        if self.misfits is not None and not of_frames:
            misfit = Misfit.of(self.misfits[row])
        axis = Axis(self.directions[row, 0], self.directions[row, 1], misfit)
        return mid_frame(first, second, axis).displacement

    def energy(self, displacements: Poses) -> Scalar:
        """Compute the energy that is stored in all hinges; J."""
        return jnp.sum(self.energies(displacements))

    def energies(self, displacements: Poses) -> Float[Array, " hinges"]:
        """Compute the energy that is stored in each hinge; J."""

        def stored_energy(energy, first, second, axis):
            return energy.stored_energy(mid_frame(first, second, axis).displacement)

        energies = jnp.zeros(len(self.ends))
        for group in self.groups:
            of_members = self.map_members(stored_energy, group, displacements)
            energies = energies.at[np.array(group.members)].add(of_members)
        return energies

    def forces(self, displacements: Poses) -> Wrenches:
        """Differentiate the energy with respect to the displacements; N m, N, N."""
        return self.energy_and_forces(displacements)[1]

    def energy_and_forces(self, displacements: Poses) -> tuple[Scalar, Wrenches]:
        """Compute the energy of all hinges (J), and the `forces`; N m, N, N."""
        energies, local = self._evaluate(hinge_forces.energy_and_forces, displacements)
        forces = self._gather(local).reshape(displacements.shape)
        return jnp.sum(energies), forces

    def forces_and_stress(
        self, displacements: Poses
    ) -> tuple[Wrenches, Float[Array, "3 members"]]:
        """Compute the `forces`, and the generalized stress of each hinge; N m, N, N."""
        local, stress = self._evaluate(hinge_forces.forces_and_stress, displacements)
        return self._gather(local).reshape(displacements.shape), jnp.stack(stress)

    def out_of_range(self, displacements: Poses) -> Bool[Array, " hinges"]:
        """Decide whether each hinge is outside the validity range of its energy."""
        outside = self._of_energies(out_of_range, displacements, bool)
        return jnp.zeros(len(self.ends), bool) if outside is None else outside

    def range_shares(self, displacements: Poses) -> Float[Array, " hinges"] | None:
        """Compute the share of each displacement in the range of a simple flexure.

        It is zero for hinges without such a share; None if there is no other hinge.
        """
        displacements = jax.lax.stop_gradient(displacements)
        return self._of_energies(range_share, displacements, float)

    def _of_energies(self, function, displacements: Poses, dtype: type) -> Array | None:
        """Evaluate a function of an energy and its displacement for all hinges.

        It may return None, for which the result is zero, or None for all hinges.
        """

        def of_hinge(energy, first, second, axis):
            return function(energy, mid_frame(first, second, axis).displacement)

        values = None
        for group in self.groups:
            of_members = self.map_members(of_hinge, group, displacements)
            if of_members is not None:
                values = jnp.zeros(len(self.ends), dtype) if values is None else values
                values = values.at[np.array(group.members)].max(of_members)
        return values

    def tangent(
        self, displacements: Poses, predicted: Float[Array, "3 members"] | None = None
    ) -> AssemblyTangent:
        """Compute the forces, their derivatives, and the generalized stress.

        A stress that Newton's method has `predicted` replaces that at these displacements
        (N m, N, N), as in the `tangent` of a hinge.
        """
        per_member = () if predicted is None else (tuple(predicted),)
        local = self._evaluate(hinge_forces.tangent, displacements, *per_member)
        return AssemblyTangent(local, self.bodies, self.ends, self._order())

    def multiply_stiffness(
        self, stiffness: Float[Array, "6 6 members"], vector: Float[Array, " dofs"]
    ) -> Float[Array, " dofs"]:
        """Multiply an assembled stiffness and a vector of displacements; rad, m, m."""
        of_hinges = vector[self._dofs()]
        return self._gather(jnp.sum(stiffness * of_hinges[None], axis=1))

    def factored(
        self,
        displacements: Poses,
        of_loads: Float[Array, " free"],
        free: tuple[int, ...],
    ) -> FactoredStiffness:
        """Compute the stiffness of hinges and loads in factors."""
        each = self._evaluate(hinge_forces.factored, displacements)
        return FactoredStiffness(each, of_loads, self.ends, self._order(), free)

    def rows_and_stiffness(
        self, displacements: Poses
    ) -> tuple[Float[Array, "hinges 3 dofs"], Float[Array, "hinges 3 3"]]:
        """Compute the derivatives of the coordinates of each hinge, and its stiffness.

        The coordinates are the rotation and the mid-frame translation; rad, m, m.
        """
        local, stiffness = self._evaluate(hinge_forces.rows_and_stiffness, displacements)
        order, hinges = np.array(self._order()), len(self.ends)
        rows = jnp.zeros((hinges, 3, 3 * self.bodies))
        # The terms of a sum have the same coordinates.
        index = order[:, None, None], np.arange(3)[:, None], self._dofs().T[:, None]
        rows = rows.at[index].set(local)
        return rows, jnp.zeros((hinges, 3, 3)).at[order].add(stiffness)

    def forces_in_motion(
        self,
        displacements: Poses,
        rates: Poses,
        translations: Float[Array, "members 2"] | None = None,
    ) -> tuple[Wrenches, Float[Array, "members 2"], tuple[Scalar, Scalar]]:
        """Compute elastic and viscous forces on each body, and two powers.

        Args:
            translations: Mid-frame translations for which the forces are computed, in the
                order of the members; by default those of the displacements; m.

        Returns:
            The forces; N m, N, N. The mid-frame translations of the displacements minus
            the translations; m. The power that is dissipated, and that of strokes; W.
        """
        per_member = self._motion_arguments(rates, translations)
        local, excess, (dissipated, by_strokes) = self._evaluate(
            motion_forces.forces_in_motion, displacements, *per_member, damped=True
        )
        forces = self._gather(local).reshape(displacements.shape)
        powers = jnp.sum(dissipated), jnp.sum(by_strokes)
        return forces, jnp.stack(excess, axis=1), powers

    def tangent_in_motion(
        self,
        displacements: Poses,
        rates: Poses,
        free: tuple[int, ...],
        translations: Float[Array, "members 2"] | None = None,
        layout: Layout | None = None,
    ) -> AssemblyMotionTangent:
        """Compute the derivatives of `forces_in_motion` among some degrees of freedom."""
        per_member = self._motion_arguments(rates, translations)
        local = self._evaluate(
            motion_forces.tangent_in_motion, displacements, *per_member, damped=True
        )
        return AssemblyMotionTangent.of(local, self.ends, self._order(), free, layout)

    def translations(self, displacements: Poses) -> Float[Array, "members 2"]:
        """Compute the mid-frame translation of each member; m."""

        def coordinates(_, *hinge):
            return hinge_forces.hinge_coordinates(mid_frame(*hinge).displacement)

        _, *translations = self._evaluate(coordinates, displacements)
        return jnp.stack(translations, axis=1)

    def _motion_arguments(self, rates: Poses, translations: Array | None):
        """Arrange the rates of both bodies of each member, and the translations."""
        ends = np.array(self.ends).reshape(-1, 2)[list(self._order())]
        both = tuple(tuple(rates[body].T) for body in ends.T)
        return (both,) if translations is None else (both, tuple(translations.T))

    def _gather(self, forces) -> Float[Array, " dofs"]:
        """Sum the forces of all members on each degree of freedom; N m, N."""
        target = self._dofs().reshape(-1)
        entries = jnp.stack([*forces]).reshape(-1)
        return sum_entries(entries, np.arange(target.size), target, 3 * self.bodies)

    def assemble(
        self,
        matrices: Float[Array, "6 6 members"],
        dofs: tuple[int, ...],
        layout: Layout | None = None,
    ) -> Float[Array, "*matrix"]:
        """Sum the matrices of all members; see `sum_matrices`."""
        return sum_matrices(matrices, self.ends, self._order(), dofs, layout)

    def _order(self) -> tuple[int, ...]:
        """Return the index of the hinge of each member."""
        return tuple(member for group in self.groups for member in group.members)

    def _dofs(self) -> Int[np.ndarray, "6 members"]:
        """Return the six degrees of freedom of each member."""
        return hinge_dofs(self.ends, self._order())

    def _evaluate(self, function, displacements: Poses, *per_member, damped=False):
        """Evaluate a function of one hinge for all members.

        The arguments of the function are those of `map_members`; the arrays in
        `per_member` have a row for each member of all groups.
        """
        parts, start = [], 0
        for group in self.groups:
            rows = slice(start, start + len(group.members))
            of_group = jax.tree.map(lambda values, rows=rows: values[rows], per_member)
            parts.append(
                self.map_members(function, group, displacements, *of_group, damped=damped)
            )
            start = rows.stop
        if len(parts) == 1:
            return parts[0]
        return jax.tree.map(lambda *values: jnp.concatenate(values), *parts)

    def map_members(
        self,
        function,
        group: HingeGroup,
        displacements: Poses,
        *per_member,
        damped: bool = False,
    ):
        """Evaluate a function of one hinge for all members of a group.

        The arguments of the function are energy, damping (if the hinges are `damped`),
        both ends, axis, and `per_member`, which has a row for each member.
        """
        members = np.array(group.members)
        first, second = np.array(self.ends)[members].T
        angle, x, y = displacements.T
        cos, sin = jnp.cos(angle / 2), jnp.sin(angle / 2)
        arms, directions = self.arms[members], self.directions[members]
        numbers, rates = self.misfits, self.misfit_rates
        numbers = None if numbers is None else numbers[members]
        rates = None if rates is None else rates[members]

        def end(body: np.ndarray, arm: Array) -> End:
            of_body = (gather_entries(values, body) for values in (angle, x, y, cos, sin))
            return End(*of_body, arm_x=arm[:, 0], arm_y=arm[:, 1])

        leaves, tree = jax.tree.flatten((group.energy, group.damping))

        def one_hinge(leaves, loads, first, second, axis, *per_member):
            energy, damping = jax.tree.unflatten(tree, leaves)
            if loads is not None:
                energy = NaturallyCurved(energy, axis.misfit.turn, loads)
            of_hinge = (energy, damping) if damped else (energy,)
            return function(*of_hinge, first, second, axis, *per_member)

        others = (
            group.curvature_loads,
            end(first, arms[:, 0]),
            end(second, arms[:, 1]),
            Axis(directions[:, 0], directions[:, 1], *Misfit.with_rate(numbers, rates)),
            *per_member,
        )
        return map_rows(one_hinge, leaves, group.batch_axes, *others)
