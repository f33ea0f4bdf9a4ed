"""The potential W of a `MixedEnergy`, and its maximum over the axial force.

W is a polynomial of the rotation, the relative transverse displacement and the relative
axial force, which are divided by a reference length and a reference force. All functions
take the powers and coefficients (J) of W.
"""

from functools import partial

import jax
import jax.numpy as jnp

from .._utils.pytrees import jvp_of_varied
from .._utils.types import Scalar
from .evaluation import (
    Coefficients,
    Orders,
    PartialSums,
    polynomial_derivatives,
    split_terms,
)
from .monomials import Powers


Bending = tuple[Scalar, Scalar]  # rotation, relative transverse displacement

_STEPS = 6  # of Newton's method


def potential_derivatives(
    powers: Powers,
    orders: tuple[Orders, ...],
    coefficients: Coefficients,
    bending: Bending,
    force_ratio: Scalar,
) -> tuple[Scalar, ...]:
    """Evaluate partial derivatives of W; J.

    The orders (0, 0, 0) are those of W itself. Between the relative forces minus one and
    one, W is the polynomial. Outside it is a parabola of the force.
    """
    variables = *bending, force_ratio
    return polynomial_derivatives(powers, orders, coefficients, variables, (2,))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def maximum_over_force(
    powers: Powers, coefficients: Coefficients, bending: Bending, axial: Scalar
) -> Scalar:
    """Compute the stored energy, the maximum of `n t1 + W` over the axial force n; J.

    `axial` is the axial displacement times the reference force; J.
    """
    force_ratio = axial_force_ratio(powers, coefficients, bending, axial)
    return _energy_at_force(powers, force_ratio, coefficients, bending, axial)


@partial(maximum_over_force.defjvp, symbolic_zeros=True)
def _(powers, primals, tangents):
    # At the maximum, the derivative with respect to the axial force is zero.
    force_ratio = axial_force_ratio(powers, *primals)
    at_force = partial(_energy_at_force, powers, force_ratio)
    return jvp_of_varied(at_force, primals, tangents)


def _energy_at_force(
    powers: Powers,
    force_ratio: Scalar,
    coefficients: Coefficients,
    bending: Bending,
    axial: Scalar,
) -> Scalar:
    """Compute `n t1 + W` for a relative axial force; J."""
    (value,) = potential_derivatives(
        powers, ((0, 0, 0),), coefficients, bending, force_ratio
    )
    return axial * force_ratio + value


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def axial_force_ratio(
    powers: Powers, coefficients: Coefficients, bending: Bending, axial: Scalar
) -> Scalar:
    """Compute the relative axial force of an axial displacement.

    `axial` is the axial displacement times the reference force; J. The result is NaN if
    the stationary value is not a maximum.

    Each Newton iteration starts between minus one and one. The last iteration is exact
    outside of this interval, because W is a parabola there.
    `optimistix.root_find` takes five times as long to compile and twice as long to run
    (100,000 values and derivatives), so the small Newton iterations of this library are
    loops of fixed length.
    """
    # The sum over rotation and displacement is a polynomial of the force alone.
    force_first = tuple((force, *others) for *others, force in powers)
    zero = jnp.zeros_like(axial)
    sums = PartialSums(split_terms(force_first, coefficients), (zero, *bending))
    of_force = sums.over_last((0, 0))

    def slope_and_curvature(force_ratio: Scalar) -> tuple[Scalar, Scalar]:
        sums = PartialSums(of_force, (force_ratio,))
        return sums.over_last((1,)).get((), zero), sums.over_last((2,))[()]

    def newton_step(_, force_ratio: Scalar) -> Scalar:
        inside = jnp.clip(force_ratio, -1.0, 1.0)
        slope, curvature = slope_and_curvature(inside)
        return inside - (axial + slope) / curvature

    force_ratio = jax.lax.fori_loop(0, _STEPS, newton_step, zero)
    _, curvature = slope_and_curvature(jnp.clip(force_ratio, -1.0, 1.0))
    return jnp.where(curvature < 0, force_ratio, jnp.nan)


@partial(axial_force_ratio.defjvp, symbolic_zeros=True)
def _(powers, primals, tangents):
    coefficients, bending, _ = primals
    force_ratio = axial_force_ratio(powers, *primals)

    def residual(coefficients: Coefficients, bending: Bending, axial: Scalar) -> Scalar:
        (slope,) = potential_derivatives(
            powers, ((0, 0, 1),), coefficients, bending, force_ratio
        )
        return axial + slope

    _, residual_rate = jvp_of_varied(residual, primals, tangents)
    (curvature,) = potential_derivatives(
        powers, ((0, 0, 2),), coefficients, bending, force_ratio
    )
    return force_ratio, -residual_rate / curvature
