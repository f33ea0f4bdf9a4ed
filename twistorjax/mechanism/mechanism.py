"""A mechanism: rigid bodies coupled by elastic hinges."""

from collections.abc import Callable, Iterable, Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import (
    BatchPose,
    BatchPoses,
    BatchWrench,
    BodiesMatrix,
    Corners,
    Displaced,
    Pose,
    Poses,
    PosesOrResult,
    Scalar,
    Wrenches,
)
from .._utils.validation import (
    all_concrete,
    index_of,
    PLURAL,
    require_distinct,
    require_kind,
    shorten,
)
from ..energies.base import range_message
from ..geometry import se2
from .body import Body
from .hinge import check_energy, frame_of, Hinge
from .hinge_assembly import HingeAssembly
from .hinge_groups import group_hinges, sums_of
from .support import unsupported_bodies


COORDINATES = ("angle", "x", "y")


class Mechanism(eqx.Module):
    """Rigid bodies that are coupled by elastic hinges, some of them fixed.

    Arrays have a row for each body, in the order in which the bodies are given. The
    degrees of freedom are numbered in the same order, three for each body.

    Args:
        bodies: The bodies in the reference configuration, in which no hinge is loaded.
        hinges: The hinges between them.
        fixed: Names of the bodies that cannot move; or a mapping from names of bodies to
            the coordinates that cannot move, of "angle", "x", and "y".

    Raises:
        ValueError: A name is unknown or occurs twice, the two ports of a hinge do not
            coincide in the reference configuration, or the energy of a hinge is invalid.

    Example:
        >>> from twistorjax import Body, Hinge, Quadratic
        >>> spring = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0])))
        >>> hinge = Hinge("spring", "wall", "block", spring, at=(0, 0.1, 0))
        >>> Mechanism([Body("wall"), Body("block")], [hinge], fixed=["wall"])
        Mechanism of 2 bodies (wall, block), 1 hinge (spring); fixed: wall
    """

    names: tuple[str, ...] = eqx.field(static=True)
    hinge_names: tuple[str, ...] = eqx.field(static=True)
    fixed: tuple[int, ...] = eqx.field(static=True)
    reference: Poses
    masses: tuple[Scalar | None, ...]
    inertias: tuple[Scalar | None, ...]
    outlines: tuple[Corners | None, ...]
    at: Float[Array, "hinges 3"]
    hinge_outlines: tuple[Corners | None, ...]
    hinge_assembly: HingeAssembly

    def __init__(
        self,
        bodies: Sequence[Body],
        hinges: Sequence[Hinge],
        fixed: Sequence[str] | Mapping[str, Sequence[str]] = (),
    ):
        require_kind("bodies", bodies, Body)
        require_kind("hinges", hinges, Hinge)
        self.names = require_distinct("body", [body.name for body in bodies])
        self.hinge_names = require_distinct("hinge", [hinge.name for hinge in hinges])
        self.reference = _rows([body.pose for body in bodies])
        self.masses = tuple(body.mass for body in bodies)
        self.inertias = tuple(body.inertia for body in bodies)
        self.outlines = tuple(body.outline for body in bodies)
        self.hinge_outlines = tuple(hinge.outline for hinge in hinges)
        if not hinges:
            raise ValueError("`hinges` is empty, but a mechanism needs at least one.")
        ends = tuple(
            (
                self._body(f"`first` of the hinge {hinge.name!r}", hinge.first),
                self._body(f"`second` of the hinge {hinge.name!r}", hinge.second),
            )
            for hinge in hinges
        )
        for hinge in hinges:
            check_energy(hinge)
        frames = [
            frame_of(hinge, bodies[first].pose, bodies[second].pose)
            for hinge, (first, second) in zip(hinges, ends, strict=True)
        ]
        self.at = _rows(frames)
        self.fixed = self.coordinates("fixed", fixed)
        pairs = np.array(ends, int).reshape(-1, 2)
        self.hinge_assembly = HingeAssembly(
            bodies=len(bodies),
            ends=ends,
            arms=self.at[:, None, 1:] - self.reference[pairs, 1:],
            axes=jnp.stack([jnp.cos(self.at[:, 0]), jnp.sin(self.at[:, 0])], axis=1),
            groups=group_hinges(hinges),
            sums=sums_of(hinges),
        )

    def index(self, name: str) -> int:
        """Return the row of a body in arrays of poses and wrenches.

        Raises:
            ValueError: The mechanism has no body of that name.
        """
        return self._body("`name`", name)

    def energy(self, poses: Poses) -> Scalar:
        """Compute the energy that is stored in all hinges; J.

        Args:
            poses: Poses of the bodies; rad, m, m.
        """
        return self.hinge_assembly.energy(self.displacements(poses))

    def wrenches(self, poses: Poses) -> Wrenches:
        """Compute the wrench of the hinges on each body; N m, N, N.

        Args:
            poses: Poses of the bodies; rad, m, m.

        Returns:
            The wrenches about the origins of the bodies, in world axes.
        """
        return -self.hinge_assembly.forces(self.displacements(poses))

    def stiffness(self, poses: Poses) -> BodiesMatrix:
        """Compute the second derivative of the energy by the poses; N m/rad, N/rad, N/m.

        Args:
            poses: Poses of the bodies; rad, m, m.
        """
        every = tuple(range(3 * len(self.names)))
        displacements = self.displacements(poses)
        _, matrix, _ = self.hinge_assembly.tangent(displacements, every, every)
        return matrix.reshape(2 * (len(self.names), 3))

    def inertia(self) -> Wrenches:
        """Collect inertia, mass, and mass of each body; infinite for fixed bodies.

        Raises:
            ValueError: A body that can move has no mass or no inertia.
        """
        rows = []
        for body, name in enumerate(self.names):
            mass, inertia = self.masses[body], self.inertias[body]
            if {3 * body, 3 * body + 1, 3 * body + 2} <= set(self.fixed):
                rows.append(jnp.full(3, jnp.inf))
            elif mass is None or inertia is None:
                missing = "mass" if mass is None else "inertia"
                raise ValueError(
                    f"The body {name!r} moves, but has no `{missing}`: give it one, or "
                    "fix the body."
                )
            else:
                rows.append(jnp.stack([inertia, mass, mass]))
        return jnp.stack(rows)

    def range_messages(self, poses: Poses) -> str:
        """Name the hinges that are displaced beyond the validity range of their energies.

        Args:
            poses: Poses of the bodies; rad, m, m.

        Returns:
            One sentence for each hinge.
        """
        displacements = self.displacements(poses)
        outside = np.asarray(self.hinge_assembly.out_of_range(displacements))
        sentences = []
        for row in map(int, np.flatnonzero(outside)):
            energy = self.hinge_assembly.energy_of(row)
            at = self.hinge_assembly.displacement_of(row, displacements)
            message = range_message(energy, at)
            sentences.append(f"The hinge {self.hinge_names[row]!r}: {message}.")
        return " ".join(sentences)

    def displacement_of(self, hinge: str, at: PosesOrResult) -> BatchPose:
        """Compute the displacement of frame b of a hinge, seen from its frame a.

        Args:
            hinge: Name of the hinge.
            at: Equilibrium or motion. Or poses of the bodies, which have lost the digits
                of displacements that are small compared with positions; rad, m, m.

        Returns:
            Angle, and translation along axes 1 and 2 of frame a. Of a motion, a row for
            each time; rad, m, m.

        Raises:
            ValueError: The mechanism has no hinge of that name, or the poses are not
                those of its bodies.
        """
        row = index_of("`hinge`", "hinge", hinge, self.hinge_names)
        return self._of_hinge(at, lambda moved: self._hinge_pose(row, moved))

    def wrench_of(self, hinge: str, at: PosesOrResult) -> BatchWrench:
        """Compute the wrench that body B exerts on a hinge, about frame b, in its axes.

        Args:
            hinge: Name of the hinge.
            at: Equilibrium or motion. Or poses of the bodies, which have lost the digits
                of displacements that are small compared with positions; rad, m, m.

        Returns:
            Moment, and force along axes 1 and 2 of frame b: axial and transverse for a
            leaf or a notch. Of a motion, a row for each time; N m, N, N.

        Raises:
            ValueError: The mechanism has no hinge of that name, the poses are not those
                of its bodies, or the hinge is beyond the validity range of its energy.
        """
        row = index_of("`hinge`", "hinge", hinge, self.hinge_names)
        wrench = self.hinge_assembly.energy_of(row).wrench
        return self._of_hinge(at, lambda moved: wrench(self._hinge_pose(row, moved)))

    def _hinge_pose(self, row: int, displacements: Poses) -> Pose:
        """Compute frame b of a hinge, seen from its frame a; rad, m, m."""
        at = self.hinge_assembly.displacement_of(row, displacements)
        x, y = at.sigma * at.x1 - at.xi * at.x2, at.sigma * at.x2 + at.xi * at.x1
        return jnp.stack([at.angle, 2 * x, 2 * y])

    def _of_hinge(self, at: PosesOrResult, of: Callable[[Poses], Pose]) -> BatchPose:
        """Evaluate a function of displacements for each of a batch of them."""
        displacements = self.displacements(at, "at")
        flat = displacements.reshape(-1, *self.reference.shape)
        shape = (*displacements.shape[:-2], 3)
        if len(flat) == 1:  # not traced, so that a value out of range raises an error
            return of(flat[0]).reshape(shape)
        return jax.vmap(of)(flat).reshape(shape)

    def ports(self, hinge: str, poses: Poses) -> tuple[Pose, Pose]:
        """Compute the two frames of a hinge in the world; rad, m, m.

        Args:
            hinge: Name of the hinge.
            poses: Poses of the bodies; rad, m, m.

        Returns:
            Frame a on body A, and frame b on body B.

        Raises:
            ValueError: The mechanism has no hinge of that name.
        """
        row = index_of("`hinge`", "hinge", hinge, self.hinge_names)
        first, second = (
            se2.compose(poses[body], se2.between(self.reference[body], self.at[row]))
            for body in self.hinge_assembly.ends[row]
        )
        return first, second

    def coordinate(self, dof: int) -> str:
        """Name the coordinate of a degree of freedom in words."""
        return f"{COORDINATES[dof % 3]} of {self.names[dof // 3]!r}"

    def __repr__(self) -> str:
        def listed(noun: str, names: Sequence[str]) -> str:
            shown = names if len(names) <= 12 else (*names[:10], "...", names[-1])
            word = noun if len(names) == 1 else PLURAL[noun]
            return f"{len(names)} {word} ({', '.join(shown)})"

        return (
            f"Mechanism of {listed('body', self.names)}, "
            f"{listed('hinge', self.hinge_names)}; "
            f"fixed: {', '.join(self._fixed_words()) or 'nothing'}"
        )

    def _fixed_words(self) -> Iterable[str]:
        """Name the fixed coordinates of each body."""
        for body, name in enumerate(self.names):
            fixed = [COORDINATES[k] for k in range(3) if 3 * body + k in self.fixed]
            if fixed:
                yield name if len(fixed) == 3 else f"{' and '.join(fixed)} of {name}"

    def _body(self, where: str, name: str) -> int:
        """Return the index of a body; `where` names the argument in messages."""
        return index_of(where, "body", name, self.names)

    def displacements(
        self, at: PosesOrResult, name: str = "poses", *, one: bool = False
    ) -> BatchPoses:
        """Compute the displacements of the bodies from their reference poses; rad, m, m.

        Args:
            at: Equilibrium or motion of this mechanism, or poses of its bodies; rad, m,
                m.
            name: Name of the argument in messages.
            one: Whether a motion or a batch is refused.

        Raises:
            ValueError: It is something else, or its shape does not fit the bodies.
        """
        if isinstance(at, Displaced):
            names = getattr(at, "names", self.names)
            if names != self.names:
                raise ValueError(
                    f"`{name}` is of a mechanism with the bodies {', '.join(names)}, but "
                    f"this one has {', '.join(self.names)}, in that order."
                )
            array, origin = at.displacements, at.reference
            fits = array.shape[-2:] == origin.shape[-2:] == self.reference.shape
            if fits:  # no digit is lost if both are measured from the same poses
                more = (array.ndim - origin.ndim) * (1,)
                origin = origin.reshape(*origin.shape[:-2], *more, *self.reference.shape)
                array += origin - jnp.broadcast_to(self.reference, origin.shape)
        else:
            try:
                array = jnp.asarray(at, float)
            except (TypeError, ValueError):
                raise ValueError(
                    f"`{name}` is {shorten(repr(at))}, but must be an equilibrium, or "
                    "poses: a row (angle, x, y) for each body."
                ) from None
            fits = array.shape == self.reference.shape
            array = array - self.reference if fits else array
        if not fits or (one and array.ndim > 2):
            raise ValueError(
                f"`{name}` has shape {array.shape}, but a mechanism with the bodies "
                f"{', '.join(self.names)} has poses of shape {self.reference.shape}: a "
                "row (angle, x, y) for each body, in that order."
            )
        return array

    def coordinates(
        self, argument: str, chosen: Sequence[str] | Mapping[str, Sequence[str]]
    ) -> tuple[int, ...]:
        """Find the degrees of freedom of named coordinates.

        Args:
            argument: Name of the argument in messages.
            chosen: Names of bodies for all their coordinates; or a mapping from names to
                some of "angle", "x", and "y".

        Raises:
            ValueError: A name is unknown or occurs twice.
        """
        if isinstance(chosen, str):
            raise ValueError(
                f"`{argument}` is the string {chosen!r}, but must be a sequence of "
                f"names: [{chosen!r}]."
            )
        if not isinstance(chosen, Mapping):
            names = require_distinct(f"body in `{argument}`", chosen)
            chosen = dict.fromkeys(names, COORDINATES)
        dofs = set()
        for name, coordinates in chosen.items():
            body = self._body(f"`{argument}`", name)
            where = f"`{argument}` of the body {name!r}"
            for coordinate in coordinates:
                column = index_of(where, "coordinate", coordinate, COORDINATES)
                dofs.add(3 * body + column)
        return tuple(sorted(dofs))

    def require_support(self, constrained: Sequence[Sequence[int]] = ()) -> None:
        """Check that hinges or constraints connect every body to a fixed one.

        Args:
            constrained: Indices of the bodies of each constraint.

        Raises:
            ValueError: A body is not connected; the message names it.
        """
        fixed = {dof // 3 for dof in self.fixed}
        groups = [*self.hinge_assembly.ends, *constrained]
        if bodies := unsupported_bodies(len(self.names), fixed, groups):
            names = " and ".join(repr(self.names[body]) for body in bodies)
            raise ValueError(
                f"Nothing holds {names}: no chain of hinges or constraints leads from "
                "there to a body in `fixed`. Fix one of them, or add a hinge."
            )


def _rows(poses: Sequence[Pose]) -> Poses:
    """Stack poses; concrete ones at once, because each operation is compiled."""
    values = all_concrete(poses)
    if values is None:
        return jnp.stack(poses)
    return jnp.asarray(np.reshape(values, (-1, 3)), float)
