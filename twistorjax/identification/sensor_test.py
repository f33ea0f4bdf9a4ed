"""Base class of the tests that are measured by sensors."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._utils.types import Table
from .._utils.validation import require_kind
from ..mechanism.mechanism import Mechanism
from .measurement import AbstractTest
from .sensors import AbstractSensor


class SensorTest(AbstractTest):
    """Test that is measured by sensors.

    Args:
        sensors: Sensors, one for each column of the table of readings.
    """

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
        row = jnp.stack([sensor.standard_deviation for sensor in self.sensors])
        return jnp.broadcast_to(row, (self.row_count, len(self.sensors)))

    def _read_sensors(
        self, mechanism: Mechanism, solution: Any
    ) -> Float[Array, "*rows columns"]:
        """Read all sensors in an equilibrium or a motion, in `units`."""
        return jnp.stack(
            [sensor.read(mechanism, solution) for sensor in self.sensors], axis=-1
        )


def require_sensors(sensors: Sequence[AbstractSensor]) -> tuple[AbstractSensor, ...]:
    """Check that there is at least one sensor, and nothing else.

    Returns:
        The sensors.

    Raises:
        ValueError: The sequence is empty, or an entry is not a sensor.
    """
    require_kind("sensors", sensors, AbstractSensor)
    if not sensors:
        raise ValueError("`sensors` is empty, but a test needs at least one sensor.")
    return tuple(sensors)
