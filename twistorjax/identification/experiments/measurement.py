"""Base classes of tests on mechanisms, and the measurements that they give."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._compile.compilation import fast_compile
from ..._utils.host import all_concrete, as_float, concrete, on_host
from ..._utils.progress import announced
from ..._utils.pytrees import group_by_structure
from ..._utils.types import KeyLike, Table, TableDeviationsLike, TableLike
from ..._utils.validation import quote, require_deviations, require_kind, require_shape
from ...mechanism.mechanism import Mechanism
from .sensors import AbstractSensor


class AbstractTest(eqx.Module):
    """Test on a mechanism: what is done to it, and which quantities are measured.

    The readings of a test form a table, with a row for each load case, time, or
    natural frequency, and a column for each sensor.
    """

    @abstractmethod
    def predict(
        self, mechanism: Mechanism, *, forward: bool = True, throw: bool = True
    ) -> Table:
        """Compute the readings of a mechanism, without measurement errors.

        Args:
            mechanism: Mechanism on which the test is done.
            forward: Whether the result is differentiated in forward mode. If False, it
                is differentiated in reverse mode.
            throw: Whether a solve that fails raises an error. If False, its rows are NaN.

        Returns:
            The readings, in `units`.
        """

    @property
    @abstractmethod
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""

    @property
    @abstractmethod
    def units(self) -> tuple[str, ...]:
        """SI units of the columns."""

    @property
    @abstractmethod
    def standard_deviations(self) -> Table:
        """Standard deviations of the readings, in `units`."""

    def measurement(
        self,
        values: TableLike,
        standard_deviations: TableDeviationsLike | None = None,
    ) -> "Measurement":
        """Combine the test with the values that were measured.

        Args:
            values: Row for each load case, time, or natural frequency, with a value for
                each sensor; NaN if a reading is missing; in `units`.
            standard_deviations: Standard deviations of the readings, by default those of
                the sensors; in `units`.

        Returns:
            The measurement, which `identify` takes.

        Raises:
            ValueError: A shape is wrong; all readings are missing; a standard deviation
                is not positive.
        """
        deviations = self.standard_deviations
        shape = deviations.shape
        requirement = (
            f"have {shape[0]} rows of {shape[1]}: {', '.join(self.columns)}. Give NaN "
            "for a missing reading"
        )
        array = require_shape("`values`", values, shape, requirement)
        if standard_deviations is not None:
            deviations = standard_deviations
        deviations = require_deviations("`standard_deviations`", deviations, shape)
        readings = concrete(array)
        if readings is not None and np.any(np.isinf(readings)):
            raise ValueError(
                "`values` has an infinite entry: give NaN for a missing reading."
            )
        if readings is not None and np.all(np.isnan(readings)):
            raise ValueError("`values` has no reading: all entries are NaN.")
        return Measurement(self, array, deviations)

    @announced("synthetic data")
    def synthetic_data(
        self, mechanism: Mechanism, key: KeyLike | None = None
    ) -> "Measurement":
        """Simulate the test on a mechanism whose parameters are known.

        Args:
            mechanism: Mechanism on which the test is done.
            key: Random key, or an integer seed, for normal measurement errors. By
                default the readings are exact.

        Returns:
            The simulated measurement.

        Raises:
            RuntimeError: A solve fails.
        """
        arrays = eqx.filter((self, mechanism), eqx.is_array)
        if all_concrete(jax.tree.leaves(arrays)) is None:
            values = self.predict(mechanism, throw=False)
        else:
            values = _predict(self, mechanism)
            if np.any(np.isnan(values)):
                self.predict(mechanism, throw=True)  # raises an error with the cause
        if key is not None:
            noise = jax.random.normal(random_key(key), values.shape, values.dtype)
            _, (exact, deviations, noise) = on_host(
                values, self.standard_deviations, noise
            )
            values = as_float(exact + deviations * noise)
        return Measurement(self, values, self.standard_deviations)


class SensorTest(AbstractTest):
    """Test that is measured by sensors."""

    # Sensors, one for each column of the table of readings
    sensors: eqx.AbstractVar[tuple[AbstractSensor, ...]]

    @property
    @abstractmethod
    def row_count(self) -> int:
        """Number of readings of each sensor."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the sensors."""
        return tuple(sensor.name for sensor in self.sensors)

    @property
    def units(self) -> tuple[str, ...]:
        """SI units of the sensors."""
        return tuple(sensor.unit for sensor in self.sensors)

    @property
    def standard_deviations(self) -> Table:
        """Standard deviations of the sensors, in `units`; equal in all rows."""
        xp, row = on_host(*(sensor.standard_deviation for sensor in self.sensors))
        shape = self.row_count, len(self.sensors)
        return as_float(xp.broadcast_to(xp.stack(row), shape))

    def _read_sensors(
        self, mechanism: Mechanism, solution: Any
    ) -> Float[Array, "*rows columns"]:
        """Read all sensors in an equilibrium or a motion, in `units`."""
        return jnp.stack(
            [sensor.read(mechanism, solution) for sensor in self.sensors], axis=-1
        )


class Measurement(eqx.Module):
    """Test with the values that were measured.

    Args:
        test: Test that was done.
        values: Measured values; NaN if a reading is missing; in the units of the test.
        standard_deviations: Standard deviations of the readings, in the same units.
    """

    test: AbstractTest
    values: Table
    standard_deviations: Table

    def residuals(self, mechanism: Mechanism, *, forward: bool = True) -> Table:
        """Compute the differences between predicted and measured values.

        Args:
            mechanism: Mechanism on which the test is done.
            forward: Mode of differentiation; see `AbstractTest.predict`.

        Returns:
            The differences, divided by the standard deviations. They are zero if a
            reading is missing, and NaN if a solve fails.
        """
        predicted = self.test.predict(mechanism, forward=forward, throw=False)
        exists = jnp.isfinite(self.values)
        difference = predicted - jnp.where(exists, self.values, 0.0)
        return jnp.where(exists, difference / self.standard_deviations, 0.0)

    def __repr__(self) -> str:
        values = concrete(self.values)
        if values is None or values.ndim != 2:
            return eqx.tree_pformat(self)
        count = int(np.sum(np.isfinite(values)))
        return f"{count} readings of {self.test!r}"


_predict = fast_compile(
    lambda test, mechanism: test.predict(mechanism, throw=False), optimize=False
)


def require_sensors(sensors: Sequence[AbstractSensor]) -> tuple[AbstractSensor, ...]:
    """Check that there is at least one sensor and that every entry is a sensor."""
    if not (checked := require_kind("sensors", sensors, AbstractSensor)):
        raise ValueError("`sensors` is empty, but a test needs at least one sensor.")
    return checked


def random_key(key: KeyLike) -> Array:
    """Make a random key from an integer of at most 63 bits; return a key unchanged."""
    is_small = not isinstance(key, int) or -(2**63) <= key < 2**63
    if isinstance(key, bool) or not isinstance(key, int | Array) or not is_small:
        raise ValueError(
            f"`key` is {quote(key)}, but must be an integer of at most 63 bits, or a "
            "random key: jax.random.key(0)."
        )
    return jax.random.key(key) if isinstance(key, int) else key


def map_in_groups(function: Callable[[Any], Array], trees: Sequence[Any]) -> list[Array]:
    """Apply a function to each tree; trees of equal structure are evaluated by `vmap`."""
    results: dict[int, Array] = {}
    for indices in group_by_structure(trees):
        if len(indices) == 1:
            results[indices[0]] = function(trees[indices[0]])
            continue
        group = [trees[index] for index in indices]
        stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *group)
        results.update(zip(indices, jax.vmap(function)(stacked), strict=True))
    return [results[index] for index in range(len(trees))]


def as_pytree(function: Any) -> Any:
    """Wrap a function so that it is part of the structure of a pytree, not a leaf.

    A module of equinox is a pytree and is returned unchanged.
    """
    is_module = isinstance(function, eqx.Module)
    return function if is_module else jax.tree_util.Partial(function)
