"""Energy of a straight spring or bar whose ends are free to rotate."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._utils.types import NumberLike, Scalar
from .._utils.validation import require_positive
from ..geometry.twistors import Displacement
from .base import AbstractEnergy, positive_error, Stress
from .dilation import multiply_fields


class AxialSpring(AbstractEnergy):
    """Elastic energy of a straight spring or bar that is hinged at both of its ends.

    The frames are in the middle of the spring, with axis 1 along it, as those of a leaf.
    One end is attached to body A at `-length / 2` along axis 1 of frame a, the other one
    to body B at `length / 2` along axis 1 of frame b. The energy is
    `stiffness (distance - length)^2 / 2`, at any distance of the ends except zero.

    A misfit or a stroke of the hinge moves both ends along its axes, which are fixed on
    the bodies. It makes the spring longer if the spring hardly turns against the bodies.

    Args:
        stiffness: Axial stiffness, such as E A / length of a bar; N/m.
        length: Length without load; m.

    Raises:
        ValueError: The stiffness or the length is not positive.

    Example:
        >>> spring = AxialSpring(100.0, length=0.5)
        >>> spring.wrench(jnp.array([0.0, 0.1, 0.0]))[1]  # longer by 0.1 m
        Array(10., dtype=float64)
        >>> spring(jnp.array([0.0, -0.5, 0.4])).round(12)  # of length 0.4
        Array(0.5, dtype=float64)
    """

    stiffness: Scalar
    length: Scalar

    def __init__(self, stiffness: NumberLike, *, length: NumberLike):
        self.stiffness = require_positive("`stiffness`", stiffness)
        self.length = require_positive("`length`", length)

    def validation_error(self) -> str | None:
        """Describe the first value that is not positive; None if both are."""
        return positive_error(self, "stiffness", "length")

    @property
    def is_unloaded(self) -> bool:
        return True

    def stored_energy(self, displacement: Displacement) -> Scalar:
        return self.stiffness * self.stretch(displacement) ** 2 / 2

    def stretch(self, displacement: Displacement) -> Scalar:
        """Compute the distance of the ends minus the length; m."""
        y1, y2 = 2 * displacement.x1 / self.length, 2 * displacement.x2 / self.length
        return self.length * _relative_stretch(
            displacement.sigma, displacement.xi, y1, y2
        )

    def ends_apart(self, displacement: Displacement) -> tuple[Scalar, Scalar]:
        """Compute the vector from one end to the other one in the mid-frame; m."""
        along = 2 * displacement.x1 + self.length * displacement.sigma
        return along, 2 * displacement.x2

    def newton_model(self, stress: Stress) -> AbstractEnergy:
        """Return the energy that replaces it in a Newton step; see `AbstractEnergy`."""
        return _NewtonModel(self, *stress[1:])

    def dilated(self, scale: Float[Array, "*batch"]) -> "AxialSpring":
        """Return the energy if all dimensions of the spring are multiplied."""
        return multiply_fields(self, scale, stiffness=1, length=1)


@jax.custom_jvp
def _relative_stretch(sigma: Scalar, xi: Scalar, y1: Scalar, y2: Scalar) -> Scalar:
    """Compute the distance of the ends minus the length, divided by the length.

    It is the difference of the squares, divided by the sum, because the difference of two
    almost equal lengths would lose its digits. The derivatives are written out, as those
    of the distance, because JAX would differentiate the quotient, which takes twice the
    time in a batch of paths (`benchmarks.paths`). The distance contains xi by sigma.
    """
    squares = y1 * (y1 + 2 * sigma) + (y2 - xi) * (y2 + xi)
    return squares / (jnp.sqrt((y1 + sigma) ** 2 + y2**2) + 1)


@_relative_stretch.defjvp
def _(primals, tangents):
    sigma, _, y1, y2 = primals
    along, distance = y1 + sigma, jnp.sqrt((y1 + sigma) ** 2 + y2**2)
    change = along * (tangents[0] + tangents[2]) + y2 * tangents[3]
    return _relative_stretch(*primals), change / distance


class _NewtonModel(AbstractEnergy):
    """Replacement of the energy of a spring in Newton's method, near a predicted force.

    A Newton step that turns a stiff bar stretches it, because its shortening along its
    first direction is of second order. The large force of this stretch would slow down
    Newton's method, so the geometric stiffness is that of the predicted force.
    """

    spring: AxialSpring
    axial: Scalar  # Predicted axial force; N
    transverse: Scalar  # Predicted transverse force; N

    def stored_energy(self, displacement: Displacement) -> Scalar:
        spring, fixed = self.spring, jax.lax.stop_gradient(displacement)
        along, across = spring.ends_apart(displacement)
        along0, across0 = spring.ends_apart(fixed)
        distance = jnp.sqrt(along**2 + across**2)
        distance0 = jnp.sqrt(along0**2 + across0**2)
        predicted = (self.axial * along0 + self.transverse * across0) / distance0
        force = spring.stiffness * spring.stretch(fixed)
        # The part of the distance that is not linear has no first derivatives.
        turn = displacement.angle - fixed.angle
        rate = along0 - spring.length * fixed.xi * turn / 2
        rate += 2 * (displacement.x1 - fixed.x1)
        rate = along0 * rate + across0 * across
        curved = distance - rate / distance0
        return spring.stored_energy(displacement) + (predicted - force) * curved
