"""Texts on an identification: summary, warnings, and undetermined directions."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Array, Float, Int

from ..results.codes import result_message, result_names
from .estimation.optimizer import exceeds_rounding
from .experiments.measurement import Measurement


if TYPE_CHECKING:
    from .report import Identification


# A direction is undetermined if the standard error of its relative change is larger.
_UNDETERMINED = 1.0
# Pairs of estimates with a larger absolute correlation are reported.
_HIGH_CORRELATION = 0.999
# Larger residuals are outliers, in standard deviations of the readings.
_OUTLIER = 5.0


def count_readings(data: Sequence[Measurement]) -> int:
    """Number of readings of measurements, without the missing ones."""
    return int(sum(np.sum(np.isfinite(np.asarray(each.values))) for each in data))


def summary(identification: "Identification") -> str:
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
    lines += [f"warning: {text}" for text in warnings(identification)]
    return "\n".join(lines)


def warnings(identification: "Identification") -> tuple[str, ...]:
    """Reasons to doubt the estimates or their standard errors."""
    names, problem = identification.names, identification.problem
    undetermined = undetermined_directions(identification)
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


def undetermined_directions(identification: "Identification") -> tuple[str, ...]:
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
            effect = f"the readings by {effect:.1g} standard deviations"
        else:
            continue
        change = _describe_direction(identification, direction)
        texts.append(f"changing {change} changes {effect}")
    return tuple(texts)


def undetermined_changes(
    identification: "Identification",
) -> Float[np.ndarray, "directions parameters"]:
    """Changes of the normalized parameters that the readings do not show.

    Each change has the length 1. There are at most three.
    """
    _, values, directions = np.linalg.svd(np.asarray(identification.jacobian))
    values = np.pad(values, (0, len(directions) - len(values)))
    return directions[values < 1 / _UNDETERMINED][-3:]


def _warnings_on_residuals(identification: "Identification") -> list[str]:
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
    return float(np.sqrt(squares / max(1, count_readings(data))))


def _robust_rms(identification: "Identification") -> float:
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


def _outliers(identification: "Identification") -> list[str]:
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
    identification: "Identification",
) -> Float[np.ndarray, " parameters"]:
    """Changes of the normalized parameters that change each value by 100 % of `scales`.

    This is 100 % of the value, or of the distance to its bound.
    """
    parameters = identification.problem.parameters
    derivatives = np.abs(parameters.derivatives(identification.normalized))
    derivatives = np.where(derivatives > 0, derivatives, 1.0)
    return np.asarray(parameters.scales(identification.normalized)) / derivatives


def _at_bounds(identification: "Identification") -> Int[np.ndarray, " at_bound"]:
    """Indices of the parameters that are at a bound."""
    return np.flatnonzero(np.asarray(identification.bound_sides))


def _warnings_on_bounds(identification: "Identification") -> list[str]:
    """Warnings on estimates at their bounds."""
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


def _sensitivities(identification: "Identification") -> tuple[np.ndarray, np.ndarray]:
    """Singular value decomposition of the derivatives with respect to relative changes.

    Parameters at a bound are left out, because the readings do not depend on their
    normalized values.

    Returns:
        The singular values, one for each parameter; and the right singular vectors, one
        in each row.
    """
    changes = _full_changes(identification)
    matrix = np.asarray(identification.jacobian) * changes[None]
    matrix = np.delete(matrix, _at_bounds(identification), axis=1)
    _, values, directions = np.linalg.svd(matrix, full_matrices=True)
    return np.pad(values, (0, matrix.shape[1] - values.size)), directions


def _determined_parameters(identification: "Identification") -> np.ndarray:
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


def _describe_direction(identification: "Identification", direction: np.ndarray) -> str:
    """Describe relative changes of parameters; the largest one is an increase by 1 %.

    A change is relative to the estimate, to its distance to a bound, or to the scale of
    an estimate near zero. The direction has an entry for each parameter that is not at a
    bound.
    """
    at_bounds = _at_bounds(identification)
    names = np.delete(identification.names, at_bounds)
    parameters, normalized = identification.problem.parameters, identification.normalized
    scales = np.asarray(parameters.scales(normalized))
    is_free = [name not in parameters.bounded for name in identification.names]
    estimates = np.abs(np.asarray(parameters.vector(normalized)))
    sizes = np.where(is_free & (estimates > 0.01 * scales), estimates, scales)
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
