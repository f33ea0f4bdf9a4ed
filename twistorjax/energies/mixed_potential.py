"""The mixed potential W of a flexure as a function of its axial force.

At a fixed rotation and transverse displacement, the potential W of a `MixedEnergy` is a
polynomial of the relative axial force, the axial force divided by a reference force.
"""

import math

import jax
import jax.numpy as jnp

from .._utils.types import Scalar


# Coefficients of the powers of the relative axial force, from the power zero on; J
ForceSeries = tuple[Scalar, ...]


def mixed_potential(
    series: ForceSeries, force_ratio: Scalar, derivative: int = 0
) -> Scalar:
    """Evaluate W or its first or second derivative with respect to the relative force; J.

    Between the relative forces minus one and one, W is the polynomial with the given
    coefficients. Outside it is a parabola.
    """
    inside = jnp.clip(force_ratio, -1.0, 1.0)
    outside = force_ratio - inside

    def polynomial(derivative: int) -> Scalar:
        total = jnp.zeros_like(inside)
        for power in reversed(range(derivative, len(series))):
            total = total * inside + math.perm(power, derivative) * series[power]
        return total

    if derivative == 2:
        return polynomial(2)
    if derivative == 1:
        return polynomial(1) + outside * polynomial(2)
    return polynomial(0) + outside * (polynomial(1) + outside * polynomial(2) / 2)


@jax.custom_jvp
def maximum_over_force(series: ForceSeries, axial: Scalar) -> Scalar:
    """Compute the stored energy, the maximum of `n t1 + W` over the axial force n; J.

    `axial` is the axial displacement times the reference force; J.
    """
    force_ratio = axial_force_ratio(series, axial)
    return axial * force_ratio + mixed_potential(series, force_ratio)


@maximum_over_force.defjvp
def _(primals, tangents):
    # At the maximum, the derivative with respect to the axial force is zero.
    series, axial = primals
    series_rates, axial_rate = tangents
    force_ratio = axial_force_ratio(series, axial)
    value = axial * force_ratio + mixed_potential(series, force_ratio)
    rate = force_ratio * axial_rate + mixed_potential(series_rates, force_ratio)
    return value, rate


@jax.custom_jvp
def axial_force_ratio(series: ForceSeries, axial: Scalar) -> Scalar:
    """Compute the relative axial force of an axial displacement.

    `axial` is the axial displacement times the reference force; J. The result is NaN if
    the stationary value is not a maximum.

    Each Newton iteration starts between minus one and one. The last iteration is exact
    outside of this interval, because W is a parabola there.
    `optimistix.root_find` takes five times as long to compile and twice as long to run
    (100,000 values and derivatives), so the small Newton iterations of this library are
    loops of fixed length.
    """

    def newton_step(_, force_ratio: Scalar) -> Scalar:
        inside = jnp.clip(force_ratio, -1.0, 1.0)
        residual = axial + mixed_potential(series, inside, 1)
        return inside - residual / mixed_potential(series, inside, 2)

    force_ratio = jax.lax.fori_loop(0, 6, newton_step, jnp.zeros_like(axial))
    is_maximum = mixed_potential(series, force_ratio, 2) < 0
    return jnp.where(is_maximum, force_ratio, jnp.nan)


@axial_force_ratio.defjvp
def _(primals, tangents):
    series, axial = primals
    series_rates, axial_rate = tangents
    force_ratio = axial_force_ratio(series, axial)
    residual_rate = axial_rate + mixed_potential(series_rates, force_ratio, 1)
    return force_ratio, -residual_rate / mixed_potential(series, force_ratio, 2)
