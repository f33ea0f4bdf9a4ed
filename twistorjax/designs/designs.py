"""Designs of a sweep: the parameter values for which a study is evaluated."""

import math
import sys
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Num
from typing_extensions import TypeAliasType

from .._utils.pytrees import path_name
from .._utils.validation import quote
from .names import check_parameter_names


# Values of one parameter, in its SI unit
GridValues = TypeAliasType(
    "GridValues", Num[ArrayLike, " values"] | Sequence[float | int]
)


class Grid:
    """All combinations of given values of each parameter.

    Args:
        values: One-dimensional array of values for each parameter, by name. The last
            parameter changes fastest.

    Raises:
        ValueError: There is no parameter, the values of a parameter are not a
            one-dimensional array of numbers, or a parameter has a reserved name.

    Example:
        >>> Grid({"length": [5e-3, 10e-3], "thickness": [0.2e-3, 0.4e-3, 0.6e-3]})
        Grid of 6 designs: 2 of length, 3 of thickness
    """

    values: dict[str, np.ndarray]

    def __init__(self, values: Mapping[str, GridValues]):
        self.values = {name: np.asarray(array) for name, array in values.items()}
        if not self.values:
            raise ValueError(
                "`values` is empty, but a grid needs at least one parameter."
            )
        check_parameter_names(tuple(self.values))
        for name, array in self.values.items():
            numeric = np.issubdtype(array.dtype, np.number)
            if array.ndim != 1 or not array.size or not numeric:
                raise ValueError(
                    f"`values[{quote(name)}]` has shape {array.shape} and type "
                    f"{array.dtype}, but must be a one-dimensional array of numbers."
                )
            # Outputs can be differentiated with respect to floats only.
            if np.issubdtype(array.dtype, np.integer):
                self.values[name] = array.astype(float)

    def __repr__(self) -> str:
        parts = (f"{array.size} of {name}" for name, array in self.values.items())
        total = math.prod(array.size for array in self.values.values())
        return f"Grid of {total:,} designs: {', '.join(parts)}"


class DesignStructure(NamedTuple):
    """Structure of one design; designs of the same structure share a compiled program."""

    tree: Any  # Structure of the pytree of a design, as the study takes it
    order: tuple[int, ...]  # Index of the parameter of each leaf of the pytree
    names: tuple[str, ...]  # Names of the parameters
    # Shape and number type of each parameter for one design
    shapes: tuple[tuple[tuple[int, ...], np.dtype], ...]

    def design(self, parameters: Sequence[Array]) -> Any:
        """Assemble the pytree of one design from its parameters, in their order."""
        leaves = [jnp.asarray(parameters[index]) for index in self.order]
        return jax.tree.unflatten(self.tree, leaves)


class Designs:
    """Designs of a sweep, numbered consecutively.

    They are a `Grid`, or a tree of arrays, such as a mapping from names to arrays. The
    first axis of each array has one entry for each design.
    """

    structure: DesignStructure
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    arrays: list[np.ndarray]

    def __init__(self, designs: Any):
        self._is_grid = isinstance(designs, Grid)
        if isinstance(designs, Grid):
            self.dims = tuple(designs.values)
            self.arrays = list(designs.values.values())
            self.shape = tuple(array.size for array in self.arrays)
            if (count := math.prod(self.shape)) > sys.maxsize:
                raise ValueError(
                    f"`designs` is a grid of {count:.3g} designs, but at most "
                    f"{sys.maxsize:.3g} are possible. Use fewer values, or split the "
                    "grid into several sweeps."
                )
            # JAX sorts the leaves of a mapping by name.
            order = tuple(self.dims.index(name) for name in sorted(self.dims))
            tree = jax.tree.structure(designs.values)
            self.structure = DesignStructure(tree, order, self.dims, self._shapes())
            return
        if isinstance(designs, Mapping):
            designs = {name: _as_array(value) for name, value in designs.items()}
        paths, tree = jax.tree_util.tree_flatten_with_path(designs)
        names: list[str] = []
        self.arrays = []
        for path, leaf in paths:
            name = path_name(path)
            array = np.asarray(leaf)
            if array.ndim < 1 or not np.issubdtype(array.dtype, np.number):
                raise ValueError(
                    f"`designs` has the parameter {quote(name)} of shape {array.shape} "
                    f"and type {array.dtype}, but each parameter needs a number, or an "
                    "array of numbers, for each design along the first axis. Constants "
                    "belong in the study."
                )
            names.append(name)
            self.arrays.append(array)
        check_parameter_names(names)
        lengths = dict(zip(names, map(len, self.arrays), strict=True))
        if len(set(lengths.values())) != 1 or 0 in lengths.values():
            counts = ", ".join(f"{count} of {name}" for name, count in lengths.items())
            raise ValueError(
                f"`designs` has {counts or 'no array'}, but needs the same number of "
                "values of each parameter, and at least one. Use a `Grid` for all "
                "combinations."
            )
        self.dims, self.shape = ("design",), (len(self.arrays[0]),)
        order = tuple(range(len(names)))
        self.structure = DesignStructure(tree, order, tuple(names), self._shapes())

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.structure.names

    def __len__(self) -> int:
        return math.prod(self.shape)

    def rows(self, start: int, stop: int) -> list[np.ndarray]:
        """Return the parameters of consecutive designs, in their order.

        Designs after the last one are copies of it.
        """
        if not self._is_grid and stop <= len(self):
            return [array[start:stop] for array in self.arrays]
        indices = np.minimum(np.arange(start, stop), len(self) - 1)
        if not self._is_grid:
            return [array[indices] for array in self.arrays]
        grid_indices = np.unravel_index(indices, self.shape)
        return [a[index] for a, index in zip(self.arrays, grid_indices, strict=True)]

    def _shapes(self) -> tuple[tuple[tuple[int, ...], np.dtype], ...]:
        """Determine the shape and number type of each parameter for one design."""
        return tuple(
            (array.shape[1:], jax.dtypes.canonicalize_dtype(array.dtype))
            for array in self.rows(0, 1)
        )


def grid_chunk(shape: Sequence[int], size: int) -> tuple[int, ...] | None:
    """Return the shape of the block of a grid that holds `size` consecutive designs.

    The last block may have fewer. The shape is None if so many are not a block.
    """
    inner = [math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
    axis = next(axis for axis, count in enumerate(inner) if count <= size)
    count = min(size // inner[axis], shape[axis])
    is_block = size == count * inner[axis] and (axis == 0 or shape[axis] % count == 0)
    if not is_block and size < math.prod(shape):
        return None
    return (*axis * (1,), count, *shape[axis + 1 :])


def grid_chunk_size(shape: Sequence[int], size: int) -> int:
    """Reduce the size of chunks so that they are blocks of a grid; see `grid_chunk`.

    The size stays as it is if it would have to be reduced to less than half.
    """
    sizes = range(size, (size - 1) // 2, -1)
    return next((smaller for smaller in sizes if grid_chunk(shape, smaller)), size)


def _as_array(value: Any) -> Any:
    """Convert a list or tuple of numbers to an array; return anything else unchanged."""
    is_list = isinstance(value, list | tuple) and value and all(map(np.isscalar, value))
    return np.asarray(value) if is_list else value
