"""Energies in the coordinates of the twist or the twistor, and the quadratic energy."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._utils.host import as_float, concrete, on_host
from .._utils.types import Flag, Matrix, MatrixLike, Scalar
from .._utils.validation import require_choice
from ..geometry.twistors import Displacement
from .base import AbstractEnergy
from .damping import ViscousDamping
from .dilation import multiply_fields
from .strains import Coordinates, half_square, matrix_error, strain, translation_scale
from .stress_model import AbstractStressModel


class CoordinateEnergy(AbstractEnergy):
    """An energy in the coordinates of the twist or of the twistor.

    The twist is not defined at a rotation of 2 pi, so an energy of the twist is valid for
    rotations below 2 pi only.
    """

    coordinates: eqx.AbstractVar[Coordinates]

    def translation_scale(self, displacement: Displacement) -> Scalar:
        """Compute the ratio of the strain's translation to that in the mid-frame."""
        return translation_scale(displacement, self.coordinates)

    def out_of_range(self, displacement: Displacement) -> Flag | None:
        """Decide whether the twist is undefined at a displacement."""
        if self.coordinates == "twistor":
            return None
        return jnp.abs(displacement.angle) >= 2 * jnp.pi

    def range_message(self, displacement: Displacement) -> str:
        """Describe the rotation and the range of the twist."""
        angle = concrete(displacement.angle)
        rotated = "" if angle is None else f" by {float(angle):.4g} rad"
        return (
            f"it is rotated{rotated}, but its energy is a function of the twist, which "
            "is defined for rotations below 6.283 rad only; use coordinates='twistor'"
        )


class Quadratic(CoordinateEnergy):
    """A quadratic form of the twist or of the twistor.

    Both have the given stiffness in the reference configuration, and their energies
    differ by terms of third and higher order. They grow without bound with the
    translation. In a pure rotation, the moment of the energy of the twist is proportional
    to the angle. The moment of the energy of the twistor is proportional to the sine of
    the angle, so this energy is bounded in a pure rotation, and its moment is zero at an
    angle of pi. Its evaluation is faster, because it needs no sine and cosine.

    Args:
        stiffness: Stiffness in the frame of the hinge, symmetric and without negative
            eigenvalues. Rows and columns are rotation, axis 1, axis 2; N m/rad, N/rad,
            N/m.
        coordinates: "twistor" for the energy `2 v K v` of v = (xi, x1, x2), "twist" for
            the energy `s K s / 2` of the twist s = (tau, t1, t2).
        flexure: Whether this is the stiffness of an undeformed flexure along axis 1, such
            as a leaf. The solvers then warn of displacements and axial forces at which
            the force or the moment of a leaf differs from that of the energy by more than
            5 %, and thermal expansion changes the stiffness with the dimensions.
        stress_model: Stress in a flexure whose dimensions are known, such as that of
            `linear_leaf` and `notch`.

    Raises:
        ValueError: The stiffness is not 3 by 3 or not symmetric, it has a negative
            eigenvalue or a value that is not finite, or the coordinates are unknown.

    Source:
        Equations 3.4 and 4.7 of the dissertation.

    Example:
        >>> leaf = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0])))
        >>> leaf(jnp.array([0.0, 0.0, 0.5]))
        Array(1.25, dtype=float64)
    """

    stiffness: Matrix
    coordinates: Coordinates = eqx.field(static=True)
    flexure: bool = eqx.field(static=True, default=False)
    stress_model: AbstractStressModel | None = eqx.field(default=None, repr=False)

    def __init__(
        self,
        stiffness: MatrixLike,
        coordinates: Coordinates = "twistor",
        *,
        flexure: bool = False,
        stress_model: AbstractStressModel | None = None,
    ):
        self.stiffness = as_float(stiffness)
        self.flexure = flexure
        self.stress_model = stress_model
        self.coordinates = require_choice(
            "`coordinates`", coordinates, ("twistor", "twist")
        )
        if error := self.validation_error():
            raise ValueError(f"A `Quadratic` energy cannot be created: {error}")

    def validation_error(self) -> str | None:
        """Describe an invalid stiffness; None if it is valid."""
        return matrix_error("stiffness", self.stiffness)

    def stored_energy(self, displacement: Displacement) -> Scalar:
        return half_square(self.stiffness, strain(displacement, self.coordinates))

    def range_share(self, displacement: Displacement) -> Scalar | None:
        """Compute the share of a displacement in that at which a leaf errs by 5 %.

        Forces and moments of a leaf without axial force were compared with the elastica,
        for all ratios of rotation and transverse displacement. Those of the energies of
        twist and twistor differ by 5 % outside an ellipse with the half axes 0.35 rad and
        0.15 lengths. The axial force n changes the transverse stiffness of a leaf by
        `6/5 n / length`, which is 5 % at `n = 0.5 E I / length^2`. A notch is compared
        with the leaf that has the same ratio of rotational and transverse stiffness.
        """
        length = self.flexure_length
        if length is None:
            return None
        rotational = self.stiffness[0, 0]
        across = 2 * displacement.x2 / (0.15 * length)
        bending = jnp.sqrt((displacement.angle / 0.35) ** 2 + across**2)
        of_strain = strain(displacement, self.coordinates)
        force = sum(self.stiffness[1, k] * of_strain[k] for k in range(3))
        return jnp.maximum(bending, jnp.abs(force) * length / (0.5 * rotational))

    @property
    def is_unloaded(self) -> bool:
        return True

    @property
    def flexure_length(self) -> Scalar | None:
        """Length of a leaf with the same ratio of stiffnesses; None if no flexure; m."""
        if not self.flexure:
            return None
        xp, (stiffness,) = on_host(self.stiffness)
        return as_float(xp.sqrt(12 * stiffness[..., 0, 0] / stiffness[..., 2, 2]))

    def dilated(self, scale: Float[Array, "*batch"]) -> "Quadratic":
        """Return the energy if all dimensions of a flexure are multiplied."""
        if not self.flexure:
            return self
        return multiply_fields(self, scale, stiffness=[[3, 2, 2], [2, 1, 1], [2, 1, 1]])

    def proportional_damping(self, time: Scalar) -> ViscousDamping:
        """Multiply the stiffness by a time (s).

        This formula avoids second derivatives of the energy, which would take a third of
        the compilation time of a motion.
        """
        return ViscousDamping(time * self.stiffness)
