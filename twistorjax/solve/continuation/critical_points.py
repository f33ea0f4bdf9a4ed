"""Limit points and branch points of a path, and their derivatives.

At both of them the tangent stiffness is singular. They are located on a segment of the
path. Their derivatives follow from equations that are regular there: those of the path,
and the condition that the stiffness is singular (Griewank and Reddien, Characterization
and computation of generalized turning points, SIAM J. Numer. Anal. 21, 1984).
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._utils.pytrees import jvp_of_varied, with_derivative
from ..._utils.types import Count, Flag, Scalar
from ...linalg.elimination import pivoted_inverse, solve
from ...linalg.lowest_modes import dominant_modes, has_subspace
from .arc_length import (
    AT_EVENT,
    AT_LIMIT,
    Metric,
    PathEvent,
    Step,
    Trace,
    UNDEFINED,
    UNRESOLVED,
)
from .location import locate, Segment
from .points import allowed_stiffness, count_of_values, stability_values
from .system import PathSystem, PathTangent


_SHIFT = 1e-12  # of a matrix, relative to its largest entry
_NO_NULL_VECTOR = 1e-6  # of the flexibility, as a fraction of that of a null vector
_SAME_POINT = 1e-8  # largest distance of critical points that are one multiple point
LARGEST_MULTIPLICITY = 6  # null vectors that are computed
# On the path that branches off, the load factor is stationary at a branch point. Both are
# located, at least at this distance.
_SAME_BRANCH_POINT = 1e-5
_LIMIT_RATE = 1e-4  # of the load factor at a limit point, as a fraction of those nearby
_SMALL_EIGENVALUE = 0.05  # at a critical point, as a fraction of those nearby
# A point is inserted if an eigenvalue is predicted to be smaller between two points, as a
# fraction of both of its values there.
_DIP = 0.1
_SHORTEST_SEGMENT = 1e-4  # in which a point is inserted
_SEPARATE = 1e-3  # distance of opposite changes of stability, as a fraction of a segment


class Criticals(NamedTuple):
    """Critical points of a path. Those after the first `number` are NaN."""

    points: Float[Array, "critical n"]
    # Whether each of them is a branch point; otherwise it is a limit point
    is_branch: Bool[Array, " critical"]
    # Number of eigenvalues that vanish at each of them
    multiplicities: Int[Array, " critical"]
    # Index of the point of the path that precedes each of them
    rows: Int[Array, " critical"]
    number: Count  # Number of critical points


class _Search(NamedTuple):
    """State of the search for the end of a path and its critical points."""

    trace: Trace  # The path, whose last point is replaced by its end
    # Stability values at its points; see `stability_values`
    values: Float[Array, "points values"]
    # Place on each segment that separates opposite changes of stability, as a fraction of
    # its length; zero if there is none
    between: Float[Array, " segments"]
    # Rows at the begin and behind the end of the points whose stability is not known yet
    unknown: tuple[Count, Count]
    criticals: Criticals  # Critical points that were found
    row: Count  # Index of the point that precedes the current segment
    done: Count  # Number of critical points that were found on this segment
    ended: Flag  # Whether the end has been located
    finished: Flag  # Whether there are no more critical points

    def negative(self) -> Int[Array, " points"]:
        """Return the number of negative values at each point."""
        return jnp.sum(self.values < 0, axis=1)

    def numbers(self) -> Int[Array, " segments"]:
        """Return the number of critical points on each segment.

        It is the change of the number of negative eigenvalues. The path that leaves a
        branch point may go through it, which does not change this number.
        """
        trace = self.trace
        changes = jnp.abs(jnp.diff(self.negative()))
        rates, signs = trace.tangents[:, -1], trace.orientations
        through = (rates[:-1] * rates[1:] < 0) & (signs[:-1] * signs[1:] < 0)
        # At its start on a branch point, a path has no orientation.
        used = (jnp.arange(len(changes)) < trace.number - 1) & (signs[:-1] != 0)
        return jnp.where(used, jnp.maximum(changes, through.astype(int)), 0)

    def dips(self, metric: Metric) -> Float[Array, " segments"]:
        """Predict where a point has to be inserted, so that no change of sign is missed.

        Two eigenvalues may change their signs in opposite directions, or the one closest
        to zero may vanish twice: its absolute value is extrapolated by parabolas through
        three points, of which one is in front of or behind the segment, and by straight
        lines. The place on each segment is a fraction of its length; zero if there is
        none.
        """
        trace = self.trace
        steps = jnp.diff(trace.points, axis=0) / metric.units[None]
        lengths = jnp.sqrt(steps**2 @ metric.weights)
        rows = np.arange(len(lengths))
        sizes = jnp.min(jnp.abs(self.values), axis=1)
        slopes = jnp.diff(sizes) / jnp.where(lengths > 0, lengths, 1.0)
        # Those in front of each segment, on it, and behind it
        around = rows[:, None] + np.arange(3)
        slopes, spans = (jnp.pad(array, 1)[around] for array in (slopes, lengths))
        length, slope = lengths[:, None], slopes[:, 1:2]
        curvature = jnp.diff(slopes, axis=1) / (length + spans[:, ::2])
        bent = curvature > 0
        curvature = jnp.where(bent, curvature, 1.0)
        begin = slope - curvature * length
        fractions = -begin / (2 * curvature * length)
        low = sizes[:-1, None] - begin**2 / (4 * curvature)
        dips = low < _DIP * jnp.minimum(sizes[:-1], sizes[1:])[:, None]
        dips &= bent & (fractions > 0.02) & (fractions < 0.98)
        used = (rows + 1 < trace.number) & (lengths > _SHORTEST_SEGMENT)
        used &= trace.orientations[:-1] != 0
        used &= trace.number < len(trace.points)
        known = jnp.stack([rows > 0, rows + 2 < trace.number], axis=1)
        known &= (self.numbers() == 0)[:, None]
        fractions = jnp.max(jnp.where(dips & known, fractions, 0.0), axis=1)
        # Straight lines through the points before and behind the segment
        begin = -sizes[:-1] / (slopes[:, 0] * lengths)
        end = 1 - sizes[1:] / (slopes[:, 2] * lengths)
        crosses = (slopes[:, 0] < 0) & (slopes[:, 2] > 0) & (begin < end)
        crosses &= jnp.all(known, axis=1)
        fractions = jnp.where(crosses & (fractions == 0), (begin + end) / 2, fractions)
        fractions = jnp.where(self.between > 0, self.between, fractions)
        return jnp.where(used, fractions, 0.0)


def locate_points(
    system: PathSystem,
    metric: Metric,
    trace: Trace,
    limits: Float[Array, "2"],
    event: PathEvent | None,
    largest_count: int,
) -> tuple[Trace, Criticals, Int[Array, " points"]]:
    """Locate the end of a path and its critical points, between its points.

    On each segment, as many critical points are located as the number of negative
    eigenvalues of the stiffness changes, which is returned for each point. If they are
    not found, the path ends before. The limits are those of the load factor; `event`
    changed its sign at the end of the path.
    """
    rows = jnp.arange(len(trace.points))
    no_stability = jax.tree.map(
        lambda shape: jnp.zeros(shape.shape),
        jax.eval_shape(partial(_stability, system, metric), trace.points[0]),
    )

    def evaluate(search: _Search) -> _Search:
        """Compute the stability of the points where it is not known."""
        first, end = search.unknown

        def one(
            row: Count, state: tuple[Array, Array, _Stability]
        ) -> tuple[Array, Array, _Stability]:
            values, between, last = state
            current = _stability(system, metric, search.trace.points[row])
            segment = jnp.where(row > first, row - 1, len(rows))
            place = _fraction_between(last, current)
            return (
                values.at[row].set(current.values),
                between.at[segment].set(place, mode="drop"),
                current,
            )

        values, between, _ = jax.lax.fori_loop(
            first, end, one, (search.values, search.between, no_stability)
        )
        return search._replace(values=values, between=between)

    def improve(search: _Search) -> _Search:
        search = evaluate(search)
        trace, found = search.trace, search.criticals
        # The next segment with a critical point or a dip
        again = (rows[:-1] == search.row) & (search.done > 0)
        dips = jnp.where(again, 0.0, search.dips(metric))
        numbers = search.numbers() - jnp.where(again, search.done, 0)
        todo = ((numbers > 0) | (dips > 0)) & (rows[:-1] >= search.row)
        row = jnp.where(search.ended, jnp.argmax(todo), trace.number - 2)
        done = jnp.where(again[row], search.done, 0)
        finished = search.ended & ~jnp.any(todo)
        finished |= search.ended & (found.number >= largest_count) & (done == 0)
        place = dips[row]
        inserts = search.ended & ~finished & (place > 0)
        points, tangents, signs, values = (
            jax.lax.dynamic_slice_in_dim(array, row, 2)
            for array in (
                trace.points, trace.tangents, trace.orientations, search.values
            )
        )  # fmt: skip
        rates, negative = tangents[:, -1], jnp.sum(values < 0, axis=1)
        change = negative[1] - negative[0]
        index = jnp.where(change > 0, negative[0] + done, negative[0] - 1 - done)
        index = jnp.clip(index, 0, values.shape[1] - 1)
        turns = (rates[0] * rates[1] < 0) & (jnp.abs(change) <= 1)
        regular = ~search.ended | inserts | (turns & (signs[0] * signs[1] > 0))
        limit = jnp.where(points[1, -1] > limits[1], limits[1], limits[0])
        by_event = trace.status == AT_EVENT
        border = metric.weights * tangents[0] / metric.units
        reach = jnp.sum(border * (points[1] - points[0]))

        def choose(point: Array, rate: Scalar, values: Array) -> Scalar:
            """Return the quantity that is zero at the point to be located."""
            end = point[-1] - limit
            if event is not None:
                end = jnp.where(by_event, event(point), end)
            before = jnp.sum(border * (point - points[0])) - place * reach
            critical = jnp.where(turns, rate, values[index])
            critical = jnp.where(inserts, before, critical)
            return jnp.where(search.ended, critical, end)

        def function(point: Array, tangent: PathTangent, step: Step):
            values = stability_values(system, metric, tangent)
            return choose(point, step.tangent[-1], values), values

        at_ends = [choose(points[k], rates[k], values[k]) for k in range(2)]
        segment = Segment(points, tangents)
        root = locate(
            system, metric, segment, function, jnp.stack(at_ends), values[0], regular,
            finished,
        )  # fmt: skip
        point, rate = root.point, root.step.tangent[-1]
        size = jnp.max(jnp.abs(values[:, index]))
        resolved = jnp.abs(root.other_values[index]) <= _SMALL_EIGENVALUE * size
        resolved |= ~search.ended | finished | inserts | (change == 0)

        # The critical point, or one more eigenvalue that vanishes at the last one
        flat = jnp.maximum(
            _LIMIT_RATE * jnp.max(jnp.abs(rates)),
            _SAME_BRANCH_POINT * jnp.abs(rates[1] - rates[0]) / reach,
        )
        is_limit = (rates[0] * rates[1] < 0) | (jnp.min(jnp.abs(rates)) <= flat)
        is_limit &= turns | (jnp.abs(rate) <= flat)
        branch = (change == 0) | ~is_limit
        last = found.number - 1
        distance = metric.length((point - found.points[last]) / metric.units)
        noise = 4 * np.finfo(float).eps * values.shape[1] * jnp.max(jnp.abs(values))
        slope = jnp.abs(values[1, index] - values[0, index]) / reach
        # Near a limit point, the distance is about the root of the rounding errors.
        same_distance = jnp.where(
            rates[0] * rates[1] < 0, _SAME_BRANCH_POINT, _SAME_POINT
        )
        tolerance = jnp.maximum(same_distance, noise / jnp.where(slope > 0, slope, 1.0))
        multiple = (found.number > 0) & (distance < tolerance) & (change != 0)
        returns = search.negative()[found.rows[last]] == negative[1]
        returns &= (distance < _SAME_BRANCH_POINT) & (branch != found.is_branch[last])
        returns &= found.number > 0
        multiple &= ~returns
        same = multiple | returns
        times = jnp.where(multiple, found.multiplicities[last] + 1, 1)
        mean = found.points[last] + (point - found.points[last]) / times.astype(float)
        both = returns | (branch & found.is_branch[last])
        recorded = search.ended & ~finished & ~inserts & resolved
        at = jnp.where(recorded, found.number - same.astype(int), largest_count)
        found = Criticals(
            found.points.at[at].set(jnp.where(multiple, mean, point), mode="drop"),
            found.is_branch.at[at].set(jnp.where(same, both, branch), mode="drop"),
            found.multiplicities.at[at].set(times, mode="drop"),
            found.rows.at[at].set(jnp.where(same, found.rows[last], row), mode="drop"),
            found.number + (recorded & ~same).astype(int),
        )

        # The path with its end, or with one more point
        changed = jnp.where(search.ended, len(rows), trace.number - 1)
        changed = jnp.where(inserts, row + 1, changed)
        source = rows - (inserts & (rows > row)).astype(int)
        arrays = [
            array[source].at[changed].set(value, mode="drop")
            for array, value in (
                (trace.points, point),
                (trace.tangents, root.step.tangent),
                (trace.orientations, root.step.orientation),
                (search.values, root.other_values),
            )
        ]
        # The last segment, or the two parts of one with a new point
        known = search.ended & ~inserts
        behind = row + jnp.where(known, 0, 2 + inserts.astype(int))
        number = trace.number + inserts.astype(int)
        number = jnp.where(resolved, number, row + 1)
        undefined = jnp.any(jnp.isnan(root.values)) & ~search.ended & by_event
        status = jnp.where(undefined, UNDEFINED, trace.status)
        trace = trace._replace(
            points=arrays[0],
            tangents=arrays[1],
            orientations=arrays[2],
            number=number,
            status=jnp.where(resolved, status, UNRESOLVED),
        )
        return _Search(
            trace,
            arrays[3],
            search.between[source[:-1]],
            (row, behind),
            found,
            jnp.where(search.ended, row, search.row),
            jnp.where(recorded, done + 1, 0),
            jnp.ones((), bool),
            finished,
        )

    nothing = jnp.full((largest_count, trace.points.shape[1]), jnp.nan)
    zero, none = jnp.zeros((), int), jnp.zeros(largest_count, int)
    found = Criticals(nothing, jnp.zeros(largest_count, bool), none, none, zero)
    located = (trace.status != AT_LIMIT) & (trace.status != AT_EVENT)
    values = jnp.zeros((len(rows), count_of_values(system)))
    search = _Search(
        trace, values, jnp.zeros(len(rows) - 1), (zero, trace.number), found, zero, zero,
        located, zero > 0,
    )  # fmt: skip
    search = jax.lax.while_loop(lambda search: ~search.finished, improve, search)
    return search.trace, search.criticals, search.negative()


class _Stability(NamedTuple):
    """Stiffness at a point of a path."""

    values: Float[Array, " values"]  # Stability values; see `stability_values`
    # Eigenvectors of the stiffness as columns, in the units of the metric; none under
    # follower loads
    modes: Float[Array, "free modes"]
    # Stiffness for displacements that the constraints allow; J
    stiffness: Float[Array, "allowed allowed"]
    basis: Float[Array, "free allowed"]  # These displacements


def _stability(
    system: PathSystem, metric: Metric, point: Float[Array, " n"]
) -> _Stability:
    """Compute the stiffness at a point of a path, and its stability values."""
    tangent = system.tangent(point)
    stiffness, basis = allowed_stiffness(system, metric, tangent)
    if not (system.symmetric and stiffness.size):
        values = stability_values(system, metric, tangent)
        return _Stability(values, basis[:, :0], stiffness, basis)
    values, vectors = jnp.linalg.eigh(stiffness)
    return _Stability(values, basis @ vectors, stiffness, basis)


def _fraction_between(first: _Stability, last: _Stability) -> Scalar:
    """Find the place on a segment that separates opposite changes of stability.

    The stiffness at its last point is compared with that at its first one in each mode.
    If it has become negative in some of them and positive in others, the number of
    negative eigenvalues changes by less than the number of critical points. The place is
    a fraction of the length; zero if there are no opposite changes.
    """
    if not first.modes.size:
        return jnp.zeros(())
    before, modes = first.values, last.basis.T @ first.modes
    after = jnp.sum(modes * (last.stiffness @ modes), axis=0)
    changes = before * after < 0
    fractions = before / jnp.where(changes, before - after, 1.0)
    falls, rises = changes & (before > 0), changes & (before < 0)
    opposite = jnp.any(falls) & jnp.any(rises)
    fall, rise = (
        jnp.mean(fractions, where=jnp.where(opposite, kind, True))
        for kind in (falls, rises)
    )
    opposite &= jnp.abs(fall - rise) > _SEPARATE
    return jnp.where(opposite, jnp.clip((fall + rise) / 2, 0.02, 0.98), 0.0)


class NullVectors(NamedTuple):
    """Null vectors of the stiffness at critical points, divided by the units.

    They are orthonormal, and zero after the first ones, as many as the multiplicity.
    """

    # Those of the rows of the scaled stiffness; see `scaled_jacobian`
    left: Float[Array, "*critical unknowns vectors"]
    right: Float[Array, "*critical unknowns vectors"]  # Those of its columns


def null_vectors(
    system: PathSystem,
    metric: Metric,
    points: Float[Array, "critical n"],
    is_branch: Bool[Array, " critical"],
    multiplicities: Int[Array, " critical"],
) -> NullVectors:
    """Compute the null vectors of the stiffness.

    They have no parts of constraint forces. The first one at a limit point is that in
    which the load does work. At a branch point, each of them is as close to a
    displacement of one degree of freedom as possible; this part is positive.
    """

    def one(arguments: tuple[Array, Flag, Count]) -> NullVectors:
        point, branch, multiplicity = arguments
        if not system.unknowns:
            return NullVectors(jnp.zeros((0, 1)), jnp.zeros((0, 1)))
        tangent = system.tangent(point)
        return null_vectors_of(system, metric, tangent, branch, multiplicity)

    # Two batches of LAPACK calls at the same time can cause a deadlock (jaxlib 0.10).
    return jax.lax.map(one, (points, is_branch, multiplicities))


def null_vectors_of(
    system: PathSystem,
    metric: Metric,
    tangent: PathTangent,
    is_branch: Flag,
    multiplicity: Count,
) -> NullVectors:
    """Compute the null vectors of one stiffness; see `null_vectors`."""
    if not system.symmetric:
        left, right = singular_vectors(metric, tangent)
        largest = right[jnp.argmax(jnp.abs(metric.weights[:-1] * right))]
        right = jnp.where(largest < 0, -1.0, 1.0) * right
        size = metric.length(jnp.append(right, 0.0))
        return NullVectors(left[:, None], right[:, None] / size)
    softest = _softest_displacements(system, metric, tangent)
    load = metric.units[: len(softest)] * tangent.by_factor[: len(softest)]
    load = jnp.where(is_branch, 0.0, load)
    found = basis_of_null_space(softest, load, multiplicity)
    found = jnp.pad(found, ((0, system.unknowns - len(softest)), (0, 0)))
    return NullVectors(found, found)


def _softest_displacements(
    system: PathSystem, metric: Metric, tangent: PathTangent
) -> Float[Array, "free vectors"]:
    """Compute the eigenvectors of the stiffness whose eigenvalues are closest to zero."""
    size = system.unknowns
    if tangent.layout is None or not has_subspace(size, LARGEST_MULTIPLICITY):
        matrix, basis = allowed_stiffness(system, metric, tangent)
        values, vectors = jnp.linalg.eigh(matrix)
        closest = jnp.argsort(jnp.abs(values))[:LARGEST_MULTIPLICITY]
        return basis @ vectors[:, closest]
    units = metric.units[:-1, None]
    # The eigenvectors are those of a matrix that is not quite singular.
    shift = _SHIFT * jnp.max(jnp.abs(units * tangent.jacobian * units.T))
    shifted = tangent.jacobian + jnp.diag(shift / units[:, 0] ** 2)
    factors = replace(tangent, jacobian=shifted).factors(symmetric=False)
    _, vectors, _ = dominant_modes(
        lambda columns: factors.solve(columns / units) / units,
        size,
        LARGEST_MULTIPLICITY,
        _NO_NULL_VECTOR,
    )
    return vectors


def basis_of_null_space(
    softest: Float[Array, "free vectors"],
    load: Float[Array, " free"],
    multiplicity: Count,
) -> Float[Array, "free vectors"]:
    """Choose an orthonormal basis of a null space; see `null_vectors`.

    It is spanned by the first ones of the `softest` displacements. The `load`, which is
    zero at a branch point, does work in the first vector only.
    """
    count = softest.shape[1]
    used = np.arange(count) < jnp.maximum(multiplicity, 1)
    chosen = jnp.where(used[None], softest, 0.0)

    def add(k: Count, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        projection, load, found = state
        vector = projection @ load
        size = jnp.linalg.norm(vector)
        vector = vector / jnp.where(size > 0, size, 1.0)
        largest = vector[jnp.argmax(jnp.abs(vector))]
        vector = jnp.where(used[k] & (size > 0), jnp.sign(largest) * vector, 0.0)
        projection = projection - jnp.outer(vector, vector)
        load = jnp.zeros_like(load).at[jnp.argmax(jnp.diagonal(projection))].set(1.0)
        return projection, load, found.at[:, k].set(vector)

    projection = chosen @ chosen.T
    single = jnp.zeros_like(load).at[jnp.argmax(jnp.diagonal(projection))].set(1.0)
    load = jnp.where(jnp.any(load != 0), load, single)
    state = projection, load, jnp.zeros_like(chosen)
    return jax.lax.fori_loop(0, count, add, state)[2]


def singular_vectors(
    metric: Metric, tangent: PathTangent
) -> tuple[Float[Array, " unknowns"], Float[Array, " unknowns"]]:
    """Compute the singular vectors of the smallest singular value of the stiffness.

    The left one belongs to the rows of the scaled stiffness; see `scaled_jacobian`.
    """
    matrix = scaled_jacobian(metric, tangent)
    # Inverse iteration, with a matrix that is not quite singular
    shift = _SHIFT * jnp.max(jnp.abs(matrix)) * jnp.eye(len(matrix))
    found = pivoted_inverse(matrix + shift)
    sizes = jnp.sum(found**2, axis=0)
    right = found @ found[:, jnp.argmax(sizes)]
    right = right / jnp.linalg.norm(right)
    left = right @ found
    left = left / jnp.linalg.norm(left)
    found = pivoted_inverse(_bordered(matrix, left[:, None], right[:, None]))
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
    matrix: Float[Array, "n n"],
    left: Float[Array, "n vectors"],
    right: Float[Array, "n vectors"],
) -> Float[Array, "n_and_vectors n_and_vectors"]:
    """Border a matrix that is almost singular, such that it becomes regular.

    Vectors that are zero have no effect.
    """
    unused = jnp.diag(jnp.where(jnp.any(right != 0, axis=0), 0.0, 1.0))
    return jnp.block([[matrix, left], [right.T, unused]])


def bordered_inverse(
    matrix: Float[Array, "n n"],
    left: Float[Array, "n vectors"],
    right: Float[Array, "n vectors"],
) -> tuple[Array, Float[Array, "vectors vectors"], Float[Array, "vectors n"]]:
    """Invert a matrix that is almost singular, with a border.

    The second result is a small matrix that vanishes if all borders are null vectors of
    `matrix`. The third result contains the left null vectors.
    """
    found, size = pivoted_inverse(_bordered(matrix, left, right)), len(matrix)
    return found, found[size:, size:], found[size:, :size]


def differentiable_critical_points(
    system: PathSystem, metric: Metric, points: Array, is_branch: Array, null: NullVectors
) -> Float[Array, "critical n"]:
    """Return critical points with derivatives with respect to the system.

    Those of a multiple point are the mean of those of the points into which it separates.
    """

    def one(point: Array, branch: Flag, borders: NullVectors) -> Array:
        return with_derivative(_point_change, point, system, metric, branch, borders)

    return jax.vmap(one)(points, is_branch, jax.lax.stop_gradient(null))


def _point_change(point: Array, arguments: Sequence[Any], tangents: Any) -> Array:
    """Differentiate the equations of a critical point.

    The equations are the residual, the condition of singularity, and closing conditions.
    The unknowns are the point, divided by the units, and an unfolding: additional forces
    along the left null vectors, by which the equations of a branch point are regular.
    They are zero at a simple limit point. At a branch point, the load factor has no part
    in the left null vectors. At a multiple point, the mean of the eigenvalues is zero,
    and those of a limit point are not coupled with the one in which the load does work.
    """
    system, metric, branch, borders = arguments
    metric = jax.lax.stop_gradient(metric)
    found = jnp.all(jnp.isfinite(point))
    at = jnp.where(found, point, 0.0) / metric.units
    row_units, count = metric.units[:-1], borders.right.shape[1]
    used = jnp.any(borders.right != 0, axis=0)

    def derivatives(system: PathSystem, point: Array) -> tuple[Array, Array]:
        tangent = system.tangent(metric.units * point)
        return scaled_jacobian(metric, tangent), row_units * tangent.by_factor

    matrix, by_factor = derivatives(system, at)
    inverse, _, null = bordered_inverse(matrix, *borders)
    inverse = inverse[: len(matrix)]
    # The derivatives of the conditions are those of the stiffness in these directions.
    shapes, response = inverse[:, -count:], inverse[:, :-count] @ by_factor

    def conditions(system: PathSystem, point: Array) -> Array:
        matrix, by_factor = derivatives(system, point)
        singular, rate = -null @ matrix @ shapes, null @ (by_factor - matrix @ response)
        mean = jnp.sum(jnp.where(used, jnp.diagonal(singular), 0.0))
        coupling = jnp.append(jnp.zeros(1), singular[0, 1:])
        closing = jnp.where(used, jnp.where(branch, rate, coupling), 0.0)
        return jnp.append(mean, closing)

    def equations(system: PathSystem) -> Array:
        residual = row_units * system.residual(metric.units * at)
        return jnp.append(residual, conditions(system, at))

    _, rate = jvp_of_varied(equations, (system,), tangents[:1])
    of_point = jax.jacrev(partial(conditions, system))(at)
    limit = ~branch & (np.arange(count) == 0)
    of_unfolding = jnp.diag(jnp.where(used, jnp.where(limit, 1.0, 0.0), 1.0))
    matrix = jnp.block(
        [
            [matrix, by_factor[:, None], borders.left],
            [of_point, jnp.pad(of_unfolding, ((1, 0), (0, 0)))],
        ]
    )
    matrix = jnp.where(found, matrix, jnp.eye(len(matrix)))
    change = -solve(matrix, rate)
    return jnp.where(found, metric.units * change[:-count], 0.0)


def differentiable_null_vectors(
    system: PathSystem, metric: Metric, points: Array, null: NullVectors
) -> Float[Array, "critical unknowns vectors"]:
    """Return the right null vectors with derivatives with respect to the system."""

    def one(point: Array, borders: NullVectors) -> Array:
        arguments = system, metric, point, borders
        return with_derivative(_null_vector_change, borders.right, *arguments)

    return jax.vmap(one)(points, jax.lax.stop_gradient(null))


def _null_vector_change(_: Array, arguments: Sequence[Any], tangents: Any) -> Array:
    """Differentiate null vectors; see `differentiable_null_vectors`."""
    system, metric, point, borders = arguments

    def vectors(system: PathSystem, point: Array) -> Array:
        matrix = scaled_jacobian(metric, system.tangent(point))
        size = len(matrix)
        return bordered_inverse(matrix, *borders)[0][:size, size:]

    changes = tangents[0], tangents[2]
    return jvp_of_varied(vectors, (system, point), changes)[1]
