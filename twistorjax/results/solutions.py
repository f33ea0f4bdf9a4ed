"""What solutions with poses of bodies share: displacements, reactions, and poses."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Inexact

from .._utils.types import Numbers
from .._utils.validation import listing, quote
from .codes import Solution
from .tables import cells, Column, Columns, columns, Tabular


_ROUNDING = 1e-14  # of displacements, relative to the largest one
_WRENCH = ("moment", "N m"), ("force_x", "N"), ("force_y", "N")


def _pose_columns(prefix: str) -> tuple[tuple[str, str], ...]:
    """Return the names and units of the columns of a pose or a displacement."""
    return (f"{prefix}angle", "rad"), (f"{prefix}x", "m"), (f"{prefix}y", "m")


class BodyDisplacements(eqx.Module):
    """Displacements of bodies, which are found by their names."""

    displacements: eqx.AbstractVar[Inexact[Array, "..."]]
    names: eqx.AbstractVar[tuple[str, ...]]

    def displacement(self, body: str) -> Inexact[Array, "*batch 3"]:
        """Return the displacement of a body.

        The displacement of an equilibrium or of a motion is measured from the reference
        pose. That of a linear response is the change from the equilibrium about which the
        mechanism is linearized. That of a frequency response is the complex amplitude of
        this change.

        Args:
            body: Name of the body.

        Returns:
            Angle, x, and y; a motion has one row for each time, a frequency response one
            for each frequency; rad, m, m.

        Raises:
            ValueError: There is no body of this name.
        """
        return self.displacements[..., self._row(body), :]

    def _row(self, body: str) -> int:
        if body not in self.names:
            raise ValueError(
                f"`body` is {quote(body)}, but the bodies are {listing(self.names)}."
            )
        return self.names.index(body)


class BodyPoses(BodyDisplacements):
    """Displacements of bodies from reference poses."""

    reference: eqx.AbstractVar[Numbers]

    @property
    def poses(self) -> Float[Array, "*batch bodies 3"]:
        """Poses of the bodies: reference poses plus displacements; rad, m, m."""
        batch_axes = self.displacements.ndim - self.reference.ndim
        shape = (
            *self.reference.shape[:-2],
            *batch_axes * (1,),
            *self.reference.shape[-2:],
        )
        return self.reference.reshape(shape) + self.displacements

    def pose(self, body: str) -> Float[Array, "*batch 3"]:
        """Return the pose of a body.

        Args:
            body: Name of the body.

        Returns:
            Angle, x, and y; a motion has one row for each time; rad, m, m.

        Raises:
            ValueError: There is no body of this name.
        """
        return self.poses[..., self._row(body), :]


class BodySolution(Solution, Tabular, BodyDisplacements):
    """A solution with displacements and reactions of each body."""

    reactions: eqx.AbstractVar[Inexact[Array, "..."]]
    constraint_forces: eqx.AbstractVar[Inexact[Array, "..."]]
    constraint_names: eqx.AbstractVar[tuple[str, ...]]

    def reaction(self, body: str) -> Inexact[Array, "*batch 3"]:
        """Return the external wrench on fixed and prescribed coordinates of a body.

        The wrench is about the origin of the body, in world axes.

        Args:
            body: Name of the body.

        Returns:
            Moment and force, zero for free coordinates; a motion has one row for each
            time, a frequency response one for each frequency; N m, N, N.

        Raises:
            ValueError: There is no body of this name.
        """
        return self.reactions[..., self._row(body), :]

    def constraint_force(self, constraint: str) -> Inexact[Array, "*batch entries"]:
        """Return the constraint forces of a constraint.

        Args:
            constraint: Name of the constraint.

        Returns:
            One force or moment for each scalar equation of the constraint; N m, N.

        Raises:
            ValueError: There is no constraint of this name.
        """
        rows = [k for k, name in enumerate(self.constraint_names) if name == constraint]
        if not rows:
            names = dict.fromkeys(self.constraint_names)
            raise ValueError(
                f"`constraint` is {quote(constraint)}, but the constraints are "
                f"{listing(names)}."
            )
        return self.constraint_forces[..., np.array(rows)]

    def _body_columns(self, *axes: str) -> Columns:
        """Return displacements, reactions, and constraint forces.

        `axes` are the axes in front of that of the bodies.
        """
        rows, names = (*axes, "body"), {"body": self.names}
        displacement = _pose_columns("displacement_")
        table = {
            **columns(self.displacements, rows, *displacement, **names),
            **columns(self.reactions, rows, *_WRENCH, **names),
        }
        if self.constraint_names:
            entries = (("entry", self.constraint_names),)
            forces = self.constraint_forces
            table["constraint_force"] = Column(forces, (*axes, "entry"), labels=entries)
        return table


class PoseSolution(BodySolution, BodyPoses):
    """A solution with the pose of each body."""

    def _body_columns(self, *axes: str) -> Columns:
        poses = columns(self.poses, (*axes, "body"), *_pose_columns(""), body=self.names)
        return {**poses, **super()._body_columns(*axes)}

    def _listed(self, title: str, head: str, rows: np.ndarray) -> str:
        """Return a title and a line for each body, at most 20 of them."""
        width = max(map(len, (*self.names, head)))
        # Angles or translations that are tiny beside the others are rounding errors.
        largest = np.abs(np.nan_to_num(rows)).max(axis=0, initial=0.0)
        largest[1:] = largest[1:].max()
        rows = np.where(np.abs(rows) < _ROUNDING * largest, 0.0, rows)
        lines = [f"{head:<{width}}  {'angle (rad)':>13}  {'x (m)':>13}  {'y (m)':>13}"]
        for name, values in zip(self.names, rows, strict=True):
            lines.append(f"{name:<{width}}  {'  '.join(cells(values))}")
        if len(lines) > 21:
            lines[11:-1] = [f"... {len(lines) - 12} more"]
        return "\n".join([title, *lines])
