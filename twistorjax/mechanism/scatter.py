"""Entries of all hinges in the vectors and matrices of a mechanism."""

from functools import lru_cache

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int


def gather_entries(
    entries: Float[Array, " entries"], source: np.ndarray
) -> Float[Array, " chosen"]:
    """Return the entries at constant positions, which must not be negative.

    An index in brackets would take ten times as long to trace.
    """
    positions = source[:, None].astype(np.int32)
    dimensions = lax.GatherDimensionNumbers((), (0,), (0,))
    return lax.gather(entries, positions, dimensions, (1,), mode="promise_in_bounds")


def sum_entries(
    entries: Float[Array, " entries"],
    source: np.ndarray,
    target: np.ndarray,
    size: int,
    signs: np.ndarray | None = None,
) -> Float[Array, " size"]:
    """Sum the entries at `source` that have the same target, for all targets.

    The entries are multiplied by `signs`, if they are given.

    If there are few targets, each target gathers its entries, which are then processed in
    parallel. A scatter operation processes one entry after another.
    """
    counts = np.bincount(target, minlength=size)
    largest = counts.max(initial=0)
    if size * largest > 8 * entries.size + 1024:
        chosen = gather_entries(entries, source)
        if signs is not None:
            chosen = chosen * jnp.asarray(signs)
        return jnp.zeros(size).at[target].add(chosen)
    order = np.argsort(target, kind="stable")
    column = np.arange(target.size) - np.repeat(np.cumsum(counts) - counts, counts)
    gathered = np.full((size, largest), entries.size)
    gathered[target[order], column] = source[order]
    weights = np.ones((size, largest))
    if signs is not None:
        weights[target[order], column] = signs[order]
    padded = jnp.concatenate([entries, jnp.zeros(1)])
    total = jnp.zeros(size)
    for rows, factors in zip(gathered.T, weights.T, strict=True):
        chosen = gather_entries(padded, rows)
        total = total + (chosen if signs is None else chosen * jnp.asarray(factors))
    return total


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
) -> tuple[np.ndarray, np.ndarray]:
    """Find the positions of the 6 by 6 matrices of hinges in the matrix of a mechanism.

    Args:
        ends: Indices of the two bodies of each hinge.
        order: Index of the hinge of each 6 by 6 matrix.
        rows: Degrees of freedom of the rows of the matrix of the mechanism.
        columns: Degrees of freedom of its columns.

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
    target = row.reshape(-1)[source] * len(columns) + column.reshape(-1)[source]
    return source, target


@lru_cache(maxsize=256)
def row_entries(
    ends: tuple[tuple[int, int], ...],
    order: tuple[int, ...],
    rows: tuple[int, ...],
    lines: int = 2,
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
