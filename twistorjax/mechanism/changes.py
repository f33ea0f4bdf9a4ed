"""Strokes and temperatures as functions of time or of a load factor."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array
from typing_extensions import TypeAliasType

from .._compile.traced_function import traced
from .._utils.host import as_float
from .._utils.types import NumberLike, PoseLike, Poses, Scalar
from ..assembly.assembly import HingeAssembly
from .mechanism import Mechanism
from .misfits import HingeState, stroke_rows, Temperature


# Strokes by the names of hinges; rad, m, m
StrokesInTime = TypeAliasType("StrokesInTime", Callable[[Scalar], Mapping[str, PoseLike]])
# Change of the temperature of all parts (K), or of single parts
TemperatureInTime = TypeAliasType(
    "TemperatureInTime", Callable[[Scalar], NumberLike | Temperature]
)


class HingeChanges(eqx.Module):
    """Functions of time that change the hinges of a mechanism."""

    # A function that returns strokes; None if there are none
    strokes: StrokesInTime | None
    # A function that returns temperatures; None if there is none
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

    def state(self, mechanism: Mechanism, time: Scalar) -> HingeState:
        """Evaluate the functions at a time; s."""
        rows = temperature = None
        if self.strokes is not None:
            rows = stroke_rows(mechanism.hinge_names, self.strokes(time))
        if self.temperature is not None:
            temperature = as_temperature(self.temperature(time))
        return HingeState(rows, temperature)

    def hinges(self, mechanism: Mechanism, time: Scalar) -> HingeAssembly:
        """Return the hinges at a time (s), with the time derivatives of their misfits."""

        def misfits(time: Scalar) -> Array | None:
            return mechanism.hinges_in(self.state(mechanism, time)).misfits

        _, rates = jax.jvp(misfits, (time,), (jnp.ones_like(time),))
        hinges = mechanism.hinges_in(self.state(mechanism, time))
        return replace(hinges, misfit_rates=rates)

    def dilation_power(
        self, mechanism: Mechanism, time: Scalar, displacements: Poses
    ) -> Scalar:
        """Compute the power by which temperatures change arms and stiffness of hinges; W.

        The power of the misfits is not included; see `HingeAssembly.forces_in_motion`.
        """
        if self.temperature is None:
            return jnp.zeros(())
        misfits = self.hinges(mechanism, time).misfits

        def energy(time: Scalar) -> Scalar:
            hinges = mechanism.hinges_in(self.state(mechanism, time))
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


def as_temperature(given: NumberLike | Temperature) -> Temperature:
    """Convert the change of the temperature of all parts; K."""
    if not isinstance(given, Temperature):
        given = Temperature(given)
    change, *by_name = given
    tree = change, *map(dict, by_name)
    return Temperature(*jax.tree.map(lambda value: jnp.asarray(value, float), tree))
