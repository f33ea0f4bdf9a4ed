"""Tests that are read by sensors."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._utils.validation import require_kind
from ..mechanism.mechanism import Mechanism
from .measurement import AbstractTest
from .sensors import AbstractSensor


class SensorTest(AbstractTest):
    """A test that is read by sensors."""

    sensors: eqx.AbstractVar[tuple[AbstractSensor, ...]]

    @property
    @abstractmethod
    def rows(self) -> int:
        """How many times all sensors are read."""

    @property
    def columns(self) -> tuple[str, ...]:
        """The sensors' names."""
        return tuple(sensor.name for sensor in self.sensors)

    @property
    def units(self) -> tuple[str, ...]:
        """The sensors' units."""
        return tuple(sensor.unit for sensor in self.sensors)

    @property
    def deviations(self) -> Float[Array, "rows columns"]:
        """The sensors' deviations."""
        row = jnp.stack([sensor.deviation for sensor in self.sensors])
        return jnp.broadcast_to(row, (self.rows, len(self.sensors)))

    def _sense(self, mechanism: Mechanism, answer: Any) -> Float[Array, "*rows columns"]:
        return jnp.stack(
            [sensor.read(mechanism, answer) for sensor in self.sensors], axis=-1
        )


def some_sensors(sensors: Sequence[AbstractSensor]) -> tuple[AbstractSensor, ...]:
    """The sensors, if there are any, and nothing else."""
    require_kind("sensors", sensors, AbstractSensor)
    if not sensors:
        raise ValueError("`sensors` is empty, but a test needs at least one.")
    return tuple(sensors)
