"""Mechanisms in motion, read at some times."""

from collections.abc import Mapping, Sequence

import diffrax as dfx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .._utils.types import PosesLike, Scalar
from .._utils.validation import concrete
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.mechanism import Mechanism
from ..solve import initial_state as begin
from ..solve.dynamics import Driving, Loading, simulate
from ..solve.statics import Equilibrium
from .measurement import as_tree
from .sensor_test import SensorTest, some_sensors
from .sensors import AbstractSensor


class MotionTest(SensorTest):
    """A mechanism in motion, read at some times.

    Args:
        times: at which it is read, from its start; s.
        sensors: read at each.
        loads: as for `simulate`.
        drives: likewise.
        constraints: likewise.
        start: likewise.
        velocities: likewise.
        tolerance: likewise. What a fit finds is as exact as the motion: for the effect
            of stiff directions to be seen, take a small one.

    Raises:
        ValueError: the times do not increase, or there is no sensor.

    Example:
        >>> from twistorjax.identification.sensors import BodySensor
        >>> let_go = {"velocities": {"block": (0.0, 1.0, 0.0)}}
        >>> MotionTest([0.0, 0.1, 0.2], [BodySensor("block", "x", 1e-5)], **let_go)
        MotionTest at 3 times up to 0.2 s, read by block.x
    """

    times: Float[Array, " times"]
    sensors: tuple[AbstractSensor, ...]
    loads: Loading
    drives: Driving
    constraints: tuple[AbstractConstraint, ...]
    start: Float[Array, "bodies 3"] | None
    velocities: dict[str, tuple[Scalar, ...]] | None
    tolerance: Scalar

    def __init__(
        self,
        times: Float[ArrayLike, " times"] | Sequence[ArrayLike],
        sensors: Sequence[AbstractSensor],
        *,
        loads: Loading = (),
        drives: Driving = (),
        constraints: Sequence[AbstractConstraint] = (),
        start: PosesLike | Equilibrium | None = None,
        velocities: Mapping[str, Sequence[ArrayLike] | Array] | None = None,
        tolerance: ArrayLike = 1e-8,
    ):
        self.times = begin.times(times)
        self.sensors = some_sensors(sensors)
        self.loads = as_tree(loads) if callable(loads) else tuple(loads)
        self.drives = as_tree(drives) if callable(drives) else tuple(drives)
        self.constraints = tuple(constraints)
        if isinstance(start, Equilibrium):
            start = start.poses
        self.start = None if start is None else jnp.asarray(start, float)
        self.velocities = None
        if velocities is not None:
            self.velocities = {
                body: tuple(jnp.asarray(entry, float) for entry in velocity)
                for body, velocity in velocities.items()
            }
        self.tolerance = jnp.asarray(tolerance, float)
        moved = self.loads, self.drives, self.constraints
        if not any(moved) and start is None and velocities is None:
            raise ValueError(
                "Nothing sets the mechanism in motion: give `velocities`, a `start`, "
                "`loads` or `drives`."
            )

    @property
    def rows(self) -> int:
        """One for each time."""
        return len(self.times)

    def read(
        self, mechanism: Mechanism, *, forward: bool = True, throw: bool = True
    ) -> Float[Array, "rows columns"]:
        motion = simulate(
            mechanism,
            self.times,
            loads=self.loads,
            drives=self.drives,
            constraints=self.constraints,
            start=self.start,
            velocities=self.velocities,
            tolerance=self.tolerance,
            adjoint=dfx.ForwardMode() if forward else None,
            energies=any(sensor.energies for sensor in self.sensors),
            throw=throw,
        )
        return self._sense(mechanism, motion)

    def __repr__(self) -> str:
        last = concrete(self.times)
        until = "" if last is None else f" up to {np.max(last):g} s"
        return (
            f"MotionTest at {self.rows} times{until}, read by {', '.join(self.columns)}"
        )
