"""Padding of measurements, so that other numbers of readings need no compilation."""

from dataclasses import replace
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Int

from .._utils.host import all_concrete, padded_size, take_rows
from .estimation.objective import IdentificationProblem
from .experiments.measurement import Measurement


if TYPE_CHECKING:
    from .report import Identification


_SMALLEST_ROW_COUNT = 8


def pad(problem: IdentificationProblem) -> IdentificationProblem:
    """Add rows without readings to all measurements, before their last rows.

    The number of rows is then a power of two, so that problems with other numbers of
    readings use the same compiled programs. Measurements that are traced, and those of
    tests that cannot be padded, are not changed.
    """
    data, held_out = (
        tuple(map(_padded, group)) for group in (problem.data, problem.held_out)
    )
    return replace(problem, data=data, held_out=held_out)


def cut(
    identification: "Identification", problem: IdentificationProblem
) -> "Identification":
    """Remove the rows that `pad` has added to the measurements of a problem."""
    start, of_jacobian = 0, []
    for after, before in zip(identification.problem.data, problem.data, strict=True):
        rows, columns = after.values.shape
        index = np.arange(start, start + rows * columns).reshape(rows, columns)
        of_jacobian.append(index[_kept_rows(len(before.values), rows)].reshape(-1))
        start += rows * columns
    residuals, held_out_residuals = (
        tuple(
            take_rows(table, _kept_rows(len(measurement.values), len(table)))
            for table, measurement in zip(tables, data, strict=True)
        )
        for tables, data in (
            (identification.residuals, problem.data),
            (identification.held_out_residuals, problem.held_out),
        )
    )
    return replace(
        identification,
        jacobian=take_rows(identification.jacobian, np.concatenate(of_jacobian)),
        residuals=residuals,
        held_out_residuals=held_out_residuals,
        problem=problem,
    )


def _padded(measurement: Measurement) -> Measurement:
    """Pad one measurement to a power of two rows."""
    if all_concrete(jax.tree.leaves(eqx.filter(measurement, eqx.is_array))) is None:
        return measurement
    count = len(measurement.values)
    more = padded_size(count, _SMALLEST_ROW_COUNT) - count
    test = measurement.test.with_more_rows(more) if more else None
    if test is None:
        return measurement
    values, deviations = (
        np.asarray(table)
        for table in (measurement.values, measurement.standard_deviations)
    )
    missing = np.full((more, values.shape[1]), np.nan)
    repeated = np.repeat(deviations[-1:], more, axis=0)
    return Measurement(
        test,
        jax.device_put(np.concatenate([values[:-1], missing, values[-1:]])),
        jax.device_put(np.concatenate([deviations, repeated])),
    )


def _kept_rows(count: int, padded: int) -> Int[np.ndarray, " count"]:
    """Return the rows of a padded table that are those of the table itself."""
    return np.append(np.arange(count - 1), padded - 1)
