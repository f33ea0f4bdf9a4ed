"""The numbers in some leaves of a design as a vector."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from .._utils.host import on_host
from .._utils.pytrees import entry_names, path_name, split_last_axis


class VectorLayout(eqx.Module):
    """Arrangement of the numbers in some leaves of a design as a vector."""

    constants: Any  # The design with None in place of these leaves
    # Structure of the design with None in place of the constants
    structure: Any = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)  # Name of each leaf
    shapes: tuple[tuple[int, ...], ...] = eqx.field(static=True)  # Shape of each leaf

    @classmethod
    def of(
        cls,
        design: Any,
        is_selected: Callable[[Any], bool],
        shape: Callable[[Any], tuple[int, ...]],
    ) -> tuple["VectorLayout", list[Any]]:
        """Return the layout for the selected leaves of a design, and these leaves."""
        selected, constants = eqx.partition(design, is_selected, is_leaf=is_selected)
        pairs, structure = jax.tree_util.tree_flatten_with_path(selected, is_selected)
        names = tuple(path_name(path) for path, _ in pairs)
        leaves = [leaf for _, leaf in pairs]
        return cls(constants, structure, names, tuple(map(shape, leaves))), leaves

    @property
    def entry_names(self) -> tuple[str, ...]:
        pairs = zip(self.names, self.shapes, strict=True)
        return tuple(entry for pair in pairs for entry in entry_names(*pair))

    def split(self, vectors: Float[Array | np.ndarray, "*designs entries"]) -> list[Any]:
        """Return the array of each leaf, whose first axes are those of the designs."""
        _, (vectors,) = on_host(vectors)
        return split_last_axis(vectors, self.shapes)

    def design(self, leaves: Sequence[Any]) -> Any:
        """Return the design with the given arrays as leaves."""
        return eqx.combine(jax.tree.unflatten(self.structure, leaves), self.constants)

    def designs(self, vectors: Float[np.ndarray, "designs entries"]) -> Any:
        """Return a tree of arrays, whose first axis has one entry for each design."""
        count, leaves = len(vectors), self.split(vectors)
        constants = jax.tree.map(
            lambda leaf: np.broadcast_to(leaf, (count, *np.shape(leaf))), self.constants
        )
        return eqx.combine(jax.tree.unflatten(self.structure, leaves), constants)
