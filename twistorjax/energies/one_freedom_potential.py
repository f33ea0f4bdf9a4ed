"""The potential of a `OneFreedomEnergy`, and its maximum over two forces.

The potential W is a polynomial of the compliant coordinate and of two forces divided by
their reference values. All functions take the powers and coefficients (J) of W.
"""

from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._utils.types import Scalar
from .evaluation import Coefficients, evaluate_polynomial
from .monomials import Powers


ForceRatios = tuple[Scalar, Scalar]

_STEPS = 6  # of Newton's method; the first one is exact for a quadratic potential


def potential(
    powers: Powers, coefficients: Coefficients, compliant: Scalar, forces: ForceRatios
) -> Scalar:
    """Evaluate W; J.

    In terms of third and higher order in the forces, a force beyond its reference value
    saturates. There W is nearly quadratic in the forces, so it has a maximum.
    """
    quadratic, higher = _split(powers)
    saturated = tuple(_saturate(force) for force in forces)
    total = evaluate_polynomial(
        tuple(powers[k] for k in quadratic), coefficients[np.array(quadratic, int)],
        (compliant, *forces),
    )  # fmt: skip
    if not higher:
        return total
    return total + evaluate_polynomial(
        tuple(powers[k] for k in higher), coefficients[np.array(higher, int)],
        (compliant, *saturated),
    )  # fmt: skip


@lru_cache
def _split(powers: Powers) -> tuple[list[int], list[int]]:
    """List the terms up to the second order in the forces, and all others."""
    orders = [row[1] + row[2] for row in powers]
    return (
        [k for k, order in enumerate(orders) if order <= 2],
        [k for k, order in enumerate(orders) if order > 2],
    )


def _saturate(force: Scalar) -> Scalar:
    """Limit a relative force to the interval from -2 to 2.

    The function is the identity from -1 to 1, and twice continuously differentiable.
    """
    inside = jnp.clip(force, -1.0, 1.0)
    return inside + jnp.tanh(force - inside)


class PotentialDerivatives(NamedTuple):
    """W and its derivatives by the compliant coordinate and the two relative forces; J.

    Args:
        value: W.
        by_compliant: Derivative by the compliant coordinate.
        by_forces: Derivatives by the forces.
        curvature: Second derivative by the compliant coordinate.
        mixed: Derivatives by the compliant coordinate and each of the forces.
        by_forces_twice: Second derivatives by the forces: 11, 12, 22.
    """

    value: Scalar
    by_compliant: Scalar
    by_forces: tuple[Scalar, Scalar]
    curvature: Scalar
    mixed: tuple[Scalar, Scalar]
    by_forces_twice: tuple[Scalar, Scalar, Scalar]

    def force_step(self, residual: tuple[Scalar, Scalar]) -> ForceRatios:
        """Return the change of the forces that eliminates a residual; J."""
        h11, h12, h22 = self.by_forces_twice
        determinant = h11 * h22 - h12**2
        first, second = residual
        return (
            (h12 * second - h22 * first) / determinant,
            (h12 * first - h11 * second) / determinant,
        )

    @property
    def is_maximum(self) -> Array:
        """Whether the second derivatives by the forces are negative definite."""
        h11, h12, h22 = self.by_forces_twice
        return (h11 < 0) & (h11 * h22 > h12**2)


@partial(jax.jit, static_argnums=0)
def potential_derivatives(
    powers: Powers, coefficients: Coefficients, compliant: Scalar, forces: ForceRatios
) -> PotentialDerivatives:
    """Evaluate W and its derivatives."""

    def gradient(compliant: Scalar, first: Scalar, second: Scalar):
        return jax.value_and_grad(
            lambda *at: potential(powers, coefficients, at[0], at[1:]), (0, 1, 2)
        )(compliant, first, second)

    (value, (by_compliant, *by_forces)), times = jax.linearize(
        gradient, compliant, *forces
    )
    one, zero = jnp.ones_like(compliant), jnp.zeros_like(compliant)
    _, (curvature, *mixed) = times(one, zero, zero)
    _, (_, h11, h12) = times(zero, one, zero)
    _, (_, _, h22) = times(zero, zero, one)
    return PotentialDerivatives(
        value, by_compliant, tuple(by_forces), curvature, tuple(mixed), (h11, h12, h22)
    )


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def maximum_over_forces(
    powers: Powers,
    coefficients: Coefficients,
    compliant: Scalar,
    stretches: tuple[Scalar, Scalar],
) -> Scalar:
    """Compute the stored energy, the maximum of `f . s + W` over the forces f; J.

    The stretches s are displacements in the stiff directions times reference forces; J.
    """
    forces = force_ratios_at(powers, coefficients, compliant, stretches)
    work = forces[0] * stretches[0] + forces[1] * stretches[1]
    return work + potential(powers, coefficients, compliant, forces)


@maximum_over_forces.defjvp
def _(powers, primals, tangents):
    # At the maximum, the derivatives by the forces are zero.
    coefficients, compliant, stretches = primals
    coefficient_rates, rate, stretch_rates = tangents
    forces = force_ratios_at(powers, *primals)
    value, slope = jax.jvp(
        lambda coefficients, at: potential(powers, coefficients, at, forces),
        (coefficients, compliant),
        (coefficient_rates, rate),
    )
    for force, stretch, stretch_rate in zip(
        forces, stretches, stretch_rates, strict=True
    ):
        value, slope = value + force * stretch, slope + force * stretch_rate
    return value, slope


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def force_ratios_at(
    powers: Powers,
    coefficients: Coefficients,
    compliant: Scalar,
    stretches: tuple[Scalar, Scalar],
) -> ForceRatios:
    """Compute the relative forces at stretches (J) by Newton's method.

    They are NaN if the stationary value is not a maximum.
    """

    def newton_step(_, forces: ForceRatios) -> ForceRatios:
        at = potential_derivatives(powers, coefficients, compliant, forces)
        step = at.force_step(
            (stretches[0] + at.by_forces[0], stretches[1] + at.by_forces[1])
        )
        return forces[0] + step[0], forces[1] + step[1]

    zero = jnp.zeros_like(stretches[0])
    forces = jax.lax.fori_loop(0, _STEPS, newton_step, (zero, zero))
    at = potential_derivatives(powers, coefficients, compliant, forces)
    first, second = (jnp.where(at.is_maximum, force, jnp.nan) for force in forces)
    return first, second


@force_ratios_at.defjvp
def _(powers, primals, tangents):
    coefficients, compliant, _ = primals
    coefficient_rates, rate, stretch_rates = tangents
    forces = force_ratios_at(powers, *primals)
    at = potential_derivatives(powers, coefficients, compliant, forces)
    by_coefficients = jax.grad(
        lambda forces: potential(powers, coefficient_rates, compliant, forces)
    )(forces)
    residual = tuple(
        stretch_rates[k] + at.mixed[k] * rate + by_coefficients[k] for k in range(2)
    )
    return forces, at.force_step(residual)


def resisted_stretch_rates(
    powers: Powers,
    coefficients: Coefficients,
    compliant: Scalar,
    stretches: tuple[Scalar, Scalar],
    rate: Scalar,
    stretch_rates: tuple[Scalar, Scalar],
) -> tuple[Scalar, Scalar]:
    """Return the elastic stretch rates, scaled by the stiffness; J/s.

    With the stiffness K and that of the reference configuration K0, both factorized as
    L L^T, the elastic rates are multiplied by `L0^-T L^T`. Their power with K0 is then
    that of the elastic rates with K.
    """
    forces = force_ratios_at(powers, coefficients, compliant, stretches)
    at = potential_derivatives(powers, coefficients, compliant, forces)
    elastic = tuple(stretch_rates[k] + at.mixed[k] * rate for k in range(2))
    zero = jnp.zeros_like(compliant)
    reference = potential_derivatives(powers, coefficients, zero, (zero, zero))
    a, b, d = _upper_factor(at)
    a0, b0, d0 = _upper_factor(reference)
    first, second = a * elastic[0] + b * elastic[1], d * elastic[1]
    scaled = second / d0
    return (first - b0 * scaled) / a0, scaled


def _upper_factor(at: PotentialDerivatives) -> tuple[Scalar, Scalar, Scalar]:
    """Factorize the stiffness, the inverse of minus the second derivatives by forces.

    The factor is the upper triangle (a, b, d) of `L^T`.
    """
    h11, h12, h22 = at.by_forces_twice
    determinant = h11 * h22 - h12**2
    k11, k12, k22 = -h22 / determinant, h12 / determinant, -h11 / determinant
    a = jnp.sqrt(k11)
    b = k12 / a
    return a, b, jnp.sqrt(k22 - b**2)
