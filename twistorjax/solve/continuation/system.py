"""Equations of an equilibrium path: those of statics with a load factor as an unknown."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.host import as_float
from ..._utils.types import Entries, Flag, Poses, Scalar
from ...assembly.stress import largest_stresses
from ...assembly.tangent import AssemblyTangent
from ...linalg.block_factors import BlockFactors, Layout
from ...linalg.factors import Factors
from ...mechanism.changes import HingeChanges
from ...mechanism.constraints import ConstraintSet
from ...mechanism.loads import LoadSet
from ...mechanism.mechanism import Mechanism
from ..equations.dofs import DofPartition
from ..equations.problem import Problem
from ..equations.system import System


class PathTangent(eqx.Module):
    """Residual of a path and its derivatives at one point."""

    # Forces on the free degrees of freedom, then violations of constraints; N m, N, rad,
    # m
    residual: Float[Array, " unknowns"]
    # Derivatives of the residual with respect to the free degrees of freedom and the
    # constraint forces
    jacobian: Float[Array, "unknowns unknowns"]
    # Derivatives of the residual with respect to the load factor
    by_factor: Float[Array, " unknowns"]
    hinges: AssemblyTangent
    # Layout of the derivatives of many bodies in blocks
    layout: Layout | None = eqx.field(static=True)

    def factors(self, symmetric: bool) -> Factors | BlockFactors:
        """Factorize the derivatives by the unknowns."""
        if self.layout is None:
            return Factors.of(self.jacobian, symmetric)
        blocks = self.layout.of_dense(self.jacobian)
        return BlockFactors.of(blocks, self.layout, symmetric)


class PathSystem(eqx.Module):
    """Equations of a mechanism whose loads are multiplied by a load factor.

    A point of a path is a vector: the displacements of the free degrees of freedom (rad,
    m), the constraint forces (N m, N), and the load factor.
    """

    mechanism: Mechanism
    loads: LoadSet  # Loads that are multiplied by the load factor
    constant_loads: LoadSet
    constraints: ConstraintSet
    # Strokes and temperatures as functions of the load factor; None if there are none
    changes: HingeChanges | None
    # Displacements at the load factor zero, of which those of the fixed and the
    # prescribed degrees of freedom are used; rad, m, m
    start: Poses
    # Change of the displacements of the prescribed degrees of freedom from the load
    # factor 0 to 1; rad, m
    targets: Float[Array, " prescribed"]
    time: Scalar  # Time at which the constraints are evaluated; s
    dofs: DofPartition = eqx.field(static=True)  # Partition of the degrees of freedom

    @property
    def unknowns(self) -> int:
        """Number of unknowns without the load factor."""
        return len(self.dofs.free) + self.constraints.size

    @property
    def symmetric(self) -> bool:
        """Whether all loads have a potential."""
        return self.loads.conservative and self.constant_loads.conservative

    def length(self) -> Scalar:
        """Return the unit of length: the rms distance of hinges from their mean; m."""
        positions = jax.lax.stop_gradient(self.mechanism.at[:, 1:])
        offsets = positions - jnp.mean(positions, axis=0)[None]
        size = jnp.sqrt(jnp.mean(jnp.sum(offsets**2, axis=1)))
        characteristic = self.at(jnp.zeros(())).units()[1]
        return jnp.maximum(size, characteristic)

    @classmethod
    def of(
        cls,
        problem: Problem,
        constant_loads: LoadSet,
        start: Poses,
        changes: HingeChanges | None = None,
    ) -> "PathSystem":
        """Multiply the loads and the displacements of a problem by a load factor."""
        return cls(
            mechanism=problem.mechanism,
            loads=problem.loads,
            constant_loads=constant_loads,
            constraints=problem.constraints,
            changes=changes,
            start=start,
            targets=jnp.array(problem.targets, float),
            time=as_float(problem.time),
            dofs=problem.dofs,
        )

    def at(self, factor: Scalar) -> System:
        """Return the equations at a load factor."""
        loads = self.constant_loads.plus(self.loads.scaled(factor))
        hinges = self.mechanism.hinge_assembly
        if self.changes is not None:
            state = self.changes.state(self.mechanism, factor)
            hinges = self.mechanism.hinges_in(state)
        begin = self.start.reshape(-1)[np.array(self.dofs.prescribed, int)]
        targets = begin + factor * self.targets
        return System(hinges, loads, self.constraints, targets, self.time, self.dofs)

    def split(self, point: Float[Array, " n"]) -> tuple[System, Poses, Entries]:
        """Return equations, displacements, and constraint forces of a point."""
        system = self.at(point[-1])
        count = len(self.dofs.free)
        displacements = system.dofs.expand(point[:count], system.targets)
        return system, displacements, point[count:-1]

    def residual(self, point: Float[Array, " n"]) -> Float[Array, " unknowns"]:
        """Compute the forces on the free degrees of freedom, and the violations."""
        system, displacements, multipliers = self.split(point)
        forces = system.unbalanced_forces(displacements, multipliers)
        return system.residual(forces, displacements)

    def tangent(
        self,
        point: Float[Array, " n"],
        predicted: Float[Array, "3 members"] | None = None,
    ) -> PathTangent:
        """Compute the residual at a point, and its derivatives.

        `predicted` is the generalized stress of the hinges for Newton's method, by
        default that at this point; N m, N, N.
        """
        system, displacements, multipliers = self.split(point)
        hinges = system.hinges.tangent(displacements, predicted)
        count = len(self.dofs.free)
        forces, matrix, jacobian = system.dense_tangent(
            hinges, displacements, self.dofs.free + self.dofs.prescribed, multipliers
        )
        applied, _ = self.loads.apply(displacements)
        by_factor = self._by_changes(point[-1], displacements) - applied.reshape(-1)
        by_factor = by_factor[system.free]
        if self.constraints.size:  # no array of size zero; see `System.residual`
            matrix = jnp.concatenate([matrix, jacobian])
            by_factor = jnp.concatenate([by_factor, jnp.zeros(self.constraints.size)])
        if self.dofs.prescribed:
            by_factor = by_factor + matrix[:, count:] @ self.targets
        matrix = matrix[:, :count]
        if self.constraints.size:
            corner = jnp.zeros((self.constraints.size, self.constraints.size))
            by_multipliers = jnp.concatenate([-matrix[count:].T, corner])
            matrix = jnp.concatenate([matrix, by_multipliers], axis=1)
        return PathTangent(
            residual=system.residual(forces, displacements),
            jacobian=matrix,
            by_factor=by_factor,
            hinges=hinges,
            layout=system.layout,
        )

    def _by_changes(self, factor: Scalar, displacements: Poses) -> Float[Array, " dofs"]:
        """Differentiate the forces of the hinges by strokes and temperatures; N m, N."""
        changes = self.changes
        if changes is None:
            return jnp.zeros(displacements.size)

        def forces(factor: Scalar) -> Float[Array, " dofs"]:
            hinges = self.mechanism.hinges_in(changes.state(self.mechanism, factor))
            return hinges.forces(displacements).reshape(-1)

        return jax.jvp(forces, (factor,), (jnp.ones_like(factor),))[1]

    def stiffness_against(
        self, point: Float[Array, " n"], shapes: Float[Array, "unknowns shapes"]
    ) -> Float[Array, "shapes shapes"]:
        """Compute the stiffness against some displacements; J.

        It is accurate if it is a small part of that of some hinges. The loads have a
        potential.
        """
        system, displacements, multipliers = self.split(point)
        moved = shapes[: len(self.dofs.free)]
        stiffness = system.factored_stiffness(displacements).gram(moved)
        if not self.constraints.size:
            return stiffness
        geometric = self.constraints.geometric_stiffness(
            displacements, system.time, multipliers
        )
        free = system.free
        return stiffness + moved.T @ geometric[free[:, None], free] @ moved

    def drive_force(self, point: Float[Array, " n"]) -> Scalar:
        """Compute the work of the reactions for a unit of the load factor; J.

        It is zero in an equilibrium that needs no reactions of prescribed displacements.
        """
        system, displacements, multipliers = self.split(point)
        reactions, _ = system.reactions_and_energy(displacements, multipliers)
        return reactions.reshape(-1)[system.prescribed] @ self.targets

    def generalized_stress(self, point: Float[Array, " n"]) -> Float[Array, "3 members"]:
        """Compute the generalized stress of the hinges at a point; N m, N, N."""
        system, displacements, _ = self.split(point)
        return system.hinges.forces_and_stress(displacements)[1]

    def stresses(self, point: Float[Array, " n"]) -> Float[Array, " hinges"]:
        """Compute the largest stress in each hinge at a point; Pa."""
        system, displacements, _ = self.split(point)
        return largest_stresses(system.hinges, displacements)

    def out_of_range(self, point: Float[Array, " n"]) -> Flag:
        """Decide whether a hinge is outside the validity range of its energy."""
        system, displacements, _ = self.split(point)
        return jnp.any(system.hinges.out_of_range(displacements))

    def range_messages(self, point: Float[Array, " n"]) -> str:
        """Describe the hinges that are outside the validity range of their energy."""
        system, displacements, _ = self.split(point)
        mechanism = eqx.tree_at(
            lambda new: new.hinge_assembly, self.mechanism, system.hinges
        )
        return mechanism.range_messages(mechanism.reference + displacements)

    def displacement_change(self, change: Float[Array, " n"]) -> Poses:
        """Arrange a change of a point by bodies; rad, m, m."""
        prescribed = change[-1] * self.targets
        return self.dofs.expand(change[: len(self.dofs.free)], prescribed)

    def mode_displacements(self, mode: Float[Array, " unknowns"]) -> Poses:
        """Arrange a change of the free displacements by bodies; rad, m, m."""
        free = mode[: len(self.dofs.free)]
        return self.dofs.expand(free, jnp.zeros_like(self.targets))
