"""Elastic material of a plate."""

import equinox as eqx

from .._utils.host import concrete
from .._utils.types import NumberLike, Scalar
from .._utils.validation import require_finite, require_interval, require_positive, warn
from ..energies.stress_model import Strengths


class Material(eqx.Module):
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
            _warn_of_units(
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

    @property
    def shear_modulus(self) -> Scalar:
        """Shear modulus; Pa."""
        return self.modulus / (2 * (1 + self.poisson))


# Least and largest values of solids, their unit, and the usual mistake
_STRENGTHS = 1e4, 1e12, "Pa", "500 MPa is 500e6 Pa"
_SOLIDS = {
    "modulus": (1e3, 1e15, "Pa", "210 GPa is 210e9 Pa"),
    "density": (10.0, 1e5, "kg/m3", "7.8 g/cm3 is 7800 kg/m3"),
    "expansion": (-0.01, 0.01, "1/K", "12 um/(m K) is 12e-6 1/K"),
    "strength": _STRENGTHS,
    "ultimate_strength": _STRENGTHS,
}


def _warn_of_units(**values: NumberLike | None) -> None:
    """Warn of values that no solid has, so that they seem to be in other units."""
    for name, value in values.items():
        low, high, unit, conversion = _SOLIDS[name]
        known = None if value is None else concrete(value)
        if known is not None and known.shape == () and not low <= float(known) <= high:
            warn(
                f"`{name}` is {float(known):g} {unit}, which is a thousand times off "
                f"every solid. {conversion}."
            )
