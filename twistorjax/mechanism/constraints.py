"""Kinematic constraints between bodies: pins, sliders, and general equations."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from itertools import combinations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._compile.traced_function import traced
from .._utils.types import (
    Entries,
    Numbers,
    Point,
    PointLike,
    Pose,
    PoseLike,
    Poses,
    Scalar,
)
from .._utils.validation import (
    index_of,
    quote,
    require_kind,
    require_names,
    require_pose,
    require_row,
    require_text,
)
from ..geometry import se2
from .mechanism import Mechanism


class AbstractConstraint(eqx.Module):
    """Kinematic constraint: a function of the poses of some bodies that must be zero.

    A subclass implements `violation`, whose constants are fields: a compiled program
    keeps the values of other variables. For each of its entries there is a constraint
    force, which does no work on displacements that the constraint allows.
    """

    name: eqx.AbstractVar[str]
    bodies: eqx.AbstractVar[tuple[str, ...]]

    @abstractmethod
    def violation(self, poses: Poses, references: Poses, time: Scalar) -> Numbers:
        """Compute the constraint violation.

        Args:
            poses: Poses of the bodies of the constraint, in order; rad, m, m.
            references: Reference poses of the same bodies; rad, m, m.
            time: Time; s.

        Returns:
            The values, which are zero if the constraint is satisfied; rad or m.
        """


class Constraint(AbstractConstraint):
    """A general equation between the poses of some bodies and the time.

    Args:
        name: Name of the constraint in solutions and messages.
        bodies: Names of the bodies whose poses the equation contains.
        zero: Function of the poses of these bodies, in order, and of the time. It returns
            one number or a row of numbers, one for each degree of freedom that the
            constraint removes; rad or m.

    Raises:
        ValueError: A name is not a string, or `zero` is not a function.

    Source:
        Equations 5.25 and 6.4 of the dissertation.

    Example:
        >>> def position_error(pose, time):
        ...     return pose[1] - 0.1 * time
        >>> Constraint("along x", ["table"], position_error).bodies
        ('table',)
    """

    name: str = eqx.field(static=True)
    bodies: tuple[str, ...] = eqx.field(static=True)
    zero: Callable[..., Numbers]

    def __init__(self, name: str, bodies: Sequence[str], zero: Callable[..., Numbers]):
        self.name = require_text("The name of a constraint", name)
        require_names(f"`bodies` of the constraint {name!r}", bodies)
        self.bodies = tuple(bodies)
        if not callable(zero):
            raise ValueError(
                f"`zero` of the constraint {name!r} is {quote(zero)}, but must be a "
                "function of the poses of the bodies and the time."
            )
        self.zero = zero

    def violation(self, poses: Poses, references: Poses, time: Scalar) -> Numbers:
        del references
        entries = jnp.asarray(self.zero(*poses, time))
        return entries[None] if entries.ndim == 0 else entries

    def traced(self) -> "Constraint":
        """Trace the function of the user, with the values that it uses at this time."""
        number = jnp.result_type(float)
        shapes = [*len(self.bodies) * [(3,)], ()]
        examples = (jax.ShapeDtypeStruct(shape, number) for shape in shapes)
        zero = traced(self.zero, *examples)
        return eqx.tree_at(lambda constraint: constraint.zero, self, zero)


class Pin(AbstractConstraint):
    """A pin joint: a point that two bodies share, about which they rotate freely.

    The constraint force is the force on the second body at the pin, in world axes; N.

    Args:
        name: Name of the constraint in solutions and messages.
        first: Name of the first body.
        second: Name of the second body.
        at: Position of the pin in the reference configuration, in the world frame; m.

    Raises:
        ValueError: A name is not a string, a body is connected to itself, or a value is
            not finite.

    Example:
        >>> Pin("elbow", "upper", "lower", at=(0.1, 0.0)).bodies
        ('upper', 'lower')
    """

    name: str = eqx.field(static=True)
    bodies: tuple[str, ...] = eqx.field(static=True)
    at: Point

    def __init__(self, name: str, first: str, second: str, at: PointLike):
        self.name = require_text("The name of a pin", name)
        self.bodies = _two_bodies("pin", name, first, second)
        self.at = require_row(f"`at` of the pin {name!r}", at, "(x, y)", 2)

    def violation(self, poses: Poses, references: Poses, time: Scalar) -> Point:
        del time
        frame = jnp.concatenate([jnp.zeros(1), self.at])
        first, second = _moved_frames(frame, poses, references)
        return second[1:] - first[1:]


class Slider(AbstractConstraint):
    """A prismatic joint: the second body slides along an axis fixed to the first.

    The constraint forces are the moment and the force normal to the axis on the second
    body, about the point of the second body that is at `at` in the reference
    configuration; N m, N.

    Args:
        name: Name of the constraint in solutions and messages.
        first: Name of the body with the guide.
        second: Name of the body that slides.
        at: Angle of the axis and a point on it in the reference configuration, in the
            world frame; rad, m, m.

    Raises:
        ValueError: A name is not a string, a body is connected to itself, or a value is
            not finite.

    Example:
        >>> Slider("rail", "frame", "table", at=(0.0, 0.0, 0.1)).bodies
        ('frame', 'table')
    """

    name: str = eqx.field(static=True)
    bodies: tuple[str, ...] = eqx.field(static=True)
    at: Pose

    def __init__(self, name: str, first: str, second: str, at: PoseLike):
        self.name = require_text("The name of a slider", name)
        self.bodies = _two_bodies("slider", name, first, second)
        self.at = require_pose(f"`at` of the slider {name!r}", at)

    def violation(
        self, poses: Poses, references: Poses, time: Scalar
    ) -> Float[Array, "2"]:
        del time
        gap = se2.between(*_moved_frames(self.at, poses, references))
        return jnp.stack([gap[0], gap[2]])


class ConstraintSet(eqx.Module):
    """All constraints on a mechanism, as functions of the displacements of its bodies.

    The generalized forces on the bodies are the product of the constraint forces and the
    derivatives of the violation.
    """

    # The constraints, in the order of their scalar equations
    constraints: tuple[AbstractConstraint, ...]
    # Indices of the bodies of each constraint
    bodies: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    # Number of scalar equations of each constraint
    sizes: tuple[int, ...] = eqx.field(static=True)
    reference: Poses  # Reference poses of all bodies; rad, m, m
    # Reference poses of the bodies of each constraint, for its violation; rad, m, m
    references: tuple[Float[Array, "_ 3"], ...]

    @property
    def size(self) -> int:
        """Number of scalar equations, each of which removes one degree of freedom."""
        return sum(self.sizes)

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Indices of each two bodies that a constraint couples."""
        return tuple(pair for rows in self.bodies for pair in combinations(rows, 2))

    def violation(self, displacements: Poses, time: Scalar) -> Entries:
        """Compute the violation of all constraints at a time (s); rad or m."""
        poses = self.reference + displacements
        parts = [
            constraint.violation(poses[np.array(rows)], references, time)
            for constraint, rows, references in zip(
                self.constraints, self.bodies, self.references, strict=True
            )
        ]
        return jnp.concatenate([jnp.zeros(0), *parts])

    def jacobian(
        self, displacements: Poses, time: Scalar
    ) -> Float[Array, "entries dofs"]:
        """Differentiate the violation with respect to all degrees of freedom."""
        if not self.size:
            return jnp.zeros((0, displacements.size))
        jacobian = jax.jacrev(self.violation)(displacements, time)
        return jacobian.reshape(self.size, -1)

    def forces(
        self, displacements: Poses, time: Scalar, multipliers: Entries
    ) -> Float[Array, " dofs"]:
        """Convert constraint forces, the multipliers, to generalized forces; N m, N."""
        if not self.size:
            return jnp.zeros(displacements.size)
        _, pull_back = jax.vjp(lambda at: self.violation(at, time), displacements)
        return pull_back(multipliers)[0].reshape(-1)

    def geometric_stiffness(
        self, displacements: Poses, time: Scalar, multipliers: Entries
    ) -> Float[Array, "dofs dofs"]:
        """Compute the negative derivative of the `forces`; N m/rad, N/rad, N/m.

        Constraint forces contribute to the stiffness, because their directions change if
        the bodies move.
        """
        poses, size = self.reference + displacements, displacements.size
        total, first = jnp.zeros((size, size)), 0
        for constraint, bodies, count, references in zip(
            self.constraints, self.bodies, self.sizes, self.references, strict=True
        ):
            rows, own = np.array(bodies), multipliers[first : first + count]

            def work(
                at: Poses, constraint=constraint, references=references, own=own
            ) -> Scalar:
                return own @ constraint.violation(at, references, time)

            dofs = (3 * rows[:, None] + np.arange(3)).reshape(-1)
            matrix = jax.hessian(work)(poses[rows]).reshape(2 * (dofs.size,))
            total = total.at[dofs[:, None], dofs].add(-matrix)
            first += count
        return total

    def names(self) -> tuple[str, ...]:
        """Return the name of the constraint of each scalar equation."""
        pairs = zip(self.constraints, self.sizes, strict=True)
        return tuple(constraint.name for constraint, size in pairs for _ in range(size))


def gather_constraints(
    mechanism: Mechanism, constraints: Sequence[AbstractConstraint]
) -> ConstraintSet:
    """Gather constraints on the bodies of a mechanism."""
    require_kind("constraints", constraints, AbstractConstraint)
    given, bodies, sizes, all_references, names = [], [], [], [], set()
    for constraint in constraints:
        where = f"The constraint {constraint.name!r}"
        if constraint.name in names:
            raise ValueError(f"{where} is given twice, but names must be unique.")
        names.add(constraint.name)
        rows = tuple(
            index_of(where, "body", body, mechanism.names) for body in constraint.bodies
        )
        if isinstance(constraint, Constraint):
            constraint = constraint.traced()
        given.append(constraint)
        references = mechanism.reference[np.array(rows)]
        if mechanism.thermal_strains is not None and isinstance(constraint, Pin | Slider):
            strains = mechanism.thermal_strains[np.array(rows)]
            references = _expanded(references, constraint.at[-2:], strains)
        shape = eqx.filter_eval_shape(
            constraint.violation, references, references, jnp.zeros(())
        ).shape
        if len(shape) != 1:
            raise ValueError(
                f"{where} returns an array of shape {shape}, but must return one number "
                "or a one-dimensional array."
            )
        bodies.append(rows)
        sizes.append(shape[0])
        all_references.append(references)
    return ConstraintSet(
        tuple(given),
        tuple(bodies),
        tuple(sizes),
        mechanism.reference,
        tuple(all_references),
    )


def _expanded(references: Poses, point: Point, strains: Float[Array, " bodies"]) -> Poses:
    """Move the origins of bodies, so that their distances from a point expand; m."""
    arms = references[:, 1:] - point[None]
    return references.at[:, 1:].add(strains[:, None] * arms)


def require_rigid_joints(
    mechanism: Mechanism, constraints: Sequence[AbstractConstraint]
) -> None:
    """Check that no pin or slider is on a body that expands while it is solved."""
    for constraint in constraints:
        if not isinstance(constraint, Pin | Slider):
            continue
        for body in constraint.bodies:
            if mechanism.expansions[mechanism.index(body)] is not None:
                raise ValueError(
                    f"The constraint {constraint.name!r} is on the body {body!r}, which "
                    "has an `expansion`, but pins and sliders do not move with a "
                    "`temperature` that changes. Solve the mechanism `at_temperature`."
                )


def _moved_frames(frame: Pose, poses: Poses, references: Poses) -> list[Pose]:
    """Move a frame from the reference configuration with each body; rad, m, m."""
    return [
        se2.compose(pose, se2.between(reference, frame))
        for pose, reference in zip(poses, references, strict=True)
    ]


def _two_bodies(noun: str, name: str, first: str, second: str) -> tuple[str, str]:
    """Check the names of the two bodies of a constraint and return them."""
    require_text(f"`first` of the {noun} {name!r}", first)
    require_text(f"`second` of the {noun} {name!r}", second)
    if first == second:
        raise ValueError(f"The {noun} {name!r} connects the body {first!r} to itself.")
    return first, second
