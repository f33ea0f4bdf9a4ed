"""Motion of a mechanism, as the solution of a simulation."""

from dataclasses import fields
from functools import partial
from typing import Any, ClassVar

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..._utils.host import take_rows
from ..._utils.types import BatchScalar, NumberLike, Numbers, Poses
from ...mechanism.misfits import Temperature
from ...results.codes import RESULTS
from ...results.solutions import PoseSolution
from ...results.tables import Column, Columns, columns
from .system import MotionSystem


class Energies(eqx.Module):
    """Energy balance of a motion, with one entry for each time; J.

    In an exact solution, the sum of elastic and kinetic energy is its initial value, plus
    the work of loads, prescribed motions, strokes, and temperatures, minus the dissipated
    energy.

    Args:
        elastic: Energy stored in the hinges.
        kinetic: Kinetic energy of the bodies.
        dissipated: Energy dissipated in the hinges since the start.
        by_loads: Work of the loads since the start.
        by_drives: Work of prescribed motions and of time-dependent constraints since the
            start.
        by_strokes: Work of strokes and of temperatures that change, since the start.
    """

    elastic: Numbers
    kinetic: Numbers
    dissipated: Numbers
    by_loads: Numbers
    by_drives: Numbers
    by_strokes: Numbers

    @property
    def imbalance(self) -> Numbers:
        """Error of the energy balance; J."""
        stored = self.elastic + self.kinetic
        supplied = self.by_loads + self.by_drives + self.by_strokes - self.dissipated
        return (stored - stored[..., :1]) - (supplied - supplied[..., :1])


class Motion(PoseSolution):
    """Motion of a mechanism.

    If a motion stopped before its end, the rows of later times are NaN.

    Args:
        times: Times; s.
        displacements: Displacement of each body from its reference pose; rad, m, m.
        velocities: Velocity of each body, in world axes; rad/s, m/s, m/s.
        reference: Poses from which displacements are measured; rad, m, m.
        reactions: External wrench on the fixed and prescribed degrees of freedom of each
            body, about the origin of the body and in world axes; zero for free degrees
            of freedom; N m, N, N.
        constraint_forces: Constraint forces, one for each scalar equation of the
            constraints; N m, N.
        energies: Energy balance; J.
        reached: Time up to which the motion was computed; s.
        steps: Number of steps of the solver, including the rejected ones.
        rejected: Number of rejected steps.
        result: `RESULTS.successful` or the reason of the failure; `result_names` returns
            its name.
        solution: The solution that diffrax returned.
        system: Equations of motion with `SaveAt(dense=True)`; otherwise None.
        strokes: Strokes of all hinges, if `simulate` had strokes; rad, m, m.
        temperature: Changes of the temperature, if `simulate` had them; K, K/m.
        names: Names of the bodies.
        constraint_names: Name of the constraint to which each scalar equation belongs.
        method: Name of the solver.
    """

    times: Float[Array, "*batch times"]
    displacements: Float[Array, "*batch times bodies 3"]
    velocities: Float[Array, "*batch times bodies 3"]
    reference: Float[Array, "*batch bodies 3"]
    reactions: Float[Array, "*batch times bodies 3"]
    constraint_forces: Float[Array, "*batch times entries"]
    energies: Energies
    reached: BatchScalar
    steps: Int[Array, "*batch"]
    rejected: Int[Array, "*batch"]
    result: RESULTS
    solution: dfx.Solution
    system: MotionSystem | None
    strokes: Float[Array, "*batch times hinges 3"] | None
    temperature: Temperature | None
    names: tuple[str, ...] = eqx.field(static=True)
    constraint_names: tuple[str, ...] = eqx.field(static=True)
    method: str = eqx.field(static=True)
    _plural: ClassVar[str] = "motions"

    def first_times(self, count: int) -> "Motion":
        """Return the motion at the first of its times; for a motion that is no batch."""

        def saved(motion: Motion) -> list[Any]:
            solution = motion.solution
            assert solution.ts is not None and solution.ys is not None
            names = ("times", "displacements", "velocities", "reactions")
            histories = [getattr(motion, name) for name in names]
            more = [motion.constraint_forces, motion.energies]
            changes = [motion.strokes, motion.temperature]
            more.extend(change for change in changes if change is not None)
            return [*histories, *more, solution.ts[0], solution.ys[0]]

        first = partial(take_rows, rows=slice(count))
        return eqx.tree_at(saved, self, jax.tree.map(first, saved(self)))

    def velocity(self, body: str) -> Float[Array, "*batch times 3"]:
        """Return the velocity of a body.

        Args:
            body: Name of the body.

        Returns:
            Angular velocity, and velocity along x and y, one row for each time; rad/s,
            m/s, m/s.

        Raises:
            ValueError: There is no body of this name.
        """
        return self.velocities[..., self._row(body), :]

    def at(self, time: NumberLike) -> Poses:
        """Compute the poses at any time.

        The motion must have been simulated with `saveat=diffrax.SaveAt(dense=True)`.

        Args:
            time: Time between the start and the end; s.

        Returns:
            The poses of the bodies; rad, m, m.

        Raises:
            ValueError: The motion was simulated without this option.
        """
        if self.system is None:
            raise ValueError(
                "This motion was saved at its times only. For poses at any time, use "
                "`simulate(..., saveat=diffrax.SaveAt(dense=True))`."
            )
        instant = jnp.asarray(time, float)
        state = self.solution.evaluate(instant)
        displacements, _ = self.system.expand(instant, state.position, state.rate)
        return self.reference + displacements

    def columns(self) -> Columns:
        velocity = (
            ("angular_velocity", "rad/s"),
            ("velocity_x", "m/s"),
            ("velocity_y", "m/s"),
        )
        table = {
            "time": Column(self.times, ("time",), "s"),
            **self._body_columns("time"),
            **columns(self.velocities, ("time", "body"), *velocity, body=self.names),
        }
        for field in fields(self.energies):
            energy = getattr(self.energies, field.name)
            table[f"energy_{field.name}"] = Column(energy, ("time",), "J")
        return {**table, "steps": Column(self.steps), "rejected": Column(self.rejected)}

    def _summary(self, names: np.ndarray) -> str:
        times, displacements = map(np.asarray, (self.times, self.displacements))
        title = (
            f"{names}: {float(times[0]):g} to {float(self.reached):.6g} s in "
            f"{int(self.steps)} steps of {self.method}, {int(self.rejected)} rejected; "
            f"{times.size} saved times"
        )
        if np.any(self.energies.dissipated):
            imbalance = np.nanmax(np.abs(self.energies.imbalance))
            stored = np.nanmax(self.energies.elastic + self.energies.kinetic)
            title += f"\nerror of the energy: {imbalance:.2g} J of {stored:.3g} J"
        largest = np.nanmax(np.abs(displacements), axis=0)
        return self._listed(title, "largest", largest)
