"""Equations of motion of a mechanism: forces and accelerations at an instant."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.types import Entries, Poses, Scalar, Wrenches
from ...assembly.assembly import HingeAssembly
from ...assembly.tangent import AssemblyMotionTangent
from ...linalg.block_factors import block_layout, Layout
from ...linalg.elimination import inverse
from ...mechanism.changes import HingeChanges
from ...mechanism.constraints import ConstraintSet
from ...mechanism.loads import Drive, Load, LoadSet, prescribed_dofs
from ...mechanism.mechanism import Mechanism
from ...mechanism.misfits import HingeState
from ..equations.dofs import DofPartition
from ..equations.tangent import add_load_stiffness


class State(NamedTuple):
    """State of a motion."""

    # Displacements of the free degrees of freedom; rad, m
    position: Float[Array, " free"]
    rate: Float[Array, " free"]  # Their rates; rad/s, m/s
    # Dissipated energy, work of loads, work of prescribed motions, and work of strokes
    # and temperatures that change; empty if they are not computed; J
    work: Float[Array, " works"]


class Forces(NamedTuple):
    """Forces on the free degrees of freedom at an instant."""

    net: Float[Array, " free"]  # Net force; N m, N
    # Difference between the translations of the hinges in their mid-frames and those for
    # which their forces were computed; m
    excess: Float[Array, " translations"]
    violation: Entries  # Violation of the constraints; rad, m


class MotionTangent(NamedTuple):
    """Derivatives of `Forces` with respect to the free degrees of freedom.

    The stiffness has the shape of the system's layout.
    """

    # Negative derivative of the net forces with respect to displacements; N m/rad, N/rad,
    # N/m
    stiffness: Float[Array, "*matrix"]
    # Derivatives of the forces of the hinges, also with respect to rates
    hinges: AssemblyMotionTangent
    # Derivative of the violations with respect to displacements
    jacobian: Float[Array, "entries free"]


class Instant(NamedTuple):
    """Accelerations, forces, and powers at an instant."""

    # Acceleration of the free degrees of freedom; rad/s^2, m/s^2
    acceleration: Float[Array, " free"]
    multipliers: Entries  # Constraint forces; N m, N
    # External wrench on fixed and prescribed degrees of freedom; N m, N, N
    reactions: Wrenches
    # Dissipated power, power of the loads, power of prescribed motions and time-dependent
    # constraints, and power of strokes and temperatures that change; W
    powers: Float[Array, " powers"]


class MotionSystem(eqx.Module):
    """Equations of motion of a mechanism.

    They are the `args` of `diffrax.diffeqsolve`, and `equation` is its term.
    """

    mechanism: Mechanism
    # The loads, or a function of time that returns them
    loads: LoadSet | Callable[[Scalar], Sequence[Load]]
    # Prescribed displacements, or a function of time that returns them
    drives: Sequence[Drive] | Callable[[Scalar], Sequence[Drive]]
    # Strokes and temperatures as functions of time; None if there are none
    changes: HingeChanges | None
    constraints: ConstraintSet
    # Inertia of each degree of freedom, zero for fixed bodies; kg m^2, kg, kg
    inertia: Float[Array, " dofs"]
    length: Scalar  # Length of the mechanism by which displacements are scaled; m
    # Period of its slowest vibration, divided by two pi, by which rates are scaled; s
    period: Scalar
    dofs: DofPartition = eqx.field(static=True)  # Partition of the degrees of freedom

    @property
    def free(self) -> np.ndarray:
        """Indices of the free degrees of freedom."""
        return np.array(self.dofs.free, int)

    @property
    def layout(self) -> Layout | None:
        """Layout of the matrices of many bodies; None if the matrices are dense."""
        pairs = self.mechanism.hinge_assembly.ends + self.constraints.pairs
        return block_layout(pairs, self.dofs.free)

    @property
    def mass(self) -> Float[Array, " free"]:
        """Inertia of each free degree of freedom; kg m^2, kg."""
        return self.inertia[self.free]

    def norm(self, error: State) -> Scalar:
        """Compute the root mean square of an error with scaled translations and rates."""
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
        """Compute prescribed displacements, velocities, and accelerations."""
        if not callable(self.drives) or not self.dofs.prescribed:
            targets = self.targets(time)
            return targets, jnp.zeros_like(targets), jnp.zeros_like(targets)
        one = jnp.ones_like(time)

        def velocity(time: Scalar) -> tuple[Array, Array]:
            return jax.jvp(self.targets, (time,), (one,))

        (targets, rates), (_, accelerations) = jax.jvp(velocity, (time,), (one,))
        return targets, rates, accelerations

    def expand(self, time: Scalar, position: Array, rate: Array) -> tuple[Poses, Poses]:
        """Compute displacements and velocities of all bodies; rad, m, m, per second."""
        targets, rates, _ = self.prescribed(time)
        return self.dofs.expand(position, targets), self.dofs.expand(rate, rates)

    def forces(
        self,
        time: Scalar,
        position: Array,
        rate: Array,
        translations: Array | None = None,
        multipliers: Array | None = None,
    ) -> Forces:
        """Compute the forces on the free degrees of freedom.

        The forces of the hinges are computed for given mid-frame translations, the
        `translations` (m), by default those of the position.
        """
        displacements, rates = self.expand(time, position, rate)
        translations = None if translations is None else translations.reshape(-1, 2)
        resisting, excess, _ = self.hinges(time).forces_in_motion(
            displacements, rates, translations
        )
        applied, _ = self.load_set(time).apply(displacements)
        net = (applied - resisting).reshape(-1)[self.free]
        violation, pull_back = jax.vjp(lambda at: self.violation(time, at), position)
        if multipliers is not None and multipliers.size:
            net = net + pull_back(multipliers)[0]
        return Forces(net, excess.reshape(-1), violation)

    def tangent(
        self,
        time: Scalar,
        position: Array,
        rate: Array,
        translations: Array,
        multipliers: Array,
    ) -> MotionTangent:
        """Compute the derivatives of the `forces`, for the same arguments."""
        displacements, rates = self.expand(time, position, rate)
        free, layout = self.dofs.free, self.layout
        tangent = self.hinges(time).tangent_in_motion(
            displacements, rates, free, translations.reshape(-1, 2), layout
        )
        loads = self.load_set(time)
        stiffness = tangent.stiffness
        if loads.present:
            _, by_angle = loads.apply(displacements)
            stiffness = add_load_stiffness(
                stiffness, by_angle.reshape(-1), loads.conservative, free, free, layout
            )
        if multipliers.size:
            geometric = self.constraints.geometric_stiffness(
                displacements, time, multipliers
            )
            geometric = geometric[self.free[:, None], self.free]
            stiffness = stiffness + (
                geometric if layout is None else layout.of_dense(geometric)
            )
        return MotionTangent(
            stiffness=stiffness,
            hinges=tangent,
            jacobian=self.jacobian(time, position),
        )

    @eqx.filter_jit  # traced once for the start, the steps, and the output
    def instant(self, time: Scalar, position: Array, rate: Array) -> Instant:
        """Compute accelerations, forces, and powers; dissertation, equation 5.25."""
        displacements, rates = self.expand(time, position, rate)
        resisting, _, (dissipated, by_strokes) = self.hinges(time).forces_in_motion(
            displacements, rates
        )
        applied, _ = self.load_set(time).apply(displacements)
        net = (applied - resisting).reshape(-1)
        multipliers, constraint, power = jnp.zeros(0), jnp.zeros_like(net), jnp.zeros(())
        if self.constraints.size:
            multipliers, constraint, power = self._multipliers(
                time, position, rate, displacements, net
            )
        acceleration = (net + constraint)[self.free] / self.mass
        _, _, prescribed = self.prescribed(time)
        total = self.inertia * self.dofs.expand(acceleration, prescribed).reshape(-1)
        reactions = self.dofs.reactions(total - net - constraint)
        by_drives = jnp.vdot(reactions, rates) - power
        powers = [dissipated, jnp.vdot(applied, rates), by_drives]
        if self.changes is not None:
            by_dilation = self.changes.dilation_power(self.mechanism, time, displacements)
            powers.append(by_strokes + by_dilation)
        return Instant(acceleration, multipliers, reactions, jnp.stack(powers))

    def _multipliers(
        self, time: Scalar, position: Array, rate: Array, displacements: Poses, net: Array
    ) -> tuple[Array, Array, Scalar]:
        """Compute constraint forces, generalized forces (N m, N), and their power (W).

        Only time-dependent constraints have a power.
        """
        one = jnp.ones_like(time)

        def violation_rate(time: Scalar, position: Array) -> Array:
            return jax.jvp(self.violation, (time, position), (one, rate))[1]

        _, bias = jax.jvp(violation_rate, (time, position), (one, rate))
        jacobian = self.jacobian(time, position)
        scaled = jacobian / self.mass[None]
        multipliers = inverse(scaled @ jacobian.T) @ (-bias - scaled @ net[self.free])
        forces = self.constraints.forces(displacements, time, multipliers)
        _, by_time = jax.jvp(
            lambda time: self.constraints.violation(displacements, time), (time,), (one,)
        )
        return multipliers, forces, jnp.vdot(multipliers, by_time)

    def project(self, time: Scalar, position: Array, rate: Array) -> tuple[Array, Array]:
        """Project a state onto the constraints, in the metric of the inertia."""
        if not self.constraints.size:
            return position, rate

        def correction(jacobian: Array, violation: Array) -> Array:
            scaled = jacobian / self.mass[None]
            return -scaled.T @ (inverse(scaled @ jacobian.T) @ violation)

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
        return self.constraints.violation(self.dofs.expand(position, targets), time)

    def jacobian(self, time: Scalar, position: Array) -> Float[Array, "entries free"]:
        """Differentiate the violation with respect to the free degrees of freedom."""
        if not self.constraints.size:
            return jnp.zeros((0, position.size))
        return jax.jacrev(lambda position: self.violation(time, position))(position)

    def hinges(self, time: Scalar) -> HingeAssembly:
        """Return the hinges with their strokes and temperatures at a time; s."""
        if self.changes is None:
            return self.mechanism.hinge_assembly
        return self.changes.hinges(self.mechanism, time)

    def hinge_state(self, time: Scalar) -> HingeState:
        """Return the strokes and the temperatures at a time; s."""
        if self.changes is None:
            return HingeState(None, None)
        return self.changes.state(self.mechanism, time)

    def load_set(self, time: Scalar) -> LoadSet:
        """Gather the loads at a time; s."""
        if isinstance(self.loads, LoadSet):
            return self.loads
        return LoadSet.of(self.mechanism, self.loads(time))


def _derivative(time: Any, state: State, system: MotionSystem) -> State:
    """Compute the time derivative of a state."""
    position, rate, work = state
    now = system.instant(time, position, rate)
    return State(rate, now.acceleration, now.powers if work.size else work)


equation = dfx.ODETerm(_derivative)
