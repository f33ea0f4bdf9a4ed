"""The motion of a mechanism in time, as a solution."""

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._utils.types import (
    BatchCount,
    BatchEntryHistory,
    BatchHistory,
    BatchPoses,
    BatchRowHistory,
    BatchScalar,
    BatchTimes,
    NumberLike,
    Numbers,
    Poses,
)
from .._utils.validation import all_concrete
from .motion_system import MotionSystem
from .results import count_results, PoseSolution, result_names, RESULTS
from .tables import Column, Columns, columns


class Energies(eqx.Module):
    """Energy balance of a motion; J.

    Elastic and kinetic energy are those at the start plus the work of loads and drives
    since then, minus the dissipated energy.

    Args:
        elastic: Energy stored in the hinges.
        kinetic: Kinetic energy of the bodies.
        dissipated: Energy dissipated in the hinges since the start.
        by_loads: Work of the loads since the start.
        by_drives: Work of drives and of constraints that depend on time since the start.
    """

    elastic: Numbers
    kinetic: Numbers
    dissipated: Numbers
    by_loads: Numbers
    by_drives: Numbers

    @property
    def imbalance(self) -> Numbers:
        """Error of the energy balance; J."""
        stored = self.elastic + self.kinetic
        supplied = self.by_loads + self.by_drives - self.dissipated
        return (stored - stored[..., :1]) - (supplied - supplied[..., :1])


class Motion(PoseSolution):
    """The motion of a mechanism.

    If a motion stopped before its end, the rows of later times are NaN.

    Args:
        times: Times; s.
        displacements: Displacement of each body from its reference pose; rad, m, m.
        velocities: Velocity of each body, in world axes; rad/s, m/s, m/s.
        reference: Poses from which displacements are measured; rad, m, m.
        reactions: External wrench on fixed and prescribed degrees of freedom; zero on
            free ones. About the origin of each body, in world axes; N m, N, N.
        constraint_forces: Constraint force of each constraint entry; N m, N.
        energies: Energy balance; J.
        reached: Time up to which the motion was computed; s.
        steps: Number of steps of the solver, rejected ones included.
        rejected: Number of rejected steps.
        result: `RESULTS.successful` or the reason of the failure; `result_names` returns
            its name.
        solution: The solution that diffrax returned.
        system: Equations of motion, if the motion is kept as a function of time.
        names: Names of the bodies.
        constraint_names: Name of the constraint of each constraint entry.
    """

    times: BatchTimes
    displacements: BatchHistory
    velocities: BatchHistory
    reference: BatchPoses
    reactions: BatchHistory
    constraint_forces: BatchEntryHistory
    energies: Energies
    reached: BatchScalar
    steps: BatchCount
    rejected: BatchCount
    result: RESULTS
    solution: dfx.Solution
    system: MotionSystem | None
    names: tuple[str, ...] = eqx.field(static=True)
    constraint_names: tuple[str, ...] = eqx.field(static=True)

    def velocity(self, body: str) -> BatchRowHistory:
        """Return the velocity of a body; rad/s, m/s, m/s."""
        return self.velocities[..., self._row(body), :]

    def at(self, time: NumberLike) -> Poses:
        """Compute the poses at any time, if the motion is kept as a function of time.

        Args:
            time: Time between the start and the end; s.

        Returns:
            The poses of the bodies; rad, m, m.

        Raises:
            ValueError: The motion is kept at its times only.
        """
        if self.system is None:
            raise ValueError(
                "This motion is kept at its times only. For poses at any time, use "
                "`simulate(..., saveat=diffrax.SaveAt(dense=True))`."
            )
        instant = jnp.asarray(time, float)
        state = self.solution.evaluate(instant)
        moved, _ = self.system.expand(instant, state.position, state.rate)
        return self.reference + moved

    def columns(self) -> Columns:
        velocity = (
            ("angular_velocity", "rad/s"),
            ("velocity_x", "m/s"),
            ("velocity_y", "m/s"),
        )
        rows = ("time", "body")
        found = {
            "time": Column(self.times, ("time",), "s"),
            **self._body_columns("time"),
            **columns(self.velocities, rows, *velocity, body=self.names),
        }
        for name in ("elastic", "kinetic", "dissipated", "by_loads", "by_drives"):
            energy = getattr(self.energies, name)
            found[f"energy_{name}"] = Column(energy, ("time",), "J")
        return {
            **found,
            "steps": Column(self.steps),
            "rejected": Column(self.rejected),
        }

    def __repr__(self) -> str:
        names = result_names(self.result)
        values = all_concrete([self.times, self.displacements, self.energies.dissipated])
        if names is None or values is None:
            return eqx.tree_pformat(self)
        if names.shape:
            return count_results("motions", names)
        times, displacements, dissipated = values
        title = (
            f"{names}: {float(times[0]):g} to {float(self.reached):.6g} s in "
            f"{int(self.steps)} steps, {int(self.rejected)} rejected; "
            f"{times.size} times kept"
        )
        if np.any(dissipated):
            lost = np.nanmax(np.abs(self.energies.imbalance))
            stored = np.nanmax(self.energies.elastic + self.energies.kinetic)
            title += f"\nenergy balance: {lost:.2g} J of {stored:.3g} J"
        largest = np.nanmax(np.abs(displacements), axis=0)
        return self._listed(title, "largest", largest)
