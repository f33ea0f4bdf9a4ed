"""Contact between two bodies, as a one-sided energy."""

from abc import abstractmethod
from typing import Any, get_args, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.host import concrete
from .._utils.types import EndsLike, NumberLike, Point, PointLike, Scalar
from .._utils.validation import (
    require_array,
    require_choice,
    require_finite,
    require_positive,
    require_row,
    warn_if_degrees,
    warn_if_long,
)
from ..geometry import se2
from ..geometry.twistors import Displacement
from .base import AbstractEnergy, nested, positive_error
from .dilation import multiply_fields


_WIDEST_GAP = 1.0  # of a stop, which must be given in meters; m

Direction = Literal["+angle", "-angle", "+x", "-x", "+y", "-y"]


class AbstractContact(AbstractEnergy):
    """Contact that resists penetration.

    The force is zero without penetration, `k d^2 / (2 e)` at a penetration d up to the
    smoothing length e, and `k (d - e / 2)` beyond, with the stiffness k. The energy has
    two continuous derivatives. There is no friction. An impact loses no energy; give the
    hinge `damping` for that.
    """

    stiffness: eqx.AbstractVar[Scalar]
    smoothing: eqx.AbstractVar[Scalar]

    @abstractmethod
    def penetration(self, displacement: Displacement) -> Scalar:
        """Compute the penetration, which is negative if there is a gap.

        Args:
            displacement: Displacement of frame b relative to frame a.

        Returns:
            The penetration; m, or rad for an angle.
        """

    def stored_energy(self, displacement: Displacement) -> Scalar:
        depth, smoothing = self.penetration(displacement), self.smoothing
        within = depth**3 / (6 * smoothing)
        beyond = depth * (depth - smoothing) / 2 + smoothing**2 / 6
        # `clip` and `maximum` have half of a derivative where their arguments are equal.
        closed = jnp.where(depth < smoothing, within, beyond)
        return self.stiffness * jnp.where(depth > 0, closed, 0.0)

    def validation_error(self) -> str | None:
        """Describe the first value that is not positive; None if all are."""
        return positive_error(self, "stiffness", "smoothing")


class _ClosedContact(AbstractEnergy):
    """A contact with its full stiffness and without force, at any displacement."""

    contact: AbstractContact

    def stored_energy(self, displacement: Displacement) -> Scalar:
        depth = self.contact.penetration(displacement)
        change = depth - jax.lax.stop_gradient(depth)
        return self.contact.stiffness * change**2 / 2


def with_closed_contacts(energy: AbstractEnergy) -> AbstractEnergy:
    """Give contacts their full stiffness, and no force, at any displacement."""

    def is_leaf(part: Any) -> bool:
        return isinstance(part, AbstractContact)

    def closed(part: Any) -> Any:
        return _ClosedContact(part) if is_leaf(part) else part

    return jax.tree.map(closed, energy, is_leaf=is_leaf)


def is_contact(energy: AbstractEnergy) -> bool:
    """Decide whether an energy is that of a contact, or a multiple of it."""
    return any(isinstance(part, AbstractContact) for part in nested(energy))


class Stop(AbstractContact):
    """A stop that limits one displacement of a hinge.

    Add it to the energy of a hinge: `leaf + Stop("+y", gap=0.2e-3, ...)`. The
    displacement is that of body B relative to body A: the angle, or the translation along
    an axis of the hinge, in the frame in the middle between its two frames. There is no
    friction, and an impact loses no energy; give the hinge `damping` for that.

    Args:
        direction: Coordinate and direction of the displacement that closes the gap: "+x"
            or "-x" along axis 1, "+y" or "-y" along axis 2, "+angle" or "-angle".
        gap: Displacement at which the stop is reached; m or rad. It may be negative, for
            a hinge that is pressed against the stop in the reference configuration.
        stiffness: Stiffness of the stop; N/m or N m/rad.
        smoothing: Penetration over which the stiffness grows from zero, such as a tenth
            of the largest one that is expected; m or rad.

    Raises:
        ValueError: The direction is unknown, the stiffness or the smoothing is not
            positive, or the gap is not finite.

    Example:
        >>> stop = Stop("-x", gap=1e-3, stiffness=1e6, smoothing=1e-5)
        >>> stop.wrench(jnp.array([0.0, -1.1e-3, 0.0]))[1]  # 1e6 N/m (0.1 - 0.005) mm
        Array(-95., dtype=float64)
    """

    direction: Direction = eqx.field(static=True)
    gap: Scalar
    stiffness: Scalar
    smoothing: Scalar

    def __init__(
        self,
        direction: Direction,
        *,
        gap: NumberLike,
        stiffness: NumberLike,
        smoothing: NumberLike,
    ):
        self.direction = require_choice("`direction`", direction, get_args(Direction))
        self.gap = require_finite("`gap`", gap)
        if direction[1:] == "angle":
            warn_if_degrees("`gap`", self.gap)
        else:
            warn_if_long("`gap`", self.gap, _WIDEST_GAP, "a stop")
        self.stiffness = require_positive("`stiffness`", stiffness)
        self.smoothing = require_positive("`smoothing`", smoothing)

    @property
    def is_unloaded(self) -> bool:
        gap = concrete(self.gap)
        return gap is not None and bool(np.all(gap >= 0))

    def penetration(self, displacement: Displacement) -> Scalar:
        sign, coordinate = self.direction[0], self.direction[1:]
        values = {
            "angle": displacement.angle,
            "x": 2 * displacement.x1,
            "y": 2 * displacement.x2,
        }
        value = values[coordinate]
        return (value if sign == "+" else -value) - self.gap

    def dilated(self, scale: Float[Array, "*batch"]) -> "Stop":
        """Return the energy if all dimensions of the stop are multiplied."""
        if self.direction[1:] == "angle":
            return multiply_fields(self, scale, stiffness=3)
        return multiply_fields(self, scale, gap=1, stiffness=1, smoothing=1)


class CornerContact(AbstractContact):
    """Contact of a corner of body B with an edge of body A.

    Add it to the energy of a hinge. The force is perpendicular to the edge. The edge has
    no end: the corner must stay beside it. There is no friction, and an impact loses no
    energy; give the hinge `damping` for that.

    Args:
        corner: Corner in the frame b of the hinge; m.
        edge: Two points of the edge in the frame a of the hinge. Body A is on the left of
            the way from the first point to the second, as in an outline whose corners are
            in counterclockwise order; m.
        stiffness: Stiffness of the contact; N/m.
        smoothing: Penetration over which the stiffness grows from zero, such as a tenth
            of the largest one that is expected; m.

    Raises:
        ValueError: The stiffness or the smoothing is not positive, the points of the edge
            coincide, or a shape is wrong.

    Example:
        >>> floor = (1.0, 0.0), (-1.0, 0.0)  # body A is below
        >>> contact = CornerContact((0.0, 0.1), floor, stiffness=1e6, smoothing=1e-5)
        >>> contact.wrench(jnp.array([0.0, 0.0, -0.1001]))[2]
        Array(-95., dtype=float64)
    """

    corner: Point
    edge: Float[Array, "2 2"]
    stiffness: Scalar
    smoothing: Scalar

    def __init__(
        self,
        corner: PointLike,
        edge: EndsLike,
        *,
        stiffness: NumberLike,
        smoothing: NumberLike,
    ):
        self.corner = require_row("`corner`", corner, "(x, y)", 2)
        requirement = "be two points (x, y)"
        self.edge = require_array("`edge`", edge, (2, 2), requirement)
        known = concrete(self.edge)
        if known is not None and np.array_equal(*known):
            raise ValueError("`edge` has two points that coincide, but they must differ.")
        self.stiffness = require_positive("`stiffness`", stiffness)
        self.smoothing = require_positive("`smoothing`", smoothing)

    def penetration(self, displacement: Displacement) -> Scalar:
        start, end = self.edge
        along_x, along_y = end - start
        length = jnp.sqrt(along_x**2 + along_y**2)
        x, y = se2.act(displacement.pose(), self.corner) - start
        return (along_x * y - along_y * x) / length

    def dilated(self, scale: Float[Array, "*batch"]) -> "CornerContact":
        """Return the energy if all dimensions of the contact are multiplied."""
        point, points = (1, 1), ((1, 1), (1, 1))
        return multiply_fields(
            self, scale, corner=point, edge=points, stiffness=1, smoothing=1
        )
