"""Stiffness of hinges and loads in factors, whose small entries are accurate."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..linalg.block_factors import Layout
from ..linalg.eigenvalues import rounding_errors, Stiffness
from ..linalg.sums import sum_entries
from .forces import Factored
from .scatter import (
    displacements_of_members,
    row_entries,
    sum_matrices,
    vector_entries,
)


class FactoredStiffness(eqx.Module):
    """Stiffness of hinges and loads among free degrees of freedom, in factors."""

    each: Factored  # Stiffness of each member; its arrays begin with members
    # Stiffness of the loads, which is diagonal because they have a potential; N m/rad
    of_loads: Float[Array, " free"]
    # Indices of the two bodies of each hinge
    ends: tuple[tuple[int, int], ...] = eqx.field(static=True)
    order: tuple[int, ...] = eqx.field(static=True)  # Index of the hinge of each member
    free: tuple[int, ...] = eqx.field(static=True)

    def dense(self) -> Stiffness:
        """Assemble the factors as dense matrices."""
        source, target = row_entries(self.ends, self.order, self.free, 3)
        size = (len(self.free), 3 * len(self.order))
        entries = jnp.moveaxis(self.each.rows, 0, -1).reshape(-1)
        rows = sum_entries(entries, source, target, size[0] * size[1])
        remainder = self._assemble(self.each.remainder) + jnp.diag(self.of_loads)
        return Stiffness(rows.reshape(size).T, self.each.weights.reshape(-1), remainder)

    def blocks(self, layout: Layout) -> Float[Array, "3 blocks size size"]:
        """Multiply the factors, and assemble the matrix in blocks."""
        rows, weights, remainder = self.each
        weighted = weights[:, :, None, None] * rows[:, :, :, None]
        matrices = jnp.sum(weighted * rows[:, :, None], axis=1) + remainder
        return self._assemble(matrices, layout) + layout.of_diagonal(self.of_loads)

    def times(
        self, vectors: Float[Array, "free vectors"]
    ) -> Float[Array, "free vectors"]:
        """Multiply the stiffness and displacements."""
        rows, weights, remainder = self.each
        moved = self._of_members(vectors)
        strains = weights[:, :, None] * _product(rows, moved)
        forces = _product(jnp.moveaxis(rows, 1, 2), strains) + _product(remainder, moved)
        source, target = vector_entries(self.ends, self.order, self.free)

        def sum_column(column: Float[Array, "members 6"]) -> Float[Array, " free"]:
            return sum_entries(column.T.reshape(-1), source, target, len(self.free))

        summed = jax.vmap(sum_column, in_axes=-1, out_axes=-1)(forces)
        return summed + self.of_loads[:, None] * vectors

    def gram(
        self, vectors: Float[Array, "free vectors"]
    ) -> Float[Array, "vectors vectors"]:
        """Compute twice the energies of displacements, and those of pairs of them."""
        rows, weights, remainder = self.each
        moved = self._of_members(vectors)
        strains = _flat(_product(rows, moved))
        of_rows = strains.T @ (weights.reshape(-1, 1) * strains)
        of_remainder = _flat(moved).T @ _flat(_product(remainder, moved))
        return of_rows + of_remainder + vectors.T @ (self.of_loads[:, None] * vectors)

    def rounding_errors(
        self, vectors: Float[Array, "free vectors"]
    ) -> Float[Array, " vectors"]:
        """Bound the rounding errors of the diagonal of `gram`; N m, N/m."""
        rows, weights, remainder = self.each
        moved = self._of_members(vectors)
        sizes, strains = jnp.abs(moved), _flat(_product(rows, moved))
        bounds = _flat(_product(jnp.abs(rows), sizes))
        of_remainder = jnp.sum(sizes * _product(jnp.abs(remainder), sizes), axis=(0, 1))
        of_remainder = of_remainder + jnp.abs(self.of_loads) @ vectors**2
        return rounding_errors(weights.reshape(-1), strains, bounds, of_remainder)

    def _assemble(self, matrices: Array, layout: Layout | None = None) -> Array:
        matrices = jnp.moveaxis(matrices, 0, -1)
        return sum_matrices(matrices, self.ends, self.order, self.free, layout)

    def _of_members(
        self, vectors: Float[Array, "free vectors"]
    ) -> Float[Array, "members 6 vectors"]:
        """Return the six displacements of each member."""
        moved = displacements_of_members(vectors, self.ends, self.order, self.free)
        return jnp.swapaxes(moved, 0, 1)


def _product(
    matrices: Float[Array, "members rows inner"],
    columns: Float[Array, "members inner vectors"],
) -> Float[Array, "members rows vectors"]:
    """Multiply small matrices of all members, in one loop over vectors."""
    terms = [
        matrices[:, :, k, None] * columns[:, None, k] for k in range(columns.shape[1])
    ]
    return sum(terms[1:], start=terms[0])


def _flat(of_members: Float[Array, "members rows vectors"]) -> Float[Array, "_ vectors"]:
    return of_members.reshape(-1, of_members.shape[-1])
