"""Limits of the dimensions of flexures."""

from typing import Literal

import jax.numpy as jnp

from .._utils.host import is_traced, on_host
from .._utils.types import Numbers, Scalar
from .._utils.validation import require_choice, require_interval


Theory = Literal["euler-bernoulli", "timoshenko"]

SHEAR_FACTOR = 5 / 6
# Limits of the smallest thickness over the length of the slender part
_LIMITS = {"euler-bernoulli": 0.1, "timoshenko": 0.25}


def require_slender(
    name: str, thickness: Scalar, length: Scalar, theory: Theory, advice: str = ""
) -> Scalar:
    """Require a thickness that is small compared with the length, for a theory; m."""
    limit = _LIMITS[require_choice("`theory`", theory, tuple(_LIMITS))]
    requirement = f"the theory {theory!r} is valid up to {limit:g}{advice}"
    return require_ratio(name, thickness, length, limit, requirement)


def require_ratio(
    name: str, part: Scalar, whole: Scalar, limit: float, requirement: str
) -> Scalar:
    """Require a positive dimension that is at most a multiple of another dimension.

    The message ends with "but" and the `requirement`. The first dimension is returned; it
    is NaN if the ratio is traced and too large.
    """
    _, (numerator, denominator) = on_host(part, whole)
    # The quotient of rounded numbers may exceed the limit: 0.3 mm / 3 mm is not 0.1.
    high = limit * (1 + 1e-12)
    ratio = require_interval(name, numerator / denominator, 0.0, high, requirement)
    return nan_where_nan(ratio, part)


def nan_where_nan(checked: Scalar, value: Numbers) -> Numbers:
    """Return a value, or NaN if a traced number that was checked is NaN."""
    if not is_traced(checked):
        return value
    return jnp.where(jnp.isnan(checked), jnp.nan, value)
