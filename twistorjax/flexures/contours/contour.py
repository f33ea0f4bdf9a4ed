"""A contour of a flexure: its thickness along the axis, and its stiffness in closed form.

The stiffness follows from the integrals of the bending compliance `12 / (E w h^3)` and of
the axial compliance `1 / (E w h)` of a beam with the thickness `h` and the width `w`.
"""

from abc import abstractmethod
from typing import Any, NamedTuple

from ..._utils.host import as_float, tree_on_host
from ..._utils.types import NumberLike, Scalar
from ..._utils.validation import require_instance, require_length
from ...energies.quadratic import Quadratic
from ...energies.strains import Coordinates
from ...energies.stress_model import AbstractStressModel
from ...mechanism.material import Material
from ..beams.beam import AbstractProfile, Beam
from ..beams.stress_models import BeamStress
from ..limits import nan_where_nan, SHEAR_FACTOR, Theory


Number = Any  # array of NumPy or JAX


class Integrals(NamedTuple):
    """Integrals of powers of the thickness `h` over half of the length."""

    bending: Number  # Integral of `1 / h^3`; 1/m2
    axial: Number  # Integral of `1 / h`
    transverse: Number  # Integral of `x^2 / h^3`, with `x` from the middle


class Contour(AbstractProfile):
    """The thickness of a flexure along its axis; m.

    It is symmetric about the middle, so the rotation about the middle, the axial and the
    transverse displacement are decoupled there.
    """

    length: Scalar

    @abstractmethod
    def half_integrals(self, xp: Any) -> Integrals:
        """Integrate over half of the length, with the functions of NumPy or JAX."""

    @abstractmethod
    def require_beam(self, theory: Theory) -> Scalar:
        """Return the smallest thickness; check that a theory of beams is valid for it; m.

        It is NaN if a traced dimension is out of range.
        """

    def stress_model(self, material: Material, width: Scalar) -> AbstractStressModel:
        """Create the stress model of a flexure with this contour and a width (m)."""
        beam = Beam(material, length=self.length, thickness=self, width=width)
        return BeamStress.of(beam)

    def energy(
        self,
        material: Material,
        width: NumberLike,
        theory: Theory,
        coordinates: Coordinates,
    ) -> Quadratic:
        """Create the energy of a flexure with this contour and a width (m)."""
        thinnest = self.require_beam(theory)
        require_instance("material", material, Material)
        width = require_length("`width`", width, material.modulus)
        xp, (contour, modulus, poisson, host_width) = tree_on_host(
            (self, material.modulus, material.poisson, width)
        )
        half = contour.half_integrals(xp)
        compliances = [24 * half.bending, 2 * half.axial, 24 * half.transverse]
        if theory == "timoshenko":
            shear = 2 * (1 + poisson) / SHEAR_FACTOR * compliances[1]
            compliances[2] = compliances[2] + shear
        stiffness = as_float(xp.diag(modulus * host_width / xp.stack(compliances)))
        return Quadratic(
            nan_where_nan(thinnest, stiffness),
            coordinates,
            flexure=True,
            stress_model=self.stress_model(material, width),
        )


class Arc(NamedTuple):
    """Integrals over an arc, dimensionless.

    The position is `sin(phi)` and the thickness is `1 + r - cos(phi)`, where `r` is the
    smallest thickness over the diameter of the arc.
    """

    axial: Number  # Integral of the power -1 of the thickness
    bending: Number  # Integral of the power -3
    first: Number  # Integral of the power -3 times the position
    second: Number  # Integral of the power -3 times the square of the position


def arc_integrals(xp: Any, r: Number, angle: Number) -> Arc:
    """Integrate over an arc from its thinnest section to an angle (rad); see `Arc`."""
    # The integrals of the powers -1, -2 and -3 of the thickness over the angle. The
    # second and the third follow from the derivative of sin / thickness^n.
    a = 1 + r
    square = r * (2 + r)
    thickness = a - xp.cos(angle)
    ratio = xp.sin(angle) / thickness
    one = 2 / xp.sqrt(square) * xp.arctan(xp.sqrt((2 + r) / r) * xp.tan(angle / 2))
    two = (a * one + ratio) / square
    three = (3 * a * two - one + ratio / thickness) / (2 * square)
    return Arc(
        axial=a * one - angle,
        bending=a * three - two,
        first=1 / thickness - 1 / r - a / 2 * (1 / thickness**2 - 1 / r**2),
        second=angle - a * square * three + (3 * a**2 - 1) * two - 3 * a * one,
    )


def square_root(xp: Any, square: Number) -> Number:
    """Compute a square root without derivative at zero, and zero below it."""
    # Rounding may put the ends of a beam outside of the contour.
    inside = square > 0
    return xp.where(inside, xp.sqrt(xp.where(inside, square, 1.0)), 0.0)
