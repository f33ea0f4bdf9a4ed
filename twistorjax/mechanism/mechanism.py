"""Mechanisms of rigid bodies that are connected by elastic hinges."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import TypeAliasType

from .._utils.host import as_float, on_host
from .._utils.stacking import PerPart
from .._utils.types import (
    Corners,
    Displaced,
    NamedNumbers,
    NumberLike,
    Pose,
    PoseLike,
    Poses,
    PosesOrResult,
    Scalar,
    Wrench,
    Wrenches,
)
from .._utils.validation import (
    index_of,
    listing,
    PLURAL,
    quote,
    require_distinct,
    require_names,
)
from ..assembly.assembly import HingeAssembly
from ..assembly.groups import group_hinges, sums_of
from ..assembly.kinematics import Misfit
from ..energies.base import range_message
from ..geometry import se2
from .body import Body
from .copies import (
    BodyLike,
    check_energies,
    copies_of,
    distinct_names,
    frames_and_misfits,
    HingeLike,
    indices_of_ends,
    joined,
    per_part,
)
from .hinge import AbstractOutline, Hinge
from .material import Expansion
from .misfits import (
    expanded,
    HingeState,
    require_same_misfits,
    stroke_rows,
    Temperature,
)
from .placement import warn_if_misplaced


COORDINATES = ("angle", "x", "y")


# Function of the hinges and of the displacements of the bodies; rad, m, m
HingeFunction = TypeAliasType("HingeFunction", Callable[[HingeAssembly, Poses], Any])


class Mechanism(eqx.Module):
    """A mechanism of rigid bodies that are connected by elastic hinges.

    Some of the bodies are fixed. Arrays have a row for each body, in the order in which
    the bodies are given. The degrees of freedom are numbered in the same order, three for
    each body.

    Args:
        bodies: The bodies in the reference configuration, in which no hinge is loaded
            unless it has a misfit.
        hinges: The hinges between them.
        fixed: Names of the bodies that cannot move; or a mapping from names of bodies to
            the names of the coordinates that cannot move: any of "angle", "x", and "y".

    Raises:
        ValueError: A name is unknown or occurs twice, the two ports of a hinge do not
            coincide in the reference configuration and the hinge has no misfit, or the
            energy of a hinge is invalid.

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
    masses: PerPart[Scalar]
    inertias: PerPart[Scalar]
    outlines: PerPart[Corners]
    expansions: PerPart[Scalar]
    thermal_strains: Float[Array, " bodies"] | None
    tilt_inertias: PerPart[Float[Array, "2 2"]]
    at: Float[Array, "hinges 3"]
    hinge_outlines: PerPart[Corners | AbstractOutline]
    hinge_expansions: PerPart[Expansion]
    hinge_assembly: HingeAssembly

    def __init__(
        self,
        bodies: Sequence[BodyLike],
        hinges: Sequence[HingeLike],
        fixed: Sequence[str] | Mapping[str, Sequence[str]] = (),
    ):
        body_copies = copies_of("bodies", bodies, Body)
        hinge_copies = copies_of("hinges", hinges, Hinge)
        self.names = distinct_names("body", body_copies)
        self.hinge_names = distinct_names("hinge", hinge_copies)
        if not hinge_copies:
            raise ValueError("`hinges` is empty, but a mechanism needs at least one.")
        ends = indices_of_ends(hinge_copies, self.names)
        check_energies(hinge_copies)
        self.reference = joined([body.rows("pose") for body in body_copies])
        self.at, misfits = frames_and_misfits(hinge_copies, ends, self.reference)
        self.masses = per_part("mass", body_copies)
        self.inertias = per_part("inertia", body_copies)
        self.outlines = per_part("outline", body_copies)
        self.expansions = per_part("expansion", body_copies)
        self.thermal_strains = None
        self.tilt_inertias = per_part("tilt_inertia", body_copies)
        self.hinge_outlines = per_part("outline", hinge_copies)
        self.hinge_expansions = per_part("expansion", hinge_copies)
        self.fixed = self.dofs_of("fixed", fixed)
        warn_if_misplaced(hinge_copies, body_copies, ends, self.at)
        xp, (at, reference) = on_host(self.at, self.reference)
        origins = reference[np.array(ends, int).reshape(-1, 2), 1:]
        energies = [copies.values("energy", "damping") for copies in hinge_copies]
        self.hinge_assembly = HingeAssembly(
            bodies=len(self.names),
            ends=ends,
            arms=as_float(at[:, None, 1:] - origins),
            directions=as_float(xp.stack([xp.cos(at[:, 0]), xp.sin(at[:, 0])], axis=1)),
            misfits=misfits,
            groups=group_hinges(energies),
            sums=sums_of(energies),
        )

    def with_strokes(self, strokes: Mapping[str, PoseLike]) -> "Mechanism":
        """Return the mechanism with strokes of actuators.

        A stroke is a displacement by which the state is displaced in which a hinge is not
        loaded. To strokes and misfits that the hinge already has, the angle and the
        translation in the mid-frame are added, so that the order does not matter.

        Args:
            strokes: A mapping from names of hinges to displacements (angle, x, y) of
                frame b relative to frame a; rad, m, m.

        Returns:
            The mechanism.

        Raises:
            ValueError: There is no hinge of a name, or a shape is wrong.

        Example:
            >>> from twistorjax import Body, equilibrium, Hinge, Quadratic
            >>> actuator = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0])))
            >>> hinge = Hinge("actuator", "wall", "block", actuator, at=(0, 0, 0))
            >>> bodies = [Body("wall"), Body("block")]
            >>> mechanism = Mechanism(bodies, [hinge], fixed=["wall"])
            >>> moved = equilibrium(mechanism.with_strokes({"actuator": (0, 1e-3, 0)}))
            >>> moved.displacement("block")[1]
            Array(0.001, dtype=float64)
        """
        rows = stroke_rows(self.hinge_names, strokes)
        return self.with_hinges(self.hinge_assembly.with_strokes(rows))

    def at_temperature(
        self,
        change: NumberLike,
        *,
        bodies: NamedNumbers = MappingProxyType({}),
        hinges: NamedNumbers = MappingProxyType({}),
        gradients: NamedNumbers = MappingProxyType({}),
    ) -> "Mechanism":
        """Return the mechanism at another temperature.

        Bodies expand about the origins of their frames, with the points of pins and
        sliders on them, but without those of loads and ports. Hinges with an `expansion`
        become longer, which changes their misfits, and get a natural curvature by a
        gradient of the temperature. The stiffness of leaves, notches, and surrogates is
        that of their new dimensions, so that a mechanism of one material at one
        temperature is only scaled. Moduli of materials, energies that are not those of
        flexures, such as a `Quadratic` without `flexure=True`, and misfits that the
        hinges already have, do not change.

        Args:
            change: Change of the temperature; K.
            bodies: Changes of single bodies, by name, instead of `change`; K.
            hinges: Changes of single hinges, by name, instead of `change`; K.
            gradients: Gradients of the temperature along axis 2 of hinges, by name; K/m.

        Returns:
            The mechanism.

        Raises:
            ValueError: A name is unknown, a value is not finite, a hinge with a
                temperature has no `expansion`, or a body or a hinge would expand or
                shrink by more than half of its size.

        Source:
            A hinge of length L becomes longer by `expansion * change * L`. Its natural
            curvature is `-expansion * gradient`. A prismatic leaf, straight or curved,
            then has the additional energy `E I expansion gradient angle`, for any
            displacement: clamped at both ends it has the moment `E I expansion gradient`
            and no force, and if it is free it bends to an arc. For a notch or another
            flexure of variable section, moment and force are exact to first order.
        """
        warm, at, strains = expanded(
            self.hinge_assembly,
            self.at,
            dict(zip(self.names, self.expansions, strict=True)),
            dict(zip(self.hinge_names, self.hinge_expansions, strict=True)),
            Temperature(change, bodies, hinges, gradients),
        )
        if self.thermal_strains is not None:
            strains = (1 + self.thermal_strains) * (1 + strains) - 1
        return eqx.tree_at(
            lambda new: (new.at, new.thermal_strains),
            self.with_hinges(warm),
            (at, strains),
            is_leaf=lambda leaf: leaf is None,
        )

    def hinges_in(self, state: HingeState) -> HingeAssembly:
        """Return the hinges with the strokes and the temperatures of a state."""
        mechanism = self
        if state.temperature is not None:
            change, bodies, hinges, gradients = state.temperature
            mechanism = self.at_temperature(
                change, bodies=bodies, hinges=hinges, gradients=gradients
            )
        hinges = mechanism.hinge_assembly
        return hinges if state.strokes is None else hinges.with_strokes(state.strokes)

    def with_hinges(self, hinges: HingeAssembly) -> "Mechanism":
        """Replace the hinges of the mechanism."""
        return eqx.tree_at(lambda new: new.hinge_assembly, self, hinges)

    def index(self, name: str) -> int:
        """Return the row of a body in arrays of poses and wrenches.

        Args:
            name: Name of the body.

        Returns:
            Index of its row.

        Raises:
            ValueError: There is no body of this name.
        """
        return index_of("`name`", "body", name, self.names)

    def is_fixed(self, body: int) -> bool:
        """Decide whether no coordinate of a body can move, by its index."""
        return body in fixed_bodies(self.fixed)

    def energy(self, poses: Poses) -> Scalar:
        """Compute the energy that is stored in all hinges.

        Args:
            poses: Poses of the bodies; rad, m, m.

        Returns:
            The energy; J.
        """
        return self.hinge_assembly.energy(self.displacements(poses))

    def wrenches(self, poses: Poses) -> Wrenches:
        """Compute the wrench of the hinges on each body.

        Args:
            poses: Poses of the bodies; rad, m, m.

        Returns:
            The wrenches about the origins of the bodies, in world axes; N m, N, N.
        """
        return -self.hinge_assembly.forces(self.displacements(poses))

    def stiffness(self, poses: Poses) -> Float[Array, "bodies 3 bodies 3"]:
        """Compute the second derivative of the energy with respect to the poses.

        Args:
            poses: Poses of the bodies; rad, m, m.

        Returns:
            Stiffness matrix with three rows and columns (angle, x, y) for each body; N
            m/rad, N/rad, N/m.
        """
        all_dofs = tuple(range(3 * len(self.names)))
        displacements = self.displacements(poses)
        tangent = self.hinge_assembly.tangent(displacements)
        matrix = tangent.matrix(all_dofs, all_dofs)
        return matrix.reshape(2 * (len(self.names), 3))

    def inertia(self) -> Wrenches:
        """Return the diagonal of the inertia matrix.

        Returns:
            Moment of inertia, mass, and mass again of each body; infinite for fixed
            bodies; kg m^2, kg, kg.

        Raises:
            ValueError: A body that can move has no mass or no inertia.
        """
        fixed = np.zeros(len(self.names), bool)
        fixed[list(fixed_bodies(self.fixed))] = True
        columns = {"mass": self.masses, "inertia": self.inertias}
        missing = {name: ~fixed & values.is_none() for name, values in columns.items()}
        if np.any(lacking := missing["mass"] | missing["inertia"]):
            body = int(np.argmax(lacking))
            fields = [f"`{name}`" for name, rows in missing.items() if rows[body]]
            raise ValueError(
                f"The body {self.names[body]!r} can move, but has no "
                f"{' and no '.join(fields)}. Give it `mass` and `inertia`, or fix the "
                "body. The origin of its frame must be its center of mass."
            )
        mass, inertia = (values.numbers(np.inf) for values in columns.values())
        xp, (mass, inertia) = on_host(mass, inertia)
        rows = xp.stack([inertia, mass, mass], axis=1)
        return as_float(xp.where(fixed[:, None], np.inf, rows))

    def dof_name(self, dof: int) -> str:
        """Return the name of a degree of freedom, such as "angle of 'stage'"."""
        return f"{COORDINATES[dof % 3]} of {self.names[dof // 3]!r}"

    def __repr__(self) -> str:
        def listed(noun: str, names: Sequence[str]) -> str:
            shown = names if len(names) <= 12 else (*names[:10], "...", names[-1])
            word = noun if len(names) == 1 else PLURAL[noun]
            return f"{len(names)} {word} ({', '.join(shown)})"

        fixed = []
        for body, name in enumerate(self.names):
            axes = [COORDINATES[k] for k in range(3) if 3 * body + k in self.fixed]
            if axes:
                whole = len(axes) == 3
                fixed.append(name if whole else f"{' and '.join(axes)} of {name}")
        return (
            f"Mechanism of {listed('body', self.names)}, "
            f"{listed('hinge', self.hinge_names)}; fixed: {', '.join(fixed) or 'nothing'}"
        )

    def displacements(
        self, at: PosesOrResult, name: str = "poses", *, single: bool = False
    ) -> Float[Array, "*batch bodies 3"]:
        """Compute the displacements of the bodies from their reference poses.

        Args:
            at: Equilibrium or motion of this mechanism, or poses of its bodies; rad, m,
                m.
            name: Name of the argument in messages.
            single: If True, a motion or a batch is rejected.

        Returns:
            One row for each body; rad, m, m.

        Raises:
            ValueError: `at` is neither a solution nor poses, or its shape does not match
                the bodies.
        """
        if isinstance(at, Displaced) and not isinstance(at, Mechanism):
            names = getattr(at, "names", self.names)
            if names != self.names:
                raise ValueError(
                    f"`{name}` is of a mechanism with the bodies {', '.join(names)}, but "
                    f"this mechanism has {', '.join(self.names)}, in this order."
                )
            array, origin = at.displacements, at.reference
            fits = array.shape[-2:] == origin.shape[-2:] == self.reference.shape
            if fits:  # no digit is lost if both are measured from the same poses
                new_axes = (array.ndim - origin.ndim) * (1,)
                shape = (*origin.shape[:-2], *new_axes, *self.reference.shape)
                xp, values = on_host(array, origin, self.reference)
                array, origin, reference = values
                array = array + (
                    origin.reshape(shape) - xp.broadcast_to(reference, shape)
                )
        else:
            try:
                array = jnp.asarray(at, float)
            except (TypeError, ValueError):
                raise ValueError(
                    f"`{name}` is {quote(at)}, but must be an equilibrium or "
                    "poses, a row (angle, x, y) for each body."
                ) from None
            fits = array.shape == self.reference.shape
            _, (array, reference) = on_host(array, self.reference)
            array = array - reference if fits else array
        if not fits or (single and array.ndim > 2):
            raise ValueError(
                f"`{name}` has shape {array.shape}, but a mechanism with the bodies "
                f"{', '.join(self.names)} has poses of shape {self.reference.shape}: a "
                "row (angle, x, y) for each body, in this order."
                f"{' Give one of its `poses`.' if fits else ''}"
            )
        return jax.device_put(array) if isinstance(array, np.ndarray) else array

    def displacement_of(self, hinge: str, at: PosesOrResult) -> Float[Array, "*batch 3"]:
        """Compute the displacement of frame b of a hinge relative to its frame a.

        Args:
            hinge: Name of the hinge.
            at: Equilibrium, motion, or poses of the bodies; rad, m, m. Prefer an
                equilibrium or a motion: poses lose the digits of displacements that are
                small compared with the positions.

        Returns:
            Angle, and translation along axes 1 and 2 of frame a; for a motion, one row
            for each time; rad, m, m.

        Raises:
            ValueError: There is no hinge of this name, or the poses are not those of the
                bodies.
        """
        row = index_of("`hinge`", "hinge", hinge, self.hinge_names)

        def pose(hinges: HingeAssembly, displacements: Poses) -> Pose:
            return _hinge_pose(hinges, row, displacements)

        return self.of_hinges(at, pose)

    def wrench_of(self, hinge: str, at: PosesOrResult) -> Float[Array, "*batch 3"]:
        """Compute the wrench that body B exerts on a hinge, about frame b, in its axes.

        Args:
            hinge: Name of the hinge.
            at: Equilibrium, motion, or poses of the bodies; rad, m, m. Prefer an
                equilibrium or a motion: poses lose the digits of displacements that are
                small compared with the positions.

        Returns:
            Moment, and force along axes 1 and 2 of frame b, which are the axial and the
            transverse force of a leaf or a notch; for a motion, one row for each time;
            N m, N, N.

        Raises:
            ValueError: There is no hinge of this name, the poses are not those of the
                bodies, or the hinge is outside the validity range of its energy.
        """
        row = index_of("`hinge`", "hinge", hinge, self.hinge_names)

        def about_frame_b(hinges: HingeAssembly, displacements: Poses) -> Wrench:
            wrench = hinges.bent_energy_of(row).wrench
            misfits = hinges.misfits
            if misfits is None:
                return wrench(_hinge_pose(hinges, row, displacements))
            # The energy belongs to frame b displaced by half the inverse misfit.
            misfit = Misfit.of(misfits[row])
            x, y = -misfit.e1 - misfit.f2, -misfit.e2 + misfit.f1
            frame = jnp.stack([-misfit.angle, x, y]) / 2
            pose = _hinge_pose(hinges, row, displacements, of_frames=False)
            return se2.transform_wrench(frame, wrench(pose))

        return self.of_hinges(at, about_frame_b)

    def energy_of(self, hinge: str, at: PosesOrResult) -> Float[Array, "*batch"]:
        """Compute the energy that is stored in a hinge.

        Args:
            hinge: Name of the hinge.
            at: Equilibrium, motion, or poses of the bodies; rad, m, m.

        Returns:
            The energy; for a motion, one for each time; J.

        Raises:
            ValueError: There is no hinge of this name, the poses are not those of the
                bodies, or the hinge is outside the validity range of its energy.
        """
        row = index_of("`hinge`", "hinge", hinge, self.hinge_names)

        def stored(hinges: HingeAssembly, displacements: Poses) -> Scalar:
            energy = hinges.bent_energy_of(row)
            return energy(_hinge_pose(hinges, row, displacements, of_frames=False))

        return self.of_hinges(at, stored)

    def misfit_of(self, hinge: str) -> Pose | None:
        """Return the displacement at which a hinge is not loaded.

        Args:
            hinge: Name of the hinge.

        Returns:
            Displacement (angle, x, y) of frame b relative to frame a, without the bending
            by a gradient of the temperature; None if no hinge of the mechanism has a
            misfit; rad, m, m.

        Raises:
            ValueError: There is no hinge of this name.
        """
        row = index_of("`hinge`", "hinge", hinge, self.hinge_names)
        misfits = self.hinge_assembly.misfits
        if misfits is None:
            return None
        xp, (numbers,) = on_host(misfits[row])
        angle, d1, d2, gap1, gap2, _ = numbers
        cos, sin = xp.cos(angle / 2), xp.sin(angle / 2)
        y1, y2 = d1 - cos * gap1, d2 - cos * gap2
        return as_float(xp.stack([angle, cos * y1 - sin * y2, cos * y2 + sin * y1]))

    def of_hinges(self, at: PosesOrResult, function: HingeFunction) -> Any:
        """Evaluate a function of the hinges at a solution, or at each one of a batch.

        The hinges have the strokes and the temperatures of the solution.

        Args:
            at: Equilibrium, motion, or poses of the bodies; rad, m, m.
            function: Function of the hinges and the displacements of the bodies; rad, m,
                m.

        Returns:
            Its array or its arrays, with the axes of the batch in front.

        Raises:
            ValueError: The equilibrium is that of a mechanism with other strokes or other
                misfits.
        """
        displacements = self.displacements(at, "at")
        require_same_misfits(self.hinge_assembly.misfits, at)
        batch = displacements.shape[:-2]
        flat = displacements.reshape(-1, *self.reference.shape)
        state = HingeState.of_solution(at, batch)

        def evaluate(displacements: Poses, state: HingeState) -> Any:
            return function(self.hinges_in(state), displacements)

        # One state is not traced, so that a value out of range raises an error.
        if len(flat) == 1:
            single = jax.tree.map(lambda values: values[0], state)
            values = evaluate(flat[0], single)
            if not batch:
                return values
            values = jax.tree.map(lambda array: array[None], values)
        else:
            values = jax.vmap(evaluate)(flat, state)
        return jax.tree.map(lambda array: array.reshape(*batch, *array.shape[1:]), values)

    def ports(self, hinge: str, poses: Poses) -> tuple[Pose, Pose]:
        """Compute the poses of the two frames of a hinge in the world.

        Args:
            hinge: Name of the hinge.
            poses: Poses of the bodies; rad, m, m.

        Returns:
            Poses of frame a on body A and of frame b on body B; rad, m, m.

        Raises:
            ValueError: There is no hinge of this name.
        """
        row = index_of("`hinge`", "hinge", hinge, self.hinge_names)
        first, second = (
            se2.compose(poses[body], se2.between(self.reference[body], self.at[row]))
            for body in self.hinge_assembly.ends[row]
        )
        return first, second

    def range_messages(self, poses: Poses) -> str:
        """Describe the hinges whose displacement is outside their validity range.

        Args:
            poses: Poses of the bodies; rad, m, m.

        Returns:
            The displacement and the range of the first one, and the names of the others.
        """
        hinges, displacements = self.hinge_assembly, self.displacements(poses)
        outside = np.flatnonzero(np.asarray(hinges.out_of_range(displacements)))
        if not len(outside):
            return ""
        first, *others = map(int, outside)
        at = hinges.displacement_of(first, displacements)
        message = range_message(hinges.energy_of(first), at)
        text = f"The hinge {self.hinge_names[first]!r}: {message}."
        names = listing(self.hinge_names[row] for row in others)
        return f"{text} Others outside of their ranges: {names}." if others else text

    def dofs_of(
        self, argument: str, chosen: Sequence[str] | Mapping[str, Sequence[str]]
    ) -> tuple[int, ...]:
        """Find the degrees of freedom of named coordinates.

        Args:
            argument: Name of the argument in messages.
            chosen: Names of bodies for all their coordinates; or a mapping from names to
                some of "angle", "x", and "y".

        Returns:
            Indices of the degrees of freedom in ascending order, three for each body.

        Raises:
            ValueError: A name is unknown or occurs twice.
        """
        require_names(f"`{argument}`", chosen)
        if not isinstance(chosen, Iterable):
            raise ValueError(
                f"`{argument}` is {quote(chosen)}, but must be a list of names "
                "of bodies, or a mapping from names to some of 'angle', 'x', 'y'."
            )
        if not isinstance(chosen, Mapping):
            names = require_distinct(f"body in `{argument}`", chosen)
            chosen = dict.fromkeys(names, COORDINATES)
        dofs = set()
        for body_name, coordinates in chosen.items():
            body = index_of(f"`{argument}`", "body", body_name, self.names)
            where = f"`{argument}` of the body {body_name!r}"
            if isinstance(coordinates, str) or not isinstance(coordinates, Iterable):
                raise ValueError(
                    f"{where} is {quote(coordinates)}, but must be a list of "
                    "some of 'angle', 'x', 'y', such as ['x', 'y']."
                )
            for name in coordinates:
                dofs.add(3 * body + index_of(where, "coordinate", name, COORDINATES))
        return tuple(sorted(dofs))


@lru_cache(maxsize=256)
def fixed_bodies(fixed: tuple[int, ...]) -> frozenset[int]:
    """Return the indices of the bodies of which all coordinates are fixed."""
    dofs = set(fixed)
    bodies = {dof // 3 for dof in fixed}
    return frozenset(
        body for body in bodies if {3 * body, 3 * body + 1, 3 * body + 2} <= dofs
    )


def _hinge_pose(
    hinges: HingeAssembly, row: int, displacements: Poses, of_frames: bool = True
) -> Pose:
    """Compute the displacement of a hinge, of its frames or with its misfit."""
    return hinges.displacement_of(row, displacements, of_frames).pose()
