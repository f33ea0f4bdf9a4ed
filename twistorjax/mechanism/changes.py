"""Strokes and temperatures that change the hinges of a mechanism in a motion."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple, TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import TypeAliasType

from .._compile.traced_function import traced
from .._utils.host import as_float
from .._utils.types import NamedNumbers, NumberLike, PoseLike, Poses, Scalar
from ..assembly.assembly import HingeAssembly
from .misfits import stroke_rows


if TYPE_CHECKING:
    from .mechanism import Mechanism


class Temperature(NamedTuple):
    """Changes of the temperature of bodies and hinges.

    These are the arguments of `Mechanism.at_temperature`.

    Args:
        change: Change of the temperature; K.
        bodies: Changes of single bodies, by name, instead of `change`; K.
        hinges: Changes of single hinges, by name, instead of `change`; K.
        gradients: Gradients of the temperature along axis 2 of hinges, by name; K/m.

    Example:
        >>> Temperature(5.0, hinges={"heater": 200.0}).hinges
        {'heater': 200.0}
    """

    change: NumberLike = 0.0
    bodies: NamedNumbers = MappingProxyType({})
    hinges: NamedNumbers = MappingProxyType({})
    gradients: NamedNumbers = MappingProxyType({})


# Strokes by the names of hinges; rad, m, m
StrokesInTime = TypeAliasType("StrokesInTime", Callable[[Scalar], Mapping[str, PoseLike]])
# Change of the temperature of all parts (K), or of single parts
TemperatureInTime = TypeAliasType(
    "TemperatureInTime", Callable[[Scalar], NumberLike | Temperature]
)


class HingeState(NamedTuple):
    """Strokes and temperatures at an instant, or at the instants of a motion.

    Args:
        strokes: Strokes of all hinges; None if there are none; rad, m, m.
        temperature: Changes of the temperature; None if it is that of the mechanism.
    """

    strokes: Float[Array, "*batch hinges 3"] | None
    temperature: Temperature | None

    @classmethod
    def of_solution(cls, solution: Any, batch: tuple[int, ...]) -> "HingeState":
        """Return the states of a solution (none for poses), one row for each."""
        strokes, temperature = (
            getattr(solution, name, None) for name in ("strokes", "temperature")
        )

        def rows(values: Array, trailing: tuple[int, ...]) -> Array:
            return jnp.broadcast_to(values, (*batch, *trailing)).reshape(-1, *trailing)

        if strokes is not None:
            strokes = rows(strokes, strokes.shape[-2:])
        return cls(strokes, jax.tree.map(lambda values: rows(values, ()), temperature))

    def hinges(self, mechanism: "Mechanism") -> HingeAssembly:
        """Return the hinges of the mechanism in this state."""
        hinges = mechanism.hinge_assembly
        if self.temperature is not None:
            change, bodies, of_hinges, gradients = self.temperature
            warm = mechanism.at_temperature(
                change, bodies=bodies, hinges=of_hinges, gradients=gradients
            )
            hinges = warm.hinge_assembly
        return hinges if self.strokes is None else hinges.with_strokes(self.strokes)


class HingeChanges(eqx.Module):
    """Functions of time that change the hinges of a mechanism.

    Args:
        strokes: A function that returns strokes; None if there are none.
        temperature: A function that returns temperatures; None if there is none.
    """

    strokes: StrokesInTime | None
    temperature: TemperatureInTime | None

    @classmethod
    def of(
        cls,
        strokes: Mapping[str, PoseLike] | StrokesInTime,
        temperature: TemperatureInTime | None,
    ) -> "HingeChanges | None":
        """Gather strokes and temperatures; None if there are none.

        Constant strokes become a function of time.
        """
        if callable(strokes):
            return cls(strokes, temperature)
        given = not isinstance(strokes, Mapping) or strokes
        if not given and temperature is None:
            return None
        constant = eqx.Partial(_constant, with_arrays(strokes)) if given else None
        return cls(constant, temperature)

    def traced(self) -> "HingeChanges":
        """Trace the functions of the user, with the values that they use at this time."""
        functions = self.strokes, self.temperature
        return HingeChanges(*(f if f is None else traced(f) for f in functions))

    def state(self, mechanism: "Mechanism", time: Scalar) -> HingeState:
        """Evaluate the functions at a time; s."""
        rows = temperature = None
        if self.strokes is not None:
            rows = stroke_rows(mechanism, self.strokes(time))
        if self.temperature is not None:
            temperature = as_temperature(self.temperature(time))
        return HingeState(rows, temperature)

    def hinges(self, mechanism: "Mechanism", time: Scalar) -> HingeAssembly:
        """Return the hinges at a time (s), with the time derivatives of their misfits."""

        def misfits(time: Scalar) -> Array | None:
            return self.state(mechanism, time).hinges(mechanism).misfits

        _, rates = jax.jvp(misfits, (time,), (jnp.ones_like(time),))
        hinges = self.state(mechanism, time).hinges(mechanism)
        return replace(hinges, misfit_rates=rates)

    def dilation_power(
        self, mechanism: "Mechanism", time: Scalar, displacements: Poses
    ) -> Scalar:
        """Compute the power by which temperatures change arms and stiffness of hinges; W.

        The power of the misfits is not included; see `HingeAssembly.forces_in_motion`.
        """
        if self.temperature is None:
            return jnp.zeros(())
        misfits = self.hinges(mechanism, time).misfits

        def energy(time: Scalar) -> Scalar:
            hinges = self.state(mechanism, time).hinges(mechanism)
            return replace(hinges, misfits=misfits).energy(displacements)

        return jax.jvp(energy, (time,), (jnp.ones_like(time),))[1]


def with_arrays(strokes: Mapping[str, PoseLike]) -> Mapping[str, PoseLike]:
    """Convert numbers of Python in strokes (rad, m, m) to arrays.

    Otherwise they are constants of a compiled program, which other numbers compile anew.
    """

    def convert(value: Any) -> Any:
        return as_float(value) if isinstance(value, int | float) else value

    return jax.tree.map(convert, strokes)


def _constant(strokes: Mapping[str, PoseLike], time: Scalar) -> Mapping[str, PoseLike]:
    """Return strokes that do not depend on the time."""
    del time
    return strokes


def as_temperature(given: "NumberLike | Temperature") -> Temperature:
    """Convert the change of the temperature of all parts; K."""
    if not isinstance(given, Temperature):
        given = Temperature(given)
    change, *by_name = given
    tree = change, *map(dict, by_name)
    return Temperature(*jax.tree.map(lambda value: jnp.asarray(value, float), tree))
