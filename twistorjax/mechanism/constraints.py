"""What is joined without stretch: pins, sliders, and whatever else must stay zero."""

from abc import abstractmethod
from collections.abc import Callable, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .._utils.types import Point, Pose, Poses, Scalar
from .._utils.validation import index_of, require_kind, require_row, require_text
from ..geometry import se2
from .mechanism import Mechanism


class AbstractConstraint(eqx.Module):
    """Something about the poses of some bodies that stays zero as they move.

    A subclass writes `violation`. What keeps it at zero is a force for each of its
    entries: in its own direction, as large as it takes.
    """

    name: eqx.AbstractVar[str]
    bodies: eqx.AbstractVar[tuple[str, ...]]

    @abstractmethod
    def violation(self, poses: Poses, rests: Poses, time: Scalar) -> Float[Array, "..."]:
        """What must be zero; rad or m.

        Args:
            poses: of its bodies, in order; rad, m, m.
            rests: of the same bodies, when nothing is loaded; rad, m, m.
            time: s.
        """


class Constraint(AbstractConstraint):
    """Any equation between the poses of some bodies, and the time.

    Args:
        name: by which answers and messages call it.
        bodies: names of those whose poses it knows.
        zero: a function of their poses, in order, and then of the time; one number or a
            row of them, as many as it takes away freedoms; rad or m.

    Raises:
        ValueError: a name is no text, or `zero` is not a function.

    Source:
        Equations 5.25 and 6.4 of the dissertation.

    Example:
        >>> along = Constraint("along", ["3"], lambda pose, time: pose[1] - 0.1 * time)
        >>> along.bodies
        ('3',)
    """

    name: str = eqx.field(static=True)
    bodies: tuple[str, ...] = eqx.field(static=True)
    zero: Callable[..., Float[Array, "..."]]

    def __init__(
        self, name: str, bodies: Sequence[str], zero: Callable[..., Float[Array, "..."]]
    ):
        self.name = require_text("The name of a constraint", name)
        if isinstance(bodies, str):
            raise ValueError(
                f"`bodies` of the constraint {name!r} is the string {bodies!r}, but must "
                f"be a sequence of names: [{bodies!r}]."
            )
        self.bodies = tuple(bodies)
        if not callable(zero):
            raise ValueError(
                f"`zero` of the constraint {name!r} is {zero!r}, but must be a function "
                "of the bodies' poses and the time."
            )
        self.zero = zero

    def violation(self, poses: Poses, rests: Poses, time: Scalar) -> Float[Array, "..."]:
        del rests
        entries = jnp.asarray(self.zero(*poses, time))
        return entries[None] if entries.ndim == 0 else entries


class Pin(AbstractConstraint):
    """A point that two bodies share, about which they turn freely.

    Its force is what it exerts on the second body there, in world axes; N.

    Args:
        name: by which answers and messages call it.
        first: name of one body.
        second: name of the other.
        at: where the pin is at rest, in the world; m.

    Raises:
        ValueError: a name is no text, a body is joined to itself, or a value not finite.

    Example:
        >>> Pin("elbow", "upper", "lower", at=(0.1, 0.0)).bodies
        ('upper', 'lower')
    """

    name: str = eqx.field(static=True)
    bodies: tuple[str, ...] = eqx.field(static=True)
    at: Point

    def __init__(
        self,
        name: str,
        first: str,
        second: str,
        at: Float[ArrayLike, "2"] | Sequence[ArrayLike],
    ):
        self.name = require_text("The name of a pin", name)
        self.bodies = _two("pin", name, first, second)
        self.at = require_row(f"`at` of the pin {name!r}", at, "(x, y)", 2)

    def violation(self, poses: Poses, rests: Poses, time: Scalar) -> Float[Array, "2"]:
        del time
        place = jnp.concatenate([jnp.zeros(1), self.at])
        first, second = (
            se2.compose(pose, se2.between(reference, place))
            for pose, reference in zip(poses, rests, strict=True)
        )
        return second[1:] - first[1:]


class Slider(AbstractConstraint):
    """A straight guide: the second body slides along an axis fixed to the first.

    Its forces are the moment and the force across that it exerts on the second body,
    about that point of it which was at `at`; N m, N.

    Args:
        name: by which answers and messages call it.
        first: name of the body that carries the guide.
        second: name of the body that slides.
        at: the guide at rest, in the world: the angle of its axis, and a point on it;
            rad, m, m.

    Raises:
        ValueError: a name is no text, a body is joined to itself, or a value not finite.

    Example:
        >>> Slider("rail", "frame", "table", at=(0.0, 0.0, 0.1)).bodies
        ('frame', 'table')
    """

    name: str = eqx.field(static=True)
    bodies: tuple[str, ...] = eqx.field(static=True)
    at: Pose

    def __init__(
        self,
        name: str,
        first: str,
        second: str,
        at: Float[ArrayLike, "3"] | Sequence[ArrayLike],
    ):
        self.name = require_text("The name of a slider", name)
        self.bodies = _two("slider", name, first, second)
        self.at = require_row(f"`at` of the slider {name!r}", at, "(angle, x, y)")

    def violation(self, poses: Poses, rests: Poses, time: Scalar) -> Float[Array, "2"]:
        del time
        first, second = (
            se2.compose(pose, se2.between(reference, self.at))
            for pose, reference in zip(poses, rests, strict=True)
        )
        apart = se2.between(first, second)
        return jnp.stack([apart[0], apart[2]])


class ConstraintSet(eqx.Module):
    """All constraints on a mechanism, as one function of its poses.

    Args:
        constraints: in the order of its entries.
        rows: the places of each one's bodies.
        sizes: how many entries each has.
        reference: poses of all bodies at rest; rad, m, m.
    """

    constraints: tuple[AbstractConstraint, ...]
    rows: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    sizes: tuple[int, ...] = eqx.field(static=True)
    reference: Poses

    @property
    def size(self) -> int:
        """How many freedoms they take away."""
        return sum(self.sizes)

    def violation(self, displacements: Poses, time: Scalar) -> Float[Array, " entries"]:
        """What must be zero, of all of them; rad or m."""
        poses = self.reference + displacements
        parts = [
            constraint.violation(
                poses[np.array(rows)], self.reference[np.array(rows)], time
            )
            for constraint, rows in zip(self.constraints, self.rows, strict=True)
        ]
        return jnp.concatenate([jnp.zeros(0), *parts])

    def owners(self) -> list[str]:
        """The name of each entry's constraint."""
        pairs = zip(self.constraints, self.sizes, strict=True)
        return [constraint.name for constraint, size in pairs for _ in range(size)]


def gather_constraints(
    mechanism: Mechanism, constraints: Sequence[AbstractConstraint]
) -> ConstraintSet:
    """Gathers constraints on the bodies of a mechanism.

    Raises:
        ValueError: a constraint names a body that the mechanism does not have, or two
            have one name, or something in the list is no constraint.
    """
    require_kind("constraints", constraints, AbstractConstraint)
    rows, sizes, names = [], [], set()
    for constraint in constraints:
        where = f"The constraint {constraint.name!r}"
        if constraint.name in names:
            raise ValueError(f"{where} is given twice; names must differ.")
        names.add(constraint.name)
        own = tuple(
            index_of(where, "body", body, mechanism.names) for body in constraint.bodies
        )
        rests = mechanism.reference[np.array(own)]
        shape = eqx.filter_eval_shape(
            constraint.violation, rests, rests, jnp.zeros(())
        ).shape
        if len(shape) != 1:
            raise ValueError(
                f"{where} gives an array of shape {shape}, but must give a row of "
                "numbers, or one."
            )
        rows.append(own)
        sizes.append(shape[0])
    return ConstraintSet(
        tuple(constraints), tuple(rows), tuple(sizes), mechanism.reference
    )


def _two(noun: str, name: str, first: str, second: str) -> tuple[str, str]:
    require_text(f"`first` of the {noun} {name!r}", first)
    require_text(f"`second` of the {noun} {name!r}", second)
    if first == second:
        raise ValueError(f"The {noun} {name!r} joins the body {first!r} to itself.")
    return first, second
