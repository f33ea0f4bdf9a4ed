"""Tests on mechanisms in motion."""

from collections.abc import Mapping, Sequence

import diffrax as dfx
import numpy as np
from jaxtyping import Array, Float

from ..._compile.traced_function import traced
from ..._utils.host import as_float, concrete
from ..._utils.types import NumberLike, Poses, Scalar, Table, TimesLike, VelocityLike
from ...mechanism.constraints import AbstractConstraint
from ...mechanism.mechanism import Mechanism
from ...results.solutions import PoseSolution
from ...solve.integration.arguments import check_times, explain_compilation
from ...solve.integration.program import Driving, Loading
from ...solve.simulate import simulate
from ...solve.statics.solution import StateLike
from .measurement import as_pytree, require_sensors, SensorTest
from .sensors import AbstractSensor


class MotionTest(SensorTest):
    """Motion of a mechanism, measured at several times.

    Args:
        times: Times of the readings; the motion starts at the first one; s.
        sensors: Sensors, which are read at each time.
        loads: Loads, or a function of time that returns them; see `simulate`.
        drives: Prescribed displacements, or a function of time that returns them; see
            `simulate`. Functions are traced when the test is created, with the values
            that their variables have at this time.
        constraints: Constraints between the bodies; see `simulate`.
        start: Poses at the start, or an equilibrium, by default the reference poses; rad,
            m, m.
        velocities: Velocities at the start of some bodies, by default zero: a mapping
            from the name to (angular velocity, velocity along x, velocity along y);
            rad/s, m/s, m/s.
        tolerance: Tolerance of the time integration, by default 1e-8; see `simulate`,
            whose default is 1e-6. The error of the simulation limits the accuracy of the
            estimates: stiffnesses of stiff directions need a small tolerance.

    Raises:
        ValueError: The times do not increase, there is no sensor, or nothing sets the
            mechanism in motion.

    Example:
        >>> from twistorjax.identification import BodySensor
        >>> camera = BodySensor("block", "x", standard_deviation=1e-5)
        >>> pushed_off = {"block": (0.0, 1.0, 0.0)}  # 1 m/s along x
        >>> MotionTest([0.0, 0.1, 0.2], [camera], velocities=pushed_off)
        MotionTest at 3 times up to 0.2 s, sensors: block.x
    """

    times: Float[Array, " times"]
    sensors: tuple[AbstractSensor, ...]
    loads: Loading
    drives: Driving
    constraints: tuple[AbstractConstraint, ...]
    start: Poses | None
    velocities: dict[str, Float[Array, "3"]] | None
    tolerance: Scalar

    def __init__(
        self,
        times: TimesLike,
        sensors: Sequence[AbstractSensor],
        *,
        loads: Loading = (),
        drives: Driving = (),
        constraints: Sequence[AbstractConstraint] = (),
        start: StateLike | None = None,
        velocities: Mapping[str, VelocityLike] | None = None,
        tolerance: NumberLike = 1e-8,
    ):
        self.times = check_times(times)
        self.sensors = require_sensors(sensors)
        with explain_compilation(self.times[0], loads=loads, drives=drives):
            self.loads = as_pytree(traced(loads)) if callable(loads) else tuple(loads)
            self.drives = as_pytree(traced(drives)) if callable(drives) else tuple(drives)
        self.constraints = tuple(constraints)
        if isinstance(start, PoseSolution):
            start = start.poses
        self.start = None if start is None else as_float(start)
        self.velocities = None
        if velocities is not None:
            self.velocities = {
                body: as_float(velocity) for body, velocity in velocities.items()
            }
        self.tolerance = as_float(tolerance)
        actions = self.loads, self.drives, self.constraints
        if not any(actions) and start is None and velocities is None:
            raise ValueError(
                "Nothing sets the mechanism in motion: give `velocities`, `start`, "
                "`loads` or `drives`."
            )

    @property
    def row_count(self) -> int:
        """Number of times."""
        return len(self.times)

    def predict(
        self, mechanism: Mechanism, *, forward: bool = True, throw: bool = True
    ) -> Table:
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
            energies=any(sensor.needs_energies for sensor in self.sensors),
            throw=throw,
        )
        return self._read_sensors(mechanism, motion)

    def __repr__(self) -> str:
        times = concrete(self.times)
        last = "" if times is None else f" up to {np.max(times):g} s"
        sensors = ", ".join(self.columns)
        return f"MotionTest at {self.row_count} times{last}, sensors: {sensors}"
