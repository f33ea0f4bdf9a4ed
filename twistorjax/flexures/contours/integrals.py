"""Stiffness of a beam of variable thickness from integrals over its length."""

from collections.abc import Callable
from typing import Any, NamedTuple

from ..._utils.host import as_float, on_host
from ..._utils.types import NumberLike, Scalar
from ..._utils.validation import require_instance, require_length
from ...energies.quadratic import Quadratic
from ...energies.strains import Coordinates
from ...energies.stress_model import AbstractStressModel
from ...mechanism.material import Material
from ..beams.beam import Beam
from ..beams.stress_models import BeamStress
from ..leaf import Theory


Number = Any  # array of NumPy or JAX


class Integrals(NamedTuple):
    """Integrals of powers of the thickness `h` over half of the length."""

    bending: Number  # Integral of `1 / h^3`; 1/m2
    axial: Number  # Integral of `1 / h`
    transverse: Number  # Integral of `x^2 / h^3`, with `x` from the middle


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
    """Integrate over an arc from its thinnest section to an angle (rad).

    Args:
        xp: Module with the functions, NumPy or `jax.numpy`.
        r: Smallest thickness over the diameter of the arc.
        angle: Angle of the arc; rad.
    """
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


def quadratic_energy(
    material: Material,
    width: NumberLike,
    half: Integrals,
    theory: Theory,
    coordinates: Coordinates,
    stress_model: AbstractStressModel,
) -> Quadratic:
    """Create the energy of a flexure from the integrals over half of its length.

    Args:
        width: Out-of-plane width; m.
        theory: "euler-bernoulli" or "timoshenko".
    """
    require_instance("material", material, Material)
    xp, (modulus, poisson, width, bending, axial, transverse) = on_host(
        material.modulus, material.poisson, require_length("`width`", width), *half
    )
    compliances = [24 * bending, 2 * axial, 24 * transverse]
    if theory == "timoshenko":
        factor = 5 / 6
        compliances[2] = compliances[2] + 2 * (1 + poisson) / factor * compliances[1]
    stiffness = modulus * width / xp.stack(compliances)
    return Quadratic(
        as_float(xp.diag(stiffness)), coordinates, flexure=True, stress_model=stress_model
    )


def beam_energy(
    material: Material,
    length: NumberLike,
    profile: Callable[[Scalar], Scalar],
    width: NumberLike,
    half: Integrals,
    theory: Theory,
    coordinates: Coordinates,
) -> Quadratic:
    """Create the energy of a flexure with the stress model of a beam.

    Args:
        length: Length; m.
        profile: Thickness (m) as a function of the position along axis 1 (m).
        width: Out-of-plane width; m.
        theory: "euler-bernoulli" or "timoshenko".
    """
    require_instance("material", material, Material)
    beam = Beam(material, length=length, thickness=profile, width=width)
    stress = BeamStress.of(beam)
    return quadratic_energy(material, width, half, theory, coordinates, stress)
