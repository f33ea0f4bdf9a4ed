"""Derivatives of the forces of all hinges, for Newton's method and for motions."""

import math
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._utils.types import Flag, Poses, Scalar
from ..linalg.block_factors import Layout
from ..linalg.sums import sum_entries
from .forces import FOUR_INDEX_AND_SIGN, HingeTangent, predicted_stress, UPPER_TRIANGLE
from .motion_forces import HingeMotionTangent
from .scatter import displacements_of_members, matrix_entries, vector_entries


# Position of each entry of a 4 by 4 matrix of displacements in the upper triangle.
_SYMMETRIC = np.zeros((4, 4), int)
_SYMMETRIC[UPPER_TRIANGLE] = _SYMMETRIC.T[UPPER_TRIANGLE] = np.arange(10)
# Its position in the whole matrix.
_WHOLE = np.arange(16).reshape(4, 4)


class AssemblyTangent(eqx.Module):
    """Forces and stiffness of each hinge with respect to its four displacements."""

    each: HingeTangent  # The tangent of each member; its arrays have an axis of members
    bodies: int = eqx.field(static=True)
    # Indices of the two bodies of each hinge
    ends: tuple[tuple[int, int], ...] = eqx.field(static=True)
    # Index of the hinge to which each column of the arrays belongs
    order: tuple[int, ...] = eqx.field(static=True)

    @property
    def stiffness(self) -> Float[Array, "10 members"]:
        """Upper triangle of the stiffness of each hinge; N m/rad, N/rad, N/m."""
        return jnp.stack(self.each.stiffness)

    def with_stiffness(
        self, members: Int[np.ndarray, " chosen"], stiffness: Float[Array, "10 chosen"]
    ) -> "AssemblyTangent":
        """Replace the stiffness of some members."""
        replaced = self.stiffness.at[:, members].set(stiffness)
        return replace(self, each=self.each._replace(stiffness=tuple(replaced)))

    @property
    def work(self) -> Scalar:
        """Sum of the absolute values of force times coordinate; J."""
        return jnp.sum(self.each.work)

    def forces(self) -> Float[Array, " dofs"]:
        """Sum the forces of all hinges on each degree of freedom; N m, N."""
        all_dofs = tuple(range(3 * self.bodies))
        forces = jnp.stack(self.each.forces)
        return _sum_forces(forces, self.ends, self.order, all_dofs)

    def matrix(
        self, rows: tuple[int, ...], columns: tuple[int, ...]
    ) -> Float[Array, "rows columns"]:
        """Sum the stiffness of all hinges among some degrees of freedom."""
        indices = matrix_entries(self.ends, self.order, rows, columns)
        shape, of_pairs = (len(rows), len(columns)), _of_pairs(_SYMMETRIC)
        return _sum_entries(self.stiffness, indices, *of_pairs, shape)

    def hinge_stiffness(self) -> Float[Array, "6 6 members"]:
        """Return the stiffness of each hinge with respect to its six displacements."""
        entry, signs = _of_pairs(_SYMMETRIC)
        entries = self.stiffness[entry] * jnp.asarray(signs)[:, None]
        return entries.reshape(6, 6, -1)

    def finite(self) -> Flag:
        """Decide whether the stiffness of all hinges is finite."""
        return jnp.all(jnp.isfinite(self.stiffness))

    def predicted_stress(self, change: Poses) -> Float[Array, "3 members"]:
        """Predict the stress after small displacements of the bodies; rad, m, m."""
        first, second = np.array(self.ends).reshape(-1, 2)[list(self.order)].T
        of_bodies = tuple(change[first].T), tuple(change[second].T)
        return jnp.stack(jax.vmap(predicted_stress)(self.each, *of_bodies))


def _of_pairs(position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the entry of two of the four for each entry of a flat 6 by 6 matrix.

    `position` is that of each entry of the 4 by 4 matrix. The second result is
    the sign with which it enters.
    """
    one_of_four, sign = FOUR_INDEX_AND_SIGN
    pairs = position[one_of_four][:, one_of_four]
    return pairs.reshape(-1), np.outer(sign, sign).reshape(-1)


def _sum_entries(
    entries: Float[Array, "*four members"],
    indices: tuple[np.ndarray, np.ndarray],
    position: np.ndarray,
    signs: np.ndarray,
    shape: tuple[int, ...],
) -> Array:
    """Sum the entries of all hinges, which are given for the four displacements.

    Args:
        indices: Index of each entry for the six displacements, and its index in the sum;
            see `matrix_entries` and `vector_entries`.
        position: Index among the four displacements, for each index among the six.
        signs: The sign with which this entry enters.
    """
    entry, hinge = np.divmod(indices[0], entries.shape[-1])
    source = position[entry] * entries.shape[-1] + hinge
    flat, size, signs = entries.reshape(-1), math.prod(shape), signs[entry]
    return sum_entries(flat, source, indices[1], size, signs).reshape(shape)


class AssemblyMotionTangent(eqx.Module):
    """Derivatives of the forces of all hinges with respect to free degrees of freedom."""

    # Derivatives with respect to displacements, in the shape of the layout; N m/rad,
    # N/rad, N/m
    stiffness: Float[Array, "*matrix"]
    # Derivatives with respect to rates; N m s/rad, N s/rad, N s/m
    damping: Float[Array, "*matrix"]
    each: HingeMotionTangent  # The tangent of each member; its arrays begin with members
    ends: tuple[tuple[int, int], ...] = eqx.field(static=True)
    order: tuple[int, ...] = eqx.field(static=True)
    free: tuple[int, ...] = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        tangent: HingeMotionTangent,
        ends: tuple[tuple[int, int], ...],
        order: tuple[int, ...],
        free: tuple[int, ...],
        layout: Layout | None = None,
    ) -> "AssemblyMotionTangent":
        """Sum the derivatives of all hinges among the free degrees of freedom.

        The matrices are dense without a `layout`. The other arguments are as in
        `AssemblyTangent`.
        """
        indices = matrix_entries(ends, order, free, free, layout)
        shape = 2 * (len(free),) if layout is None else layout.shape

        def by_dofs(entries: Array) -> Float[Array, "*matrix"]:
            entries = jnp.moveaxis(entries, 0, -1)
            return _sum_entries(entries, indices, *_of_pairs(_WHOLE), shape)

        stiffness, damping = by_dofs(tangent.stiffness), by_dofs(tangent.damping)
        return cls(stiffness, damping, tangent, ends, order, free)

    def translation_change(
        self, change: Float[Array, " free"]
    ) -> Float[Array, " translations"]:
        """Compute the change of the mid-frame translations with displacements; m."""
        rows = self.each.translation_by_displacement
        return jnp.sum(rows * self._of_four(change)[:, None], axis=2).reshape(-1)

    def forces_of_translations(
        self, change: Float[Array, " translations"]
    ) -> Float[Array, " free"]:
        """Compute the change of the forces with the mid-frame translations; N m, N."""
        rows = self.each.force_by_translation
        return self._sum(jnp.sum(rows * change.reshape(-1, 2, 1), axis=1))

    def damping_forces(self, rates: Float[Array, " free"]) -> Float[Array, " free"]:
        """Compute the viscous forces at rates (rad/s, m/s); N m, N."""
        rows = self.each.damping
        return self._sum(jnp.sum(rows * self._of_four(rates)[:, None], axis=2))

    def _of_four(self, change: Float[Array, " free"]) -> Float[Array, "members 4"]:
        """Return the change of the four displacements of each member."""
        of_six = displacements_of_members(change, self.ends, self.order, self.free)
        a, b = of_six[:3], of_six[3:]
        return jnp.stack([a[0], b[0], b[1] - a[1], b[2] - a[2]], axis=1)

    def _sum(self, of_four: Float[Array, "members 4"]) -> Float[Array, " free"]:
        return _sum_forces(of_four.T, self.ends, self.order, self.free)


def _sum_forces(
    of_four: Float[Array, "4 members"],
    ends: tuple[tuple[int, int], ...],
    order: tuple[int, ...],
    dofs: tuple[int, ...],
) -> Float[Array, " dofs"]:
    """Sum forces on the four displacements of all members on degrees of freedom."""
    indices = vector_entries(ends, order, dofs)
    return _sum_entries(of_four, indices, *FOUR_INDEX_AND_SIGN, (len(dofs),))
