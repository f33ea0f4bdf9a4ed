"""Programs that follow a path, and compute the quantities at its points.

The points of a path are computed in one program, and their quantities in another one,
because the number of points is known only after the first. Inside `jax.jit` and under
`jax.grad` there is one program.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from typing_extensions import TypeAliasType

from ..._compile.compilation import fast_compile
from ..._utils.host import padded_size, program_input, take_rows
from ..._utils.pytrees import stop_gradient
from ..._utils.types import Count, Scalar
from ...results.codes import result_of_status, RESULTS
from ..equations.stresses import select_stresses
from . import arc_length
from .arc_length import follow, Metric, Trace
from .branch_points import refine_branch_points
from .critical_points import (
    Criticals,
    differentiable_critical_points,
    locate_points,
    null_vectors,
)
from .points import differentiable_points, point_values
from .solution import CriticalPoints, Path, PathPoint
from .start import first_point, FirstPoint, start_at, start_on_branch
from .system import PathSystem


# Condition for the end of a path: a function whose change of sign ends it
Until = TypeAliasType("Until", Callable[[PathPoint], Scalar])


class PathRun(NamedTuple):
    """Result of the continuation."""

    metric: Metric  # Units of the unknowns
    trace: Trace  # The points
    # Number of negative eigenvalues of the stiffness at each point
    negative: Int[Array, " points"]
    criticals: Criticals  # The critical points


@fast_compile
def run_path(
    system: PathSystem,
    first: FirstPoint,
    limits: Float[Array, "2"],
    largest_step: Scalar,
    until: Until | None,
    max_points: Count | int,
    rows: int,
    max_critical: int,
) -> PathRun:
    """Follow the path, and locate its end and its critical points; see `follow`."""
    system, first, limits, until = stop_gradient((system, first, limits, until))
    event = None if until is None else _event(system, until)
    point = first_point(system, first.displacements, first.factor)
    mode = first.mode.reshape(-1)[np.array(system.dofs.free, int)]
    mode = jnp.concatenate([mode, jnp.zeros(len(point) - len(mode))])
    metric, start, singular = start_at(system, point, first.direction)
    singular &= ~first.at_branch
    start = start_on_branch(metric, start, first.direction * mode, first.at_branch)
    trace = follow(system, metric, start, limits, largest_step, event, max_points, rows)
    status = jnp.where(singular, arc_length.SINGULAR, trace.status)
    if event is not None:
        undefined = jnp.isnan(event(point)) & (status != arc_length.NOT_FINITE)
        status = jnp.where(undefined & ~singular, arc_length.UNDEFINED, status)
    trace = trace._replace(status=status)
    trace, criticals, negative = locate_points(
        system, metric, trace, limits, event, max_critical
    )
    return PathRun(metric, trace, negative, criticals)


def _event(system: PathSystem, until: Until) -> arc_length.PathEvent:
    """Convert a function of a `PathPoint` to one of a vector."""

    def event(point: Float[Array, " n"]) -> Scalar:
        equations, displacements, _ = system.split(point)
        mechanism = system.mechanism
        on_path = PathPoint(
            load_factor=point[-1],
            displacements=displacements,
            reference=mechanism.reference,
            energy=equations.hinges.energy(displacements),
            names=mechanism.names,
        )
        value = until(on_path)
        if jnp.shape(value) != ():
            raise TypeError(
                f"`until` returns an array of shape {jnp.shape(value)}, but must return "
                "one number, whose sign changes at the end of the path."
            )
        if jnp.issubdtype(jnp.asarray(value).dtype, bool):
            raise TypeError(
                "`until` returns a truth value, but must return a number whose sign "
                "changes at the end of the path. Return a difference instead of a "
                "comparison, such as `a - b` instead of `a < b`."
            )
        return value

    return event


def _end_condition(
    system: PathSystem, limits: Float[Array, "2"], until: Until | None, trace: Trace
) -> tuple[Scalar, Float[Array, " n"]]:
    """Return the value and the gradient of the function that is zero at the last point.

    The value has derivatives with respect to the system, the limits, and `until`.
    """
    point = trace.points[trace.number - 1]
    limit = limits[jnp.argmin(jnp.abs(limits - point[-1]))]
    value = jnp.where(trace.status == arc_length.AT_LIMIT, point[-1] - limit, 0.0)
    gradient = _of_load_factor(point)
    if until is None:
        return value, gradient
    at_event = trace.status == arc_length.AT_EVENT
    event, event_gradient = jax.value_and_grad(_event(system, until))(point)
    value = jnp.where(at_event, event, value)
    return value, jnp.where(at_event, event_gradient, gradient)


def _of_load_factor(point: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return the gradient of the load factor of a point."""
    return jnp.zeros_like(point).at[-1].set(1.0)


@partial(fast_compile, optimize=False)  # runs for milliseconds
def evaluate_path(
    system: PathSystem, limits: Float[Array, "2"], until: Until | None, run: PathRun
) -> Path:
    """Compute the quantities at the points, and give them derivatives."""
    metric, trace, negative, criticals = run
    fixed, mechanism = stop_gradient(system), system.mechanism
    rows = jnp.asarray(np.arange(len(trace.points)))
    used = rows < trace.number
    # In rows that are not used, the equations must have a solution, too: otherwise their
    # derivatives are NaN, also multiplied by zero.
    known = jnp.where(used[:, None], trace.points, trace.points[:1])
    tangents = jnp.where(used[:, None], trace.tangents, trace.tangents[:1])
    normals = tangents * (metric.weights / metric.units)[None]
    ended = (trace.status == arc_length.AT_LIMIT) | (trace.status == arc_length.AT_EVENT)
    is_end = ended & (rows == trace.number - 1)
    condition, gradient = _end_condition(system, limits, until, trace)
    normals = jnp.where(is_end[:, None], gradient[None], normals)
    # The first point stays at its load factor.
    normals = normals.at[0].set(_of_load_factor(known[0]))
    conditions = jnp.where(is_end, condition, 0.0)
    points = differentiable_points(system, known, normals, conditions)

    count = jnp.minimum(criticals.number, len(criticals.points))
    found = jnp.asarray(np.arange(len(criticals.points))) < count
    at = jnp.where(found[:, None], criticals.points, trace.points[:1])
    null = null_vectors(fixed, metric, at, criticals.is_branch, criticals.multiplicities)
    at = differentiable_critical_points(system, metric, at, criticals.is_branch, null)
    values = point_values(system, jnp.concatenate([points, at]))
    masked = jax.tree.map(lambda array: _masked(used, array[: len(rows)]), values)
    critical = jax.tree.map(lambda array: _masked(found, array[len(rows) :]), values)
    modes = jax.vmap(system.mode_displacements)(null.right[..., 0])
    length = fixed.length()
    stresses = None
    if masked.stresses is not None:
        hinges, names = mechanism.hinge_assembly, mechanism.hinge_names
        stresses = select_stresses(hinges, masked.stresses, names)
    return Path(
        load_factors=masked.load_factor,
        displacements=masked.displacements,
        reference=mechanism.reference,
        reactions=masked.reactions,
        constraint_forces=masked.constraint_forces,
        energies=masked.energy,
        negative_eigenvalues=jnp.where(used, negative, -1),
        critical_points=CriticalPoints(
            load_factors=critical.load_factor,
            displacements=critical.displacements,
            reference=mechanism.reference,
            energies=critical.energy,
            reactions=critical.reactions,
            modes=_masked(found, modes),
            is_branch=criticals.is_branch,
            multiplicities=criticals.multiplicities,
            rows=criticals.rows,
            count=count,
            length=length,
            names=mechanism.names,
        ),
        count=trace.number,
        steps=trace.steps,
        result=path_result(trace),
        names=mechanism.names,
        constraint_names=system.constraints.names(),
        range_shares=masked.range_shares,
        stresses=stresses,
    )


def path_result(trace: Trace) -> RESULTS:
    """Return the reason of the end of a path."""
    results = (
        (arc_length.AT_EVENT, RESULTS.event_occurred),
        (arc_length.RETURNED, RESULTS.returned_to_start),
        (arc_length.OUT_OF_RANGE, RESULTS.out_of_range),
        (arc_length.FULL, RESULTS.max_points_reached),
        (arc_length.TOO_SHORT, RESULTS.path_interrupted),
        (arc_length.NOT_FINITE, RESULTS.not_finite),
        (arc_length.SINGULAR, RESULTS.unstable),
        (arc_length.UNDEFINED, RESULTS.until_not_a_number),
        (arc_length.UNRESOLVED, RESULTS.critical_point_not_found),
    )
    return result_of_status(trace.status, results, RESULTS.successful)


def first_rows(run: PathRun, rows: int) -> PathRun:
    """Return the first rows of the points of a path."""
    trace = run.trace
    names = ("points", "tangents", "orientations")
    first = {name: take_rows(getattr(trace, name), slice(rows)) for name in names}
    negative = take_rows(run.negative, slice(rows))
    return run._replace(trace=trace._replace(**first), negative=negative)


def _masked(used: Bool[Array, " rows"], values: Array) -> Array:
    """Replace the rows that are not used by NaN."""
    return jnp.where(used.reshape(-1, *(values.ndim - 1) * (1,)), values, jnp.nan)


@fast_compile
def solve_path(
    system: PathSystem,
    first: FirstPoint,
    limits: Float[Array, "2"],
    largest_step: Scalar,
    until: Until | None,
    max_points: int,
    max_critical: int,
) -> Path:
    """Follow the path and evaluate its points, inside another program."""
    run = run_path(
        system, first, limits, largest_step, until, max_points, max_points, max_critical
    )
    return evaluate_path(system, limits, until, refine_path(system, run))


@fast_compile
def refine_path(system: PathSystem, run: PathRun) -> PathRun:
    """Improve the branch points; see `refine_branch_points`."""
    fixed = stop_gradient(system)
    refined = refine_branch_points(fixed, run.metric, run.criticals)
    return run._replace(criticals=refined)


def run_refined(
    system: PathSystem,
    first: FirstPoint,
    limits: Float[Array, "2"],
    largest_step: Scalar,
    until: Until | None,
    max_points: int,
    max_critical: int,
) -> PathRun:
    """Follow the path, and improve its branch points, outside of other programs.

    Many numbers of points share a program with the same number of rows.
    """
    run = run_path(
        system, first, limits, largest_step, until,
        program_input(max_points, int), padded_size(max_points, 16), max_critical,
    )  # fmt: skip
    if np.any(run.criticals.is_branch & (run.criticals.multiplicities == 1)):
        run = refine_path(system, run)
    return run
