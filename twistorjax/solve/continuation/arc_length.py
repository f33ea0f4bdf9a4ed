"""Arc-length continuation of an equilibrium path by Newton's method.

A step predicts the next point along the tangent of the path, and corrects it in the plane
that is perpendicular to this tangent (Keller, Numerical solution of bifurcation and
nonlinear eigenvalue problems, 1977). The matrix of the correction, the tangent stiffness
with a row and a column more, is regular at a limit point.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._utils.pytrees import select
from ..._utils.types import Count, Flag, Scalar
from ...linalg.factors import determinant_sign
from .system import PathSystem, PathTangent


(
    RUNNING, AT_LIMIT, AT_EVENT, RETURNED, OUT_OF_RANGE, FULL, TOO_SHORT, NOT_FINITE,
    SINGULAR, UNDEFINED, UNRESOLVED,
) = range(11)  # fmt: skip

_LARGEST_CORRECTION = 0.3  # of the first correction, as a fraction of the step

_LARGEST_CONTRACTION = 0.25  # of the following corrections

_SMALL_CORRECTION = 1e-3  # of a step; smaller ones need not contract

_CORRECTIONS = 8  # at most, in one step

_SMALLEST_STEP = 1e-7  # as a fraction of the largest one

# Steps of this fraction may pass a limit point and branch points at the same time.
_MULTIPLE_POINT_STEP = 4e-4

_TOLERANCE = 1e-9  # on the predicted error of a point, relative to the largest step

_ROUNDING = 1e-8  # Corrections below this fraction of a step may be rounding errors.

_LARGEST_ANGLE = 0.35  # between the tangents of successive points; rad

_GOOD_ANGLE = 0.12

_GROWTH = 2.0

_REDUCTION = 0.4  # of a step that was rejected

# A path has returned if it passes its first point at this fraction of its largest
# displacement, which may be small compared with the metric in a shallow mechanism.
_SAME_PLACE = 0.05

_BLOCK = 16  # steps, after which points are stored

_FIRST_STEP = 0.1  # as a fraction of the largest one

_FIRST_BRANCH_STEP = 0.3

# The direction of a branch is known less exactly than that of a path.
_LARGEST_BRANCH_CORRECTION = 0.8

_LARGEST_BRANCH_ANGLE = 1.2


# A function of a point of the path
PathEvent = Callable[[Float[Array, " n"]], Scalar]


class Metric(NamedTuple):
    """Units of the unknowns, in which a path has an arc length."""

    # Unit of each displacement (rad, m), of each constraint force (N m, N), and of the
    # load factor
    units: Float[Array, " n"]
    # 1 for unknowns that count in the arc length, and 0 for constraint forces
    weights: Float[Array, " n"]

    def length(self, scaled: Float[Array, " n"]) -> Scalar:
        """Compute the length of a vector that has been divided by the units."""
        return jnp.sqrt(jnp.sum(self.weights * scaled**2))


class Step(NamedTuple):
    """Solution of the equations of a correction."""

    correction: Float[Array, " n"]  # Correction of the point, divided by the units
    tangent: Float[Array, " n"]  # Unit tangent of the path, divided by the units
    angle: Scalar  # Angle between the tangent and that of the last point; rad
    # Sign of the determinant of the bordered matrix, which changes at a branch point
    orientation: Scalar


class Node(NamedTuple):
    """Point of a path with its tangent."""

    point: Float[Array, " n"]
    tangent: Float[Array, " n"]  # Unit tangent of the path, divided by the units
    orientation: Scalar  # Orientation, see `Step`; zero at a branch point


class Trace(NamedTuple):
    """Points of a path. Those after the first `number` are not used."""

    points: Float[Array, "points n"]
    tangents: Float[Array, "points n"]  # Unit tangents, divided by the units
    orientations: Float[Array, " points"]  # Orientations; see `Step`
    number: Count  # Number of points
    steps: Count  # Number of evaluations of the tangent stiffness
    status: Count  # Reason of the end
    # The last point that was computed, also if it is out of range
    reached: Float[Array, " n"]


class _State(NamedTuple):
    last: Node  # The last point that was found
    # The last point that was computed, also if it is out of range
    reached: Float[Array, " n"]
    iterate: Float[Array, " n"]  # Current iterate
    # Predicted stress of the hinges, at the iterate and at the last point
    predicted: Float[Array, "2 3 members"]
    # Rate of the tangent along the path at the last point, estimated from the last two
    # tangents
    curvature: Float[Array, " n"]
    size: Scalar  # Length of the current step
    tries: Count  # Number of corrections in this step
    last_correction: Scalar  # Length of the last correction
    # Largest distance from the first point, and its displacements alone
    farthest: Float[Array, "2"]
    number: Count  # Number of points that were found
    steps: Count  # Number of evaluations of the tangent stiffness
    status: Count  # Reason of the end, or `RUNNING`


def solve_step(
    tangent: PathTangent, metric: Metric, border: Float[Array, " n"], excess: Scalar
) -> Step:
    """Solve for a correction in the plane whose normal is `border`, and for the tangent.

    `excess` is the distance of the point from this plane, in the units of the metric.
    """
    matrix = jnp.concatenate([tangent.jacobian, tangent.by_factor[:, None]], axis=1)
    matrix = jnp.concatenate([matrix * metric.units[None], border_row(metric, border)])
    scale = jnp.max(jnp.abs(matrix), axis=1)
    scale = jnp.where(scale > 0, scale, 1.0)
    factors = jax.scipy.linalg.lu_factor(matrix / scale[:, None])
    right = -jnp.concatenate([tangent.residual, excess[None]]) / scale
    along = jnp.zeros_like(right).at[-1].set(1 / scale[-1])
    correction, direction = jax.scipy.linalg.lu_solve(
        factors, jnp.stack([right, along], axis=1)
    ).T
    length = metric.length(direction)
    return Step(
        correction=correction,
        tangent=direction / length,
        angle=jnp.arccos(jnp.clip(metric.length(border) / length, 0.0, 1.0)),
        orientation=determinant_sign(*factors),
    )


def border_row(metric: Metric, border: Float[Array, " n"]) -> Float[Array, "1 n"]:
    """Return the last row of the matrix of a correction."""
    return (metric.weights * border)[None]


def follow(
    system: PathSystem,
    metric: Metric,
    start: Node,
    limits: Float[Array, "2"],
    largest_step: Scalar,
    event: PathEvent | None,
    max_points: Count | int,
    rows: int,
) -> Trace:
    """Follow a path from one of its points.

    The limits are those of the load factor. The path ends with the first point outside of
    them, or behind a change of sign of the event, a function of a point. The trace has
    space for `rows` points, at least `max_points`.
    """
    # The branches of a mechanism that is nearly symmetric do not quite meet.
    at_branch = start.orientation == 0
    size = jnp.where(at_branch, _FIRST_BRANCH_STEP, _FIRST_STEP) * largest_step
    smallest = _SMALLEST_STEP * largest_step
    multiple = _MULTIPLE_POINT_STEP * largest_step

    def advance(state: _State, _) -> tuple[_State, tuple[Flag, Node]]:
        """Correct the iterate, and accept, reject, or continue the step."""
        last = state.last
        tangent = system.tangent(state.iterate, state.predicted[0])
        moved = (state.iterate - last.point) / metric.units
        excess = jnp.sum(metric.weights * last.tangent * moved) - state.size
        step = solve_step(tangent, metric, last.tangent, excess)
        length = metric.length(step.correction)
        first = state.tries == 0
        ratio = jnp.where(first, length / state.size, length / state.last_correction)
        leaves_branch = at_branch & (state.number == 1)
        largest = jnp.where(
            leaves_branch, _LARGEST_BRANCH_CORRECTION, _LARGEST_CORRECTION
        )
        largest = jnp.where(first, largest, _LARGEST_CONTRACTION)
        rounded = length <= _ROUNDING * state.size
        # The error after a Newton correction is the correction times the contraction.
        small = length * jnp.minimum(ratio, 1.0) <= _TOLERANCE * largest_step
        # The stress that the first tangent assumes is extrapolated, and may be wrong for
        # stiff hinges, so that the tangent of the path would be wrong as well.
        small = (small | rounded) & ~first
        turns = step.tangent[-1] * last.tangent[-1] < 0
        branches = step.orientation * last.orientation < 0
        valid = (ratio <= largest) | (length <= _SMALL_CORRECTION * state.size)
        valid &= jnp.all(jnp.isfinite(step.correction))
        angle = jnp.where(leaves_branch, _LARGEST_BRANCH_ANGLE, _LARGEST_ANGLE)
        valid &= ~small | (step.angle <= angle)
        # Limit points and branch points are located one by one, if they are different.
        valid &= ~(small & turns & branches) | (state.size <= multiple)
        converged = valid & small
        rejected = ~valid | (~converged & (state.tries + 1 >= _CORRECTIONS))

        point = state.iterate + metric.units * step.correction
        outside = system.out_of_range(point)
        kept = converged & ~outside & (state.status == RUNNING)
        count = state.number + kept.astype(int)
        slow = jnp.where(state.tries >= 4, 0.7, _GROWTH)
        growth = _GOOD_ANGLE / jnp.where(step.angle > 0, step.angle, 1e-12)
        growth = jnp.clip(jnp.minimum(growth, slow), 0.3, _GROWTH)
        size = state.size * jnp.where(
            converged, growth, jnp.where(rejected, _REDUCTION, 1.0)
        )
        size = jnp.minimum(size, largest_step)

        # The next iterate: corrected, or predicted from this point or from the last one
        change = metric.units * step.correction
        bend = (step.tangent - last.tangent) / state.size
        curvature = jnp.where(converged, bend, state.curvature)
        ahead = metric.units * size * (step.tangent + size / 2 * bend)
        again = size * (last.tangent + size / 2 * state.curvature)
        again = last.point + metric.units * again
        iterate = jnp.where(rejected, again, point + jnp.where(converged, ahead, 0.0))
        stress = tangent.hinges.predicted_stress(system.displacement_change(change))
        # Along the path, the stress of a stiff hinge grows in proportion. A displacement
        # by the curvature would appear to stretch it.
        along = metric.units * size * step.tangent
        far = system.displacement_change(change + jnp.where(converged, along, 0.0))
        next_stress = tangent.hinges.predicted_stress(far)
        next_stress = jnp.where(rejected, state.predicted[1], next_stress)
        own_stress = jnp.where(converged, stress, state.predicted[1])

        from_start = (point - start.point) / metric.units
        distance = metric.length(from_start)
        displaced = metric.length(from_start.at[-1].set(0.0))
        occurred = undefined = jnp.zeros((), bool)
        if event is not None:
            product = event(point) * event(last.point)
            occurred, undefined = product < 0, jnp.isnan(product)
        # The displacements beside the tangent at the first point
        passed = jnp.sum(metric.weights * start.tangent * from_start)
        beside = (from_start - passed * start.tangent).at[-1].set(0.0)
        same_direction = jnp.sum(metric.weights * step.tangent * start.tangent) > 0.8
        returned = (distance < state.size) & same_direction
        returned &= state.farthest[0] > 4 * largest_step
        returned &= metric.length(beside) < _SAME_PLACE * state.farthest[1]
        status = jnp.select(
            [
                converged & outside,
                kept & undefined,
                kept & occurred,
                kept & ((point[-1] < limits[0]) | (point[-1] > limits[1])),
                kept & returned,
                count >= max_points,
                rejected & (size < smallest),
            ],
            [OUT_OF_RANGE, UNDEFINED, AT_EVENT, AT_LIMIT, RETURNED, FULL, TOO_SHORT],
            RUNNING,
        )
        node = Node(point, step.tangent, step.orientation)
        new = _State(
            last=select(kept, node, last),
            reached=jnp.where(converged, point, state.reached),
            iterate=iterate,
            predicted=jnp.stack([next_stress, own_stress]),
            curvature=curvature,
            size=size,
            tries=jnp.where(converged | rejected, 0, state.tries + 1),
            last_correction=length,
            farthest=jnp.maximum(
                state.farthest, jnp.where(kept, jnp.stack([distance, displaced]), 0.0)
            ),
            number=count,
            steps=state.steps + 1,
            status=status,
        )
        return select(state.status == RUNNING, new, state), (kept, node)

    def advance_block(carry: tuple[_State, Node]) -> tuple[_State, Node]:
        """Take several steps, and store the points that were found."""
        state, nodes = carry
        new, (kept, found) = jax.lax.scan(advance, state, length=_BLOCK)
        row = jnp.where(kept, state.number + jnp.cumsum(kept.astype(int)) - 1, rows)
        nodes = jax.tree.map(
            lambda stored, values: stored.at[row].set(values, mode="drop"), nodes, found
        )
        return new, nodes

    finite = jnp.all(jnp.isfinite(start.tangent)) & jnp.all(jnp.isfinite(start.point))
    zero, one = jnp.zeros(()), jnp.ones((), int)
    stress = system.generalized_stress(start.point)
    # Along one of several branches that leave a point, the stiffness in the directions of
    # the others is singular at the load factor of this point.
    ahead = metric.units * size * start.tangent
    ahead = ahead.at[-1].add(jnp.where(at_branch, size**2 / 8, 0.0))
    state = _State(
        last=start,
        reached=start.point,
        iterate=start.point + ahead,
        predicted=jnp.stack([stress, stress]),
        curvature=0 * start.tangent,
        size=size,
        tries=0 * one,
        last_correction=zero,
        farthest=jnp.zeros(2),
        number=one,
        steps=0 * one,
        status=jnp.where(finite, RUNNING, NOT_FINITE),
    )
    nodes = jax.tree.map(
        lambda value: jnp.zeros((rows, *value.shape)).at[0].set(value), start
    )
    # Each iteration of a `while` loop of a batch copies all that it carries, so the
    # points are stored once for each block of steps.
    state, nodes = jax.lax.while_loop(
        lambda carry: carry[0].status == RUNNING, advance_block, (state, nodes)
    )
    return Trace(
        *nodes,
        number=state.number,
        steps=state.steps,
        status=state.status,
        reached=state.reached,
    )
