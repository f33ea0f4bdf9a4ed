"""Bodies and hinges together."""

from collections.abc import Iterable, Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from . import se2
from ._checks import all_known, find, kinds, known, PLURAL
from ._types import Corners, Pose, Poses, PosesLike, Scalar, Wrench, Wrenches
from .body import Body
from .clifford import Displacement
from .couplings import Couplings, stack_hinges, sums_of
from .hinge import Hinge


COORDINATES = ("angle", "x", "y")


class Mechanism(eqx.Module):
    """Rigid bodies joined by elastic hinges, some of them held.

    Arrays have a row for each body, in the order in which the bodies were given.

    Args:
        bodies: at rest, where no hinge is loaded.
        hinges: between them.
        held: names of the bodies that cannot move; or, for bodies that cannot move in
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
        ...                                 at=(0, 0.1, 0))], held=["wall"])
        Mechanism of 2 bodies (wall, block), 1 hinge (spring); held: wall
    """

    names: tuple[str, ...] = eqx.field(static=True)
    hinge_names: tuple[str, ...] = eqx.field(static=True)
    held: tuple[int, ...] = eqx.field(static=True)
    loose: tuple[str, ...] = eqx.field(static=True)
    rest: Poses
    masses: tuple[Scalar | None, ...]
    inertias: tuple[Scalar | None, ...]
    outlines: tuple[Corners | None, ...]
    at: Float[Array, "hinges 3"]
    hinge_outlines: tuple[Corners | None, ...]
    couplings: Couplings

    def __init__(
        self,
        bodies: Sequence[Body],
        hinges: Sequence[Hinge],
        held: Sequence[str] | Mapping[str, Sequence[str]] = (),
    ):
        kinds("bodies", bodies, Body)
        kinds("hinges", hinges, Hinge)
        self.names = _distinct("body", [body.name for body in bodies])
        self.hinge_names = _distinct("hinge", [hinge.name for hinge in hinges])
        self.rest = _rows([body.rest for body in bodies])
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
            _check_energy(hinge)
        at = [
            _place(hinge, bodies[first].rest, bodies[second].rest)
            for hinge, (first, second) in zip(hinges, ends, strict=True)
        ]
        self.at = _rows(at)
        self.held = self.coordinates("held", held)
        self.loose = self._unsupported(ends)
        pairs = np.array(ends, int).reshape(-1, 2)
        self.couplings = Couplings(
            bodies=len(bodies),
            ends=ends,
            arms=self.at[:, None, 1:] - self.rest[pairs, 1:],
            axes=jnp.stack([jnp.cos(self.at[:, 0]), jnp.sin(self.at[:, 0])], axis=1),
            stacks=stack_hinges(hinges),
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
        return self.couplings.energy(self._displacements(poses))

    def wrenches(self, poses: Poses) -> Wrenches:
        """What the hinges apply to each body, at its origin, in world axes; N m, N, N.

        Args:
            poses: of the bodies; rad, m, m.
        """
        return -self.couplings.forces(self._displacements(poses))

    def stiffness(self, poses: Poses) -> Float[Array, "bodies 3 bodies 3"]:
        """Second derivative of the energy by the poses; N m/rad, N/rad, N/m.

        Args:
            poses: of the bodies; rad, m, m.
        """
        every = tuple(range(3 * len(self.names)))
        _, matrix, _ = self.couplings.tangent(self._displacements(poses), every, every)
        return matrix.reshape(2 * (len(self.names), 3))

    def inertia(self) -> Wrenches:
        """Inertia, mass and mass of each body; infinite for bodies held altogether.

        Raises:
            ValueError: a body that can move has no mass or no inertia.
        """
        rows = []
        for body, name in enumerate(self.names):
            mass, inertia = self.masses[body], self.inertias[body]
            if {3 * body, 3 * body + 1, 3 * body + 2} <= set(self.held):
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

    def ranges_beyond(self, poses: Poses) -> str:
        """Which hinges are displaced beyond the range of their energies, in words.

        Args:
            poses: of the bodies; rad, m, m.
        """
        beyond = np.asarray(self.couplings.beyond(self._displacements(poses)))
        words = []
        for row in map(int, np.flatnonzero(beyond)):
            name, energy = self.hinge_names[row], self.couplings.energy_of(row)
            at = Displacement.of(self.displacement_of(name, poses))
            words.append(f"The hinge {name!r}: {energy.place_in_range(at)}.")
        return " ".join(words)

    def displacement_of(self, hinge: str, poses: Poses) -> Pose:
        """How far a hinge is displaced: its frame b, seen from its frame a; rad, m, m.

        Args:
            hinge: its name.
            poses: of the bodies; rad, m, m.

        Raises:
            ValueError: the mechanism has no hinge of that name.
        """
        return se2.between(*self.ports(hinge, poses))

    def wrench_of(self, hinge: str, poses: Poses) -> Wrench:
        """What a hinge bears: what body B exerts on it, about frame b, in its axes.

        Args:
            hinge: its name.
            poses: of the bodies; rad, m, m.

        Returns:
            Moment, and force along axes 1 and 2 of frame b: axial and transverse for a
            leaf or a notch; N m, N, N.

        Raises:
            ValueError: the mechanism has no hinge of that name.
        """
        row = find("`hinge`", "hinge", hinge, self.hinge_names)
        return self.couplings.energy_of(row).wrench(self.displacement_of(hinge, poses))

    def ports(self, hinge: str, poses: Poses) -> tuple[Pose, Pose]:
        """Where the two frames of a hinge stand, in the world; rad, m, m.

        Args:
            hinge: its name.
            poses: of the bodies; rad, m, m.

        Raises:
            ValueError: the mechanism has no hinge of that name.
        """
        row = find("`hinge`", "hinge", hinge, self.hinge_names)
        first, second = (
            se2.compose(poses[body], se2.between(self.rest[body], self.at[row]))
            for body in self.couplings.ends[row]
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
            f"held: {', '.join(self._held_words()) or 'nothing'}"
        )

    def _held_words(self) -> Iterable[str]:
        for body, name in enumerate(self.names):
            held = [COORDINATES[k] for k in range(3) if 3 * body + k in self.held]
            if held:
                yield name if len(held) == 3 else f"{' and '.join(held)} of {name}"

    def _body(self, where: str, name: str) -> int:
        return find(where, "body", name, self.names)

    def _displacements(self, poses: PosesLike, name: str = "poses") -> Poses:
        array = jnp.asarray(poses, float)
        if array.shape != self.rest.shape:
            raise ValueError(
                f"`{name}` has shape {array.shape}, but a mechanism with the bodies "
                f"{', '.join(self.names)} has poses of shape {self.rest.shape}: a row "
                "(angle, x, y) for each body, in that order."
            )
        return array - self.rest

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
                row = find(where, "coordinate", coordinate, COORDINATES)
                places.add(3 * body + row)
        return tuple(sorted(places))

    def _unsupported(self, ends: Sequence[tuple[int, int]]) -> tuple[str, ...]:
        """The bodies from which no chain of hinges leads to one that is held."""
        reached = {place // 3 for place in self.held}
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

    def need_support(self) -> None:
        """Refuses what cannot rest: a body that no chain of hinges ties to a held one.

        Raises:
            ValueError: there is one; the text names it.
        """
        if self.loose:
            raise ValueError(
                f"Nothing holds {' and '.join(map(repr, self.loose))}: no chain of "
                "hinges leads from there to a body in `held`. Hold one of them, or add a "
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
    values = all_known(poses)
    if values is None:
        return jnp.stack(poses)
    return jnp.asarray(np.reshape(values, (-1, 3)), float)


def _check_energy(hinge: Hinge) -> None:
    if fault := hinge.energy.fault():
        raise ValueError(
            f"The energy of the hinge {hinge.name!r} cannot be used: {fault}"
        )
    for leaf in jax.tree.leaves(hinge.energy):
        values = known(leaf)
        if values is not None and not np.all(np.isfinite(values)):
            raise ValueError(
                f"The energy of the hinge {hinge.name!r} has a value that is not finite: "
                f"{values.tolist()}."
            )


def _place(hinge: Hinge, first: Pose, second: Pose) -> Pose:
    """Where the frames of a hinge stand at rest, in the world."""
    if hinge.ports is None:
        assert hinge.at is not None
        return hinge.at
    a, b = (
        se2.compose(body, port)
        for body, port in zip((first, second), hinge.ports, strict=True)
    )
    seen = all_known([se2.between(a, b), a, b, *hinge.ports])
    if seen is not None:
        gap, *places = seen
        scale = 1e-12 + max(np.max(np.abs(place[1:])) for place in places)
        apart = np.abs(gap) > 1e-9 * np.array([1.0, scale, scale])
        if np.any(apart):
            raise ValueError(
                f"The ports of the hinge {hinge.name!r} do not coincide at rest: seen "
                f"from port a on {hinge.first!r}, port b on {hinge.second!r} is turned "
                f"by {gap[0]:.6g} rad and shifted by ({gap[1]:.6g}, {gap[2]:.6g}) m. A "
                "hinge is unstressed at rest: move a port or a body, or give `at`."
            )
    return a
