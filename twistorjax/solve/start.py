"""How a motion begins, and what is wrong where it cannot."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, cast, TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .._checks import all_known, find, known, row, uncompilable
from .._trees import undifferentiated
from .._types import Poses
from ..boundary import Drive, driven
from ..joints import Joined
from ..mechanism import Mechanism
from .elimination import inverse
from .newton import Places
from .results import meaning, RESULTS
from .statics import free_coordinates
from .system import State, System


if TYPE_CHECKING:
    from .motion import Motion

# In parts of the mechanism's length, and of its speed
_EXACT = 1e-9


def times(given: ArrayLike | Sequence[ArrayLike]) -> Float[Array, " times"]:
    """The times at which a motion is told, if they increase as far as can be seen."""
    values = jnp.asarray(given, float)
    if values.ndim != 1 or len(values) < 2:
        raise ValueError(
            f"`times` has shape {values.shape}, but must be a row of at least two times: "
            "when the motion begins, and when it ends."
        )
    finite("times", values)
    seen = known(values)
    if seen is not None:
        late = np.flatnonzero(np.diff(seen) <= 0)
        if late.size:
            k = int(late[0])
            raise ValueError(
                f"`times` must increase, but `times[{k + 1}]` = {seen[k + 1]:g} comes "
                f"after `times[{k}]` = {seen[k]:g}."
            )
    return values


def finite(name: str, value: Array) -> None:
    """Refuses what can be seen not to be finite."""
    seen = known(value)
    if seen is not None and not np.all(np.isfinite(seen)):
        raise ValueError(f"`{name}` must be finite, but has {seen.tolist()}.")


@contextmanager
def compiling(now: Array, **functions: Any) -> Iterator[None]:
    """Tells which function of time it was, where JAX cannot compile one."""
    try:
        yield
    except jax.errors.JAXTypeError:
        for name, function in functions.items():
            if callable(function):
                _compilable(name, function, now)
        raise


def _compilable(name: str, function: Callable, now: Array) -> None:
    try:
        eqx.filter_eval_shape(function, now)
    except jax.errors.JAXTypeError as error:
        raise uncompilable(name, "about the time", error) from error


def limits(tolerance: ArrayLike, max_steps: int, step: ArrayLike | None) -> None:
    """Refuses settings that make no sense."""
    for name, value in (("tolerance", tolerance), ("step", step)):
        seen = None if value is None else known(value)
        if seen is not None and not np.all((seen > 0) & np.isfinite(seen)):
            raise ValueError(f"`{name}` is {value!r}, but must be positive and finite.")
    if max_steps < 1:
        raise ValueError(f"`max_steps` is {max_steps!r}, but must be at least 1.")


def velocities(
    mechanism: Mechanism,
    given: Mapping[str, Sequence[ArrayLike] | Array] | None,
    free: tuple[int, ...],
) -> Poses | None:
    """Velocities at the start, of the bodies that are named; zero for the others."""
    if given is None:
        return None
    if not isinstance(given, Mapping):
        raise ValueError(
            f"`velocities` is {given!r}, but must be a mapping from names of bodies to "
            '(rate of turning, along x, along y): {"link": (0, 1, 0)}.'
        )
    rows = [jnp.zeros(3)] * len(mechanism.names)
    for name, velocity in given.items():
        body = find("`velocities`", "body", name, mechanism.names)
        where = f"`velocities` of the body {name!r}"
        rows[body] = row(where, velocity, "(rate of turning, along x, along y)")
        seen = known(rows[body])
        for k in range(3):
            place = 3 * body + k
            if place not in free and seen is not None and seen[k] != 0:
                raise ValueError(
                    f"{where} moves the {mechanism.coordinate(place)}, but that is held "
                    "or driven: its velocity is given by what holds or drives it."
                )
    return jnp.stack(rows)


def begin(
    mechanism: Mechanism,
    times: Float[Array, " times"],
    loads,
    drives,
    joints: Joined,
    moved: Poses,
    given: Poses | None,
    energies: bool,
    places: Places,
) -> tuple[System, State, Array, RESULTS]:
    """The equations of a motion, its first state and step, and whether it can begin.

    A state that cannot begin is NaN, at which every solver stops.
    """
    arms = jax.lax.stop_gradient(mechanism.couplings.arms)
    length = jnp.sqrt(jnp.mean(jnp.sum(arms**2, axis=-1)))
    inertia = mechanism.inertia().reshape(-1)
    system = System(
        mechanism=mechanism,
        loads=loads,
        drives=drives,
        joined=joints,
        inertia=jnp.where(jnp.isinf(inertia), 0.0, inertia),
        length=_finite(length),
        period=jnp.ones(()),
        still=moved.reshape(-1),
        places=places,
    )
    place = moved.reshape(-1)[system.free]
    period, first = _periods(system, moved, times[-1] - times[0])
    system = eqx.tree_at(lambda system: system.period, system, period)
    rate = jnp.zeros_like(place)
    if given is not None:
        rate = given.reshape(-1)[system.free]

    result = RESULTS.successful
    checks = [(jnp.all(jnp.diff(times) > 0), RESULTS.times_not_increasing)]
    where, _, _ = system.driving(times[0])
    apart = jnp.abs(where - moved.reshape(-1)[np.array(places.driven, int)])
    unit = jnp.where(np.array(places.driven, int) % 3 == 0, 1.0, system.length)
    # NaN is told as not finite
    checks.append((~jnp.any(apart > _EXACT * unit), RESULTS.drive_jumps))
    checks.append((~_gives_energy(mechanism), RESULTS.damping_gives_energy))
    if joints.size:
        consistent, rate = _consistent(system, times[0], place, rate, given is not None)
        checks.append((consistent, RESULTS.constraints_at_odds))
    for fine, item in reversed(checks):
        result = RESULTS.where(fine, result, item)
    works = jnp.zeros(3 if energies else 0)
    state = State(place, rate, works)
    fine = result == RESULTS.successful
    return (
        system,
        jax.tree.map(lambda x: jnp.where(fine, x, jnp.nan), state),
        first,
        result,
    )


def _periods(system: System, moved: Poses, longest: Array) -> tuple[Array, Array]:
    """Those of the slowest vibration and of the fastest, over two pi, or nearly; s.

    By the sums of the squares of all periods, and of all frequencies, which they lead.
    """
    system, moved, longest = undifferentiated((system, moved, longest))
    # the function of a step's tangent, so that it is traced once
    couplings, mass = system.mechanism.couplings, system.mass
    stretches = couplings.stretches(moved)
    still = jnp.zeros_like(moved)
    stiffness = couplings.tangent_in_motion(
        moved, still, system.places.free, stretches
    ).stiffness
    slowest = jnp.sum(jnp.diagonal(inverse(stiffness)) * mass)
    fastest = jnp.sum(jnp.diagonal(stiffness) / mass)
    # where nothing holds a body, no period but that of the motion itself
    slowest = jnp.where((slowest > 0) & (slowest < longest**2), slowest, longest**2)
    fastest = jnp.where(fastest > 1 / longest**2, fastest, 1 / longest**2)
    return _finite(jnp.sqrt(slowest)), _finite(1 / jnp.sqrt(fastest))


def _finite(value: Array) -> Array:
    # what is not finite is told by the motion itself
    return jnp.where(jnp.isfinite(value) & (value > 0), value, 1.0)


def _gives_energy(mechanism: Mechanism) -> Array:
    wrong = jnp.zeros((), bool)
    for stack in mechanism.couplings.stacks:
        if stack.damping is not None:
            matrix = jax.lax.stop_gradient(stack.damping.damping).reshape(-1, 3, 3)
            size = jnp.sqrt(jnp.abs(jnp.diagonal(matrix, axis1=1, axis2=2)))
            size = jnp.where(size > 0, size, 1.0)
            scaled = matrix / (size[:, :, None] * size[:, None])
            # positive where each of its minors about the diagonal is
            a, b, c = scaled[:, 0, 1], scaled[:, 0, 2], scaled[:, 1, 2]
            x, y, z = jnp.diagonal(scaled, axis1=1, axis2=2).T
            minors = [x, y, z, x * y - a * a, x * z - b * b, y * z - c * c]
            whole = x * y * z + 2 * a * b * c - x * c * c - y * b * b - z * a * a
            wrong |= jnp.any(jnp.stack([*minors, whole]) < -1e-9)
    return wrong


def _consistent(
    system: System, time: Array, place: Array, rate: Array, told: bool
) -> tuple[Array, Array]:
    """Whether the constraints allow the start, and a rate that they allow.

    A rate that was told must be allowed itself; that which was not is the least.
    """
    normals = system.normals(time, place)
    violation = system.violation(time, place)
    allowed = system.project(time, place, rate)[1]
    scaled = normals * jnp.where(system.free % 3 == 0, 1.0, system.length)[None]
    scaled = scaled / jnp.linalg.norm(scaled, axis=1, keepdims=True)
    largest = jnp.max(jnp.abs(inverse(scaled @ scaled.T)))
    apart = (largest < 1e12) & (normals.shape[0] <= normals.shape[1])
    met = jnp.max(jnp.abs(violation)) <= _EXACT * (1 + system.length)
    if told:
        speed = 1 + jnp.max(jnp.abs(rate))
        met &= jnp.max(jnp.abs(allowed - rate)) <= 1e-6 * speed
    # what is not finite is told as such
    seen = jnp.all(jnp.isfinite(normals)) & jnp.all(jnp.isfinite(violation))
    return (met & apart) | ~seen, allowed


def _given(drives: Any, now: Array) -> Sequence[Drive]:
    return cast(Sequence[Drive], drives(now) if callable(drives) else drives)


def refuse(
    mechanism: Mechanism, drives, joints: Joined, moved: Poses, now: Array, told: bool
) -> None:
    """Refuses a start that can be seen to be none, before anything is compiled."""
    if all_known([moved, now, *jax.tree.leaves((mechanism, joints))]) is None:
        return
    given = _given(drives, now)
    places, targets = driven(mechanism, given)
    if all_known(targets) is None:
        return
    unit = np.sqrt(np.mean(np.sum(np.square(mechanism.couplings.arms), axis=-1)))
    for place, target in zip(places, targets, strict=True):
        apart = abs(float(target) - float(moved.reshape(-1)[place]))
        if apart > _EXACT * (1.0 if place % 3 == 0 else unit or 1.0):
            words = _jumps(mechanism, drives, moved, now)
            raise ValueError(f"{meaning('drive_jumps')} {words}")
    seen = np.isfinite(np.asarray(joints.violation(moved, now))) if joints.size else ()
    if joints.size and not told and np.all(seen):
        words = _at_odds(mechanism, joints, moved, now, drives)
        if not words.startswith("The velocities"):
            raise ValueError(f"{meaning('constraints_at_odds')} {words}")


def failure(
    answer: "Motion",
    mechanism: Mechanism,
    drives,
    joints: Joined,
    moved: Poses,
    now: Array,
    item: str,
    lane: tuple[int, ...],
) -> Exception:
    """What is wrong with a motion that did not reach its end, or could not begin."""
    text = meaning(item)
    if lane:
        return RuntimeError(f"{text} (lane {', '.join(map(str, lane))} of the batch)")
    if item == "drive_jumps":
        return ValueError(f"{text} {_jumps(mechanism, drives, moved, now)}")
    if item == "constraints_at_odds":
        return ValueError(f"{text} {_at_odds(mechanism, joints, moved, now, drives)}")
    if item in ("times_not_increasing", "damping_gives_energy"):
        return ValueError(text)
    if item == "not_finite":
        text += _not_finite(mechanism)
    return RuntimeError(f"{text} {_stopped(answer, mechanism)}")


def _jumps(mechanism: Mechanism, drives, moved: Poses, now: Array) -> str:
    given = _given(drives, now)
    places, targets = driven(mechanism, given)
    words = [
        f"The {mechanism.coordinate(place)} starts at {moved.reshape(-1)[place]:.6g} and "
        f"is driven to {target:.6g}."
        for place, target in zip(places, targets, strict=True)
        if abs(float(target) - float(moved.reshape(-1)[place])) > 0
    ]
    return " ".join(words)


def _at_odds(
    mechanism: Mechanism, joints: Joined, moved: Poses, now: Array, drives
) -> str:
    """Which constraints are violated at the start, or add nothing to those before."""
    given = _given(drives, now)
    places, _ = driven(mechanism, given)
    free = free_coordinates(len(mechanism.names), mechanism.held, places)
    violation = np.asarray(joints.violation(moved, now))
    normals = np.asarray(
        jax.jacrev(lambda moved: joints.violation(moved, now))(moved)
    ).reshape(violation.size, -1)[:, list(free)]
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.where(size > 0, size, 1.0)
    owners = joints.owners()
    words = []
    for name in dict.fromkeys(owners):
        own = [k for k, owner in enumerate(owners) if owner == name]
        before = own[0]
        rank = np.linalg.matrix_rank(normals[:before], 1e-9) if before else 0
        gained = np.linalg.matrix_rank(normals[: own[-1] + 1], 1e-9) - rank
        worst = np.abs(violation[own]).max()
        if gained < len(own) and worst > _EXACT:
            words.append(
                f"{name!r} contradicts those before it: it leaves {worst:.3g} that "
                "nothing can mend."
            )
        elif gained < len(own):
            words.append(
                f"{name!r} is redundant: {len(own) - gained} of its {len(own)} entries "
                "follow from those before it and from what is held or driven. Leave it "
                "out."
            )
        elif worst > _EXACT:
            words.append(f"{name!r} is violated by {worst:.3g} at the start.")
    return " ".join(words) or "The velocities at the start are against them."


def _not_finite(mechanism: Mechanism) -> str:
    """Which hinge or body has the value."""
    for place, name in enumerate(mechanism.hinge_names):
        values = jax.tree.leaves(mechanism.couplings.energy_of(place))
        if not all(np.all(np.isfinite(value)) for value in values):
            return f" It is in the energy of the hinge {name!r}."
    for body, name in enumerate(mechanism.names):
        values = mechanism.rest[body], mechanism.masses[body], mechanism.inertias[body]
        if not all(np.all(np.isfinite(v)) for v in values if v is not None):
            return f" It is in the body {name!r}."
    return ""


def _stopped(answer: "Motion", mechanism: Mechanism) -> str:
    """When, and who moved fastest and bore most in what was kept."""
    at = f"It went to t = {float(answer.reached):.6g} s in {int(answer.steps)} steps."
    kept = np.flatnonzero(np.isfinite(np.asarray(answer.times)))
    if not kept.size:
        return at
    last = kept[-1]
    if last == 0:
        return at
    fastest = np.argmax(
        np.linalg.norm(np.asarray(answer.velocities)[last, :, 1:], axis=1)
    )
    poses = answer.poses[last]
    stored = [
        float(
            mechanism.couplings.energy_of(place)(mechanism.displacement_of(name, poses))
        )
        for place, name in enumerate(mechanism.hinge_names)
    ]
    return (
        f"{at} At {float(answer.times[last]):.6g} s the body "
        f"{mechanism.names[fastest]!r} moved fastest, and the hinge "
        f"{mechanism.hinge_names[int(np.argmax(stored))]!r} stored most."
    )
