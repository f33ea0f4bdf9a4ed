"""Numbers of a design: variables with their bounds, and constants."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from .._utils.pytrees import path_name
from .._utils.types import NumbersLike
from .._utils.validation import quote
from .designs import Designs, DesignStructure
from .distributions import Normal
from .parameters import as_parameters, is_parameter, parameter_bounds, parameter_units
from .vector_layout import VectorLayout


class DesignSpace(NamedTuple):
    """All real numbers of a design as one vector, of which some are variables."""

    structure: DesignStructure
    layout: VectorLayout  # Real parameters as a vector, and the other ones
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
        """Collect the numbers of one design, as the study takes it.

        Each `Parameter` in it is a variable or, if there is none, each real number. The
        standard deviations are those of the uncertain parameters.
        """
        layout, leaves = VectorLayout.of(
            as_parameters(parameters, _is_real),
            lambda leaf: is_parameter(leaf) or _is_real(leaf),
            lambda leaf: np.shape(_value(leaf)),
        )
        if not any(map(is_parameter, leaves)):
            raise ValueError(
                f"`parameters` is {quote(parameters)}, but needs a variable: a "
                "`Parameter`, a float, or an array of floats."
            )
        shapes = dict(zip(layout.names, layout.shapes, strict=True))
        deviations = _check_deviations(shapes, standard_deviations)
        flags, start, lower, upper, scales = (
            np.concatenate([np.ravel(array) for array in column])
            for column in zip(*map(_numbers, leaves), strict=True)
        )
        return cls(
            structure=Designs(layout.designs(start[None])).structure,
            layout=layout,
            names=layout.entry_names,
            units=tuple(unit for leaf in leaves for unit in _units(leaf)),
            is_variable=flags,
            start=start,
            lower=lower,
            upper=upper,
            scales=scales,
            deviations=np.concatenate([np.ravel(each) for each in deviations.values()]),
        )

    @property
    def is_robust(self) -> bool:
        """Whether a number is uncertain."""
        return bool(np.any(self.deviations))

    def program_input(
        self, vectors: Float[np.ndarray, "designs numbers"]
    ) -> list[np.ndarray]:
        """Return the array of each parameter, with one entry for each design."""
        return jax.tree.leaves(self.layout.designs(vectors))

    def tree(self, vector: Float[np.ndarray, " numbers"]) -> Any:
        """Return a design as the study takes it."""
        return jax.tree.map(lambda array: array[0], self.layout.designs(vector[None]))

    def vector_of(self, design: Any) -> Float[np.ndarray, " numbers"]:
        """Return the real numbers of a design."""
        leaves = jax.tree.leaves(design)
        real = [np.ravel(leaf) for leaf in leaves if _is_real(leaf)]
        return np.concatenate(real)

    def vectors(self, designs: Any) -> Float[np.ndarray, "designs numbers"]:
        """Convert designs to vectors, and check them.

        The first axis of each array has one entry for each design.
        """
        given = Designs(designs)
        missing = sorted({*self.layout.names} - {*given.names})
        if missing:
            raise ValueError(
                f"`starts` has {', '.join(map(repr, given.names))}, but needs also "
                f"{', '.join(map(repr, missing))}: all real parameters."
            )
        arrays = []
        for name, shape in zip(self.layout.names, self.layout.shapes, strict=True):
            array = given.arrays[given.names.index(name)]
            if array.shape[1:] != shape:
                raise ValueError(
                    f"`starts` has {quote(name)} of shape {array.shape}, but needs one "
                    f"entry of shape {shape} for each start."
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
        """Sample designs whose variables lie evenly between their bounds."""
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

    def normal_tree(self) -> Any:
        """Return the start with the normal distribution of each uncertain parameter."""
        parts = self.layout.split(self.deviations)
        deviations = dict(zip(self.layout.names, parts, strict=True))

        def distribution(path: Any, value: Any) -> Any:
            deviation = deviations.get(path_name(path), 0.0)
            return Normal(value, deviation) if np.any(deviation) else value

        return jax.tree_util.tree_map_with_path(distribution, self.tree(self.start))


def _value(leaf: Any) -> Any:
    return np.asarray(leaf.value) if is_parameter(leaf) else leaf


def _is_real(leaf: Any) -> bool:
    return eqx.is_inexact_array_like(leaf) and not np.iscomplexobj(leaf)


def _units(leaf: Any) -> list[str]:
    """Unit of each entry of a leaf; empty if it is unknown."""
    return parameter_units(leaf) if is_parameter(leaf) else np.size(leaf) * [""]


def _numbers(leaf: Any) -> list[Any]:
    """Flags, start values, lower bounds, upper bounds, and scales of a leaf."""
    value = np.asarray(_value(leaf), float)
    full = np.ones_like(value)
    if not is_parameter(leaf):
        return [0 * full > 1, value, -np.inf * full, np.inf * full, full]
    lower, upper = parameter_bounds(leaf)
    size = np.abs(value)
    size = np.where(size > 0, size, np.max(size, initial=0.0))
    scale = np.minimum(np.where(size > 0, size, np.inf), upper - lower)
    if leaf.scale is not None:
        scale = np.asarray(leaf.scale)
    scale = np.where(np.isfinite(scale), scale, 1.0)
    return [full > 0, value, lower * full, upper * full, scale * full]


def _check_deviations(
    shapes: Mapping[str, tuple[int, ...]], standard_deviations: Mapping[str, NumbersLike]
) -> dict[str, np.ndarray]:
    """Return the standard deviation of each entry of the real parameters."""
    deviations = {name: np.zeros(shape) for name, shape in shapes.items()}
    for name, given in standard_deviations.items():
        if name not in shapes:
            raise ValueError(
                f"`standard_deviations` has {quote(name)}, but the real parameters are "
                f"{', '.join(map(repr, shapes))}."
            )
        shape = shapes[name]
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
