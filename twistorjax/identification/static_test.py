"""Tests on mechanisms in static equilibrium."""

from collections import Counter
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.host import concrete
from .._utils.types import Table
from ..mechanism.loads import Drive, Load
from ..mechanism.mechanism import Mechanism
from ..solve.statics import Equilibrium, equilibrium
from .measurement import map_in_groups, require_sensors, SensorTest
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
        StaticTest of 1 trial, sensors: table.x
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
            loads=[action for action in trial if isinstance(action, Load)],
            drives=[action for action in trial if isinstance(action, Drive)],
            tolerance=self.tolerance,
            throw=throw,
        )

    def __repr__(self) -> str:
        trials = "1 trial" if self.row_count == 1 else f"{self.row_count} trials"
        return f"StaticTest of {trials}, sensors: {', '.join(self.columns)}"


def _require_trial(trial: Sequence[Load | Drive]) -> _Trial:
    """Check that a trial is a sequence of loads and prescribed displacements."""
    if isinstance(trial, Load | Drive):
        raise ValueError("A trial is a list of loads and drives: put this one in [...].")
    for action in trial:
        if not isinstance(action, Load | Drive):
            raise ValueError(
                f"A trial contains a {type(action).__name__}, but must be a list of "
                "loads and drives."
            )
    return tuple(trial)


def _pad_with_zero_loads(trials: Sequence[_Trial]) -> list[_Trial]:
    """Add zero loads to the trials until all have the same number of loads on each body.

    Trials with equal prescribed coordinates then have the same structure, so that they
    are evaluated together by `vmap`.
    """
    loads_of_trials = [
        [action for action in trial if isinstance(action, Load)] for trial in trials
    ]
    largest_counts: Counter[tuple[str, bool]] = Counter()
    for loads in loads_of_trials:
        largest_counts |= Counter((load.body, load.follower) for load in loads)
    padded = []
    for trial, loads in zip(trials, loads_of_trials, strict=True):
        actions: list[Load | Drive] = [each for each in trial if isinstance(each, Drive)]
        for kind, count in largest_counts.items():
            same = [load for load in loads if (load.body, load.follower) == kind]
            zero_load = Load(kind[0], wrench=(0.0, 0.0, 0.0), follower=kind[1])
            actions += [*same, *[zero_load] * (count - len(same))]
        padded.append(tuple(actions))
    return padded
