"""Entries of all hinges in the vectors and matrices of a mechanism."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Inexact, Int


def gather_entries(
    entries: Inexact[Array, "entries ..."], source: np.ndarray
) -> Inexact[Array, "chosen ..."]:
    """Return the entries at constant positions, which must not be negative.

    An index in brackets would take ten times as long to trace.
    """
    positions = source[:, None].astype(np.int32)
    batch = entries.shape[1:]
    dimensions = lax.GatherDimensionNumbers(tuple(range(1, 1 + len(batch))), (0,), (0,))
    sizes = (1, *batch)
    return lax.gather(entries, positions, dimensions, sizes, mode="promise_in_bounds")


def sum_entries(
    entries: Float[Array, " entries"],
    source: np.ndarray,
    target: np.ndarray,
    size: int,
    signs: np.ndarray | None = None,
    batch_last: bool = False,
) -> Float[Array, " size"]:
    """Sum the entries at `source` that have the same target, for all targets.

    If there are few targets, each target gathers its entries, which are then processed in
    parallel. A scatter operation processes one entry after another.

    Args:
        source: Indices of the entries that are summed.
        target: Index of each of them in the sum.
        signs: Signs by which they are multiplied; all positive if None.
        batch_last: Whether `jax.vmap` makes its axis the last one in memory. This is
            faster if the sum is a matrix for `small_matrices.eliminate`, and slower if
            other operations need it.
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

    def add(entries: Float[Array, "entries ..."]) -> Float[Array, "size ..."]:
        batch = entries.shape[1:]
        padded = jnp.concatenate([entries, jnp.zeros((1, *batch))])
        total = jnp.zeros((size, *batch))
        for rows, factors in zip(gathered.T, weights.T, strict=True):
            chosen = gather_entries(padded, rows)
            if signs is not None:
                chosen = chosen * factors.reshape(-1, *(1 for _ in batch))
            total = total + chosen
        return total

    return _with_batch_last(add)(entries) if batch_last else add(entries)


def _with_batch_last(function: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """Let `jax.vmap` call a linear function with the batch as the last axis.

    The function must accept such batches. Its derivatives are batched as usual.
    """
    batched = jax.custom_batching.custom_vmap(function)

    @batched.def_vmap
    def _(axis_size: int, in_batched: Sequence[bool], values: Array):
        del axis_size, in_batched
        return jnp.moveaxis(function(jnp.moveaxis(values, 0, -1)), -1, 0), True

    # JAX cannot differentiate a function with such a rule in reverse mode.
    linear = jax.custom_jvp(batched)
    linear.defjvp(lambda primals, changes: (linear(*primals), function(*changes)))
    return linear


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
