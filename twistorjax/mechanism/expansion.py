"""Thermal expansion of a hinge."""

from typing import Any

import equinox as eqx
from jaxtyping import Array, Float
from typing_extensions import TypeAliasType

from .._utils.host import as_float, on_host
from .._utils.types import EndsLike, NumberLike, PointLike, Pose, Scalar
from .._utils.validation import (
    require_array,
    require_finite,
    require_positive,
    require_row,
)
from .material import Material


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
