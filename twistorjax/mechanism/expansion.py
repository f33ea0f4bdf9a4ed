"""Thermal expansion of a hinge."""

from typing import Any

import equinox as eqx
from typing_extensions import TypeAliasType

from .._utils.types import NumberLike, Scalar
from .._utils.validation import require_finite, require_positive
from .material import Material


# Material with a coefficient of thermal expansion, or this coefficient; 1/K
ExpansionLike = TypeAliasType("ExpansionLike", Material | NumberLike)


class Expansion(eqx.Module):
    """Thermal expansion of a hinge between its two clamped ends.

    Args:
        material: Material with its coefficient of thermal expansion, or this coefficient;
            1/K.
        length: Free length of the hinge along axis 1, in the middle of which its frames
            are; m.
        arc_length: Length of the center line of a curved hinge, along which a gradient of
            the temperature bends it; by default `length`; m.

    Raises:
        ValueError: The material has no coefficient, the coefficient is not finite, or a
            length is not positive.

    Example:
        >>> Expansion(12e-6, length=0.05).coefficient
        Array(1.2e-05, dtype=float64)
    """

    coefficient: Scalar
    length: Scalar
    arc_length: Scalar | None

    def __init__(
        self,
        material: ExpansionLike,
        *,
        length: NumberLike,
        arc_length: NumberLike | None = None,
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
        self.length = require_positive("`length`", length)
        self.arc_length = None
        if arc_length is not None:
            self.arc_length = require_positive("`arc_length`", arc_length)
