"""Notch hinges: the neck between two circular holes."""

from typing import Any, Literal

import numpy as np

from .._utils.host import as_float, on_host
from .._utils.types import Corners, NumberLike, Scalar
from .._utils.validation import (
    require_choice,
    require_instance,
    require_interval,
    require_length,
    require_positive,
)
from ..energies.quadratic import Quadratic
from ..energies.strains import Coordinates
from ..mechanism.material import Material
from .beams.beam import outline_along
from .beams.stress_models import SectionStress
from .contours.contour import arc_integrals, Contour
from .contours.notches import EllipticalNotch


Stiffnesses = tuple[Any, Any, Any]  # arrays of NumPy or JAX
Formula = Literal["fitted", "paros-weisbord", "paros-weisbord-simplified"]

# Limits of web / hole. The reasons are in the docstring of `notch`.
_RANGES = {
    "fitted": (0.05, 0.5),
    "paros-weisbord": (0.0, 0.25),
    "paros-weisbord-simplified": (0.0, 0.1),
}


def notch(
    material: Material,
    *,
    hole: NumberLike,
    web: NumberLike,
    width: NumberLike,
    formula: Formula = "fitted",
    coordinates: Coordinates = "twistor",
) -> Quadratic:
    """Create the quadratic energy of a notch hinge.

    Its frame is at the middle of the neck, with axis 1 along the neck.

    Args:
        material: Material of the plate.
        hole: Diameter of the two circular holes; m.
        web: Smallest thickness of the neck; m.
        width: Out-of-plane width, which is the thickness of the plate; m.
        formula: Source of the stiffness.

            * "fitted": Curves that were fitted to many finite-element analyses, as listed
              in the dissertation. They are valid for web / hole from 0.05 to 0.5. Below
              0.05 the transverse stiffness is too small: it is 0.88 times that of a beam
              with shear at 0.05 and 0.71 times at 0.03, and it is negative below 0.0157.
            * "paros-weisbord": A beam of variable height without shear, integrated
              exactly. It is valid for web / hole up to 0.25. Shear would increase the
              transverse compliance by 40 % at 0.1, and double it at 0.25.
            * "paros-weisbord-simplified": The leading terms of "paros-weisbord" for small
              ratios. They are valid for web / hole up to 0.1. There the rotational
              stiffness is within 3 %, the axial stiffness within 11 % and the transverse
              stiffness within 23 % of the exact integrals.

            The axial stiffness of "fitted" is smaller than that of a beam, in which the
            stress is uniform over each section: by 33 % at 0.05, by 37 % at 0.1 and by
            46 % at 0.3.
        coordinates: Coordinates of the energy, "twistor" or "twist".

    Returns:
        The energy, whose stiffness is that of the undeformed neck.

    Raises:
        ValueError: A dimension is not positive, or web / hole is outside the range of the
            formula.

    Source:
        The listing `notch_stiff` of the dissertation, after Zhang and Fasse. Paros and
        Weisbord, How to design flexure hinges, Machine Design 37 (1965). Their transverse
        stiffness is for a load at the end of the neck; here it is for a load at the
        middle, from the same integrals. The simplified rotational stiffness is equation
        6.2 of the dissertation. For its stage, this equation gives 2.4907 N m/rad; the
        text prints 2.4919 N m/rad.

    Example:
        >>> aluminum = Material(modulus=69e9, poisson=0.33)
        >>> energy = notch(aluminum, hole=3e-3, web=0.25e-3, width=0.02)
        >>> energy.stiffness.diagonal()
        Array([2.50965125e+00, 1.58837017e+08, 1.66074768e+07], dtype=float64)
    """
    require_instance("material", material, Material)
    low, high = _RANGES[require_choice("`formula`", formula, tuple(_RANGES))]
    xp, (modulus, hole, web, width) = on_host(
        material.modulus,
        require_length("`hole`", hole, material.modulus),
        require_positive("`web`", web),
        require_length("`width`", width, material.modulus),
    )
    ratio = require_interval(
        "`web / hole`",
        web / hole,
        low * (1 - 1e-12),  # The quotient 0.15 mm / 3 mm is not exactly 0.05.
        high * (1 + 1e-12),
        f"the formula {formula!r} is valid from {low:g} to {high:g}",
    )
    stiffnesses = {
        "fitted": _fitted,
        "paros-weisbord": _paros_weisbord,
        "paros-weisbord-simplified": _paros_weisbord_simplified,
    }[formula](ratio)
    scale = modulus * width
    units = xp.stack([scale * hole**2, scale, scale])
    stiffness = as_float(xp.diag(units * xp.stack(stiffnesses)))
    moduli = material.modulus, material.shear_modulus
    stress = SectionStress.of_notch(material.strengths, hole, web, width, moduli)
    return Quadratic(stiffness, coordinates, flexure=True, stress_model=stress)


def notch_profile(*, hole: NumberLike, web: NumberLike) -> Contour:
    """Return the thickness of the neck of a notch as a function of the position.

    Use it as the `thickness` of a `Beam` with the length `hole`. In a neck as short as
    this, the stress is not uniform over a section, as a beam assumes. Finite elements
    give a rotational stiffness that is some percent smaller, and an axial stiffness that
    is a third to a half smaller; see `notch`.

    Args:
        hole: Diameter of the two circular holes; m.
        web: Smallest thickness of the neck; m.

    Returns:
        The thickness of the neck (m) as a function of the position along axis 1 (m).

    Raises:
        ValueError: A dimension is not positive.

    Example:
        >>> import jax.numpy as jnp
        >>> thickness = notch_profile(hole=3e-3, web=0.25e-3)
        >>> thickness(jnp.array(0.0)), thickness(jnp.array(1.5e-3))
        (Array(0.00025, dtype=float64), Array(0.00325, dtype=float64))
    """
    hole, web = require_length("`hole`", hole), require_length("`web`", web)
    _, (diameter,) = on_host(hole)
    return EllipticalNotch(hole, web, depth=as_float(diameter / 2))


def notch_outline(
    *,
    hole: NumberLike,
    web: NumberLike,
    height: NumberLike | None = None,
    points: int = 61,
) -> Corners:
    """Compute the outline of the neck of a notch in its frame.

    The thinnest place is a corner. With the default of `points`, `io.save_outline` writes
    the edges as circular arcs.

    Args:
        hole: Diameter of the two circular holes; m.
        web: Smallest thickness of the neck; m.
        height: In-plane height of the adjacent bodies, which limits the outline; m. The
            default is the full height of the holes.
        points: Number of points on the arc of each side. An even number is increased by
            one.

    Returns:
        The corners of the outline; m.

    Example:
        >>> outline = notch_outline(hole=3e-3, web=0.25e-3)
        >>> outline[30, 1] - outline[91, 1]  # the thinnest place
        Array(0.00025, dtype=float64)
    """
    shares = np.linspace(-1.0, 1.0, points + 1 - points % 2)
    limit = np.inf if height is None else height
    xp, (hole, web, limit) = on_host(hole, web, limit)
    largest = np.pi / 2
    if height is not None:  # The arc ends where it is as high as the bodies.
        largest = xp.arccos(1 - xp.clip((limit - web) / hole, 0.0, 1.0))
    angle = shares * largest
    x = xp.sin(angle) * hole / 2
    y = (1 - xp.cos(angle)) * hole / 2 + web / 2
    if height is not None:
        y = xp.minimum(y, limit / 2)
        end = xp.reshape(hole / 2, (1,))
        x, y = xp.concatenate([-end, x, end]), xp.concatenate([y[:1], y, y[-1:]])
    return outline_along(x, 2 * y)


# The three formulas take r = web / hole. They return the rotational stiffness over
# modulus * width * hole^2, and the axial and transverse stiffness over modulus * width.


def _fitted(r: Scalar) -> Stiffnesses:
    """Evaluate the curves that were fitted to finite-element analyses."""
    xp, (r,) = on_host(r)
    root = xp.sqrt(r)
    rotation = r**2 * (0.1109 * root - 0.035 * r)
    axial = 0.3568 * root + 0.1452 * r
    transverse = 0.283 * r - 0.03443 * root - 0.06692 * r * root
    return rotation, axial, transverse


def _paros_weisbord(r: Scalar) -> Stiffnesses:
    """Integrate the compliances of a beam of variable height."""
    xp, (r,) = on_host(r)
    # The compliances of an `EllipticalNotch` with the length 1 and the depth 1/2
    arc = arc_integrals(xp, r, xp.pi / 2)
    return 1 / (12 * arc.bending), 1 / arc.axial, 1 / (3 * arc.second)


def _paros_weisbord_simplified(r: Scalar) -> Stiffnesses:
    """Evaluate the leading terms of `_paros_weisbord` for small ratios."""
    xp, (r,) = on_host(r)
    slenderness = xp.sqrt(1 / (2 * r))  # sqrt(radius / web)
    rotation = r**2 / (4.5 * xp.pi * slenderness)
    axial = 1 / (xp.pi * slenderness - 2.57)
    transverse = 1 / (1.5 * xp.pi * slenderness**3)
    return rotation, axial, transverse
