"""Stable states of a bistable mechanism, and the loads between which it snaps."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._compile.compilation import fast_compile
from .._utils.host import is_traced
from .._utils.progress import announced
from .._utils.pytrees import stop_gradient
from .._utils.types import Count, Flag, NumberLike, Pose, Scalar
from .._utils.validation import require_positive
from ..linalg.elimination import solve
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Drive, Load
from ..mechanism.mechanism import Mechanism
from ..results.codes import finish, RESULTS, Solution
from ..results.solutions import BodyPoses
from .continuation.arc_length import Metric, NOT_FINITE, Step
from .continuation.critical_points import differentiable_critical_points, null_vectors
from .continuation.diagnosis import path_message
from .continuation.location import locate, Segment
from .continuation.points import differentiable_points, negative_eigenvalues, point_values
from .continuation.program import (
    path_result,
    PathRun,
    refine_path,
    run_path,
    run_refined,
)
from .continuation.setup import assemble_path, check_settings, first_displacements
from .continuation.solution import CriticalPoint
from .continuation.start import FirstPoint, metric_of
from .continuation.system import PathSystem, PathTangent
from .equations.dofs import DofPartition
from .equations.problem import Problem
from .equations.state import warn_outside_linear_range
from .statics.solution import StateLike


_MAX_CRITICAL = 10  # critical points of a path that are located
_CORRECTIONS = 12  # of a state without prescribed displacements
_CORRECTED = 1e-9  # largest last correction that is accepted
_SAME_STATE = 1e-6  # largest distance of states that are equal
# The second state may be at the full prescribed displacements.
_FARTHER = 1 + 1e-6


class Bistability(Solution, BodyPoses):
    """Equilibria without the multiplied loads, and the loads at which a mechanism snaps.

    The states are the first stable equilibrium, the unstable one, and the second stable
    one. Values that do not exist are NaN. They have derivatives with respect to the
    mechanism and its loads.

    Args:
        is_bistable: Whether the path has a second stable equilibrium. If not, there may
            be one beyond the full loads, or on another path that crosses this one at a
            branch point.
        displacements: Displacements of the bodies in the three states; rad, m, m.
        reference: Poses from which displacements are measured; rad, m, m.
        energies: Energies in the three states: those stored in the hinges, minus the work
            of the constant loads; J.
        negative_eigenvalues: Number of negative eigenvalues of the stiffness in the three
            states; -1 if a state does not exist.
        snap_factors: Load factor at which the first state becomes unstable, and that at
            which the second one does. If it is bistable, the second one is negative: it
            needs loads in the opposite direction. A mechanism under prescribed
            displacements that has no critical point is switched at its unstable state,
            where the drive force changes its sign.
        at_branch: Whether each of them is a branch point, at which a symmetric mechanism
            leaves the path to a side, and not a limit point.
        result: Reason of the end of the path, or `RESULTS.successful` if the second state
            was found before; `result_names` returns its name.
        names: Names of the bodies.
        range_shares: Displacement or axial force of each hinge in the three states,
            divided by the one at which it errs by 5 %, as those of an `Equilibrium`; None
            if all hinges have validity ranges.
    """

    is_bistable: Bool[Array, "*batch"]
    displacements: Float[Array, "*batch 3 bodies 3"]
    reference: Float[Array, "*batch bodies 3"]
    energies: Float[Array, "*batch 3"]
    negative_eigenvalues: Int[Array, "*batch 3"]
    snap_factors: Float[Array, "*batch 2"]
    at_branch: Bool[Array, "*batch 2"]
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)
    range_shares: Float[Array, "*batch 3 hinges"] | None = None
    _plural: ClassVar[str] = "mechanisms"

    @property
    def barriers(self) -> Float[Array, "*batch 2"]:
        """Energy of the unstable state above the first and above the second one; J.

        If the path has branch points, it is only an upper bound of the energy barrier:
        the mechanism may move around the unstable state of the path.
        """
        first, middle, second = jnp.moveaxis(self.energies, -1, 0)
        return jnp.stack([middle - first, middle - second], axis=-1)

    def travel(self, body: str) -> Pose:
        """Return the displacement of a body from the first to the second stable state.

        Args:
            body: Name of the body.

        Returns:
            Angle, x, and y; rad, m, m.

        Raises:
            ValueError: There is no body of this name.
        """
        states = self.displacement(body)
        return states[..., 2, :] - states[..., 0, :]

    def _batch_summary(self, names: np.ndarray) -> str:
        count = np.sum(self.is_bistable)
        return f"{super()._batch_summary(names)}, {count:,} of them bistable"

    def _summary(self, names: np.ndarray) -> str:
        bistable, at_branch, negative = (
            np.asarray(values)
            for values in (self.is_bistable, self.at_branch, self.negative_eigenvalues)
        )
        factors, energies = np.asarray(self.snap_factors), np.asarray(self.energies)
        if not self.succeeded:
            return f"no second stable state was found: {names}"
        if np.isnan(factors[0]):
            return (
                "monostable up to the full loads and drives: no limit or branch point; "
                "larger ones, or others in another direction, may show a second state"
            )
        forth, back = (
            f"{factor:.6g}{' (branch point)' if branch else ''}"
            for factor, branch in zip(factors, at_branch, strict=True)
        )
        lines = [
            "bistable"
            if bistable
            else "not bistable up to the full loads and drives, but it snaps"
        ]
        if at_branch[0] and not bistable:
            lines = [
                "no second stable state on this symmetric path; after the branch point, "
                "the mechanism leaves it: add a small constant load that is not symmetric"
            ]
        back = "" if np.isnan(factors[1]) else f", back at {back}"
        lines.append(f"snaps at the load factor {forth}{back}")
        if bistable:
            first, second = (energies[1] - energies[k] for k in (0, 2))
            lowest = negative[1] == 1 and not at_branch.any()
            bound = "energy barrier" if lowest else "energy barrier at most"
            lines.append(
                f"{bound} {first:.6g} J from the first state, {second:.6g} J from the "
                "second one"
            )
        return "\n".join(lines)


@announced("bistability")
def bistability(
    mechanism: Mechanism,
    *,
    loads: Sequence[Load] = (),
    drives: Sequence[Drive] = (),
    constant_loads: Sequence[Load] = (),
    constraints: Sequence[AbstractConstraint] = (),
    start: StateLike | None = None,
    direction: int = 1,
    largest_step: float = 0.1,
    max_points: int = 500,
    time: NumberLike = 0.0,
    throw: bool = True,
) -> Bistability:
    """Find the second stable state of a mechanism, and the loads at which it snaps.

    The path of the equilibria is followed from the first state until the loads reach
    their full magnitude, or their opposite; see `path`. Their magnitude must be larger
    than that at which the mechanism snaps: a mechanism that is monostable up to the full
    loads may snap under larger ones, or under loads in another direction.

    Without loads, the mechanism is switched by prescribed displacements. The states are
    then those without drive force, to which the mechanism moves if the drive is released.

    Args:
        mechanism: The mechanism.
        loads: Loads by which the mechanism is switched.
        drives: Prescribed displacements that are multiplied together with the loads. If
            there are no loads, they are measured from the first state, and must reach the
            second one.
        constant_loads: Loads that always act, such as weights.
        constraints: Pins, sliders, and other constraints between the bodies.
        start: Equilibrium or poses from which the first state is computed; by default
            that which is connected to the reference configuration.
        direction: 1 to begin with increasing loads, -1 with loads in the opposite
            direction.
        largest_step: Largest distance of successive points; see `path`.
        max_points: Largest number of points of the path.
        time: Time at which time-dependent constraints are evaluated; s.
        throw: Whether a failure raises an error; otherwise it is reported by `result`.

    Returns:
        The states and the load factors. They are NaN if the path does not reach them.

    Raises:
        ValueError: An argument is invalid; see `path`.
        RuntimeError: There is no first equilibrium, or the path ended before the second
            one was found and before the full loads; see `path`.

    Example:
        >>> import twistorjax as tj
        >>> length, angle = np.hypot(1.0, 0.3), np.arctan2(0.3, 1.0)
        >>> bar = tj.energies.AxialSpring(1000.0, length=length)
        >>> bodies = [tj.Body("wall"), tj.Body("apex", pose=(0.0, 0.0, 0.3))]
        >>> left = tj.Hinge("left", "wall", "apex", bar, at=(angle, -0.5, 0.15))
        >>> right = tj.Hinge("right", "apex", "wall", bar, at=(-angle, 0.5, 0.15))
        >>> fixed = {"wall": ["angle", "x", "y"], "apex": ["angle"]}
        >>> truss = tj.Mechanism(bodies, [left, right], fixed=fixed)
        >>> switch = bistability(truss, loads=[tj.Load("apex", force=(0.0, -20.0))])
        >>> switch.travel("apex")[2].round(6)  # twice the rise
        Array(-0.6, dtype=float64)
        >>> switch.snap_factors
        Array([ 0.4975, -0.4975], dtype=float64)
    """
    check_settings(direction, (-1.0, 1.0), max_points)
    if isinstance(start, CriticalPoint):
        raise ValueError(
            "`start` is a critical point, but must be an equilibrium without the "
            "multiplied loads: the first state."
        )
    if not loads and not drives:
        raise ValueError("Nothing is multiplied by the load factor. Give `loads`.")
    step = require_positive("`largest_step`", largest_step)
    by_drives, begin = not loads, None
    if by_drives:
        undriven = Problem.of(mechanism, (), (), constraints, time)
        begin = first_displacements(undriven, constant_loads, start)
    system, first = assemble_path(
        mechanism, loads, drives, {}, None, constant_loads, constraints, start,
        direction, time, begin,
    )  # fmt: skip
    limits = np.array([-1.0, 1.0]) * (_FARTHER if by_drives else 1.0)
    arguments = system, first, jnp.asarray(limits), step, None
    # Outside of programs, their numbers are known also if JAX differentiates.
    constants = stop_gradient(arguments)
    if is_traced(constants):
        numbers = max_points, max_points, _MAX_CRITICAL
        return _solve(system, first, by_drives, *arguments[2:], *numbers)
    run = run_refined(*constants, max_points=max_points, max_critical=_MAX_CRITICAL)
    found = _evaluate(system, run, first.direction, by_drives)
    if throw:
        warn_outside_linear_range(mechanism, found.range_shares)

    def error(item: str, batch_index: tuple[int, ...]) -> Exception:
        del batch_index
        return RuntimeError(
            f"No second stable state was found. {path_message(item, constants[0], run)}"
        )

    return finish(found, throw, error)


@fast_compile
def _solve(
    system: PathSystem, first: FirstPoint, by_drives: bool, *arguments: Any
) -> Bistability:
    """Compute the result of `bistability`, inside another program."""
    run = refine_path(system, run_path(system, first, *arguments))
    return _evaluate(system, run, first.direction, by_drives)


@partial(fast_compile, optimize=False)  # runs for milliseconds
def _evaluate(
    system: PathSystem, run: PathRun, direction: Scalar, by_drives: bool
) -> Bistability:
    """Compute the states and the loads of a path, and give them derivatives.

    `by_drives` is whether the mechanism is switched by prescribed displacements only.
    """
    fixed, metric, path_system = stop_gradient(system), run.metric, system
    states, found, rows = _unloaded_points(fixed, run, direction, by_drives)
    lost = jnp.zeros((), bool)
    if by_drives:
        system = _released(system)
        states, metric, converged = _released_points(fixed, states)
        fixed, lost = stop_gradient(system), found[2] & ~converged[2]
        found &= converged
    at_zero_load = jnp.zeros_like(states).at[:, -1].set(1.0)
    states = differentiable_points(system, states, at_zero_load)
    values = point_values(system, states)
    negative = negative_eigenvalues(fixed, metric, jax.lax.stop_gradient(states))
    work = jax.vmap(system.constant_loads.work)(values.displacements)
    energies = values.energy - work
    known = found[:, None, None]
    middle = jnp.array(jnp.nan)
    if by_drives:
        change = (values.displacements[1] - path_system.start).reshape(-1)
        change = change[np.array(path_system.dofs.prescribed, int)]
        targets = path_system.targets
        middle = jnp.where(found[1], change @ targets / (targets @ targets), jnp.nan)
    snap_factors, at_branch = _snap_factors(path_system, run, direction, rows, middle)
    bistable = found[2] & (negative[0] == 0) & (negative[2] == 0)
    result = RESULTS.where(found[2], RESULTS.successful, path_result(run.trace))
    result = RESULTS.where(lost, RESULTS.no_equilibrium, result)
    shares = values.range_shares
    if shares is not None:
        shares = jnp.where(found[:, None], shares, jnp.nan)
    return Bistability(
        is_bistable=bistable,
        displacements=jnp.where(known, values.displacements, jnp.nan),
        reference=system.mechanism.reference,
        energies=jnp.where(found, energies, jnp.nan),
        negative_eigenvalues=jnp.where(found, negative, -1),
        snap_factors=snap_factors,
        at_branch=at_branch,
        result=result,
        names=system.mechanism.names,
        range_shares=shares,
    )


def _unloaded_points(
    system: PathSystem, run: PathRun, sign: Scalar, by_drives: bool
) -> tuple[Float[Array, "3 n"], Bool[Array, "3"], Float[Array, "2"]]:
    """Find the points of a path at the load factor zero, and whether they exist.

    Under prescribed displacements only, they are the points without drive force. The last
    result has the rows of the path after which the unstable state and the second stable
    one are, infinite if they do not exist; a half is added behind a limit point in the
    same interval.
    """
    trace, criticals, metric = run.trace, run.criticals, run.metric

    def value_at(point: Float[Array, " n"]) -> Scalar:
        return system.drive_force(point) if by_drives else point[-1]

    # Between two successive points of a path, or of its limit points, the load factor
    # increases or decreases, so that there is at most one state. The drive force has
    # other extreme values.
    rows, indices = jnp.arange(len(trace.points)), jnp.arange(len(criticals.points))
    is_limit = (indices < criticals.number) & ~criticals.is_branch
    keys = jnp.concatenate(
        [
            jnp.where(rows < trace.number, rows.astype(float), jnp.inf),
            jnp.where(is_limit, criticals.rows.astype(float) + 0.5, jnp.inf),
        ]
    )
    points = jnp.concatenate([trace.points, criticals.points])
    if by_drives:
        key, point = _least_force(system, run, value_at)
        keys, points = jnp.append(keys, key), jnp.concatenate([points, point[None]])
    order = jnp.argsort(keys)
    keys, points = keys[order], points[order]
    factors, used = sign * jax.vmap(value_at)(points), jnp.isfinite(keys[1:])

    def first_row(crossing: Array, after: Count) -> tuple[Count, Flag]:
        crossing = crossing & used & (jnp.arange(len(used)) > after)
        return jnp.argmax(crossing), jnp.any(crossing)

    decreasing = (factors[:-1] > 0) & (factors[1:] <= 0)
    down, has_down = first_row(decreasing, jnp.zeros((), int))
    up, has_up = first_row((factors[:-1] < 0) & (factors[1:] >= 0), down)

    def state_after(row: Count) -> Float[Array, " n"]:
        ends = jax.lax.dynamic_slice_in_dim(points, row, 2)
        point = _root_between(system, metric, ends, value_at)
        return point if by_drives else point.at[-1].set(0.0)

    middle, second = jax.vmap(state_after)(jnp.stack([down, up]))
    found = jnp.stack([trace.number > 0, has_down, has_down & has_up])
    found &= trace.status != NOT_FINITE
    states = jnp.stack([trace.points[0], middle, second])
    rows = jnp.where(found[1:], keys[jnp.stack([down, up])], jnp.inf)
    return jnp.where(found[:, None], states, trace.points[:1]), found, rows


def _least_force(
    system: PathSystem, run: PathRun, value_at: Callable[[Array], Scalar]
) -> tuple[Scalar, Float[Array, " n"]]:
    """Return a point at which the drive force is least, between two points of the path.

    The first result is its row, increased by a half; infinite if there is none.
    """
    trace, metric = run.trace, run.metric

    def force_and_rate(point: Array, tangent: Array) -> tuple[Scalar, Scalar]:
        return jax.jvp(value_at, (point,), (metric.units * tangent,))

    forces, rates = jax.vmap(force_and_rate)(trace.points, trace.tangents)
    sizes, growth = jnp.abs(forces), jnp.sign(forces) * rates
    least = (forces[:-1] * forces[1:] > 0) & (growth[:-1] < 0) & (growth[1:] > 0)
    least &= np.arange(len(least)) + 1 < trace.number
    row = jnp.argmin(jnp.where(least, jnp.minimum(sizes[:-1], sizes[1:]), jnp.inf))
    segment = Segment(
        jax.lax.dynamic_slice_in_dim(trace.points, row, 2),
        jax.lax.dynamic_slice_in_dim(trace.tangents, row, 2),
    )

    def function(point: Array, _: PathTangent, step: Step) -> tuple[Scalar, Array]:
        return force_and_rate(point, step.tangent)[1], point[:0]

    ends = jax.lax.dynamic_slice_in_dim(rates, row, 2)
    nothing = trace.points[0, :0]
    exists = least[row]
    root = locate(system, metric, segment, function, ends, nothing, exists, ~exists)
    return jnp.where(exists, row.astype(float) + 0.5, jnp.inf), root.point


def _root_between(
    system: PathSystem,
    metric: Metric,
    ends: Float[Array, "2 n"],
    function: Callable[[Float[Array, " n"]], Scalar],
) -> Float[Array, " n"]:
    """Compute the equilibrium at which a function is zero between two points."""
    chord = (ends[1] - ends[0]) / metric.units
    chord = chord / metric.length(chord)
    segment = Segment(ends, jnp.stack([chord, chord]))
    values = jnp.stack([function(end) for end in ends])
    return locate(
        system, metric, segment, lambda point, *_: (function(point), point[:0]), values,
        ends[0, :0], jnp.array(True),
    ).point  # fmt: skip


def _released(system: PathSystem) -> PathSystem:
    """Return the equations of a mechanism without its prescribed displacements."""
    dofs, targets = DofPartition.of(system.mechanism), jnp.zeros(0)
    return replace(system, dofs=dofs, targets=targets)


def _released_points(
    system: PathSystem, states: Float[Array, "3 n"]
) -> tuple[Float[Array, "3 m"], Metric, Bool[Array, "3"]]:
    """Compute the equilibria without prescribed displacements near points of a path.

    The other results are their metric, and whether they were found.
    """
    released = _released(system)

    def released_point(state: Float[Array, " n"]) -> Float[Array, " m"]:
        _, displacements, multipliers = system.split(state)
        free = displacements.reshape(-1)[np.array(released.dofs.free, int)]
        return jnp.concatenate([free, multipliers, jnp.zeros(1)])

    points = jax.vmap(released_point)(states)
    metric = metric_of(released, released.tangent(points[0]), points[0])

    def correct(_, state: tuple[Array, Scalar]) -> tuple[Array, Scalar]:
        tangent = released.tangent(state[0])
        change = jnp.append(-solve(tangent.jacobian, tangent.residual), 0.0)
        return state[0] + change, metric.length(change / metric.units)

    def corrected(point: Float[Array, " m"]) -> tuple[Array, Scalar]:
        return jax.lax.fori_loop(0, _CORRECTIONS, correct, (point, jnp.zeros(())))

    points, changes = jax.vmap(corrected)(points)
    distances = jax.vmap(metric.length)((points - points[:1]) / metric.units[None])
    moved = (distances > _SAME_STATE) | (np.arange(3) == 0)
    return points, metric, (changes <= _CORRECTED) & moved


def _snap_factors(
    system: PathSystem,
    run: PathRun,
    sign: Scalar,
    states: Float[Array, "2"],
    middle: Scalar,
) -> tuple[Float[Array, "2"], Bool[Array, "2"]]:
    """Return the load factors at which the first and the second state become unstable.

    They are the first critical point, and the last one before the second state, or before
    the end of the path. Prescribed displacements switch a mechanism at the load factor of
    its unstable state, `middle`, if there is no critical point before. `states` are the
    rows of the unstable state and of the second stable one.
    """
    end = states[1]
    criticals, indices = run.criticals, jnp.arange(len(run.criticals.points))
    rows = criticals.rows.astype(float)
    before = (rows < end) | (sign * criticals.points[:, -1] < 0)
    before &= (rows <= end) & (indices < criticals.number)
    last = jnp.sum(before) - 1
    chosen = jnp.stack([jnp.zeros_like(last), jnp.maximum(last, 0)])
    # Further critical points may not have been located.
    complete = criticals.number < len(indices)
    complete |= last < criticals.number - 1
    found = jnp.stack([last >= 0, (last > 0) & complete])
    at = jnp.where(found[:, None], criticals.points[chosen], run.trace.points[:1])
    at_branch = criticals.is_branch[chosen] & found
    null = null_vectors(
        stop_gradient(system), run.metric, at, at_branch, criticals.multiplicities[chosen]
    )
    at = differentiable_critical_points(system, run.metric, at, at_branch, null)
    around = rows[chosen] - states[0]
    switched = jnp.isfinite(middle) & ~(found & (around * np.array([1.0, -1.0]) <= 0))
    factors = jnp.where(switched, middle, jnp.where(found, at[:, -1], jnp.nan))
    return factors, at_branch & ~switched
