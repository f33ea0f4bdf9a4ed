"""Values that XLA computes once, although several other values depend on them."""

from collections.abc import Sequence
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Inexact


Tree = TypeVar("Tree")

# For fewer values than these, further loops take longer than repeated operations.
_FEWEST_VALUES = 64


def computed_once(tree: Tree, finite: Inexact[Array, "*batch"]) -> Tree:
    """Return the leaves of a tree, such that XLA computes them once in large batches.

    XLA computes each of many outputs in a loop of its own. In this loop it computes again
    what the output depends on, except operations that it counts as expensive, such as a
    division. All leaves are therefore divided by one, if there are many. Their
    derivatives are those of the tree.

    Args:
        tree: Arrays with the same shape as `finite`.
        finite: Finite values, from which the ones are computed. XLA does not know that
            they are ones.

    Example:
        >>> computed_once((jnp.ones(2), jnp.zeros(2)), jnp.ones(2))
        (Array([1., 1.], dtype=float64), Array([0., 0.], dtype=float64))
    """
    leaves, structure = jax.tree.flatten(tree)
    one = 1 + 0 * jax.lax.stop_gradient(finite)
    return jax.tree.unflatten(structure, _with_same_derivatives(leaves, one))


@jax.custom_jvp
def _with_same_derivatives(leaves: list[Array], one: Array) -> list[Array]:
    return _divide_many(leaves, one)


@_with_same_derivatives.defjvp
def _(primals, tangents):
    return _with_same_derivatives(*primals), tangents[0]


@jax.custom_batching.custom_vmap
def _divide_many(leaves: list[Array], one: Array) -> list[Array]:
    if one.size < _FEWEST_VALUES:
        return leaves
    return [leaf / one for leaf in leaves]


@_divide_many.def_vmap
def _(axis_size: int, in_batched: Sequence, leaves: list[Array], one: Array):
    """Divide the whole batch, whose size is known only here."""

    def batch(values: Array, batched: bool) -> Array:
        return values if batched else jnp.broadcast_to(values, (axis_size, *values.shape))

    leaves_batched, one_batched = in_batched
    leaves = [batch(*pair) for pair in zip(leaves, leaves_batched, strict=True)]
    divided = _divide_many(leaves, batch(one, one_batched))
    return divided, [True] * len(divided)
