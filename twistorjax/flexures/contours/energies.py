"""Stiffness in closed form of flexures with fillets, notches, or a reinforced middle.

The contours are those of `profiles`. Each formula integrates the bending compliance
`12 / (E w h^3)` and the axial compliance `1 / (E w h)` of a beam with the thickness `h`
and the width `w`. All contours are symmetric about their middle, so the rotation about
the middle, the axial and the transverse displacement are decoupled there.
"""

import numpy as np

from ..._utils.host import as_float, on_host
from ..._utils.types import NumberLike
from ..._utils.validation import require_interval, require_length
from ...energies.quadratic import Quadratic
from ...energies.strains import Coordinates
from ...mechanism.material import Material
from ..beams.stress_models import SectionStress
from ..leaf import Theory
from .integrals import arc_integrals, beam_energy, Integrals, quadratic_energy
from .limits import (
    require_arc,
    require_fillet,
    require_notch,
    require_reinforcement,
    require_slender,
)
from .profiles import (
    elliptical_notch_profile,
    filleted_leaf_profile,
    power_law_notch_profile,
    v_notch_profile,
)


_LARGEST_ANGLE = 5 * np.pi / 6


def filleted_leaf(
    material: Material,
    *,
    length: NumberLike,
    thickness: NumberLike,
    fillet: NumberLike,
    width: NumberLike,
    theory: Theory = "euler-bernoulli",
    coordinates: Coordinates = "twistor",
) -> Quadratic:
    """Create the quadratic energy of a leaf with circular fillets at its four corners.

    Its frame is at the middle of the leaf, with axis 1 along the leaf. The fillets are
    part of a beam, in which the stress is uniform or linear over each section; in a real
    fillet, the corners carry less stress. The thickness is `filleted_leaf_profile`.

    Args:
        material: Material of the plate.
        length: Free length along axis 1, including the fillets; m.
        thickness: In-plane thickness between the fillets; m.
        fillet: Radius of the fillets, at most half of the length; m.
        width: Out-of-plane width, which is the thickness of the plate; m.
        theory: "euler-bernoulli" for bending only, or "timoshenko" for bending and
            shear, with the shear correction factor 5/6. With shear, the stiffness is
            that of a `Beam`.
        coordinates: Coordinates of the energy; see `leaf`.

    Returns:
        The energy, whose stiffness is that of the undeformed leaf.

    Raises:
        ValueError: A dimension is not positive, the fillets do not fit into the length,
            or the thickness exceeds a tenth of the length ("euler-bernoulli") or a
            quarter of it ("timoshenko"). At a tenth, for a Poisson's ratio of 0.3, shear
            increases the transverse compliance by 3 % with small fillets, by 6 % with a
            radius of a fifth of the length, and by 38 % with half of the length.

    Source:
        Lobontiu, Paine, Garcia and Goldfarb, Corner-filleted flexure hinges, Journal of
        Mechanical Design 123 (2001). Their compliances are for loads at the end of the
        leaf; here they are for loads at the middle, from the same integrals.

    Example:
        >>> steel = Material(modulus=210e9, poisson=0.3)
        >>> energy = filleted_leaf(
        ...     steel, length=20e-3, thickness=0.5e-3, fillet=2e-3, width=10e-3
        ... )
        >>> energy.stiffness.diagonal()
        Array([1.27623813e+00, 5.79342767e+07, 5.18723846e+04], dtype=float64)
    """
    length = require_length("`length`", length)
    thickness = require_length("`thickness`", thickness)
    fillet = require_fillet(length, fillet)
    thickness = require_slender("`thickness / length`", thickness, length, theory)
    xp, (length, thickness, fillet) = on_host(length, thickness, fillet)
    straight = length / 2 - fillet
    arc = arc_integrals(xp, thickness / (2 * fillet), xp.pi / 2)
    fourth = 1 / (8 * fillet**2)  # of the square of the radius, over its fourth power
    integrals = Integrals(
        straight / thickness**3 + fourth * arc.bending,
        straight / thickness + arc.axial / 2,
        straight**3 / (3 * thickness**3)
        + straight**2 * fourth * arc.bending
        + straight / (4 * fillet) * arc.first
        + arc.second / 8,
    )
    profile = filleted_leaf_profile(length=length, thickness=thickness, fillet=fillet)
    return beam_energy(material, length, profile, width, integrals, theory, coordinates)


def elliptical_notch(
    material: Material,
    *,
    length: NumberLike,
    web: NumberLike,
    depth: NumberLike,
    width: NumberLike,
    theory: Theory = "euler-bernoulli",
    coordinates: Coordinates = "twistor",
) -> Quadratic:
    """Create the quadratic energy of the neck between two half ellipses.

    Its frame is at the middle of the neck, with axis 1 along the neck. One semi-axis of
    the ellipses is half of the length, the other is the depth. With equal semi-axes the
    stiffness is that of `notch` with the formula "paros-weisbord". The formula is that of
    a beam, in which the stress is uniform or linear over each section; see `notch` for
    the difference to finite elements. The thickness is `elliptical_notch_profile`.

    Args:
        material: Material of the plate.
        length: Length along axis 1, which is the length of one axis of the ellipses; m.
        web: Smallest thickness of the neck; m.
        depth: Depth of each of the two notches; m.
        width: Out-of-plane width, which is the thickness of the plate; m.
        theory: "euler-bernoulli" or "timoshenko", as for `filleted_leaf`.
        coordinates: Coordinates of the energy; see `leaf`.

    Returns:
        The energy, whose stiffness is that of the undeformed neck.

    Raises:
        ValueError: A dimension is not positive, the depth exceeds half of the length or
            is less than a twentieth of the web, or the web exceeds a tenth of the length
            ("euler-bernoulli") or a quarter of it ("timoshenko"). At a tenth, for a
            Poisson's ratio of 0.3, shear increases the transverse compliance by 10 % with
            a depth of a tenth of the length, and by 38 % with half of it.

    Source:
        Smith, Badami, Dale and Xu, Elliptical flexure hinges, Review of Scientific
        Instruments 68 (1997). The integrals are those of Paros and Weisbord (1965),
        because an ellipse is a scaled circle.

    Example:
        >>> steel = Material(modulus=210e9, poisson=0.3)
        >>> energy = elliptical_notch(
        ...     steel, length=20e-3, web=0.5e-3, depth=4e-3, width=10e-3
        ... )
        >>> energy.stiffness.diagonal()
        Array([5.33704059e+00, 1.25259074e+08, 1.49382987e+06], dtype=float64)
    """
    length, web, depth = require_notch(length, web, depth, theory)
    xp, (length, web, depth) = on_host(length, web, depth)
    arc = arc_integrals(xp, web / (2 * depth), xp.pi / 2)
    aspect = length / 2 / (2 * depth)
    integrals = Integrals(
        aspect / (2 * depth) ** 2 * arc.bending,
        aspect * arc.axial,
        aspect**3 * arc.second,
    )
    profile = elliptical_notch_profile(length=length, web=web, depth=depth)
    return beam_energy(material, length, profile, width, integrals, theory, coordinates)


def parabolic_notch(
    material: Material,
    *,
    length: NumberLike,
    web: NumberLike,
    depth: NumberLike,
    width: NumberLike,
    theory: Theory = "euler-bernoulli",
    coordinates: Coordinates = "twistor",
) -> Quadratic:
    """Create the quadratic energy of the neck between two parabolas.

    Its frame is at the middle of the neck, with axis 1 along the neck. The formula is
    that of a beam, in which the stress is uniform or linear over each section; see
    `notch` for the difference to finite elements. The thickness is
    `power_law_notch_profile` with the exponent 2.

    Args:
        material: Material of the plate.
        length: Length along axis 1; m.
        web: Smallest thickness of the neck; m.
        depth: Depth of each of the two notches; m.
        width: Out-of-plane width, which is the thickness of the plate; m.
        theory: "euler-bernoulli" or "timoshenko", as for `filleted_leaf`.
        coordinates: Coordinates of the energy; see `leaf`.

    Returns:
        The energy, whose stiffness is that of the undeformed neck.

    Raises:
        ValueError: A dimension is not positive, the depth exceeds half of the length or
            is less than a twentieth of the web, or the web exceeds a tenth of the length
            ("euler-bernoulli") or a quarter of it ("timoshenko"). At a tenth, for a
            Poisson's ratio of 0.3, shear increases the transverse compliance by 14 % with
            a depth of a tenth of the length, and by 70 % with half of it.

    Source:
        Lobontiu, Paine, O'Malley and Samuelson, Parabolic and hyperbolic flexure hinges,
        Precision Engineering 26 (2002), for loads at the middle of the neck.

    Example:
        >>> steel = Material(modulus=210e9, poisson=0.3)
        >>> energy = parabolic_notch(
        ...     steel, length=20e-3, web=0.5e-3, depth=4e-3, width=10e-3
        ... )
        >>> energy.stiffness.diagonal()
        Array([7.42939369e+00, 1.58392821e+08, 3.65194340e+06], dtype=float64)
    """
    length, web, depth = require_notch(length, web, depth, theory)
    xp, (length, web, depth) = on_host(length, web, depth)
    # The thickness is `web (1 + r u^2)` with `u` from 0 to 1. These are the integrals of
    # the powers -1, -2 and -3 of the parenthesis; the last has the factor u^2.
    r = 2 * depth / web
    first = xp.arctan(xp.sqrt(r)) / xp.sqrt(r)
    second = (1 / (1 + r) + first) / 2
    third = (1 / (1 + r) ** 2 + 3 * second) / 4
    half = length / 2
    integrals = Integrals(
        half / web**3 * third,
        half / web * first,
        (half / web) ** 3 * (second - third) / r,
    )
    profile = power_law_notch_profile(length=length, web=web, depth=depth, exponent=2.0)
    return beam_energy(material, length, profile, width, integrals, theory, coordinates)


def v_notch(
    material: Material,
    *,
    length: NumberLike,
    web: NumberLike,
    radius: NumberLike,
    angle: NumberLike,
    width: NumberLike,
    theory: Theory = "euler-bernoulli",
    coordinates: Coordinates = "twistor",
) -> Quadratic:
    """Create the quadratic energy of the neck between two V-notches with round roots.

    Its frame is at the middle of the neck, with axis 1 along the neck. The formula is
    that of a beam. It is not accurate for steep flanks, whose outer parts carry little
    stress: the steeper the flanks are, the more it overestimates the stiffness. The
    thickness is `v_notch_profile`.

    Args:
        material: Material of the plate.
        length: Length along axis 1; m.
        web: Smallest thickness of the neck; m.
        radius: Radius of the roots; m.
        angle: Angle between the two flanks of one notch, from 0 to 5/6 pi; rad.
        width: Out-of-plane width, which is the thickness of the plate; m.
        theory: "euler-bernoulli" or "timoshenko", as for `filleted_leaf`.
        coordinates: Coordinates of the energy; see `leaf`.

    Returns:
        The energy, whose stiffness is that of the undeformed neck.

    Raises:
        ValueError: A dimension is not positive, the angle is outside its range, the arc
            is longer than the length, or the web exceeds a tenth of the diameter of the
            arc ("euler-bernoulli") or a quarter of it ("timoshenko"). At a tenth, for a
            Poisson's ratio of 0.3, shear increases the transverse compliance by 11 to
            23 % at an angle of 150 degrees, by 34 % at 120 degrees, and by 37 to 50 % at
            60 and 90 degrees.

    Source:
        Tian, Shirinzadeh, Zhang and Zhong, Three flexure hinges for compliant mechanism
        designs based on dimensionless graph analysis, Precision Engineering 34 (2010), on
        filleted V-shaped hinges; here for loads at the middle of the neck.

    Example:
        >>> steel = Material(modulus=210e9, poisson=0.3)
        >>> energy = v_notch(
        ...     steel, length=20e-3, web=0.5e-3, radius=5e-3, angle=np.pi / 2, width=10e-3
        ... )
        >>> energy.stiffness.diagonal()
        Array([1.18827486e+01, 2.40952959e+08, 1.54366033e+07], dtype=float64)
    """
    length, web = require_length("`length`", length), require_length("`web`", web)
    angle = require_interval(
        "`angle`", angle, 0.0, _LARGEST_ANGLE * (1 + 1e-12), "must be from 0 to 5/6 pi"
    )
    radius = require_arc(length, radius, angle)
    _, (half_diameter,) = on_host(radius)
    diameter = as_float(2 * half_diameter)
    web = require_slender("`web / (2 radius)`", web, diameter, theory)
    xp, (length, web, radius, angle) = on_host(length, web, radius, angle)
    arc_angle = (xp.pi - angle) / 2
    arc = arc_integrals(xp, web / (2 * radius), arc_angle)
    slope = 2 / xp.tan(angle / 2)  # of the thickness on the flanks
    begin = radius * xp.sin(arc_angle)
    thin = web + 2 * radius * (1 - xp.cos(arc_angle))
    thick = thin + slope * (length / 2 - begin)
    # On the flanks the position is `(h + offset) / slope`.
    offset = slope * begin - thin
    logarithm = xp.log(thick / thin)
    squares = (1 / thin**2 - 1 / thick**2) / 2
    integrals = Integrals(
        arc.bending / (8 * radius**2) + squares / slope,
        arc.axial / 2 + logarithm / slope,
        arc.second / 8
        + (logarithm + 2 * offset * (1 / thin - 1 / thick) + offset**2 * squares)
        / slope**3,
    )
    profile = v_notch_profile(length=length, web=web, radius=radius, angle=angle)
    return beam_energy(material, length, profile, width, integrals, theory, coordinates)


def reinforced_leaf(
    material: Material,
    *,
    length: NumberLike,
    thickness: NumberLike,
    reinforced_length: NumberLike,
    reinforced_thickness: NumberLike,
    width: NumberLike,
    theory: Theory = "euler-bernoulli",
    coordinates: Coordinates = "twistor",
) -> Quadratic:
    """Create the quadratic energy of a leaf with a thicker middle section.

    Its frame is at the middle of the leaf, with axis 1 along the leaf. It consists of
    three leaves in series; the local deformation where the thickness changes is
    neglected, which is that of a fraction of the smaller thickness in length. The
    thickness is `reinforced_leaf_profile`.

    Args:
        material: Material of the plate.
        length: Free length along axis 1; m.
        thickness: In-plane thickness of the two thin end sections; m.
        reinforced_length: Length of the thick middle section; m.
        reinforced_thickness: In-plane thickness of the middle section, at least that of
            the end sections; m.
        width: Out-of-plane width, which is the thickness of the plate; m.
        theory: "euler-bernoulli" or "timoshenko", as for `filleted_leaf`.
        coordinates: Coordinates of the energy; see `leaf`.

    Returns:
        The energy, whose stiffness is that of the undeformed leaf.

    Raises:
        ValueError: A dimension is not positive, the middle section is not shorter than
            the leaf or is thinner than the end sections, or the smaller thickness exceeds
            a tenth of the length of both end sections together ("euler-bernoulli") or a
            quarter of it ("timoshenko"). At a tenth, shear increases the transverse
            compliance by less than 4 %.

    Source:
        Compliances of leaves in series. On reinforced leaf springs: van Eijk, On the
        design of plate-spring mechanisms, dissertation, Delft (1985).

    Example:
        >>> steel = Material(modulus=210e9, poisson=0.3)
        >>> energy = reinforced_leaf(
        ...     steel,
        ...     length=20e-3,
        ...     thickness=0.3e-3,
        ...     reinforced_length=14e-3,
        ...     reinforced_thickness=2e-3,
        ...     width=10e-3,
        ... )
        >>> energy.stiffness.diagonal()
        Array([7.81346893e-01, 7.77777778e+07, 1.07686969e+04], dtype=float64)
    """
    length = require_length("`length`", length)
    thickness = require_length("`thickness`", thickness)
    reinforced_thickness = require_reinforcement(thickness, reinforced_thickness)
    middle = require_length("`reinforced_length`", reinforced_length)
    _, (whole, middle) = on_host(length, middle)
    outer = require_interval(
        "`length - reinforced_length`", whole - middle, 0.0, np.inf, "must be positive"
    )
    name = "`thickness / (length - reinforced_length)`"
    thickness = require_slender(name, thickness, outer, theory)
    _, (length, middle, outer, thin, thick) = on_host(
        length, middle, outer, thickness, reinforced_thickness
    )
    integrals = Integrals(
        outer / (2 * thin**3) + middle / (2 * thick**3),
        outer / (2 * thin) + middle / (2 * thick),
        (length**3 - middle**3) / (24 * thin**3) + middle**3 / (24 * thick**3),
    )
    # The stress is largest at the ends of the thin sections.
    stress = SectionStress.of_leaf(material.strengths, length, thin, width)
    return quadratic_energy(material, width, integrals, theory, coordinates, stress)
