"""Stable states of a bistable mechanism, and the loads between which it snaps."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._utils.compilation import fast_compile
from .._utils.host import all_concrete, is_traced
from .._utils.pytrees import stop_gradient
from .._utils.types import BatchFlag, Count, Flag, NumberLike, Pose, Scalar
from .._utils.validation import index_of, require_positive
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Drive, Load
from ..mechanism.mechanism import Mechanism
from .continuation import Metric, NOT_FINITE
from .critical_points import null_vectors, with_derivatives
from .path import check_settings, path_message
from .path_location import locate, Segment
from .path_points import negative_eigenvalues, on_path, point_values
from .path_program import (
    path_result,
    PathRun,
    refine_path,
    refine_uncompiled,
    run_path,
    run_uncompiled,
)
from .path_results import CriticalPoint
from .path_setup import assemble_path, FirstPoint
from .path_system import PathSystem
from .results import (
    count_results,
    is_success,
    result_names,
    RESULTS,
    succeeded_or_raise,
)
from .static_results import StateLike, warn_outside_linear_range


_MAX_CRITICAL = 10  # critical points of a path that are located


class Bistability(eqx.Module):
    """Equilibria without the multiplied loads, and the loads at which a mechanism snaps.

    The states are the first stable equilibrium, the unstable one, and the second stable
    one. Values that do not exist are NaN. They have derivatives with respect to the
    mechanism and its loads.

    Args:
        is_bistable: Whether the path has a second stable equilibrium. If not, there may
            be one beyond the full loads.
        displacements: Displacements of the bodies in the three states; rad, m, m.
        energies: Energies in the three states: those stored in the hinges, minus the work
            of the constant loads; J.
        negative_eigenvalues: Number of negative eigenvalues of the stiffness in the three
            states; -1 if a state does not exist.
        snap_factors: Load factor at which the first state becomes unstable, and that at
            which the second one does. If it is bistable, the second one is negative: it
            needs loads in the opposite direction.
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
    energies: Float[Array, "*batch 3"]
    negative_eigenvalues: Int[Array, "*batch 3"]
    snap_factors: Float[Array, "*batch 2"]
    at_branch: Bool[Array, "*batch 2"]
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)
    range_shares: Float[Array, "*batch 3 hinges"] | None = None

    @property
    def succeeded(self) -> BatchFlag:
        """Whether the second state was found, or the path ended at the full loads."""
        return is_success(self.result)

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
        row = index_of("`body`", "body", body, self.names)
        return self.displacements[..., 2, row, :] - self.displacements[..., 0, row, :]

    def __repr__(self) -> str:
        known = all_concrete(
            [
                self.is_bistable,
                self.snap_factors,
                self.at_branch,
                self.energies,
                self.negative_eigenvalues,
            ]
        )
        names = result_names(self.result)
        if known is None or names is None:
            return eqx.tree_pformat(self)
        bistable, factors, at_branch, energies, negative = known
        if bistable.shape:
            title = count_results("mechanisms", names)
            return f"{title}, {np.sum(bistable):,} of them bistable"
        if not self.succeeded:
            return f"no second stable state was found: {names}"
        if np.isnan(factors[0]):
            return "monostable up to the full loads: no limit point or branch point"
        forth, back = (
            f"{factor:.6g}{' (branch point)' if branch else ''}"
            for factor, branch in zip(factors, at_branch, strict=True)
        )
        lines = ["bistable" if bistable else "not bistable, but it snaps"]
        lines.append(f"snaps at the load factor {forth}, back at {back}")
        if bistable:
            first, second = (energies[1] - energies[k] for k in (0, 2))
            lowest = negative[1] == 1 and not at_branch.any()
            bound = "energy barrier" if lowest else "energy barrier at most"
            lines.append(
                f"{bound} {first:.6g} J from the first state, {second:.6g} J from the "
                "second one"
            )
        return "\n".join(lines)


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

    Args:
        mechanism: The mechanism.
        loads: Loads by which the mechanism is switched.
        drives: Prescribed displacements that are multiplied together with the loads.
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
    system, first = assemble_path(
        mechanism, loads, drives, {}, None, constant_loads, constraints, start,
        direction, time,
    )  # fmt: skip
    arguments = system, first, jnp.array([-1.0, 1.0]), step
    numbers = None, max_points, _MAX_CRITICAL
    if is_traced(arguments):
        return _solve(*arguments, *numbers)
    run = run_path(*arguments, *numbers)
    if np.any(run.criticals.is_branch & (run.criticals.multiplicities == 1)):
        run = refine_path(system, run)
    found = _evaluate(system, run, first.direction)
    if not throw:
        return found
    warn_outside_linear_range(mechanism, found.range_shares)

    def error(item: str, batch_index: tuple[int, ...]) -> Exception:
        del batch_index
        return RuntimeError(
            f"No second stable state was found. {path_message(item, system, run)}"
        )

    return succeeded_or_raise(found, error)


def _solve_uncompiled(
    system: PathSystem, first: FirstPoint, *arguments: Any
) -> Bistability:
    """Compute the result of `bistability`, inside another program."""
    run = refine_uncompiled(system, run_uncompiled(system, first, *arguments))
    return _evaluate_uncompiled(system, run, first.direction)


def _evaluate_uncompiled(
    system: PathSystem, run: PathRun, direction: Scalar
) -> Bistability:
    """Compute the states and the loads of a path, and give them derivatives."""
    fixed = stop_gradient(system)
    states, found, end = _unloaded_points(fixed, run, direction)
    at_zero_load = jnp.zeros_like(states).at[:, -1].set(1.0)
    states = on_path(system, states, at_zero_load)
    values = point_values(system, states)
    negative = negative_eigenvalues(fixed, run.metric, jax.lax.stop_gradient(states))
    work = jax.vmap(system.constant_loads.work)(values.displacements)
    energies = values.energy - work
    known = found[:, None, None]
    snap_factors, at_branch = _snap_factors(system, run, direction, end)
    bistable = found[2] & (negative[0] == 0) & (negative[2] == 0)
    result = RESULTS.where(found[2], RESULTS.successful, path_result(run.trace))
    shares = values.range_shares
    if shares is not None:
        shares = jnp.where(found[:, None], shares, jnp.nan)
    return Bistability(
        is_bistable=bistable,
        displacements=jnp.where(known, values.displacements, jnp.nan),
        energies=jnp.where(found, energies, jnp.nan),
        negative_eigenvalues=jnp.where(found, negative, -1),
        snap_factors=snap_factors,
        at_branch=at_branch,
        result=result,
        names=system.mechanism.names,
        range_shares=shares,
    )


def _unloaded_points(
    system: PathSystem, run: PathRun, sign: Scalar
) -> tuple[Float[Array, "3 n"], Bool[Array, "3"], Scalar]:
    """Find the points of a path at the load factor zero, and whether they exist.

    The last result is the row of the path after which the second state is, or the last
    one; a half is added behind a limit point in the same interval.
    """
    trace, criticals = run.trace, run.criticals
    # Between two successive points of a path, or of its limit points, the load factor
    # increases or decreases, so that there is at most one state.
    rows, indices = jnp.arange(len(trace.points)), jnp.arange(len(criticals.points))
    is_limit = (indices < criticals.number) & ~criticals.is_branch
    keys = jnp.concatenate(
        [
            jnp.where(rows < trace.number, rows.astype(float), jnp.inf),
            jnp.where(is_limit, criticals.rows.astype(float) + 0.5, jnp.inf),
        ]
    )
    order = jnp.argsort(keys)
    keys, points = keys[order], jnp.concatenate([trace.points, criticals.points])[order]
    factors, used = sign * points[:, -1], jnp.isfinite(keys[1:])

    def first_row(crossing: Array, after: Count) -> tuple[Count, Flag]:
        crossing = crossing & used & (jnp.arange(len(used)) > after)
        return jnp.argmax(crossing), jnp.any(crossing)

    decreasing = (factors[:-1] > 0) & (factors[1:] <= 0)
    down, has_down = first_row(decreasing, jnp.zeros((), int))
    up, has_up = first_row((factors[:-1] < 0) & (factors[1:] >= 0), down)

    def state_after(row: Count) -> Float[Array, " n"]:
        ends = jax.lax.dynamic_slice_in_dim(points, row, 2)
        return _at_zero_load(system, run.metric, ends)

    middle, second = jax.vmap(state_after)(jnp.stack([down, up]))
    found = jnp.stack([trace.number > 0, has_down, has_down & has_up])
    found &= trace.status != NOT_FINITE
    states = jnp.stack([trace.points[0], middle, second])
    end = jnp.where(found[2], keys[up], jnp.inf)
    return jnp.where(found[:, None], states, trace.points[:1]), found, end


def _at_zero_load(
    system: PathSystem, metric: Metric, ends: Float[Array, "2 n"]
) -> Float[Array, " n"]:
    """Compute the equilibrium at the load factor zero between two points of a path."""
    chord = (ends[1] - ends[0]) / metric.units
    chord = chord / metric.length(chord)
    segment = Segment(ends, jnp.stack([chord, chord]))
    root = locate(
        system, metric, segment, lambda point, *_: (point[-1], point[:0]), ends[:, -1],
        ends[0, :0], jnp.array(True),
    )  # fmt: skip
    return root.point.at[-1].set(0.0)


def _snap_factors(
    system: PathSystem, run: PathRun, sign: Scalar, end: Scalar
) -> tuple[Float[Array, "2"], Bool[Array, "2"]]:
    """Return the load factors at which the first and the second state become unstable.

    They are the first critical point, and the last one before the second state, or before
    the end of the path.
    """
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
    at = with_derivatives(system, run.metric, at, at_branch, null)
    return jnp.where(found, at[:, -1], jnp.nan), at_branch


_solve = fast_compile(_solve_uncompiled)
_evaluate = fast_compile(_evaluate_uncompiled)
