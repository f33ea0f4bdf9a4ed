"""Result of an optimization: the best local optimum, and the ends of all searches."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..._utils.types import NumbersLike
from ...designs.design_space import DesignSpace
from ...designs.sampling import sample_designs
from ...results.codes import result_message, RESULT_NAMES, result_names, RESULTS
from ...results.tables import Column, dataset
from ..sweep import sweep
from .conditions import (
    active_limits,
    ActiveLimit,
    FEASIBILITY_TOLERANCE,
    find_multipliers,
    sensitivities,
    Sensitivity,
    without_effect,
)
from .limits import Limit
from .local_search import SearchEnd
from .problem import Evaluation, output_entry_names, Problem


if TYPE_CHECKING:
    import xarray


# Two searches ended at the same optimum if their normalized variables differ by less.
_SAME_POINT = 1e-3
# Number of starts at which a variable without effect is looked for
_CHECKED_STARTS = 8
# Largest number of limits that are printed
_MOST_PRINTED = 10


class LocalOptimum(NamedTuple):
    """Local optimum at which one or several searches ended.

    Args:
        objective: The objective.
        parameters: The design, as the study takes it.
        starts: Indices of the starts of these searches.
    """

    objective: float
    parameters: Any
    starts: tuple[int, ...]


class Searches(NamedTuple):
    """Starts and ends of all searches.

    Args:
        starts: Real numbers of the design at each start.
        ends: Real numbers of the design at the end of each search.
        objectives: Objective at each end; NaN if the study fails there.
        violations: Largest violation of a limit at each end, divided by the limit.
        results: Number of the result of each search; see `RESULTS`.
        evaluations: Number of designs that each search evaluated.
    """

    starts: Float[np.ndarray, "starts numbers"]
    ends: Float[np.ndarray, "starts numbers"]
    objectives: Float[np.ndarray, " starts"]
    violations: Float[np.ndarray, " starts"]
    results: tuple[int, ...]
    evaluations: tuple[int, ...]


class Violations(NamedTuple):
    """Shares of sampled designs that violate limits.

    Args:
        any_limit: Share of the designs that violate a limit, or for which the study
            fails.
        by_limit: Share of the designs that violate each limit, by the name of the entry
            of the output and the side, such as "stress[left] upper".
        failed: Share of the designs for which the study fails.
        designs: Number of designs.
    """

    any_limit: float
    by_limit: Mapping[str, float]
    failed: float
    designs: int

    def __repr__(self) -> str:
        ranked = sorted(self.by_limit.items(), key=lambda item: -item[1])
        shares = {"any limit": self.any_limit, **dict(ranked[:_MOST_PRINTED])}
        if self.failed:
            shares["failed"] = self.failed
        width = max(map(len, shares))
        lines = [f"share of {self.designs:,} designs that violate a limit"]
        lines += [
            f"{name:<{width}}  {100 * share:7.2f} %" for name, share in shares.items()
        ]
        return "\n".join(lines)


@dataclass(frozen=True, repr=False)
class Optimum:
    """Best design that was found, and how all searches ended.

    Args:
        name: Name of the objective.
        objective: The objective at the optimum; NaN if no optimum was found.
        unit: Unit of the objective; empty if it is unknown.
        maximized: Whether the objective is maximized.
        parameters: The design at the optimum, as the study takes it. If no optimum was
            found, the last design with the smallest violation of the limits.
        outputs: Outputs of the study at the optimum, by name.
        margins: Distance of each limited output to its limit, divided by the limit, by
            the name of the entry and the side, such as "stress[left] upper".
        active_limits: Limits and bounds that determine the optimum, with their
            multipliers.
        sensitivities: Derivatives of the optimal objective with respect to the constants
            among the parameters, and to the standard deviations.
        local_optima: Local optima within all limits, the best one first.
        without_effect: Variables on which neither the objective nor an active limit
            depends, so that other values of them are as good.
        residual: Norm of the gradient of the Lagrange function, which is zero at an exact
            optimum, divided by that of the objective at the first start.
        searches: Starts and ends of all searches.
        result: `RESULTS.successful` or the reason of the failure.
        study: The study.
        space: Names, units, and bounds of the numbers of a design.
        limits: Limits of the outputs, by name.
        standard_deviations: Standard deviations of the uncertain parameters, by name.
        coverage_factor: Number of standard deviations at which the limits hold.
    """

    name: str
    objective: float
    unit: str
    maximized: bool
    parameters: Any
    outputs: Mapping[str, np.ndarray]
    margins: Mapping[str, float]
    active_limits: tuple[ActiveLimit, ...]
    sensitivities: tuple[Sensitivity, ...]
    local_optima: tuple[LocalOptimum, ...]
    without_effect: tuple[str, ...]
    residual: float
    searches: Searches
    result: RESULTS
    study: Callable[[Any], Any]
    space: DesignSpace
    limits: Mapping[str, Limit]
    standard_deviations: Mapping[str, NumbersLike]
    coverage_factor: float

    @property
    def succeeded(self) -> bool:
        """Whether a local optimum within all limits was found."""
        return bool(self.result == RESULTS.successful)

    def succeeded_or_raise(self) -> "Optimum":
        """Return this optimum.

        Raises:
            RuntimeError: No local optimum within all limits was found.
        """
        if self.succeeded:
            return self
        name = str(result_names(self.result))
        raise RuntimeError(f"{self!r}. {result_message(name)}")

    def violations(
        self,
        standard_deviations: Mapping[str, NumbersLike] | None = None,
        *,
        count: int = 10_000,
        seed: int = 0,
        **sweep_options: Any,
    ) -> Violations:
        """Compute how many designs violate a limit if their parameters vary.

        The designs are sampled from normal distributions about the optimum.

        Args:
            standard_deviations: Standard deviation of each uncertain parameter, by name;
                by default those of the optimization.
            count: Number of designs.
            seed: Seed of the random number generator.
            sweep_options: Further arguments of `sweep`, such as `progress`.

        Returns:
            The shares of the designs that violate the limits.

        Raises:
            ImportError: xarray is not installed.
            ValueError: There is no uncertain parameter, or a standard deviation is not
                valid.
        """
        if standard_deviations is None:
            standard_deviations = self.standard_deviations
        if not standard_deviations:
            raise ValueError(
                "No parameter is uncertain. Give `standard_deviations` of some "
                "parameters."
            )
        space = DesignSpace.from_tree(self.parameters, standard_deviations)
        designs = sample_designs(space.normal_tree(), count, method="random", seed=seed)
        table = sweep(self.study, designs, **sweep_options)
        failed = ~np.asarray(table["succeeded"])
        by_limit: dict[str, np.ndarray] = {}
        for name, limit in self.limits.items():
            output = table[name]
            entries = output_entry_names(
                name, output.shape[1:], output.dims[1:], table.coords
            )
            sides = (("lower", limit.lower, 1), ("upper", limit.upper, -1))
            for side, bound, sign in sides:
                if bound is not None:
                    below = (sign * (output.values - bound) < 0).reshape(count, -1)
                    names = [f"{entry} {side}" for entry in entries]
                    by_limit.update(zip(names, below.T, strict=True))
        violated = np.any([failed, *by_limit.values()], axis=0)
        shares = {name: float(np.mean(each)) for name, each in by_limit.items()}
        return Violations(float(np.mean(violated)), shares, float(np.mean(failed)), count)

    def to_xarray(self) -> "xarray.Dataset":
        """Convert the starts and ends of all searches to an xarray dataset.

        Returns:
            The dataset, with the axes `start` and `number`: the real numbers of a design.

        Raises:
            ImportError: xarray is not installed.
        """
        searches = self.searches
        both = ("start", "number")
        numbers = (("number", self.space.names),)
        flags = {
            "flag_values": list(range(len(RESULT_NAMES))),
            "flag_meanings": " ".join(RESULT_NAMES),
        }
        return dataset(
            {
                "start_value": Column(searches.starts, both, "", numbers),
                "end_value": Column(searches.ends, both, "", numbers),
                "unit": Column(np.array(self.space.units), ("number",), "", numbers),
                "objective": Column(searches.objectives, ("start",), self.unit),
                "violation": Column(searches.violations, ("start",), "1"),
                "result": Column(np.array(searches.results), ("start",)),
                "evaluations": Column(np.array(searches.evaluations), ("start",)),
            },
            {"result": flags},
        )

    def __repr__(self) -> str:
        how = "maximized" if self.maximized else "minimized"
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        counts = Counter(RESULT_NAMES[code] for code in self.searches.results)
        ends = {name: f"{count} {name}" for name, count in counts.items()}
        if not self.succeeded:
            violated = sorted((m, name) for name, m in self.margins.items() if m < -1e-6)
            texts = [f"{name} by {-100 * margin:.3g} %" for margin, name in violated[:5]]
            closest = f"; the closest end violates {', '.join(texts)}" if texts else ""
            return (
                f"{self.name} {how}: no optimum within all limits; searches: "
                f"{', '.join(ends.values())}{closest}"
            )
        lines = [
            f"{self.name} {how}: {self.objective:.6g}{unit}; "
            f"{len(self.local_optima[0].starts)} of {counts.total()} searches ended here",
            *self._variable_lines(),
            *self._limit_lines(),
        ]
        if self.sensitivities:
            width = max(8, *(len(each.name) for each in self.sensitivities))
            lines.append(f"{'constant':<{width}}  {'value':>11}  {'derivative':>11}")
            lines += [
                f"{name:<{width}}  {value:>11.6g}  {derivative:>11.5g}"
                for name, value, derivative in self.sensitivities
            ]
        if self.without_effect:
            lines.append(f"variables without effect: {', '.join(self.without_effect)}")
        others: Counter[str] = Counter()
        for each in self.local_optima[1:]:
            others[f"{each.objective:.6g}{unit}"] += len(each.starts)
        if same := others.pop(f"{self.objective:.6g}{unit}", 0):
            lines.append(f"searches with the same objective at other designs: {same}")
        if others:
            texts = [f"{objective} ({number})" for objective, number in others.items()]
            lines.append(f"other local optima (searches): {', '.join(texts)}")
        ends.pop("successful")
        if ends:
            lines.append(f"searches without an optimum: {', '.join(ends.values())}")
        return "\n".join(lines)

    def _variable_lines(self) -> list[str]:
        """Lines with the value of each variable, and the bound at which it is."""
        at_bound = {each.name: each.side for each in self.active_limits if each.is_bound}
        vector = self.space.vector_of(self.parameters)
        rows = np.flatnonzero(self.space.is_variable)
        names = [self.space.names[row] for row in rows]
        width = max(8, *map(len, names))
        lines = [f"{'variable':<{width}}  {'optimum':>11}"]
        for row, name in zip(rows, names, strict=True):
            side = f"  {at_bound[name]} bound" if name in at_bound else ""
            unit = f" {self.space.units[row]}" if self.space.units[row] else ""
            lines.append(f"{name:<{width}}  {vector[row]:>11.6g}{unit}{side}")
        return lines

    def _limit_lines(self) -> list[str]:
        """Lines with the multiplier of each active limit, if there is one."""
        if not self.active_limits:
            return []
        texts = [str(each) for each in self.active_limits]
        width = max(12, *map(len, texts))
        lines = [f"{'active limit':<{width}}  {'derivative':>11}  {'for 1 %':>10}"]
        for text, each in zip(texts, self.active_limits, strict=True):
            change = 0.01 * abs(each.limit) * each.derivative
            lines.append(f"{text:<{width}}  {each.derivative:>11.5g}  {change:>+10.4g}")
        return lines


def summarize(
    problem: Problem, starts: Sequence[Evaluation], ends: Sequence[SearchEnd]
) -> Optimum:
    """Select the best end of all searches of a problem, and compute its multipliers.

    If there is no optimum, the best end has the smallest violation of the limits.
    """
    evaluations = problem.evaluate(np.stack([end.vector for end in ends]))
    succeeded = np.array([each.succeeded for each in evaluations])
    objectives = np.array([each.values[0] for each in evaluations])
    violations = np.array([problem.violation(each) for each in evaluations])
    searches = Searches(
        starts=np.stack([start.vector for start in starts]),
        ends=np.stack([end.vector for end in ends]),
        objectives=np.where(succeeded, objectives, np.nan),
        violations=np.where(succeeded, violations, np.nan),
        results=tuple(end.result for end in ends),
        evaluations=tuple(end.evaluations for end in ends),
    )
    local_optima = _local_optima(problem, searches)
    order = np.lexsort(
        (
            problem.sign * searches.objectives,
            np.maximum(searches.violations, FEASIBILITY_TOLERANCE),
            np.array(searches.results) != 0,
        )
    )  # NaN is last.
    best = evaluations[order[0]]
    if problem.space.is_robust:
        numbers = np.arange(len(problem.space.names))
        best = problem.with_deviation_jacobian(best, numbers, problem.evaluate)
    multipliers = find_multipliers(problem, best)
    result = RESULTS.successful
    if not np.any(succeeded):
        result = RESULTS.no_solution_at_start
    elif not local_optima:
        is_feasible = np.any(searches.violations <= FEASIBILITY_TOLERANCE)
        result = RESULTS.not_converged if is_feasible else RESULTS.no_feasible_design
    margins = problem.margins
    return Optimum(
        name=problem.objective_name,
        objective=float(best.values[0]) if local_optima else float("nan"),
        unit=problem.columns[problem.objective_name].unit,
        maximized=problem.sign < 0,
        parameters=problem.space.tree(best.vector),
        outputs=problem.outputs(best.vector),
        margins={
            f"{name} {side}": float(value)
            for name, side, value in zip(
                margins.names, margins.sides, margins.values(best), strict=True
            )
        },
        active_limits=active_limits(problem, multipliers),
        sensitivities=sensitivities(problem, multipliers, best),
        local_optima=local_optima,
        without_effect=without_effect(
            problem, multipliers, [best, *starts[:_CHECKED_STARTS]]
        ),
        residual=multipliers.residual,
        searches=searches,
        result=result,
        study=problem.study,
        space=problem.space,
        limits=problem.limits,
        standard_deviations=problem.standard_deviations,
        coverage_factor=margins.coverage_factor,
    )


def _local_optima(problem: Problem, searches: Searches) -> tuple[LocalOptimum, ...]:
    """Group the converged searches by their ends, the best optimum first."""
    rows = np.flatnonzero(np.array(searches.results) == 0)
    points = [problem.normalized(end) for end in searches.ends]
    groups: list[list[int]] = []
    for row in rows[np.argsort(problem.sign * searches.objectives[rows], kind="stable")]:
        for group in groups:
            if np.all(np.abs(points[row] - points[group[0]]) < _SAME_POINT):
                group.append(int(row))
                break
        else:
            groups.append([int(row)])
    return tuple(
        LocalOptimum(
            objective=float(searches.objectives[group[0]]),
            parameters=problem.space.tree(searches.ends[group[0]]),
            starts=tuple(sorted(group)),
        )
        for group in groups
    )
