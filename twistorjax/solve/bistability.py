"""Stable states of a bistable mechanism, and the loads between which it snaps."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._utils.compilation import fast_compile
from .._utils.host import all_concrete, is_traced
from .._utils.pytrees import stop_gradient
from .._utils.types import Count, Flag, NumberLike, Pose, Scalar
from .._utils.validation import index_of, require_positive
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Drive, Load
from ..mechanism.mechanism import Mechanism
from .continuation import Metric, solve_step, Trace
from .critical_points import with_derivatives
from .path_points import on_path, point_values
from .path_program import PathRun, run_uncompiled
from .path_setup import assemble_path, FirstPoint, StartLike
from .path_system import PathSystem


_MAX_CRITICAL = 6  # critical points of a path, of which the limit points are used
_CORRECTIONS = 8  # of an unloaded equilibrium, which starts between two points of a path


class Bistability(eqx.Module):
    """Equilibria without the multiplied loads, and the loads at which a mechanism snaps.

    The states are the first stable equilibrium, the unstable one, and the second stable
    one. Values that do not exist are NaN. They have derivatives with respect to the
    mechanism and its loads.

    Args:
        is_bistable: Whether the path has a second stable equilibrium.
        displacements: Displacements of the bodies in the three states; rad, m, m.
        energies: Energies in the three states: those stored in the hinges, minus the work
            of the constant loads; J.
        snap_factors: Load factor at which the mechanism snaps out of the first state, and
            that at which it snaps back. If it is bistable, the second one is negative: it
            needs loads in the opposite direction.
        names: Names of the bodies.
    """

    is_bistable: Bool[Array, "*batch"]
    displacements: Float[Array, "*batch 3 bodies 3"]
    energies: Float[Array, "*batch 3"]
    snap_factors: Float[Array, "*batch 2"]
    names: tuple[str, ...] = eqx.field(static=True)

    @property
    def barriers(self) -> Float[Array, "*batch 2"]:
        """Energy of the unstable state above the first and above the second one; J."""
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
        known = all_concrete([self.is_bistable, self.snap_factors, self.energies])
        if known is None or known[0].shape:
            return eqx.tree_pformat(self)
        bistable, (forth, back), energies = known
        if np.isnan(forth):
            return "monostable: no limit point up to the last load factor"
        lines = [f"{'bistable' if bistable else 'not bistable, but it snaps'}"]
        lines.append(f"snaps at the load factor {forth:.6g}, back at {back:.6g}")
        if bistable:
            first, second = (energies[1] - energies[k] for k in (0, 2))
            lines.append(
                f"energy barrier {first:.6g} J from the first state, {second:.6g} J from "
                "the second one"
            )
        return "\n".join(lines)


def bistability(
    mechanism: Mechanism,
    *,
    loads: Sequence[Load] = (),
    drives: Sequence[Drive] = (),
    constant_loads: Sequence[Load] = (),
    constraints: Sequence[AbstractConstraint] = (),
    start: StartLike | None = None,
    direction: int = 1,
    largest_step: float = 0.1,
    max_points: int = 500,
    time: NumberLike = 0.0,
) -> Bistability:
    """Find the second stable state of a mechanism, and the loads at which it snaps.

    The path of the equilibria is followed from the first state until the loads reach
    their full magnitude, or their opposite; see `path`. Their magnitude must be larger
    than that at which the mechanism snaps.

    Args:
        mechanism: The mechanism.
        loads: Loads by which the mechanism is switched.
        drives: Prescribed displacements that are multiplied together with the loads.
        constant_loads: Loads that always act, such as weights.
        constraints: Pins, sliders, and other constraints between the bodies.
        start: Equilibrium or poses near the first state; by default that which is
            connected to the reference configuration.
        direction: 1 to begin with increasing loads, -1 with loads in the opposite
            direction.
        largest_step: Largest distance of successive points; see `path`.
        max_points: Largest number of points of the path.
        time: Time at which time-dependent constraints are evaluated; s.

    Returns:
        The states and the load factors. They are NaN if the path does not reach them.

    Raises:
        ValueError: An argument is invalid; see `path`.
        RuntimeError: There is no first equilibrium.

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
    step = require_positive("`largest_step`", largest_step)
    system, first = assemble_path(
        mechanism, loads, drives, {}, None, constant_loads, constraints, start,
        direction, time,
    )  # fmt: skip
    arguments = system, first, step, max_points
    if is_traced(arguments):
        return _traced(*arguments)
    return _compiled(*arguments)


def _bistability(
    system: PathSystem, first: FirstPoint, step: Scalar, max_points: int
) -> Bistability:
    """Compute the result of `bistability`."""
    limits = jnp.array([-1.0, 1.0])
    run = run_uncompiled(system, first, limits, step, None, max_points, _MAX_CRITICAL)
    points, found = _unloaded_points(stop_gradient(system), run, first.direction)
    at_zero_load = jnp.zeros_like(points).at[:, -1].set(1.0)
    points = on_path(system, points, at_zero_load)
    values = point_values(system, points)
    work = jax.vmap(system.constant_loads.work)(values.displacements)
    energies = values.energy - work
    known = found[:, None, None]
    return Bistability(
        is_bistable=found[2],
        displacements=jnp.where(known, values.displacements, jnp.nan),
        energies=jnp.where(found, energies, jnp.nan),
        snap_factors=_first_limit_factors(system, run),
        names=system.mechanism.names,
    )


def _unloaded_points(
    system: PathSystem, run: PathRun, sign: Scalar
) -> tuple[Float[Array, "3 n"], Bool[Array, "3"]]:
    """Find the points of a path at the load factor zero, and whether they exist."""
    trace = run.trace
    factors, rows = sign * trace.points[:, -1], jnp.arange(len(trace.points) - 1)
    used = rows < trace.number - 1

    def first_row(crossing: Array, after: Count) -> tuple[Count, Flag]:
        crossing = crossing & used & (rows > after)
        return jnp.argmax(crossing), jnp.any(crossing)

    decreasing = (factors[:-1] > 0) & (factors[1:] <= 0)
    down, has_down = first_row(decreasing, jnp.zeros((), int))
    up, has_up = first_row((factors[:-1] < 0) & (factors[1:] >= 0), down)
    middle, second = (_at_zero_load(system, run.metric, trace, row) for row in (down, up))
    found = jnp.stack([trace.number > 0, has_down, has_down & has_up])
    points = jnp.stack([trace.points[0], middle, second])
    return jnp.where(found[:, None], points, trace.points[:1]), found


def _at_zero_load(
    system: PathSystem, metric: Metric, trace: Trace, row: Count
) -> Float[Array, " n"]:
    """Compute the equilibrium at the load factor zero between two points of a path."""
    before, after = trace.points[row], trace.points[row + 1]
    share = before[-1] / (before[-1] - after[-1])
    border = jnp.zeros_like(before).at[-1].set(1.0)

    def correct(_, point: Array) -> Array:
        excess = point[-1] / metric.units[-1]
        step = solve_step(system.tangent(point), metric, border, excess)
        return point + metric.units * step.correction

    start = before + share * (after - before)
    return jax.lax.fori_loop(0, _CORRECTIONS, correct, start)


def _first_limit_factors(system: PathSystem, run: PathRun) -> Float[Array, "2"]:
    """Return the load factors of the first two limit points, with derivatives."""
    criticals = run.criticals
    is_limit = ~criticals.is_branch & (
        jnp.arange(len(criticals.points)) < criticals.number
    )
    (rows,) = jnp.nonzero(is_limit, size=2, fill_value=0)
    found = jnp.arange(2) < jnp.sum(is_limit)
    at = jnp.where(found[:, None], criticals.points[rows], run.trace.points[:1])
    at = with_derivatives(system, run.metric, at, jnp.zeros(2, bool))
    return jnp.where(found, at[:, -1], jnp.nan)


_traced = eqx.filter_jit(_bistability)
_compiled = fast_compile(_bistability)
