"""Sensors on the bodies and hinges of a mechanism."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, get_args, Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._utils.host import concrete
from ..._utils.types import AnyArray, NumberLike, PointLike, Scalar
from ..._utils.validation import index_of, require_choice, require_positive, require_row
from ...geometry import se2
from ...mechanism.mechanism import Mechanism


BodyQuantity = Literal[
    "angle",
    "x",
    "y",
    "angular_velocity",
    "velocity_x",
    "velocity_y",
    "moment",
    "force_x",
    "force_y",
]
HingeQuantity = Literal["angle", "x", "y", "moment", "force_1", "force_2"]

UNITS = {
    "angle": "rad",
    "x": "m",
    "y": "m",
    "angular_velocity": "rad/s",
    "velocity_x": "m/s",
    "velocity_y": "m/s",
    "moment": "N m",
    "force_x": "N",
    "force_y": "N",
    "force_1": "N",
    "force_2": "N",
}


class AbstractSensor(eqx.Module):
    """Sensor that measures one quantity of a mechanism.

    Args:
        name: Name of the sensor.
        unit: SI unit of the reading.
        standard_deviation: Standard deviation of the measurement error, in `unit`.
    """

    name: eqx.AbstractVar[str]
    unit: eqx.AbstractVar[str]
    standard_deviation: eqx.AbstractVar[Scalar]

    @abstractmethod
    def read(self, mechanism: Mechanism, solution: Any) -> Float[Array, "*rows"]:
        """Compute the reading, without measurement error.

        Args:
            mechanism: Mechanism on which the sensor is mounted.
            solution: Equilibrium or motion of the mechanism.

        Returns:
            The reading; for a motion, one for each time; in `unit`.
        """

    @property
    def needs_energies(self) -> bool:
        """Whether the sensor needs the energy balance of a motion."""
        return False

    def __repr__(self) -> str:
        value = concrete(self.standard_deviation)
        accuracy = ""
        if value is not None and not value.shape:
            accuracy = f", standard deviation {value:g} {self.unit}".rstrip()
        return f"{type(self).__name__}({self.name}{accuracy})"


class _QuantitySensor(AbstractSensor):
    """Sensor for a quantity of a body or a hinge; `UNITS` has its unit."""

    name: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    quantity: str = eqx.field(static=True)
    standard_deviation: Scalar

    def __init__(
        self,
        subject: str,
        quantity: str,
        choices: tuple[str, ...],
        standard_deviation: NumberLike,
    ):
        self.quantity = require_choice("`quantity`", quantity, choices)
        self.unit = UNITS[quantity]
        self.name = f"{subject}.{quantity}"
        self.standard_deviation = _require_deviation(self.name, standard_deviation)


class BodySensor(_QuantitySensor):
    """Sensor for the displacement, the velocity or the reaction of a body.

    Args:
        body: Name of the body.
        quantity: Measured quantity. "angle", "x" and "y" are displacements from the
            reference pose; rad, m, m. "angular_velocity", "velocity_x" and "velocity_y"
            are velocities in a motion; rad/s, m/s, m/s. "moment", "force_x" and "force_y"
            are reactions on fixed and prescribed coordinates; N m, N, N.
        standard_deviation: Standard deviation of the measurement error, in the unit of
            the quantity.
        at: Measured point in the frame of the body, by default the origin of the body.
            It applies to "x", "y", "velocity_x" and "velocity_y"; m.
        absolute: Whether "angle", "x" and "y" are measured in the world frame, instead
            of relative to the reference pose.

    Raises:
        ValueError: The quantity does not exist; the standard deviation is not positive;
            `at` or `absolute` does not apply to the quantity.

    Example:
        >>> BodySensor("table", "x", standard_deviation=1e-6)
        BodySensor(table.x, standard deviation 1e-06 m)
    """

    body: str = eqx.field(static=True)
    at: Float[Array, "2"] | None
    absolute: bool = eqx.field(static=True)

    def __init__(
        self,
        body: str,
        quantity: BodyQuantity,
        standard_deviation: NumberLike,
        *,
        at: PointLike | None = None,
        absolute: bool = False,
    ):
        super().__init__(body, quantity, get_args(BodyQuantity), standard_deviation)
        self.body = body
        self.at = None if at is None else require_row("`at`", at, "a point (x, y)", 2)
        self.absolute = absolute
        if at is not None and quantity not in ("x", "y", "velocity_x", "velocity_y"):
            raise ValueError(
                f"`at` is given, but the {quantity} of a body is the same at all its "
                "points: leave out `at`."
            )
        if absolute and quantity not in ("angle", "x", "y"):
            raise ValueError(
                f"`absolute` is given, but the {quantity} of a body does not depend on "
                "its reference pose: leave out `absolute`."
            )

    def read(self, mechanism: Mechanism, solution: Any) -> Float[Array, "*rows"]:
        index = get_args(BodyQuantity).index(self.quantity)
        if index >= 6:
            return solution.reaction(self.body)[..., index - 6]
        displacement = solution.displacement(self.body)
        reference = mechanism.reference[mechanism.index(self.body)]
        arm, offset = (0.0, 0.0), (0.0, 0.0)  # of the point from the origin of the body
        if self.at is not None:
            arm = se2.rotate(reference[0], self.at)
            half = displacement[..., 0] / 2
            offset = se2.rotation_displacement(arm, jnp.cos(half), jnp.sin(half))
        if index < 3:
            value = displacement[..., index]
            if self.absolute:
                value = value + reference[index]
            if self.at is not None:
                value = value + offset[index - 1]
                if self.absolute:
                    value = value + arm[index - 1]
            return value
        if not hasattr(solution, "velocity"):
            raise ValueError(
                f"{self!r} measures a velocity, but only a motion has velocities: use it "
                "in a `MotionTest`."
            )
        velocity = solution.velocity(self.body)
        value = velocity[..., index - 3]
        if self.at is not None:
            x, y = arm[0] + offset[0], arm[1] + offset[1]
            value = value + velocity[..., 0] * (-y, x)[index - 4]
        return value


class HingeSensor(_QuantitySensor):
    """Sensor for the displacement or the wrench of a hinge.

    Args:
        hinge: Name of the hinge.
        quantity: Measured quantity. "angle", "x" and "y" are the pose of frame b of the
            hinge relative to its frame a; rad, m, m. "moment", "force_1" and "force_2"
            are the wrench on the hinge, in the axes of frame b; N m, N, N.
        standard_deviation: Standard deviation of the measurement error, in the unit of
            the quantity.

    Raises:
        ValueError: The quantity does not exist, or the standard deviation is not
            positive.

    Example:
        >>> HingeSensor("a", "x", standard_deviation=10e-9)
        HingeSensor(a.x, standard deviation 1e-08 m)
    """

    hinge: str = eqx.field(static=True)

    def __init__(
        self, hinge: str, quantity: HingeQuantity, standard_deviation: NumberLike
    ):
        super().__init__(hinge, quantity, get_args(HingeQuantity), standard_deviation)
        self.hinge = hinge

    def read(self, mechanism: Mechanism, solution: Any) -> Float[Array, "*rows"]:
        index_of("The sensor", "hinge", self.hinge, mechanism.hinge_names)
        index = get_args(HingeQuantity).index(self.quantity)
        compute = mechanism.displacement_of if index < 3 else mechanism.wrench_of
        return compute(self.hinge, solution)[..., index % 3]


class FunctionSensor(AbstractSensor):
    """Sensor that is defined by a function of the mechanism and its solution.

    Args:
        function: Function of the mechanism and of its equilibrium or motion. It returns
            a number or, for a motion, one for each time. Define it once: a new function
            is compiled again. If a variable that it uses changes, define a new function.
        name: Name of the sensor.
        unit: SI unit of the reading.
        standard_deviation: Standard deviation of the measurement error, in `unit`.

    Raises:
        ValueError: The standard deviation is not positive.

    Example:
        >>> def stored_energy(mechanism, solution):
        ...     return solution.energy
        >>> FunctionSensor(stored_energy, "energy", "J", standard_deviation=1e-3)
        FunctionSensor(energy, standard deviation 0.001 J)
    """

    function: Callable[[Mechanism, Any], AnyArray] = eqx.field(static=True)
    name: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    standard_deviation: Scalar

    def __init__(
        self,
        function: Callable[[Mechanism, Any], AnyArray],
        name: str,
        unit: str,
        standard_deviation: NumberLike,
    ):
        self.function = function
        self.name = name
        self.unit = unit
        self.standard_deviation = _require_deviation(name, standard_deviation)

    @property
    def needs_energies(self) -> bool:
        """True, because the function may use the energy balance of a motion."""
        return True

    def read(self, mechanism: Mechanism, solution: Any) -> Float[Array, "*rows"]:
        return self.function(mechanism, solution)


def _require_deviation(sensor: str, value: NumberLike) -> Scalar:
    """Require a positive, finite standard deviation of a sensor."""
    return require_positive(f"`standard_deviation` of the sensor {sensor!r}", value)
