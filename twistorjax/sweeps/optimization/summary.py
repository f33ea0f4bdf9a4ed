"""Summary of the searches of one optimization as its optimum."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...results.codes import RESULTS
from .conditions import find_multipliers, Multipliers
from .deviations import neighbors, with_deviation_jacobian
from .local_search import FEASIBILITY_TOLERANCE, SearchEnd
from .optimum import ActiveLimit, LocalOptimum, Optimum, Searches, Sensitivity
from .problem import Evaluation, Problem
from .setup import Setup


# Two searches ended at the same optimum if their normalized variables differ by less.
_SAME_POINT = 1e-3
# A variable has no effect if, at the optimum and at several starts, all derivatives are
# below this part of the largest one.
_NO_EFFECT, _CHECKED_STARTS = 1e-9, 8


def summarize(
    setup: Setup,
    problem: Problem,
    starts: Float[np.ndarray, "starts numbers"],
    ends: Sequence[SearchEnd],
) -> Optimum:
    """Select the best end of all searches, and compute its multipliers.

    Args:
        setup: Setup of the optimization.
        problem: The problem, with its scales.
        starts: Numbers of the design at each start.
        ends: End of the search from each start.

    Returns:
        The optimum. If there is none, the end with the smallest violation of the limits.
    """
    evaluations = setup.evaluate(np.stack([end.vector for end in ends]))
    succeeded = np.array([each.succeeded for each in evaluations])
    objectives = np.array([each.values[0] for each in evaluations])
    violations = np.array([problem.violation(each) for each in evaluations])
    searches = Searches(
        starts=starts,
        ends=np.stack([end.vector for end in ends]),
        objectives=np.where(succeeded, objectives, np.nan),
        violations=np.where(succeeded, violations, np.nan),
        results=tuple(end.result for end in ends),
        evaluations=tuple(end.evaluations for end in ends),
    )
    converged = [end.result == 0 for end in ends]
    local_optima = _local_optima(problem, searches)
    order = np.lexsort(
        (
            problem.sign * np.where(succeeded, objectives, np.inf * problem.sign),
            np.where(succeeded, np.maximum(violations, FEASIBILITY_TOLERANCE), np.inf),
            ~np.array(converged),
        )
    )
    best = evaluations[order[0]]
    if problem.space.is_robust:
        numbers = np.arange(len(problem.space.names))
        around = setup.evaluate(neighbors(problem.space, best.vector, numbers))
        best = with_deviation_jacobian(best, around, numbers)
    multipliers = find_multipliers(problem, best)
    result = RESULTS.successful
    if not local_optima:
        is_feasible = bool(np.any(violations[succeeded] <= FEASIBILITY_TOLERANCE))
        result = RESULTS.not_converged if is_feasible else RESULTS.no_feasible_design
        if not np.any(succeeded):
            result = RESULTS.no_solution_at_start
    outputs = setup.outputs_of(best.vector)
    hidden = {f"{name}_by_{p}" for name in setup.outputs.columns
              for p in setup.outputs.parameters}  # fmt: skip
    return Optimum(
        name=setup.objective,
        objective=float(best.values[0]) if local_optima else float("nan"),
        unit=setup.unit,
        maximized=problem.sign < 0,
        parameters=problem.space.tree(best.vector),
        outputs={
            name: np.asarray(column.values)
            for name, column in outputs.columns.items()
            if name not in hidden
        },
        margins={
            f"{name} {side}": float(value)
            for name, side, value in zip(
                problem.margins.names,
                problem.margins.sides,
                problem.margins.values(best),
                strict=True,
            )
        },
        active_limits=_active_limits(problem, multipliers, best),
        sensitivities=_sensitivities(problem, multipliers, best),
        local_optima=local_optima,
        without_effect=_without_effect(
            problem, multipliers, [best, *setup.evaluate(starts[:_CHECKED_STARTS])]
        ),
        residual=multipliers.residual,
        searches=searches,
        result=result,
        study=setup.study,
        space=problem.space,
        limits=setup.limits,
        standard_deviations=setup.standard_deviations,
        coverage_factor=setup.coverage_factor,
    )


def _local_optima(problem: Problem, searches: Searches) -> tuple[LocalOptimum, ...]:
    """Group the converged searches by their ends, the best optimum first."""
    rows = [row for row, result in enumerate(searches.results) if result == 0]
    rows.sort(key=lambda row: problem.sign * searches.objectives[row])
    groups: list[list[int]] = []
    for row in rows:
        point = problem.normalized(searches.ends[row])
        for group in groups:
            other = problem.normalized(searches.ends[group[0]])
            if np.all(np.abs(point - other) < _SAME_POINT):
                group.append(row)
                break
        else:
            groups.append([row])
    return tuple(
        LocalOptimum(
            objective=float(searches.objectives[group[0]]),
            parameters=problem.space.tree(searches.ends[group[0]]),
            starts=tuple(sorted(group)),
        )
        for group in groups
    )


def _without_effect(
    problem: Problem, multipliers: Multipliers, evaluations: Sequence[Evaluation]
) -> tuple[str, ...]:
    """Names of the variables on which objective and active limits do not depend."""
    gradients = [
        np.concatenate(
            [
                problem.gradient(each)[None],
                problem.margin_gradients(each)[multipliers.active_margins],
            ]
        )
        for each in evaluations
        if each.succeeded
    ]
    if not gradients:
        return ()
    sizes = np.max(np.abs(np.concatenate(gradients)), axis=0)
    is_flat = sizes <= _NO_EFFECT * np.max(sizes)
    rows = np.flatnonzero(problem.space.is_variable)[is_flat]
    return tuple(problem.space.names[row] for row in rows)


def _active_limits(
    problem: Problem, multipliers: Multipliers, best: Evaluation
) -> tuple[ActiveLimit, ...]:
    """List the active limits and bounds, with the derivatives of the optimum.

    The optimum of the minimized objective changes by minus the multiplier times the
    increase of a margin.
    """
    margins, space = problem.margins, problem.space
    size = problem.sign * problem.objective_scale
    # Adding zero replaces a negative zero by zero.
    derivatives = size * margins.signs * multipliers.margins / margins.scales + 0.0
    active = []
    for row in multipliers.active_margins:
        active.append(
            ActiveLimit(
                name=margins.names[row],
                side=margins.sides[row],
                limit=float(margins.limits[row]),
                unit=margins.units[row],
                derivative=float(derivatives[row]),
                is_bound=False,
            )
        )
    variables = np.flatnonzero(space.is_variable)
    for k in multipliers.active_bounds:
        row = variables[k]
        at_lower = abs(best.vector[row] - space.lower[row]) <= abs(
            best.vector[row] - space.upper[row]
        )
        active.append(
            ActiveLimit(
                name=space.names[row],
                side="lower" if at_lower else "upper",
                limit=float((space.lower if at_lower else space.upper)[row]),
                unit=space.units[row],
                derivative=float(size * multipliers.bounds[k] / space.scales[row]),
                is_bound=True,
            )
        )
    return tuple(active)


def _sensitivities(
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
    widths = -problem.margins.coverage_factor * changes / margins.scales[:, None]
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
