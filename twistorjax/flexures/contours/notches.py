"""Necks between two notches whose sides are ellipses, power functions, or V-shaped."""

from typing import Any

import numpy as np

from ..._utils.host import as_float, on_host
from ..._utils.types import NumberLike, Scalar
from ..._utils.validation import require_interval, require_length
from ...energies.quadratic import Quadratic
from ...energies.strains import Coordinates
from ...mechanism.material import Material
from ..limits import require_ratio, require_slender, Theory
from .contour import arc_integrals, Contour, Integrals, square_root


_EXPONENTS = (2.0, 16.0)
_LARGEST_ANGLE = 5 * np.pi / 6


class AbstractNotch(Contour):
    """A neck between two notches of the same depth, whose sides are smooth curves."""

    web: Scalar
    depth: Scalar

    def require_beam(self, theory: Theory) -> Scalar:
        depth = require_ratio(
            "`depth / length`",
            self.depth,
            self.length,
            0.5,
            "the formula of a beam is valid up to 0.5",
        )
        web = require_ratio(
            "`web / depth`",
            self.web,
            depth,
            20.0,
            "the formula is valid up to 20. For a shallower notch, use `leaf`",
        )
        return require_slender("`web / length`", web, self.length, theory)


class EllipticalNotch(AbstractNotch):
    """The neck between two half ellipses."""

    def values(self, xp: Any, position: Any) -> Any:
        root = square_root(xp, 1 - (2 * position / self.length) ** 2)
        return self.web + 2 * self.depth * (1 - root)

    def half_integrals(self, xp: Any) -> Integrals:
        arc = arc_integrals(xp, self.web / (2 * self.depth), xp.pi / 2)
        aspect = self.length / (4 * self.depth)
        return Integrals(
            aspect / (2 * self.depth) ** 2 * arc.bending,
            aspect * arc.axial,
            aspect**3 * arc.second,
        )


def elliptical_notch_profile(
    *, length: NumberLike, web: NumberLike, depth: NumberLike
) -> Contour:
    """Return the thickness of the neck between two half ellipses.

    One semi-axis is half of the length, along axis 1. The other is the depth. With equal
    semi-axes this is `notch_profile`. With a `Beam` of 48 steps, the relative error of
    the stiffness is below 1e-8 for web / depth from 0.02 up. With the default of 16 steps
    it is up to 1e-4. The stress concentration at the neck is not included.

    Args:
        length: Length along axis 1, which is the length of one axis of the ellipses; m.
        web: Smallest thickness of the neck; m.
        depth: Depth of each of the two notches; m.

    Returns:
        The thickness (m) as a function of the position along axis 1 (m). At both ends it
        is `web + 2 depth`.

    Raises:
        ValueError: A dimension is not positive.

    Example:
        >>> import jax.numpy as jnp
        >>> thickness = elliptical_notch_profile(length=20e-3, web=0.5e-3, depth=4e-3)
        >>> thickness(jnp.array(0.0)), thickness(jnp.array(10e-3))
        (Array(0.0005, dtype=float64), Array(0.0085, dtype=float64))
    """
    return EllipticalNotch(
        require_length("`length`", length),
        require_length("`web`", web),
        require_length("`depth`", depth),
    )


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
    contour = elliptical_notch_profile(length=length, web=web, depth=depth)
    return contour.energy(material, width, theory, coordinates)


class PowerLawNotch(AbstractNotch):
    """A neck whose two sides are power functions."""

    exponent: Scalar

    def values(self, xp: Any, position: Any) -> Any:
        share = xp.abs(2 * position / self.length) ** self.exponent
        return self.web + 2 * self.depth * share

    def half_integrals(self, xp: Any) -> Integrals:
        """Integrate over half of the length if the exponent is 2."""
        # The thickness is `web (1 + r u^2)` with `u` from 0 to 1. These are the integrals
        # of the powers -1, -2 and -3 of the parenthesis; the last has the factor u^2.
        r = 2 * self.depth / self.web
        first = xp.arctan(xp.sqrt(r)) / xp.sqrt(r)
        second = (1 / (1 + r) + first) / 2
        third = (1 / (1 + r) ** 2 + 3 * second) / 4
        half = self.length / 2
        return Integrals(
            half / self.web**3 * third,
            half / self.web * first,
            (half / self.web) ** 3 * (second - third) / r,
        )


def power_law_notch_profile(
    *,
    length: NumberLike,
    web: NumberLike,
    depth: NumberLike,
    exponent: NumberLike = 2.0,
) -> Contour:
    """Return the thickness of a neck whose two sides are power functions.

    The thickness is `web + 2 depth |2 x / length|^exponent`. With the exponent 2 the
    sides are parabolas. A high exponent approaches a leaf with rounded corners. With a
    `Beam` of 48 steps, the relative error of the stiffness is below 3e-7 for web / depth
    from 0.02 up. With the default of 16 steps it is up to 4e-4. The stress
    concentration at the neck is not included.

    Args:
        length: Length along axis 1; m.
        web: Smallest thickness of the neck; m.
        depth: Depth of each of the two notches; m.
        exponent: Exponent, from 2 to 16.

    Returns:
        The thickness (m) as a function of the position along axis 1 (m). At both ends it
        is `web + 2 depth`.

    Raises:
        ValueError: A dimension is not positive, or the exponent is outside its range.
            Below 2 the neck has a kink or an infinite curvature.

    Source:
        Linss, Erbe and Zentner, On polynomial flexure hinges for increased deflection and
        an approach for simplified manufacturing, IFToMM World Congress (2011).

    Example:
        >>> import jax.numpy as jnp
        >>> thickness = power_law_notch_profile(
        ...     length=20e-3, web=0.5e-3, depth=4e-3, exponent=4
        ... )
        >>> thickness(jnp.array(0.0)), thickness(jnp.array(5e-3))
        (Array(0.0005, dtype=float64), Array(0.001, dtype=float64))
    """
    low, high = _EXPONENTS
    return PowerLawNotch(
        require_length("`length`", length),
        require_length("`web`", web),
        require_length("`depth`", depth),
        require_interval(
            "`exponent`",
            exponent,
            low * (1 - 1e-12),
            high * (1 + 1e-12),
            f"must be from {low:g} to {high:g}",
        ),
    )


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
    contour = power_law_notch_profile(length=length, web=web, depth=depth)
    return contour.energy(material, width, theory, coordinates)


class VNotch(Contour):
    """The neck between two arcs with tangent flanks."""

    web: Scalar
    radius: Scalar
    angle: Scalar

    def values(self, xp: Any, position: Any) -> Any:
        distance = xp.abs(position)
        on_arc = xp.minimum(distance, self.radius * xp.cos(self.angle / 2))
        height = self.radius - xp.sqrt(self.radius**2 - on_arc**2)
        on_flank = (distance - on_arc) / xp.tan(self.angle / 2)
        return self.web + 2 * height + 2 * on_flank

    def half_integrals(self, xp: Any) -> Integrals:
        radius, arc_angle = self.radius, (xp.pi - self.angle) / 2
        arc = arc_integrals(xp, self.web / (2 * radius), arc_angle)
        slope = 2 / xp.tan(self.angle / 2)  # of the thickness on the flanks
        begin = radius * xp.sin(arc_angle)
        thin = self.web + 2 * radius * (1 - xp.cos(arc_angle))
        thick = thin + slope * (self.length / 2 - begin)
        # On the flanks the position is `(h + offset) / slope`.
        offset = slope * begin - thin
        logarithm = xp.log(thick / thin)
        squares = (1 / thin**2 - 1 / thick**2) / 2
        return Integrals(
            arc.bending / (8 * radius**2) + squares / slope,
            arc.axial / 2 + logarithm / slope,
            arc.second / 8
            + (logarithm + 2 * offset * (1 / thin - 1 / thick) + offset**2 * squares)
            / slope**3,
        )

    def require_beam(self, theory: Theory) -> Scalar:
        _, (radius,) = on_host(self.radius)
        return require_slender(
            "`web / (2 radius)`", self.web, as_float(2 * radius), theory
        )


def v_notch_profile(
    *, length: NumberLike, web: NumberLike, radius: NumberLike, angle: NumberLike
) -> Contour:
    """Return the thickness of the neck between two V-shaped notches with round roots.

    The root is a circular arc that is tangent to two straight flanks. If the angle tends
    to zero and the radius is half of the length, this is `notch_profile`.

    With a `Beam` of 48 steps, the relative error of the stiffness is at most 3e-5 for a
    radius from a tenth of the length up. A radius of a fiftieth of the length needs more
    steps: the error is up to 1e-3 with 96 steps and 1e-4 with 200. The stress
    concentration at the root is not included. It is large if the radius is smaller than
    the web.

    Args:
        length: Length along axis 1; m.
        web: Smallest thickness of the neck; m.
        radius: Radius of the roots; m.
        angle: Angle between the two flanks of one notch, from 0 to pi; rad.

    Returns:
        The thickness (m) as a function of the position along axis 1 (m).

    Raises:
        ValueError: A dimension is not positive, the angle is outside its range, or the
            arc, which has the chord `2 radius cos(angle / 2)`, is longer than the length.

    Example:
        >>> import jax.numpy as jnp
        >>> right_angle = np.pi / 2
        >>> thickness = v_notch_profile(
        ...     length=20e-3, web=0.5e-3, radius=2e-3, angle=right_angle
        ... )
        >>> thickness(jnp.array(0.0)), thickness(jnp.array(10e-3)).round(6)
        (Array(0.0005, dtype=float64), Array(0.018843, dtype=float64))
    """
    length, web = require_length("`length`", length), require_length("`web`", web)
    angle = require_interval("`angle`", angle, 0.0, np.pi, "must be from 0 to pi")
    xp, (whole, half_angle) = on_host(length, angle)
    radius = require_ratio(
        "`2 radius cos(angle / 2) / length`",
        require_length("`radius`", radius),
        as_float(whole / (2 * xp.cos(half_angle / 2))),
        1.0,
        "must be at most 1. Use a smaller radius, a larger angle, or a longer neck",
    )
    return VNotch(length, web, radius, angle)


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
    angle = require_interval(
        "`angle`", angle, 0.0, _LARGEST_ANGLE * (1 + 1e-12), "must be from 0 to 5/6 pi"
    )
    contour = v_notch_profile(length=length, web=web, radius=radius, angle=angle)
    return contour.energy(material, width, theory, coordinates)
