"""Optional methods of energies, which reduce solver steps or define damping.

Only the methods for damping change a solution. The functions of this module find the
methods of an energy also if it is multiplied by a factor or has a validity range. The
terms of a sum are treated as separate hinges. An energy without a method has the default.
"""

from typing import Protocol, runtime_checkable

import jax.numpy as jnp

from .._utils.types import Scalar
from ..geometry.twistors import Displacement
from .base import AbstractEnergy, AbstractWrapper, HasValidityRange, Scaled, Sum
from .damping import ViscousDamping


Rates = tuple[Scalar, Scalar, Scalar]
Stress = tuple[Scalar, Scalar, Scalar]


@runtime_checkable
class HasTranslationScale(Protocol):
    """An energy that is nearly quadratic in scaled mid-frame translations."""

    def translation_scale(self, displacement: Displacement) -> Scalar:
        """Compute the factor by which mid-frame translations are multiplied.

        Returns:
            The dimensionless factor, a function of the angle only.
        """
        ...


@runtime_checkable
class HasNewtonModel(Protocol):
    """An energy that Newton's method replaces by another energy, to need fewer steps."""

    def newton_model(self, stress: Stress) -> AbstractEnergy:
        """Return the energy that replaces it in a Newton step.

        Args:
            stress: Predicted generalized stress: moment, axial force, and transverse
                force; N m, N, N.

        Returns:
            An energy whose derivatives agree with those of this energy to first order,
            near the predicted stress.
        """
        ...


@runtime_checkable
class HasProportionalDamping(Protocol):
    """An energy with a formula for damping in proportion to its stiffness."""

    def proportional_damping(self, time: Scalar) -> ViscousDamping:
        """Return the damping that is the stiffness times a time.

        Args:
            time: Factor of the stiffness in the reference configuration; s.

        Returns:
            The damping; N m s/rad, N s/rad, N s/m.
        """
        ...


@runtime_checkable
class HasResistedRates(Protocol):
    """An energy whose proportional damping acts only on strain rates that it resists."""

    def resisted_rates(self, displacement: Displacement, rates: Rates) -> Rates:
        """Return the part of the strain rates that the energy resists.

        Args:
            rates: Rates of the twist; rad/s, m/s, m/s.

        Returns:
            The rates on which the damping acts; rad/s, m/s, m/s.
        """
        ...


def unwrap(energy: AbstractEnergy) -> AbstractEnergy:
    """Remove factors and validity ranges from an energy."""
    while isinstance(energy, AbstractWrapper):
        energy = energy.energy
    return energy


def translation_scale(energy: AbstractEnergy, displacement: Displacement) -> Scalar:
    """Compute the factor by which mid-frame translations are multiplied.

    Newton's method predicts the generalized stress of a hinge with respect to the scaled
    translations. It takes few steps if the energy is nearly quadratic in them.
    """
    inner = unwrap(energy)
    if isinstance(inner, HasTranslationScale):
        return inner.translation_scale(displacement)
    return jnp.ones_like(displacement.angle)


def newton_model(energy: AbstractEnergy, stress: Stress) -> AbstractEnergy:
    """Return the energy that replaces another one near a predicted stress; N m, N, N."""
    if isinstance(energy, HasNewtonModel):
        return energy.newton_model(stress)
    if isinstance(energy, AbstractWrapper):
        if energy.multiple is None:
            return newton_model(energy.energy, stress)
        positive = energy.multiple > 0
        multiple = jnp.where(positive, energy.multiple, 1.0)
        m, n1, n2 = (jnp.where(positive, part / multiple, 0.0) for part in stress)
        model = newton_model(energy.energy, (m, n1, n2))
        return Scaled(factor=energy.multiple, energy=model)
    return energy


def proportional_damping(energy: AbstractEnergy, time: Scalar) -> ViscousDamping:
    """Return the damping that is the stiffness in the reference pose times `time`; s."""
    if isinstance(energy, AbstractWrapper):
        factor = 1.0 if energy.multiple is None else energy.multiple
        return proportional_damping(energy.energy, factor * time)
    if isinstance(energy, HasProportionalDamping):
        return energy.proportional_damping(time)
    return ViscousDamping(time * energy.tangent_stiffness())


def has_resisted_rates(energy: AbstractEnergy) -> bool:
    """Decide whether an energy resists only a part of the twist rates."""
    return isinstance(unwrap(energy), HasResistedRates)


def resisted_rates(
    energy: AbstractEnergy, displacement: Displacement, rates: Rates
) -> Rates:
    """Return the part of the twist rates that an energy resists; rad/s, m/s, m/s.

    By default, these are all of them.
    """
    inner = unwrap(energy)
    if isinstance(inner, HasResistedRates):
        return inner.resisted_rates(displacement, rates)
    return rates


class _RangeOnly(AbstractEnergy):
    """The validity range of a sum, without its energy."""

    energy: AbstractEnergy

    def stored_energy(self, displacement: Displacement) -> Scalar:
        return jnp.zeros_like(displacement.angle)


def parallel_terms(energy: AbstractEnergy) -> tuple[AbstractEnergy, ...]:
    """Split an energy into the terms of its sum; itself, if it is not a sum.

    A mechanism treats the terms as hinges in parallel, so that each term has its own
    optional methods. If a sum has a validity range, an additional term without energy
    checks this range.
    """
    if isinstance(energy, Sum):
        return tuple(term for part in energy.parts for term in parallel_terms(part))
    if not isinstance(energy, AbstractWrapper):
        return (energy,)
    terms = parallel_terms(energy.energy)
    if len(terms) == 1:
        return (energy,)
    if energy.multiple is not None:
        terms = tuple(Scaled(factor=energy.multiple, energy=term) for term in terms)
    if isinstance(energy, HasValidityRange):
        terms = (*terms, _RangeOnly(energy))
    return terms
