"""The designs of a sweep, a lane each."""

import math
import sys
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Num

from .._utils.pytrees import path_name
from .names import check_parameters


class Grid:
    """Every combination of some values of each parameter.

    Args:
        values: of each parameter, by its name: a row of numbers. The last changes
            fastest.

    Raises:
        ValueError: there is no parameter, or one has no row of numbers, or its name
            cannot be that of a parameter.

    Example:
        >>> Grid({"length": [5e-3, 10e-3], "thickness": [0.2e-3, 0.4e-3, 0.6e-3]})
        Grid of 6 designs: 2 of length, 3 of thickness
    """

    values: dict[str, np.ndarray]

    def __init__(
        self,
        values: Mapping[str, Num[ArrayLike, " values"] | Sequence[float | int]],
    ):
        self.values = {name: _floats(np.asarray(row)) for name, row in values.items()}
        if not self.values:
            raise ValueError("`values` is empty, but a grid needs a parameter.")
        check_parameters(tuple(self.values))
        for name, row in self.values.items():
            if row.ndim != 1 or not row.size or not np.issubdtype(row.dtype, np.number):
                raise ValueError(
                    f"`values[{name!r}]` has shape {row.shape} and type {row.dtype}, but "
                    "must be a row of numbers."
                )

    def __repr__(self) -> str:
        parts = (f"{row.size} of {name}" for name, row in self.values.items())
        total = math.prod(row.size for row in self.values.values())
        return f"Grid of {total:,} designs: {', '.join(parts)}"


def _floats(row: np.ndarray) -> np.ndarray:
    """Whole numbers as others, so that answers can be differentiated by them."""
    return row.astype(float) if np.issubdtype(row.dtype, np.integer) else row


class Kind(NamedTuple):
    """Of what designs consist: alike for those that one program serves.

    Args:
        tree: what a study takes.
        order: of its leaves, the place of each among the names.
        names: of the parameters.
        shapes: of each for one design, and the type of its numbers.
    """

    tree: Any
    order: tuple[int, ...]
    names: tuple[str, ...]
    shapes: tuple[tuple[tuple[int, ...], np.dtype], ...]

    def design(self, leaves: Sequence[Array]) -> Any:
        """One design, as the study takes it, of its parameters by their names."""
        sorted_out = [jnp.asarray(leaves[place]) for place in self.order]
        return jax.tree.unflatten(self.tree, sorted_out)


class Designs:
    """Designs in a row, whatever they were given as.

    Args:
        designs: a `Grid`; or a tree of arrays, such as a mapping from names, each with an
            entry for each design along its first axis.

    Raises:
        ValueError: there is no array; they are of different lengths, or too many to be
            numbered; a name cannot be that of a parameter.
    """

    kind: Kind
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    arrays: list[np.ndarray]

    def __init__(self, designs: Any):
        self._grid = isinstance(designs, Grid)
        if isinstance(designs, Grid):
            self.dims = tuple(designs.values)
            self.arrays = list(designs.values.values())
            self.shape = tuple(row.size for row in self.arrays)
            if (count := math.prod(self.shape)) > sys.maxsize:
                raise ValueError(
                    f"`designs` is a grid of {count:.3g} designs, but at most "
                    f"{sys.maxsize:.3g} can be numbered. Use fewer values, or split "
                    "them into several sweeps."
                )
            # of a mapping, whose leaves JAX puts in the order of their names
            order = tuple(self.dims.index(name) for name in sorted(self.dims))
            tree = jax.tree.structure(designs.values)
            self.kind = Kind(tree, order, self.dims, self._shapes())
            return
        if isinstance(designs, Mapping):
            designs = {name: _array(part) for name, part in designs.items()}
        paths, tree = jax.tree_util.tree_flatten_with_path(designs)
        names: list[str] = []
        self.arrays = []
        for path, leaf in paths:
            name = path_name(path)
            array = np.asarray(leaf)
            if array.ndim < 1 or not np.issubdtype(array.dtype, np.number):
                raise ValueError(
                    f"`designs` has {name} of shape {array.shape} and type "
                    f"{array.dtype}, but it must have a number, or an array of them, for "
                    "each design along the first axis. What is the same for all belongs "
                    "in the study."
                )
            names.append(name)
            self.arrays.append(array)
        check_parameters(names)
        lengths = dict(zip(names, map(len, self.arrays), strict=True))
        if len(set(lengths.values())) != 1 or 0 in lengths.values():
            told = ", ".join(f"{count} of {name}" for name, count in lengths.items())
            raise ValueError(
                f"`designs` has {told or 'no array'}, but must have as many of each, and "
                "at least one. For all combinations take a `Grid`."
            )
        self.dims, self.shape = ("design",), (len(self.arrays[0]),)
        self.kind = Kind(tree, tuple(range(len(names))), tuple(names), self._shapes())

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters."""
        return self.kind.names

    def __len__(self) -> int:
        return math.prod(self.shape)

    def take(self, rows: np.ndarray) -> list[np.ndarray]:
        """The parameters of some designs, in the order of the names."""
        if not self._grid:
            return [array[rows] for array in self.arrays]
        places = np.unravel_index(rows, self.shape)
        return [row[place] for row, place in zip(self.arrays, places, strict=True)]

    def _shapes(self) -> tuple[tuple[tuple[int, ...], np.dtype], ...]:
        one = self.take(np.zeros(1, int))
        return tuple(
            (leaf.shape[1:], jax.dtypes.canonicalize_dtype(leaf.dtype)) for leaf in one
        )


def _array(part: Any) -> Any:
    """A list of numbers as an array; what else there is as it is."""
    listed = isinstance(part, list | tuple) and part and all(map(np.isscalar, part))
    return np.asarray(part) if listed else part
