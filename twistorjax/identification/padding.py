"""Tables of readings with more rows, so that many lengths share a compiled program."""

from dataclasses import replace
from functools import singledispatch

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Int

from .._utils.host import all_concrete, as_float, padded_size, take_rows
from .estimation.objective import IdentificationProblem
from .experiments.hinge import HingeTest
from .experiments.measurement import AbstractTest, Measurement
from .experiments.motion import MotionTest
from .experiments.statics import StaticTest
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


def cut(identification: Identification, problem: IdentificationProblem) -> Identification:
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
    added = padded_size(count, _SMALLEST_ROW_COUNT) - count
    test = _with_more_rows(measurement.test, added) if added else None
    if test is None:
        return measurement
    values, deviations = (
        np.asarray(table)
        for table in (measurement.values, measurement.standard_deviations)
    )
    missing = np.full((added, values.shape[1]), np.nan)
    repeated = np.repeat(deviations[-1:], added, axis=0)
    return Measurement(
        test,
        jax.device_put(np.concatenate([values[:-1], missing, values[-1:]])),
        jax.device_put(np.concatenate([deviations, repeated])),
    )


def _kept_rows(count: int, padded: int) -> Int[np.ndarray, " count"]:
    """Return the rows of a padded table that are those of the table itself."""
    return np.append(np.arange(count - 1), padded - 1)


@singledispatch
def _with_more_rows(test: AbstractTest, count: int) -> AbstractTest | None:
    """Add rows before the last one of a test, which do not change its other rows.

    The result is None if the test cannot be changed in this way.
    """
    del test, count
    return None


@_with_more_rows.register
def _(test: StaticTest, count: int) -> StaticTest:
    return replace(test, load_cases=test.load_cases + count * test.load_cases[-1:])


@_with_more_rows.register
def _(test: MotionTest, count: int) -> MotionTest:
    times = np.asarray(test.times)
    between = np.linspace(times[-2], times[-1], count + 2)[1:-1]
    times = as_float(np.insert(times, -1, between))
    return eqx.tree_at(lambda test: test.times, test, times)


@_with_more_rows.register
def _(test: HingeTest, count: int) -> HingeTest:
    poses = np.asarray(test.poses)
    repeated = np.repeat(poses[-1:], count, axis=0)
    poses = as_float(np.concatenate([poses, repeated]))
    return eqx.tree_at(lambda test: test.poses, test, poses)
