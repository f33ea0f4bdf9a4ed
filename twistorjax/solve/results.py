"""How a solve ended, and what all solutions have in common."""

from collections import Counter
from collections.abc import Callable
from typing import Protocol, runtime_checkable, TypeVar

import diffrax as dfx
import equinox as eqx
import numpy as np
from jaxtyping import Array, Inexact

from .._utils.types import (
    BatchEntries,
    BatchFlag,
    BatchPose,
    BatchPoses,
    BatchRow,
    Numbers,
)
from .._utils.validation import concrete
from .tables import Column, Columns, columns, Tabular


class RESULTS(dfx.RESULTS):  # pyright: ignore[reportGeneralTypeIssues]
    """Reasons why a solve ended. The message of `successful` is empty.

    Equilibria end as `successful`, `not_finite`, `unstable`, `no_equilibrium`,
    `steps_used_up`, `inconsistent_constraints`, or `out_of_range`. Motions end as
    `successful`, `event_occurred`, `max_steps_reached`, `not_finite`, `out_of_range`,
    `step_too_long`, or with a reason why they cannot start. Identifications end as
    `successful`, `not_converged`, or `no_solution_at_start`. `RESULTS[item]` is the
    message. The enumeration extends that of diffrax.
    """

    successful = ""
    not_finite = (
        "A value of the mechanism, its loads or its drives is not finite: a NaN was "
        "given, or a dimension of a hinge lies outside the range of its formula."
    )
    unstable = (
        "Some body can move without storing energy, or even releases energy, so the "
        "equilibrium is not determined or not stable. Hold the body with `fixed`, "
        "prescribe its displacement, add a hinge, or stiffen one: the `stiffness` of the "
        "mechanism there is singular or has a negative eigenvalue."
    )
    no_equilibrium = (
        "No equilibrium was found that is connected to the start up to the full loads "
        "and drives. `fraction` is the part of them that was reached: there the "
        "mechanism may buckle or snap through, or a hinge may leave the range of its "
        "energy. Take smaller loads, prescribe a displacement instead of the load, or, "
        "if a symmetric mechanism may buckle to either side, choose one by a small load."
    )
    steps_used_up = (
        "The largest number of Newton steps was reached. `fraction` is the part of the "
        "loads and drives that was reached; raise `max_steps`, or start closer with "
        "`start`."
    )
    out_of_range = (
        "A hinge is displaced beyond the validity range of its energy: it rotates "
        "further, or transmits a larger force, than the energy was made for. Make the "
        "energy for a wider range, or load the mechanism less."
    )

    step_too_long = (
        "The steps of constant length are too long for this motion: the equations of one "
        "step did not converge. Give a shorter `step`, or none, so that the steps are "
        "chosen by the tolerance."
    )
    times_not_increasing = (
        "The times do not increase. Give at least two times, each later than the one "
        "before."
    )
    drive_jumps = (
        "At the first time a prescribed coordinate is not where its body starts, so it "
        "would have to jump. Start the drive at the start, or start the body at the "
        "drive."
    )
    damping_gives_energy = (
        "The damping of a hinge has a negative eigenvalue, so it would supply energy to "
        "the mechanism instead of dissipating it. Every eigenvalue must be zero or "
        "positive."
    )
    inconsistent_constraints = (
        "The constraints repeat or contradict one another, or the start violates them."
    )

    not_converged = (
        "The estimates have not converged within the allowed evaluations. Raise "
        "`max_steps`, start closer, try `restarts`, or leave out parameters that the "
        "measurements do not determine."
    )
    no_solution_at_start = (
        "At the start values of the parameters, a test has no solution. Start from "
        "values at which every solve succeeds."
    )


def result_names(result: RESULTS) -> np.ndarray | None:
    """Return the names of results in the shape of their batch; None while traced."""
    index = concrete(result._value)
    return None if index is None else np.array(_BY_NUMBER[index], object)


def count_results(noun: str, names: np.ndarray) -> str:
    """Count how many solutions of a batch ended in each way, in one line."""
    counts = Counter(map(str, names.ravel()))
    words = ", ".join(f"{count:,} {name}" for name, count in counts.items())
    return f"{names.size:,} {noun}, of shape {names.shape}: {words}"


@runtime_checkable
class HasResult(Protocol):
    """A solution that reports how it ended."""

    @property
    def result(self) -> RESULTS: ...

    @property
    def succeeded(self) -> BatchFlag: ...


Solution = TypeVar("Solution", bound=HasResult)


def raise_failed(
    solution: Solution, error: Callable[[str, tuple[int, ...]], Exception]
) -> Solution:
    """Return a solution if it succeeded, and raise the error of the first failed one.

    Args:
        solution: A solution, or a batch of them.
        error: Function that returns the error, from the name of the result and the index
            in the batch.

    Returns:
        The solution.
    """
    names = result_names(solution.result)
    if names is None:
        return solution.result.error_if(solution, ~solution.succeeded)
    failed = ~np.asarray(solution.succeeded)
    if np.any(failed):
        index = tuple(map(int, np.unravel_index(np.argmax(failed), failed.shape)))
        raise error(np.asarray(names)[index], index)
    return solution


def result_message(name: str) -> str:
    """Return the message of a result, by its name."""
    return RESULTS[getattr(RESULTS, name)]


# by the numbers of the results
RESULT_NAMES = tuple(
    sorted(RESULTS._name_to_item, key=lambda name: int(getattr(RESULTS, name)._value))
)
_BY_NUMBER = np.array(RESULT_NAMES, object)

_WRENCH = ("moment", "N m"), ("force_x", "N"), ("force_y", "N")


def _pose_columns(prefix: str) -> tuple[tuple[str, str], ...]:
    """Names and units of the columns of a pose or a displacement."""
    return (f"{prefix}angle", "rad"), (f"{prefix}x", "m"), (f"{prefix}y", "m")


class BodySolution(Tabular):
    """A solution with displacements and reactions of each body."""

    displacements: eqx.AbstractVar[Inexact[Array, "..."]]
    reactions: eqx.AbstractVar[Inexact[Array, "..."]]
    constraint_forces: eqx.AbstractVar[Inexact[Array, "..."]]
    result: eqx.AbstractVar[RESULTS]
    names: eqx.AbstractVar[tuple[str, ...]]
    constraint_names: eqx.AbstractVar[tuple[str, ...]]

    @property
    def succeeded(self) -> BatchFlag:
        """Whether the solve succeeded."""
        done = self.result == RESULTS.successful
        return done | (self.result == RESULTS.event_occurred)

    def displacement(self, body: str) -> BatchRow:
        """Return the displacement of a body from its reference pose; rad, m, m."""
        return self.displacements[..., self._row(body), :]

    def reaction(self, body: str) -> BatchRow:
        """Return the external wrench on fixed and prescribed coordinates of a body.

        About the origin of the body, in world axes; N m, N, N.
        """
        return self.reactions[..., self._row(body), :]

    def constraint_force(self, constraint: str) -> BatchEntries:
        """Return the constraint force of each entry of a constraint; N m, N.

        Raises:
            ValueError: The mechanism has no such constraint.
        """
        rows = [k for k, name in enumerate(self.constraint_names) if name == constraint]
        if not rows:
            names = dict.fromkeys(self.constraint_names)
            raise ValueError(
                f"`constraint` is {constraint!r}, but the constraints are "
                f"{', '.join(map(repr, names)) or 'none'}."
            )
        return self.constraint_forces[..., np.array(rows)]

    def _body_columns(self, *axes: str) -> Columns:
        """Columns of displacements, reactions, and constraint forces.

        Args:
            axes: Axes before that of the bodies.
        """
        rows, names = (*axes, "body"), {"body": self.names}
        moved = _pose_columns("displacement_")
        found = {
            **columns(self.displacements, rows, *moved, **names),
            **columns(self.reactions, rows, *_WRENCH, **names),
        }
        if self.constraint_names:
            entries = (("entry", self.constraint_names),)
            forces = self.constraint_forces
            found["constraint_force"] = Column(forces, (*axes, "entry"), labels=entries)
        return found

    def _row(self, body: str) -> int:
        """Return the index of a body."""
        if body not in self.names:
            raise ValueError(
                f"`body` is {body!r}, but the bodies are "
                f"{', '.join(map(repr, self.names))}."
            )
        return self.names.index(body)


class PoseSolution(BodySolution):
    """A solution with the pose of each body."""

    reference: eqx.AbstractVar[Numbers]

    @property
    def poses(self) -> BatchPoses:
        """Poses of the bodies; rad, m, m."""
        more = self.displacements.ndim - self.reference.ndim
        shape = (*self.reference.shape[:-2], *more * (1,), *self.reference.shape[-2:])
        return self.reference.reshape(shape) + self.displacements

    def pose(self, body: str) -> BatchPose:
        """Return the pose of a body; rad, m, m."""
        return self.poses[..., self._row(body), :]

    def _body_columns(self, *axes: str) -> Columns:
        poses = columns(self.poses, (*axes, "body"), *_pose_columns(""), body=self.names)
        return {**poses, **super()._body_columns(*axes)}

    def _listed(self, title: str, head: str, rows: np.ndarray) -> str:
        """Return a title and a line for each body, at most 20 of them."""
        wide = max(map(len, (*self.names, head)))
        lines = [f"{head:<{wide}}  {'angle (rad)':>13}  {'x (m)':>13}  {'y (m)':>13}"]
        for name, values in zip(self.names, rows, strict=True):
            cells = "  ".join(f"{value:>13.6g}" for value in values)
            lines.append(f"{name:<{wide}}  {cells}")
        if len(lines) > 21:
            lines[11:-1] = [f"... {len(lines) - 12} more"]
        return "\n".join([title, *lines])
