"""Energies of hinges whose dimensions grow in proportion, as by thermal expansion."""

from dataclasses import fields
from operator import attrgetter
from typing import Any, Protocol, runtime_checkable, TypeVar

import equinox as eqx
from jaxtyping import Array, Float

from .._utils.host import as_float, on_host
from .base import AbstractEnergy
from .stress_model import AbstractStressModel


Energy = TypeVar("Energy", bound=AbstractEnergy)


@runtime_checkable
class CanDilate(Protocol):
    """An energy that knows that of a hinge whose dimensions are a multiple."""

    def dilated(self, scale: Float[Array, "*batch"]) -> AbstractEnergy:
        """Return the energy if all dimensions of the hinge are multiplied.

        It is the same object if the dimensions of the hinge are unknown. Otherwise, the
        energy at a rotation and a translation becomes `scale^3` times that at the
        rotation and the translation divided by `scale`.

        Args:
            scale: The factor; one for each energy if the energies are stacked.

        Returns:
            The energy of the larger hinge.
        """
        ...


def dilated(energy: AbstractEnergy, scale: Float[Array, "*batch"]) -> AbstractEnergy:
    """Return an energy if all dimensions of its hinge are multiplied by a factor.

    It applies to all energies in sums, multiples, and other wrappers, and to their
    validity ranges and stress models. An energy of unknown dimensions does not change:
    one that is not `CanDilate`, or a `Quadratic` that is not that of a flexure.
    """
    new, is_wrapper = energy, False
    for field in fields(energy):
        value: Any = getattr(energy, field.name, None)
        parts = value if isinstance(value, tuple) else (value,)
        if not any(isinstance(part, AbstractEnergy) for part in parts):
            continue
        is_wrapper = True
        larger = tuple(dilated(part, scale) for part in parts)
        if any(part is not old for part, old in zip(larger, parts, strict=True)):
            larger = larger if isinstance(value, tuple) else larger[0]
            new = eqx.tree_at(attrgetter(field.name), new, larger)
    if is_wrapper and new is energy:
        return energy
    if isinstance(new, CanDilate):
        new = new.dilated(scale)
    model = getattr(new, "stress_model", None)
    if new is not energy and isinstance(model, AbstractStressModel):
        new = eqx.tree_at(attrgetter("stress_model"), new, model.dilated(scale))
    return new


def dilated_potential(energy: Energy, scale: Float[Array, "*batch"]) -> Energy:
    """Return an energy with the fields `coefficients`, `length`, and `force`.

    Args:
        energy: An energy whose coefficients (J) belong to displacements over the length
            (m) and forces over the force (N).
        scale: The factor of all dimensions of its hinge.

    Returns:
        The energy of the larger hinge.
    """
    xp, (scale, *values) = on_host(scale, *_potential_fields(energy))
    coefficients, length, force = values
    shape = (*xp.shape(scale), coefficients.shape[-1])
    factors = xp.broadcast_to(xp.asarray(scale**3)[..., None], shape)
    return eqx.tree_at(
        _potential_fields,
        energy,
        (
            as_float(factors * xp.broadcast_to(coefficients, factors.shape)),
            as_float(scale * length),
            as_float(scale**2 * force),
        ),
    )


_potential_fields = attrgetter("coefficients", "length", "force")
