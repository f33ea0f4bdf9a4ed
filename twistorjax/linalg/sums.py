"""Sums of chosen entries of an array, for vectors and matrices of a mechanism."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Inexact


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
) -> Float[Array, " size"]:
    """Sum the entries at `source` that have the same target, for all targets.

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

    return _with_batch_last(add)(entries)


def _with_batch_last(function: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """Let `jax.vmap` call a linear function with the batch as the last axis.

    The function must accept such batches. Its derivatives are batched as usual. The
    layout is that of `eliminate`: the gains of 128 stages take 0.83 instead of 0.99 ms
    (`benchmarks.sweeps`).
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
