"""Elastic material of a plate, and the thermal expansion of hinges."""

from typing import Any

import equinox as eqx
from jaxtyping import Array, Float
from typing_extensions import TypeAliasType

from .._utils.host import as_float, concrete, on_host
from .._utils.printing import Printed
from .._utils.types import EndsLike, NumberLike, PointLike, Pose, Scalar
from .._utils.validation import (
    listing,
    quote,
    require_array,
    require_finite,
    require_interval,
    require_positive,
    require_row,
    warn,
)
from ..energies.stress_model import Strengths
from .materials import MATERIALS


class Material(Printed):
    """An isotropic, linearly elastic material.

    Args:
        modulus: Young's modulus; Pa.
        poisson: Poisson's ratio.
        density: Density, which is only needed for masses; kg/m3.
        expansion: Coefficient of thermal expansion, which is only needed for changes of
            temperature; 1/K.
        strength: Largest allowable stress under static loads: the yield strength, or the
            fracture strength of a brittle material. If it is given, `equilibrium` and
            `path` report the stresses of the hinges; Pa.
        ultimate_strength: Ultimate tensile strength, for `fatigue`; Pa.
        endurance_limit: Largest amplitude of a stress that alternates about zero, for
            infinite life, for `fatigue`; Pa.

    Raises:
        ValueError: The modulus, the density, or a strength is not positive, Poisson's
            ratio is not between -1 and 0.5, or the coefficient of expansion is not
            finite.

    Example:
        >>> aluminum = Material(modulus=69e9, poisson=0.33)
        >>> aluminum.shear_modulus
        Array(2.59398496e+10, dtype=float64)
    """

    modulus: Scalar
    poisson: Scalar
    density: Scalar | None
    expansion: Scalar | None
    strengths: Strengths

    def __init__(
        self,
        modulus: NumberLike,
        poisson: NumberLike,
        density: NumberLike | None = None,
        expansion: NumberLike | None = None,
        strength: NumberLike | None = None,
        ultimate_strength: NumberLike | None = None,
        endurance_limit: NumberLike | None = None,
    ):
        self.modulus = require_positive("`modulus`", modulus)
        requirement = "must be above -1 and at most 0.5"
        self.poisson = require_interval("`poisson`", poisson, -1.0, 0.5, requirement)
        self.density = None if density is None else require_positive("`density`", density)
        self.expansion = None
        if expansion is not None:
            self.expansion = require_finite("`expansion`", expansion)
        given = {
            "strength": strength,
            "ultimate_strength": ultimate_strength,
            "endurance_limit": endurance_limit,
        }
        # A modulus of exactly 1 makes a study dimensionless.
        if concrete(modulus) != 1:
            warn_of_units(
                modulus=modulus,
                density=density,
                expansion=expansion,
                strength=strength,
                ultimate_strength=ultimate_strength,
            )
        self.strengths = Strengths(
            *(
                None if value is None else require_positive(f"`{name}`", value)
                for name, value in given.items()
            )
        )

    @classmethod
    def named(cls, name: str) -> "Material":
        """Return a material with typical values, for a first design.

        Args:
            name: "spring steel", "aluminum 7075-T6", "titanium Ti-6Al-4V", "silicon" (in
                the plane of a (100) wafer, along <110>), or "PEEK". `mechanism.materials`
                lists the values and their sources.

        Raises:
            ValueError: There is no such material.

        Example:
            >>> Material.named("aluminum 7075-T6").density
            Array(2810., dtype=float64)
        """
        if name not in MATERIALS:
            raise ValueError(
                f"There is no material {quote(name)}. There are {listing(MATERIALS)}. "
                "Others are created by `Material(modulus=..., poisson=...)`."
            )
        return cls(**MATERIALS[name])

    @property
    def shear_modulus(self) -> Scalar:
        """Shear modulus; Pa."""
        _, (modulus, poisson) = on_host(self.modulus, self.poisson)
        return as_float(modulus / (2 * (1 + poisson)))


# Least and largest values of solids, their unit, and the usual mistake
_STRENGTHS = 1e4, 1e12, "Pa", "500 MPa is 500e6 Pa"

_SOLIDS = {
    "modulus": (3e5, 1e15, "Pa", "210 GPa is 210e9 Pa"),
    "density": (10.0, 1e5, "kg/m3", "7.8 g/cm3 is 7800 kg/m3"),
    "expansion": (-0.01, 0.01, "1/K", "12 um/(m K) is 12e-6 1/K"),
    "strength": _STRENGTHS,
    "ultimate_strength": _STRENGTHS,
    "stress": _STRENGTHS,
}


def warn_of_units(**values: NumberLike | None) -> None:
    """Warn of values that no solid has, so that they seem to be in other units."""
    for name, value in values.items():
        low, high, unit, conversion = _SOLIDS[name]
        known = None if value is None else concrete(value)
        if known is not None and known.shape == () and not low <= float(known) <= high:
            warn(
                f"`{name}` is {float(known):g} {unit}, but that of solids is between "
                f"{low:g} and {high:g} {unit}. {conversion}."
            )


# Material with a coefficient of thermal expansion, or this coefficient; 1/K
ExpansionLike = TypeAliasType("ExpansionLike", Material | NumberLike)


class Expansion(eqx.Module):
    """Thermal expansion of a hinge between its two clamped ends.

    Args:
        material: Material with its coefficient of thermal expansion, or this coefficient;
            1/K.
        length: Free length of a straight hinge along axis 1, in the middle of which its
            frames are; m. Give either it or `ends`.
        ends: Positions (x, y) of the two clamped ends of a hinge that is not straight, in
            its frame; m, m.
        arc_length: Length of the center line of a curved hinge, along which a gradient of
            the temperature bends it; by default the distance of the ends along axis 1; m.
        centroid: Mean position (x, y) of this center line, about which a gradient turns
            the ends; by default that of a parabola through both ends and the origin; m,
            m.

    Raises:
        ValueError: The material has no coefficient, a value is not finite, a length is
            not positive, not exactly one of `length` and `ends` is given, or `arc_length`
            or `centroid` are given without `ends`.

    Example:
        >>> Expansion(12e-6, length=0.05).coefficient
        Array(1.2e-05, dtype=float64)
    """

    coefficient: Scalar
    ends: Float[Array, "2 2"]
    arc_length: Scalar
    centroid: Float[Array, "2"]

    def __init__(
        self,
        material: ExpansionLike,
        *,
        length: NumberLike | None = None,
        ends: EndsLike | None = None,
        arc_length: NumberLike | None = None,
        centroid: PointLike | None = None,
    ):
        coefficient: Any = material
        if isinstance(material, Material):
            if material.expansion is None:
                raise ValueError(
                    "The material has no `expansion`, but a hinge needs a coefficient of "
                    "thermal expansion (1/K): `Material(..., expansion=12e-6)`."
                )
            coefficient = material.expansion
        self.coefficient = require_finite("`material`", coefficient)
        if length is not None:
            if any(value is not None for value in (ends, arc_length, centroid)):
                raise ValueError(
                    "A hinge with a `length` is straight. Give the positions of both "
                    "`ends` of a curved hinge with its `arc_length` and its `centroid`."
                )
            xp, (span,) = on_host(require_positive("`length`", length))
            half = xp.stack([span, 0 * span]) / 2
            ends = as_float(xp.stack([-half, half]))
        elif ends is None:
            raise ValueError(
                "Give `Expansion` either the `length` of a straight hinge (m), or the "
                "positions (m) of both `ends` of another one in its frame."
            )
        rows = "be the positions (x, y) of both ends"
        self.ends = require_array("`ends`", ends, (2, 2), rows)
        self.arc_length = require_positive(
            "`arc_length`", self.length if arc_length is None else arc_length
        )
        if centroid is None:
            _, (known,) = on_host(self.ends)
            centroid = as_float((known[0] + known[1]) / 6)
        self.centroid = require_row("`centroid`", centroid, "a position (x, y)", 2)

    @property
    def length(self) -> Scalar:
        """Distance of the clamped ends along axis 1; m."""
        _, (ends,) = on_host(self.ends)
        return as_float(ends[1, 0] - ends[0, 0])

    @property
    def free_turn(self) -> Pose:
        """Displacement of the free hinge by a gradient, over its rotation; -, m, m.

        The ends turn about the centroid of the center line.
        """
        xp, (known,) = on_host(self.centroid)
        x, y = known
        return as_float(xp.stack([1 + 0 * x, y, -x]))
