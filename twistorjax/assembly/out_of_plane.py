"""Stiffness of a mechanism out of its plane, about a deformed planar state."""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._utils.types import Poses, Scalar
from ..energies.stress_model import out_of_plane_stiffness, stress_model
from . import forces as hinge_forces
from .assembly import HingeAssembly, HingeGroup
from .kinematics import HingeKinematics


# Stiffness of hinges in their mid-frames, by the index of the hinge
Given = dict[int, Float[Array, "3 3"]]


def assembled_stiffness(
    hinges: HingeAssembly, displacements: Poses, warping: bool, given: Given
) -> Float[Array, "dofs dofs"]:
    """Sum the stiffness of all hinges against displacements out of the plane.

    These are z and the rotations about x and y of each body, at its displaced origin; m,
    rad, rad. Hinges without a known stiffness resist nothing. That of the hinges in
    `given` replaces the one that follows from their dimensions.
    """
    parts = []
    for group in hinges.groups:
        rows = [given.get(member) for member in group.members]
        known = jnp.array([0.0 if row is None else 1.0 for row in rows])
        zero = jnp.zeros((3, 3))
        replaced = jnp.stack([zero if row is None else row for row in rows])

        def of_hinge(energy, first, second, axis, known: Scalar, replaced: Array):
            kinematics = HingeKinematics.of(first, second, axis)
            at = kinematics.middle.displacement
            wrench = hinge_forces.energy_gradient(energy, at)
            found = out_of_plane_stiffness(energy, at, wrench, warping)
            found = jnp.zeros((3, 3)) if found is None else found
            stiffness = jnp.where(known > 0, replaced, found)
            rows = _relative_displacement(kinematics)
            return rows.T @ stiffness @ rows

        parts.append(hinges.map_members(of_hinge, group, displacements, known, replaced))
    matrices = jnp.moveaxis(jnp.concatenate(parts), 0, -1)
    return hinges.assemble(matrices, tuple(range(3 * hinges.bodies)))


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
