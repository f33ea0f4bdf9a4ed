"""Leaf hinges: slender straight beams of constant section, cut from a plate."""

from typing import Literal

import jax.numpy as jnp
from jaxtyping import ArrayLike

from .._utils.types import Corners
from .._utils.validation import (
    require_choice,
    require_interval,
    require_kind,
    require_positive,
)
from ..energies.base import Quadratic
from ..energies.mixed import MixedEnergy
from ..energies.strains import Coordinates
from .material import Material


def leaf(
    material: Material,
    *,
    length: ArrayLike,
    thickness: ArrayLike,
    width: ArrayLike,
    theory: Literal["euler-bernoulli", "timoshenko"] = "euler-bernoulli",
    coordinates: Coordinates = "twistor",
) -> Quadratic:
    """The energy of a leaf hinge, in the frame at its middle with axis 1 along it.

    There the stiffness is diagonal: the middle is the centre of stiffness.

    Args:
        material: of the plate.
        length: along axis 1, free of its clamps; m.
        thickness: in the plane, across; m.
        width: out of the plane: the plate's own thickness; m.
        theory: whether transverse forces also shear the leaf ("timoshenko", shear
            factor 5/6) or bend it alone, as in the dissertation.
        coordinates: of the quadratic energy, "twistor" or "twist": that of the twist is
            exact for a leaf bent by a moment alone, that of the twistor bears at most
            EI / length.

    Raises:
        ValueError: a dimension is not positive, or the leaf is too stout: its thickness
            may be a tenth of its length without shear, where that would add 3 % to the
            transverse compliance, and a quarter with it.

    Source:
        Equation 5.8 of the dissertation and its listing `cant_stiff`, where the axial
        direction is axis 2. Shear factor: Cowper (1966), for Poisson's ratio zero.

    Example:
        >>> soft = Material(modulus=3.45e9, poisson=0.3)
        >>> jnp.diag(leaf(soft, length=10e-3, thickness=1e-3, width=5e-3).stiffness)
        Array([1.4375e-01, 1.7250e+06, 1.7250e+04], dtype=float64)
    """
    require_kind("material", [material], Material)
    require_choice("`theory`", theory, ("euler-bernoulli", "timoshenko"))
    length, width = (
        require_positive("`length`", length),
        require_positive("`width`", width),
    )
    thickness = require_positive("`thickness`", thickness)
    share = 0.25 if theory == "timoshenko" else 0.1
    slender = require_interval(
        "`thickness / length`",
        thickness / length,
        0.0,
        share * (1 + 1e-12),  # 0.3 mm to 3 mm is a tenth, but not to the last bit
        f"the {theory} leaf holds to {share:g}: take a thinner or longer leaf"
        + ("" if theory == "timoshenko" else ', or theory="timoshenko"'),
    )
    area = width * slender * length
    second_moment = area * (slender * length) ** 2 / 12
    bending = material.modulus * second_moment / length
    transverse = length**2 / (12 * bending)
    if theory == "timoshenko":
        transverse = transverse + length / (material.shear_modulus * area * 5 / 6)
    axial = material.modulus * area / length
    return Quadratic(jnp.diag(jnp.stack([bending, axial, 1 / transverse])), coordinates)


def quartic_leaf(
    material: Material,
    *,
    length: ArrayLike,
    thickness: ArrayLike,
    width: ArrayLike,
    theory: Literal["euler-bernoulli", "timoshenko"] = "euler-bernoulli",
) -> MixedEnergy:
    """The energy of a leaf hinge that shortens as it bends, to the fourth order.

    As `leaf`, in the coordinates of the twist, but what stretches the leaf is its
    translation along axis 1 less what bending takes of it. To 20 degrees it errs by some
    per cent where the quadratic energy errs by several times the wrench; several in a
    row, each for its part of the length, converge with the fourth power of their number.

    Args:
        material: of the plate.
        length: along axis 1, free of its clamps; m.
        thickness: in the plane, across; m.
        width: out of the plane: the plate's own thickness; m.
        theory: as for `leaf`.

    Raises:
        ValueError: as for `leaf`.

    Source:
        Bent to a circle, the two frames, each fixed to one end, pass each other by
        `length angle^2 / 12` along the axis; guided across by `t2`, the leaf is a cubic
        and shortens by `3 t2^2 / (5 length)`.

    Example:
        >>> soft = Material(modulus=3.45e9, poisson=0.3)
        >>> curved = quartic_leaf(soft, length=10e-3, thickness=1e-3, width=5e-3)
        >>> jnp.diag(curved.tangent_stiffness())
        Array([1.4375e-01, 1.7250e+06, 1.7250e+04], dtype=float64)
    """
    straight = leaf(
        material, length=length, thickness=thickness, width=width, theory=theory
    )
    bending, axial, across = jnp.diag(straight.stiffness)
    size = require_positive("`length`", length)
    force = bending / size
    terms = {
        (2, 0, 0): bending / 2,
        (0, 2, 0): across * size**2 / 2,
        (0, 2, 1): 3 / 5 * bending,
        (2, 0, 1): -bending / 12,
        (0, 0, 2): -(force**2) / (2 * axial),
    }
    return MixedEnergy(
        jnp.stack(list(terms.values())), tuple(terms), length=size, force=force
    )


def leaf_outline(*, length: ArrayLike, thickness: ArrayLike, points: int = 24) -> Corners:
    """The outline of a leaf in its own frame, for drawing; m."""
    x = jnp.linspace(-0.5, 0.5, points) * length
    y = jnp.full_like(x, 0.5) * thickness
    return jnp.concatenate([jnp.stack([x, y], 1), jnp.stack([x, -y], 1)[::-1]])
