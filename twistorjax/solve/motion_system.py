"""Equations of motion of a mechanism: forces and accelerations at an instant."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import Entries, Poses, Scalar, Wrenches
from ..mechanism.constraints import ConstraintSet
from ..mechanism.loads import Drive, Load, loaded_bodies, LoadSet, prescribed_dofs
from ..mechanism.mechanism import Mechanism
from .dofs import DofPartition
from .small_matrices import inverse
from .tangents import add_load_stiffness


class State(NamedTuple):
    """State of a motion.

    Args:
        position: Displacements of the free degrees of freedom; rad, m.
        rate: Their rates; rad/s, m/s.
        work: Dissipated energy and work of loads and drives, or no entry; J.
    """

    position: Float[Array, " free"]
    rate: Float[Array, " free"]
    work: Float[Array, " works"]


class Forces(NamedTuple):
    """Forces on the free degrees of freedom at an instant.

    Args:
        net: Net force; N m, N.
        excess: Difference between the translations of the hinges in their mid-frames and
            those for which their forces were computed; m.
        violation: Violation of the constraints; rad, m.
    """

    net: Float[Array, " free"]
    excess: Float[Array, " stretches"]
    violation: Entries


class Slopes(NamedTuple):
    """Derivatives of `Forces` by the free degrees of freedom.

    Args:
        stiffness: Negative derivative of the net forces by displacements.
        damping: Negative derivative of the net forces by rates.
        stretching: Derivative of the mid-frame translations by displacements.
        bearing: Derivative of the resisting forces by the mid-frame translations.
        jacobian: Derivative of the violations by displacements.
    """

    stiffness: Float[Array, "free free"]
    damping: Float[Array, "free free"]
    stretching: Float[Array, "free stretches"]
    bearing: Float[Array, "free stretches"]
    jacobian: Float[Array, "entries free"]


class Instant(NamedTuple):
    """Accelerations, forces, and powers at an instant.

    Args:
        acceleration: Acceleration of the free degrees of freedom; rad/s2, m/s2.
        push: Constraint force of each entry; N m, N.
        reactions: External wrench on fixed and prescribed degrees of freedom; N m, N, N.
        powers: Dissipated power, power of the loads, power of drives and constraints; W.
    """

    acceleration: Float[Array, " free"]
    push: Entries
    reactions: Wrenches
    powers: Float[Array, "3"]


class MotionSystem(eqx.Module):
    """The equations of motion of a mechanism.

    It is the `args` of diffrax's solve, and `equation` is the term.

    Args:
        mechanism: The mechanism.
        loads: Loads on its bodies, or a function of time that returns them.
        drives: Prescribed displacements, or a function of time that returns them.
        constraints: Its constraints.
        inertia: Inertia of each degree of freedom, zero where it is fixed; kg m2, kg, kg.
        length: Length of the mechanism by which displacements are scaled; m.
        period: Period of its slowest motion over two pi, by which rates are scaled; s.
        start: Displacements at the start, which fixed degrees of freedom keep; rad, m.
        dofs: Partition of the degrees of freedom.
    """

    mechanism: Mechanism
    loads: Sequence[Load] | Callable[[Scalar], Sequence[Load]]
    drives: Sequence[Drive] | Callable[[Scalar], Sequence[Drive]]
    constraints: ConstraintSet
    inertia: Float[Array, " dofs"]
    length: Scalar
    period: Scalar
    start: Poses
    dofs: DofPartition = eqx.field(static=True)

    @property
    def free(self) -> np.ndarray:
        """Indices of the free degrees of freedom."""
        return np.array(self.dofs.free, int)

    @property
    def mass(self) -> Float[Array, " free"]:
        """Inertia of each free degree of freedom; kg m2, kg."""
        return self.inertia[self.free]

    def norm(self, error: State) -> Scalar:
        """Compute the root mean square of an error; translations and rates are scaled."""
        unit = jnp.where(self.free % 3 == 0, 1.0, self.length)
        position, rate = error.position / unit, error.rate * self.period / unit
        squares = jnp.sum(position**2) + jnp.sum(rate**2)
        return jnp.sqrt(squares / max(1, 2 * position.size))

    def targets(self, time: Scalar) -> Float[Array, " prescribed"]:
        """Compute the prescribed displacements at a time; rad, m."""
        drives = self.drives(time) if callable(self.drives) else self.drives
        dofs, targets = prescribed_dofs(self.mechanism, drives)
        if dofs != self.dofs.prescribed:
            raise ValueError(
                "`drives` must give the same coordinates in the same order at all times."
            )
        return jnp.array(targets, float)

    def prescribed(self, time: Scalar) -> tuple[Array, Array, Array]:
        """Compute prescribed displacements, their velocities, and their accelerations."""
        if not callable(self.drives) or not self.dofs.prescribed:
            targets = self.targets(time)
            return targets, jnp.zeros_like(targets), jnp.zeros_like(targets)
        one = jnp.ones_like(time)

        def velocity(time: Scalar) -> tuple[Array, Array]:
            return jax.jvp(self.targets, (time,), (one,))

        (targets, rates), (_, accelerations) = jax.jvp(velocity, (time,), (one,))
        return targets, rates, accelerations

    def expand(self, time: Scalar, position: Array, rate: Array) -> tuple[Poses, Poses]:
        """Compute displacements and velocities of all bodies at a time."""
        targets, rates, _ = self.prescribed(time)
        return self._displacements(position, targets), self.dofs.expand(rate, rates)

    def forces(
        self,
        time: Scalar,
        position: Array,
        rate: Array,
        stretches: Array | None = None,
        push: Array | None = None,
    ) -> Forces:
        """Compute the forces on the free degrees of freedom.

        Args:
            time: Time; s.
            position: Displacements of the free degrees of freedom; rad, m.
            rate: Their rates; rad/s, m/s.
            stretches: Mid-frame translations for which the forces of the hinges are
                computed; by default their own; m.
            push: Constraint force of each entry; by default none; N m, N.
        """
        displacements, rates = self.expand(time, position, rate)
        given = None if stretches is None else stretches.reshape(-1, 2)
        resisting, excess, _ = self.mechanism.hinge_assembly.forces_in_motion(
            displacements, rates, given
        )
        applied, _ = self.load_set(time).apply(displacements)
        net = (applied - resisting).reshape(-1)[self.free]
        violation, pull_back = jax.vjp(lambda at: self.violation(time, at), position)
        if push is not None and push.size:
            net = net + pull_back(push)[0]
        return Forces(net, excess.reshape(-1), violation)

    def slopes(
        self, time: Scalar, position: Array, rate: Array, stretches: Array, push: Array
    ) -> Slopes:
        """Compute the derivatives of the `forces`, for the same arguments."""
        displacements, rates = self.expand(time, position, rate)
        free = self.dofs.free
        tangent = self.mechanism.hinge_assembly.tangent_in_motion(
            displacements, rates, free, stretches.reshape(-1, 2)
        )
        loads = self.load_set(time)
        _, by_angle = loads.apply(displacements)
        stiffness = add_load_stiffness(
            tangent.stiffness, by_angle.reshape(-1), loads.bodies, free, free
        )
        if push.size:
            geometric = self.constraints.geometric_stiffness(displacements, time, push)
            stiffness = stiffness + geometric[self.free[:, None], self.free]
        return Slopes(stiffness, *tangent[1:], self.jacobian(time, position))

    @eqx.filter_jit  # traced once for the start, the steps, and the output
    def instant(self, time: Scalar, position: Array, rate: Array) -> Instant:
        """Compute accelerations, forces, and powers; dissertation, equation 5.25."""
        displacements, rates = self.expand(time, position, rate)
        resisting, _, dissipated = self.mechanism.hinge_assembly.forces_in_motion(
            displacements, rates
        )
        applied, _ = self.load_set(time).apply(displacements)
        net = (applied - resisting).reshape(-1)
        push, constraint, power = jnp.zeros(0), jnp.zeros_like(net), jnp.zeros(())
        if self.constraints.size:
            push, constraint, power = self._push(time, position, rate, displacements, net)
        acceleration = (net + constraint)[self.free] / self.mass
        _, _, prescribed = self.prescribed(time)
        total = self.inertia * self.dofs.expand(acceleration, prescribed).reshape(-1)
        reactions = self.dofs.reactions(total - net - constraint)
        by_drives = jnp.vdot(reactions, rates) - power
        powers = jnp.stack([dissipated, jnp.vdot(applied, rates), by_drives])
        return Instant(acceleration, push, reactions, powers)

    def _push(
        self, time: Scalar, position: Array, rate: Array, displacements: Poses, net: Array
    ) -> tuple[Array, Array, Scalar]:
        """Compute constraint forces, their generalized forces, and their power.

        The power is that of constraints which depend on time, as drives do; W.
        """
        one = jnp.ones_like(time)

        def violation_rate(time: Scalar, position: Array) -> Array:
            return jax.jvp(self.violation, (time, position), (one, rate))[1]

        _, bias = jax.jvp(violation_rate, (time, position), (one, rate))
        jacobian = self.jacobian(time, position)
        light = jacobian / self.mass[None]
        push = inverse(light @ jacobian.T) @ (-bias - light @ net[self.free])
        forces = self.constraints.forces(displacements, time, push)
        _, by_time = jax.jvp(
            lambda time: self.constraints.violation(displacements, time), (time,), (one,)
        )
        return push, forces, jnp.vdot(push, by_time)

    def project(self, time: Scalar, position: Array, rate: Array) -> tuple[Array, Array]:
        """Project a state onto the constraints, in the metric of the inertia."""
        if not self.constraints.size:
            return position, rate

        def correction(jacobian: Array, violation: Array) -> Array:
            light = jacobian / self.mass[None]
            return -light.T @ (inverse(light @ jacobian.T) @ violation)

        for _ in range(2):
            jacobian = self.jacobian(time, position)
            position = position + correction(jacobian, self.violation(time, position))
        jacobian = self.jacobian(time, position)
        one = jnp.ones_like(time)
        _, drift = jax.jvp(self.violation, (time, position), (one, rate))
        return position, rate + correction(jacobian, drift)

    def violation(self, time: Scalar, position: Array) -> Entries:
        """Compute the violation of the constraints; rad, m."""
        if not self.constraints.size:
            return jnp.zeros(0)
        targets, _, _ = self.prescribed(time)
        return self.constraints.violation(self._displacements(position, targets), time)

    def jacobian(self, time: Scalar, position: Array) -> Float[Array, "entries free"]:
        """Compute the derivatives of the violation by the free degrees of freedom."""
        if not self.constraints.size:
            return jnp.zeros((0, position.size))
        return jax.jacrev(lambda position: self.violation(time, position))(position)

    def load_set(self, time: Scalar) -> LoadSet:
        """Gather the loads at a time."""
        loads = self.loads(time) if callable(self.loads) else self.loads
        loaded_bodies(self.mechanism, loads)
        return LoadSet.of(loads, self.mechanism.names, self.mechanism.reference)

    def _displacements(self, position: Array, targets: Array) -> Poses:
        """Arrange displacements by bodies; fixed ones stay where they started."""
        return self.dofs.expand(position, targets) + self.dofs.fixed_part(self.start)


def _derivative(time: Any, state: State, system: MotionSystem) -> State:
    """Time derivative of a state."""
    position, rate, work = state
    now = system.instant(time, position, rate)
    return State(rate, now.acceleration, now.powers if work.size else work)


equation = dfx.ODETerm(_derivative)
