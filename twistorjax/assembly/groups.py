"""Groups of hinges with the same kind of energy, stacked for array operations."""

from collections.abc import Sequence
from functools import partial
from operator import itemgetter

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from .._utils.host import as_float
from .._utils.stacking import Copies, member_of, PerPart, stack
from .._utils.types import Scalar
from ..energies.base import AbstractEnergy, parallel_terms
from ..energies.damping import ViscousDamping
from ..energies.dilation import dilated
from ..energies.natural_curvature import curvature_loads


class HingeGroup(eqx.Module):
    """Hinges with the same kind of energy and damping.

    A hinge whose energy is a sum has a member for each term.
    """

    members: tuple[int, ...] = eqx.field(static=True)  # Index of the hinge of each member
    # Their energies, stacked. An array that all of them share is not stacked.
    energy: AbstractEnergy
    # Their damping, stacked in the same way; None without damping
    damping: ViscousDamping | None
    # For each array of energy and damping: 0 if it is stacked, None if it is shared
    batch_axes: tuple[int | None, ...] = eqx.field(static=True)
    # Loads of each member for its natural turn; see the function of this name. None if
    # there was no gradient of the temperature.
    curvature_loads: Float[Array, "members 4"] | None = None

    def of_member(self, member: int) -> "DampedEnergy":
        """Return the energy of one member and its damping."""
        hinges = self.energy, self.damping
        return member_of(hinges, self.batch_axes, itemgetter(member))


# Energy and damping of a hinge
DampedEnergy = tuple[AbstractEnergy, ViscousDamping | Scalar | None]


def group_hinges(hinges: Sequence[Copies]) -> tuple[HingeGroup, ...]:
    """Stack the energies of hinges of the same kind, and their damping.

    The terms of a sum act in parallel. Each of them has its own damping, coordinates, and
    model for Newton's method.
    """
    rows, terms, start = [], [], 0
    for copies in hinges:
        # The terms have the same arrays as their sum.
        leaves = map(id, jax.tree.leaves(copies.value))
        varies = dict(zip(leaves, copies.flags, strict=True))
        of_terms = [
            Copies(pair, copies.number, [varies[id(x)] for x in jax.tree.leaves(pair)])
            for pair in _terms(copies.value)
        ]
        rows += len(of_terms) * list(range(start, start + copies.number))
        terms += of_terms
        start += copies.number
    groups = []
    for indices, (energy, damping), axes in stack(terms, share=True):
        if eqx.is_array(damping):  # a time
            damping = _proportional(energy, damping, axes)
            axes = (*axes[:-1], None if damping.damping.ndim == 2 else 0)
        members = tuple(rows[k] for k in indices)
        groups.append(HingeGroup(members, energy, damping, axes))
    return tuple(groups)


def dilate_groups(
    groups: Sequence[HingeGroup],
    scales: Float[Array | np.ndarray, " hinges"],
    free_turns: Float[Array | np.ndarray, "hinges 3"],
    has_gradients: bool,
) -> tuple[HingeGroup, ...]:
    """Multiply the dimensions of all hinges by factors, as thermal expansion does.

    The loads of natural curvature are computed if there are gradients of the temperature.
    """
    new = []
    for group in groups:
        energy = dilated(group.energy, as_float(scales[np.array(group.members)]))
        old_leaves = jax.tree.leaves(group.energy)
        changed = [
            leaf is not old
            for leaf, old in zip(jax.tree.leaves(energy), old_leaves, strict=True)
        ]
        # Arrays that the hinges shared were stacked, because their factors may differ.
        axes = [
            0 if stacked else axis
            for stacked, axis in zip(changed, group.batch_axes, strict=False)
        ]
        axes += group.batch_axes[len(changed) :]
        loads = None
        if has_gradients or group.curvature_loads is not None:
            free = as_float(free_turns[np.array(group.members)])
            loads = _curvature_loads(energy, free, tuple(axes[: len(changed)]))
        group = HingeGroup(group.members, energy, group.damping, tuple(axes), loads)
        new.append(group)
    return tuple(new)


def sums_of(hinges: Sequence[Copies]) -> PerPart:
    """Return energy and damping of each hinge whose energy is a sum; None for others."""
    return PerPart.of(
        [
            hinge
            if len(parallel_terms(hinge.value[0])) > 1
            else Copies(None, hinge.number)
            for hinge in hinges
        ]
    )


def _terms(hinge: DampedEnergy) -> list[DampedEnergy]:
    """Return the terms of an energy, each with its part of the damping."""
    energy, damping = hinge
    terms = parallel_terms(energy)
    return list(zip(terms, _distribute(damping, terms), strict=True))


def _distribute(
    damping: ViscousDamping | Scalar | None, terms: Sequence[AbstractEnergy]
) -> list[ViscousDamping | Scalar | None]:
    """Distribute the damping of a hinge among the terms of its energy.

    A time (s) multiplies the stiffness of each term. A `ViscousDamping` acts only once:
    together with the first term that resists only a part of the rates, if there is one,
    or else with the first term.
    """
    if not isinstance(damping, ViscousDamping):
        return [damping] * len(terms)
    chosen = next((k for k, term in enumerate(terms) if not term.resists_all_rates), 0)
    return [damping if k == chosen else None for k in range(len(terms))]


@partial(jax.jit, static_argnames="batch_axes")
def _proportional(
    energy: AbstractEnergy, time: Array, batch_axes: tuple[int | None, ...]
) -> ViscousDamping:
    """Compute the damping of stacked energies: their stiffness times a time; s."""
    leaves, tree = jax.tree.flatten(energy)

    def damping(leaves, time):
        return jax.tree.unflatten(tree, leaves).proportional_damping(time)

    *of_energy, of_time = batch_axes
    if any(axis == 0 for axis in batch_axes):
        damping = jax.vmap(damping, in_axes=(of_energy, of_time))
    return damping(leaves, time)


@partial(jax.jit, static_argnames="batch_axes")
def _curvature_loads(
    energy: AbstractEnergy,
    free: Float[Array, "members 3"],
    batch_axes: tuple[int | None, ...],
) -> Float[Array, "members 4"]:
    """Compute the loads of natural curvature of stacked energies."""
    leaves, tree = jax.tree.flatten(energy)

    def loads(leaves, free):
        return curvature_loads(jax.tree.unflatten(tree, leaves), free)

    return jax.vmap(loads, in_axes=(list(batch_axes), 0))(leaves, free)
