"""Values that XLA computes once, although several other values depend on them."""

from typing import TypeVar

import jax
from jaxtyping import Array, Inexact


Tree = TypeVar("Tree")


def computed_once(tree: Tree, finite: Inexact[Array, "*batch"]) -> Tree:
    """Return the leaves of a tree, such that XLA computes them once.

    XLA computes each of many outputs in a loop of its own. In this loop it computes again
    what the output depends on, except operations that it counts as expensive, such as a
    division. All leaves are therefore divided by one. In a batch of 256 stages, their
    tangents take a third of the time.

    Args:
        tree: Arrays with the same shape as `finite`.
        finite: Finite values, from which the ones are computed. XLA does not know that
            they are ones.

    Example:
        >>> computed_once((jax.numpy.ones(2), jax.numpy.zeros(2)), jax.numpy.ones(2))
        (Array([1., 1.], dtype=float64), Array([0., 0.], dtype=float64))
    """
    one = 1 + 0 * jax.lax.stop_gradient(finite)
    return jax.tree.map(lambda leaf: leaf / one, tree)
