"""Search for the ends of a range of motion, along the stable part of a path.

Only the two ends are needed. With the long steps of a root finder, they take a fortieth
of the time of a path with an `until`, and half of its compilation
(`benchmarks.analyses`).
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..._compile.compilation import fast_compile
from ..._utils.pytrees import (
    jvp_of_varied,
    largest_of,
    stop_gradient,
    with_derivative,
)
from ..._utils.types import Count, Flag, Poses, Scalar
from ...results.codes import is_success, RESULTS
from ..equations.load_state import LoadState
from ..statics.solver import find_equilibrium, search_result
from .arc_length import Metric
from .critical_points import (
    differentiable_critical_points,
    null_vectors_of,
    singular_vectors,
)
from .points import differentiable_points, point_values, PointValues, stability_values
from .start import first_point, metric_of
from .system import PathSystem, PathTangent


_TOLERANCE, _MOST_STEPS = 1e-10, 400  # of an equilibrium
_MOST_EQUILIBRIA = 200
_GROWTH = 8.0  # largest ratio of successive factors
_PRECISION = 1e-10  # of the stress
_REACHED = 1e-6  # of the stress at an end that is limited by it
_STABILITY = 1e-6  # of the factor, if the range ends without reaching a stress
_NO_WORK = 1e-6  # of a load in the mode of a branch point, as a fraction of its size
_NO_STIFFNESS = 1e-2  # in a mode at a critical point, as a fraction of that without input
_ROUNDING = 1e-15  # of the factor, if the precision of the stress cannot be reached


class RangeEnd(NamedTuple):
    """An end of the range of motion, or both of them."""

    factor: Float[Array, "..."]  # Factor of the input; NaN if no end was found
    values: PointValues  # Displacements and reactions there
    stresses: Float[Array, "... hinges"]  # Largest stress in each hinge; Pa
    # Whether an allowable stress is reached; otherwise the equilibrium becomes unstable
    by_stress: Bool[Array, "..."]
    result: RESULTS  # Reason of a failure


class _Search(NamedTuple):
    """State of the search for an end."""

    lower: Scalar  # Largest factor at which no allowable stress is exceeded
    excess: Scalar  # Excess of the stress at this factor; see `_excess`
    point: Float[Array, " n"]  # Point of the path there
    slope: Scalar  # Derivative of the excess by the factor
    upper: Scalar  # Smallest factor beyond the end; infinite if there is none yet
    upper_excess: Scalar  # Excess at this factor; NaN if there is no equilibrium
    # Factors of the two excesses in the method of false position
    weights: Float[Array, "2"]
    last: Count  # -1 if the lower end was replaced last, 1 if it was the upper one
    result: RESULTS  # Reason why there is no equilibrium at the upper end
    # Whether there is also none a little beyond the upper end. From a point that is far
    # away, an equilibrium may not be found although it exists.
    confirmed: Flag
    equilibria: Count  # Number of equilibria that were computed

    def is_narrow(self) -> Flag:
        """Decide whether the two factors agree as closely as required."""
        unstable = jnp.isnan(self.upper_excess)
        width = jnp.where(unstable, _STABILITY, _ROUNDING) * self.upper
        return jnp.isfinite(self.upper) & (self.upper - self.lower <= width)

    def next_factor(self) -> Scalar:
        """Choose the next factor: by secant, by false position, or by bisection.

        If the factors agree, it is a little beyond the upper one.
        """
        linear = self.lower - self.excess / self.slope
        forward = self.slope > 0
        farthest = jnp.where(self.lower > 0, _GROWTH * self.lower, 1.0)
        outward = jnp.where(forward, jnp.minimum(linear, farthest), farthest)
        outward = jnp.where(self.lower > 0, outward, farthest)
        middle = jnp.where(
            self.lower > 0, (self.lower + self.upper) / 2, self.upper / _GROWTH
        )
        below = forward & (linear < self.upper) & (self.lower > 0)
        inward = jnp.where(below, linear, middle)
        first, second = self.weights * jnp.stack([self.excess, self.upper_excess])
        width = self.upper - self.lower
        false_position = self.lower - first * width / (second - first)
        bracketed = jnp.where(jnp.isfinite(self.upper_excess), false_position, inward)
        inside = jnp.where(jnp.isfinite(self.upper), bracketed, outward)
        return jnp.where(self.is_narrow(), (1 + 10 * _STABILITY) * self.upper, inside)


@fast_compile
def find_ends(
    system: PathSystem, start: Poses, allowable: Float[Array, " hinges"]
) -> RangeEnd:
    """Compute both ends of the range, with one more axis in front.

    The load factor is the factor of the input, `start` the displacements without it, and
    the allowable stresses are in Pa.
    """
    return jax.vmap(partial(_end, system, start, allowable))(jnp.array([-1.0, 1.0]))


def _end(
    system: PathSystem, start: Poses, allowable: Float[Array, " hinges"], side: Scalar
) -> RangeEnd:
    """Compute the end on one side, -1 or 1; see `find_ends`."""
    fixed, limits = stop_gradient((system, allowable))
    search = _find(fixed, jax.lax.stop_gradient(start), limits, side)
    found = jnp.abs(search.excess) < _REACHED
    arguments = system, allowable, found, start
    point = with_derivative(_end_change, search.point, *arguments)
    values = jax.tree.map(lambda array: array[0], point_values(system, point[None]))
    stresses = system.stresses(point)
    unstable = jnp.zeros((), bool)
    for reason in (
        RESULTS.successful,  # The next equilibrium is not connected to the last one.
        RESULTS.unstable,
        RESULTS.no_equilibrium,
        RESULTS.steps_used_up,
    ):
        unstable |= search.result == reason
    ended = found | (unstable & (search.lower > 0))
    result = RESULTS.where(ended, RESULTS.successful, search.result)
    endless = ~found & ~jnp.isfinite(search.upper)
    result = RESULTS.where(endless, RESULTS.stress_not_reached, result)
    exceeded = (search.lower == 0) & (search.excess > 0)
    result = RESULTS.where(exceeded, RESULTS.stress_exceeded, result)
    failed = result != RESULTS.successful
    factor = jnp.where(failed, jnp.nan, values.load_factor)
    stresses = jnp.where(failed, jnp.nan, stresses)
    return RangeEnd(factor, values, stresses, found, result)


def _end_change(point: Array, arguments: Sequence[Any], tangents: Any) -> Array:
    """Return the change of an end of the range.

    It stays where the excess of the stress is zero, or where the stiffness is singular.
    """
    system, allowable, by_stress, start = arguments
    fixed = stop_gradient(system)
    # The other kind of end may not exist, and would have derivatives that are infinite.
    at_stress = jnp.where(by_stress, point, jnp.nan)
    at_critical = jnp.where(by_stress, jnp.nan, point)
    tangent = fixed.tangent(point)
    metric = metric_of(fixed, tangent, point)
    is_branch, multiplicity = _kind(fixed, metric, tangent, start)
    null = null_vectors_of(fixed, metric, tangent, is_branch, multiplicity)
    null = jax.tree.map(lambda vectors: vectors[None], null)

    def moved(system: PathSystem, allowable: Array) -> Array:
        excess, gradient = jax.value_and_grad(
            lambda at: _excess(system.stresses(at), allowable)
        )(point)
        gradient = jax.lax.stop_gradient(gradient)
        by_excess = differentiable_points(
            system, at_stress[None], gradient[None], excess[None]
        )
        critical = differentiable_critical_points(
            system, metric, at_critical[None], is_branch[None], null
        )
        return jnp.where(by_stress, by_excess, critical)[0]

    return jvp_of_varied(moved, (system, allowable), tangents[:2])[1]


def _kind(
    system: PathSystem, metric: Metric, tangent: PathTangent, start: Poses
) -> tuple[Flag, Count]:
    """Return whether a critical point is a branch point, and its multiplicity."""
    left, _ = singular_vectors(metric, tangent)
    load = metric.units[:-1] * tangent.by_factor
    is_branch = jnp.abs(left @ load) <= _NO_WORK * jnp.linalg.norm(load)
    begin = system.tangent(first_point(system, start, jnp.zeros(())))
    before, after = (
        stability_values(system, metric, tangent) for tangent in (begin, tangent)
    )
    return is_branch, jnp.maximum(jnp.sum(after <= _NO_STIFFNESS * before), 1)


def _excess(
    stresses: Float[Array, " hinges"], allowable: Float[Array, " hinges"]
) -> Scalar:
    """Compute the largest ratio of stress and allowable stress, minus 1."""
    return largest_of(stresses / allowable) - 1


def _next_point(
    system: PathSystem, factor: Scalar, start: Float[Array, " n"]
) -> tuple[Float[Array, " n"], RESULTS]:
    """Search for the equilibrium at a factor of the input, from another point.

    The last result is why the point is not an equilibrium.
    """
    before, displacements, multipliers = system.split(start)
    first = LoadState(
        before.loads,
        before.hinges.misfits,
        multipliers if system.constraints.size else None,
    )
    equations = system.at(factor)
    solution = find_equilibrium(
        equations, displacements, first, jnp.asarray(_TOLERANCE), jnp.asarray(_MOST_STEPS)
    )
    free = solution.displacements.reshape(-1)[equations.free]
    if solution.multipliers is not None:
        multipliers = solution.multipliers
    point = jnp.concatenate([free, multipliers, factor[None]])
    return point, search_result(equations, solution)


def _find(
    system: PathSystem, start: Poses, allowable: Float[Array, " hinges"], side: Scalar
) -> _Search:
    """Search for the end on one side."""
    point = first_point(system, start, jnp.zeros(()))
    excess = _excess(system.stresses(point), allowable)
    zero = jnp.zeros(())
    state = _Search(
        lower=zero,
        excess=excess,
        point=point,
        slope=zero,
        upper=zero + jnp.inf,
        upper_excess=zero + jnp.nan,
        weights=jnp.ones(2),
        last=jnp.zeros((), int),
        result=RESULTS.successful,
        confirmed=jnp.zeros((), bool),
        equilibria=jnp.zeros((), int),
    )

    def unfinished(search: _Search) -> Flag:
        unstable = jnp.isnan(search.upper_excess)
        narrow = search.is_narrow() & (search.confirmed | ~unstable)
        exact = jnp.abs(search.excess) < _PRECISION
        ended = exact | narrow | (search.equilibria >= _MOST_EQUILIBRIA)
        return ~ended & ((search.lower > 0) | (search.excess < 0))

    def improve(search: _Search) -> _Search:
        factor = search.next_factor()
        point, result = _next_point(system, side * factor, search.point)
        excess = _excess(system.stresses(point), allowable)
        excess = jnp.where(is_success(result), excess, jnp.nan)
        succeeded = jnp.isfinite(excess)
        below = succeeded & ((excess <= 0) | (jnp.abs(excess) < _PRECISION))
        # The method of Illinois: an end that is kept twice loses half of its weight.
        weights = jnp.stack(
            [
                jnp.where(~below & (search.last == 1), search.weights[0] / 2, 1.0),
                jnp.where(below & (search.last == -1), search.weights[1] / 2, 1.0),
            ]
        )
        slope = (excess - search.excess) / (factor - search.lower)
        reason = RESULTS.where(below, search.result, result)
        is_beyond = factor > search.upper
        upper = jnp.where(is_beyond & ~succeeded, search.upper, factor)
        upper = jnp.where(below, jnp.where(is_beyond, jnp.inf, search.upper), upper)

        def select(new: Array, old: Array) -> Array:
            return jnp.where(below, new, old)

        return _Search(
            lower=select(factor, search.lower),
            excess=select(excess, search.excess),
            point=select(point, search.point),
            slope=jnp.where(succeeded, slope, search.slope),
            upper=upper,
            upper_excess=select(search.upper_excess, excess),
            weights=weights,
            last=select(jnp.array(-1), jnp.array(1)),
            result=reason,
            confirmed=is_beyond & ~succeeded,
            equilibria=search.equilibria + 1,
        )

    return jax.lax.while_loop(unfinished, improve, state)
