"""Location of a point on a segment of a path: an end, a limit point, a branch point."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._utils.pytrees import select
from ..._utils.types import Count, Flag, Scalar
from .arc_length import Metric, solve_step, Step
from .system import PathSystem, PathTangent


_ITERATIONS = 60
_CORRECTED = 1e-7  # largest correction of an accurate point, as a fraction of the segment
_ROUNDING = 1e-12  # of the position on the segment, as a fraction of its length
# At this distance from an accurate point, as a fraction of the segment, an extrapolation
# is as accurate as a correction.
_CLOSE = 1e-5
# Part of the way back to the last corrected point, from a point that cannot be corrected
_BACK = 0.1


class Segment(NamedTuple):
    """Part of a path between two successive points."""

    points: Float[Array, "2 n"]  # Both points
    tangents: Float[Array, "2 n"]  # Unit tangents at both of them, divided by the units


# A function of a point of the path, of the derivatives, and of the step there. The second
# result is returned with the root.
SegmentFunction = Callable[
    [Float[Array, " n"], PathTangent, Step], tuple[Scalar, Float[Array, " m"]]
]


class Root(NamedTuple):
    """Point of a segment at which a function is zero."""

    point: Float[Array, " n"]
    step: Step  # The step there or nearby
    other_values: Float[Array, " m"]  # The second result of the function, there or nearby
    values: Float[Array, "2"]  # Values of the function on both sides of the root


class _Base(NamedTuple):
    """Point of the path from which others are extrapolated."""

    scaled: Float[Array, " n"]  # The point, divided by the units
    position: Scalar  # Its position
    slope: Float[Array, " n"]  # Rate of the path with the position, there


class _Search(NamedTuple):
    """State of the search for a root on a segment."""

    ends: Float[Array, "2"]  # Both ends of the interval that contains the root
    values: Float[Array, "2"]  # Values of the function at both ends
    position: Scalar  # Position of the current point
    scaled: Float[Array, " n"]  # Current point, divided by the units
    step: Step  # Step at the last accurate point
    # Second result of the function at the last accurate point
    other_values: Float[Array, " m"]
    last_position: Scalar  # Position of the last evaluation of the function
    base: _Base  # Last corrected point
    finished: Flag  # Whether the root has been found
    iterations: Count  # Number of evaluations


def locate(
    system: PathSystem,
    metric: Metric,
    segment: Segment,
    function: SegmentFunction,
    values: Float[Array, "2"],
    other_values: Float[Array, " m"],
    regular: Flag,
    skip: Flag | bool = False,
) -> Root:
    """Find the point of a segment at which a function is zero.

    The position on the segment is that along its first tangent. The root stays in an
    interval, at the ends of which the function has different signs (Illinois method).

    Args:
        values: Values of the function at both ends, with different signs.
        other_values: Second result of the function at one of the ends.
        regular: Whether the equations of a correction are regular at the root. Otherwise
            the root is extrapolated from a point nearby.
        skip: Whether there is nothing to be found, so that the result has no meaning.
    """
    border = metric.weights * segment.tangents[0]
    first, last = segment.points / metric.units[None]
    length = jnp.sum(border * (last - first))
    slopes = segment.tangents / (segment.tangents @ border)[:, None]

    def interpolate(position: Scalar) -> Float[Array, " n"]:
        """Evaluate the cubic polynomial with the points and tangents of both ends."""
        u = position / length
        return (
            (1 + 2 * u) * (1 - u) ** 2 * first
            + u**2 * (3 - 2 * u) * last
            + length * u * (1 - u) * ((1 - u) * slopes[0] - u * slopes[1])
        )

    def predict(position: Scalar, base: _Base) -> Float[Array, " n"]:
        """Extrapolate from a corrected point, or interpolate if it is far away."""
        ahead = position - base.position
        near = jnp.abs(ahead) < 0.05 * length
        return jnp.where(near, base.scaled + ahead * base.slope, interpolate(position))

    def improve(search: _Search) -> _Search:
        """Correct the point, or move it if it is accurate already."""
        tangent = system.tangent(metric.units * search.scaled)
        excess = jnp.sum(border * (search.scaled - first)) - search.position
        step = solve_step(tangent, metric, segment.tangents[0], excess)
        size = metric.length(step.correction)
        # Near a branch point, only rounding errors would be corrected: the point is
        # extrapolated from the last corrected one.
        from_base = search.position - search.base.position
        singular = ~regular & (jnp.abs(from_base) <= _CLOSE * length)
        singular |= ~(size <= jnp.where(regular, jnp.inf, 0.1 * length))
        scaled = search.scaled + jnp.where(singular, 0.0, step.correction)
        # Rounding errors need not become smaller.
        accurate = singular | (size <= _CORRECTED * length)
        accurate |= search.iterations % 6 == 5

        value, other_values = function(metric.units * scaled, tangent, step)
        # So it would be at a branch point that is met by chance. As long as no corrected
        # point is near enough for the extrapolation, one is sought closer to it.
        at_root = jnp.abs(value) <= _CLOSE * jnp.max(jnp.abs(values))
        too_far = ~regular & ~singular & at_root
        at_left = value * search.values[0] > 0
        last_end = jnp.where(at_left, search.ends[0], search.ends[1])
        # The value at an end that stays twice is halved.
        kept = jnp.where(search.last_position == last_end, 0.5, 1.0)
        ends = jnp.stack(
            [
                jnp.where(at_left, search.position, search.ends[0]),
                jnp.where(at_left, search.ends[1], search.position),
            ]
        )
        at_ends = jnp.stack(
            [
                jnp.where(at_left, value, kept * search.values[0]),
                jnp.where(at_left, kept * search.values[1], value),
            ]
        )
        root = jnp.where(value == 0, search.position, _secant(ends, at_ends))
        change = root - search.position
        slope = step.tangent / jnp.sum(border * step.tangent)
        base = select(singular, search.base, _Base(scaled, search.position, slope))
        ahead = jnp.where(value == 0, scaled, predict(root, base))
        finished = (jnp.abs(change) <= _ROUNDING * length) | (value == 0)
        finished |= ends[1] - ends[0] <= _ROUNDING * length
        moved = _Search(
            ends, at_ends, root, ahead, step, other_values, search.position, base,
            finished, search.iterations + 1,
        )  # fmt: skip
        back = search.position - _BACK * from_base
        position, scaled = select(
            too_far, (back, predict(back, search.base)), (search.position, scaled)
        )
        corrected = search._replace(
            position=position, scaled=scaled, iterations=search.iterations + 1
        )
        return select(accurate & ~too_far, moved, corrected)

    zero, ends = jnp.zeros(()), jnp.stack([jnp.zeros(()), length])
    position = _secant(ends, values)
    nothing = Step(0 * first, segment.tangents[0], zero, zero)
    search = _Search(
        ends=ends,
        values=values,
        position=position,
        scaled=interpolate(position),
        step=nothing,
        other_values=other_values,
        last_position=-jnp.ones(()),
        base=_Base(first, zero, slopes[0]),
        finished=jnp.asarray(skip),
        iterations=jnp.zeros((), int),
    )
    search = jax.lax.while_loop(
        lambda search: ~search.finished & (search.iterations < _ITERATIONS),
        improve,
        search,
    )
    return Root(
        metric.units * search.scaled, search.step, search.other_values, search.values
    )


def _secant(ends: Float[Array, "2"], values: Float[Array, "2"]) -> Scalar:
    """Return the root of the secant, or the middle if this is not in the interval."""
    left, right = ends
    root = right - values[1] * (right - left) / (values[1] - values[0])
    inside = jnp.isfinite(root) & (root > left) & (root < right)
    return jnp.where(inside, root, (left + right) / 2)
