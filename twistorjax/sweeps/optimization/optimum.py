"""Result of an optimization: optimum, active limits, and ends of all searches."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..._utils.types import NumbersLike
from ...designs.design_space import DesignSpace
from ...results.codes import result_message, RESULT_NAMES, result_names, RESULTS
from ...results.tables import Column, dataset
from .limits import Limit
from .violations import Violations, violations


if TYPE_CHECKING:
    import xarray


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
        given = self.standard_deviations
        if standard_deviations is not None:
            given = standard_deviations
        return violations(
            self.study, self.parameters, self.limits, given, count, seed, sweep_options
        )

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
        count = len(self.searches.results)
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        if not self.succeeded:
            names = Counter(RESULT_NAMES[code] for code in self.searches.results)
            ends = ", ".join(f"{number} {name}" for name, number in names.items())
            violated = sorted((m, name) for name, m in self.margins.items() if m < -1e-6)
            texts = [f"{name} by {-100 * margin:.3g} %" for margin, name in violated[:5]]
            closest = f"; the closest end violates {', '.join(texts)}" if texts else ""
            return (
                f"{self.name} {how}: no optimum within all limits; searches: {ends}"
                f"{closest}"
            )
        here = len(self.local_optima[0].starts)
        lines = [
            f"{self.name} {how}: {self.objective:.6g}{unit}; {here} of {count} searches "
            "ended here"
        ]
        lines += self._variable_lines()
        if self.active_limits:
            lines += self._limit_lines()
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
        found = sum(len(each.starts) for each in self.local_optima)
        if found < count:
            names = Counter(RESULT_NAMES[code] for code in self.searches.results)
            ends = ", ".join(
                f"{number} {name}" for name, number in names.items()
                if name != "successful"
            )  # fmt: skip
            lines.append(f"searches without an optimum: {ends}")
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
        """Lines with the multiplier of each active limit."""
        texts = [str(each) for each in self.active_limits]
        width = max(12, *map(len, texts))
        lines = [f"{'active limit':<{width}}  {'derivative':>11}  {'for 1 %':>10}"]
        for text, each in zip(texts, self.active_limits, strict=True):
            change = 0.01 * abs(each.limit) * each.derivative
            lines.append(f"{text:<{width}}  {each.derivative:>11.5g}  {change:>+10.4g}")
        return lines
