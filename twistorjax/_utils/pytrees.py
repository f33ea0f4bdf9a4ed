"""Trees of arrays: which can be stacked, and which are not to be differentiated."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np


def alike(trees: Sequence[Any]) -> list[list[int]]:
    """The places of those trees that can be stacked: of one structure, shape and type."""
    kinds: dict[Any, list[int]] = {}
    for place, tree in enumerate(trees):
        leaves, structure = jax.tree.flatten(tree)
        shapes = tuple((np.shape(leaf), jnp.result_type(leaf)) for leaf in leaves)
        kinds.setdefault((structure, shapes), []).append(place)
    return list(kinds.values())


def path_name(path: Sequence[Any]) -> str:
    """What a leaf is called, by its path: "leaf.length"; "value" where it is all."""
    return jax.tree_util.keystr(tuple(path), simple=True, separator=".") or "value"


def entry_names(name: str, shape: tuple[int, ...]) -> list[str]:
    """What the entries of an array of that name are called: "web[0]", "web[1]"."""
    places = (", ".join(map(str, place)) for place in np.ndindex(shape))
    return [f"{name}[{place}]" if place else name for place in places]


def undifferentiated(tree: Any) -> Any:
    """The same, with no derivative: what changes the way to an answer, and not it.

    Stopped on the way in: tangents that are dropped in the end are traced nevertheless.
    """
    arrays, rest = eqx.partition(tree, eqx.is_array)
    return eqx.combine(jax.lax.stop_gradient(arrays), rest)
