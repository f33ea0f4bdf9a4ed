"""Result of an identification: estimates, uncertainties and warnings."""

from collections.abc import Callable, Sequence
from functools import wraps
from statistics import NormalDist
from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._utils.host import as_float, on_host
from .._utils.types import BatchScalar, NumberLike, Parameters
from ..results.codes import result_message, result_names, RESULTS, Solution
from .estimation.objective import IdentificationProblem
from .estimation.optimizer import exceeds_rounding
from .experiments.measurement import Measurement


# A parameter is at its bound if its distance to the bound is exp(-12) of the initial one;
# or if it is less than 1/e of the initial one, and the linearized model has its minimum
# beyond the bound, or nearer to it by a factor of ten.
_AT_BOUND, _NEAR_BOUND, _STEP_TO_BOUND = 12.0, 1.0, 0.9


_Method = TypeVar("_Method", bound=Callable[..., Any])


def _for_each(method: _Method) -> _Method:
    """Apply a method of one identification to each entry of a batch of them."""

    @wraps(method)
    def for_each(self: Any, *arguments: Any) -> Any:
        if self.normalized.ndim == 1:
            return method(self, *arguments)
        return eqx.filter_vmap(lambda one: for_each(one, *arguments))(self)

    return for_each  # pyright: ignore[reportReturnType]


class Identification(Solution):
    """Estimated parameters of a mechanism, and their uncertainties.

    The uncertainties follow from the linearization of the model at the estimates. They
    assume that the errors of the readings are normal, independent, and as large as the
    given standard deviations. If an estimate is at its bound, they are those of the model
    without the bound, and a warning says so.

    The result of `jax.vmap` is a batch of identifications, with one more axis in all
    arrays. The texts are those of one identification:
    `jax.tree.map(lambda array: array[0], batch).warnings`.

    Args:
        estimates: Estimated values, in a pytree with the structure of `start`.
        normalized: Normalized parameters at the estimates: dimensionless changes from the
            initial values, which are relative changes if they are small.
        jacobian: Derivatives of the residuals with respect to the normalized parameters.
        residuals: Residuals of each measurement: predicted minus measured values, divided
            by the standard deviations of the readings.
        held_out_residuals: Residuals of the measurements that were held out.
        loss: Half the sum of the squared residuals, or Huber's loss.
        losses: Loss at the end of the search from each start.
        steps: Number of evaluations.
        result: Result code; `result_names` returns its name.
        problem: Design function, parameters, and measurements.
    """

    estimates: Any
    normalized: Float[Array, "*batch parameters"]
    jacobian: Float[Array, "*batch readings parameters"]
    residuals: tuple[Float[Array, "*batch _rows _columns"], ...]
    held_out_residuals: tuple[Float[Array, "*batch _rows _columns"], ...]
    loss: BatchScalar
    losses: Float[Array, "*batch restarts"]
    steps: Int[Array, "*batch"]
    result: RESULTS
    problem: IdentificationProblem
    _plural: ClassVar[str] = "identifications"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of `covariance`."""
        return self.problem.parameters.names

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters, in the order of `names`."""
        return self.problem.parameters.units

    @property
    @_for_each
    def values(self) -> Float[Array, "*batch parameters"]:
        """Estimated values as a vector, in the order of `names`."""
        return self.problem.parameters.vector(self.normalized)

    @property
    @_for_each
    def normalized_covariance(self) -> Float[Array, "*batch parameters parameters"]:
        """Covariance of the normalized parameters.

        The variance of a parameter that the readings do not determine is infinite. For
        Huber's loss the covariance takes the distribution of the residuals into account.
        """
        xp, (jacobian, growth) = on_host(self.jacobian, self._distance_ratios())
        _, singular_values, directions = xp.linalg.svd(
            jacobian * growth[None], full_matrices=False
        )
        determined = exceeds_rounding(singular_values)
        divisor = xp.where(determined, singular_values, 1.0)
        inverse = xp.where(determined, 1 / divisor, 0.0)
        root = directions.T * inverse[None]
        covariance = root @ root.T
        if self.problem.huber_threshold is not None:
            factor = self._huber_correction(self.problem.huber_threshold)
            covariance = factor * covariance
        covariance = covariance * growth[:, None] * growth[None]
        kept = xp.where(determined[:, None], directions, 0.0)
        undetermined = xp.sum(kept**2, axis=0) < 1 - 1e-9
        diagonal = xp.where(undetermined, xp.inf, xp.diagonal(covariance))
        on_diagonal = np.eye(len(self.names), dtype=bool)
        return as_float(xp.where(on_diagonal, diagonal[None], covariance))

    def _distance_ratios(self) -> Parameters:
        """Ratio of the initial to the final distance of each parameter from its bound.

        It is at least 1. The readings hardly depend on the normalized value of a
        parameter near its bound; with this factor they depend on it as at the start.
        """
        parameters = self.problem.parameters
        start = as_float(np.zeros(len(self.names)))
        xp, (initial, final) = on_host(
            parameters.derivatives(start), parameters.derivatives(self.normalized)
        )
        ratios = initial / xp.maximum(final, 1e-100 * initial)
        return as_float(xp.where(parameters.is_bounded, xp.maximum(ratios, 1.0), 1.0))

    @property
    @_for_each
    def bound_sides(self) -> Int[Array, "*batch parameters"]:
        """Bound at which each estimate is: -1 for the lower, 1 for the upper, 0 for none.

        An estimate is also at its bound if the linearized model has its minimum at the
        bound or beyond it. The search ends before it has reached the bound if the rest of
        the distance is smaller than the standard error.
        """
        xp, (jacobian, growth, normalized, *tables) = on_host(
            self.jacobian, self._distance_ratios(), self.normalized, *self.residuals
        )
        residuals = xp.concatenate([table.reshape(-1) for table in tables])
        if (threshold := self.problem.huber_threshold) is not None:
            residuals = xp.clip(residuals, -threshold, threshold)
        left, singular_values, directions = xp.linalg.svd(
            jacobian * growth[None], full_matrices=False
        )
        determined = exceeds_rounding(singular_values)
        divisor = xp.where(determined, singular_values, 1.0)
        components = xp.where(determined, residuals @ left / divisor, 0.0)
        step = -growth * (components @ directions)
        lower, upper = self.problem.parameters.bounds

        def is_at_bound(change: Any, step: Any) -> Any:
            near = (change > _NEAR_BOUND) & (step >= _STEP_TO_BOUND)
            return near | (change > _AT_BOUND)

        at_lower = is_at_bound(-normalized, -step) & np.isfinite(lower)
        at_upper = is_at_bound(normalized, step) & np.isfinite(upper)
        sides = xp.where(at_lower, -1, xp.where(at_upper, 1, 0))
        return jnp.asarray(sides)

    def _huber_correction(self, threshold: float) -> NumberLike:
        """Factor by which Huber's loss increases the covariance, at least 1.

        The threshold of Huber's loss is in standard deviations.

        Source:
            Huber, Robust Statistics, 1981, section 7.6.
        """
        data = self.problem.data
        xp, tables = on_host(*self.residuals, *(each.values for each in data))
        residuals, values = (
            xp.concatenate([table.reshape(-1) for table in half])
            for half in (tables[: len(data)], tables[len(data) :])
        )
        exists = xp.isfinite(values)
        count = xp.sum(xp.where(exists, 1.0, 0.0))
        parameters = float(len(self.names))
        clipped = xp.clip(residuals, -threshold, threshold)
        is_small = exists & (xp.abs(residuals) <= threshold)
        share = xp.sum(xp.where(is_small, 1.0, 0.0)) / count
        variance = xp.sum(clipped**2) / xp.maximum(count - parameters, 1.0)
        small_sample = 1 + parameters / count * (1 - share) / share
        return xp.maximum(small_sample**2 * variance / share**2, 1.0)

    @property
    @_for_each
    def covariance(self) -> Float[Array, "*batch parameters parameters"]:
        """Covariance of the estimates, in the products of their units.

        The variance of a parameter that the readings do not determine is infinite.
        """
        xp, (covariance, derivatives) = on_host(
            self.normalized_covariance,
            self.problem.parameters.derivatives(self.normalized),
        )
        infinite = xp.isinf(covariance)
        finite = xp.where(infinite, 0.0, covariance)
        scaled = finite * derivatives[:, None] * derivatives[None]
        return as_float(xp.where(infinite, xp.inf, scaled))

    @property
    @_for_each
    def standard_errors(self) -> Any:
        """Standard errors of the estimates, in a pytree with the structure of `start`."""
        xp, (covariance,) = on_host(self.covariance)
        errors = as_float(xp.sqrt(xp.diagonal(covariance)))
        return self.problem.parameters.unflatten(errors)

    @property
    @_for_each
    def correlation(self) -> Float[Array, "*batch parameters parameters"]:
        """Correlation matrix of the estimates."""
        xp, (covariance,) = on_host(self.normalized_covariance)
        on_diagonal = np.eye(len(self.names), dtype=bool)
        errors = xp.sqrt(xp.diagonal(covariance))
        # An undetermined parameter has an infinite variance, and finite covariances.
        others = xp.where(on_diagonal, 0.0, covariance)
        correlation = others / (errors[:, None] * errors[None])
        return as_float(xp.where(on_diagonal, 1.0, correlation))

    @_for_each
    def confidence_interval(self, level: float = 0.95) -> tuple[Any, Any]:
        """Compute confidence intervals of the parameters, within their bounds.

        Args:
            level: Confidence level: share of such intervals that contain the true value.

        Returns:
            The lower and the upper limits, each in a pytree with the structure of
            `start`.

        Raises:
            ValueError: The level is not between 0 and 1.
        """
        if not 0 < level < 1:
            raise ValueError(f"`level` is {level}, but must be between 0 and 1: 0.95.")
        parameters = self.problem.parameters
        xp, (covariance, center, values, derivatives, sides) = on_host(
            self.normalized_covariance,
            self.normalized,
            self.values,
            parameters.derivatives(self.normalized),
            self.bound_sides,
        )
        quantile = NormalDist().inv_cdf((1 + level) / 2)
        half_width = quantile * xp.sqrt(xp.diagonal(covariance))
        # The normalized value of a parameter at its bound is no linear measure of it.
        nonlinear = xp.where(sides == 0, half_width, 0.0)
        linear = xp.where(sides == 0, 0.0, half_width * derivatives)
        limits = []
        for sign in (-1.0, 1.0):
            limit = parameters.vector(as_float(center + sign * nonlinear))
            at_bound = xp.clip(values + sign * linear, *parameters.bounds)
            limit = xp.where(sides == 0, limit, at_bound)
            limits.append(parameters.unflatten(as_float(limit)))
        return limits[0], limits[1]

    @property
    @_for_each
    def mechanism(self) -> Any:
        """Mechanism that the design function builds from the estimates."""
        return self.problem.design(self.estimates)

    @property
    def reading_count(self) -> int:
        """Number of readings from which the parameters were estimated."""
        self._require_one("reading_count")
        return _count_readings(self.problem.data)

    @property
    def undetermined_directions(self) -> tuple[str, ...]:
        """Descriptions of the changes of the parameters that the readings do not show.

        A direction is undetermined if its standard error is larger than a relative change
        of the parameters by 100 %.
        """
        self._require_one("undetermined_directions")
        return _undetermined_directions(self)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reasons to doubt the estimates or their standard errors."""
        self._require_one("warnings")
        return _warnings(self)

    def _require_one(self, name: str) -> None:
        """Raise an error if this is a batch of identifications."""
        if self.normalized.ndim > 1:
            raise ValueError(
                f"`{name}` belongs to one identification, but this is a batch of the "
                f"shape {self.normalized.shape[:-1]}. Select one of them: "
                f"`jax.tree.map(lambda array: array[0], batch).{name}`."
            )

    def _summary(self, names: np.ndarray) -> str:
        del names
        return _summary(self)


# A direction is undetermined if the standard error of its relative change is larger.
_UNDETERMINED = 1.0

# Pairs of estimates with a larger absolute correlation are reported.
_HIGH_CORRELATION = 0.999

# Larger residuals are outliers, in standard deviations of the readings.
_OUTLIER = 5.0


def _count_readings(data: Sequence[Measurement]) -> int:
    """Number of readings of measurements, without the missing ones."""
    return int(sum(np.sum(np.isfinite(np.asarray(each.values))) for each in data))


def _summary(identification: Identification) -> str:
    """Table of the estimates and their standard errors, followed by the warnings."""
    names, problem = identification.names, identification.problem
    rms = _rms(identification.residuals, problem.data)
    title = (
        f"{result_names(identification.result)}: {_plural(len(names), 'parameter')} from "
        f"{_plural(identification.reading_count, 'reading')} in "
        f"{_plural(int(identification.steps), 'evaluation')}; RMS residual {rms:.3g} "
        "standard deviations"
    )
    if identification.held_out_residuals:
        held_out_rms = _rms(identification.held_out_residuals, problem.held_out)
        title += f", {held_out_rms:.3g} of the held-out readings"
    width = max(map(len, (*names, "parameter")))
    lines = [title, f"{'parameter':<{width}}  {'estimate':>15}  {'± standard error':>18}"]
    errors = np.sqrt(np.diagonal(np.asarray(identification.covariance)))
    determined = _determined_parameters(identification)
    values = np.asarray(identification.values)
    sides = np.asarray(identification.bound_sides)
    units = identification.units
    rows = zip(names, values, errors, determined, units, sides, strict=True)
    for name, value, error, is_determined, unit, side in rows:
        uncertainty = f"± {error:.2g} {unit}".rstrip()
        if side:
            uncertainty += "  at its bound"
        digits = 3
        if not is_determined:
            uncertainty = f"{unit}  not determined".strip()
        elif error > 0 and value != 0:  # as many digits as the standard error has
            digits = min(10, max(3, 2 - int(np.floor(np.log10(error / abs(value))))))
        lines.append(f"{name:<{width}}  {value:>15.{digits}g}  {uncertainty}")
    lines += [f"warning: {text}" for text in _warnings(identification)]
    return "\n".join(lines)


def _warnings(identification: Identification) -> tuple[str, ...]:
    """Reasons to doubt the estimates or their standard errors."""
    names, problem = identification.names, identification.problem
    undetermined = _undetermined_directions(identification)
    texts = [f"not determined: {text}" for text in undetermined]
    result = str(result_names(identification.result))
    if result != "successful":
        texts.append(result_message(result))
    texts += _warnings_on_residuals(identification)
    is_high = np.abs(np.asarray(identification.correlation)) > _HIGH_CORRELATION
    if undetermined:  # They show high correlations already.
        is_high[:] = False
    for row, column in np.argwhere(np.triu(is_high, 1)):
        texts.append(
            f"the estimates of {names[row]} and {names[column]} have the correlation "
            f"{identification.correlation[row, column]:.6f}: only a combination of them "
            "is known well"
        )
    if identification.held_out_residuals:
        rms = _rms(identification.residuals, problem.data)
        held_out_rms = _rms(identification.held_out_residuals, problem.held_out)
        if held_out_rms > 2 * max(rms, 1.0):
            texts.append(
                f"the RMS residual of the held-out readings is {held_out_rms:.3g} "
                f"standard deviations, that of the fitted readings {rms:.3g}"
            )
    texts += _warnings_on_bounds(identification)
    losses = np.asarray(identification.losses)
    if losses.size > 1:
        best = np.sum(losses <= losses.min() * 1.001 + 1e-9)
        if best < losses.size:
            texts.append(
                f"{losses.size - best} of {losses.size} starts ended with a larger loss "
                "than the best one"
            )
    return tuple(texts)


def _undetermined_directions(identification: Identification) -> tuple[str, ...]:
    """Descriptions of the changes of the parameters that the readings do not show."""
    if str(result_names(identification.result)) not in ("successful", "not_converged"):
        return ()
    singular_values, directions = _sensitivities(identification)
    texts = []
    for singular_value, direction in zip(singular_values, directions, strict=True):
        if singular_value <= 1e-15 * singular_values.max(initial=0.0):
            effect = "no reading"
        elif 1 / singular_value > _UNDETERMINED:
            effect = 0.01 * singular_value / np.abs(direction).max()
            # Smaller effects are rounding errors.
            size = f"{effect:.1g}" if effect >= 1e-6 else "less than 1e-06"
            effect = f"the readings by {size} standard deviations"
        else:
            continue
        change = _describe_direction(identification, direction)
        texts.append(f"changing {change} changes {effect}")
    return tuple(texts)


def undetermined_changes(
    identification: Identification,
) -> Float[np.ndarray, "directions parameters"]:
    """Changes of the normalized parameters that the readings do not show.

    Each change has the length 1. There are at most three.
    """
    _, values, directions = np.linalg.svd(np.asarray(identification.jacobian))
    values = np.pad(values, (0, len(directions) - len(values)))
    return directions[values < 1 / _UNDETERMINED][-3:]


def _warnings_on_residuals(identification: Identification) -> list[str]:
    """Warnings on missing degrees of freedom, large residuals and outliers."""
    problem = identification.problem
    readings = identification.reading_count
    singular_values, _ = _sensitivities(identification)
    rank = int(np.sum(exceeds_rounding(singular_values)))
    degrees_of_freedom = readings - rank
    texts = []
    if degrees_of_freedom <= 0:
        texts.append(
            f"{_plural(readings, 'reading')} for {_plural(rank, 'parameter')}: there are "
            "no degrees of freedom left, so small residuals do not confirm the model"
        )
    else:
        rms = _rms(identification.residuals, problem.data)
        if problem.huber_threshold is not None:
            rms = _robust_rms(identification)
        ratio = rms * np.sqrt(readings / degrees_of_freedom)
        if ratio > 1 + 4 / np.sqrt(2 * degrees_of_freedom):
            texts.append(
                f"the residuals are {ratio:.3g} times as large as the standard "
                "deviations of the readings: the model does not describe the mechanism, "
                "or the sensors have larger errors. The standard errors of the estimates "
                "are too small, at least by this factor"
            )
    if problem.huber_threshold is not None and (outliers := _outliers(identification)):
        texts.append(f"outliers, in standard deviations: {', '.join(outliers)}")
    return texts


def _rms(tables: Sequence[Array], data: Sequence[Measurement]) -> float:
    """Root mean square of residuals; those of missing readings are zero."""
    squares = sum(float(np.sum(np.square(table))) for table in tables)
    return float(np.sqrt(squares / max(1, _count_readings(data))))


def _robust_rms(identification: Identification) -> float:
    """Standard deviation of the residuals, estimated from their median magnitude.

    Outliers hardly affect it. For a normal distribution the standard deviation is 1.4826
    times the median of the absolute values.
    """
    data = identification.problem.data
    magnitudes = [
        np.abs(np.asarray(table))[np.isfinite(np.asarray(measurement.values))]
        for table, measurement in zip(identification.residuals, data, strict=True)
    ]
    return float(1.4826 * np.median(np.concatenate(magnitudes)))


def _outliers(identification: Identification) -> list[str]:
    """Descriptions of the largest outliers, at most five."""
    data = identification.problem.data
    found = [
        (abs(value), f"{measurement.test.columns[column]} in row {row} ({value:.3g})")
        for table, measurement in zip(identification.residuals, data, strict=True)
        for (row, column), value in np.ndenumerate(np.asarray(table))
        if abs(value) > _OUTLIER
    ]
    return [text for _, text in sorted(found, reverse=True)[:5]]


def _full_changes(
    identification: Identification,
) -> Float[np.ndarray, " parameters"]:
    """Changes of the normalized parameters that change each value by 100 % of `scales`.

    This is 100 % of the value, or of the distance to its bound.
    """
    parameters = identification.problem.parameters
    derivatives = np.abs(parameters.derivatives(identification.normalized))
    derivatives = np.where(derivatives > 0, derivatives, 1.0)
    return np.asarray(parameters.scales(identification.normalized)) / derivatives


def _at_bounds(identification: Identification) -> Int[np.ndarray, " at_bound"]:
    """Indices of the parameters that are at a bound."""
    return np.flatnonzero(np.asarray(identification.bound_sides))


def _warnings_on_bounds(identification: Identification) -> list[str]:
    texts = []
    lower, upper = identification.problem.parameters.bounds
    for k in _at_bounds(identification):
        bound = (lower if identification.bound_sides[k] < 0 else upper)[k]
        value = f"{bound:g} {identification.units[k]}".strip()
        texts.append(
            f"{identification.names[k]} is at its bound, {value}: the readings indicate "
            "a value at the bound or beyond it. The standard errors are those of the "
            "model without this bound"
        )
    return texts


def _sensitivities(identification: Identification) -> tuple[np.ndarray, np.ndarray]:
    """Singular value decomposition of the derivatives with respect to relative changes.

    The right singular vectors are rows, with one singular value for each parameter.
    Parameters at a bound are left out, because the readings do not depend on their
    normalized values.
    """
    changes = _full_changes(identification)
    matrix = np.asarray(identification.jacobian) * changes[None]
    matrix = np.delete(matrix, _at_bounds(identification), axis=1)
    _, values, directions = np.linalg.svd(matrix, full_matrices=True)
    return np.pad(values, (0, matrix.shape[1] - values.size)), directions


def _determined_parameters(identification: Identification) -> np.ndarray:
    """Decide whether the readings determine each parameter.

    A parameter is not determined if the standard error of its relative change exceeds
    100 %. It is also not determined if its standard error exceeds 10 % and is mostly due
    to undetermined directions, along which the estimates remain at the start.
    """
    variances = np.diagonal(np.asarray(identification.normalized_covariance))
    relative = np.sqrt(variances) / _full_changes(identification)
    singular_values, directions = _sensitivities(identification)
    inverse = 1 / np.maximum(singular_values, 1e-150)
    shares = (directions * inverse[:, None]) ** 2
    undetermined = np.sum(shares[inverse > _UNDETERMINED], axis=0)
    is_free = undetermined > np.maximum(0.5 * np.sum(shares, axis=0), 0.01)
    at_bounds = _at_bounds(identification)
    kept = np.delete(np.arange(len(variances)), at_bounds)
    determined = relative <= _UNDETERMINED
    determined[kept] &= ~is_free
    determined[at_bounds] = np.isfinite(variances[at_bounds])
    return determined


def _describe_direction(identification: Identification, direction: np.ndarray) -> str:
    """Describe relative changes of parameters; the largest one is an increase by 1 %.

    A change is relative to the estimate, to its distance to a bound, or to the scale of
    an estimate near zero. The direction has an entry for each parameter that is not at a
    bound.
    """
    at_bounds = _at_bounds(identification)
    names = np.delete(identification.names, at_bounds)
    parameters, normalized = identification.problem.parameters, identification.normalized
    scales = np.asarray(parameters.scales(normalized))
    estimates = np.abs(np.asarray(parameters.vector(normalized)))
    is_relative = ~parameters.is_bounded & (estimates > 0.01 * scales)
    sizes = np.where(is_relative, estimates, scales)
    changes = direction * np.delete(scales / sizes, at_bounds)
    changes = changes / changes[np.argmax(np.abs(changes))]
    texts = [
        f"{names[k]} by {changes[k]:+.2g} %"
        for k in np.argsort(-np.abs(changes), kind="stable")
        if abs(changes[k]) >= 0.05
    ]
    if len(texts) > 4:
        texts = [*texts[:4], f"{len(texts) - 4} more"]
    if len(texts) == 1:
        return texts[0]
    return f"{', '.join(texts[:-1])} and {texts[-1]} together"


def _plural(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
