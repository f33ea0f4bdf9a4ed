"""The potential W of a flexure, and its maximum over one or two forces.

W is a function of bending and of forces in the stiff directions, which are divided by
reference values. A `MixedEnergy` has a polynomial potential of the axial force, a
`BeamColumn` that of a beam-column, and a `OneFreedomEnergy` a polynomial of two forces.
"""

from abc import abstractmethod
from functools import lru_cache, partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.pytrees import jvp_of_varied
from .._utils.types import Scalar
from .evaluation import (
    Coefficients,
    evaluate_polynomial,
    Orders,
    PartialSums,
    polynomial_derivatives,
    split_terms,
)
from .monomials import Powers


Bending = tuple[Scalar, Scalar]  # rotation, relative transverse displacement

AXIAL_COMPLIANCE = (0, 0, 2)  # powers of the term of the axial reference compliance

_STEPS = 6  # of Newton's method


class AbstractPotential(eqx.Module):
    """The potential W as a function of bending and of the relative axial force; J."""

    @property
    @abstractmethod
    def reference_curvature(self) -> Scalar:
        """Second derivative by the axial force, in the reference configuration; J."""

    @abstractmethod
    def derivatives(
        self, orders: tuple[Orders, ...], bending: Bending, force_ratio: Scalar
    ) -> tuple[Scalar, ...]:
        """Evaluate partial derivatives of W; J.

        The orders (0, 0, 0) are those of W itself. The sum of the orders is at most two.
        """

    @abstractmethod
    def force_ratio(self, bending: Bending, axial: Scalar) -> Scalar:
        """Find the relative axial force of an axial displacement by Newton's method.

        `axial` is the axial displacement times the reference force; J. The result is NaN
        if the stationary value is not a maximum. Its derivatives are those of
        `axial_force_ratio`.

        `optimistix.root_find` takes five times as long to compile and twice as long to
        run (100,000 values and derivatives), so the small Newton iterations of this
        library are loops of fixed length.
        """


class PolynomialPotential(AbstractPotential):
    """A potential that is a polynomial of its three variables.

    Between the relative forces minus one and one, W is the polynomial. Outside it is a
    parabola of the force.
    """

    coefficients: Float[Array, " terms"]  # Coefficients of the terms; J
    powers: Powers = eqx.field(static=True)  # Powers of the three variables in each term

    @property
    def reference_curvature(self) -> Scalar:
        return 2 * self.coefficients[self.powers.index(AXIAL_COMPLIANCE)]

    def derivatives(
        self, orders: tuple[Orders, ...], bending: Bending, force_ratio: Scalar
    ) -> tuple[Scalar, ...]:
        variables = *bending, force_ratio
        return polynomial_derivatives(
            self.powers, orders, self.coefficients, variables, (2,)
        )

    def force_ratio(self, bending: Bending, axial: Scalar) -> Scalar:
        # The sum over rotation and displacement is a polynomial of the force alone.
        force_first = tuple((force, *others) for *others, force in self.powers)
        zero = jnp.zeros_like(axial)
        sums = PartialSums(split_terms(force_first, self.coefficients), (zero, *bending))
        of_force = sums.over_last((0, 0))

        def slope_and_curvature(force_ratio: Scalar) -> tuple[Scalar, Scalar]:
            sums = PartialSums(of_force, (force_ratio,))
            return sums.over_last((1,)).get((), zero), sums.over_last((2,))[()]

        # Each iteration starts between minus one and one. The last one is exact outside
        # of this interval, because W is a parabola there.
        def newton_step(_, force_ratio: Scalar) -> Scalar:
            inside = jnp.clip(force_ratio, -1.0, 1.0)
            slope, curvature = slope_and_curvature(inside)
            return inside - (axial + slope) / curvature

        force_ratio = jax.lax.fori_loop(0, _STEPS, newton_step, zero)
        _, curvature = slope_and_curvature(jnp.clip(force_ratio, -1.0, 1.0))
        return jnp.where(curvature < 0, force_ratio, jnp.nan)


@jax.custom_jvp
def maximum_over_force(
    potential: AbstractPotential, bending: Bending, axial: Scalar
) -> Scalar:
    """Compute the stored energy, the maximum of `n t1 + W` over the axial force n; J.

    `axial` is the axial displacement times the reference force; J.
    """
    force_ratio = axial_force_ratio(potential, bending, axial)
    return _energy_at_force(force_ratio, potential, bending, axial)


@partial(maximum_over_force.defjvp, symbolic_zeros=True)
def _(primals, tangents):
    # At the maximum, the derivative with respect to the axial force is zero.
    at_force = partial(_energy_at_force, axial_force_ratio(*primals))
    return jvp_of_varied(at_force, primals, tangents)


def _energy_at_force(
    force_ratio: Scalar, potential: AbstractPotential, bending: Bending, axial: Scalar
) -> Scalar:
    """Compute `n t1 + W` for a relative axial force; J."""
    (value,) = potential.derivatives(((0, 0, 0),), bending, force_ratio)
    return axial * force_ratio + value


@jax.custom_jvp
def axial_force_ratio(
    potential: AbstractPotential, bending: Bending, axial: Scalar
) -> Scalar:
    """Compute the relative axial force; see `AbstractPotential.force_ratio`."""
    return potential.force_ratio(bending, axial)


@partial(axial_force_ratio.defjvp, symbolic_zeros=True)
def _(primals, tangents):
    force_ratio = axial_force_ratio(*primals)

    def residual(potential: AbstractPotential, bending: Bending, axial: Scalar) -> Scalar:
        (slope,) = potential.derivatives(((0, 0, 1),), bending, force_ratio)
        return axial + slope

    _, residual_rate = jvp_of_varied(residual, primals, tangents)
    potential, bending, _ = primals
    (curvature,) = potential.derivatives(((0, 0, 2),), bending, force_ratio)
    return force_ratio, -residual_rate / curvature


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
    """W and its derivatives by the coordinate and the two relative forces; J."""

    value: Scalar  # W
    by_compliant: Scalar  # Derivative by the compliant coordinate
    by_forces: tuple[Scalar, Scalar]  # Derivatives by the forces
    curvature: Scalar  # Second derivative by the compliant coordinate
    # Derivatives by the compliant coordinate and each of the forces
    mixed: tuple[Scalar, Scalar]
    # Second derivatives by the forces: 11, 12, 22
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
