"""Energies of hinges whose dimensions grow in proportion, as by thermal expansion."""

from dataclasses import fields
from operator import attrgetter
from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from .._utils.host import as_float, on_host
from .base import AbstractEnergy, is_energy
from .stress_model import AbstractStressModel


Part = TypeVar("Part", bound=AbstractEnergy | AbstractStressModel)


def dilated(energy: AbstractEnergy, scale: Float[Array, "*batch"]) -> AbstractEnergy:
    """Return an energy if all dimensions of its hinge are multiplied by a factor.

    It applies to all energies in sums, multiples, and other wrappers, and to their
    validity ranges and stress models. An energy of unknown dimensions does not change.
    """
    new, has_parts = energy, False
    for field in fields(energy):
        parts, tree = jax.tree.flatten(getattr(energy, field.name, None), is_energy)
        if not any(map(is_energy, parts)):
            continue
        has_parts = True
        larger = [dilated(part, scale) if is_energy(part) else part for part in parts]
        if any(part is not old for part, old in zip(larger, parts, strict=True)):
            value = jax.tree.unflatten(tree, larger)
            new = eqx.tree_at(attrgetter(field.name), new, value)
    if has_parts and new is energy:
        return energy
    new = new.dilated(scale)
    model = getattr(new, "stress_model", None)
    if new is not energy and isinstance(model, AbstractStressModel):
        new = eqx.tree_at(attrgetter("stress_model"), new, model.dilated(scale))
    return new


def multiply_fields(part: Part, scale: Float[Array, "*batch"], **exponents: Any) -> Part:
    """Multiply fields of an energy or a stress model by powers of the factor `scale`.

    All dimensions of the hinge are multiplied by this factor; there is one for each
    energy if energies are stacked. The exponent of a field has as many axes as the field
    of one energy has. Fields that are None stay None.
    """
    names = [name for name in exponents if getattr(part, name) is not None]
    xp, (scale, *values) = on_host(scale, *(getattr(part, name) for name in names))
    new = []
    for name, value in zip(names, values, strict=True):
        exponent = np.asarray(exponents[name], float)
        axes = exponent.ndim
        shape = (*scale.shape, *value.shape[value.ndim - axes :])
        factors = xp.broadcast_to(scale[(..., *axes * (None,))], shape)
        factors = factors ** np.broadcast_to(exponent, shape)
        new.append(as_float(factors * xp.broadcast_to(value, shape)))
    return eqx.tree_at(lambda part: [getattr(part, name) for name in names], part, new)
