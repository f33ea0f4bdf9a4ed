"""Lagrange multipliers of the active limits and bounds of an optimum."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .problem import Evaluation, Problem


# A limit is active if its margin is below this part of its scale. A bound is active if
# the distance to it is below this part of the scale of the variable.
_ACTIVE_TOLERANCE = 1e-5
# Multipliers below this part of the largest one are rounding errors.
_ROUNDING = 1e-12


class Multipliers(NamedTuple):
    """Multipliers that fulfill the first-order conditions best.

    At an optimum, the gradient of the minimized objective is the sum of the gradients of
    the margins times their multipliers, and of the multipliers of the bounds.

    Args:
        margins: Multiplier of each margin; zero if its limit is not active.
        bounds: Multiplier of each variable: positive at an active lower bound, negative
            at an active upper bound, and otherwise zero.
        active_margins: Rows of the active margins.
        active_bounds: Variables that are at a bound.
        residual: Norm of the difference.
    """

    margins: Float[np.ndarray, " margins"]
    bounds: Float[np.ndarray, " variables"]
    active_margins: Int[np.ndarray, " active"]
    active_bounds: Int[np.ndarray, " at_bound"]
    residual: float


def find_multipliers(problem: Problem, evaluation: Evaluation) -> Multipliers:
    """Compute the multipliers at a design, in the normalized form of the problem.

    Args:
        problem: The problem.
        evaluation: Outputs of the design and their derivatives.

    Returns:
        The multipliers, which are positive for limits and bounds that oppose the
        objective.
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
    by_margin = np.zeros(len(margins.names))
    by_margin[active] = factors[: len(active)]
    by_margin[equalities] -= factors[len(active) : len(active) + len(equalities)]
    by_bound = np.zeros(len(point))
    by_bound[at_bound] = factors[len(active) + len(equalities) :] * sides[at_bound]
    return Multipliers(by_margin, by_bound, active, at_bound, norm)
