"""What an experiment reads off a mechanism: sensors on its bodies and hinges."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, get_args, Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from .._utils.validation import (
    concrete,
    index_of,
    require_choice,
    require_positive,
    require_row,
)
from ..geometry import se2
from ..mechanism.mechanism import Mechanism


Quantity = Literal[
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
Strained = Literal["angle", "x", "y", "moment", "force_1", "force_2"]

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
    """One number read off a mechanism, with the standard deviation of its error."""

    deviation: eqx.AbstractVar[Float[Array, ""]]

    @abstractmethod
    def read(self, mechanism: Mechanism, answer: Any) -> Float[Array, "*rows"]:
        """What it reads in an equilibrium, or at each time of a motion."""

    @property
    @abstractmethod
    def name(self) -> str:
        """What it is called."""

    @property
    @abstractmethod
    def unit(self) -> str:
        """In which it reads."""

    @property
    def energies(self) -> bool:
        """Whether it may read what work was done in a motion."""
        return False


class BodySensor(AbstractSensor):
    """Reads how a body has moved from rest, how it moves, or what it is held by.

    Args:
        body: its name.
        quantity: "angle", "x", "y": how far it has moved from rest; rad, m, m.
            "angular_velocity", "velocity_x", "velocity_y": how fast, in a motion; rad/s,
            m/s, m/s. "moment", "force_x", "force_y": what its held and driven coordinates
            receive from outside; N m, N, N.
        deviation: standard deviation of a reading, in the unit of the quantity.
        at: the point on the body that it looks at, in the body's frame, for "x" and "y"
            and their velocities, by default the body's origin; m.
        absolute: whether it reads where the body is in the world, and not how far it has
            moved.

    Raises:
        ValueError: the quantity is unknown, the deviation not positive, or a point given
            for what does not depend on it.

    Example:
        >>> BodySensor("table", "x", 1e-6)
        BodySensor(table.x, to 1e-06 m)
    """

    body: str = eqx.field(static=True)
    quantity: Quantity = eqx.field(static=True)
    deviation: Float[Array, ""]
    at: Float[Array, "2"] | None
    absolute: bool = eqx.field(static=True)

    def __init__(
        self,
        body: str,
        quantity: Quantity,
        deviation: ArrayLike,
        *,
        at: Float[ArrayLike, "2"] | Sequence[ArrayLike] | None = None,
        absolute: bool = False,
    ):
        self.body = body
        self.quantity = require_choice("`quantity`", quantity, get_args(Quantity))
        self.deviation = require_positive(
            f"`deviation` of the sensor {self.name!r}", deviation
        )
        self.at = None if at is None else require_row("`at`", at, "a point (x, y)", 2)
        self.absolute = absolute
        if at is not None and quantity not in ("x", "y", "velocity_x", "velocity_y"):
            raise ValueError(
                f"`at` is given, but the {quantity} of a body is one for all its points."
            )
        if absolute and quantity not in ("angle", "x", "y"):
            raise ValueError(f"`absolute` is given, but the {quantity} has no place.")

    @property
    def name(self) -> str:
        """The body and the quantity."""
        return f"{self.body}.{self.quantity}"

    @property
    def unit(self) -> str:
        """Of the quantity."""
        return UNITS[self.quantity]

    def read(self, mechanism: Mechanism, answer: Any) -> Float[Array, "*rows"]:
        place = get_args(Quantity).index(self.quantity)
        if place >= 6:
            return answer.reaction(self.body)[..., place - 6]
        moved = answer.displacement(self.body)
        reference = mechanism.reference[mechanism.index(self.body)]
        if place < 3:
            value = moved[..., place]
            if self.absolute:
                value = value + reference[place]
            if self.at is not None:
                before = se2._turn(reference[0], self.at)
                value = value + _swung(before, moved[..., 0])[place - 1]
                if self.absolute:
                    value = value + before[place - 1]
            return value
        if not hasattr(answer, "velocity"):
            raise ValueError(f"{self!r} reads a velocity, but only a motion has any.")
        speed = answer.velocity(self.body)
        value = speed[..., place - 3]
        if self.at is not None:
            before = se2._turn(reference[0], self.at)
            ahead = before[:, None] + jnp.stack(_swung(before, moved[..., 0].ravel()))
            across = (-ahead[1], ahead[0])[place - 4].reshape(value.shape)
            value = value + speed[..., 0] * across
        return value

    def __repr__(self) -> str:
        return _told(self)


class HingeSensor(AbstractSensor):
    """Reads how a hinge is strained, or what it bears.

    Args:
        hinge: its name.
        quantity: "angle", "x", "y": of its frame b seen from its frame a; rad, m, m.
            "moment", "force_1", "force_2": what it bears, in the axes of frame b;
            N m, N, N.
        deviation: standard deviation of a reading, in the unit of the quantity.

    Raises:
        ValueError: the quantity is unknown, or the deviation not positive.

    Example:
        >>> HingeSensor("a", "x", 10e-9)
        HingeSensor(a.x, to 1e-08 m)
    """

    hinge: str = eqx.field(static=True)
    quantity: Strained = eqx.field(static=True)
    deviation: Float[Array, ""]

    def __init__(self, hinge: str, quantity: Strained, deviation: ArrayLike):
        self.hinge = hinge
        self.quantity = require_choice("`quantity`", quantity, get_args(Strained))
        self.deviation = require_positive(
            f"`deviation` of the gauge {self.name!r}", deviation
        )

    @property
    def name(self) -> str:
        """The hinge and the quantity."""
        return f"{self.hinge}.{self.quantity}"

    @property
    def unit(self) -> str:
        """Of the quantity."""
        return UNITS[self.quantity]

    def read(self, mechanism: Mechanism, answer: Any) -> Float[Array, "*rows"]:
        index_of("A gauge", "hinge", self.hinge, mechanism.hinge_names)
        place = get_args(Strained).index(self.quantity)
        tell = mechanism.displacement_of if place < 3 else mechanism.wrench_of
        return tell(self.hinge, answer)[..., place % 3]

    def __repr__(self) -> str:
        return _told(self)


class FunctionSensor(AbstractSensor):
    """Reads anything: a function of the mechanism and of the equilibrium or motion.

    Args:
        function: called with the mechanism and the answer; gives a number, or one for
            each time of a motion. Define it once: another function is compiled anew.
        name: what it is called.
        unit: for printing.
        deviation: standard deviation of a reading.

    Example:
        >>> def stored_energy(mechanism, answer):
        ...     return answer.energy
        >>> FunctionSensor(stored_energy, "energy", "J", 1e-3)
        FunctionSensor(energy, to 0.001 J)
    """

    function: Callable[[Mechanism, Any], Array] = eqx.field(static=True)
    called: str = eqx.field(static=True)
    measured_in: str = eqx.field(static=True)
    deviation: Float[Array, ""]

    def __init__(
        self,
        function: Callable[[Mechanism, Any], Array],
        name: str,
        unit: str,
        deviation: ArrayLike,
    ):
        self.function = function
        self.called = name
        self.measured_in = unit
        self.deviation = require_positive(
            f"`deviation` of the reading {name!r}", deviation
        )

    @property
    def name(self) -> str:
        """As it was given."""
        return self.called

    @property
    def unit(self) -> str:
        """As it was given."""
        return self.measured_in

    @property
    def energies(self) -> bool:
        """It may read anything."""
        return True

    def read(self, mechanism: Mechanism, answer: Any) -> Float[Array, "*rows"]:
        return self.function(mechanism, answer)

    def __repr__(self) -> str:
        return _told(self)


def _swung(arm: Float[Array, "2"], angle: Array) -> tuple[Array, Array]:
    return se2._swing(arm, jnp.cos(angle / 2), jnp.sin(angle / 2))


def _told(sensor: AbstractSensor) -> str:
    seen = concrete(sensor.deviation)
    told = "" if seen is None or seen.shape else f", to {seen:g} {sensor.unit}"
    return f"{type(sensor).__name__}({sensor.name}{told})"
