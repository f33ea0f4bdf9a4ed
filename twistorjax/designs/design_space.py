"""Numbers of a design: variables with their bounds, and constants."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from .._utils.pytrees import entry_names, path_name, split_last_axis
from .._utils.types import NumbersLike
from .._utils.validation import quote
from .designs import Designs, DesignStructure
from .distributions import Normal
from .parameters import Parameter


class DesignSpace(NamedTuple):
    """All real numbers of a design as one vector, of which some are variables."""

    structure: DesignStructure
    arrays: list[np.ndarray]  # Value of each parameter, in the order of the structure
    rows: list[int]  # Rows of the real parameters in `arrays`
    names: tuple[str, ...]  # Name of each real number
    units: tuple[str, ...]  # Unit of each real number; empty if it is unknown
    is_variable: Bool[np.ndarray, " numbers"]  # Whether each number is a variable
    start: Float[np.ndarray, " numbers"]
    # Lower bound of each number; -inf if there is none
    lower: Float[np.ndarray, " numbers"]
    # Upper bound of each number; inf if there is none
    upper: Float[np.ndarray, " numbers"]
    # Typical change of each number, by which its changes are divided
    scales: Float[np.ndarray, " numbers"]
    # Standard deviation of each number; zero if it is certain
    deviations: Float[np.ndarray, " numbers"]

    @classmethod
    def from_tree(
        cls, parameters: Any, standard_deviations: Mapping[str, NumbersLike]
    ) -> "DesignSpace":
        """Collect the numbers of a design.

        Args:
            parameters: One design, as the study takes it. Each `Parameter` in it is a
                variable or, if there is none, each real number.
            standard_deviations: Standard deviation of each uncertain parameter, by name.

        Raises:
            ValueError: There is no variable; a standard deviation belongs to no real
                parameter, is negative, or has a wrong shape.
        """
        leaves = jax.tree_util.tree_leaves_with_path(parameters, is_leaf=_is_parameter)
        tree = jax.tree.map(_value, parameters, is_leaf=_is_parameter)
        if not any(_is_parameter(leaf) for _, leaf in leaves):
            leaves = [(path, _as_parameter(leaf)) for path, leaf in leaves]
        if not any(_is_parameter(leaf) for _, leaf in leaves):
            raise ValueError(
                f"`parameters` is {quote(parameters)}, but needs a variable: a "
                "`Parameter`, a float, or an array of floats."
            )
        real = {path_name(path): leaf for path, leaf in leaves if _is_real(_value(leaf))}
        deviations = _check_deviations(real, standard_deviations)
        designs = Designs(jax.tree.map(lambda leaf: np.asarray(leaf)[None], tree))
        names, units, entries = [], [], []
        for name, leaf in real.items():
            shape = np.shape(_value(leaf))
            names += entry_names(name, shape)
            units += [_unit(leaf, index) for index in np.ndindex(shape)]
            deviation = np.broadcast_to(deviations.get(name, 0.0), shape)
            entries.append([*_numbers(leaf), deviation])
        flags, start, lower, upper, scales, deviation = (
            np.concatenate([np.ravel(array) for array in arrays])
            for arrays in zip(*entries, strict=True)
        )
        return cls(
            structure=designs.structure,
            arrays=[array[0] for array in designs.arrays],
            rows=[designs.names.index(name) for name in real],
            names=tuple(names),
            units=tuple(units),
            is_variable=flags,
            start=start,
            lower=lower,
            upper=upper,
            scales=scales,
            deviations=deviation,
        )

    @property
    def is_robust(self) -> bool:
        """Whether a number is uncertain."""
        return bool(np.any(self.deviations))

    @property
    def real_names(self) -> tuple[str, ...]:
        """Names of the real parameters."""
        return tuple(self.structure.names[row] for row in self.rows)

    def program_input(
        self, vectors: Float[np.ndarray, "designs numbers"]
    ) -> list[np.ndarray]:
        """Return the array of each parameter, with one entry for each design."""
        shapes = [self.arrays[row].shape for row in self.rows]
        parts = dict(zip(self.rows, split_last_axis(vectors, shapes), strict=True))
        return [
            parts.get(row, np.broadcast_to(array, (len(vectors), *array.shape)))
            for row, array in enumerate(self.arrays)
        ]

    def tree(self, vector: Float[np.ndarray, " numbers"]) -> Any:
        """Return a design as the study takes it."""
        arrays = [array[0] for array in self.program_input(vector[None])]
        return jax.tree.unflatten(self.structure.tree, arrays)

    def vector_of(self, design: Any) -> Float[np.ndarray, " numbers"]:
        """Return the real numbers of a design."""
        leaves = jax.tree.leaves(design)
        real = [np.ravel(leaf) for leaf in leaves if _is_real(leaf)]
        return np.concatenate(real)

    def vectors(self, designs: Any) -> Float[np.ndarray, "designs numbers"]:
        """Convert designs to vectors.

        Args:
            designs: A tree of arrays, whose first axis has one entry for each design.

        Raises:
            ValueError: The tree has another structure than a design, the arrays have
                different lengths or shapes, or a number is outside its bounds.
        """
        given = Designs(designs)
        missing = sorted({*self.real_names} - {*given.names})
        if missing:
            raise ValueError(
                f"`starts` has {', '.join(map(repr, given.names))}, but needs also "
                f"{', '.join(map(repr, missing))}: all real parameters."
            )
        arrays = []
        for name, row in zip(self.real_names, self.rows, strict=True):
            array = given.arrays[given.names.index(name)]
            if array.shape[1:] != self.arrays[row].shape:
                raise ValueError(
                    f"`starts` has {quote(name)} of shape {array.shape}, but needs one "
                    f"entry of shape {self.arrays[row].shape} for each start."
                )
            arrays.append(array.reshape(len(given), -1).astype(float))
        vectors = np.concatenate(arrays, axis=1)
        inside = (self.lower <= vectors) & (vectors <= self.upper)
        if not np.all(inside):
            start, column = np.argwhere(~inside)[0]
            raise ValueError(
                f"`starts` has {self.names[column]} = {vectors[start, column]:g} in "
                f"design {start}, but it must be between {self.lower[column]:g} and "
                f"{self.upper[column]:g}."
            )
        return vectors

    def sampled(self, count: int, seed: int) -> Float[np.ndarray, "designs numbers"]:
        """Sample designs whose variables lie evenly between their bounds.

        Raises:
            ValueError: A variable lacks a bound.
        """
        from scipy.stats import qmc

        variables = self.is_variable
        lower, upper = self.lower[variables], self.upper[variables]
        unbounded = ~(np.isfinite(lower) & np.isfinite(upper))
        if np.any(unbounded):
            name = str(np.array(self.names)[variables][unbounded][0])
            raise ValueError(
                f"Random starts need bounds, but {quote(name)} lacks one. Use a "
                "`Parameter` with `lower` and `upper`, or give the designs as `starts`."
            )
        sampler = qmc.Sobol(int(variables.sum()), rng=seed)
        points = sampler.random_base2(max(0, count - 1).bit_length())[:count]
        vectors = np.repeat(self.start[None], count, axis=0)
        vectors[:, variables] = lower + (upper - lower) * points
        return vectors

    def normal_tree(self, vector: Float[np.ndarray, " numbers"]) -> Any:
        """Return a design with the normal distribution of each uncertain parameter."""
        arrays: list[Any] = [array[0] for array in self.program_input(vector[None])]
        shapes = [self.arrays[row].shape for row in self.rows]
        deviations = split_last_axis(self.deviations[None], shapes)
        for row, deviation in zip(self.rows, deviations, strict=True):
            if np.any(deviation):
                arrays[row] = Normal(arrays[row], deviation[0])
        return jax.tree.unflatten(self.structure.tree, arrays)


def _is_parameter(leaf: Any) -> bool:
    return isinstance(leaf, Parameter)


def _value(leaf: Any) -> Any:
    """Value of a leaf of a design."""
    return np.asarray(leaf.value) if _is_parameter(leaf) else leaf


def _is_real(value: Any) -> bool:
    return np.issubdtype(np.asarray(value).dtype, np.floating)


def _as_parameter(leaf: Any) -> Any:
    """Return a variable for a leaf of real numbers, and other leaves unchanged."""
    return Parameter(leaf) if _is_real(leaf) else leaf


def _unit(leaf: Any, index: tuple[int, ...]) -> str:
    """Unit of an entry of a leaf; empty if it is unknown."""
    if not _is_parameter(leaf):
        return ""
    return leaf.unit if isinstance(leaf.unit, str) else leaf.unit[index[-1]]


def _numbers(leaf: Any) -> list[Any]:
    """Flags, start values, lower bounds, upper bounds, and scales of a leaf."""
    value = np.asarray(_value(leaf), float)
    full = np.ones_like(value)
    if not _is_parameter(leaf):
        return [0 * full > 1, value, -np.inf * full, np.inf * full, full]
    lower = -np.inf if leaf.lower is None else leaf.lower
    upper = np.inf if leaf.upper is None else leaf.upper
    size = np.abs(value)
    size = np.where(size > 0, size, np.max(size, initial=0.0))
    scale = np.minimum(np.where(size > 0, size, np.inf), upper - lower)
    if leaf.scale is not None:
        scale = np.asarray(leaf.scale)
    scale = np.where(np.isfinite(scale), scale, 1.0)
    return [full > 0, value, lower * full, upper * full, scale * full]


def _check_deviations(
    real: Mapping[str, Any], standard_deviations: Mapping[str, NumbersLike]
) -> dict[str, np.ndarray]:
    """Return the standard deviation of each entry of the uncertain parameters."""
    deviations = {}
    for name, given in standard_deviations.items():
        if name not in real:
            raise ValueError(
                f"`standard_deviations` has {quote(name)}, but the real parameters are "
                f"{', '.join(map(repr, real))}."
            )
        shape = np.shape(_value(real[name]))
        deviation = np.asarray(given, float)
        if deviation.shape not in ((), shape):
            raise ValueError(
                f"`standard_deviations[{quote(name)}]` has shape {deviation.shape}, but "
                f"must be one number, or have the shape {shape} of the parameter."
            )
        if not np.all((deviation >= 0) & np.isfinite(deviation)):
            raise ValueError(
                f"`standard_deviations[{quote(name)}]` is {deviation.tolist()}, but must "
                "be finite and not negative."
            )
        deviations[name] = np.broadcast_to(deviation, shape)
    if standard_deviations and not any(np.any(each) for each in deviations.values()):
        raise ValueError(
            "All `standard_deviations` are zero. Leave them out if all parameters are "
            "certain."
        )
    return deviations
