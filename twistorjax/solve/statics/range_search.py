"""Search for the ends of a range of motion, and their derivatives."""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..._compile.compilation import fast_compile
from ..._utils.types import Count, Entries, Flag, Poses, Scalar
from ...assembly.assembly import HingeAssembly
from ...assembly.stress import largest_stresses
from ...mechanism.constraints import ConstraintSet
from ...mechanism.loads import LoadSet
from ...results.codes import is_success, RESULTS
from ..equations.dofs import DofPartition
from ..equations.load_state import LoadState
from ..equations.system import System
from .newton import CONVERGED, NewtonSolution
from .solution import Equilibrium
from .solver import find_equilibrium, report_equilibrium, search_result


_TOLERANCE, _MOST_STEPS = 1e-10, 400  # of an equilibrium
_MOST_EQUILIBRIA = 200
_GROWTH = 8.0  # largest ratio of successive factors
_PRECISION = 1e-10  # of the stress
_REACHED = 1e-6  # of the stress at an end that is limited by it
_STABILITY = 1e-6  # of the factor, if the range ends without reaching a stress
_ROUNDING = 1e-15  # of the factor, if the precision of the stress cannot be reached


class RangePoint(NamedTuple):
    """An equilibrium within the range of motion.

    Args:
        factor: Factor of the input.
        displacements: Displacements of the bodies; rad, m, m.
        constraint_forces: Constraint forces; N m, N.
    """

    factor: Scalar
    displacements: Poses
    constraint_forces: Entries


class RangeInput(NamedTuple):
    """An input of a mechanism, and what does not depend on it.

    Args:
        hinges: The hinges without strokes.
        reference: Reference poses; rad, m, m.
        loads: Loads of the input.
        constant_loads: Loads that are not multiplied.
        constraints: The constraints.
        targets: Prescribed displacements of the input; rad, m.
        strokes: Strokes of all hinges; None if there are none; rad, m, m.
        time: Time at which the constraints are evaluated; s.
        allowable: Allowable stress of each hinge; Pa.
    """

    hinges: HingeAssembly
    reference: Poses
    loads: LoadSet
    constant_loads: LoadSet
    constraints: ConstraintSet
    targets: tuple[Scalar, ...]
    strokes: Float[Array, "hinges 3"] | None
    time: Scalar
    allowable: Float[Array, " hinges"]

    def hinges_at(self, factor: Scalar) -> HingeAssembly:
        """Return the hinges at a factor of the input."""
        if self.strokes is None:
            return self.hinges
        return self.hinges.with_strokes(factor * self.strokes)

    def loads_at(self, factor: Scalar) -> LoadSet:
        """Return all loads at a factor of the input."""
        return self.constant_loads.plus(self.loads.scaled(factor))

    def system_at(self, factor: Scalar, dofs: DofPartition) -> System:
        """Return the equations at a factor of the input."""
        return System(
            self.hinges_at(factor),
            self.loads_at(factor),
            self.constraints,
            jnp.array([factor * target for target in self.targets], float),
            self.time,
            dofs,
        )

    def next_point(
        self, factor: Scalar, start: RangePoint, dofs: DofPartition
    ) -> tuple[RangePoint, Float[Array, " hinges"], RESULTS]:
        """Search for the equilibrium at a factor of the input, from another one.

        Returns:
            The last point, the stresses there (Pa), and why it is not the equilibrium.
        """
        system = self.system_at(factor, dofs)
        first = LoadState(
            self.loads_at(start.factor),
            self.hinges_at(start.factor).misfits,
            self._multipliers(start),
        )
        solution = find_equilibrium(
            system,
            start.displacements,
            first,
            jnp.asarray(_TOLERANCE),
            jnp.asarray(_MOST_STEPS),
        )
        forces = solution.multipliers
        forces = start.constraint_forces if forces is None else forces
        point = RangePoint(factor, solution.displacements, forces)
        stresses = largest_stresses(system.hinges, point.displacements)
        return point, stresses, search_result(system, solution)

    def results_at(
        self, point: RangePoint, dofs: DofPartition
    ) -> tuple[Equilibrium, Float[Array, " hinges"]]:
        """Compute all results at a known point, and the stresses (Pa), with derivatives.

        The displacements and forces of the point are constants. The derivatives follow
        from the equations.
        """
        system = self.system_at(point.factor, dofs)
        known = NewtonSolution(
            point.displacements,
            self._multipliers(point),
            fraction=jnp.ones(()),
            steps=jnp.zeros((), int),
            status=jnp.asarray(CONVERGED),
        )
        solution = report_equilibrium(
            system, known, self.reference, point.displacements, names=((), ())
        )
        return solution, largest_stresses(system.hinges, solution.displacements)

    def excess(self, stresses: Float[Array, " hinges"]) -> Scalar:
        """Compute the largest ratio of stress and allowable stress, minus 1."""
        return jnp.max(stresses / self.allowable) - 1

    def _multipliers(self, point: RangePoint) -> Entries | None:
        """Return the constraint forces of a point; None without constraints; N m, N."""
        return point.constraint_forces if self.constraints.size else None


class RangeEnd(NamedTuple):
    """An end of the range of motion, or both of them.

    Args:
        factor: Factor of the input; NaN if no end was found.
        equilibrium: Equilibrium at this factor.
        stresses: Largest stress in each hinge; Pa.
        by_stress: Whether an allowable stress is reached; otherwise the equilibrium
            becomes unstable.
        result: Reason of a failure.
    """

    factor: Float[Array, "..."]
    equilibrium: Equilibrium
    stresses: Float[Array, "... hinges"]
    by_stress: Bool[Array, "..."]
    result: RESULTS


class _Search(NamedTuple):
    """State of the search for an end.

    Args:
        lower: Largest factor at which no allowable stress is exceeded.
        excess: Excess of the stress at this factor; see `RangeInput.excess`.
        displacements: Displacements at this factor; rad, m, m.
        constraint_forces: Constraint forces at this factor; N m, N.
        slope: Derivative of the excess by the factor.
        upper: Smallest factor beyond the end; infinite if there is none yet.
        upper_excess: Excess at this factor; NaN if there is no equilibrium.
        weights: Factors of the two excesses in the method of false position.
        last: -1 if the lower end was replaced last, 1 if it was the upper one.
        result: Reason why there is no equilibrium at the upper end.
        confirmed: Whether there is also none a little beyond the upper end. From a point
            that is far away, an equilibrium may not be found although it exists.
        equilibria: Number of equilibria that were computed.
    """

    lower: Scalar
    excess: Scalar
    displacements: Poses
    constraint_forces: Entries
    slope: Scalar
    upper: Scalar
    upper_excess: Scalar
    weights: Float[Array, "2"]
    last: Count
    result: RESULTS
    confirmed: Flag
    equilibria: Count

    def point(self, side: Scalar) -> RangePoint:
        """Return the equilibrium at the lower factor, on the side -1 or 1."""
        return RangePoint(side * self.lower, self.displacements, self.constraint_forces)

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


@partial(fast_compile, jit=jax.jit, static_argnames=("dofs",))
def find_ends(given: RangeInput, start: Poses, *, dofs: DofPartition) -> RangeEnd:
    """Compute both ends of the range, with one more axis in front."""
    return jax.vmap(lambda side: _end(given, start, side, dofs))(jnp.array([-1.0, 1.0]))


def _end(given: RangeInput, start: Poses, side: Scalar, dofs: DofPartition) -> RangeEnd:
    """Compute the end on one side, -1 or 1; see `find_ends`."""
    search = _find(*jax.lax.stop_gradient((given, start)), side, dofs)
    found = jnp.abs(search.excess) < _REACHED
    point = search.point(side)
    factor = _factor_with_derivative(point, given, found, dofs)
    solution, stresses = given.results_at(point._replace(factor=factor), dofs)
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
    factor = jnp.where(failed, jnp.nan, factor)
    stresses = jnp.where(failed, jnp.nan, stresses)
    return RangeEnd(factor, solution, stresses, found, result)


def _find(given: RangeInput, start: Poses, side: Scalar, dofs: DofPartition) -> _Search:
    """Search for the end on one side."""
    excess = given.excess(largest_stresses(given.hinges, start))
    zero = jnp.zeros(())
    state = _Search(
        lower=zero,
        excess=excess,
        displacements=start,
        constraint_forces=jnp.zeros(given.constraints.size),
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
        lower = search.point(side)
        point, stresses, result = given.next_point(side * factor, lower, dofs)
        excess = jnp.where(is_success(result), given.excess(stresses), jnp.nan)
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
            displacements=select(point.displacements, search.displacements),
            constraint_forces=select(point.constraint_forces, search.constraint_forces),
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


@eqx.filter_custom_jvp
def _factor_with_derivative(
    point: RangePoint, given: RangeInput, by_stress: Flag, dofs: DofPartition
) -> Scalar:
    """Return the factor of an end with a derivative, which is NaN if not `by_stress`."""
    del given, by_stress, dofs
    return point.factor


@_factor_with_derivative.def_jvp
def _(primals, tangents):
    # At the end, the excess of the stress is zero, also if the mechanism changes.
    point, given, by_stress, dofs = primals
    _, change, *_ = tangents
    factor = point.factor

    def excess(factor: Scalar, given: RangeInput) -> Scalar:
        _, stresses = given.results_at(point._replace(factor=factor), dofs)
        return given.excess(stresses)

    _, slope = jax.jvp(lambda value: excess(value, given), (factor,), (1 + 0 * factor,))
    _, rate = eqx.filter_jvp(lambda value: excess(factor, value), (given,), (change,))
    rate = jnp.zeros_like(slope) if rate is None else rate
    return factor, jnp.where(by_stress, -rate / slope, jnp.nan)
