"""Stiffness of a mechanism out of its plane, about a deformed planar state."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import Poses, Scalar
from ..energies.stress_model import out_of_plane_stiffness, stress_model
from ..linalg.factors import Factors
from . import forces as hinge_forces
from .assembly import HingeAssembly, HingeGroup
from .kinematics import HingeKinematics
from .scatter import hinge_dofs


# Stiffness of hinges in their mid-frames, by the index of the hinge
Given = dict[int, Float[Array, "3 3"]]


class MemberStiffness(NamedTuple):
    """Stiffness of the hinges of a group, and what it resists.

    It resists linear combinations of the displacements of both bodies: z and the
    rotations about axes 1 and 2 of the mid-frame. If the hinges are segments of flexures,
    two more displacements are the twist rates at both ends; m, rad, rad, rad/m, rad/m.
    """

    rows: Float[Array, "members resisted displacements"]
    stiffness: Float[Array, "members resisted resisted"]


def member_stiffness(
    hinges: HingeAssembly, displacements: Poses, warping: bool, given: Given
) -> list[MemberStiffness]:
    """Compute the stiffness of the hinges of each group.

    Hinges without a known stiffness resist nothing. That of the hinges in `given`
    replaces the one that follows from their dimensions.
    """

    def of_hinge(energy, first, second, axis, known: Scalar, replaced: Array):
        kinematics = HingeKinematics.of(first, second, axis)
        at = kinematics.middle.displacement
        wrench = hinge_forces.energy_gradient(energy, at)
        found = out_of_plane_stiffness(energy, at, wrench, warping)
        found = jnp.zeros((3, 3)) if found is None else found
        more = len(found) - 3
        rows = jax.scipy.linalg.block_diag(
            _relative_displacement(kinematics), jnp.eye(more)
        )
        stiffness = jnp.where(known > 0, jnp.pad(replaced, (0, more)), found)
        return MemberStiffness(rows, stiffness)

    members = []
    for group in hinges.groups:
        known = jnp.array([1.0 if member in given else 0.0 for member in group.members])
        replaced = jnp.stack([given.get(k, jnp.zeros((3, 3))) for k in group.members])
        members.append(
            hinges.map_members(of_hinge, group, displacements, known, replaced)
        )
    return members


def assembled_stiffness(
    hinges: HingeAssembly, members: Sequence[MemberStiffness]
) -> Float[Array, "dofs dofs"]:
    """Sum the stiffness of all hinges against displacements out of the plane.

    These are z and the rotations about x and y of each body, at its displaced origin; m,
    rad, rad. The twist rate where two segments of a flexure meet follows from them,
    because no bimoment acts there.
    """
    ends, count = np.array(hinges.ends), 3 * hinges.bodies
    twists = any(rows.shape[2] > 6 for rows, _ in members)
    matrix = jnp.zeros(2 * (count + twists * hinges.bodies,))
    for group, (rows, stiffness) in zip(hinges.groups, members, strict=True):
        of_bodies = hinge_dofs(hinges.ends, group.members).T
        twist_rates = count + ends[np.array(group.members)]
        dofs = np.concatenate([of_bodies, twist_rates], axis=1)[:, : rows.shape[2]]
        parts = jnp.swapaxes(rows, 1, 2) @ stiffness @ rows
        matrix = matrix.at[dofs[:, :, None], dofs[:, None]].add(parts)
    if not twists:
        return matrix
    bimoments, coupling = matrix[count:, count:], matrix[count:, :count]
    clamped = jnp.diag(jnp.where(jnp.diagonal(bimoments) > 0, 0.0, 1.0))
    factors = Factors.of(bimoments + clamped, symmetric=True)
    return matrix[:count, :count] - coupling.T @ factors.solve(coupling)


def hinge_stiffness(
    hinges: HingeAssembly, members: Sequence[MemberStiffness]
) -> tuple[Float[Array, "hinges 3 6"], Float[Array, "hinges 3 3"]]:
    """Return what each hinge resists, and its stiffness, if it does not warp."""
    all_rows = jnp.zeros((len(hinges.ends), 3, 6))
    total = jnp.zeros((len(hinges.ends), 3, 3))
    for group, (rows, stiffness) in zip(hinges.groups, members, strict=True):
        index = np.array(group.members)
        # The terms of a sum have the same coordinates.
        all_rows = all_rows.at[index].set(rows[:, :3, :6])
        total = total.at[index].add(stiffness[:, :3, :3])
    return all_rows, total


def hinges_without_stiffness(hinges: HingeAssembly) -> Sequence[int]:
    """Return the indices of hinges whose stiffness does not follow from dimensions."""

    def is_known(group: HingeGroup) -> bool:
        model = stress_model(group.energy)
        return model is not None and model.knows_sections

    unknown = (group.members for group in hinges.groups if not is_known(group))
    return sorted({member for members in unknown for member in members})


def _relative_displacement(kinematics: HingeKinematics) -> Float[Array, "3 6"]:
    """Return the displacement of body B relative to body A at the mid-frame of a hinge.

    It is z and the rotations about axes 1 and 2 of the mid-frame, for those of both
    bodies about x and y.
    """
    middle = kinematics.middle
    half_1, half_2 = middle.half
    cos, sin = middle.cos, middle.sin
    one, zero = jnp.ones_like(cos), jnp.zeros_like(cos)
    turned = jnp.array([[one, zero, zero], [zero, cos, sin], [zero, -sin, cos]])
    columns = []
    for sign, arm_1, arm_2 in (
        (-1.0, kinematics.a1 + half_1, kinematics.a2 + half_2),
        (1.0, kinematics.b1 - half_1, kinematics.b2 - half_2),
    ):
        # A rotation about axis 1 lifts points on axis 2, and one about axis 2 lowers
        # those on axis 1.
        moved = jnp.array([[one, arm_2, -arm_1], [zero, one, zero], [zero, zero, one]])
        columns.append(sign * moved @ turned)
    return jnp.concatenate(columns, axis=1)
