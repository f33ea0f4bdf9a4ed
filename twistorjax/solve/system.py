"""The equations of a mechanism: residual, tangent stiffness, loads, and constraints.

Statics, linearization, vibrations, frequency response, and motion assemble their
equations here. The unknowns are the displacements of the free degrees of freedom and the
constraint forces.
"""

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import lineax as lx
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import Entries, Poses, Scalar, Wrenches
from ..mechanism.constraints import AbstractConstraint, ConstraintSet, gather_constraints
from ..mechanism.hinge_assembly import HingeAssembly
from ..mechanism.loads import Load, loaded_bodies, LoadSet
from ..mechanism.mechanism import Mechanism
from .block_factorization import block_layout
from .dofs import DofPartition
from .factorization import ConstrainedFactors, Factors
from .tangents import (
    add_load_stiffness,
    BlockTangent,
    ConstrainedTangent,
    DenseTangent,
    Tangent,
)


class System(eqx.Module):
    """The equations of equilibrium of a mechanism at one instant.

    Args:
        hinges: The hinges.
        loads: The loads at their full magnitude.
        constraints: The constraints.
        targets: Displacements of the prescribed degrees of freedom; rad, m.
        time: Time at which the constraints are evaluated; s.
        dofs: Partition of the degrees of freedom.
    """

    hinges: HingeAssembly
    loads: LoadSet
    constraints: ConstraintSet
    targets: Float[Array, " prescribed"]
    time: Scalar
    dofs: DofPartition = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        mechanism: Mechanism,
        dofs: DofPartition,
        loads: Sequence[Load] = (),
        constraints: Sequence[AbstractConstraint] = (),
    ) -> "System":
        """Assemble the equations of a mechanism whose prescribed dofs do not move."""
        loaded_bodies(mechanism, loads)
        return cls(
            mechanism.hinge_assembly,
            LoadSet.of(loads, mechanism.names, mechanism.reference),
            gather_constraints(mechanism, constraints),
            jnp.zeros(len(dofs.prescribed)),
            jnp.zeros(()),
            dofs,
        )

    @property
    def free(self) -> np.ndarray:
        """Indices of the free degrees of freedom."""
        return np.array(self.dofs.free, int)

    @property
    def prescribed(self) -> np.ndarray:
        """Indices of the prescribed degrees of freedom."""
        return np.array(self.dofs.prescribed, int)

    def units(self) -> Float[Array, "3"]:
        """Units of the displacements of a body: 1 rad, and a length of the mechanism.

        The length is the root mean square distance of the hinges from the origins of the
        bodies that move; rad, m, m.
        """
        lever = self.hinges.lever(self.dofs.free)
        lever = jnp.where(lever > 0, lever, 1.0)
        return jnp.stack([jnp.ones_like(lever), lever, lever])

    def free_units(self) -> Float[Array, " free"]:
        """Unit of the displacement of each free degree of freedom; rad, m."""
        return self.units()[self.free % 3]

    def place(
        self,
        displacements: Poses,
        free: Array | None = None,
        prescribed: Array | None = None,
    ) -> Poses:
        """Replace the free or the prescribed displacements; rad, m, m."""
        flat = displacements.reshape(-1)
        if free is not None:
            flat = flat.at[self.free].set(free)
        if prescribed is not None:
            flat = flat.at[self.prescribed].set(prescribed)
        return flat.reshape(displacements.shape)

    def violation(self, displacements: Poses) -> Entries:
        """Compute the violation of the constraints; rad or m."""
        return self.constraints.violation(displacements, self.time)

    def jacobian(self, displacements: Poses) -> Float[Array, "entries dofs"]:
        """Compute the derivatives of the violation by all degrees of freedom."""
        return self.constraints.jacobian(displacements, self.time)

    def residual(self, displacements: Poses, push: Entries) -> Float[Array, " dofs"]:
        """Compute the forces that are not in equilibrium; N m, N.

        On fixed and prescribed degrees of freedom they are the reactions.

        Args:
            displacements: Displacement of each body from its reference pose; rad, m, m.
            push: Constraint force of each entry; N m, N.
        """
        applied, _ = self.loads.apply(displacements)
        residual = (self.hinges.forces(displacements) - applied).reshape(-1)
        if not self.constraints.size:
            return residual
        return residual - self.constraints.forces(displacements, self.time, push)

    def reactions(self, displacements: Poses, push: Entries) -> Wrenches:
        """Compute the reactions on fixed and prescribed degrees of freedom; N m, N, N."""
        return self.dofs.reactions(self.residual(displacements, push))

    def constraint_forces(self, displacements: Poses) -> Entries:
        """Compute the constraint forces of an equilibrium by least squares; N m, N."""
        if not self.constraints.size:
            return jnp.zeros(0)
        residual = self.residual(displacements, jnp.zeros(self.constraints.size))
        units = self.free_units()
        scaled = self.jacobian(displacements)[:, self.free] * units[None]
        problem = lx.MatrixLinearOperator(scaled.T)
        right = units * residual[self.free]
        return lx.linear_solve(problem, right, lx.QR(), throw=False).value

    def constraint_stiffness(self, displacements: Poses) -> Float[Array, "dofs dofs"]:
        """Compute the geometric stiffness of the constraint forces of an equilibrium."""
        push = self.constraint_forces(displacements)
        return self.constraints.geometric_stiffness(displacements, self.time, push)

    def tangent(
        self,
        displacements: Poses,
        fraction: Scalar | float = 1.0,
        predicted: Float[Array, "3 hinges"] | None = None,
        push: Entries | None = None,
    ) -> tuple[Float[Array, " dofs"], Tangent, Scalar]:
        """Compute the residual under a fraction of the loads, and its derivatives.

        Args:
            displacements: Displacement of each body from its reference pose; rad, m, m.
            fraction: Fraction of the loads.
            predicted: Generalized stress of the hinges that determines their geometric
                stiffness; by default the stress at these displacements; N m, N.
            push: Constraint force of each entry, needed if there are constraints; N m, N.

        Returns:
            The residual, the tangent stiffness of the free degrees of freedom, and a
            measure of the energy at work in the hinges, which is never negative; J.
        """
        layout = block_layout(self.hinges.ends, self.dofs.free)
        if self.constraints.size or layout is None:
            columns = self.dofs.free + self.dofs.prescribed
            residual, matrix, work = self.matrix(
                displacements, columns, fraction, predicted
            )
            if not self.constraints.size:
                return residual, DenseTangent(matrix), work
            assert push is not None
            return *self._constrained(displacements, residual, matrix, push), work
        forces, pairs, work = self.hinges.pairs(displacements, predicted)
        applied, by_angle = (
            fraction * value.reshape(-1) for value in self.loads.apply(displacements)
        )
        tangent = BlockTangent(self.hinges, pairs, by_angle, self.dofs, layout)
        return forces - applied, tangent, work

    def matrix(
        self,
        displacements: Poses,
        columns: tuple[int, ...],
        fraction: Scalar | float = 1.0,
        predicted: Float[Array, "3 hinges"] | None = None,
    ) -> tuple[Float[Array, " dofs"], Float[Array, "free columns"], Scalar]:
        """Compute the residual and the tangent stiffness without constraints.

        Args:
            displacements: Displacement of each body from its reference pose; rad, m, m.
            columns: Degrees of freedom by which the free forces are differentiated.
            fraction: Fraction of the loads.
            predicted: Generalized stress of the hinges; see `tangent`.

        Returns:
            The residual, the matrix, and the work; see `tangent`.
        """
        forces, matrix, work = self.hinges.tangent(
            displacements, self.dofs.free, columns, predicted
        )
        if not self.loads.bodies:
            return forces, matrix, work
        applied, by_angle = (
            fraction * value.reshape(-1) for value in self.loads.apply(displacements)
        )
        matrix = add_load_stiffness(
            matrix, by_angle, self.loads.bodies, self.dofs.free, columns
        )
        return forces - applied, matrix, work

    def whole_stiffness(
        self, displacements: Poses
    ) -> tuple[Float[Array, "dofs dofs"], Float[Array, "entries dofs"]]:
        """Compute the tangent stiffness among all degrees of freedom.

        The constraint forces are those that hold the mechanism in equilibrium.

        Args:
            displacements: Displacement of each body from its reference pose; rad, m, m.

        Returns:
            The stiffness, with that of loads and constraint forces; N m/rad, N/rad, N/m.
            The derivatives of the constraint violations by all degrees of freedom.
        """
        count = self.dofs.total
        whole = replace(self, dofs=DofPartition(count, tuple(range(count))))
        _, matrix, _ = whole.matrix(displacements, whole.dofs.free)
        if self.constraints.size:
            matrix += self.constraint_stiffness(displacements)
        return matrix, self.jacobian(displacements)

    def factors(
        self, stiffness: Float[Array, "free free"], jacobian: Float[Array, "entries free"]
    ) -> Factors | ConstrainedFactors:
        """Factor the stiffness of the free degrees of freedom, and of the constraints."""
        symmetric = self.loads.conservative
        if not self.constraints.size:
            return Factors.of(stiffness, symmetric)
        units = self.free_units()
        return ConstrainedFactors.of(stiffness, jacobian, units, symmetric)

    def _constrained(
        self,
        displacements: Poses,
        residual: Float[Array, " dofs"],
        matrix: Float[Array, "free columns"],
        push: Entries,
    ) -> tuple[Float[Array, " dofs"], ConstrainedTangent]:
        """Add the constraint forces to the residual, and their derivatives."""
        columns = np.array(self.dofs.free + self.dofs.prescribed, int)
        jacobian = self.jacobian(displacements)
        geometric = self.constraints.geometric_stiffness(displacements, self.time, push)
        tangent = ConstrainedTangent(
            stiffness=matrix + geometric[self.free[:, None], columns],
            jacobian=jacobian[:, columns],
            units=self.free_units(),
        )
        return residual - push @ jacobian, tangent
