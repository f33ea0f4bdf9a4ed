"""The potential W of a flexure, and its maximum over the axial force.

W is a function of the rotation, the relative transverse displacement and the relative
axial force, which are divided by a reference length and a reference force. A
`MixedEnergy` has a polynomial potential, and a `BeamColumn` that of a beam-column.
"""

from abc import abstractmethod
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._utils.pytrees import jvp_of_varied
from .._utils.types import Scalar
from .evaluation import Orders, PartialSums, polynomial_derivatives, split_terms
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

    Args:
        coefficients: Coefficients of the terms; J.
        powers: Powers of the three variables in each term.
    """

    coefficients: Float[Array, " terms"]
    powers: Powers = eqx.field(static=True)

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
