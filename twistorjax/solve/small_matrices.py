"""Inverses of small matrices, by the thousand."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Inexact


def inverse(matrix: Inexact[Array, "... n n"]) -> Inexact[Array, "... n n"]:
    """By elimination down the diagonal, without a search for pivots.

    For matrices whose symmetric part is positive, or is so in blocks that lean on one
    another, as inertia and constraints do. For small ones it takes less time than
    LAPACK's; and batches of LAPACK's wait for one another in XLA's threads, two of them
    for ever (jaxlib 0.10, where two run side by side on two cores).

    Args:
        matrix: one or many of them; where it has no inverse the answer is not finite.

    Example:
        >>> inverse(jnp.array([[2.0, 1.0], [1.0, 1.0]]))
        Array([[ 1., -1.],
               [-1.,  2.]], dtype=float64)
    """
    size = matrix.shape[-1]
    if not size:
        return matrix

    def eliminate(k: Array, reference: Array) -> Array:
        down = jax.lax.dynamic_index_in_dim(reference, k, 2, keepdims=True)
        along = jax.lax.dynamic_index_in_dim(reference, k, 1, keepdims=True)
        over = 1 / jax.lax.dynamic_index_in_dim(along, k, 2, keepdims=True)
        along = along * over
        here = jnp.arange(size) == k
        row, column = here[None, :, None], here[None, None]
        found = jnp.where(column, -down * over, reference - down * along)
        return jnp.where(row, jnp.where(column, over, along), found)

    flat = matrix.reshape(-1, size, size)
    return jax.lax.fori_loop(0, size, eliminate, flat).reshape(matrix.shape)
