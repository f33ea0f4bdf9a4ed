"""Bodies and hinges together."""

from collections.abc import Callable, Iterable, Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import (
    Corners,
    Displaced,
    Pose,
    Poses,
    PosesLike,
    Scalar,
    Wrench,
    Wrenches,
)
from .._utils.validation import all_concrete, index_of, PLURAL, require_kind, shorten
from ..geometry import se2
from .body import Body
from .hinge import check_energy, frame_of, Hinge
from .hinge_assembly import HingeAssembly
from .hinge_groups import group_hinges, sums_of


COORDINATES = ("angle", "x", "y")


class Mechanism(eqx.Module):
    """Rigid bodies joined by elastic hinges, some of them held.

    Arrays have a row for each body, in the order in which the bodies were given.

    Args:
        bodies: at rest, where no hinge is loaded.
        hinges: between them.
        fixed: names of the bodies that cannot move; or, for bodies that cannot move in
            some of their coordinates, a mapping from the name to those, of "angle", "x"
            and "y".

    Raises:
        ValueError: a name is unknown or doubled; the two ports of a hinge do not
            coincide at rest; a hinge's stiffness is not symmetric, has a negative
            eigenvalue or is not finite; or nothing holds a body.

    Example:
        >>> from twistorjax import Body, Hinge, Quadratic
        >>> spring = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0])))
        >>> wall, block = Body("wall"), Body("block")
        >>> Mechanism([wall, block], [Hinge("spring", "wall", "block", spring,
        ...                                 at=(0, 0.1, 0))], fixed=["wall"])
        Mechanism of 2 bodies (wall, block), 1 hinge (spring); fixed: wall
    """

    names: tuple[str, ...] = eqx.field(static=True)
    hinge_names: tuple[str, ...] = eqx.field(static=True)
    fixed: tuple[int, ...] = eqx.field(static=True)
    unstable: tuple[str, ...] = eqx.field(static=True)
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
        self.names = _distinct("body", [body.name for body in bodies])
        self.hinge_names = _distinct("hinge", [hinge.name for hinge in hinges])
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
        at = [
            frame_of(hinge, bodies[first].pose, bodies[second].pose)
            for hinge, (first, second) in zip(hinges, ends, strict=True)
        ]
        self.at = _rows(at)
        self.fixed = self.coordinates("fixed", fixed)
        self.unstable = self._unsupported(ends)
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
        """The row of a body in arrays of poses and wrenches.

        Raises:
            ValueError: the mechanism has no body of that name.
        """
        return self._body("`name`", name)

    def energy(self, poses: Poses) -> Scalar:
        """What all hinges store; J.

        Args:
            poses: of the bodies; rad, m, m.
        """
        return self.hinge_assembly.energy(self.displacements(poses))

    def wrenches(self, poses: Poses) -> Wrenches:
        """What the hinges apply to each body, at its origin, in world axes; N m, N, N.

        Args:
            poses: of the bodies; rad, m, m.
        """
        return -self.hinge_assembly.forces(self.displacements(poses))

    def stiffness(self, poses: Poses) -> Float[Array, "bodies 3 bodies 3"]:
        """Second derivative of the energy by the poses; N m/rad, N/rad, N/m.

        Args:
            poses: of the bodies; rad, m, m.
        """
        every = tuple(range(3 * len(self.names)))
        _, matrix, _ = self.hinge_assembly.tangent(
            self.displacements(poses), every, every
        )
        return matrix.reshape(2 * (len(self.names), 3))

    def inertia(self) -> Wrenches:
        """Inertia, mass and mass of each body; infinite for bodies held altogether.

        Raises:
            ValueError: a body that can move has no mass or no inertia.
        """
        rows = []
        for body, name in enumerate(self.names):
            mass, inertia = self.masses[body], self.inertias[body]
            if {3 * body, 3 * body + 1, 3 * body + 2} <= set(self.fixed):
                rows.append(jnp.full(3, jnp.inf))
            elif mass is None or inertia is None:
                lacks = "mass" if mass is None else "inertia"
                raise ValueError(
                    f"The body {name!r} moves, but has no `{lacks}`: give it one, or "
                    "hold it."
                )
            else:
                rows.append(jnp.stack([inertia, mass, mass]))
        return jnp.stack(rows)

    def range_messages(self, poses: Poses) -> str:
        """Which hinges are displaced beyond the range of their energies, in words.

        Args:
            poses: of the bodies; rad, m, m.
        """
        beyond = np.asarray(self.hinge_assembly.out_of_range(self.displacements(poses)))
        words = []
        for row in map(int, np.flatnonzero(beyond)):
            name, energy = self.hinge_names[row], self.hinge_assembly.energy_of(row)
            at = self.hinge_assembly.displacement_of(row, self.displacements(poses))
            words.append(f"The hinge {name!r}: {energy.range_message(at)}.")
        return " ".join(words)

    def displacement_of(
        self, hinge: str, at: Poses | Displaced
    ) -> Float[Array, "*batch 3"]:
        """The displacement of a hinge: its frame b, seen from its frame a; rad, m, m.

        Args:
            hinge: Name of the hinge.
            at: Equilibrium or motion. Or poses of the bodies, which have lost the digits
                of displacements that are small against positions; rad, m, m.

        Returns:
            Angle, and translation along axes 1 and 2 of frame a. Of a motion a row for
            each time; rad, m, m.

        Raises:
            ValueError: The mechanism has no hinge of that name, or the poses are not
                those of its bodies.
        """
        row = index_of("`hinge`", "hinge", hinge, self.hinge_names)
        return self._of_hinge(at, lambda moved: self._displaced(row, moved))

    def wrench_of(self, hinge: str, at: Poses | Displaced) -> Float[Array, "*batch 3"]:
        """The wrench that body B exerts on a hinge, about frame b, in its axes.

        Args:
            hinge: Name of the hinge.
            at: Equilibrium or motion. Or poses of the bodies, which have lost the digits
                of displacements that are small against positions; rad, m, m.

        Returns:
            Moment, and force along axes 1 and 2 of frame b: axial and transverse for a
            leaf or a notch. Of a motion a row for each time; N m, N, N.

        Raises:
            ValueError: The mechanism has no hinge of that name, the poses are not those
                of its bodies, or the hinge is beyond the range of its energy.
        """
        row = index_of("`hinge`", "hinge", hinge, self.hinge_names)
        energy = self.hinge_assembly.energy_of(row)

        def wrench(moved: Poses) -> Wrench:
            return energy.wrench(self._displaced(row, moved))

        return self._of_hinge(at, wrench)

    def _displaced(self, row: int, displacements: Poses) -> Pose:
        """Frame b of a hinge, seen from its frame a; rad, m, m."""
        at = self.hinge_assembly.displacement_of(row, displacements)
        x, y = at.sigma * at.x1 - at.xi * at.x2, at.sigma * at.x2 + at.xi * at.x1
        return jnp.stack([at.angle, 2 * x, 2 * y])

    def _of_hinge(
        self, at: Poses | Displaced, function: Callable[[Poses], Float[Array, "3"]]
    ) -> Float[Array, "*batch 3"]:
        """A function of displacements, for each of a batch of them."""
        moved = self.displacements(at, "at")
        flat = moved.reshape(-1, *self.reference.shape)
        if len(flat) == 1:  # so that a value out of range can be seen
            return function(flat[0]).reshape(*moved.shape[:-2], 3)
        return jax.vmap(function)(flat).reshape(*moved.shape[:-2], 3)

    def ports(self, hinge: str, poses: Poses) -> tuple[Pose, Pose]:
        """Where the two frames of a hinge stand, in the world; rad, m, m.

        Args:
            hinge: its name.
            poses: of the bodies; rad, m, m.

        Raises:
            ValueError: the mechanism has no hinge of that name.
        """
        row = index_of("`hinge`", "hinge", hinge, self.hinge_names)
        first, second = (
            se2.compose(poses[body], se2.between(self.reference[body], self.at[row]))
            for body in self.hinge_assembly.ends[row]
        )
        return first, second

    def coordinate(self, place: int) -> str:
        """What the coordinate at a place is called, of three a body in order."""
        return f"{COORDINATES[place % 3]} of {self.names[place // 3]!r}"

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
        for body, name in enumerate(self.names):
            fixed = [COORDINATES[k] for k in range(3) if 3 * body + k in self.fixed]
            if fixed:
                yield name if len(fixed) == 3 else f"{' and '.join(fixed)} of {name}"

    def _body(self, where: str, name: str) -> int:
        return index_of(where, "body", name, self.names)

    def displacements(
        self, at: PosesLike | Displaced, name: str = "poses", *, one: bool = False
    ) -> Float[Array, "*batch bodies 3"]:
        """How far the bodies have moved from rest; rad, m, m.

        Args:
            at: Equilibrium or motion of this mechanism, or poses of its bodies; rad, m,
                m.
            name: What messages call it.
            one: Whether a motion or a batch is refused.

        Raises:
            ValueError: It is no such thing, or its shape does not fit the bodies.
        """
        if isinstance(at, Displaced):
            names = getattr(at, "names", self.names)
            if names != self.names:
                raise ValueError(
                    f"`{name}` is of a mechanism with the bodies {', '.join(names)}, but "
                    f"this one has {', '.join(self.names)}, in that order."
                )
            array, reference = at.displacements, at.reference
            fits = array.shape[-2:] == reference.shape[-2:] == self.reference.shape
            if fits:  # no digit is lost where both count from the same poses
                more = (array.ndim - reference.ndim) * (1,)
                reference = reference.reshape(
                    *reference.shape[:-2], *more, *self.reference.shape
                )
                array = array + (
                    reference - jnp.broadcast_to(self.reference, reference.shape)
                )
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
                f"{', '.join(self.names)} has poses of shape {self.reference.shape}: a row "
                "(angle, x, y) for each body, in that order."
            )
        return array

    def coordinates(
        self, argument: str, chosen: Sequence[str] | Mapping[str, Sequence[str]]
    ) -> tuple[int, ...]:
        """The places of some bodies' coordinates, of three a body in order.

        Args:
            argument: what messages call the choice.
            chosen: names of bodies, for all their coordinates; or a mapping from names to
                some of "angle", "x" and "y".

        Raises:
            ValueError: a name is unknown or given twice.
        """
        if isinstance(chosen, str):
            raise ValueError(
                f"`{argument}` is the string {chosen!r}, but must be a sequence of "
                f"names: [{chosen!r}]."
            )
        if not isinstance(chosen, Mapping):
            names = _distinct(f"body in `{argument}`", chosen)
            chosen = dict.fromkeys(names, COORDINATES)
        places = set()
        for name, coordinates in chosen.items():
            body = self._body(f"`{argument}`", name)
            where = f"`{argument}` of the body {name!r}"
            for coordinate in coordinates:
                row = index_of(where, "coordinate", coordinate, COORDINATES)
                places.add(3 * body + row)
        return tuple(sorted(places))

    def _unsupported(self, ends: Sequence[tuple[int, int]]) -> tuple[str, ...]:
        """The bodies from which no chain of hinges leads to one that is held."""
        reached = {place // 3 for place in self.fixed}
        joined: dict[int, list[int]] = {}
        for first, second in ends:
            joined.setdefault(first, []).append(second)
            joined.setdefault(second, []).append(first)
        front = list(reached)
        while front:
            fresh = set(joined.get(front.pop(), ())) - reached
            reached |= fresh
            front.extend(fresh)
        return tuple(name for k, name in enumerate(self.names) if k not in reached)

    def require_support(self) -> None:
        """Refuses what cannot rest: a body that no chain of hinges ties to a held one.

        Raises:
            ValueError: there is one; the text names it.
        """
        if self.unstable:
            raise ValueError(
                f"Nothing holds {' and '.join(map(repr, self.unstable))}: no chain of "
                "hinges leads from there to a body in `fixed`. Hold one of them, or add a "
                "hinge. (In motion, pins and sliders may hold it: `simulate`.)"
            )


def _distinct(noun: str, names: Sequence[str]) -> tuple[str, ...]:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ValueError(f"The {noun} {name!r} is given twice; names must differ.")
        seen.add(name)
    return tuple(names)


def _rows(poses: Sequence[Pose]) -> Poses:
    values = all_concrete(poses)
    if values is None:
        return jnp.stack(poses)
    return jnp.asarray(np.reshape(values, (-1, 3)), float)
