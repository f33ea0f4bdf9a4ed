"""Factors of the tangent stiffness of a mechanism of many bodies, in blocks."""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Inexact, Int

from .._utils.types import Flag, Scalar
from .elimination import inverse
from .factors import diagonal_scale, Factors, is_stable, scale_rows


# With fewer free degrees of freedom, or fewer blocks, a dense factorization is faster
# (`benchmarks.chains`).
_LEAST_DOFS = 120
_LEAST_BLOCKS = 8
# Smaller blocks take more time, because each block costs several calls of LAPACK.
_LEAST_BLOCK_SIZE = 12
# Of complex matrices: improvements of a solution, its largest residual relative to the
# product of matrix and solution, and what is added to the diagonal if this is exceeded.
_REFINEMENTS, _LARGEST_ERROR, _SHIFT = 3, 1e-13, 1e-9


class Layout(NamedTuple):
    """An order of degrees of freedom in which a matrix is block tridiagonal."""

    order: tuple[int, ...]  # Index of each free degree of freedom in the new order
    size: int  # Number of rows of a block
    blocks: int  # Number of blocks on the diagonal

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Shape of the array of blocks: on the diagonal, below it, and above it."""
        return 3, self.blocks, self.size, self.size

    def flat_indices(
        self, rows: Int[np.ndarray, " entries"], columns: Int[np.ndarray, " entries"]
    ) -> Int[np.ndarray, " entries"]:
        """Compute the indices of matrix entries in the flattened array of blocks.

        Rows and columns of the matrix are numbered by the free degrees of freedom. The
        array has the `shape` of the layout.
        """
        order = np.array(self.order)
        row, column = order[rows], order[columns]
        row_block, column_block = row // self.size, column // self.size
        diagonal = (row_block - column_block) % 3  # 0 is the diagonal, 1 below, 2 above
        block = np.maximum(row_block, column_block)
        in_block = (row % self.size) * self.size + column % self.size
        return (diagonal * self.blocks + block) * self.size**2 + in_block

    def complete(
        self, blocks: Inexact[Array, "3 blocks size size"]
    ) -> Inexact[Array, "3 blocks size size"]:
        """Set the diagonal of unused rows at the end to one."""
        used = np.arange(self.blocks * self.size) < len(self.order)
        unused = np.eye(self.size)[None] * ~used.reshape(self.blocks, self.size, 1)
        return blocks.at[0].add(jnp.asarray(unused, blocks.dtype))

    def rows(
        self, vectors: Inexact[Array, "free ..."]
    ) -> Inexact[Array, "blocks size ..."]:
        """Arrange vectors by blocks; unused entries are zero."""
        padded = jnp.concatenate([vectors, jnp.zeros_like(vectors[:1])])
        return padded[self._dofs()]

    def of_dense(
        self, matrix: Inexact[Array, "free free"]
    ) -> Inexact[Array, "3 blocks size size"]:
        """Arrange a block tridiagonal matrix in blocks."""
        padded = jnp.pad(matrix, (0, 1))
        dofs = self._dofs()
        before = np.concatenate([np.full((1, self.size), len(self.order)), dofs[:-1]])
        pairs = (dofs, dofs), (dofs, before), (before, dofs)
        return jnp.stack(
            [padded[rows[:, :, None], columns[:, None]] for rows, columns in pairs]
        )

    def of_diagonal(
        self, diagonal: Float[Array, " free"]
    ) -> Float[Array, "3 blocks size size"]:
        """Arrange a diagonal matrix in blocks."""
        on_diagonal = self.rows(diagonal)[:, None] * np.eye(self.size)[None]
        return jnp.zeros(self.shape).at[0].set(on_diagonal)

    def diagonal(
        self, blocks: Inexact[Array, "3 blocks size size"]
    ) -> Inexact[Array, " free"]:
        """Return the diagonal of a matrix."""
        return self.vector(jnp.diagonal(blocks[0], axis1=1, axis2=2))

    def scaled(
        self, blocks: Inexact[Array, "3 blocks size size"], units: Float[Array, " free"]
    ) -> Inexact[Array, "3 blocks size size"]:
        """Multiply the rows and the columns of a matrix by units."""
        of_blocks = self.rows(units)
        before = jnp.roll(of_blocks, 1, axis=0)
        rows = jnp.stack([of_blocks, of_blocks, before])[..., None]
        columns = jnp.stack([of_blocks, before, of_blocks])[..., None, :]
        return (rows * columns).astype(blocks.dtype) * blocks

    def times(
        self,
        blocks: Inexact[Array, "3 blocks size size"],
        vector: Inexact[Array, " free"],
    ) -> Inexact[Array, " free"]:
        """Multiply a matrix and a vector."""
        rows = self.rows(vector)
        parts = jnp.stack([rows, jnp.roll(rows, 1, axis=0), rows])
        diagonal, below, above = jnp.sum(blocks * parts[..., None, :], axis=-1)
        # The first block has none above it, so that the last row gets zeros.
        return self.vector(diagonal + below + jnp.roll(above, -1, axis=0))

    def _dofs(self) -> Int[np.ndarray, "blocks size"]:
        """Return the degree of freedom of each row; their number if it is not used."""
        dofs = np.full(self.blocks * self.size, len(self.order))
        dofs[list(self.order)] = np.arange(len(self.order))
        return dofs.reshape(self.blocks, self.size)

    def vector(
        self, rows: Inexact[Array, "blocks size ..."]
    ) -> Inexact[Array, "free ..."]:
        """Arrange the rows of blocks as vectors again."""
        return rows.reshape(-1, *rows.shape[2:])[np.array(self.order)]


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
    scale: Float[Array, " free"]  # Reciprocal square roots of the diagonal
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
        """Factorize a matrix, given by its blocks on, below, and above the diagonal."""
        scale = diagonal_scale(layout.diagonal(blocks))
        diagonal, below, above = layout.complete(layout.scaled(blocks, scale))
        one = jnp.ones(layout.size)

        def eliminate(factors_before: Factors, blocks):
            diagonal, below, above = blocks
            above = factors_before.solve_scaled(above)
            factors = Factors.of_scaled(diagonal - below @ above, symmetric, one)
            return factors, (factors.triangle, factors.pivots, above)

        identity = Factors.of_scaled(jnp.eye(layout.size), symmetric, one)
        _, (triangles, pivots, above) = jax.lax.scan(
            eliminate, identity, (diagonal, below, above)
        )
        return cls(layout, scale, below, triangles, pivots, above)

    def solve(self, right: Float[Array, "free ..."]) -> Float[Array, "free ..."]:
        one = jnp.ones(self.layout.size)

        def solve_block(factors: tuple[Array, Array | None], right: Array) -> Array:
            return Factors(one, *factors).solve_scaled(right)

        rows = self.layout.rows(scale_rows(self.scale, right))
        factors = self.triangles, self.pivots
        solution = _substitute(solve_block, factors, self.below, self.above, rows)
        return scale_rows(self.scale, self.layout.vector(solution))

    def solve_and_check(
        self, right: Float[Array, " free"]
    ) -> tuple[Float[Array, " free"], Flag]:
        return self.solve(right), self.is_stable()

    def is_stable(self) -> Flag:
        """Decide whether the matrix resists every displacement; see `Factors`."""
        return is_stable(self.triangles, self.pivots)


class BlockInverses(eqx.Module):
    """A block tridiagonal matrix whose eliminated blocks on the diagonal are inverted.

    The matrix may be complex. It is eliminated without pivoting; see `inverse`. Its
    linear systems, of which a step of a motion solves several, take half the time of
    `BlockFactors` (`benchmarks.lattices`).
    """

    layout: Layout = eqx.field(static=True)
    inverses: Inexact[Array, "blocks size size"]  # Those of the eliminated blocks
    below: Inexact[Array, "blocks size size"]  # The first one is zero
    above: Inexact[Array, "blocks size size"]  # As in `BlockFactors`

    @classmethod
    def of(
        cls, blocks: Inexact[Array, "3 blocks size size"], layout: Layout
    ) -> "BlockInverses":
        """Eliminate a matrix, given by its blocks on, below, and above the diagonal."""

        def eliminate(inverse_before, blocks):
            diagonal, below, above = blocks
            above = inverse_before @ above
            inverted = inverse(diagonal - below @ above)
            return inverted, (inverted, above)

        blocks = layout.complete(blocks)
        identity = jnp.eye(layout.size, dtype=blocks.dtype)
        _, (inverses, above) = jax.lax.scan(eliminate, identity, tuple(blocks))
        return cls(layout, inverses, blocks[1], above)

    def solve(self, right: Inexact[Array, "free ..."]) -> Inexact[Array, "free ..."]:
        rows = self.layout.rows(right)
        solution = _substitute(jnp.matmul, self.inverses, self.below, self.above, rows)
        return self.layout.vector(solution)

    def is_positive(self) -> Flag:
        """Decide whether a symmetric matrix is positive definite.

        It is if all eliminated blocks are.
        """
        return jnp.all(jnp.isfinite(jnp.linalg.cholesky(self.inverses)))

    def diagonal(self) -> Inexact[Array, " free"]:
        """Compute the diagonal of the inverse of the matrix.

        Source:
            Erisman and Tinney, On computing certain elements of the inverse of a sparse
            matrix, Communications of the ACM 18, 1975.
        """

        def block(inverse_after, block):
            inverted, above_next, below_next = block
            whole = inverted + above_next @ inverse_after @ below_next @ inverted
            return whole, jnp.diagonal(whole)

        following = (jnp.roll(part, -1, axis=0) for part in (self.above, self.below))
        zero = jnp.zeros_like(self.inverses[0])
        parts = (self.inverses, *following)
        _, diagonals = jax.lax.scan(block, zero, parts, reverse=True)
        return self.layout.vector(diagonals)


def solve_in_blocks(
    blocks: Complex[Array, "3 blocks size size"],
    layout: Layout,
    right: Complex[Array, " free"],
) -> tuple[Complex[Array, " free"], Scalar]:
    """Solve a complex linear system, and estimate its condition number.

    The diagonal of the matrix is of the order of one. The matrix is eliminated without
    pivoting, and the solution is improved. If a leading part of the matrix is singular,
    imaginary numbers are added to the diagonal before. The condition number is the growth
    of the solution for random numbers; infinite if there is no accurate one.
    """
    known = jax.lax.stop_gradient(blocks)
    size = jnp.linalg.norm(known)
    probe = np.random.default_rng(0).normal(size=(2, len(layout.order)))
    probe = jnp.asarray(probe[0] + 1j * probe[1])

    def inverted(matrix: Array, shift: Scalar) -> BlockInverses:
        shifts = jax.lax.complex(0.0, shift) * jnp.eye(layout.size, dtype=complex)
        return BlockInverses.of(matrix.at[0].add(shifts), layout)

    def improved(inverses: BlockInverses, apply: Callable, right: Array) -> Array:
        def improve(_, solution: Array) -> Array:
            return solution + inverses.solve(right - apply(solution))

        return jax.lax.fori_loop(0, _REFINEMENTS, improve, inverses.solve(right))

    def attempt(shift: Scalar) -> tuple[BlockInverses, Scalar, Scalar]:
        inverses = inverted(known, shift)
        solution = improved(inverses, partial(layout.times, known), probe)
        growth = size * jnp.linalg.norm(solution)
        error = jnp.linalg.norm(probe - layout.times(known, solution))
        accurate = error <= _LARGEST_ERROR * growth
        condition = jnp.where(accurate, growth / jnp.linalg.norm(probe), jnp.inf)
        return inverses, condition, shift

    first = attempt(jnp.zeros(()))
    inverses, condition, shift = jax.lax.cond(
        jnp.isfinite(first[1]), lambda: first, lambda: attempt(jnp.asarray(_SHIFT))
    )

    def solve(apply: Callable, right: Array) -> Array:
        return improved(inverses, apply, right)

    def solve_transposed(apply: Callable, right: Array) -> Array:
        diagonal, below, above = jnp.swapaxes(known, -1, -2)
        transposed = inverted(jnp.stack([diagonal, above, below]), shift)
        return improved(transposed, apply, right)

    apply = partial(layout.times, blocks)
    solution = jax.lax.custom_linear_solve(apply, right, solve, solve_transposed)
    return solution, condition


def _substitute(
    solve_block: Callable[[Any, Array], Array],
    factors: Any,
    below: Inexact[Array, "blocks size size"],
    above: Inexact[Array, "blocks size size"],
    rows: Inexact[Array, "blocks size ..."],
) -> Inexact[Array, "blocks size ..."]:
    """Solve with eliminated blocks, forward with `solve_block`, then backward."""

    def forward(solution_before, block):
        factors, below, right = block
        solution = solve_block(factors, right - below @ solution_before)
        return solution, solution

    def backward(solution_after, block):
        above, solution = block
        solution = solution - above @ solution_after
        return solution, solution

    zero = jnp.zeros_like(rows[0])
    _, solution = jax.lax.scan(forward, zero, (factors, below, rows))
    # The first block above the diagonal is zero, so it may follow the last one.
    above = jnp.roll(above, -1, axis=0)
    return jax.lax.scan(backward, zero, (above, solution), reverse=True)[1]
