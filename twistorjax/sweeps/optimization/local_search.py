"""Search for a local optimum from one start, by the SLSQP method of SciPy."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...results.codes import RESULT_NAMES
from .conditions import FEASIBILITY_TOLERANCE, is_optimum, STATIONARITY_TOLERANCE
from .problem import Evaluate, Evaluation, Problem


# Violations between these parts of the scale of a limit are corrected by a Newton step.
_ROUNDING, _LARGEST_CORRECTION = 1e-12, 1e-2
# Factors of the objective. SLSQP begins with a unit matrix as second derivatives, so its
# first step has the length of the gradient, unless bounds and limits shorten it. A long
# first step finds better optima and needs fewer evaluations: on the stage of the manual,
# 11 of 64 searches find the best optimum with a factor of 100, and 3 with a factor of 1.
# With a large factor, the line search may end early because of rounding. Then the search
# is repeated with the next factor, from its end if this is closer to all limits.
_FACTORS = (100.0, 10.0, 1.0)
# Where the gradient of the objective has become smaller than this part of its scale, the
# objective is divided by the new gradient, because the first scale may be larger than all
# changes that are left. The search is continued with short first steps, until it does not
# move any more. A search that ends before an optimum is continued once.
_SMALL_GRADIENT, _CONTINUED_FACTORS, _SMALL_MOVE = 1e-2, (0.1,), 1e-5
# Gradients with a smaller sine of the angle between them are linearly dependent. The
# distance from a start with dependent gradients, in typical changes of the variables
_DEPENDENT, _BESIDE = 1e-8, 0.03
# Largest gradient at the end of a search that does not move any more
_TOLERATED_RESIDUAL = 1e-3


class SearchEnd(NamedTuple):
    """End of a search."""

    vector: Float[np.ndarray, " numbers"]  # Numbers of the last design
    result: int  # Number of the result; see `RESULTS`
    evaluations: int  # Number of evaluated designs


class _StudyFailed(Exception):
    """The search cannot continue, because the study failed."""


def search(
    problem: Problem,
    start: Evaluation,
    evaluate: Evaluate,
    *,
    tolerance: float,
    max_steps: int,
) -> SearchEnd:
    """Search for a local optimum; see `optimize` for the tolerance of the objective."""
    if not start.succeeded:
        return SearchEnd(start.vector, start.result, 1)
    point = problem.normalized(start.vector)
    evaluator = _Evaluator(problem, evaluate, point, start)
    end, factors, steps = start, _FACTORS, 0
    tolerated = STATIONARITY_TOLERANCE
    while steps < max_steps:
        moved, new_steps = _improve(
            evaluator, point, factors, tolerance=tolerance, max_steps=max_steps - steps
        )
        steps += new_steps
        is_continued = factors is _CONTINUED_FACTORS
        is_still = is_continued and np.max(np.abs(moved - point)) < _SMALL_MOVE
        point, end = moved, evaluator(moved)
        if is_still:
            tolerated = _TOLERATED_RESIDUAL
            break
        problem, factors = evaluator.problem, _CONTINUED_FACTORS
        if not end.succeeded or problem.violation(end) > FEASIBILITY_TOLERANCE:
            break
        gradient = problem.gradient_size(end)
        if 0 < gradient < _SMALL_GRADIENT * problem.objective_scale:
            evaluator.problem = problem._replace(objective_scale=gradient)
        elif is_continued or is_optimum(problem, end):
            break
    result = RESULT_NAMES.index("not_converged")
    if not end.succeeded:
        result = end.result
    elif is_optimum(problem, end, tolerated):
        result = RESULT_NAMES.index("successful")
    elif problem.violation(end) > FEASIBILITY_TOLERANCE:
        result = RESULT_NAMES.index("no_feasible_design")
    return SearchEnd(problem.vector(point), result, evaluator.count)


def _improve(
    evaluator: "_Evaluator",
    start: Float[np.ndarray, " variables"],
    factors: Sequence[float],
    *,
    tolerance: float,
    max_steps: int,
) -> tuple[Float[np.ndarray, " variables"], int]:
    """Run SLSQP, with one factor of the objective after the other until one succeeds.

    The results are the normalized variables at the end, and the number of steps.
    """
    from scipy.optimize import Bounds, minimize

    problem, point = evaluator.problem, start
    first, steps = evaluator(start), 0
    for factor in factors:
        try:
            point, rows = _independent_limits(evaluator, point)
            constraints = [
                {
                    "type": kind,
                    "fun": lambda x, rows=rows: evaluator.margins(x)[rows],
                    "jac": lambda x, rows=rows: evaluator.margin_gradients(x)[rows],
                }
                for kind, rows in zip(("eq", "ineq"), rows, strict=True)
                if rows.size
            ]
            solution = minimize(
                lambda x, factor=factor: factor * evaluator.objective(x),
                point,
                jac=lambda x, factor=factor: factor * evaluator.gradient(x),
                bounds=Bounds(*problem.bounds),
                constraints=constraints,
                method="SLSQP",
                options={"ftol": tolerance * factor, "maxiter": max_steps - steps},
            )
        except _StudyFailed:
            point = start
            continue
        steps += solution.nit
        point = _restored(evaluator, solution.x)
        end = evaluator(point)
        if is_optimum(problem, end) or steps >= max_steps:
            break
        # A long step may lead to a region without feasible designs.
        if not end.succeeded or problem.violation(end) > problem.violation(first):
            point = start
    return point, steps


def _independent_limits(
    evaluator: "_Evaluator", point: Float[np.ndarray, " variables"]
) -> tuple[Float[np.ndarray, " variables"], list[Int[np.ndarray, " rows"]]]:
    """Leave out limits whose gradients depend linearly on those of prescribed outputs.

    SLSQP cannot solve for its step with them. They follow from the prescribed outputs
    that are kept, or contradict them, which the violation at the end shows. If gradients
    are dependent at the start only, the search begins beside it.

    The results are the normalized variables at which the search begins, the rows of the
    margins of prescribed outputs, and those of the other limits.
    """
    from scipy.linalg import qr

    prescribed = evaluator.problem.margins.is_equality
    if not np.any(prescribed):
        return point, [np.flatnonzero(prescribed), np.flatnonzero(~prescribed)]

    def independent(point: np.ndarray) -> list[np.ndarray]:
        gradients = evaluator.margin_gradients(point)
        norms = np.linalg.norm(gradients, axis=1)
        scaled = gradients / np.where(norms > 0, norms, 1.0)[:, None]
        q, r, order = qr(scaled[prescribed].T, mode="economic", pivoting=True)
        rank = np.sum(np.abs(np.diagonal(r)) > _DEPENDENT)
        equalities = np.flatnonzero(prescribed)[np.sort(order[:rank])]
        basis = q[:, :rank]
        remainders = np.linalg.norm(scaled - scaled @ basis @ basis.T, axis=1)
        is_dependent = (norms > 0) & (remainders < _DEPENDENT) & (rank < point.size)
        return [equalities, np.flatnonzero(~prescribed & ~is_dependent)]

    rows = independent(point)
    if sum(map(len, rows)) == prescribed.size:
        return point, rows
    rng = np.random.default_rng(0)
    beside = point + _BESIDE * rng.uniform(-1.0, 1.0, point.size)
    beside = np.clip(beside, *evaluator.problem.bounds)
    if evaluator(beside).succeeded:
        others = independent(beside)
        if sum(map(len, others)) > sum(map(len, rows)):
            return beside, others
    return point, rows


def _restored(
    evaluator: "_Evaluator", point: Float[np.ndarray, " variables"]
) -> Float[np.ndarray, " variables"]:
    """Move a design onto the limits that it violates, by the shortest Newton step.

    The merit function of SLSQP has no descent direction at a stationary point that
    violates a limit only a little, so a search that begins there would end at once.
    """
    problem, evaluation = evaluator.problem, evaluator(point)
    if not evaluation.succeeded:
        return point
    if not _ROUNDING < problem.violation(evaluation) < _LARGEST_CORRECTION:
        return point
    margins = problem.margins.values(evaluation)
    violated = (margins < 0) | problem.margins.is_equality
    lower, upper = problem.bounds
    is_free = (point > lower) & (point < upper)
    gradients = problem.margin_gradients(evaluation)[violated][:, is_free]
    if not gradients.size:
        return point
    restored = point.copy()
    restored[is_free] -= np.linalg.lstsq(gradients, margins[violated], rcond=None)[0]
    return np.clip(restored, lower, upper)


class _Evaluator:
    """Values and gradients of a problem for the normalized variables of the solver.

    The solver asks for the objective, the margins, and their gradients one after the
    other, which one evaluation answers. At a design for which the study fails, the
    objective is infinite, so that the line search shortens its step.
    """

    def __init__(
        self, problem: Problem, evaluate: Evaluate, point: np.ndarray, start: Evaluation
    ):
        self.problem, self._evaluate = problem, evaluate
        self._point, self._last = np.array(point), start
        self._margins = problem.margins.values(start)
        self.count = 1

    def __call__(self, point: np.ndarray) -> Evaluation:
        if not np.array_equal(point, self._point):
            (self._last,) = self._evaluate(self.problem.vector(point)[None])
            self._point = np.array(point)
            self.count += 1
        return self._last

    def objective(self, point: np.ndarray) -> float:
        evaluation = self(point)
        return self.problem.objective(evaluation) if evaluation.succeeded else np.inf

    def gradient(self, point: np.ndarray) -> np.ndarray:
        return self.problem.gradient(self._succeeded(point))

    def margins(self, point: np.ndarray) -> np.ndarray:
        evaluation = self(point)
        if evaluation.succeeded:
            self._margins = self.problem.margins.values(evaluation)
        return self._margins

    def margin_gradients(self, point: np.ndarray) -> np.ndarray:
        return self.problem.margin_gradients(self._succeeded(point))

    def _succeeded(self, point: np.ndarray) -> Evaluation:
        evaluation = self(point)
        space = self.problem.space
        if space.is_robust and evaluation.deviation_jacobian is None:
            variables = np.flatnonzero(space.is_variable)
            self._last = evaluation = self.problem.with_deviation_jacobian(
                evaluation, variables, self._evaluate
            )
            self.count += 2 * len(variables)
        if not evaluation.succeeded:
            raise _StudyFailed
        return evaluation
