"""First-order conditions of an optimum, and what follows from their multipliers."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .problem import Evaluation, Problem


# A limit may be violated by this part of its scale.
FEASIBILITY_TOLERANCE = 1e-7
# A gradient of the Lagrange function below this part of the gradient of the objective at
# the start is zero.
STATIONARITY_TOLERANCE = 1e-5
# A limit is active if its margin is below this part of its scale. A bound is active if
# the distance to it is below this part of the scale of the variable.
_ACTIVE_TOLERANCE = 1e-5
# Multipliers below this part of the largest one are rounding errors.
_ROUNDING = 1e-12
# A variable has no effect if all derivatives are below this part of the largest one.
_NO_EFFECT = 1e-9


class ActiveLimit(NamedTuple):
    """Limit of an output, or bound of a variable, that determines the optimum.

    Args:
        name: Name of the output or of the variable, such as "stress[left]".
        side: "lower", "upper", or "equal" for a prescribed output.
        limit: The limit or the bound, in `unit`.
        unit: Unit of the limit; empty if it is unknown.
        derivative: Derivative of the optimal objective with respect to the limit, which
            is its Lagrange multiplier, in the unit of the objective over `unit`.
        is_bound: Whether it is a bound of a variable.
    """

    name: str
    side: str
    limit: float
    unit: str
    derivative: float
    is_bound: bool

    def __str__(self) -> str:
        relation = {"lower": ">=", "upper": "<=", "equal": "="}[self.side]
        return f"{self.name} {relation} {self.limit:.6g} {self.unit}".rstrip()


class Sensitivity(NamedTuple):
    """Derivative of the optimal objective with respect to a constant.

    Args:
        name: Name of the constant; "standard deviation of web[0]" for a tolerance.
        value: The constant.
        derivative: The derivative, in the unit of the objective over that of `value`.
    """

    name: str
    value: float
    derivative: float


class Multipliers(NamedTuple):
    """Multipliers that fulfill the first-order conditions best.

    At an optimum, the gradient of the minimized objective is the sum of the gradients of
    the margins times their multipliers, and of the multipliers of the bounds. All are in
    the normalized form of the problem.
    """

    margins: Float[np.ndarray, " margins"]  # Zero if the limit is not active
    # Positive at an active lower bound, negative at an active upper one, otherwise zero
    bounds: Float[np.ndarray, " variables"]
    active_margins: Int[np.ndarray, " active"]  # Rows of the active margins
    # 1 at an active lower bound, -1 at an active upper one, otherwise zero
    bound_sides: Float[np.ndarray, " variables"]
    residual: float  # Norm of the difference


def find_multipliers(problem: Problem, evaluation: Evaluation) -> Multipliers:
    """Compute the multipliers at a design.

    They are positive for limits and bounds that oppose the objective.
    """
    from scipy.optimize import nnls

    margins, gradients = problem.margins, problem.margin_gradients(evaluation)
    gradient = problem.gradient(evaluation)
    active = np.flatnonzero(
        (margins.values(evaluation) < _ACTIVE_TOLERANCE) | margins.is_equality
    )
    lower, upper = problem.bounds
    point = problem.normalized(evaluation.vector)
    sides = (point < lower + _ACTIVE_TOLERANCE) * 1.0
    sides -= (point > upper - _ACTIVE_TOLERANCE) * 1.0
    at_bound = np.flatnonzero(sides)
    equalities = active[margins.is_equality[active]]
    matrix = np.concatenate(
        [gradients[active], -gradients[equalities], np.diag(sides)[at_bound]]
    )
    factors, norm = np.zeros(0), float(np.linalg.norm(gradient))
    if len(matrix):
        factors, norm = nnls(matrix.T, gradient)
        factors = np.where(factors > _ROUNDING * factors.max(), factors, 0.0)
    ends = np.cumsum([len(active), len(equalities)])
    positive, negative, of_bounds = np.split(factors, ends)
    by_margin, by_bound = np.zeros(len(margins.names)), np.zeros(len(point))
    by_margin[active] = positive
    by_margin[equalities] -= negative
    by_bound[at_bound] = of_bounds * sides[at_bound]
    return Multipliers(by_margin, by_bound, active, sides, norm)


def is_optimum(
    problem: Problem, evaluation: Evaluation, tolerance: float = STATIONARITY_TOLERANCE
) -> bool:
    """Decide whether a design fulfills the first-order conditions of an optimum.

    `tolerance` is that of the gradient of the Lagrange function, as a part of the scale
    of the objective.
    """
    if not evaluation.succeeded or problem.violation(evaluation) > FEASIBILITY_TOLERANCE:
        return False
    return find_multipliers(problem, evaluation).residual < tolerance


def active_limits(problem: Problem, multipliers: Multipliers) -> tuple[ActiveLimit, ...]:
    """List the active limits and bounds, with the derivatives of the optimum.

    The optimum of the minimized objective changes by minus the multiplier times the
    increase of a margin.
    """
    margins, space = problem.margins, problem.space
    size = problem.sign * problem.objective_scale
    # Adding zero replaces a negative zero by zero.
    derivatives = size * margins.signs * multipliers.margins / margins.scales + 0.0
    limits = [
        ActiveLimit(
            name=margins.names[row],
            side=margins.sides[row],
            limit=float(margins.limits[row]),
            unit=margins.units[row],
            derivative=float(derivatives[row]),
            is_bound=False,
        )
        for row in multipliers.active_margins
    ]
    for row, side, multiplier in zip(
        np.flatnonzero(space.is_variable),
        multipliers.bound_sides,
        multipliers.bounds,
        strict=True,
    ):
        if side:
            bounds = space.lower if side > 0 else space.upper
            limits.append(
                ActiveLimit(
                    name=space.names[row],
                    side="lower" if side > 0 else "upper",
                    limit=float(bounds[row]),
                    unit=space.units[row],
                    derivative=float(size * multiplier / space.scales[row]),
                    is_bound=True,
                )
            )
    return tuple(limits)


def sensitivities(
    problem: Problem, multipliers: Multipliers, best: Evaluation
) -> tuple[Sensitivity, ...]:
    """Derivatives of the optimum with respect to constants and standard deviations.

    By the envelope theorem, they are the derivatives of the Lagrange function.
    """
    space, margins = problem.space, problem.margins
    weights = problem.sign * problem.objective_scale * multipliers.margins
    by_number = best.jacobian[0] - weights @ margins.jacobian(best)
    found = [
        Sensitivity(space.names[row], float(space.start[row]), float(by_number[row]))
        for row in np.flatnonzero(~space.is_variable)
    ]
    if not space.is_robust:
        return tuple(found)
    # The width k sqrt(sum (s dy/dp)^2) of a margin changes by k s (dy/dp)^2 / sqrt(...).
    deviations = best.deviations[margins.rows]
    changes = np.zeros((len(margins.names), len(space.names)))
    known = deviations > 0
    jacobian = best.jacobian[margins.rows[known]]
    changes[known] = jacobian**2 * space.deviations / deviations[known][:, None]
    widths = -margins.coverage_factor * changes / margins.scales[:, None]
    by_deviation = -weights @ widths
    found += [
        Sensitivity(
            f"standard deviation of {space.names[row]}",
            float(space.deviations[row]),
            float(by_deviation[row]),
        )
        for row in np.flatnonzero(space.deviations)
    ]
    return tuple(found)


def without_effect(
    problem: Problem, multipliers: Multipliers, evaluations: Sequence[Evaluation]
) -> tuple[str, ...]:
    """Names of the variables on which objective and active limits do not depend.

    This is decided at the optimum and at other designs, whose evaluations are given.
    """
    gradients = []
    for each in evaluations:
        if each.succeeded:
            limited = problem.margin_gradients(each)[multipliers.active_margins]
            gradients += [problem.gradient(each)[None], limited]
    if not gradients:
        return ()
    sizes = np.max(np.abs(np.concatenate(gradients)), axis=0)
    is_flat = sizes <= _NO_EFFECT * np.max(sizes)
    rows = np.flatnonzero(problem.space.is_variable)[is_flat]
    return tuple(problem.space.names[row] for row in rows)
