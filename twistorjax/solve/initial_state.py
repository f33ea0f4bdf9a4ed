"""How a motion begins, and what is wrong where it cannot."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from .._utils.pytrees import undifferentiated
from .._utils.types import Poses, Scalar
from .._utils.validation import compilation_error, concrete, index_of, require_row
from ..mechanism.constraints import ConstraintSet
from ..mechanism.mechanism import Mechanism
from .motion_system import State, System
from .results import RESULTS
from .small_matrices import inverse
from .static_system import DofPartition


# Violations of the constraints that are taken for rounding errors: of displacements, in
# rad and in lengths of the mechanism, and of velocities, as a share of the velocities.
EXACT = 1e-9
_ALONG = 1e-6


def times(given: ArrayLike | Sequence[ArrayLike]) -> Float[Array, " times"]:
    """The times at which a motion is told, if they increase as far as can be seen."""
    values = jnp.asarray(given, float)
    if values.ndim != 1 or len(values) < 2:
        raise ValueError(
            f"`times` has shape {values.shape}, but must be a row of at least two times: "
            "when the motion begins, and when it ends."
        )
    finite("times", values)
    seen = concrete(values)
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
    seen = concrete(value)
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
        raise compilation_error(name, "about the time", error) from error


def limits(tolerance: ArrayLike, max_steps: int, step: ArrayLike | None) -> None:
    """Refuses settings that make no sense."""
    for name, value in (("tolerance", tolerance), ("step", step)):
        seen = None if value is None else concrete(value)
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
        body = index_of("`velocities`", "body", name, mechanism.names)
        where = f"`velocities` of the body {name!r}"
        rows[body] = require_row(where, velocity, "(rate of turning, along x, along y)")
        seen = concrete(rows[body])
        for k in range(3):
            place = 3 * body + k
            if place not in free and seen is not None and seen[k] != 0:
                raise ValueError(
                    f"{where} moves the {mechanism.coordinate(place)}, but that is held "
                    "or driven: its velocity is given by what holds or drives it."
                )
    return jnp.stack(rows)


class Beginning(NamedTuple):
    """The initial value problem of a motion.

    Of a motion that cannot begin, the state is zero and the times are equal: no solver
    takes a step, so that it delays no other motion of its batch.

    Args:
        system: equations of motion.
        state: at the first time.
        times: at which the motion is reported; s.
        step: length of the first step; s.
        tolerance: of a step's error.
        result: `successful`, or why the motion cannot begin.
    """

    system: System
    state: State
    times: Float[Array, " times"]
    step: Scalar
    tolerance: Scalar
    result: RESULTS


def begin(
    mechanism: Mechanism,
    times: Float[Array, " times"],
    loads,
    drives,
    joints: ConstraintSet,
    moved: Poses,
    given: Poses | None,
    energies: bool,
    places: DofPartition,
    tolerance: Scalar,
    step: Scalar | None,
    needs_rates: bool,
) -> Beginning:
    """Set up the equations of a motion and check that it can begin.

    Args:
        mechanism: its bodies and hinges.
        times: at which the motion is reported; s.
        loads: on its bodies, or a function of time.
        drives: of its coordinates, or a function of time.
        joints: its constraints.
        moved: displacements at the start; rad, m, m.
        given: velocities at the start, if any; rad/s, m/s, m/s.
        energies: whether work and dissipation are integrated too.
        places: of the free and of the driven coordinates.
        tolerance: of a step's error.
        step: length of all steps, if it is constant; s.
        needs_rates: whether accelerations at the start are checked here, because the
            solver does not do it.
    """
    inertia = mechanism.inertia().reshape(-1)
    system = System(
        mechanism=mechanism,
        loads=loads,
        drives=drives,
        joined=joints,
        inertia=jnp.where(jnp.isinf(inertia), 0.0, inertia),
        length=jnp.ones(()),
        period=jnp.ones(()),
        still=moved.reshape(-1),
        places=places,
    )
    place = moved.reshape(-1)[system.free]
    length, period, first = _scales(system, moved, times[-1] - times[0])
    system = eqx.tree_at(
        lambda system: (system.length, system.period), system, (length, period)
    )
    rate = jnp.zeros_like(place)
    if given is not None:
        rate = given.reshape(-1)[system.free]

    settings = [tolerance] if step is None else [tolerance, step]
    positive = jnp.all(jnp.stack([setting > 0 for setting in settings]))
    checks = [
        (_all_finite(times, place, rate, *settings) & positive, RESULTS.not_finite),
        (~jnp.any(jnp.diff(times) <= 0), RESULTS.times_not_increasing),
    ]
    where, _, _ = system.driving(times[0])
    apart = jnp.abs(where - moved.reshape(-1)[np.array(places.driven, int)])
    unit = jnp.where(np.array(places.driven, int) % 3 == 0, 1.0, system.length)
    checks.append((~jnp.any(apart > EXACT * unit), RESULTS.drive_jumps))
    checks.append((~_gives_energy(mechanism), RESULTS.damping_gives_energy))
    if joints.size:
        consistent, place, rate = _consistent(
            system, times[0], place, rate, given is not None
        )
        checks.append((consistent, RESULTS.inconsistent_constraints))
    values = [where, place, rate]
    if needs_rates:
        values.append(system.instant(times[0], place, rate).acceleration)
    # what a drive or a constraint has brought in
    checks.append((_all_finite(*values), RESULTS.not_finite))
    result = RESULTS.successful
    for fine, item in reversed(checks):
        result = RESULTS.where(fine, result, item)
    can = result == RESULTS.successful
    works = jnp.zeros(3 if energies else 0)
    return Beginning(
        system=system,
        state=State(jnp.where(can, place, 0.0), jnp.where(can, rate, 0.0), works),
        times=jnp.where(can, times, 0.0),
        step=jnp.where(can, first if step is None else step, 1.0),
        tolerance=jnp.where(can, tolerance, 1.0),
        result=result,
    )


def _scales(
    system: System, moved: Poses, longest: Array
) -> tuple[Scalar, Scalar, Scalar]:
    """Scales of a motion, by which errors and the first step are measured.

    Args:
        system: equations of motion.
        moved: displacements at the start; rad, m, m.
        longest: how long the motion lasts; s.

    Returns:
        The length of a lever: of the hinges' distances from the origins of bodies that
        move, or, where these are zero, of the rotational against the translational
        stiffness; m.
        Nearly the periods of the slowest and of the fastest vibration, over two pi, by
        the sums of the squares of all periods and frequencies; s.
    """
    system, moved, longest = undifferentiated((system, moved, longest))
    # the function of a step's tangent, so that it is traced once
    hinge_assembly, mass = system.mechanism.hinge_assembly, system.mass
    stretches = hinge_assembly.stretches(moved)
    still = jnp.zeros_like(moved)
    stiffness = hinge_assembly.tangent_in_motion(
        moved, still, system.places.free, stretches
    ).stiffness
    diagonal = jnp.diagonal(stiffness)
    turns = system.free % 3 == 0
    turning, shifting = (jnp.sum(jnp.where(k, diagonal, 0.0)) for k in (turns, ~turns))
    lever, stiff = hinge_assembly.lever(system.places.free), jnp.sqrt(turning / shifting)
    # a lever of rounding errors is none
    length = jnp.where(jnp.isfinite(stiff) & (lever <= 1e-9 * stiff), stiff, lever)
    slowest = jnp.sum(jnp.diagonal(inverse(stiffness)) * mass)
    fastest = jnp.sum(diagonal / mass)
    # where nothing holds a body, no period but that of the motion itself
    slowest = jnp.where((slowest > 0) & (slowest < longest**2), slowest, longest**2)
    fastest = jnp.where(fastest > 1 / longest**2, fastest, 1 / longest**2)
    periods = jnp.sqrt(slowest), 1 / jnp.sqrt(fastest)
    return _finite(length), _finite(periods[0]), _finite(periods[1])


def _all_finite(*values: Array) -> Bool[Array, ""]:
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(value)) for value in values]))


def _finite(value: Array) -> Array:
    # what is not finite is told by the motion itself
    return jnp.where(jnp.isfinite(value) & (value > 0), value, 1.0)


def _gives_energy(mechanism: Mechanism) -> Array:
    wrong = jnp.zeros((), bool)
    for stack in mechanism.hinge_assembly.groups:
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
    system: System, time: Array, place: Array, rate: Array, given: bool
) -> tuple[Array, Array, Array]:
    """Check the start against the constraints, and project it onto them.

    Each entry of the violation is divided by its largest change when the mechanism moves
    by one of its own lengths or turns by 1 rad, so that no unit matters. Velocities that
    are given must be allowed themselves; others are projected.

    Args:
        system: equations of motion.
        time: s.
        place: displacements of the free coordinates; rad, m.
        rate: of the displacements; rad/s, m/s.
        given: whether the velocities were given.

    Returns:
        Whether the start is allowed; the nearest allowed displacements; and the nearest
        allowed velocities.
    """
    normals = system.normals(time, place)
    violation = system.violation(time, place)
    nearest, allowed = system.project(time, place, rate)
    unit = jnp.where(system.free % 3 == 0, 1.0, system.length)
    scaled = normals * unit[None]
    size = jnp.linalg.norm(scaled, axis=1, keepdims=True)
    largest = jnp.max(jnp.abs(inverse((scaled / size) @ (scaled / size).T)))
    apart = (largest < 1e12) & (normals.shape[0] <= normals.shape[1])
    met = jnp.max(jnp.abs(violation) / size[:, 0]) <= EXACT
    if given:
        across = jnp.linalg.norm((allowed - rate) / unit)
        met &= across <= _ALONG * jnp.linalg.norm(rate / unit)
    # what is not finite is reported as such
    seen = jnp.all(jnp.isfinite(normals)) & jnp.all(jnp.isfinite(violation))
    return (met & apart) | ~seen, nearest, allowed
