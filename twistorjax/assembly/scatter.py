"""Entries of all hinges in the vectors and matrices of a mechanism."""

import math
from functools import lru_cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..linalg.block_factors import Layout
from ..linalg.sums import gather_entries, sum_entries


def sum_matrices(
    matrices: Float[Array, "6 6 members"],
    ends: tuple[tuple[int, int], ...],
    order: tuple[int, ...],
    dofs: tuple[int, ...],
    layout: Layout | None = None,
) -> Float[Array, "*matrix"]:
    """Sum the matrices of hinges among some degrees of freedom; see `matrix_entries`.

    The sum is dense, or has the shape of a layout.
    """
    indices = matrix_entries(ends, order, dofs, dofs, layout)
    shape = 2 * (len(dofs),) if layout is None else layout.shape
    return sum_entries(matrices.reshape(-1), *indices, math.prod(shape)).reshape(shape)


def displacements_of_members(
    vectors: Float[Array, "free ..."],
    ends: tuple[tuple[int, int], ...],
    order: tuple[int, ...],
    free: tuple[int, ...],
) -> Float[Array, "6 members ..."]:
    """Return the six displacements of each hinge; those that are not free are zero."""
    source, target = vector_entries(ends, order, free)
    position = np.full(6 * len(order), len(free))
    position[source] = target
    padded = jnp.concatenate([vectors, jnp.zeros_like(vectors[:1])])
    return gather_entries(padded, position).reshape(6, -1, *vectors.shape[1:])


@lru_cache(maxsize=256)
def hinge_dofs(
    ends: tuple[tuple[int, int], ...], order: tuple[int, ...]
) -> Int[np.ndarray, "6 members"]:
    """Return the six degrees of freedom of the two bodies of each hinge in `order`."""
    bodies = np.array(ends).reshape(-1, 2)[list(order)]
    return (3 * bodies[:, :, None] + np.arange(3)).reshape(-1, 6).T


@lru_cache(maxsize=256)
def matrix_entries(
    ends: tuple[tuple[int, int], ...],
    order: tuple[int, ...],
    rows: tuple[int, ...],
    columns: tuple[int, ...],
    layout: Layout | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Find the positions of the 6 by 6 matrices of hinges in the matrix of a mechanism.

    Args:
        ends: Indices of the two bodies of each hinge.
        order: Index of the hinge of each 6 by 6 matrix.
        layout: Layout of the blocks of the matrix of a mechanism, if it is not dense.

    Returns:
        The indices of the entries that are used, in the flat array of shape (6, 6,
        matrices); and the index of each in the flat matrix of the mechanism.
    """
    dofs = hinge_dofs(ends, order)
    size = 1 + max(dofs.max(initial=0), *rows, *columns, 0)
    row_of, column_of = np.full(size, -1), np.full(size, -1)
    row_of[list(rows)] = np.arange(len(rows))
    column_of[list(columns)] = np.arange(len(columns))
    row = np.broadcast_to(row_of[dofs][:, None], (6, *dofs.shape))
    column = np.broadcast_to(column_of[dofs][None], (6, *dofs.shape))
    source = np.flatnonzero((row >= 0) & (column >= 0))
    row, column = row.reshape(-1)[source], column.reshape(-1)[source]
    if layout is not None:
        return source, layout.flat_indices(row, column)
    return source, row * len(columns) + column


@lru_cache(maxsize=256)
def vector_entries(
    ends: tuple[tuple[int, int], ...], order: tuple[int, ...], rows: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Find the positions of the six entries of each hinge in a vector of a mechanism.

    Arguments and results are as in `matrix_entries`.
    """
    dofs = hinge_dofs(ends, order)
    row_of = np.full(1 + max(dofs.max(initial=0), *rows, 0), -1)
    row_of[list(rows)] = np.arange(len(rows))
    row = row_of[dofs].reshape(-1)
    source = np.flatnonzero(row >= 0)
    return source, row[source]


@lru_cache(maxsize=256)
def row_entries(
    ends: tuple[tuple[int, int], ...],
    order: tuple[int, ...],
    rows: tuple[int, ...],
    lines: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Find the positions of the rows of hinges, with 6 entries each, in a matrix.

    The columns of this matrix are the rows of the hinges, `lines` for each hinge. Other
    arguments and results are as in `matrix_entries`.
    """
    dofs = hinge_dofs(ends, order)
    row_of = np.full(1 + max(dofs.max(initial=0), *rows, 0), -1)
    row_of[list(rows)] = np.arange(len(rows))
    members = dofs.shape[1]
    row = np.broadcast_to(row_of[dofs][None], (lines, 6, members))
    column = lines * np.arange(members) + np.arange(lines)[:, None, None]
    source = np.flatnonzero(row >= 0)
    target = row * lines * members + np.broadcast_to(column, row.shape)
    return source, target.reshape(-1)[source]
