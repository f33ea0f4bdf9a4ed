"""Optimization problem: its compiled program, and the outputs in normalized form.

A solver sees the variables divided by their scales, the minimized objective divided by
the norm of its gradient at the start, and the margins divided by the limits.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..._utils.pytrees import entry_names
from ..._utils.types import NumbersLike
from ..._utils.validation import quote
from ...designs.design_space import DesignSpace
from ...results.codes import RESULT_NAMES
from ...results.tables import Columns
from ..executor import Program
from ..outputs import StudyOutput
from .limits import Limit


# Step of the differences of standard deviations, as a part of the scale of a number
_STEP = 1e-4


class Evaluation(NamedTuple):
    """Outputs of a design, and their derivatives with respect to all its real numbers."""

    vector: Float[np.ndarray, " numbers"]  # Real numbers of the design
    values: Float[np.ndarray, " outputs"]  # The objective, then the limited outputs
    jacobian: Float[np.ndarray, "outputs numbers"]
    succeeded: bool  # Whether the study succeeded, and values and derivatives are finite
    result: int  # Number of its result; see `RESULTS`
    # Standard deviations of the outputs, to first order; their derivatives, if known
    deviations: Float[np.ndarray, " outputs"]
    deviation_jacobian: Float[np.ndarray, "outputs numbers"] | None = None


# A function that evaluates designs
Evaluate = Callable[[Float[np.ndarray, "designs numbers"]], list[Evaluation]]


class Margins(NamedTuple):
    """Distances of limited outputs to their limits; negative if a limit is violated.

    The margin of an output y with the standard deviation s is y - k s - lower, or upper -
    y - k s, with the coverage factor k.
    """

    names: tuple[str, ...]  # Name of each limited entry, such as "stress[left]"
    units: tuple[str, ...]  # Unit of each entry; empty if it is unknown
    rows: Int[np.ndarray, " margins"]  # Row of each entry in the values of an evaluation
    signs: Float[np.ndarray, " margins"]  # 1 for a lower limit, -1 for an upper limit
    limits: Float[np.ndarray, " margins"]  # The limits, in the units of the outputs
    scales: Float[np.ndarray, " margins"]  # Numbers by which the margins are divided
    is_equality: Bool[np.ndarray, " margins"]  # Whether the output is prescribed
    coverage_factor: float

    @classmethod
    def of(
        cls, limits: Mapping[str, Limit], columns: Columns, coverage_factor: float
    ) -> "Margins":
        """Collect the margins of limited outputs, whose columns have one row a design."""
        entries, begin = [], 1  # The first row is the objective.
        for name, limit in limits.items():
            column = columns[name]
            shape = column.values.shape[1:]
            names = output_entry_names(name, shape, column.axes, dict(column.labels))
            bounds = [_broadcast(name, bound, shape) for bound in limit.sides]
            for row, (entry, lower, upper) in enumerate(
                zip(names, *bounds, strict=True), start=begin
            ):
                is_equality = bool(lower == upper)
                if np.isfinite(lower):
                    entries.append((entry, column.unit, row, 1.0, lower, is_equality))
                if np.isfinite(upper) and not is_equality:
                    entries.append((entry, column.unit, row, -1.0, upper, False))
            begin += len(names)
        fields = list(zip(*entries, strict=True)) or [()] * 6
        values = np.array(fields[4], float)
        return cls(
            names=tuple(fields[0]),
            units=tuple(fields[1]),
            rows=np.array(fields[2], int),
            signs=np.array(fields[3], float),
            limits=values,
            scales=np.where(values == 0, 1.0, np.abs(values)),
            is_equality=np.array(fields[5], bool),
            coverage_factor=coverage_factor,
        )

    @property
    def sides(self) -> list[str]:
        """Side of each limit: "lower", "upper", or "equal"."""
        return [
            "equal" if is_equality else "lower" if sign > 0 else "upper"
            for is_equality, sign in zip(self.is_equality, self.signs, strict=True)
        ]

    def with_scales(self, start: Evaluation) -> "Margins":
        """Divide the margins with limits of zero by the sizes of the outputs at a design.

        The others are divided by their limits.
        """
        size = np.abs(start.values[self.rows])
        use = (self.limits == 0) & (size > 0) & np.isfinite(size)
        return self._replace(scales=np.where(use, size, self.scales))

    def values(self, evaluation: Evaluation) -> Float[np.ndarray, " margins"]:
        """Return the margins divided by their scales."""
        margins = self.signs * (evaluation.values[self.rows] - self.limits)
        margins -= self.coverage_factor * evaluation.deviations[self.rows]
        return margins / self.scales

    def jacobian(self, evaluation: Evaluation) -> Float[np.ndarray, "margins numbers"]:
        """Return the derivatives of `values` with respect to all real numbers."""
        rows = self.signs[:, None] * evaluation.jacobian[self.rows]
        if evaluation.deviation_jacobian is not None:
            widths = evaluation.deviation_jacobian[self.rows]
            rows = rows - self.coverage_factor * widths
        return rows / self.scales[:, None]


class Problem(NamedTuple):
    """Objective, limits, and design space of an optimization, and its program."""

    study: Callable[[Any], Any]
    program: Program  # Evaluates the study, and differentiates `columns`
    space: DesignSpace  # Numbers of the design
    objective_name: str
    sign: float  # 1 if the objective is minimized, -1 if it is maximized
    columns: Columns  # The objective and the limited outputs; their values are shapes
    limits: Mapping[str, Limit]  # Limits of the outputs, by name
    margins: Margins
    # Standard deviations of the uncertain parameters, by name
    standard_deviations: Mapping[str, NumbersLike]
    objective_scale: float = 1.0  # Number by which the objective is divided

    def evaluate(self, vectors: Float[np.ndarray, "designs numbers"]) -> list[Evaluation]:
        """Evaluate designs, in as many calls of the program as they need."""
        evaluations: list[Evaluation] = []
        for begin in range(0, len(vectors), self.program.chunk_size):
            chunk = vectors[begin : begin + self.program.chunk_size]
            output = self._output(chunk)
            columns, parts, jacobians = output.columns, [], []
            for name in (self.objective_name, *self.limits):
                part = columns[name].values.reshape(len(output.result), -1)
                by_parameter = [
                    columns[f"{name}_by_{p}"].values.reshape(*part.shape, -1)
                    for p in self.space.layout.names
                ]
                parts.append(part)
                jacobians.append(np.concatenate(by_parameter, axis=2))
            values = np.concatenate(parts, axis=1)
            jacobian = np.concatenate(jacobians, axis=1)
            finite = np.isfinite(values).all(axis=1)
            finite &= np.isfinite(jacobian).all(axis=(1, 2))
            not_finite = RESULT_NAMES.index("not_finite")
            results = np.where(output.succeeded & ~finite, not_finite, output.result)
            rows = zip(
                chunk,
                values,
                jacobian,
                (output.succeeded & finite).tolist(),
                results.tolist(),
                np.linalg.norm(jacobian * self.space.deviations, axis=2),
                strict=False,  # The last rows are padding.
            )
            evaluations += [Evaluation(*row) for row in rows]
        return evaluations

    def outputs(self, vector: Float[np.ndarray, " numbers"]) -> dict[str, np.ndarray]:
        """Return all outputs of the study for one design, without derivatives."""
        columns = self._output(vector[None]).columns
        derivatives = {
            f"{name}_by_{p}" for name in self.columns for p in self.space.layout.names
        }
        return {
            name: np.asarray(column.values[0])
            for name, column in columns.items()
            if name not in derivatives
        }

    def _output(self, vectors: Float[np.ndarray, "designs numbers"]) -> StudyOutput:
        """Call the program for a chunk, padded with copies of its last design."""
        rows = np.minimum(np.arange(self.program.chunk_size), len(vectors) - 1)
        return self.program.evaluate(self.space.program_input(vectors[rows]))

    def scaled(self, start: Evaluation) -> "Problem":
        """Return the problem with scales that follow from a start.

        The gradient of the objective at the start then has the norm 1.
        """
        scale = self.gradient_size(start) or abs(float(start.values[0])) or 1.0
        margins = self.margins.with_scales(start)
        return self._replace(margins=margins, objective_scale=scale)

    def gradient_size(self, evaluation: Evaluation) -> float:
        """Return the norm of the gradient of the objective, which is not scaled."""
        gradient = self._replace(objective_scale=1.0).gradient(evaluation)
        return float(np.linalg.norm(gradient))

    @property
    def bounds(self) -> tuple[Float[np.ndarray, " variables"], ...]:
        """Lower and upper bounds of the normalized variables."""
        return self.normalized(self.space.lower), self.normalized(self.space.upper)

    def normalized(
        self, vector: Float[np.ndarray, " numbers"]
    ) -> Float[np.ndarray, " variables"]:
        """Return the normalized variables of a design."""
        return (vector / self.space.scales)[self.space.is_variable]

    def vector(
        self, point: Float[np.ndarray, " variables"]
    ) -> Float[np.ndarray, " numbers"]:
        """Return the numbers of the design with these normalized variables."""
        space, vector = self.space, self.space.start.copy()
        vector[space.is_variable] = point * space.scales[space.is_variable]
        return np.clip(vector, space.lower, space.upper)

    def objective(self, evaluation: Evaluation) -> float:
        """Return the objective to be minimized, divided by its scale."""
        return float(self.sign * evaluation.values[0] / self.objective_scale)

    def gradient(self, evaluation: Evaluation) -> Float[np.ndarray, " variables"]:
        """Return the derivatives of `objective` by the normalized variables."""
        gradient = self.sign * evaluation.jacobian[0] / self.objective_scale
        return self._by_variables(gradient)

    def margin_gradients(
        self, evaluation: Evaluation
    ) -> Float[np.ndarray, "margins variables"]:
        """Return the derivatives of the margins by the normalized variables."""
        return self._by_variables(self.margins.jacobian(evaluation))

    def violation(self, evaluation: Evaluation) -> float:
        """Return the largest violation of a limit, divided by its scale."""
        margins = self.margins.values(evaluation)
        violations = np.where(self.margins.is_equality, np.abs(margins), -margins)
        return float(np.max(violations, initial=0.0))

    def _by_variables(self, jacobian: np.ndarray) -> np.ndarray:
        return (jacobian * self.space.scales)[..., self.space.is_variable]

    def with_deviation_jacobian(
        self, evaluation: Evaluation, rows: Int[np.ndarray, " k"], evaluate: Evaluate
    ) -> Evaluation:
        """Add the derivatives of the standard deviations by some numbers of the design.

        The standard deviation of an output contains its first derivatives, so that its
        derivatives contain second ones. They are differences of the exact first
        derivatives, with an error of about 1e-8. Exact second derivatives would need a
        program whose compilation takes five times as long, and some solvers have first
        derivatives only.

        `evaluate` evaluates two neighbors of the design for each of the `rows`, which
        are indices of numbers. If the study fails for a neighbor, the evaluation has not
        succeeded.
        """
        vector, space = evaluation.vector, self.space
        neighbors = np.repeat(vector[None], 2 * len(rows), axis=0)
        for row, pair in zip(rows, neighbors.reshape(len(rows), 2, -1), strict=True):
            step = _STEP * space.scales[row]
            # Both are on the same side if there is a bound on the other side.
            if vector[row] + step > space.upper[row]:
                pair[:, row] += [-step, -2 * step]
            elif vector[row] - step < space.lower[row]:
                pair[:, row] += [step, 2 * step]
            else:
                pair[:, row] += [step, -step]
        around = evaluate(neighbors)
        jacobian = np.zeros_like(evaluation.jacobian)
        for row, first, second in zip(rows, around[::2], around[1::2], strict=True):
            # Derivative at zero of the parabola through the three values
            a, b = first.vector[row] - vector[row], second.vector[row] - vector[row]
            slope_a = (first.deviations - evaluation.deviations) / a
            slope_b = (second.deviations - evaluation.deviations) / b
            jacobian[:, row] = b / (b - a) * slope_a - a / (b - a) * slope_b
        failed = next((each for each in around if not each.succeeded), evaluation)
        return evaluation._replace(
            deviation_jacobian=jacobian, succeeded=failed.succeeded, result=failed.result
        )


def output_entry_names(
    name: str, shape: tuple[int, ...], axes: Sequence[Any], labels: Mapping[Any, Any]
) -> list[str]:
    """Return the names of the entries of an output, such as "stress[left]".

    `labels` has names of the entries along an axis, by the name of the axis.
    """
    if len(axes) == 1 and axes[0] in labels:
        return [f"{name}[{label}]" for label in np.asarray(labels[axes[0]])]
    return entry_names(name, shape)


def _broadcast(
    name: str, bound: np.ndarray | None, shape: tuple[int, ...]
) -> Float[np.ndarray, " entries"]:
    """Return a limit of each entry of an output; NaN if there is none."""
    if bound is None:
        return np.full(int(np.prod(shape, dtype=int)), np.nan)
    if bound.shape not in ((), shape):
        raise ValueError(
            f"The limit of {quote(name)} has shape {bound.shape}, but must be one "
            f"number, or have the shape {shape} of the output."
        )
    return np.broadcast_to(bound, shape).ravel()
