"""Factors of the tangent stiffness of a mechanism, dense or by blocks."""

from functools import lru_cache
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from .small_matrices import inverse


# A dense factorization takes less time below so many free coordinates, or where so few
# blocks would be left of the matrix.
_LEAST_COORDINATES = 120
_LEAST_BLOCKS = 8
# Smaller blocks take more time, because each costs several calls of LAPACK.
_LEAST_BLOCK = 12


class Factors(NamedTuple):
    """A matrix scaled by its diagonal, so that units do not matter, and factored.

    A symmetric one by Cholesky's method, which fails where the equilibrium is unstable:
    then all that follows from it is NaN.

    Args:
        scale: reciprocal square roots of the diagonal.
        triangle: Cholesky's factor, or both factors of Gauss.
        pivots: rows that Gauss's elimination exchanged; none for a symmetric matrix.
    """

    scale: Float[Array, " n"]
    triangle: Float[Array, "n n"]
    pivots: Int[Array, " n"] | None

    @classmethod
    def of(cls, matrix: Float[Array, "n n"], symmetric: bool) -> "Factors":
        """Factor a matrix."""
        scale = _scale(jnp.diagonal(matrix))
        return cls.of_scaled(scale[:, None] * matrix * scale[None], symmetric, scale)

    @classmethod
    def of_scaled(
        cls, matrix: Float[Array, "n n"], symmetric: bool, scale: Float[Array, " n"]
    ) -> "Factors":
        """Factor a matrix that has been scaled."""
        if symmetric:
            return cls(scale, jnp.linalg.cholesky(matrix, symmetrize_input=False), None)
        return cls(scale, *jax.scipy.linalg.lu_factor(matrix))

    def solve(self, right: Float[Array, " n"]) -> Float[Array, " n"]:
        """Solve the linear system for one right-hand side."""
        return self.scale * self.solve_scaled(self.scale * right)

    def solve_scaled(self, right: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
        """Solve the scaled linear system."""
        if self.pivots is None:
            return jax.scipy.linalg.cho_solve((self.triangle, True), right)
        return jax.scipy.linalg.lu_solve((self.triangle, self.pivots), right)

    def resists(self) -> Bool[Array, ""]:
        """Decide whether every displacement meets resistance, beyond rounding.

        With follower loads only the sign of the determinant is seen: it changes where a
        first displacement meets no resistance.
        """
        return _resist(self.triangle, self.pivots)


def _scale(diagonal: Float[Array, " n"]) -> Float[Array, " n"]:
    size = jnp.abs(diagonal)
    return jnp.where(size > 0, size, 1.0) ** -0.5


def _resist(
    triangle: Float[Array, "*blocks n n"], pivots: Int[Array, "*blocks n"] | None
) -> Bool[Array, ""]:
    diagonal = jnp.diagonal(triangle, axis1=-2, axis2=-1)
    if pivots is None:
        return jnp.all(diagonal > 1e-7)  # Cholesky's are the square roots of pivots
    rows = np.arange(pivots.shape[-1], dtype=np.int32)
    swaps = jnp.sum(pivots != jnp.broadcast_to(rows, pivots.shape))
    upright = (swaps + jnp.sum(diagonal < 0)) % 2 == 0
    return upright & jnp.all(jnp.abs(diagonal) > 1e-14)


def null_space(
    jacobian: Float[Array, "entries n"],
) -> tuple[Float[Array, "n entries"], Float[Array, "n allowed"]]:
    """Compute the pseudo-inverse of a constraint Jacobian, and a basis of its null space.

    The columns of the basis are orthonormal. Both results are differentiable: the basis
    of one point is projected onto the null space of its neighbors and orthonormalized.

    Args:
        jacobian: A matrix with linearly independent rows.
    """
    entries = len(jacobian)
    rotation, _ = jnp.linalg.qr(jax.lax.stop_gradient(jacobian).T, mode="complete")
    basis = rotation[:, entries:]
    size = jnp.linalg.norm(jacobian, axis=1)
    size = jnp.where(size > 0, size, 1.0)
    rows = jacobian / size[:, None]
    back = rows.T @ inverse(rows @ rows.T)
    basis = basis - back @ (rows @ basis)
    if basis.shape[1]:
        lower = jnp.linalg.cholesky(basis.T @ basis)
        basis = jax.scipy.linalg.solve_triangular(lower, basis.T, lower=True).T
    return back / size[None], basis


class ConstrainedFactors(NamedTuple):
    """A stiffness factored on the displacements that constraints allow.

    Solves `[K G^T; G 0]` for displacements and constraint forces by the null-space method
    (Nocedal and Wright, Numerical Optimization, 2006, section 16.2).

    Args:
        units: Unit of each degree of freedom; rad, m.
        stiffness: The stiffness K in these units.
        back: Pseudo-inverse of the Jacobian G in these units.
        basis: Orthonormal basis of the null space of G in these units.
        reduced: Factors of the stiffness on this basis.
    """

    units: Float[Array, " n"]
    stiffness: Float[Array, "n n"]
    back: Float[Array, "n entries"]
    basis: Float[Array, "n allowed"]
    reduced: Factors

    @classmethod
    def of(
        cls,
        stiffness: Float[Array, "n n"],
        jacobian: Float[Array, "entries n"],
        units: Float[Array, " n"],
        symmetric: bool,
    ) -> "ConstrainedFactors":
        """Factor a stiffness with a constraint Jacobian."""
        scaled = units[:, None] * stiffness * units[None]
        back, basis = null_space(jacobian * units[None])
        reduced = Factors.of(basis.T @ scaled @ basis, symmetric)
        return cls(units, scaled, back, basis, reduced)

    def solve(self, right: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
        """Solve for displacements, then constraint forces, of one right-hand side."""
        count = len(self.units)
        force, violation = self.units * right[:count], right[count:]
        moved = self.back @ violation
        left = self.basis.T @ (force - self.stiffness @ moved)
        moved = moved + self.basis @ self.reduced.solve(left)
        push = self.back.T @ (force - self.stiffness @ moved)
        return jnp.concatenate([self.units * moved, push])

    def resists(self) -> Bool[Array, ""]:
        """Decide whether every allowed displacement meets resistance; see `Factors`."""
        return self.reduced.resists() & jnp.all(jnp.isfinite(self.back))


class Layout(NamedTuple):
    """An order of coordinates in which a matrix has three diagonals of blocks.

    Args:
        order: for each free coordinate, its place in the new order.
        size: of a block.
        blocks: number of blocks on the diagonal.
    """

    order: tuple[int, ...]
    size: int
    blocks: int

    def places(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Find entries of the matrix in the array of blocks, flattened.

        That array has the shape (3, blocks, size, size): blocks on the diagonal, below it
        and above it.

        Args:
            rows: of the entries, as free coordinates.
            columns: of the entries, as free coordinates.
        """
        order = np.array(self.order)
        row, column = order[rows], order[columns]
        block, other = row // self.size, column // self.size
        which = (block - other) % 3  # 0 on the diagonal, 1 below, 2 above
        block = np.maximum(block, other)
        within = (row % self.size) * self.size + column % self.size
        return (which * self.blocks + block) * self.size**2 + within


@lru_cache(maxsize=256)
def block_layout(
    ends: tuple[tuple[int, int], ...], free: tuple[int, ...]
) -> Layout | None:
    """Find blocks in the stiffness of a mechanism, or none if a dense one is as fast.

    Bodies are ordered by the method of Cuthill and McKee, reversed, so that hinges join
    bodies that are near each other in the order.

    Args:
        ends: the two bodies of each hinge.
        free: the free coordinates, of three a body.
    """
    count = len(free)
    if count < _LEAST_COORDINATES:
        return None
    bodies = np.array(free) // 3
    names, place = np.unique(bodies, return_inverse=True)
    row = np.full(1 + max(names.max(), *np.ravel(ends)), -1)
    row[names] = np.arange(len(names))
    pairs = row[np.array(ends)]
    pairs = pairs[np.all(pairs >= 0, axis=1)]
    both = np.concatenate([pairs, pairs[:, ::-1]]).T
    graph = coo_array((np.ones(both.shape[1]), tuple(both)), shape=2 * (len(names),))
    rank = np.empty(len(names), int)
    rank[reverse_cuthill_mckee(graph.tocsr(), symmetric_mode=True)] = np.arange(
        len(names)
    )
    order = np.empty(count, int)
    order[np.argsort(rank[place], kind="stable")] = np.arange(count)
    # a hinge joins all coordinates of its two bodies, and so does each body its own
    low, high = np.full(len(names), count), np.zeros(len(names), int)
    np.minimum.at(low, place, order)
    np.maximum.at(high, place, order)
    itself = np.arange(len(names))
    first, second = np.concatenate([pairs, np.stack([itself, itself], 1)]).T
    begins = np.minimum(low[first], low[second])
    ends_at = np.maximum(high[first], high[second])
    size = _LEAST_BLOCK
    while np.any(ends_at // size - begins // size > 1):
        size += 1
    blocks = -(-count // size)
    return (
        Layout(tuple(order.tolist()), size, blocks) if blocks >= _LEAST_BLOCKS else None
    )


class BlockFactors(eqx.Module):
    """A matrix with three diagonals of blocks, scaled by its diagonal, and factored.

    Args:
        layout: of its blocks.
        scale: reciprocal square roots of the diagonal, in the order of the blocks.
        below: the blocks below the diagonal, the first of them zero.
        triangles: factors of each block of the diagonal, less what was eliminated.
        pivots: rows that Gauss's elimination exchanged; none for a symmetric matrix.
        ahead: what each block of unknowns adds to the one before it.

    Source:
        Golub and Van Loan, Matrix Computations, section 4.5.
    """

    layout: Layout = eqx.field(static=True)
    scale: Float[Array, "blocks size"]
    below: Float[Array, "blocks size size"]
    triangles: Float[Array, "blocks size size"]
    pivots: Int[Array, "blocks size"] | None
    ahead: Float[Array, "blocks size size"]

    @classmethod
    def of(
        cls, blocks: Float[Array, "3 blocks size size"], layout: Layout, symmetric: bool
    ) -> "BlockFactors":
        """Factor a matrix; unused rows at its end get a diagonal of ones."""
        size, count = layout.size, layout.blocks
        used = np.arange(count * size).reshape(count, size) < len(layout.order)
        diagonal, below, above = blocks
        diagonal = diagonal + jnp.asarray(np.eye(size)[None] * ~used[:, None])
        scale = _scale(jnp.diagonal(diagonal, axis1=1, axis2=2))
        before = jnp.concatenate([jnp.ones((1, size)), scale[:-1]])
        diagonal = scale[:, :, None] * diagonal * scale[:, None]
        below = scale[:, :, None] * below * before[:, None]
        above = before[:, :, None] * above * scale[:, None]
        one = jnp.ones(size)

        def eliminate(factors: Factors, rows):
            diagonal, below, above = rows
            ahead = factors.solve_scaled(above)
            factors = Factors.of_scaled(diagonal - below @ ahead, symmetric, one)
            return factors, (factors.triangle, factors.pivots, ahead)

        begin = Factors.of_scaled(jnp.eye(size), symmetric, one)
        _, (triangles, pivots, ahead) = jax.lax.scan(
            eliminate, begin, (diagonal, below, above)
        )
        return cls(layout, scale, below, triangles, pivots, ahead)

    def solve(self, right: Float[Array, " free"]) -> Float[Array, " free"]:
        """Solve the linear system for one right-hand side."""
        layout, order = self.layout, np.array(self.layout.order)
        one = jnp.ones(layout.size)

        def forwards(last, row):
            triangle, pivots, below, right = row
            factors = Factors(one, triangle, pivots)
            found = factors.solve_scaled(right - below @ last)
            return found, found

        def backwards(later, row):
            ahead, found = row
            found = found - ahead @ later
            return found, found

        source = np.full(layout.blocks * layout.size, len(order))
        source[order] = np.arange(len(order))
        rows = jnp.concatenate([right, jnp.zeros(1)])[source]
        rows = self.scale * rows.reshape(self.scale.shape)
        nothing = jnp.zeros(layout.size)
        _, found = jax.lax.scan(
            forwards, nothing, (self.triangles, self.pivots, self.below, rows)
        )
        after = jnp.roll(self.ahead, -1, axis=0)  # the first of them is zero
        _, found = jax.lax.scan(backwards, nothing, (after, found), reverse=True)
        return (self.scale * found).reshape(-1)[order]

    def resists(self) -> Bool[Array, ""]:
        """Decide whether every displacement meets resistance; see `Factors`."""
        return _resist(self.triangles, self.pivots)
