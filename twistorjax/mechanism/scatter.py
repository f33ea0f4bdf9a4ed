"""Which entries of all hinges go where in the vectors and matrices of a mechanism."""

from functools import lru_cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


def summed(
    entries: Float[Array, " entries"], source: np.ndarray, target: np.ndarray, size: int
) -> Float[Array, " size"]:
    """Sum those entries of a row that have the same target.

    Where the targets are few each gathers its own, which a processor does side by side;
    it would add them one after another.
    """
    counts = np.bincount(target, minlength=size)
    most = counts.max(initial=0)
    if size * most > 8 * entries.size + 1024:
        return jnp.zeros(size).at[target].add(entries[source])
    order = np.argsort(target, kind="stable")
    place = np.arange(target.size) - np.repeat(np.cumsum(counts) - counts, counts)
    gathered = np.full((size, most), entries.size)
    gathered[target[order], place] = source[order]
    padded = jnp.concatenate([entries, jnp.zeros(1)])
    return jnp.sum(padded[gathered], axis=1)


@lru_cache(maxsize=256)
def coordinates_of(
    ends: tuple[tuple[int, int], ...], order: tuple[int, ...]
) -> np.ndarray:
    """The six coordinates of each hinge's two bodies, a column for each hinge."""
    bodies = np.array(ends).reshape(-1, 2)[list(order)]
    return (3 * bodies[:, :, None] + np.arange(3)).reshape(-1, 6).T


@lru_cache(maxsize=256)
def places_of_pairs(
    ends: tuple[tuple[int, int], ...],
    order: tuple[int, ...],
    rows: tuple[int, ...],
    columns: tuple[int, ...],
) -> tuple[np.ndarray, np.ndarray]:
    """Which entries of all hinges' matrices go where in the matrix of a mechanism."""
    coordinates = coordinates_of(ends, order)
    size = 1 + max(coordinates.max(initial=0), *rows, *columns, 0)
    row_of, column_of = np.full(size, -1), np.full(size, -1)
    row_of[list(rows)] = np.arange(len(rows))
    column_of[list(columns)] = np.arange(len(columns))
    row = np.broadcast_to(row_of[coordinates][:, None], (6, *coordinates.shape))
    column = np.broadcast_to(column_of[coordinates][None], (6, *coordinates.shape))
    source = np.flatnonzero((row >= 0) & (column >= 0))
    target = row.reshape(-1)[source] * len(columns) + column.reshape(-1)[source]
    return source, target


@lru_cache(maxsize=256)
def places_of_lines(
    ends: tuple[tuple[int, int], ...],
    order: tuple[int, ...],
    rows: tuple[int, ...],
    lines: int = 2,
) -> tuple[np.ndarray, np.ndarray]:
    """Which entries of all hinges' lines go where in a mechanism's matrix."""
    coordinates = coordinates_of(ends, order)
    row_of = np.full(1 + max(coordinates.max(initial=0), *rows, 0), -1)
    row_of[list(rows)] = np.arange(len(rows))
    hinges = coordinates.shape[1]
    row = np.broadcast_to(row_of[coordinates][None], (lines, 6, hinges))
    column = lines * np.arange(hinges) + np.arange(lines)[:, None, None]
    source = np.flatnonzero(row >= 0)
    target = row * lines * hinges + np.broadcast_to(column, row.shape)
    return source, target.reshape(-1)[source]
