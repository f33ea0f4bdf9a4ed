"""Optimization problem in the normalized form that a solver takes."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..._utils.pytrees import entry_names
from ..._utils.validation import quote
from ...designs.design_space import DesignSpace
from ...results.codes import RESULT_NAMES
from ...results.tables import Column, Columns
from ..outputs import StudyOutput
from .limits import Limit


class Evaluation(NamedTuple):
    """Outputs of a design, and their derivatives.

    Args:
        vector: Real numbers of the design.
        values: The objective and the limited outputs.
        jacobian: Derivatives with respect to all real numbers of the design.
        succeeded: Whether the study succeeded, and values and derivatives are finite.
        result: Number of its result; see `RESULTS`.
        deviations: Standard deviations of the outputs, to first order.
        deviation_jacobian: Derivatives of the standard deviations, if they are known.
    """

    vector: Float[np.ndarray, " numbers"]
    values: Float[np.ndarray, " outputs"]
    jacobian: Float[np.ndarray, "outputs numbers"]
    succeeded: bool
    result: int
    deviations: Float[np.ndarray, " outputs"]
    deviation_jacobian: Float[np.ndarray, "outputs numbers"] | None = None


class OutputVector(NamedTuple):
    """Order of the objective and the limited outputs in one vector.

    Args:
        columns: The columns, by name; their values are shapes.
        parameters: Names of the real parameters of a design.
    """

    columns: Columns
    parameters: tuple[str, ...]

    @classmethod
    def of(
        cls, output: StudyOutput, names: Sequence[str], space: DesignSpace
    ) -> "OutputVector":
        """Select outputs of a study from those of a chunk of designs."""
        columns = {name: output.columns[name] for name in names}
        return cls(columns, space.real_names)

    def slice(self, name: str) -> slice:
        """Return the range of an output in the vector."""
        begin = 0
        for other, column in self.columns.items():
            size = int(np.prod(column.values.shape[1:], dtype=int))
            if other == name:
                return slice(begin, begin + size)
            begin += size
        raise KeyError(name)

    def entry_names(self, name: str) -> list[str]:
        """Return the names of the entries of an output, such as "stress[left]"."""
        column: Column = self.columns[name]
        shape = column.values.shape[1:]
        labels = dict(column.labels)
        if len(shape) == 1 and (entries := labels.get(column.axes[0])):
            return [f"{name}[{entry}]" for entry in entries]
        return entry_names(name, shape)

    def evaluations(
        self,
        vectors: Float[np.ndarray, "designs numbers"],
        deviations: Float[np.ndarray, " numbers"],
        output: StudyOutput,
    ) -> list[Evaluation]:
        """Return the evaluation of each design of a chunk.

        Args:
            vectors: Numbers of each design.
            deviations: Standard deviations of the numbers, which are independent.
            output: Outputs of the study for the chunk.

        Returns:
            The evaluations.
        """
        count = len(output.succeeded)
        values, jacobians = [], []
        for name in self.columns:
            value = np.asarray(output.columns[name].values).reshape(count, -1)
            parts = [
                np.asarray(output.columns[f"{name}_by_{parameter}"].values)
                for parameter in self.parameters
            ]
            rows = [part.reshape(count, value.shape[1], -1) for part in parts]
            values.append(value)
            jacobians.append(np.concatenate(rows, axis=2))
        value, jacobian = (
            np.concatenate(values, axis=1),
            np.concatenate(jacobians, axis=1),
        )
        finite = np.all(np.isfinite(value), axis=1)
        finite &= np.all(np.isfinite(jacobian), axis=(1, 2))
        succeeded = np.asarray(output.succeeded)
        not_finite = RESULT_NAMES.index("not_finite")
        results = np.where(succeeded & ~finite, not_finite, np.asarray(output.result))
        return [
            Evaluation(*row)
            for row in zip(
                vectors,
                value,
                jacobian,
                (succeeded & finite).tolist(),
                results.tolist(),
                np.linalg.norm(jacobian * deviations, axis=2),
                strict=True,
            )
        ]


class Margins(NamedTuple):
    """Distances of limited outputs to their limits; negative if a limit is violated.

    The margin of an output y with the standard deviation s is y - k s - lower, or upper -
    y - k s, with the coverage factor k.

    Args:
        names: Name of each limited entry.
        units: Unit of each entry; empty if it is unknown.
        rows: Row of each entry in the vector of outputs.
        signs: 1 for a lower limit, -1 for an upper limit.
        limits: The limits, in the units of the outputs.
        scales: Numbers by which the margins are divided.
        is_equality: Whether the output is prescribed.
        coverage_factor: Number of standard deviations at which the limits must hold.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    rows: Int[np.ndarray, " margins"]
    signs: Float[np.ndarray, " margins"]
    limits: Float[np.ndarray, " margins"]
    scales: Float[np.ndarray, " margins"]
    is_equality: Bool[np.ndarray, " margins"]
    coverage_factor: float

    @classmethod
    def of(
        cls,
        limits: Mapping[str, Limit],
        outputs: OutputVector,
        units: Mapping[str, str],
        coverage_factor: float,
    ) -> "Margins":
        """Collect the margins of all limited outputs.

        Args:
            limits: Limits of the outputs, by name.
            outputs: Order of the outputs in their vector.
            units: Units of outputs without a unit of their own, by name.
            coverage_factor: Number of standard deviations at which the limits must hold.

        Returns:
            The margins.

        Raises:
            ValueError: A limit has another shape than its output.
        """
        entries = []
        for name, limit in limits.items():
            begin, names = outputs.slice(name).start, outputs.entry_names(name)
            column = outputs.columns[name]
            unit, shape = column.unit or units.get(name, ""), column.values.shape[1:]
            lower = _broadcast(name, limit.lower, shape)
            upper = _broadcast(name, limit.upper, shape)
            for row, (entry, low, high) in enumerate(
                zip(names, lower, upper, strict=True), start=begin
            ):
                is_equality = bool(low == high)
                if np.isfinite(low):
                    entries.append((entry, unit, row, 1.0, low, is_equality))
                if np.isfinite(high) and not is_equality:
                    entries.append((entry, unit, row, -1.0, high, False))
        columns = list(zip(*entries, strict=True)) or [()] * 6
        bounds = np.array(columns[4], float)
        return cls(
            names=tuple(columns[0]),
            units=tuple(columns[1]),
            rows=np.array(columns[2], int),
            signs=np.array(columns[3], float),
            limits=bounds,
            scales=np.where(bounds == 0, 1.0, np.abs(bounds)),
            is_equality=np.array(columns[5], bool),
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
    """One optimization problem.

    Args:
        space: Numbers of the design.
        margins: Margins of the limits.
        sign: 1 if the objective is minimized, -1 if it is maximized.
        objective_scale: Number by which the objective is divided.
    """

    space: DesignSpace
    margins: Margins
    sign: float
    objective_scale: float = 1.0

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
        variables = self.space.is_variable
        scales = self.space.scales[variables]
        return self.space.lower[variables] / scales, self.space.upper[variables] / scales

    def normalized(
        self, vector: Float[np.ndarray, " numbers"]
    ) -> Float[np.ndarray, " variables"]:
        """Return the normalized variables of a design."""
        return (vector / self.space.scales)[self.space.is_variable]

    def vector(
        self, point: Float[np.ndarray, " variables"]
    ) -> Float[np.ndarray, " numbers"]:
        """Return the numbers of the design with these normalized variables."""
        space = self.space
        vector = space.start.copy()
        values = point * space.scales[space.is_variable]
        lower, upper = space.lower[space.is_variable], space.upper[space.is_variable]
        vector[space.is_variable] = np.clip(values, lower, upper)
        return vector

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
        return float(np.max(self._violations(margins), initial=0.0))

    def _violations(self, margins: np.ndarray) -> np.ndarray:
        return np.where(self.margins.is_equality, np.abs(margins), -margins)

    def _by_variables(self, jacobian: np.ndarray) -> np.ndarray:
        variables = self.space.is_variable
        return jacobian[..., variables] * self.space.scales[variables]


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
