"""Tests on mechanisms in static equilibrium."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import Table
from .._utils.validation import concrete
from ..mechanism.loads import Drive, Load
from ..mechanism.mechanism import Mechanism
from ..solve.statics import Equilibrium, equilibrium
from .measurement import map_in_groups
from .sensor_test import require_sensors, SensorTest
from .sensors import AbstractSensor


_Trial = tuple[Load | Drive, ...]


class StaticTest(SensorTest):
    """Series of static trials, each with its own loads and prescribed displacements.

    Args:
        trials: List of loads and prescribed displacements for each trial.
        sensors: Sensors, which are read in the equilibrium of each trial.
        tolerance: Relative tolerance of the equilibria; see `equilibrium`.

    Raises:
        ValueError: There is no trial or no sensor, or a trial contains something else
            than loads and prescribed displacements.

    Example:
        >>> from twistorjax.identification import BodySensor
        >>> camera = BodySensor("table", "x", standard_deviation=1e-6)
        >>> push = Load("table", force=(5.0, 0.0))  # N
        >>> StaticTest([[push]], [camera])
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
        self.trials = tuple(map(_require_trial, trials))
        self.sensors = require_sensors(sensors)
        self.tolerance = tolerance
        if not trials:
            raise ValueError("`trials` is empty, but a test needs at least one trial.")

    @property
    def row_count(self) -> int:
        """Number of trials."""
        return len(self.trials)

    def predict(
        self, mechanism: Mechanism, *, forward: bool = True, throw: bool = True
    ) -> Table:
        del forward

        def read_trial(trial: _Trial) -> Float[Array, " columns"]:
            solution = self._solve(mechanism, trial, throw=False)
            return self._read_sensors(mechanism, solution)

        readings = jnp.stack(map_in_groups(read_trial, _pad_with_zero_loads(self.trials)))
        values = concrete(readings)
        if throw and values is not None and np.any(np.isnan(values)):
            for trial in self.trials:
                self._solve(mechanism, trial, throw=True)
        return readings

    def _solve(self, mechanism: Mechanism, trial: _Trial, throw: bool) -> Equilibrium:
        """Compute the equilibrium of one trial."""
        return equilibrium(
            mechanism,
            loads=[part for part in trial if isinstance(part, Load)],
            drives=[part for part in trial if isinstance(part, Drive)],
            tolerance=self.tolerance,
            throw=throw,
        )

    def __repr__(self) -> str:
        trials = "1 trial" if self.row_count == 1 else f"{self.row_count} trials"
        return f"StaticTest of {trials}, read by {', '.join(self.columns)}"


def _require_trial(trial: Sequence[Load | Drive]) -> _Trial:
    """Check that a trial is a sequence of loads and prescribed displacements."""
    if isinstance(trial, Load | Drive):
        raise ValueError("A trial is a list of loads and drives: put this one in [...].")
    for part in trial:
        if not isinstance(part, Load | Drive):
            raise ValueError(
                f"A trial contains a {type(part).__name__}, but must be a list of loads "
                "and drives."
            )
    return tuple(trial)


def _pad_with_zero_loads(trials: Sequence[_Trial]) -> list[_Trial]:
    """Add zero loads to the trials until all have the same number of loads on each body.

    Trials with equal prescribed coordinates then have the same structure, so that they
    are evaluated together by `vmap`.
    """
    counts: dict[tuple[str, bool], int] = {}
    loads_of_trials = []
    for trial in trials:
        loads_by_kind: dict[tuple[str, bool], list[Load]] = {}
        for part in trial:
            if isinstance(part, Load):
                loads_by_kind.setdefault((part.body, part.follower), []).append(part)
        loads_of_trials.append(loads_by_kind)
        for kind, loads in loads_by_kind.items():
            counts[kind] = max(len(loads), counts.get(kind, 0))
    padded = []
    for trial, loads_by_kind in zip(trials, loads_of_trials, strict=True):
        parts: list[Load | Drive] = [part for part in trial if isinstance(part, Drive)]
        for (body, follower), count in counts.items():
            loads = loads_by_kind.get((body, follower), [])
            zero_load = Load(body, wrench=(0.0, 0.0, 0.0), follower=follower)
            parts += [*loads, *[zero_load] * (count - len(loads))]
        padded.append(tuple(parts))
    return padded
