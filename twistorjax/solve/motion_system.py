"""The equations of motion of a mechanism: who moves it, and what resists."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import Poses, Scalar, Wrenches
from ..mechanism.constraints import ConstraintSet
from ..mechanism.loads import Drive, driven, Load, loaded_bodies, LoadSet
from ..mechanism.mechanism import Mechanism
from .small_matrices import inverse
from .static_system import DofPartition


class State(NamedTuple):
    """Where a mechanism is, and how it moves.

    Args:
        place: displacements of its free coordinates from rest; rad, m.
        rate: of the displacements; rad/s, m/s.
        work: what was dissipated, and what loads and drives have done, or nothing; J.
    """

    place: Float[Array, " free"]
    rate: Float[Array, " free"]
    work: Float[Array, " works"]


class Forces(NamedTuple):
    """What moves the free coordinates at an instant.

    Args:
        net: force on each; N m, N.
        excess: of the hinges' own half-way translations over those they were taken to
            bear; m.
        violation: of the constraints; rad, m.
    """

    net: Float[Array, " free"]
    excess: Float[Array, " stretches"]
    violation: Float[Array, " constraints"]


class Slopes(NamedTuple):
    """How `Forces` follow the free coordinates.

    Args:
        stiffness: by which their net forces fall with displacements.
        damping: the same with their rates.
        stretching: of the half-way translations, by displacements.
        bearing: of what resists, by the half-way translations.
        normals: of the violations, by displacements.
    """

    stiffness: Float[Array, "free free"]
    damping: Float[Array, "free free"]
    stretching: Float[Array, "free stretches"]
    bearing: Float[Array, "free stretches"]
    normals: Float[Array, "constraints free"]


class Instant(NamedTuple):
    """What happens at an instant.

    Args:
        acceleration: of the free coordinates; rad/s2, m/s2.
        push: of each constraint's entries; N m, N.
        reactions: what held and driven coordinates receive; N m, N, N.
        powers: what is dissipated, and what loads and drives do; W.
    """

    acceleration: Float[Array, " free"]
    push: Float[Array, " constraints"]
    reactions: Wrenches
    powers: Float[Array, "3"]


class System(eqx.Module):
    """A mechanism with all that moves it, as forces on its free coordinates.

    It is the `args` of diffrax's solve, and `equation` its term.

    Args:
        mechanism: its bodies and hinges.
        loads: on its bodies, or a function of time that gives them.
        drives: of its coordinates, or a function of time that gives them.
        joined: its constraints.
        inertia: of each coordinate, zero where it is held; kg m2, kg, kg.
        length: of a lever of the mechanism, by which displacements are measured; m.
        period: of its slowest motion over two pi, by which rates are; s.
        still: displacements at the start, at which held coordinates stay; rad, m.
        places: of the free and of the driven coordinates.
    """

    mechanism: Mechanism
    loads: Sequence[Load] | Callable[[Scalar], Sequence[Load]]
    drives: Sequence[Drive] | Callable[[Scalar], Sequence[Drive]]
    joined: ConstraintSet
    inertia: Float[Array, " coordinates"]
    length: Scalar
    period: Scalar
    still: Float[Array, " coordinates"]
    places: DofPartition = eqx.field(static=True)

    @property
    def free(self) -> np.ndarray:
        """Places of the free coordinates."""
        return np.array(self.places.free, int)

    @property
    def mass(self) -> Float[Array, " free"]:
        """Inertia of each free coordinate; kg m2, kg."""
        return self.inertia[self.free]

    def size(self, error: State) -> Scalar:
        """How large an error is: in angles, and in parts of the length and the period."""
        turns = self.free % 3 == 0
        unit = jnp.where(turns, 1.0, self.length)
        place, rate = error.place / unit, error.rate * self.period / unit
        return jnp.sqrt((jnp.sum(place**2) + jnp.sum(rate**2)) / max(1, 2 * place.size))

    def targets(self, time: Scalar) -> Float[Array, " driven"]:
        """Where the driven coordinates are at a time; rad, m."""
        drives = self.drives(time) if callable(self.drives) else self.drives
        places, targets = driven(self.mechanism, drives)
        if places != self.places.driven:
            raise ValueError(
                "`drives` must give the same coordinates in the same order at all times."
            )
        return jnp.array(targets, float)

    def driving(self, time: Scalar) -> tuple[Array, Array, Array]:
        """Where the driven coordinates are, their velocities and accelerations."""
        if not callable(self.drives) or not self.places.driven:
            where = self.targets(time)
            return where, jnp.zeros_like(where), jnp.zeros_like(where)
        one = jnp.ones_like(time)

        def moving(time: Scalar) -> tuple[Array, Array]:
            return jax.jvp(self.targets, (time,), (one,))

        (where, velocity), (_, gain) = jax.jvp(moving, (time,), (one,))
        return where, velocity, gain

    def spread(self, time: Scalar, place: Array, rate: Array) -> tuple[Poses, Poses]:
        """Displacements and rates of all coordinates."""
        where, velocity, _ = self.driving(time)
        return self._placed(place, where), self._whole(rate, velocity)

    def forces(
        self,
        time: Scalar,
        place: Array,
        rate: Array,
        stretches: Array | None = None,
        push: Array | None = None,
    ) -> Forces:
        """What moves the free coordinates.

        Args:
            time: s.
            place: displacements of the free coordinates; rad, m.
            rate: of the displacements; rad/s, m/s.
            stretches: the half-way translations that the hinges are taken to bear, by
                default their own; m.
            push: of each constraint, by default none; N m, N.
        """
        displacements, rates = self.spread(time, place, rate)
        borne = None if stretches is None else stretches.reshape(-1, 2)
        resisting, excess, _ = self.mechanism.hinge_assembly.forces_in_motion(
            displacements, rates, borne
        )
        applied, _, _ = self.applied(time, displacements)
        net = (applied - resisting).reshape(-1)[self.free]
        violation, back = jax.vjp(lambda place: self.violation(time, place), place)
        if push is not None and push.size:
            net = net + back(push)[0]
        return Forces(net, excess.reshape(-1), violation)

    def slopes(
        self, time: Scalar, place: Array, rate: Array, stretches: Array, push: Array
    ) -> Slopes:
        """How the `forces` follow the free coordinates, for the same arguments."""
        displacements, rates = self.spread(time, place, rate)
        tangent = self.mechanism.hinge_assembly.tangent_in_motion(
            displacements, rates, self.places.free, stretches.reshape(-1, 2)
        )
        stiffness = tangent.stiffness
        _, by_angle, bodies = self.applied(time, displacements)
        pairs = [
            (row, self.places.free.index(3 * (coordinate // 3)), coordinate)
            for row, coordinate in enumerate(self.places.free)
            if coordinate // 3 in bodies and 3 * (coordinate // 3) in self.places.free
        ]
        if pairs:  # a load's wrench depends on the angle of its own body alone
            rows, columns, which = np.array(pairs).T
            stiffness = stiffness.at[rows, columns].add(-by_angle.reshape(-1)[which])
        normals = self.normals(time, place)
        if push.size:

            def pushed(place: Array) -> Array:
                return jax.vjp(lambda at: self.violation(time, at), place)[1](push)[0]

            stiffness = stiffness - jax.jacfwd(pushed)(place)
        return Slopes(stiffness, *tangent[1:], normals)

    @eqx.filter_jit  # traced once for the start, the steps, and what is told
    def instant(self, time: Scalar, place: Array, rate: Array) -> "Instant":
        """What happens at an instant: equation 5.25, and what follows from it."""
        displacements, rates = self.spread(time, place, rate)
        resisting, _, dissipated = self.mechanism.hinge_assembly.forces_in_motion(
            displacements, rates
        )
        applied, _, _ = self.applied(time, displacements)
        net = (applied - resisting).reshape(-1)
        push, back, moving = jnp.zeros(0), jnp.zeros_like(net), jnp.zeros(())
        if self.joined.size:
            push, back, moving = self._pushed(time, place, rate, displacements, net)
        acceleration = (net + back)[self.free] / self.mass
        _, _, gain = self.driving(time)
        total = self.inertia * self._whole(acceleration, gain).reshape(-1)
        fixed = np.ones(net.size)
        fixed[self.free] = 0.0
        reactions = jnp.asarray(fixed) * (total - net - back)
        reactions = reactions.reshape(displacements.shape)
        by_drives = jnp.vdot(reactions, rates) - moving
        powers = jnp.stack([dissipated, jnp.vdot(applied, rates), by_drives])
        return Instant(acceleration, push, reactions, powers)

    def _pushed(
        self, time: Scalar, place: Array, rate: Array, displacements: Poses, net: Array
    ) -> tuple[Array, Array, Scalar]:
        """Forces of the constraints, these on all coordinates, and the power they take.

        That of constraints which change with time, as a drive does.
        """
        one = jnp.ones_like(time)

        def violation_rate(time: Scalar, place: Array) -> Array:
            return jax.jvp(self.violation, (time, place), (one, rate))[1]

        _, curving = jax.jvp(violation_rate, (time, place), (one, rate))
        normals = self.normals(time, place)
        light = normals / self.mass[None]
        push = inverse(light @ normals.T) @ (-curving - light @ net[self.free])
        _, back = jax.vjp(lambda at: self.joined.violation(at, time), displacements)
        _, moving = jax.jvp(
            lambda time: self.joined.violation(displacements, time), (time,), (one,)
        )
        return push, back(push)[0].reshape(-1), jnp.vdot(push, moving)

    def project(self, time: Scalar, place: Array, rate: Array) -> tuple[Array, Array]:
        """The nearest place and rate that the constraints allow, as inertia measures."""
        if not self.joined.size:
            return place, rate

        def nearest(normals: Array, violation: Array) -> Array:
            light = normals / self.mass[None]
            return -light.T @ (inverse(light @ normals.T) @ violation)

        for _ in range(2):
            normals = self.normals(time, place)
            place = place + nearest(normals, self.violation(time, place))
        normals = self.normals(time, place)
        _, drift = jax.jvp(self.violation, (time, place), (jnp.ones_like(time), rate))
        return place, rate + nearest(normals, drift)

    def violation(self, time: Scalar, place: Array) -> Float[Array, " constraints"]:
        """By how much the constraints are violated; rad, m."""
        if not self.joined.size:
            return jnp.zeros(0)
        where, _, _ = self.driving(time)
        return self.joined.violation(self._placed(place, where), time)

    def normals(self, time: Scalar, place: Array) -> Float[Array, "constraints free"]:
        """Derivatives of the violation by the free coordinates."""
        if not self.joined.size:
            return jnp.zeros((0, place.size))
        return jax.jacrev(lambda place: self.violation(time, place))(place)

    def applied(
        self, time: Scalar, displacements: Poses
    ) -> tuple[Wrenches, Wrenches, tuple[int, ...]]:
        """What loads apply, its derivatives by each body's angle, and the loaded ones."""
        loads = self.loads(time) if callable(self.loads) else self.loads
        bodies = loaded_bodies(self.mechanism, loads)
        acting = LoadSet.of(loads, bodies, self.mechanism.reference)
        return *acting.apply(displacements), bodies

    def _placed(self, free: Array, given: Array) -> Poses:
        fixed = np.ones(self.inertia.size)
        fixed[list(self.places.free + self.places.driven)] = 0.0
        return self._whole(free, given) + (fixed * self.still).reshape(-1, 3)

    def _whole(self, free: Array, given: Array) -> Poses:
        """Values of the free and of the driven coordinates, and zero for the held."""
        known = (*self.places.free, *self.places.driven)
        source = np.full(self.inertia.size, len(known))
        source[list(known)] = np.arange(len(known))
        return jnp.concatenate([free, given, jnp.zeros(1)])[source].reshape(-1, 3)


def _rates(time: Any, state: State, system: System) -> State:
    place, rate, work = state
    now = system.instant(time, place, rate)
    return State(rate, now.acceleration, now.powers if work.size else work)


equation = dfx.ODETerm(_rates)
