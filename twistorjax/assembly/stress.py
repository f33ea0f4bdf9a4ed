"""Stresses in the hinges of a mechanism whose dimensions are known."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._utils.pytrees import largest_of
from .._utils.types import Poses
from ..energies.stress_model import (
    AbstractStressModel,
    stress_model,
    surface_stresses,
    wrench_of_flexure,
)
from . import forces as hinge_forces
from .assembly import HingeAssembly
from .kinematics import mid_frame


class MemberStresses(NamedTuple):
    """Stresses in hinges of the same kind.

    A hinge whose energy is a sum has a member for each term.
    """

    rows: tuple[int, ...]  # Index of the hinge of each member
    # Normal stress at points of the surface of each member; Pa
    values: Float[Array, "members points"]


def member_stresses(
    hinges: HingeAssembly, displacements: Poses
) -> tuple[MemberStresses, ...]:
    """Compute the normal stress at points of the surfaces of all flexures.

    Hinges whose dimensions are not known are left out.
    """

    def of_hinge(energy, first, second, axis):
        at = mid_frame(first, second, axis).displacement
        wrench = hinge_forces.energy_gradient(energy, at)
        return surface_stresses(energy, at, wrench)

    return tuple(
        MemberStresses(group.members, hinges.map_members(of_hinge, group, displacements))
        for group in hinges.groups
        if stress_model(group.energy) is not None
    )


def member_states(
    hinges: HingeAssembly, displacements: Poses
) -> Float[Array, "members 6"]:
    """Compute the states of all flexures, from which their stresses follow.

    The members are those of `member_stresses`. A state is the displacement of a flexure
    (angle, x, y), and its moment, axial force, and transverse force in the mid-frame;
    rad, m, m, N m, N, N.
    """

    def of_hinge(energy, first, second, axis):
        at = mid_frame(first, second, axis).displacement
        wrench = wrench_of_flexure(energy, hinge_forces.energy_gradient(energy, at))
        return jnp.concatenate([at.pose(), jnp.stack(wrench)])

    states = [
        hinges.map_members(of_hinge, group, displacements)
        for group in hinges.groups
        if stress_model(group.energy) is not None
    ]
    return jnp.concatenate([jnp.zeros((0, 6)), *states])


def member_models(hinges: HingeAssembly) -> tuple[AbstractStressModel, ...]:
    """Return the stress models of all flexures, in the order of `member_states`."""
    models = []
    for group in hinges.groups:
        for member in range(len(group.members)):
            model = stress_model(group.of_member(member)[0])
            models += [] if model is None else [model]
    return tuple(models)


def rows_with_stress(
    hinges: HingeAssembly, strength: str | None = None
) -> tuple[int, ...]:
    """Return the indices of the hinges whose dimensions are known.

    If the name of one of the `Strengths` is given, it must be known as well.
    """
    rows = set()
    for group in hinges.groups:
        model = stress_model(group.energy)
        if model is None:
            continue
        if strength is None or getattr(model.strengths, strength) is not None:
            rows |= set(group.members)
    return tuple(sorted(rows))


def rows_of_points(hinges: HingeAssembly) -> Int[np.ndarray, " points"]:
    """Return the index of the hinge of each point with a stress, in order."""

    def values(displacements: Poses) -> list[Array]:
        return [part.values for part in member_stresses(hinges, displacements)]

    shapes = jax.eval_shape(values, jax.ShapeDtypeStruct((hinges.bodies, 3), float))
    members = [
        group.members for group in hinges.groups if stress_model(group.energy) is not None
    ]
    return np.concatenate(
        [
            np.repeat(rows, shape.shape[1])
            for rows, shape in zip(members, shapes, strict=True)
        ]
    )


def largest_stresses(
    hinges: HingeAssembly, displacements: Poses
) -> Float[Array, " hinges"]:
    """Compute the largest magnitude of the stress in each hinge (Pa), zero if unknown."""
    found, members = [jnp.zeros(1)], [[0] for _ in hinges.ends]
    count = 1
    for rows, values in member_stresses(hinges, displacements):
        found.append(largest_of(jnp.abs(values)))
        for row in rows:
            members[row].append(count)
            count += 1
    # The terms of a sum belong to one hinge. Others have no further member than the zero.
    width = max(map(len, members))
    index = np.array([each + (width - len(each)) * [0] for each in members])
    return largest_of(jnp.concatenate(found)[index])


def strengths(hinges: HingeAssembly, name: str) -> Float[Array, " hinges"] | None:
    """Return one of the `Strengths` of the material of each hinge; Pa.

    It is infinite for hinges without this strength; None if no hinge has it.
    """
    result = None
    for group in hinges.groups:
        model = stress_model(group.energy)
        value = None if model is None else getattr(model.strengths, name)
        if value is not None:
            result = jnp.full(len(hinges.ends), jnp.inf) if result is None else result
            result = result.at[np.array(group.members)].min(value)
    return result
