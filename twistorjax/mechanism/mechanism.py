"""Mechanisms of rigid bodies that are connected by elastic hinges."""

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.host import all_concrete, as_float, on_host
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
    Wrenches,
)
from .._utils.validation import (
    index_of,
    PLURAL,
    require_distinct,
    require_kind,
    require_same_precision,
    shorten,
)
from ..assembly.assembly import HingeAssembly
from ..assembly.groups import group_hinges, sums_of
from .body import Body
from .expansion import Expansion
from .hinge import check_energy, frame_and_misfit, Hinge
from .misfits import expanded, with_strokes
from .outline import AbstractOutline
from .placement import warn_if_misplaced
from .queries import HingeQueries


COORDINATES = ("angle", "x", "y")


class Mechanism(HingeQueries):
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
    masses: tuple[Scalar | None, ...]
    inertias: tuple[Scalar | None, ...]
    outlines: tuple[Corners | None, ...]
    expansions: tuple[Scalar | None, ...]
    at: Float[Array, "hinges 3"]
    hinge_outlines: tuple[Corners | AbstractOutline | None, ...]
    hinge_expansions: tuple[Expansion | None, ...]
    hinge_assembly: HingeAssembly

    def __init__(
        self,
        bodies: Sequence[Body],
        hinges: Sequence[Hinge],
        fixed: Sequence[str] | Mapping[str, Sequence[str]] = (),
    ):
        require_kind("bodies", bodies, Body)
        require_kind("hinges", hinges, Hinge)
        for kind, parts in (("body", bodies), ("hinge", hinges)):
            for part in parts:
                require_same_precision(f"The {kind} {part.name!r}", part)
        self.names = require_distinct("body", [body.name for body in bodies])
        self.hinge_names = require_distinct("hinge", [hinge.name for hinge in hinges])
        self.reference = _rows([body.pose for body in bodies])
        self.masses = tuple(body.mass for body in bodies)
        self.inertias = tuple(body.inertia for body in bodies)
        self.outlines = tuple(body.outline for body in bodies)
        self.expansions = tuple(body.expansion for body in bodies)
        self.hinge_outlines = tuple(hinge.outline for hinge in hinges)
        self.hinge_expansions = tuple(hinge.expansion for hinge in hinges)
        if not hinges:
            raise ValueError("`hinges` is empty, but a mechanism needs at least one.")

        def body(hinge: Hinge, end: str) -> int:
            where = f"`{end}` of the hinge {hinge.name!r}"
            return index_of(where, "body", getattr(hinge, end), self.names)

        ends = tuple((body(hinge, "first"), body(hinge, "second")) for hinge in hinges)
        for hinge in hinges:
            check_energy(hinge)
        frames, misfits = zip(
            *(
                frame_and_misfit(hinge, bodies[first].pose, bodies[second].pose)
                for hinge, (first, second) in zip(hinges, ends, strict=True)
            ),
            strict=True,
        )
        self.at = _rows(frames)
        self.fixed = self.dofs_of("fixed", fixed)
        xp, (at, reference) = on_host(self.at, self.reference)
        if (known := all_concrete([at])) is not None:
            pairs = [(bodies[first], bodies[second]) for first, second in ends]
            warn_if_misplaced(hinges, pairs, known[0])
        origins = reference[np.array(ends, int).reshape(-1, 2), 1:]
        self.hinge_assembly = HingeAssembly(
            bodies=len(bodies),
            ends=ends,
            arms=as_float(at[:, None, 1:] - origins),
            directions=as_float(xp.stack([xp.cos(at[:, 0]), xp.sin(at[:, 0])], axis=1)),
            misfits=_misfits(misfits),
            groups=group_hinges(hinges),
            sums=sums_of(hinges),
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
        return with_strokes(self, strokes)

    def at_temperature(
        self,
        change: NumberLike,
        *,
        bodies: NamedNumbers = MappingProxyType({}),
        hinges: NamedNumbers = MappingProxyType({}),
        gradients: NamedNumbers = MappingProxyType({}),
    ) -> "Mechanism":
        """Return the mechanism at another temperature.

        Bodies expand about the origins of their frames. Hinges with an `expansion` become
        longer, which changes their misfits, and get a natural curvature by a gradient of
        the temperature. The stiffness of leaves, notches, and surrogates is that of their
        new dimensions, so that a mechanism of one material at one temperature is only
        scaled. Moduli of materials, energies that are not those of flexures, such as a
        `Quadratic` without `flexure=True`, and misfits that the hinges already have, do
        not change.

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
        return expanded(self, change, bodies, hinges, gradients)

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
        return {3 * body, 3 * body + 1, 3 * body + 2} <= set(self.fixed)

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
        rows = []
        for body, name in enumerate(self.names):
            mass, inertia = self.masses[body], self.inertias[body]
            if self.is_fixed(body):
                rows.append(jnp.full(3, jnp.inf))
            elif mass is None or inertia is None:
                values = {"mass": mass, "inertia": inertia}
                missing = [f"`{key}`" for key, value in values.items() if value is None]
                raise ValueError(
                    f"The body {name!r} can move, but has no {' and no '.join(missing)}. "
                    "Give it `mass` and `inertia`, or fix the body. The origin of its "
                    "frame must be its center of mass."
                )
            else:
                rows.append(jnp.stack([inertia, mass, mass]))
        return jnp.stack(rows)

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
        if isinstance(at, Displaced):
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
                    f"`{name}` is {shorten(repr(at))}, but must be an equilibrium or "
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
            )
        return jax.device_put(array) if isinstance(array, np.ndarray) else array

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
        if isinstance(chosen, str):
            raise ValueError(
                f"`{argument}` is the string {chosen!r}, but must be a list of names, "
                f"such as [{chosen!r}]."
            )
        if not isinstance(chosen, Iterable):
            raise ValueError(
                f"`{argument}` is {shorten(repr(chosen))}, but must be a list of names "
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
                    f"{where} is {shorten(repr(coordinates))}, but must be a list of "
                    "some of 'angle', 'x', 'y', such as ['x', 'y']."
                )
            for name in coordinates:
                dofs.add(3 * body + index_of(where, "coordinate", name, COORDINATES))
        return tuple(sorted(dofs))


def _misfits(
    rows: Sequence[Float[Array, "6"] | None],
) -> Float[Array, "hinges 6"] | None:
    """Stack the numbers of misfits; None if there are none."""
    if all(row is None for row in rows):
        return None
    xp, arrays = on_host(*(np.zeros(6) if row is None else row for row in rows))
    return as_float(xp.stack(arrays))


def _rows(poses: Sequence[Pose]) -> Poses:
    """Stack poses."""
    xp, arrays = on_host(*poses)
    return as_float(xp.reshape(xp.stack(arrays), (-1, 3)) if arrays else np.zeros((0, 3)))
