"""Optional properties of energies by which solvers and damping treat them better.

They change no solution, only the number of steps, except for damping. The functions of
this module find a property also inside of multiples and validity ranges; hinges treat the
terms of a sum one by one. An energy without a property has the default.
"""

from typing import Protocol, runtime_checkable

import jax.numpy as jnp

from .._utils.types import Scalar
from ..geometry.twistors import Displacement
from .base import AbstractEnergy, AbstractWrapper, HasValidityRange, Scaled, Sum
from .damping import ViscousDamping


Rates = tuple[Scalar, Scalar, Scalar]


@runtime_checkable
class HasTranslationScale(Protocol):
    """An energy that is nearly quadratic in translations of its own coordinates."""

    def translation_scale(self, displacement: Displacement) -> Scalar:
        """Compute the ratio of its own translations to those in the mid-frame."""
        ...


@runtime_checkable
class HasNewtonModel(Protocol):
    """An energy with a better model for Newton's method than its own derivatives."""

    def newton_model(self, axial_force: Scalar) -> AbstractEnergy:
        """Return the energy that replaces it in a Newton step.

        Args:
            axial_force: Predicted force along axis 1; N. Near this force, the derivatives
                of the model agree with its own to first order.
        """
        ...


@runtime_checkable
class HasProportionalDamping(Protocol):
    """An energy with a formula for damping in proportion to its stiffness."""

    def proportional_damping(self, time: Scalar) -> ViscousDamping:
        """Return the damping that is the stiffness times a time; N m s/rad, N s/m."""
        ...


@runtime_checkable
class HasResistedRates(Protocol):
    """An energy that is stiff against some combinations of the twist rates only."""

    def resisted_rates(self, displacement: Displacement, rates: Rates) -> Rates:
        """Return the part of the twist rates that the energy resists."""
        ...


def bare(energy: AbstractEnergy) -> AbstractEnergy:
    """Remove factors and validity ranges from an energy."""
    while isinstance(energy, AbstractWrapper):
        energy = energy.energy
    return energy


def translation_scale(energy: AbstractEnergy, displacement: Displacement) -> Scalar:
    """Compute the ratio of the energy's own translations to those in the mid-frame.

    Newton's method predicts the generalized stress of a hinge in these coordinates, and
    takes few steps if the energy is nearly quadratic in them.
    """
    inner = bare(energy)
    if isinstance(inner, HasTranslationScale):
        return inner.translation_scale(displacement)
    return jnp.ones_like(displacement.angle)


def newton_model(energy: AbstractEnergy, axial_force: Scalar) -> AbstractEnergy:
    """Return the energy that replaces another one in a Newton step.

    Args:
        energy: The energy.
        axial_force: Predicted force along axis 1; N.
    """
    if isinstance(energy, AbstractWrapper):
        if energy.multiple is None:
            return newton_model(energy.energy, axial_force)
        positive = energy.multiple > 0
        share = axial_force / jnp.where(positive, energy.multiple, 1.0)
        share = jnp.where(positive, share, 0.0)
        return Scaled(factor=energy.multiple, energy=newton_model(energy.energy, share))
    if isinstance(energy, HasNewtonModel):
        return energy.newton_model(axial_force)
    return energy


def proportional_damping(energy: AbstractEnergy, time: Scalar) -> ViscousDamping:
    """Return the damping that is the stiffness in the reference pose times a time; s."""
    if isinstance(energy, AbstractWrapper):
        factor = 1.0 if energy.multiple is None else energy.multiple
        return proportional_damping(energy.energy, factor * time)
    if isinstance(energy, HasProportionalDamping):
        return energy.proportional_damping(time)
    return ViscousDamping(time * energy.tangent_stiffness())


def has_resisted_rates(energy: AbstractEnergy) -> bool:
    """Decide whether an energy resists only a part of the twist rates."""
    return isinstance(bare(energy), HasResistedRates)


def resisted_rates(
    energy: AbstractEnergy, displacement: Displacement, rates: Rates
) -> Rates:
    """Return the part of the twist rates that an energy resists; rad/s, m/s, m/s."""
    inner = bare(energy)
    if isinstance(inner, HasResistedRates):
        return inner.resisted_rates(displacement, rates)
    return rates


class _RangeOnly(AbstractEnergy):
    """The validity range of a sum, without its energy."""

    energy: AbstractEnergy

    def stored_energy(self, displacement: Displacement) -> Scalar:
        return jnp.zeros_like(displacement.angle)


def parallel_terms(energy: AbstractEnergy) -> tuple[AbstractEnergy, ...]:
    """Split an energy into the terms of its sum; itself, if it is no sum.

    A mechanism treats the terms as hinges in parallel, so that each term keeps its own
    properties. If a sum has a validity range, one more term checks it and stores nothing.
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
