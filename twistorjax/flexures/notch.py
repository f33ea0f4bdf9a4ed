"""Notch hinges: the neck that two round holes leave between them."""

from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import ArrayLike

from .._utils.types import Corners, Scalar
from .._utils.validation import (
    require_choice,
    require_interval,
    require_kind,
    require_positive,
)
from ..energies.base import Quadratic
from ..energies.strains import Coordinates
from .material import Material


Formula = Literal["fitted", "paros-weisbord", "paros-weisbord-simplified"]

# web / hole, from above to and including: see `notch` for the reasons
_RANGES = {
    "fitted": (0.05, 0.5),
    "paros-weisbord": (0.0, 0.25),
    "paros-weisbord-simplified": (0.0, 0.1),
}


def notch(
    material: Material,
    *,
    hole: ArrayLike,
    web: ArrayLike,
    width: ArrayLike,
    formula: Formula = "fitted",
    coordinates: Coordinates = "twistor",
) -> Quadratic:
    """The energy of a notch hinge, in the frame at its middle with axis 1 along it.

    Args:
        material: of the plate.
        hole: diameter of the two round holes; m.
        web: thickness of the neck where it is thinnest; m.
        width: out of the plane: the plate's own thickness; m.
        formula: where the stiffness comes from.

            * "fitted": curves through many finite-element analyses, as the dissertation
              lists them. For webs from 0.05 to 0.5 of the hole; below, the curve for
              shear leaves that of a beam that shears (0.88 of it at 0.05, 0.71 at 0.03)
              and is negative under 0.0157.
            * "paros-weisbord": the neck as a beam of variable height, integrated
              exactly, without shear. For webs to 0.25 of the hole, where shear would
              double the transverse compliance; it adds 0.4 to it at 0.1.
            * "paros-weisbord-simplified": the leading terms of that for thin webs, to a
              tenth of the hole, where they are within 3 % in rotation, 11 % in axial
              and 23 % in transverse stiffness of the exact integrals.

            The fitted axial stiffness is below that of the beam, whose stress is even
            over each section: by 33 % at 0.05, 37 % at 0.1, 46 % at 0.3 of the hole.
        coordinates: of the quadratic energy, "twistor" or "twist".

    Raises:
        ValueError: a dimension is not positive, or the web is outside the range.

    Source:
        The listing `notch_stiff` of the dissertation, after Zhang and Fasse; Paros and
        Weisbord, How to design flexure hinges, Machine Design 37 (1965), and equation
        6.2 (for the stage it gives 2.4907 N m/rad; the text prints 2.4919). Their
        transverse stiffness is for a load at the end of the neck; here it is
        that of the middle, from the same integrals.

    Example:
        >>> plate = Material(modulus=69e9, poisson=0.33)
        >>> jnp.diag(notch(plate, hole=3e-3, web=0.25e-3, width=0.02).stiffness)
        Array([2.50965125e+00, 1.58837017e+08, 1.66074768e+07], dtype=float64)
    """
    require_kind("material", [material], Material)
    low, high = _RANGES[require_choice("`formula`", formula, tuple(_RANGES))]
    hole, web = require_positive("`hole`", hole), require_positive("`web`", web)
    ratio = require_interval(
        "`web / hole`",
        web / hole,
        low * (1 - 1e-12),  # 0.15 mm to 3 mm is within, but not to the last bit
        high * (1 + 1e-12),
        f"the formula {formula!r} holds above {low:g} and up to {high:g}",
    )
    scale = material.modulus * require_positive("`width`", width)
    stiffnesses = {
        "fitted": _fitted,
        "paros-weisbord": _beam,
        "paros-weisbord-simplified": _thin,
    }[formula](ratio)
    units = jnp.stack([scale * hole**2, scale, scale])
    return Quadratic(jnp.diag(units * jnp.stack(stiffnesses)), coordinates)


def notch_profile(*, hole: ArrayLike, web: ArrayLike) -> jax.tree_util.Partial:
    """The thickness of a notch's neck along its axis, for a `Beam` as long as the holes.

    In so short a neck the stress is not even over each section, as a beam takes it:
    finite elements turn by some per cent less moment, and give by a third to a half more
    along the axis; see `notch`.

    Args:
        hole: diameter of the two round holes; m.
        web: thickness of the neck where it is thinnest; m.

    Raises:
        ValueError: a dimension is not positive.

    Example:
        >>> neck = notch_profile(hole=3e-3, web=0.25e-3)
        >>> neck(jnp.array(0.0)), neck(jnp.array(1.5e-3))
        (Array(0.00025, dtype=float64), Array(0.00325, dtype=float64))
    """
    hole, web = require_positive("`hole`", hole), require_positive("`web`", web)
    return jax.tree_util.Partial(_between_holes, hole, web)


def _between_holes(hole: Scalar, web: Scalar, place: Scalar) -> Scalar:
    square = hole**2 - (2 * place) ** 2
    inside = square > 0  # rounding puts the ends outside, where a root has no derivative
    return web + hole - jnp.where(inside, jnp.sqrt(jnp.where(inside, square, 1.0)), 0.0)


def notch_outline(
    *, hole: ArrayLike, web: ArrayLike, height: ArrayLike | None = None, points: int = 24
) -> Corners:
    """The outline of a notch's neck in its own frame, for drawing; m.

    Args:
        hole: diameter of the two round holes; m.
        web: thickness of the neck where it is thinnest; m.
        height: of the bodies beside it, across, which it does not exceed; by default as
            far as the holes reach; m.
        points: along each side.
    """
    angle = jnp.linspace(-jnp.pi / 2, jnp.pi / 2, points)
    x = jnp.sin(angle) * hole / 2
    y = (1 - jnp.cos(angle)) * hole / 2 + jnp.ones_like(angle) * web / 2
    if height is not None:
        y = jnp.minimum(y, jnp.asarray(height, float) / 2)
    return jnp.concatenate([jnp.stack([x, y], 1), jnp.stack([x, -y], 1)[::-1]])


def _fitted(r: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    root = jnp.sqrt(r)
    rotation = r**2 * (0.1109 * root - 0.035 * r)
    axial = 0.3568 * root + 0.1452 * r
    shear = 0.283 * r - 0.03443 * root - 0.06692 * r * root
    return rotation, axial, shear


def _beam(r: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    # Height h = hole (a - cos phi) at x = hole / 2 sin phi. A_n is the integral of
    # (a - cos phi)^-n over the half circle; each follows from the derivative of the last.
    a = 1 + r
    square = r * (2 + r)
    first = 4 / jnp.sqrt(square) * jnp.arctan(jnp.sqrt((2 + r) / r))
    second = (a * first + 2 / a) / square
    third = (3 * a * second - first + 2 / a**2) / (2 * square)
    axial = (a * first - jnp.pi) / 2
    rotation = 6 * (a * third - second)
    shear = 1.5 * (jnp.pi - a * square * third + (3 * a**2 - 1) * second - 3 * a * first)
    return 1 / rotation, 1 / axial, 1 / shear


def _thin(r: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    slender = jnp.sqrt(1 / (2 * r))  # sqrt(radius / web)
    rotation = r**2 / (4.5 * jnp.pi * slender)
    axial = 1 / (jnp.pi * slender - 2.57)
    shear = 1 / (1.5 * jnp.pi * slender**3)
    return rotation, axial, shear
