"""Derivatives of the forces of all hinges, for Newton's method and for motions."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import Flag, Poses, Scalar
from .hinge_forces import FOUR_OF_SIX, HingeTangent, UPPER_TRIANGLE
from .scatter import hinge_dofs, matrix_entries, sum_entries


class AssemblyTangent(eqx.Module):
    """Forces and stiffness of all hinges with respect to their four motions.

    Args:
        motion_forces: Forces on the motions of each hinge; N m, N m, N, N.
        stiffness: Upper triangle of the stiffness of each hinge; N m/rad, N/rad, N/m.
        stress: Generalized stress of each hinge; N m, N, N.
        stress_rates: Its derivatives with respect to the motions.
        work: Sum of the absolute values of force times coordinate; J.
        bodies: Number of bodies.
        ends: Indices of the two bodies of each hinge.
        order: Index of the hinge to which each column of the arrays belongs.
    """

    motion_forces: Float[Array, "4 hinges"]
    stiffness: Float[Array, "10 hinges"]
    stress: Float[Array, "3 hinges"]
    stress_rates: Float[Array, "3 4 hinges"]
    work: Scalar
    bodies: int = eqx.field(static=True)
    ends: tuple[tuple[int, int], ...] = eqx.field(static=True)
    order: tuple[int, ...] = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        tangent: HingeTangent,
        bodies: int,
        ends: tuple[tuple[int, int], ...],
        order: tuple[int, ...],
    ) -> "AssemblyTangent":
        """Stack the values of all hinges in one array, and split it."""
        rates = [value for line in tangent.stress_rates for value in line]
        values = [*tangent.forces, *tangent.stiffness, *tangent.stress, *rates]
        parts = jnp.split(jnp.stack([*values, tangent.work]), [4, 14, 17, 29])
        forces, stiffness, stress, rates, work = parts
        rates = rates.reshape(3, 4, -1)
        total = jnp.sum(work)
        return cls(forces, stiffness, stress, rates, total, bodies, ends, order)

    def forces(self) -> Float[Array, " dofs"]:
        """Sum the forces of all hinges on each degree of freedom; N m, N."""
        motion, sign = FOUR_OF_SIX
        dofs = hinge_dofs(self.ends, self.order)
        hinges = np.arange(dofs.shape[1])
        source = motion[:, None] * len(hinges) + hinges
        signs = np.broadcast_to(sign[:, None], source.shape)
        entries, size = self.motion_forces.reshape(-1), 3 * self.bodies
        source, target, signs = source.reshape(-1), dofs.reshape(-1), signs.reshape(-1)
        return sum_entries(entries, source, target, size, signs)

    def matrix(
        self, rows: tuple[int, ...], columns: tuple[int, ...]
    ) -> Float[Array, "rows columns"]:
        """Sum the stiffness of all hinges among some degrees of freedom."""
        source, target = matrix_entries(self.ends, self.order, rows, columns)
        entry, hinge = np.divmod(source, len(self.order))
        compressed, signs = _compressed_entries()
        source = compressed[entry] * len(self.order) + hinge
        entries, size = self.stiffness.reshape(-1), len(rows) * len(columns)
        summed = sum_entries(entries, source, target, size, signs[entry])
        return summed.reshape(len(rows), len(columns))

    def hinge_stiffness(self) -> Float[Array, "6 6 hinges"]:
        """Return the stiffness of each hinge with respect to its six displacements."""
        compressed, signs = _compressed_entries()
        entries = self.stiffness[compressed] * jnp.asarray(signs)[:, None]
        return entries.reshape(6, 6, -1)

    def finite(self) -> Flag:
        """Decide whether the stiffness of all hinges is finite."""
        return jnp.all(jnp.isfinite(self.stiffness))

    def predicted_stress(self, change: Poses) -> Float[Array, "3 hinges"]:
        """Predict the stress after small displacements of the bodies; rad, m, m."""
        first, second = np.array(self.ends).reshape(-1, 2)[list(self.order)].T
        a, b = change[first].T, change[second].T
        stress = self.stress
        for motion, value in enumerate([a[0], b[0], b[1] - a[1], b[2] - a[2]]):
            stress = stress + self.stress_rates[:, motion] * value[None]
        return stress


def _compressed_entries() -> tuple[np.ndarray, np.ndarray]:
    """Find the entry of the upper triangle for each entry of a flat 6 by 6 stiffness.

    The second result is the sign with which it enters.
    """
    motion, sign = FOUR_OF_SIX
    index = np.zeros((4, 4), int)
    index[UPPER_TRIANGLE] = np.arange(10)
    index = np.maximum(index, index.T)
    return index[motion][:, motion].reshape(-1), np.outer(sign, sign).reshape(-1)


class AssemblyMotionTangent(NamedTuple):
    """Derivatives of the forces of all hinges with respect to free degrees of freedom.

    Args:
        stiffness: Derivatives with respect to displacements; N m/rad, N/rad, N/m.
        damping: Derivatives with respect to rates; N m s/rad, N s/rad, N s/m.
        stretch_by_displacement: Derivatives of the mid-frame translations; m/rad, -.
        force_by_stretch: Derivatives of the forces with respect to the mid-frame
            translations; N, N/m.
    """

    stiffness: Float[Array, "free free"]
    damping: Float[Array, "free free"]
    stretch_by_displacement: Float[Array, "free stretches"]
    force_by_stretch: Float[Array, "free stretches"]
