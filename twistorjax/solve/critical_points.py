"""Limit points and branch points of a path, and their derivatives.

At both of them the tangent stiffness is singular. They are located on a segment of the
path. Their derivatives follow from equations that are regular there: those of the path,
and the condition that the stiffness is singular (Griewank and Reddien, Characterization
and computation of generalized turning points, SIAM J. Numer. Anal. 21, 1984).
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._utils.pytrees import jvp_of_varied
from .._utils.types import Count, Flag, Scalar
from .continuation import AT_EVENT, AT_LIMIT, Metric, PathEvent, Step, Trace
from .path_location import locate, Segment
from .path_system import PathSystem, PathTangent
from .small_matrices import pivoted_inverse, solve


_SHIFT = 1e-12  # of a matrix, relative to its largest entry
_SAME_POINT = 1e-3  # largest distance of two critical points that are one point


class Criticals(NamedTuple):
    """Critical points of a path. Those after the first `number` are NaN.

    Args:
        points: The points.
        is_branch: Whether each of them is a branch point; otherwise it is a limit point.
        rows: Index of the point of the path that precedes each of them.
        number: Number of critical points.
    """

    points: Float[Array, "critical n"]
    is_branch: Bool[Array, " critical"]
    rows: Int[Array, " critical"]
    number: Count


class _Search(NamedTuple):
    """State of the search for the end of a path and its critical points.

    Args:
        trace: The path, whose last point is replaced by its end.
        criticals: Critical points that were found.
        row: Index of the point that precedes the last critical point.
        ended: Whether the end has been located.
    """

    trace: Trace
    criticals: Criticals
    row: Count
    ended: Flag


def locate_points(
    system: PathSystem,
    metric: Metric,
    trace: Trace,
    limits: Float[Array, "2"],
    event: PathEvent | None,
    largest_count: int,
) -> tuple[Trace, Criticals]:
    """Locate the end of a path and its critical points, between its points.

    Args:
        system: The equations.
        metric: Units of the unknowns.
        trace: The path, as found by `follow`.
        limits: Interval of the load factor.
        event: Function of a point whose change of sign ended the path.
        largest_count: Largest number of critical points.

    Returns:
        The path up to its end, and the critical points.
    """

    def flags(trace: Trace) -> tuple[Array, Array]:
        """Decide between which points there are limit points, and branch points."""
        used = jnp.arange(len(trace.points) - 1) < trace.number - 1
        rates, orientations = trace.tangents[:, -1], trace.orientations
        turns = used & (rates[:-1] * rates[1:] < 0)
        return turns, used & (orientations[:-1] * orientations[1:] < 0)

    def next_row(search: _Search) -> tuple[Count, Flag]:
        """Return the next row with a critical point, and whether there is one."""
        turns, branches = flags(search.trace)
        later = (turns | branches) & (np.arange(len(turns)) > search.row)
        return jnp.argmax(later), jnp.any(later)

    def improve(search: _Search) -> _Search:
        trace, found = search.trace, search.criticals
        row, _ = next_row(search)
        row = jnp.where(search.ended, row, trace.number - 2)
        points = jax.lax.dynamic_slice_in_dim(trace.points, row, 2)
        tangents = jax.lax.dynamic_slice_in_dim(trace.tangents, row, 2)
        determinants = jax.lax.dynamic_slice_in_dim(trace.log_determinants, row, 2)
        signs = jax.lax.dynamic_slice_in_dim(trace.orientations, row, 2)
        reference = jnp.max(determinants)
        branch = search.ended & (signs[0] * signs[1] < 0)
        limit = jnp.where(points[1, -1] > limits[1], limits[1], limits[0])
        by_event = trace.status == AT_EVENT

        def function(point: Array, step: Step) -> Scalar:
            determinant = jnp.exp(step.log_determinant - reference)
            critical = jnp.where(branch, step.orientation * determinant, step.tangent[-1])
            end = point[-1] - limit
            if event is not None:
                end = jnp.where(by_event, event(point), end)
            return jnp.where(search.ended, critical, end)

        values = jnp.stack(
            [
                function(
                    points[k], Step(0 * points[k], tangents[k], limit, signs[k], size)
                )
                for k, size in enumerate(determinants)
            ]
        )
        segment = Segment(points, tangents)
        point, step = locate(system, metric, segment, function, values, ~branch)
        # On the path that branches off, the load factor is stationary at a branch point,
        # which is not a limit point in addition.
        before = found.points[found.number - 1]
        distance = metric.length((point - before) / metric.units)
        same = (found.number > 0) & (distance < _SAME_POINT)
        index = jnp.where(search.ended, found.number - same.astype(int), largest_count)
        found = Criticals(
            found.points.at[index].set(point, mode="drop"),
            found.is_branch.at[index].set(
                branch | (same & found.is_branch[found.number - 1]), mode="drop"
            ),
            found.rows.at[index].set(row, mode="drop"),
            found.number + (search.ended & ~same).astype(int),
        )
        last = jnp.where(search.ended, len(trace.points), trace.number - 1)
        trace = trace._replace(
            points=trace.points.at[last].set(point, mode="drop"),
            tangents=trace.tangents.at[last].set(step.tangent, mode="drop"),
            orientations=trace.orientations.at[last].set(step.orientation, mode="drop"),
        )
        row = jnp.where(search.ended, row, search.row)
        return _Search(trace, found, row, jnp.ones((), bool))

    nothing = jnp.full((largest_count, trace.points.shape[1]), jnp.nan)
    none = jnp.zeros(largest_count, bool)
    rows = jnp.zeros(largest_count, int)
    found = Criticals(nothing, none, rows, jnp.zeros((), int))
    located = (trace.status != AT_LIMIT) & (trace.status != AT_EVENT)
    search = _Search(trace, found, -jnp.ones((), int), located)

    def unfinished(search: _Search) -> Flag:
        return ~search.ended | (
            next_row(search)[1] & (search.criticals.number < largest_count)
        )

    search = jax.lax.while_loop(unfinished, improve, search)
    return search.trace, search.criticals


def null_vectors(
    system: PathSystem, metric: Metric, points: Float[Array, "critical n"]
) -> Float[Array, "critical unknowns"]:
    """Compute the null vectors of the stiffness, divided by the units, of unit length.

    The largest entry is positive.
    """

    def one(point: Array) -> Float[Array, " unknowns"]:
        _, mode = singular_vectors(system, metric, point)
        mode = mode / metric.length(jnp.concatenate([mode, jnp.zeros(1)]))
        largest = mode[jnp.argmax(jnp.abs(metric.weights[:-1] * mode))]
        return jnp.where(largest < 0, -1.0, 1.0) * mode

    return jax.vmap(one)(points)


def singular_vectors(
    system: PathSystem, metric: Metric, point: Float[Array, " n"]
) -> tuple[Float[Array, " unknowns"], Float[Array, " unknowns"]]:
    """Compute the singular vectors of the smallest singular value of the stiffness.

    The left one belongs to the rows of the scaled stiffness; see `scaled_jacobian`.
    """
    matrix = scaled_jacobian(metric, system.tangent(point))
    # Inverse iteration, with a matrix that is not quite singular
    shift = _SHIFT * jnp.max(jnp.abs(matrix)) * jnp.eye(len(matrix))
    found = pivoted_inverse(matrix + shift)
    sizes = jnp.sum(found**2, axis=0)
    right = found @ found[:, jnp.argmax(sizes)]
    right = right / jnp.linalg.norm(right)
    left = right @ found
    left = left / jnp.linalg.norm(left)
    found = pivoted_inverse(_bordered(matrix, left, right))
    left, right = found[-1, :-1], found[:-1, -1]
    return left / jnp.linalg.norm(left), right / jnp.linalg.norm(right)


def scaled_jacobian(
    metric: Metric, tangent: PathTangent
) -> Float[Array, "unknowns unknowns"]:
    """Return the derivative of the residual, in the units of the metric.

    A force is multiplied by the unit of its displacement, and a violation by that of its
    constraint force.
    """
    units = metric.units[:-1]
    return units[:, None] * tangent.jacobian * units[None]


def _bordered(
    matrix: Float[Array, "n n"], left: Float[Array, " n"], right: Float[Array, " n"]
) -> Float[Array, "n_and_1 n_and_1"]:
    """Border a matrix that is almost singular, such that it becomes regular."""
    return jnp.block([[matrix, left[:, None]], [right[None], jnp.zeros((1, 1))]])


def bordered_inverse(
    matrix: Float[Array, "n n"], left: Float[Array, " n"], right: Float[Array, " n"]
) -> tuple[Float[Array, "n_and_1 n_and_1"], Scalar, Float[Array, " n"]]:
    """Invert a matrix that is almost singular, with a border.

    Returns:
        The inverse of the bordered matrix, a number that vanishes if `matrix` is
        singular, and its left null vector.
    """
    found = pivoted_inverse(_bordered(matrix, left, right))
    return found, found[-1, -1], found[-1, :-1]


def _extended_residual(
    system: PathSystem,
    metric: Metric,
    borders: tuple[Array, Array],
    branch: Flag,
    unknowns: Array,
) -> Float[Array, " n_and_1"]:
    """Residual, condition of singularity, and closing condition of a critical point.

    The unknowns are a point and an unfolding: an additional force along the left null
    vector, by which the equations of a branch point are regular. It is zero at a limit
    point. At a branch point, the load factor has no part in the left null vector.

    Args:
        system: The equations.
        metric: Units of the unknowns.
        borders: The left and the right null vector near the point.
        branch: Whether it is a branch point.
        unknowns: The point, divided by the units, and the unfolding.
    """
    left, right = borders
    row_units, unfolding = metric.units[:-1], unknowns[-1]
    tangent = system.tangent(metric.units * unknowns[:-1])
    _, singular, null = bordered_inverse(scaled_jacobian(metric, tangent), left, right)
    rate = jnp.sum(null * row_units * tangent.by_factor)
    residual = row_units * tangent.residual + unfolding * left
    closing = jnp.where(branch, rate, unfolding)
    return jnp.concatenate([residual, jnp.stack([singular, closing])])


def with_derivatives(
    system: PathSystem, metric: Metric, points: Array, is_branch: Array
) -> Float[Array, "critical n"]:
    """Return critical points with derivatives with respect to the system."""
    dynamic, static = eqx.partition(system, eqx.is_inexact_array)

    def one(point: Array, branch: Flag) -> Array:
        return _critical(static, dynamic, metric, point, branch)

    return jax.vmap(one)(points, is_branch)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _critical(static: PathSystem, dynamic: PathSystem, metric, point, branch):
    """Return the critical point; see `with_derivatives`."""
    del static, dynamic, metric, branch
    return point


@partial(_critical.defjvp, symbolic_zeros=True)
def _(static, primals, tangents):
    dynamic, metric, point, branch = primals
    point = _critical(static, dynamic, metric, point, branch)
    found = jnp.all(jnp.isfinite(point))
    metric, at = jax.lax.stop_gradient((metric, jnp.where(found, point, 0.0)))
    left, right = jax.lax.stop_gradient(
        singular_vectors(eqx.combine(jax.lax.stop_gradient(dynamic), static), metric, at)
    )

    def equations(dynamic: PathSystem, unknowns: Array) -> Array:
        system = eqx.combine(dynamic, static)
        return _extended_residual(system, metric, (left, right), branch, unknowns)

    scaled = jnp.where(found, point, 0.0) / metric.units
    unknowns = jnp.concatenate([scaled, jnp.zeros(1)])
    _, rate = jvp_of_varied(
        lambda dynamic: equations(dynamic, unknowns), (dynamic,), (tangents[0],)
    )
    matrix = jax.jacfwd(equations, argnums=1)(dynamic, unknowns)
    matrix = jnp.where(found, matrix, jnp.eye(len(matrix)))
    change = -solve(matrix, rate)
    change = jnp.where(found, metric.units * change[:-1], 0.0)
    return point, change
