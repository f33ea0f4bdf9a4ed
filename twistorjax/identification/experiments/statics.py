"""Tests on mechanisms in static equilibrium."""

from collections import Counter
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.host import concrete
from ..._utils.types import Table
from ...mechanism.loads import Drive, Load
from ...mechanism.mechanism import Mechanism
from ...solve.equilibrium import equilibrium
from ...solve.statics.solution import Equilibrium
from .measurement import map_in_groups, require_sensors, SensorTest
from .sensors import AbstractSensor


_LoadCase = tuple[Load | Drive, ...]


class StaticTest(SensorTest):
    """Equilibria of a mechanism under several load cases, measured by sensors.

    Args:
        load_cases: List of loads and prescribed displacements for each load case.
        sensors: Sensors, which are read in the equilibrium of each load case.
        tolerance: Relative tolerance of the equilibria; see `equilibrium`.

    Raises:
        ValueError: There is no load case or no sensor, or a load case contains something
            else than loads and prescribed displacements.

    Example:
        >>> from twistorjax.identification import BodySensor
        >>> camera = BodySensor("table", "x", standard_deviation=1e-6)
        >>> push = Load("table", force=(5.0, 0.0))  # N
        >>> StaticTest([[push]], [camera])
        StaticTest of 1 load case, sensors: table.x
    """

    load_cases: tuple[_LoadCase, ...]
    sensors: tuple[AbstractSensor, ...]
    tolerance: float = eqx.field(static=True)

    def __init__(
        self,
        load_cases: Sequence[Sequence[Load | Drive]],
        sensors: Sequence[AbstractSensor],
        *,
        tolerance: float = 1e-10,
    ):
        self.load_cases = tuple(map(_require_load_case, load_cases))
        self.sensors = require_sensors(sensors)
        self.tolerance = tolerance
        if not load_cases:
            raise ValueError(
                "`load_cases` is empty, but a test needs at least one load case."
            )

    @property
    def row_count(self) -> int:
        """Number of load cases."""
        return len(self.load_cases)

    def predict(
        self, mechanism: Mechanism, *, forward: bool = True, throw: bool = True
    ) -> Table:
        del forward

        def read_load_case(load_case: _LoadCase) -> Float[Array, " columns"]:
            solution = self._solve(mechanism, load_case, throw=False)
            return self._read_sensors(mechanism, solution)

        padded = _pad_with_zero_loads(self.load_cases)
        readings = jnp.stack(map_in_groups(read_load_case, padded))
        values = concrete(readings)
        if throw and values is not None and np.any(np.isnan(values)):
            for load_case in self.load_cases:
                self._solve(mechanism, load_case, throw=True)
        return readings

    def _solve(
        self, mechanism: Mechanism, load_case: _LoadCase, throw: bool
    ) -> Equilibrium:
        """Compute the equilibrium of one load case."""
        return equilibrium(
            mechanism,
            loads=[action for action in load_case if isinstance(action, Load)],
            drives=[action for action in load_case if isinstance(action, Drive)],
            tolerance=self.tolerance,
            throw=throw,
        )

    def __repr__(self) -> str:
        count = self.row_count
        load_cases = "1 load case" if count == 1 else f"{count} load cases"
        return f"StaticTest of {load_cases}, sensors: {', '.join(self.columns)}"


def _require_load_case(load_case: Sequence[Load | Drive]) -> _LoadCase:
    """Check that a load case is a sequence of loads and prescribed displacements."""
    if isinstance(load_case, Load | Drive):
        raise ValueError(
            "A load case is a list of loads and drives: put this one in [...]."
        )
    for action in load_case:
        if not isinstance(action, Load | Drive):
            raise ValueError(
                f"A load case contains a {type(action).__name__}, but must be a list of "
                "loads and drives."
            )
    return tuple(load_case)


def _pad_with_zero_loads(load_cases: Sequence[_LoadCase]) -> list[_LoadCase]:
    """Add zero loads until all load cases have the same number of loads on each body.

    Load cases with equal prescribed coordinates then have the same structure, so that
    they are evaluated together by `vmap`.
    """
    loads_of_cases = [
        [action for action in load_case if isinstance(action, Load)]
        for load_case in load_cases
    ]
    largest_counts: Counter[tuple[str, bool]] = Counter()
    for loads in loads_of_cases:
        largest_counts |= Counter((load.body, load.follower) for load in loads)
    padded = []
    for load_case, loads in zip(load_cases, loads_of_cases, strict=True):
        actions: list[Load | Drive] = [
            each for each in load_case if isinstance(each, Drive)
        ]
        for kind, count in largest_counts.items():
            same = [load for load in loads if (load.body, load.follower) == kind]
            zero_load = Load(kind[0], wrench=(0.0, 0.0, 0.0), follower=kind[1])
            actions += [*same, *[zero_load] * (count - len(same))]
        padded.append(tuple(actions))
    return padded
