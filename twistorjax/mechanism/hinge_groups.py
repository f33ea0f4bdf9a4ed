"""Hinges with the same kind of energy, stacked for evaluation as one array operation."""

from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._utils.pytrees import group_by_structure
from .._utils.types import Scalar
from .._utils.validation import all_concrete
from ..energies.base import AbstractEnergy
from ..energies.damping import ViscousDamping
from ..energies.solver_protocols import (
    has_resisted_rates,
    parallel_terms,
    proportional_damping,
)
from .hinge import Hinge


class HingeGroup(eqx.Module):
    """Hinges with the same kind of energy and damping.

    A hinge whose energy is a sum has a member for each term.

    Args:
        members: Index of the hinge of each member.
        energy: Their energies, stacked; an array that all of them share is not repeated.
        damping: Their damping, stacked in the same way, if they are damped.
        axes: For each array of energy and damping 0 if it is stacked, None if shared.
    """

    members: tuple[int, ...] = eqx.field(static=True)
    energy: AbstractEnergy
    damping: ViscousDamping | None
    axes: tuple[int | None, ...] = eqx.field(static=True)


def group_hinges(hinges: Sequence[Hinge]) -> tuple[HingeGroup, ...]:
    """Sort the energies of hinges by kind, and stack those of the same kind.

    The terms of a sum act in parallel, each with its own damping, coordinates, and model
    for Newton's method.
    """
    rows, pairs = [], []
    for row, hinge in enumerate(hinges):
        terms = parallel_terms(hinge.energy)
        for term, damping in zip(terms, _distribute(hinge.damping, terms), strict=True):
            rows.append(row)
            pairs.append((term, damping))
    groups = []
    for indices in group_by_structure(pairs):
        tree = jax.tree.structure(pairs[indices[0]])
        columns = zip(*(jax.tree.leaves(pairs[k]) for k in indices), strict=True)
        leaves, axes = [], []
        for column in columns:
            shared = all(leaf is column[0] for leaf in column)
            axes.append(None if shared else 0)
            leaves.append(column[0] if shared else _stack(column))
        energy, damping = jax.tree.unflatten(tree, leaves)
        if eqx.is_array(damping):  # a time
            damping = _proportional(energy, damping, tuple(axes))
            axes[-1] = None if damping.damping.ndim == 2 else 0
        members = tuple(rows[k] for k in indices)
        groups.append(HingeGroup(members, energy, damping, tuple(axes)))
    return tuple(groups)


def sums_of(
    hinges: Sequence[Hinge],
) -> tuple[tuple[AbstractEnergy, ViscousDamping | Scalar | None] | None, ...]:
    """Return energy and damping of each hinge whose energy is a sum; None for others."""
    return tuple(
        (hinge.energy, hinge.damping) if len(parallel_terms(hinge.energy)) > 1 else None
        for hinge in hinges
    )


def _distribute(
    damping: ViscousDamping | Scalar | None, terms: Sequence[AbstractEnergy]
) -> list[ViscousDamping | Scalar | None]:
    """Distribute the damping of a hinge among the terms of its energy.

    A time multiplies the stiffness of each term; s. A damping acts once, with the first
    term that resists only a part of the rates, if there is one.
    """
    if not isinstance(damping, ViscousDamping):
        return [damping] * len(terms)
    chosen = next((k for k, term in enumerate(terms) if has_resisted_rates(term)), 0)
    return [damping if k == chosen else None for k in range(len(terms))]


@partial(jax.jit, static_argnames="axes")
def _proportional(
    energy: AbstractEnergy, time: Array, axes: tuple[int | None, ...]
) -> ViscousDamping:
    """Compute the damping of stacked energies in proportion to their stiffness.

    Args:
        energy: The energies.
        time: Factor of the stiffness; s.
        axes: Axes of the arrays of energies and times; see `HingeGroup`.
    """
    leaves, tree = jax.tree.flatten(energy)

    def one(leaves, time):
        return proportional_damping(jax.tree.unflatten(tree, leaves), time)

    *of_energy, of_time = axes
    if any(axis == 0 for axis in axes):
        one = jax.vmap(one, in_axes=(of_energy, of_time))
    return one(leaves, time)


def _stack(row: Sequence[Array]) -> Array:
    """Stack arrays; concrete ones at once, because each operation is compiled."""
    values = all_concrete(row)
    return jnp.stack(row) if values is None else jnp.asarray(np.stack(values))
