"""Initial state of a motion, and the checks that it can start."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.pytrees import stop_gradient
from ..._utils.types import Count, Flag, Poses, Scalar, Wrenches
from ...linalg.block_factors import BlockInverses
from ...linalg.elimination import inverse
from ...mechanism.changes import HingeChanges
from ...mechanism.constraints import ConstraintSet
from ...mechanism.mechanism import Mechanism
from ...results.codes import RESULTS
from ..equations.consistency import consistent_rows, LARGEST_INITIAL_VIOLATION
from ..equations.dofs import DofPartition
from .system import MotionSystem, State


# Velocities that violate the constraints are rounding errors if they are at most this
# fraction of all velocities.
_LARGEST_VELOCITY_VIOLATION = 1e-6


class InitialValueProblem(NamedTuple):
    """The initial value problem of a motion.

    If the motion cannot start, the state and the times are zero, so the solver takes no
    step, and the other motions of a batch are not delayed.
    """

    system: MotionSystem  # Equations of motion
    state: State  # State at the first time
    times: Float[Array, " times"]  # Times at which the motion is reported; s
    step: Scalar  # Length of the first step; s
    tolerance: Scalar  # Tolerance on the error of a step
    result: RESULTS  # `successful`, or the reason why the motion cannot start


def initial_value_problem(
    mechanism: Mechanism,
    inertia: Wrenches,
    times: Float[Array, " times"],
    loads,
    drives,
    changes: HingeChanges | None,
    constraints: ConstraintSet,
    start: Poses,
    velocities: Poses | None,
    energies: bool,
    dofs: DofPartition,
    tolerance: Scalar,
    step: Scalar | None,
    check_accelerations: bool,
    time_count: Count,
    saved_times: Array | None,
) -> InitialValueProblem:
    """Set up the equations of a motion and check that it can start.

    The arguments are those of `simulate`, converted to arrays: `start` has displacements
    (rad, m, m), and `velocities` a row for each body (rad/s, m/s, m/s). Only the first
    `time_count` of the times are given; the last one is repeated after them. The times at
    which a motion is saved instead are those of `saveat`; s. The accelerations at the
    start are checked only on request, because some solvers check them as well.
    """
    inertia = inertia.reshape(-1)
    system = MotionSystem(
        mechanism=mechanism,
        loads=loads,
        drives=drives,
        changes=changes,
        constraints=constraints,
        inertia=jnp.where(jnp.isinf(inertia), 0.0, inertia),
        length=jnp.ones(()),
        period=jnp.ones(()),
        dofs=dofs,
    )
    position = start.reshape(-1)[system.free]
    length, period, first = _scales(system, start, times[0], times[-1] - times[0])
    system = eqx.tree_at(
        lambda system: (system.length, system.period), system, (length, period)
    )
    rate = jnp.zeros_like(position)
    if velocities is not None:
        rate = velocities.reshape(-1)[system.free]

    settings = [tolerance] if step is None else [tolerance, step]
    positive = jnp.all(jnp.stack([setting > 0 for setting in settings]))
    checks = [
        (_all_finite(times, position, rate, *settings) & positive, RESULTS.not_finite),
    ]
    late = (jnp.diff(times) <= 0) & (np.arange(1, len(times)) < time_count)
    checks.append((~jnp.any(late), RESULTS.times_not_increasing))
    if saved_times is not None:
        within = (saved_times >= times[0]) & (saved_times <= times[-1])
        ordered = jnp.all(jnp.diff(saved_times) >= 0) & jnp.all(within)
        checks.append((ordered, RESULTS.times_not_increasing))
    targets, _, _ = system.prescribed(times[0])
    prescribed = np.array(dofs.prescribed, int)
    jump = jnp.abs(targets - start.reshape(-1)[prescribed])
    unit = jnp.where(prescribed % 3 == 0, 1.0, system.length)
    jumps = jnp.any(jump > LARGEST_INITIAL_VIOLATION * unit)
    checks.append((~jumps, RESULTS.drive_jumps))
    checks.append((~_supplies_energy(mechanism), RESULTS.damping_gives_energy))
    if constraints.size:
        consistent, position, rate = _consistent(
            system, times[0], position, rate, velocities is not None
        )
        checks.append((consistent, RESULTS.inconsistent_constraints))
    values = [targets, position, rate]
    if check_accelerations:
        values.append(system.instant(times[0], position, rate).acceleration)
    # Prescribed motions and constraints may have values that are not finite.
    checks.append((_all_finite(*values), RESULTS.not_finite))
    result = RESULTS.successful
    for passed, item in reversed(checks):
        result = RESULTS.where(passed, result, item)
    starts = result == RESULTS.successful
    work_count = 3 if changes is None else 4
    works = jnp.zeros(work_count if energies else 0)
    position, rate = (jnp.where(starts, value, 0.0) for value in (position, rate))
    return InitialValueProblem(
        system=system,
        state=State(position, rate, works),
        times=jnp.where(starts, times, 0.0),
        step=jnp.where(starts, first if step is None else step, 1.0),
        tolerance=jnp.where(starts, tolerance, 1.0),
        result=result,
    )


def _scales(
    system: MotionSystem, start: Poses, time: Array, duration: Array
) -> tuple[Scalar, Scalar, Scalar]:
    """Compute a length (m) and two times (s) that scale errors and the first step.

    The length is the root mean square distance of the hinges from the origins of bodies
    that move. If this is zero, it is the square root of rotational over translational
    stiffness. The times are estimates of the periods of the slowest and of the fastest
    vibration, divided by two pi. They follow from the sums of the squares of all periods
    and of all frequencies at the start (at `time`; s), and are limited by the `duration`
    of the motion (s).
    """
    system, start, time, duration = stop_gradient((system, start, time, duration))
    # The steps of the solver call the same function, so that it is traced once.
    hinges, mass = system.hinges(time), system.mass
    translations = hinges.translations(start)
    no_velocities = jnp.zeros_like(start)
    free, layout = system.dofs.free, system.layout
    tangent = hinges.tangent_in_motion(start, no_velocities, free, translations, layout)
    stiffness = tangent.stiffness
    if layout is None:
        diagonal, compliance = jnp.diagonal(stiffness), jnp.diagonal(inverse(stiffness))
    else:
        diagonal = layout.diagonal(stiffness)
        compliance = BlockInverses.of(stiffness, layout).diagonal()
    rotations = system.free % 3 == 0
    rotational, translational = (
        jnp.sum(jnp.where(chosen, diagonal, 0.0)) for chosen in (rotations, ~rotations)
    )
    distance = hinges.characteristic_length(system.dofs.free)
    ratio = jnp.sqrt(rotational / translational)
    # A distance that consists of rounding errors is not used.
    length = jnp.where(jnp.isfinite(ratio) & (distance <= 1e-9 * ratio), ratio, distance)
    slowest = jnp.sum(compliance * mass)
    fastest = jnp.sum(diagonal / mass)
    # Without stiffness there is no period, and the duration replaces it.
    limited = (slowest > 0) & (slowest < duration**2)
    slowest = jnp.where(limited, slowest, duration**2)
    fastest = jnp.where(fastest > 1 / duration**2, fastest, 1 / duration**2)
    scales = length, jnp.sqrt(slowest), 1 / jnp.sqrt(fastest)
    # Values that are not finite are reported by the motion.
    length, slowest, fastest = (
        jnp.where(jnp.isfinite(scale) & (scale > 0), scale, 1.0) for scale in scales
    )
    return length, slowest, fastest


def _all_finite(*values: Array) -> Flag:
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(value)) for value in values]))


def _supplies_energy(mechanism: Mechanism) -> Flag:
    """Decide whether a damping matrix has a negative eigenvalue, by its minors."""
    negative = jnp.zeros((), bool)
    for group in mechanism.hinge_assembly.groups:
        if group.damping is not None:
            matrix = jax.lax.stop_gradient(group.damping.damping).reshape(-1, 3, 3)
            size = jnp.sqrt(jnp.abs(jnp.diagonal(matrix, axis1=1, axis2=2)))
            size = jnp.where(size > 0, size, 1.0)
            scaled = matrix / (size[:, :, None] * size[:, None])
            a, b, c = scaled[:, 0, 1], scaled[:, 0, 2], scaled[:, 1, 2]
            x, y, z = jnp.diagonal(scaled, axis1=1, axis2=2).T
            minors = [x, y, z, x * y - a * a, x * z - b * b, y * z - c * c]
            determinant = x * y * z + 2 * a * b * c - x * c * c - y * b * b - z * a * a
            negative |= jnp.any(jnp.stack([*minors, determinant]) < -1e-9)
    return negative


def _consistent(
    system: MotionSystem, time: Array, position: Array, rate: Array, given: bool
) -> tuple[Flag, Array, Array]:
    """Check the initial state against the constraints, and project it onto them.

    Displacements are divided by a length of the mechanism; see `consistent_rows`.
    Velocities that are `given` must satisfy the constraints; others are projected.
    """
    jacobian = system.jacobian(time, position)
    violation = system.violation(time, position)
    projected_position, projected_rate = system.project(time, position, rate)
    unit = jnp.where(system.free % 3 == 0, 1.0, system.length)
    consistent = consistent_rows(jacobian * unit[None], violation)
    if given:
        error = jnp.linalg.norm((projected_rate - rate) / unit)
        largest = _LARGEST_VELOCITY_VIOLATION * jnp.linalg.norm(rate / unit)
        consistent &= ~(error > largest)  # true for errors that are not finite
    return consistent, projected_position, projected_rate
