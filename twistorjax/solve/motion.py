"""How a mechanism moved, as an answer."""

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from .._utils.validation import all_concrete
from .motion_system import System
from .results import count_results, PoseSolution, result_names, RESULTS
from .tables import Column, Columns, columns


class Energies(eqx.Module):
    """Where the energy of a motion is, and where it came from; J.

    What is stored and moving is what it was at the start, and what loads and drives have
    done since, less what was dissipated.

    Args:
        elastic: stored in the hinges.
        kinetic: of the bodies.
        dissipated: in the hinges, since the start.
        by_loads: done by the loads, since the start.
        by_drives: done by what drives coordinates and moves constraints, since the start.
    """

    elastic: Float[Array, "..."]
    kinetic: Float[Array, "..."]
    dissipated: Float[Array, "..."]
    by_loads: Float[Array, "..."]
    by_drives: Float[Array, "..."]

    @property
    def imbalance(self) -> Float[Array, "..."]:
        """What is there and should not be: the error of the motion, as energy."""
        fixed = self.elastic + self.kinetic
        came = self.by_loads + self.by_drives - self.dissipated
        return (fixed - fixed[..., :1]) - (came - came[..., :1])


class Motion(PoseSolution):
    """How the bodies of a mechanism moved.

    Where a motion stopped before its end, the rows of later times are NaN.

    Args:
        times: s.
        displacements: of each body from its rest; rad, m, m.
        velocities: of each body, in world axes; rad/s, m/s, m/s.
        reference: the poses from which displacements count; rad, m, m.
        reactions: what held and driven coordinates receive from outside; zero elsewhere.
            About each body's origin, in world axes; N m, N, N.
        pushes: of each constraint's entries; N m, N.
        energies: where the energy is, and where it came from; J.
        reached: the time up to which it went; s.
        steps: of the solver, those that were tried again included.
        rejected: those that were tried again.
        result: how it ended; `result_names` gives its name.
        solution: all else that diffrax tells.
        system: its equations, where the whole of it was kept.
        names: of the bodies, for their rows.
        joints: the constraint that each entry of `pushes` belongs to.
    """

    times: Float[Array, "*batch times"]
    displacements: Float[Array, "*batch times bodies 3"]
    velocities: Float[Array, "*batch times bodies 3"]
    reference: Float[Array, "*batch bodies 3"]
    reactions: Float[Array, "*batch times bodies 3"]
    pushes: Float[Array, "*batch times entries"]
    energies: Energies
    reached: Float[Array, "*batch"]
    steps: Int[Array, "*batch"]
    rejected: Int[Array, "*batch"]
    result: RESULTS
    solution: dfx.Solution
    system: System | None
    names: tuple[str, ...] = eqx.field(static=True)
    joints: tuple[str, ...] = eqx.field(static=True)

    def velocity(self, body: str) -> Float[Array, "*batch times 3"]:
        """How fast a body moves; rad/s, m/s, m/s."""
        return self.velocities[..., self._row(body), :]

    def at(self, time: ArrayLike) -> Float[Array, "bodies 3"]:
        """The poses at any time of a motion kept as a whole, by `SaveAt(dense=True)`.

        Args:
            time: between its start and its end; s.

        Raises:
            ValueError: the motion was not kept as a whole.
        """
        if self.system is None:
            raise ValueError(
                "This motion was kept at its times alone. For poses at any time: "
                "`simulate(..., saveat=diffrax.SaveAt(dense=True))`."
            )
        instant = jnp.asarray(time, float)
        state = self.solution.evaluate(instant)
        return self.reference + self.system.spread(instant, state.place, state.rate)[0]

    def push(self, constraint: str) -> Float[Array, "*batch times entries"]:
        """What a constraint exerts, for each of its entries; N m, N."""
        rows = [k for k, name in enumerate(self.joints) if name == constraint]
        if not rows:
            there = ", ".join(map(repr, dict.fromkeys(self.joints))) or "none"
            raise ValueError(
                f"`constraint` is {constraint!r}, but the constraints are {there}."
            )
        return self.pushes[..., np.array(rows)]

    def columns(self) -> Columns:
        rows = ("time", "body")
        told = {
            "time": Column(self.times, ("time",), "s"),
            **self._by_body(self.poses, "time"),
            **columns(
                self.velocities,
                rows,
                ("angular_velocity", "rad/s"),
                ("velocity_x", "m/s"),
                ("velocity_y", "m/s"),
                body=self.names,
            ),
        }
        if self.joints:
            entries = (("entry", self.joints),)
            told["push"] = Column(self.pushes, ("time", "entry"), labels=entries)
        for name in ("elastic", "kinetic", "dissipated", "by_loads", "by_drives"):
            energy = getattr(self.energies, name)
            told[f"energy_{name}"] = Column(energy, ("time",), "J")
        told["steps"] = Column(self.steps)
        told["rejected"] = Column(self.rejected)
        return told

    def __repr__(self) -> str:
        ended = result_names(self.result)
        seen = all_concrete([self.times, self.displacements, self.energies.dissipated])
        if ended is None or seen is None:
            return eqx.tree_pformat(self)
        if ended.shape:
            return count_results("motions", ended)
        times, moved, _ = seen
        title = (
            f"{ended}: {float(times[0]):g} to {float(self.reached):.6g} s in "
            f"{int(self.steps)} steps, {int(self.rejected)} tried again; "
            f"{times.size} times kept"
        )
        if np.any(seen[2]):
            lost = np.nanmax(np.abs(self.energies.imbalance))
            fixed = np.nanmax(self.energies.elastic + self.energies.kinetic)
            title += f"\nenergy out of balance by {lost:.2g} J of {fixed:.3g} J"
        return self._listed(title, "largest", np.nanmax(np.abs(moved), axis=0))
