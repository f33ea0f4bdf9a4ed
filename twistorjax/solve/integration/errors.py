"""Error messages of motions that cannot start, or that did not reach their end."""

from collections.abc import Sequence
from typing import Any, cast, NamedTuple, TYPE_CHECKING

import jax
import numpy as np
from jaxtyping import Array

from ..._utils.host import all_concrete
from ..._utils.types import Poses
from ...mechanism.constraints import ConstraintSet
from ...mechanism.loads import Drive, prescribed_dofs
from ...mechanism.mechanism import Mechanism
from ...results.codes import result_error, result_message
from ..equations.consistency import (
    characteristic_length,
    constraint_error,
    LARGEST_INITIAL_VIOLATION,
)
from ..equations.dofs import DofPartition


if TYPE_CHECKING:
    from .solution import Motion


class StartOfMotion(NamedTuple):
    """Start of a motion, with its checks and error messages."""

    mechanism: Mechanism
    drives: Any  # Prescribed displacements, or a function of time that returns them
    constraints: ConstraintSet
    displacements: Poses  # Displacements at the start; rad, m, m
    time: Array  # Time at the start; s
    dofs: DofPartition  # Partition of the degrees of freedom
    has_velocities: bool  # Whether velocities at the start are given

    def check(self) -> None:
        """Raise a ValueError if the start is invalid, before anything is compiled."""
        values = [self.displacements, self.time]
        leaves = jax.tree.leaves((self.mechanism, self.constraints))
        if all_concrete([*values, *leaves]) is None:
            return
        if (jumps := self._jumps()) is None:
            return
        unit = characteristic_length(self.mechanism)
        if any(
            jump > LARGEST_INITIAL_VIOLATION * (1.0 if dof % 3 == 0 else unit)
            for dof, jump, _ in jumps
        ):
            raise ValueError(f"{result_message('drive_jumps')} {self._jump_message()}")
        if not self.constraints.size or self.has_velocities:
            return
        violation = self.constraints.violation(self.displacements, self.time)
        message = self._constraint_message()
        if np.all(np.isfinite(np.asarray(violation))) and message:
            name = "inconsistent_constraints"
            raise ValueError(f"{result_message(name)} {message}")

    def error(
        self, motion: "Motion", name: str, batch_index: tuple[int, ...]
    ) -> Exception:
        """Return the error of a failed motion from the name of its result.

        `batch_index` is its index in a batch; empty for a single motion.
        """
        detail = ""
        if batch_index or name in ("times_not_increasing", "damping_gives_energy"):
            pass
        elif name == "drive_jumps":
            detail = f" {self._jump_message()}"
        elif name == "inconsistent_constraints":
            message = self._constraint_message()
            detail = f" {message or 'The velocities at the start violate them.'}"
        else:
            detail = _not_finite_message(self.mechanism) if name == "not_finite" else ""
            detail += f" {_stop_message(motion, self.mechanism)}"
        return result_error(name, batch_index, detail)

    def _jumps(self) -> list[tuple[int, float, float]] | None:
        """List the degree of freedom, the jump, and the target of each drive; rad, m."""
        drives = self.drives(self.time) if callable(self.drives) else self.drives
        dofs, targets = prescribed_dofs(self.mechanism, cast(Sequence[Drive], drives))
        if all_concrete(targets) is None:
            return None
        start = np.asarray(self.displacements).reshape(-1)
        return [
            (dof, abs(float(target) - float(start[dof])), float(target))
            for dof, target in zip(dofs, targets, strict=True)
        ]

    def _jump_message(self) -> str:
        """Describe the prescribed coordinates that would have to jump."""
        start = np.asarray(self.displacements).reshape(-1)
        return " ".join(
            f"The {self.mechanism.dof_name(dof)} starts at {start[dof]:.6g}, but "
            f"{target:.6g} is prescribed."
            for dof, jump, target in self._jumps() or []
            if jump > 0
        )

    def _constraint_message(self) -> str:
        """Describe the constraints that are violated or redundant."""
        return constraint_error(
            self.constraints, self.dofs, self.mechanism, self.displacements, self.time
        )


def _not_finite_message(mechanism: Mechanism) -> str:
    """Name the hinge or body with a value that is not finite."""
    for row, name in enumerate(mechanism.hinge_names):
        values = jax.tree.leaves(mechanism.hinge_assembly.energy_of(row))
        if not all(np.all(np.isfinite(value)) for value in values):
            return f" The value is in the energy of the hinge {name!r}."
    for body, name in enumerate(mechanism.names):
        values = (
            mechanism.reference[body],
            mechanism.masses[body],
            mechanism.inertias[body],
        )
        if not all(np.all(np.isfinite(v)) for v in values if v is not None):
            return f" The value is in the body {name!r}."
    return ""


def _stop_message(motion: "Motion", mechanism: Mechanism) -> str:
    """Describe the end of a motion, its fastest body, and the hinge with most energy."""
    reached, steps = float(motion.reached), int(motion.steps)
    text = f"The motion reached t = {reached:.6g} s in {steps} steps."
    saved = np.flatnonzero(np.isfinite(np.asarray(motion.times)))
    if not saved.size or saved[-1] == 0:
        return text
    last = saved[-1]
    speeds = np.linalg.norm(np.asarray(motion.velocities)[last, :, 1:], axis=1)
    fastest = mechanism.names[int(np.argmax(speeds))]
    poses = motion.poses[last]
    energies = [float(mechanism.energy_of(name, poses)) for name in mechanism.hinge_names]
    largest = mechanism.hinge_names[int(np.argmax(energies))]
    return (
        f"{text} At {float(motion.times[last]):.6g} s the body {fastest!r} was the "
        f"fastest, and the hinge {largest!r} stored the most energy."
    )
