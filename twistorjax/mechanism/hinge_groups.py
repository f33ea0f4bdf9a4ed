"""Energies of one kind, stacked so that all of them are one array operation."""

from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._utils.pytrees import alike
from .._utils.types import Scalar
from .._utils.validation import all_concrete
from ..energies.base import AbstractEnergy
from ..energies.damping import ViscousDamping
from .hinge import Hinge


class HingeGroup(eqx.Module):
    """Hinges of one kind of energy and damping, evaluated as one array operation.

    A hinge whose energy is a sum has a place for each term.

    Args:
        members: their places in the mechanism's list of hinges.
        energy: their energies, stacked; what all of them share stands once.
        damping: the same of what they dissipate, if anything.
        axes: for each array of the two 0 where it is stacked, or nothing.
    """

    members: tuple[int, ...] = eqx.field(static=True)
    energy: AbstractEnergy
    damping: ViscousDamping | None
    axes: tuple[int | None, ...] = eqx.field(static=True)


def group_hinges(hinges: Sequence[Hinge]) -> tuple[HingeGroup, ...]:
    """Sort the energies of hinges by kind, and stack those of one kind.

    The terms of a sum act side by side, each with its own damping, coordinates and
    prediction for Newton's method.
    """
    rows, couples = [], []
    for row, hinge in enumerate(hinges):
        terms = hinge.energy.parallel_terms()
        for term, damping in zip(terms, _shared(hinge.damping, terms), strict=True):
            rows.append(row)
            couples.append((term, damping))
    stacks = []
    for places in alike(couples):
        tree = jax.tree.structure(couples[places[0]])
        columns = zip(*(jax.tree.leaves(couples[k]) for k in places), strict=True)
        leaves, axes = [], []
        for column in columns:
            shared = all(leaf is column[0] for leaf in column)
            axes.append(None if shared else 0)
            leaves.append(column[0] if shared else _stacked(column))
        energy, damping = jax.tree.unflatten(tree, leaves)
        if eqx.is_array(damping):  # a time
            damping = _proportional(energy, damping, tuple(axes))
            axes[-1] = None if damping.damping.ndim == 2 else 0
        members = tuple(rows[k] for k in places)
        stacks.append(HingeGroup(members, energy, damping, tuple(axes)))
    return tuple(stacks)


def sums_of(
    hinges: Sequence[Hinge],
) -> tuple[tuple[AbstractEnergy, ViscousDamping | Scalar | None] | None, ...]:
    """The energies of hinges that are sums, and their dampings; see `HingeAssembly`."""
    return tuple(
        (hinge.energy, hinge.damping) if len(hinge.energy.parallel_terms()) > 1 else None
        for hinge in hinges
    )


def _shared(
    damping: ViscousDamping | Scalar | None, terms: Sequence[AbstractEnergy]
) -> list[ViscousDamping | Scalar | None]:
    """The damping of each term of a sum, from that of the hinge.

    A time multiplies the stiffness of each term. A damping as such acts once, beside a
    term that says which rates it resists, if there is one.
    """
    if not isinstance(damping, ViscousDamping):
        return [damping] * len(terms)
    chosen = next((k for k, term in enumerate(terms) if term.has_resisted_rates()), 0)
    return [damping if k == chosen else None for k in range(len(terms))]


@partial(jax.jit, static_argnames="axes")
def _proportional(
    energy: AbstractEnergy, time: Array, axes: tuple[int | None, ...]
) -> ViscousDamping:
    """The dampings that are the stiffness at rest times a time, of stacked energies."""
    leaves, tree = jax.tree.flatten(energy)

    def one(leaves, time):
        return jax.tree.unflatten(tree, leaves).proportional_damping(time)

    *of_energy, of_time = axes
    if any(axis == 0 for axis in axes):
        one = jax.vmap(one, in_axes=(of_energy, of_time))
    return one(leaves, time)


def _stacked(row: Sequence[Array]) -> Array:
    # a thousand traced rows would be a thousand operations to compile
    values = all_concrete(row)
    return jnp.stack(row) if values is None else jnp.asarray(np.stack(values))
