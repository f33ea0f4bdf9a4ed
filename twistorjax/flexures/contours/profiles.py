"""Contours of flexures: the thickness along the axis, for the model `Beam`.

Each function returns the thickness as a function of the position along axis 1. Use it as
the `thickness` of a `Beam` of the same length. `energies` has the stiffness of
these contours in closed form.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..._utils.host import as_float, on_host
from ..._utils.types import NumberLike, Numbers, Scalar
from ..._utils.validation import require_interval, require_length, require_positive
from ..beams.beam import elementwise
from .limits import nan_where_nan, require_arc, require_fillet, require_reinforcement


_EXPONENTS = (2.0, 16.0)


def filleted_leaf_profile(
    *, length: NumberLike, thickness: NumberLike, fillet: NumberLike
) -> jax.tree_util.Partial:
    """Return the thickness of a leaf with circular fillets at its four corners.

    With a `Beam` of 48 steps, the relative error of the stiffness is at most 5e-5. With
    the default of 16 steps it is up to 3e-3. Under a transverse force the largest stress
    is near the beginning of a fillet. `beam_under_load` finds it within 0.3 %. The stress
    concentration at the fillet is not included.

    Args:
        length: Free length along axis 1, including the fillets; m.
        thickness: In-plane thickness between the fillets; m.
        fillet: Radius of the fillets, at most half of the length; m.

    Returns:
        The thickness (m) as a function of the position along axis 1 (m). At both ends it
        is `thickness + 2 fillet`.

    Raises:
        ValueError: A dimension is not positive, or the fillets do not fit into the
            length.

    Example:
        >>> thickness = filleted_leaf_profile(length=20e-3, thickness=0.5e-3, fillet=2e-3)
        >>> thickness(jnp.array(8e-3)), thickness(jnp.array(10e-3))
        (Array(0.0005, dtype=float64), Array(0.0045, dtype=float64))
    """
    length = require_length("`length`", length)
    thickness = require_length("`thickness`", thickness)
    fillet = require_fillet(length, fillet)
    return jax.tree_util.Partial(_filleted_leaf, length, thickness, fillet)


def elliptical_notch_profile(
    *, length: NumberLike, web: NumberLike, depth: NumberLike
) -> jax.tree_util.Partial:
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
        >>> thickness = elliptical_notch_profile(length=20e-3, web=0.5e-3, depth=4e-3)
        >>> thickness(jnp.array(0.0)), thickness(jnp.array(10e-3))
        (Array(0.0005, dtype=float64), Array(0.0085, dtype=float64))
    """
    return jax.tree_util.Partial(
        _elliptical_notch,
        require_length("`length`", length),
        require_length("`web`", web),
        require_length("`depth`", depth),
    )


def power_law_notch_profile(
    *,
    length: NumberLike,
    web: NumberLike,
    depth: NumberLike,
    exponent: NumberLike = 2.0,
) -> jax.tree_util.Partial:
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
        >>> thickness = power_law_notch_profile(
        ...     length=20e-3, web=0.5e-3, depth=4e-3, exponent=4
        ... )
        >>> thickness(jnp.array(0.0)), thickness(jnp.array(5e-3))
        (Array(0.0005, dtype=float64), Array(0.001, dtype=float64))
    """
    low, high = _EXPONENTS
    return jax.tree_util.Partial(
        _power_law_notch,
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


def v_notch_profile(
    *, length: NumberLike, web: NumberLike, radius: NumberLike, angle: NumberLike
) -> jax.tree_util.Partial:
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
        >>> right_angle = np.pi / 2
        >>> thickness = v_notch_profile(
        ...     length=20e-3, web=0.5e-3, radius=2e-3, angle=right_angle
        ... )
        >>> thickness(jnp.array(0.0)), thickness(jnp.array(10e-3)).round(6)
        (Array(0.0005, dtype=float64), Array(0.018843, dtype=float64))
    """
    web = require_length("`web`", web)
    angle = require_interval("`angle`", angle, 0.0, np.pi, "must be from 0 to pi")
    radius = require_arc(require_length("`length`", length), radius, angle)
    return jax.tree_util.Partial(_v_notch, web, radius, angle)


def reinforced_leaf_profile(
    *,
    length: NumberLike,
    thickness: NumberLike,
    reinforced_length: NumberLike,
    reinforced_thickness: NumberLike,
    transition: NumberLike | None = None,
) -> jax.tree_util.Partial:
    """Return the thickness of a leaf with a thicker middle section.

    A `Beam` is integrated in steps that do not end where the thickness changes. An abrupt
    change may cause an error of 1 % even with 200 steps. Therefore the thickness changes
    smoothly over a short transition, such that the rotational stiffness is exactly that
    of an abrupt change. The transverse stiffness changes by less than 0.2 %. The axial
    compliance increases as if each of the two thin sections were longer, by 0.11 times
    the transition for a sixfold thickness and by at most 0.18 times.

    With the default transition, the relative error of the stiffness of a `Beam` is at
    most 2e-3 with 32 steps, 4e-4 with 64, and 4e-5 with 128. The largest stress of the
    end sections is found with any number of sections. The stress concentration at the
    transition is not included.

    Args:
        length: Free length along axis 1; m.
        thickness: In-plane thickness of the two thin end sections; m.
        reinforced_length: Length of the thick middle section, which is measured between
            the middles of the two transitions; m.
        reinforced_thickness: In-plane thickness of the middle section, at least that of
            the end sections; m.
        transition: Length of each of the two transitions; m. The default is length / 50.

    Returns:
        The thickness (m) as a function of the position along axis 1 (m).

    Raises:
        ValueError: A dimension is not positive, the middle section is thinner than the
            end sections, or the transitions do not fit into the sections.

    Example:
        >>> thickness = reinforced_leaf_profile(
        ...     length=20e-3,
        ...     thickness=0.3e-3,
        ...     reinforced_length=14e-3,
        ...     reinforced_thickness=2e-3,
        ... )
        >>> thickness(jnp.array(0.0)).round(6), thickness(jnp.array(10e-3)).round(6)
        (Array(0.002, dtype=float64), Array(0.0003, dtype=float64))
    """
    length = require_length("`length`", length)
    thickness = require_length("`thickness`", thickness)
    thick = require_reinforcement(thickness, reinforced_thickness)
    middle = require_length("`reinforced_length`", reinforced_length)
    _, (length, middle) = on_host(length, middle)
    transition = require_positive(
        "`transition`", length / 50 if transition is None else transition
    )
    _, (shift,) = on_host(transition)
    inner = require_interval(
        "`reinforced_length - transition`",
        middle - shift,
        0.0,
        np.inf,
        "must be positive. Use a shorter `transition`",
    )
    outer = require_interval(
        "`length - reinforced_length - transition`",
        length - middle - shift,
        0.0,
        np.inf,
        "must be positive. Use a shorter `transition` or `reinforced_length`",
    )
    inner = nan_where_nan(outer, inner)
    return jax.tree_util.Partial(_reinforced_leaf, thickness, thick, inner, transition)


# The thickness (m) at a position along axis 1 (m). The dimensions are those of the
# functions above; m, and rad for the angle.


@elementwise
def _filleted_leaf(
    length: Scalar, thickness: Scalar, fillet: Scalar, position: Numbers
) -> Numbers:
    """Compute the thickness from the distance to the nearest end of the leaf."""
    xp, (length, thickness, fillet, position) = on_host(
        length, thickness, fillet, position
    )
    distance = xp.minimum(length / 2 - xp.abs(position), fillet)
    depth = 2 * _sqrt(xp, distance * (2 * fillet - distance))
    return as_float(thickness + 2 * fillet - depth)


@elementwise
def _elliptical_notch(
    length: Scalar, web: Scalar, depth: Scalar, position: Numbers
) -> Numbers:
    """Compute the thickness between two half ellipses."""
    xp, (length, web, depth, position) = on_host(length, web, depth, position)
    root = _sqrt(xp, 1 - (2 * position / length) ** 2)
    return as_float(web + 2 * depth * (1 - root))


@elementwise
def _power_law_notch(
    length: Scalar, web: Scalar, depth: Scalar, exponent: Scalar, position: Numbers
) -> Numbers:
    """Compute the thickness between two power functions."""
    xp, (length, web, depth, exponent, position) = on_host(
        length, web, depth, exponent, position
    )
    return as_float(web + 2 * depth * xp.abs(2 * position / length) ** exponent)


@elementwise
def _v_notch(web: Scalar, radius: Scalar, angle: Scalar, position: Numbers) -> Numbers:
    """Compute the thickness between two arcs with tangent flanks."""
    xp, (web, radius, angle, position) = on_host(web, radius, angle, position)
    distance = xp.abs(position)
    on_arc = xp.minimum(distance, radius * xp.cos(angle / 2))
    height = radius - xp.sqrt(radius**2 - on_arc**2)
    on_flank = (distance - on_arc) / xp.tan(angle / 2)
    return as_float(web + 2 * height + 2 * on_flank)


def _reinforced_leaf(
    thin: Scalar, thick: Scalar, inner: Scalar, transition: Scalar, position: Scalar
) -> Scalar:
    """Compute the thickness of a leaf with a thick middle section.

    The bending compliance per length follows a polynomial with three continuous
    derivatives, which is antisymmetric about the middle of the transition. So its
    integral does not depend on the length of the transition.

    Args:
        thin: Thickness of the end sections; m.
        thick: Thickness of the middle section; m.
        inner: Length of the thick section without the transitions; m.
        transition: Length of the transition; m.
        position: Position along axis 1; m.
    """
    u = jnp.clip((jnp.abs(position) - inner / 2) / transition, 0.0, 1.0)
    share = u**4 * (35 - 84 * u + 70 * u**2 - 20 * u**3)
    compliance = share + (1 - share) * (thin / thick) ** 3
    return thin * compliance ** (-1 / 3)


def _sqrt(xp: Any, square: Any) -> Any:
    """Compute a square root without derivative at zero, and zero below it."""
    # Rounding may put the ends of a beam outside of the contour.
    inside = square > 0
    return xp.where(inside, xp.sqrt(xp.where(inside, square, 1.0)), 0.0)
