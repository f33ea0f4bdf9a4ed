"""Limits of the dimensions of contours of flexures."""

import jax.numpy as jnp

from ..._utils.host import as_float, is_traced, on_host
from ..._utils.types import NumberLike, Scalar
from ..._utils.validation import require_choice, require_interval, require_length
from ..leaf import Theory


# Limits of the smallest thickness over the length of the slender part
_LIMITS = {"euler-bernoulli": 0.1, "timoshenko": 0.25}


def require_fillet(length: Scalar, fillet: NumberLike) -> Scalar:
    """Require a radius of fillets that fit into the length of a leaf; m."""
    return require_ratio(
        "`fillet / length`",
        require_length("`fillet`", fillet),
        length,
        0.5,
        "must be at most 0.5, because there are fillets at both ends",
    )


def require_arc(length: Scalar, radius: NumberLike, angle: Scalar) -> Scalar:
    """Require a radius (m) of an arc between flanks at an angle (rad) that fits.

    The chord of the arc is at most the length (m).
    """
    radius = require_length("`radius`", radius)
    xp, (whole, half_angle) = on_host(length, angle)
    chord_limit = as_float(whole / (2 * xp.cos(half_angle / 2)))
    return require_ratio(
        "`2 radius cos(angle / 2) / length`",
        radius,
        chord_limit,
        1.0,
        "must be at most 1. Use a smaller radius, a larger angle, or a longer neck",
    )


def require_reinforcement(thickness: Scalar, reinforced: NumberLike) -> Scalar:
    """Require a thickness of a middle section that is at least another one; m."""
    reinforced = require_length("`reinforced_thickness`", reinforced)
    checked = require_ratio(
        "`thickness / reinforced_thickness`",
        thickness,
        reinforced,
        1.0,
        "must be at most 1, because the middle section is the thick one",
    )
    return nan_where_nan(checked, reinforced)


def require_ratio(
    name: str, part: Scalar, whole: Scalar, limit: float, requirement: str
) -> Scalar:
    """Require a positive dimension that is at most a multiple of another dimension.

    Args:
        part: The dimension; m.
        whole: The other dimension; m.
        limit: Largest ratio of the two, up to rounding.
        requirement: Words of the message that follow "but".

    Returns:
        The first dimension. It is NaN if the ratio is traced and too large.

    Raises:
        ValueError: The ratio is known and too large.
    """
    _, (numerator, denominator) = on_host(part, whole)
    # The quotient of rounded numbers may exceed the limit: 0.3 mm / 3 mm is not 0.1.
    high = limit * (1 + 1e-12)
    ratio = require_interval(name, numerator / denominator, 0.0, high, requirement)
    return nan_where_nan(ratio, part)


def nan_where_nan(checked: Scalar, value: Scalar) -> Scalar:
    """Return a value, or NaN if a traced number that was checked is NaN."""
    if not is_traced(checked):
        return value
    return jnp.where(jnp.isnan(checked), jnp.nan, value)


def require_notch(
    length: NumberLike, web: NumberLike, depth: NumberLike, theory: Theory
) -> tuple[Scalar, Scalar, Scalar]:
    """Require the dimensions of a notch in the ranges of the formulas; m."""
    length = require_length("`length`", length)
    depth = require_ratio(
        "`depth / length`",
        require_length("`depth`", depth),
        length,
        0.5,
        "the formula of a beam is valid up to 0.5",
    )
    web = require_ratio(
        "`web / depth`",
        require_length("`web`", web),
        depth,
        20.0,
        "the formula is valid up to 20. For a shallower notch, use `leaf`",
    )
    return length, require_slender("`web / length`", web, length, theory), depth


def require_slender(
    name: str, thickness: Scalar, length: Scalar, theory: Theory
) -> Scalar:
    """Require a thickness that is small compared with the length, for a theory; m."""
    limit = _LIMITS[require_choice("`theory`", theory, tuple(_LIMITS))]
    requirement = f"the theory {theory!r} is valid up to {limit:g}"
    return require_ratio(name, thickness, length, limit, requirement)
