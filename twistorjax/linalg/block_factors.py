"""Factors of the tangent stiffness of a mechanism of many bodies, in blocks."""

from functools import lru_cache
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._utils.types import Flag
from .factors import diagonal_scale, Factors, is_stable


# With fewer free degrees of freedom, or fewer blocks, a dense factorization is faster
# (`benchmarks.chains`).
_LEAST_DOFS = 120
_LEAST_BLOCKS = 8
# Smaller blocks take more time, because each block costs several calls of LAPACK.
_LEAST_BLOCK_SIZE = 12


class Layout(NamedTuple):
    """An order of degrees of freedom in which a matrix is block tridiagonal."""

    order: tuple[int, ...]  # Index of each free degree of freedom in the new order
    size: int  # Number of rows of a block
    blocks: int  # Number of blocks on the diagonal

    def flat_indices(
        self, rows: Int[np.ndarray, " entries"], columns: Int[np.ndarray, " entries"]
    ) -> Int[np.ndarray, " entries"]:
        """Compute the indices of matrix entries in the flattened array of blocks.

        Rows and columns of the matrix are numbered by the free degrees of freedom. The
        array has the shape (3, blocks, size, size): the blocks on the diagonal, below it,
        and above it.
        """
        order = np.array(self.order)
        row, column = order[rows], order[columns]
        row_block, column_block = row // self.size, column // self.size
        diagonal = (row_block - column_block) % 3  # 0 is the diagonal, 1 below, 2 above
        block = np.maximum(row_block, column_block)
        in_block = (row % self.size) * self.size + column % self.size
        return (diagonal * self.blocks + block) * self.size**2 + in_block


@lru_cache(maxsize=256)
def block_layout(
    ends: tuple[tuple[int, int], ...], free: tuple[int, ...]
) -> Layout | None:
    """Find an order in which the stiffness of a mechanism is block tridiagonal.

    Bodies are ordered by the reverse Cuthill-McKee method, so that the two bodies of a
    hinge (`ends`) are close to each other in the order. A body has three degrees of
    freedom. The layout is None if a dense factorization is faster.
    """
    count = len(free)
    if count < _LEAST_DOFS:
        return None
    # These packages take 0.1 s to load, and only mechanisms of many bodies need them.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    bodies, body_of_dof = np.unique(np.array(free) // 3, return_inverse=True)
    node = np.full(1 + max(bodies.max(), *np.ravel(ends)), -1)
    node[bodies] = np.arange(len(bodies))
    pairs = node[np.array(ends)]
    pairs = pairs[np.all(pairs >= 0, axis=1)]
    edges = np.concatenate([pairs, pairs[:, ::-1]]).T
    graph = coo_array((np.ones(edges.shape[1]), tuple(edges)), shape=2 * (len(bodies),))
    rank = np.empty(len(bodies), int)
    rank[reverse_cuthill_mckee(graph.tocsr(), symmetric_mode=True)] = np.arange(
        len(bodies)
    )
    order = np.empty(count, int)
    order[np.argsort(rank[body_of_dof], kind="stable")] = np.arange(count)
    low, high = np.full(len(bodies), count), np.zeros(len(bodies), int)
    np.minimum.at(low, body_of_dof, order)
    np.maximum.at(high, body_of_dof, order)
    # A hinge couples all coordinates of its two bodies, and a load those of one body.
    each = np.arange(len(bodies))
    first, second = np.concatenate([pairs, np.stack([each, each], 1)]).T
    lowest = np.minimum(low[first], low[second])
    highest = np.maximum(high[first], high[second])
    size = _LEAST_BLOCK_SIZE
    while np.any(highest // size - lowest // size > 1):
        size += 1
    blocks = -(-count // size)
    if blocks < _LEAST_BLOCKS:
        return None
    return Layout(tuple(order.tolist()), size, blocks)


class BlockFactors(eqx.Module):
    """Factors of a block tridiagonal matrix that is scaled by its diagonal.

    Source:
        Golub and Van Loan, Matrix Computations, section 4.5.
    """

    layout: Layout = eqx.field(static=True)
    scale: Float[Array, "blocks size"]  # Reciprocal square roots of the diagonal
    below: Float[Array, "blocks size size"]  # The first one is zero
    # Factors of each block on the diagonal after elimination
    triangles: Float[Array, "blocks size size"]
    # Rows that Gaussian elimination exchanged; None for Cholesky factors
    pivots: Int[Array, "blocks size"] | None
    # Blocks above the diagonal after elimination: the negative derivatives of the
    # unknowns of the previous block with respect to those of this block
    above: Float[Array, "blocks size size"]

    @classmethod
    def of(
        cls, blocks: Float[Array, "3 blocks size size"], layout: Layout, symmetric: bool
    ) -> "BlockFactors":
        """Factorize a matrix, given by its blocks on, below, and above the diagonal.

        Unused rows at the end get a diagonal of ones.
        """
        size, count = layout.size, layout.blocks
        used = np.arange(count * size).reshape(count, size) < len(layout.order)
        diagonal, below, above = blocks
        diagonal = diagonal + jnp.asarray(np.eye(size)[None] * ~used[:, None])
        scale = diagonal_scale(jnp.diagonal(diagonal, axis1=1, axis2=2))
        scale_before = jnp.concatenate([jnp.ones((1, size)), scale[:-1]])
        diagonal = scale[:, :, None] * diagonal * scale[:, None]
        below = scale[:, :, None] * below * scale_before[:, None]
        above = scale_before[:, :, None] * above * scale[:, None]
        one = jnp.ones(size)

        def eliminate(factors_before: Factors, blocks):
            diagonal, below, above = blocks
            above = factors_before.solve_scaled(above)
            factors = Factors.of_scaled(diagonal - below @ above, symmetric, one)
            return factors, (factors.triangle, factors.pivots, above)

        identity = Factors.of_scaled(jnp.eye(size), symmetric, one)
        _, (triangles, pivots, above) = jax.lax.scan(
            eliminate, identity, (diagonal, below, above)
        )
        return cls(layout, scale, below, triangles, pivots, above)

    def solve(self, right: Float[Array, " free"]) -> Float[Array, " free"]:
        layout, order = self.layout, np.array(self.layout.order)
        one = jnp.ones(layout.size)

        def forward(solution_before, block):
            triangle, pivots, below, right = block
            factors = Factors(one, triangle, pivots)
            solution = factors.solve_scaled(right - below @ solution_before)
            return solution, solution

        def backward(solution_after, block):
            above, solution = block
            solution = solution - above @ solution_after
            return solution, solution

        source = np.full(layout.blocks * layout.size, len(order))
        source[order] = np.arange(len(order))
        rows = jnp.concatenate([right, jnp.zeros(1)])[source]
        rows = self.scale * rows.reshape(self.scale.shape)
        zero = jnp.zeros(layout.size)
        _, solution = jax.lax.scan(
            forward, zero, (self.triangles, self.pivots, self.below, rows)
        )
        # The first block above the diagonal is zero, so it may follow the last one.
        above = jnp.roll(self.above, -1, axis=0)
        _, solution = jax.lax.scan(backward, zero, (above, solution), reverse=True)
        return (self.scale * solution).reshape(-1)[order]

    def solve_and_check(
        self, right: Float[Array, " free"]
    ) -> tuple[Float[Array, " free"], Flag]:
        return self.solve(right), self.is_stable()

    def is_stable(self) -> Flag:
        """Decide whether the matrix resists every displacement; see `Factors`."""
        return is_stable(self.triangles, self.pivots)
