"""Leaf hinges: slender straight beams of constant cross-section, cut from a plate."""

import numpy as np

from .._utils.host import as_float, on_host
from .._utils.types import Corners, NumberLike, Scalar
from .._utils.validation import require_choice, require_instance, require_length
from ..energies.beam_column import BeamColumn
from ..energies.mixed import MixedEnergy
from ..energies.quadratic import Quadratic
from ..energies.strains import Coordinates
from ..mechanism.material import Material
from .beams.beam import outline_along
from .beams.stress_models import BeamColumnStress, SectionStress
from .limits import require_slender, SHEAR_FACTOR, Theory


def leaf(
    material: Material,
    *,
    length: NumberLike,
    thickness: NumberLike,
    width: NumberLike,
    theory: Theory = "euler-bernoulli",
) -> BeamColumn:
    """Create the energy of a leaf hinge as a beam-column.

    Its frame is at the middle of the leaf, with axis 1 along the leaf. The energy is
    exact in the axial force, so it includes the change of the transverse stiffness by
    tension and compression, buckling, the shortening of the bent leaf, and its axial
    compliance. Terms of the fourth order extend it to rotations up to 0.8 rad, or
    transverse displacements up to a quarter of the length; `BeamColumn` has the errors.
    A solution with larger ones is out of range: use `surrogate` of a `Beam`. The leaf has
    no mass; `chain` divides it into segments that have.

    Args:
        material: Material of the plate.
        length: Free length along axis 1, without the clamped parts; m.
        thickness: In-plane thickness across axis 1; m.
        width: Out-of-plane width, which is the thickness of the plate; m.
        theory: "euler-bernoulli" for bending only, as in the dissertation, or
            "timoshenko" for bending and shear, with the shear correction factor 5/6.

    Returns:
        The energy of rotation, transverse displacement, and axial force.

    Raises:
        ValueError: A dimension is not positive, or the thickness exceeds a tenth of the
            length ("euler-bernoulli") or a quarter of it ("timoshenko"). At a tenth,
            shear increases the transverse compliance by 3 %.

    Source:
        See `BeamColumn`. The stiffness of the undeformed leaf is that of equation 5.8 of
        the dissertation.

    Example:
        >>> polymer = Material(modulus=3.45e9, poisson=0.3)
        >>> energy = leaf(polymer, length=10e-3, thickness=1e-3, width=5e-3)
        >>> energy.tangent_stiffness().diagonal()
        Array([1.4375e-01, 1.7250e+06, 1.7250e+04], dtype=float64)
    """
    length, thickness, width = _require_dimensions(
        material, length, thickness, width, theory
    )
    bending, axial, shear = _section_stiffnesses(material, thickness, width)
    has_shear = theory == "timoshenko"
    return BeamColumn(
        length,
        bending,
        axial,
        shear if has_shear else None,
        stress_model=BeamColumnStress(
            length=length,
            thickness=thickness,
            width=width,
            modulus=material.modulus,
            strengths=material.strengths,
            shear_ratio=as_float(shear / axial) if has_shear else None,
            shear_modulus=material.shear_modulus,
        ),
    )


def linear_leaf(
    material: Material,
    *,
    length: NumberLike,
    thickness: NumberLike,
    width: NumberLike,
    theory: Theory = "euler-bernoulli",
    coordinates: Coordinates = "twistor",
) -> Quadratic:
    """Create the quadratic energy of a leaf hinge, which is linear in its displacement.

    Its frame is at the middle of the leaf, with axis 1 along the leaf. In this frame the
    stiffness is diagonal. The energy is accurate for small displacements under small
    axial forces only: an axial force of `0.5 E I / length^2` changes the transverse
    stiffness of a leaf by 5 %, and this energy has neither this change nor buckling. The
    solvers warn if a displacement or an axial force causes an error above 5 %. Use
    `leaf` unless you need the energy of the dissertation.

    Args:
        material: Material of the plate.
        length: Free length along axis 1, without the clamped parts; m.
        thickness: In-plane thickness across axis 1; m.
        width: Out-of-plane width, which is the thickness of the plate; m.
        theory: "euler-bernoulli" for bending only, as in the dissertation, or
            "timoshenko" for bending and shear, with the shear correction factor 5/6.
        coordinates: Coordinates of the energy. With "twist", the moment in a pure
            rotation is proportional to the angle, as in a leaf that is bent by a pure
            moment. With "twistor" it is proportional to the sine of the angle, so it does
            not exceed E I / length. Neither energy includes that frame b of a leaf that
            is bent to an arc moves by `length angle^2 / 12` along axis 1; see `leaf`.

    Returns:
        The energy, whose stiffness is that of the undeformed leaf.

    Raises:
        ValueError: A dimension is not positive, or the thickness exceeds a tenth of the
            length ("euler-bernoulli") or a quarter of it ("timoshenko"). At a tenth,
            shear increases the transverse compliance by 3 %.

    Source:
        Equation 5.8 of the dissertation and its listing `cant_stiff`, where the axial
        direction is axis 2. Shear correction factor: Cowper (1966), for a Poisson's ratio
        of zero.

    Example:
        >>> polymer = Material(modulus=3.45e9, poisson=0.3)
        >>> energy = linear_leaf(polymer, length=10e-3, thickness=1e-3, width=5e-3)
        >>> energy.stiffness.diagonal()
        Array([1.4375e-01, 1.7250e+06, 1.7250e+04], dtype=float64)
    """
    require_choice("`coordinates`", coordinates, ("twistor", "twist"))
    length, thickness, width = _require_dimensions(
        material, length, thickness, width, theory
    )
    bending, axial, shear = _section_stiffnesses(material, thickness, width)
    xp, (length, bending, axial, shear) = on_host(length, bending, axial, shear)
    compliance = length**3 / (12 * bending)
    if theory == "timoshenko":
        compliance = compliance + length / shear
    stiffness = xp.diag(xp.stack([bending / length, axial / length, 1 / compliance]))
    return Quadratic(
        as_float(stiffness),
        coordinates,
        flexure=True,
        stress_model=SectionStress.of_leaf(
            material.strengths,
            length,
            thickness,
            width,
            (material.modulus, material.shear_modulus),
        ),
    )


def quartic_leaf(
    material: Material,
    *,
    length: NumberLike,
    thickness: NumberLike,
    width: NumberLike,
    theory: Theory = "euler-bernoulli",
) -> MixedEnergy:
    """Create the energy of a leaf hinge up to the fourth order of its displacement.

    It is `leaf` to the first order in the axial force, a polynomial with five terms. The
    error of the transverse stiffness is 5 % at an axial force of -8.17 or 84.3 times
    `E I / length^2`, and the solvers warn of larger errors. If a leaf is divided into
    several such hinges in series, the error decreases with the fourth power of their
    number.

    Args:
        material: Material of the plate.
        length: Free length along axis 1, without the clamped parts; m.
        thickness: In-plane thickness across axis 1; m.
        width: Out-of-plane width, which is the thickness of the plate; m.
        theory: "euler-bernoulli" or "timoshenko", as for `leaf`.

    Returns:
        The energy of rotation, transverse displacement, and axial force.

    Raises:
        ValueError: As for `leaf`.

    Source:
        Second-order kinematics of a beam. In a leaf that is bent to an arc, frame b moves
        by `length angle^2 / 12` along axis 1, because each frame is fixed to one end. If
        frame b is displaced by `t2` without rotation, the leaf is a cubic parabola and
        frame b moves by `-3 t2^2 / (5 length)` along axis 1.

    Example:
        >>> polymer = Material(modulus=3.45e9, poisson=0.3)
        >>> energy = quartic_leaf(polymer, length=10e-3, thickness=1e-3, width=5e-3)
        >>> energy.tangent_stiffness().diagonal()
        Array([1.4375e-01, 1.7250e+06, 1.7250e+04], dtype=float64)
    """
    quadratic = linear_leaf(
        material, length=length, thickness=thickness, width=width, theory=theory
    )
    xp, (stiffness, length) = on_host(quadratic.stiffness, length)
    bending, axial, transverse = xp.diag(stiffness)
    force = bending / length
    terms = {
        (2, 0, 0): bending / 2,
        (0, 2, 0): transverse * length**2 / 2,
        (0, 2, 1): 3 / 5 * bending,
        (2, 0, 1): -bending / 12,
        (0, 0, 2): -(force**2) / (2 * axial),
    }
    coefficients = as_float(xp.stack(list(terms.values())))
    return MixedEnergy(
        coefficients,
        tuple(terms),
        length=length,
        force=force,
        flexure=True,
        stress_model=quadratic.stress_model,
    )


def _require_dimensions(
    material: Material,
    length: NumberLike,
    thickness: NumberLike,
    width: NumberLike,
    theory: Theory,
) -> tuple[Scalar, Scalar, Scalar]:
    """Check the dimensions of a leaf and its theory, and return the dimensions; m."""
    modulus = require_instance("material", material, Material).modulus
    length = require_length("`length`", length, modulus)
    other_theory = "" if theory == "timoshenko" else ', or theory="timoshenko"'
    thickness = require_slender(
        "`thickness / length`",
        require_length("`thickness`", thickness, modulus),
        length,
        theory,
        f". Use a thinner or longer leaf{other_theory}",
    )
    return length, thickness, require_length("`width`", width, modulus)


def _section_stiffnesses(
    material: Material, thickness: Scalar, width: Scalar
) -> tuple[NumberLike, NumberLike, NumberLike]:
    """Compute the stiffnesses in bending, tension, and shear; N m^2, N, N."""
    _, (modulus, poisson, thickness, width) = on_host(
        material.modulus, material.poisson, thickness, width
    )
    axial = modulus * width * thickness
    shear = SHEAR_FACTOR * axial / (2 * (1 + poisson))
    return axial * thickness**2 / 12, axial, shear


def leaf_outline(
    *, length: NumberLike, thickness: NumberLike, points: int = 24
) -> Corners:
    """Compute the outline of a leaf in its frame, for drawing.

    Args:
        length: Free length along axis 1; m.
        thickness: In-plane thickness across axis 1; m.
        points: Number of points on each side.

    Returns:
        The corners of the outline; m.
    """
    _, (length, thickness) = on_host(length, thickness)
    position = np.linspace(-0.5, 0.5, points) * length
    return outline_along(position, np.ones(points) * thickness)
