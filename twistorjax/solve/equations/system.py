"""The equations of a mechanism: residual, tangent stiffness, loads, and constraints.

Statics, linearization, vibrations, and frequency response assemble their equations here;
`integration.system` has the equations of motion. The unknowns are the displacements of
the free degrees of freedom and the constraint forces.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.types import Entries, Poses, Scalar, Wrenches
from ...assembly.assembly import HingeAssembly
from ...assembly.factored import FactoredStiffness
from ...assembly.tangent import AssemblyTangent
from ...linalg.block_factors import block_layout, Layout
from ...linalg.constraints import (
    AllowedDisplacements,
    BorderedFactors,
    ConstrainedFactors,
)
from ...linalg.factors import Elimination, factorize, Factors
from ...mechanism.constraints import ConstraintSet
from ...mechanism.loads import LoadSet
from .dofs import DofPartition
from .load_state import LoadState
from .tangent import (
    add_load_stiffness,
    BlockTangent,
    ConstrainedTangent,
    DenseTangent,
    Tangent,
)


class System(eqx.Module):
    """Equations of equilibrium of a mechanism at one instant."""

    hinges: HingeAssembly
    loads: LoadSet  # The loads, at their full magnitude
    constraints: ConstraintSet
    # Displacements of the prescribed degrees of freedom; rad, m
    targets: Float[Array, " prescribed"]
    time: Scalar  # Time at which the constraints are evaluated; s
    dofs: DofPartition = eqx.field(static=True)  # Partition of the degrees of freedom
    # Loads and misfits at the fraction zero of the loads. If it is None, there are no
    # loads at the fraction zero, and the misfits are always complete.
    at_start: LoadState | None = None

    @property
    def free(self) -> np.ndarray:
        """Indices of the free degrees of freedom."""
        return np.array(self.dofs.free, int)

    @property
    def layout(self) -> Layout | None:
        """Layout of the matrices of many bodies; None if the matrices are dense."""
        return None if self.constraints.size else self.constrained_layout

    @property
    def constrained_layout(self) -> Layout | None:
        """Layout of the stiffness of many bodies and of products of the constraints."""
        return block_layout(self.hinges.ends + self.constraints.pairs, self.dofs.free)

    @property
    def prescribed(self) -> np.ndarray:
        """Indices of the prescribed degrees of freedom."""
        return np.array(self.dofs.prescribed, int)

    def units(self) -> Float[Array, "3"]:
        """Return the units of displacements: 1 rad, and the characteristic length (m)."""
        length = self.hinges.characteristic_length(self.dofs.free)
        length = jnp.where(length > 0, length, 1.0)
        return jnp.stack([jnp.ones_like(length), length, length])

    def free_units(self) -> Float[Array, " free"]:
        """Return the unit of each free degree of freedom; rad, m."""
        return self.units()[self.free % 3]

    @property
    def conservative(self) -> bool:
        """Whether the loads have a potential at all fractions."""
        if self.at_start is not None and not self.at_start.loads.conservative:
            return False
        return self.loads.conservative

    @property
    def changes_misfits(self) -> bool:
        """Whether the misfits of the hinges depend on the fraction of the loads."""
        if self.at_start is None:
            return False
        return self.at_start.misfits is not None or self.hinges.misfits is not None

    def loads_at(self, fraction: Scalar | float) -> LoadSet:
        """Return the loads at a fraction."""
        loads = self.loads.scaled(fraction)
        if self.at_start is None or not self.at_start.loads.present:
            return loads
        return loads.plus(self.at_start.loads.scaled(1 - fraction))

    def hinges_at(self, fraction: Scalar | float) -> HingeAssembly:
        """Return the hinges, with misfits between those of the start and their own."""
        if self.at_start is None or not self.changes_misfits:
            return self.hinges
        first, last = (
            jnp.zeros(()) if misfits is None else jnp.asarray(misfits)
            for misfits in (self.at_start.misfits, self.hinges.misfits)
        )
        return replace(self.hinges, misfits=first + fraction * (last - first))

    def misfit_response(
        self, displacements: Poses, fraction: Scalar, increment: Scalar
    ) -> tuple[Float[Array, " unknowns"], Float[Array, "3 members"]]:
        """Compute the change of forces and stress with an increment of the misfits.

        Both are of first order, in N m and N. They are zero if the misfits are constant,
        and the forces are zero in the rows of constraints.
        """
        if not self.changes_misfits:
            unknowns = len(self.free) + self.constraints.size
            return jnp.zeros(unknowns), jnp.zeros((3, self.hinges.member_count))

        def forces_and_stress(fraction: Scalar) -> tuple[Array, Array]:
            forces, stress = self.hinges_at(fraction).forces_and_stress(displacements)
            return self.residual(forces.reshape(-1), displacements), stress

        return jax.jvp(forces_and_stress, (fraction,), (increment,))[1]

    def violation(self, displacements: Poses) -> Entries:
        """Compute the violation of the constraints; rad or m."""
        return self.constraints.violation(displacements, self.time)

    def jacobian(self, displacements: Poses) -> Float[Array, "entries dofs"]:
        """Differentiate the violation with respect to all degrees of freedom."""
        return self.constraints.jacobian(displacements, self.time)

    def residual(
        self, unbalanced: Float[Array, " dofs"], displacements: Poses
    ) -> Float[Array, " unknowns"]:
        """Join unbalanced forces on free degrees of freedom (N m, N) and violations.

        Without constraints, no empty array is joined, because with one XLA loses the type
        of LAPACK calls in large programs (jaxlib 0.10.2: "No registered implementation
        for untyped custom call").
        """
        unbalanced = unbalanced[self.free]
        if not self.constraints.size:
            return unbalanced
        return jnp.concatenate([unbalanced, self.violation(displacements)])

    def unbalanced_forces(
        self, displacements: Poses, multipliers: Entries
    ) -> Float[Array, " dofs"]:
        """Compute the forces of hinges, minus loads and constraint forces; N m, N.

        They are zero on free degrees of freedom in equilibrium. On fixed and prescribed
        ones they are the reactions.
        """
        forces = self.hinges.forces(displacements)
        return self._unbalanced(forces, displacements, multipliers)

    def unbalanced_at_start(
        self, forces: Wrenches, displacements: Poses
    ) -> Float[Array, " dofs"]:
        """Subtract the known loads at the fraction zero from the forces of the hinges.

        The result, in N m and N, is zero if the mechanism is in equilibrium there.
        """
        unbalanced = forces.reshape(-1)
        if self.at_start is None:
            return unbalanced
        if self.at_start.loads.present:
            applied, _ = self.at_start.loads.apply(displacements)
            unbalanced = unbalanced - applied.reshape(-1)
        if self.at_start.constraint_forces is None:
            return unbalanced
        multipliers = jnp.asarray(self.at_start.constraint_forces)
        return unbalanced - self.constraints.forces(displacements, self.time, multipliers)

    def reactions_and_energy(
        self, displacements: Poses, multipliers: Entries
    ) -> tuple[Wrenches, Scalar]:
        """Compute the reactions on fixed and prescribed degrees of freedom, and energy.

        The reactions are in N m, N, N; the energy that the hinges store is in J.
        """
        energy, forces = self.hinges.energy_and_forces(displacements)
        unbalanced = self._unbalanced(forces, displacements, multipliers)
        return self.dofs.reactions(unbalanced), energy

    def constraint_forces(self, displacements: Poses) -> Entries:
        """Compute the constraint forces of an equilibrium by least squares; N m, N."""
        if not self.constraints.size:
            return jnp.zeros(0)
        # Only mechanisms with constraints need this package, which takes time to load.
        import lineax as lx

        no_forces = jnp.zeros(self.constraints.size)
        unbalanced = self.unbalanced_forces(displacements, no_forces)
        units = self.free_units()
        scaled = self.jacobian(displacements)[:, self.free] * units[None]
        problem = lx.MatrixLinearOperator(scaled.T)
        right = units * unbalanced[self.free]
        return lx.linear_solve(problem, right, lx.QR(), throw=False).value

    def constraint_stiffness(self, displacements: Poses) -> Float[Array, "dofs dofs"]:
        """Compute the geometric stiffness of the constraint forces of an equilibrium."""
        multipliers = self.constraint_forces(displacements)
        return self.constraints.geometric_stiffness(displacements, self.time, multipliers)

    def tangent(
        self,
        displacements: Poses,
        fraction: Scalar | float = 1.0,
        predicted: Float[Array, "3 members"] | None = None,
        multipliers: Entries | None = None,
        misfit_fraction: Scalar | None = None,
        contact_stiffness: Float[Array, "10 contacts"] | None = None,
    ) -> tuple[Float[Array, " dofs"], Tangent, AssemblyTangent]:
        """Compute unbalanced forces at a fraction of the loads, and their derivatives.

        Args:
            predicted: Generalized stress of the hinges for Newton's method; see the
                `tangent` of a hinge; by default that at these displacements; N m, N, N.
            multipliers: Constraint forces, if there are constraints; N m, N.
            misfit_fraction: Fraction of the misfits, by default that of the loads.
            contact_stiffness: Stiffness of the contacts of another state, in the order of
                `HingeAssembly.contacts`; by default that of this one.

        Returns:
            The unbalanced forces, the tangent stiffness of the free degrees of freedom,
            and the tangent of the hinges alone.
        """
        if misfit_fraction is None:
            misfit_fraction = jnp.asarray(fraction)
        hinges = self.hinges_at(misfit_fraction)
        hinge_tangents = hinges.tangent(displacements, predicted)
        if contact_stiffness is not None:
            hinge_tangents = hinge_tangents.with_stiffness(
                hinges.contacts, contact_stiffness
            )
        layout = self.layout
        if layout is not None:
            applied, by_angle = (
                value.reshape(-1)
                for value in self.loads_at(fraction).apply(displacements)
            )
            tangent = BlockTangent(
                self.hinges,
                hinge_tangents.hinge_stiffness(),
                by_angle,
                self.dofs,
                layout,
            )
            return hinge_tangents.forces() - applied, tangent, hinge_tangents
        columns = self.dofs.free + self.dofs.prescribed
        unbalanced, matrix, jacobian = self.dense_tangent(
            hinge_tangents, displacements, columns, multipliers, fraction
        )
        if not self.constraints.size:
            return unbalanced, DenseTangent(matrix), hinge_tangents
        units, layout = self.free_units(), self.constrained_layout
        tangent = ConstrainedTangent(matrix, jacobian, units, layout)
        return unbalanced, tangent, hinge_tangents

    def factored_stiffness(self, displacements: Poses) -> FactoredStiffness:
        """Compute the stiffness without that of the constraints and follower loads."""
        _, by_angle = self.loads.apply(displacements)
        # Without follower loads, only the moments of the loads depend on the angles.
        rotations = self.free % 3 == 0
        of_loads = jnp.where(rotations, -by_angle.reshape(-1)[self.free], 0.0)
        return self.hinges.factored(displacements, of_loads, self.dofs.free)

    def dense_tangent(
        self,
        hinge_tangents: AssemblyTangent,
        displacements: Poses,
        columns: tuple[int, ...],
        multipliers: Entries | None,
        fraction: Scalar | float = 1.0,
    ) -> tuple[
        Float[Array, " dofs"],
        Float[Array, "free columns"],
        Float[Array, "entries columns"],
    ]:
        """Add a fraction of the loads, and the constraint forces, to a tangent of hinges.

        Returns:
            The unbalanced forces on all degrees of freedom, and the derivatives of those
            on the free ones and of the violations by the degrees of freedom in `columns`.
        """
        forces = hinge_tangents.forces()
        matrix = hinge_tangents.matrix(self.dofs.free, columns)
        loads = self.loads_at(fraction)
        if loads.present:
            applied, by_angle = (
                value.reshape(-1) for value in loads.apply(displacements)
            )
            forces = forces - applied
            matrix = add_load_stiffness(
                matrix, by_angle, loads.conservative, self.dofs.free, columns
            )
        if not self.constraints.size:
            return forces, matrix, jnp.zeros((0, len(columns)))
        assert multipliers is not None
        jacobian, selected = self.jacobian(displacements), np.array(columns, int)
        geometric = self.constraints.geometric_stiffness(
            displacements, self.time, multipliers
        )
        forces = forces - multipliers @ jacobian
        matrix = matrix + geometric[self.free[:, None], selected]
        return forces, matrix, jacobian[:, selected]

    def whole_stiffness(
        self, displacements: Poses
    ) -> tuple[Float[Array, "dofs dofs"], Float[Array, "entries dofs"]]:
        """Compute the tangent stiffness with respect to all degrees of freedom.

        The stiffness (N m/rad, N/rad, N/m) includes that of the loads, and that of the
        constraint forces which are in equilibrium with them. The second matrix has the
        derivatives of the constraint violations.
        """
        all_dofs = tuple(range(self.dofs.total))
        whole = replace(self, dofs=DofPartition(len(all_dofs), all_dofs))
        multipliers = self.constraint_forces(displacements)
        _, stiffness, jacobian = whole.dense_tangent(
            self.hinges.tangent(displacements), displacements, all_dofs, multipliers
        )
        return stiffness, jacobian

    def factors(
        self, stiffness: Float[Array, "free free"], jacobian: Float[Array, "entries free"]
    ) -> Factors | Elimination | ConstrainedFactors | BorderedFactors:
        """Factorize the stiffness of the free degrees of freedom, with constraints."""
        symmetric = self.loads.conservative
        if not self.constraints.size:
            return factorize(stiffness, symmetric)
        if (layout := self.constrained_layout) is not None:
            return BorderedFactors.of(stiffness, jacobian, layout, symmetric)
        allowed = self.allowed_displacements(jacobian)
        return ConstrainedFactors.of(stiffness, allowed, symmetric)

    def allowed_displacements(
        self, jacobian: Float[Array, "entries free"]
    ) -> AllowedDisplacements:
        """Return the free displacements that the constraints allow."""
        return AllowedDisplacements.of(jacobian, self.free_units())

    def _unbalanced(
        self, forces: Wrenches, displacements: Poses, multipliers: Entries
    ) -> Float[Array, " dofs"]:
        """Subtract the loads and the constraint forces from the forces of the hinges."""
        applied, _ = self.loads.apply(displacements)
        unbalanced = (forces - applied).reshape(-1)
        if not self.constraints.size:
            return unbalanced
        return unbalanced - self.constraints.forces(displacements, self.time, multipliers)
