"""Mechanisms loaded or displaced, and read at rest."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.validation import concrete
from ..mechanism.loads import Drive, Load
from ..mechanism.mechanism import Mechanism
from ..solve.statics import Equilibrium, equilibrium
from .measurement import mapped
from .sensor_test import SensorTest, some_sensors
from .sensors import AbstractSensor


_Trial = tuple[Load | Drive, ...]


class StaticTest(SensorTest):
    """A mechanism loaded or displaced, trial after trial, and read at rest.

    Args:
        trials: one list of loads and drives for each, as `equilibrium` takes them.
        sensors: read in each trial.
        tolerance: for `equilibrium`.

    Raises:
        ValueError: there is no trial or no sensor.

    Example:
        >>> from twistorjax.identification.sensors import BodySensor
        >>> push = Load("table", (0, 5, 0))
        >>> StaticTest([[push]], [BodySensor("table", "x", 1e-6)])
        StaticTest of 1 trial, read by table.x
    """

    trials: tuple[_Trial, ...]
    sensors: tuple[AbstractSensor, ...]
    tolerance: float = eqx.field(static=True)

    def __init__(
        self,
        trials: Sequence[Sequence[Load | Drive]],
        sensors: Sequence[AbstractSensor],
        *,
        tolerance: float = 1e-10,
    ):
        self.trials = tuple(map(_trial, trials))
        self.sensors = some_sensors(sensors)
        self.tolerance = tolerance
        if not trials:
            raise ValueError("`trials` is empty, but a test needs at least one.")

    @property
    def rows(self) -> int:
        """One for each trial."""
        return len(self.trials)

    def read(
        self, mechanism: Mechanism, *, forward: bool = True, throw: bool = True
    ) -> Float[Array, "rows columns"]:
        del forward

        def one(trial: _Trial) -> Float[Array, " columns"]:
            solution = self._settle(mechanism, trial, throw=False)
            return self._sense(mechanism, solution)

        read = jnp.stack(mapped(one, _alike(self.trials)))
        seen = concrete(read)
        if throw and seen is not None and np.any(np.isnan(seen)):
            for trial in self.trials:
                self._settle(mechanism, trial, throw=True)
        return read

    def _settle(self, mechanism: Mechanism, trial: _Trial, throw: bool) -> Equilibrium:
        return equilibrium(
            mechanism,
            loads=[part for part in trial if isinstance(part, Load)],
            drives=[part for part in trial if isinstance(part, Drive)],
            tolerance=self.tolerance,
            throw=throw,
        )

    def __repr__(self) -> str:
        trials = "1 trial" if self.rows == 1 else f"{self.rows} trials"
        return f"StaticTest of {trials}, read by {', '.join(self.columns)}"


def _trial(parts: Sequence[Load | Drive]) -> _Trial:
    if isinstance(parts, Load | Drive):
        raise ValueError("A trial is a list of loads and drives: put this one in [...].")
    for part in parts:
        if not isinstance(part, Load | Drive):
            raise ValueError(
                f"A trial has a {type(part).__name__}, but takes loads and drives alone."
            )
    return tuple(parts)


def _alike(trials: Sequence[_Trial]) -> list[_Trial]:
    """The trials, with loads of zero where another has a load.

    So that those which are driven alike are of one structure, and mapped as one.
    """
    slots: dict[tuple[str, bool], int] = {}
    sorted_out = []
    for trial in trials:
        own: dict[tuple[str, bool], list[Load]] = {}
        for part in trial:
            if isinstance(part, Load):
                own.setdefault((part.body, part.follower), []).append(part)
        sorted_out.append(own)
        for slot, loads in own.items():
            slots[slot] = max(len(loads), slots.get(slot, 0))
    filled = []
    for trial, own in zip(trials, sorted_out, strict=True):
        parts: list[Load | Drive] = [part for part in trial if isinstance(part, Drive)]
        for (body, follower), count in slots.items():
            loads = own.get((body, follower), [])
            none = [Load(body, (0, 0, 0), follower=follower)] * (count - len(loads))
            parts += [*loads, *none]
        filled.append(tuple(parts))
    return filled
