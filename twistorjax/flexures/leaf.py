"""Leaf hinges: slender straight beams of constant cross-section, cut from a plate."""

from typing import Literal

import numpy as np

from .._utils.host import as_float, on_host
from .._utils.types import Corners, NumberLike
from .._utils.validation import (
    require_choice,
    require_instance,
    require_interval,
    require_positive,
)
from ..energies.mixed import MixedEnergy
from ..energies.quadratic import Quadratic
from ..energies.strains import Coordinates
from ..mechanism.material import Material
from .stress_models import SectionStress


Theory = Literal["euler-bernoulli", "timoshenko"]


def leaf(
    material: Material,
    *,
    length: NumberLike,
    thickness: NumberLike,
    width: NumberLike,
    theory: Theory = "euler-bernoulli",
    coordinates: Coordinates = "twistor",
) -> Quadratic:
    """Create the quadratic energy of a leaf hinge.

    Its frame is at the middle of the leaf, with axis 1 along the leaf. In this frame the
    stiffness is diagonal. The energy is accurate for small rotations; use `quartic_leaf`
    or `surrogate` for larger ones.

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
            is bent to an arc moves by `length angle^2 / 12` along axis 1; see
            `quartic_leaf`.

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
        >>> energy = leaf(polymer, length=10e-3, thickness=1e-3, width=5e-3)
        >>> energy.stiffness.diagonal()
        Array([1.4375e-01, 1.7250e+06, 1.7250e+04], dtype=float64)
    """
    require_instance("material", material, Material)
    require_choice("`theory`", theory, ("euler-bernoulli", "timoshenko"))
    _, (length, thickness) = on_host(
        require_positive("`length`", length), require_positive("`thickness`", thickness)
    )
    limit = 0.25 if theory == "timoshenko" else 0.1
    slenderness = require_interval(
        "`thickness / length`",
        thickness / length,
        0.0,
        limit * (1 + 1e-12),  # The quotient 0.3 mm / 3 mm is not exactly 0.1.
        f"the theory {theory!r} is valid up to {limit:g}. Use a thinner or longer leaf"
        + ("" if theory == "timoshenko" else ', or theory="timoshenko"'),
    )
    xp, (modulus, poisson, length, width, slenderness) = on_host(
        material.modulus,
        material.poisson,
        length,
        require_positive("`width`", width),
        slenderness,
    )
    area = width * slenderness * length
    second_moment = area * (slenderness * length) ** 2 / 12
    bending = modulus * second_moment / length
    transverse_compliance = length**2 / (12 * bending)
    if theory == "timoshenko":
        shear_modulus = modulus / (2 * (1 + poisson))
        shear_compliance = length / (shear_modulus * area * 5 / 6)
        transverse_compliance = transverse_compliance + shear_compliance
    diagonal = [bending, modulus * area / length, 1 / transverse_compliance]
    return Quadratic(
        as_float(xp.diag(xp.stack(diagonal))),
        coordinates,
        flexure=True,
        stress_model=SectionStress.of_leaf(
            material.strengths, length, slenderness * length, width
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

    It has the stiffness of `leaf`, and it includes that the ends of a leaf approach each
    other when the leaf bends. A transverse force of `E I / length^2` on the end of a
    cantilever gives displacements with an error of 0.3 % (16 % with `leaf`). For given
    displacements with rotations up to 20 degrees, the least accurate component of the
    wrench has an error of 40 % (1400 % with `leaf`; thickness / length = 0.1). If a leaf
    is divided into several such hinges in series, the error decreases with the fourth
    power of their number.

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
    quadratic = leaf(
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
        stress_model=quadratic.stress_model,
    )


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
    xp, (length, thickness) = on_host(length, thickness)
    x = np.linspace(-0.5, 0.5, points) * length
    y = np.full(points, 0.5) * thickness
    return as_float(xp.concatenate([xp.stack([x, y], 1), xp.stack([x, -y], 1)[::-1]]))
