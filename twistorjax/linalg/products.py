"""Products of small matrices whose sums are written out."""

from collections.abc import Sequence

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Inexact

from .._utils.types import Scalar


_MOST_TERMS = 24  # of sums that are written out


def product(
    first: Inexact[Array, "rows inner"], second: Inexact[Array, "inner columns"]
) -> Inexact[Array, "rows columns"]:
    """Multiply two small matrices as a sum, which XLA fuses with other operations.

    For a few rows, the call of a matrix product takes longer than its operations, and so
    does that of a reduction. The time of compilation grows with the number of terms, so
    that many terms are reduced.
    """
    if len(second) > _MOST_TERMS:
        return jnp.sum(first[:, :, None] * second[None], axis=1)
    sizes = (1,) * len(second)  # `jnp.split` would not accept an empty one
    columns, rows = lax.split(first, sizes, axis=1), lax.split(second, sizes)
    zero = jnp.zeros((len(first), second.shape[1]), first.dtype)
    return sum(map(jnp.multiply, columns, rows), start=zero)


def as_array(rows: Sequence[Sequence[Scalar]]) -> Float[Array, "rows columns"]:
    """Convert rows of scalars to an array."""
    return jnp.stack([jnp.stack(row) for row in rows])
