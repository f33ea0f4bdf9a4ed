"""Parameters to identify: numbers of a design, with units and bounds.

The optimization works with dimensionless *normalized parameters*. They are zero at the
initial values. A small normalized parameter is the relative change of its value or, if
the parameter has a bound, of its distance to the bound. All real numbers are mapped to
values between the bounds, so the optimization itself has no constraints.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.pytrees import entry_names, path_name
from .._utils.types import ArrayOfNumbers, Numbers
from .._utils.validation import concrete


class Parameter(eqx.Module):
    """Number or array that is identified from measurements.

    Args:
        value: Initial value.
        unit: Unit of the value, for printing. An array has one unit, or one for each
            entry of its last axis.
        lower: Lower bound; the value always exceeds it. Stiffnesses and lengths have the
            lower bound 0.
        upper: Upper bound; the value is always smaller.
        scale: Size of a typical change of a parameter without bounds. The default is the
            absolute value of `value`, and for a zero in an array the largest absolute
            value of the array. The scale of a parameter with a bound is its distance to
            the bound.

    Raises:
        ValueError: The value is not finite or not between the bounds; the value is zero
            and there is neither a bound nor a scale; both a bound and a scale are given.

    Example:
        >>> Parameter(250e-6, "m", lower=0)
        Parameter(0.00025 m, above 0)
    """

    value: Numbers
    unit: str | tuple[str, ...] = eqx.field(static=True)
    lower: float | None = eqx.field(static=True)
    upper: float | None = eqx.field(static=True)
    scale: Numbers | None

    def __init__(
        self,
        value: ArrayOfNumbers,
        unit: str | Sequence[str] = "",
        *,
        lower: float | int | None = None,
        upper: float | int | None = None,
        scale: ArrayOfNumbers | None = None,
    ):
        self.value = jnp.asarray(value, float)
        self.unit = unit if isinstance(unit, str) else tuple(unit)
        shape = self.value.shape
        if not isinstance(unit, str) and (not shape or len(unit) != shape[-1]):
            raise ValueError(
                f"`unit` has {len(unit)} entries, but the `Parameter` has shape {shape}: "
                "give one unit, or one for each entry of the last axis."
            )
        self.lower = None if lower is None else float(lower)
        self.upper = None if upper is None else float(upper)
        self.scale = None if scale is None else jnp.asarray(scale, float)
        if self.scale is not None and (lower is not None or upper is not None):
            raise ValueError(
                "A `Parameter` has both a bound and a `scale`, but the scale of a "
                "bounded parameter is its distance to the bound: leave out `scale`."
            )
        initial = concrete(self.value)
        if initial is None:
            return
        if not np.all(np.isfinite(initial)):
            raise ValueError(
                f"The value of a `Parameter` is {initial.tolist()}, but must be finite."
            )
        if lower is not None and upper is not None and not lower < upper:
            raise ValueError(
                f"`lower` is {lower:g} and `upper` is {upper:g}, but `lower` must be "
                "smaller: are the bounds exchanged?"
            )
        low = -np.inf if self.lower is None else self.lower
        high = np.inf if self.upper is None else self.upper
        if not np.all((low < initial) & (initial < high)):
            raise ValueError(
                f"The value of a `Parameter` is {initial.tolist()}, but must be"
                f"{self._bounds()}."
            )
        size = concrete(self.initial_scale())
        if size is not None and not np.all((size > 0) & np.isfinite(size)):
            raise ValueError(
                "A `Parameter` without bounds has the value 0, so the size of a typical "
                "change is not known: give it as `scale`."
            )

    def initial_scale(self) -> Numbers:
        """Derivative of the value with respect to the normalized parameter, at zero.

        Returns:
            The derivative, in the unit of the parameter.
        """
        if self.lower is not None and self.upper is not None:
            fraction = (self.value - self.lower) / (self.upper - self.lower)
            return (self.upper - self.lower) * fraction * (1 - fraction)
        if self.lower is not None:
            return self.value - self.lower
        if self.upper is not None:
            return self.upper - self.value
        if self.scale is None:
            size = jnp.abs(self.value)
            return jnp.where(size > 0, size, jnp.max(size))
        return jnp.broadcast_to(self.scale, self.value.shape)

    def value_at(self, normalized: Numbers) -> Numbers:
        """Compute the value from the normalized parameter.

        Args:
            normalized: Normalized parameter; zero gives the initial value.

        Returns:
            The value, which lies between the bounds, in the unit of the parameter.
        """
        if self.lower is not None and self.upper is not None:
            fraction = (self.value - self.lower) / (self.upper - self.lower)
            logit = jnp.log(fraction / (1 - fraction))
            span = self.upper - self.lower
            return self.lower + span * jax.nn.sigmoid(logit + normalized)
        if self.lower is not None:
            return self.lower + (self.value - self.lower) * jnp.exp(normalized)
        if self.upper is not None:
            return self.upper - (self.upper - self.value) * jnp.exp(-normalized)
        return self.value + self.initial_scale() * normalized

    def _bounds(self) -> str:
        """Text of the bounds, which starts with a space; empty if there is none."""
        texts = [
            f" {side} {bound:g}"
            for side, bound in (("above", self.lower), ("below", self.upper))
            if bound is not None
        ]
        return " and".join(texts)

    def __repr__(self) -> str:
        initial = concrete(self.value)
        if initial is None:
            return eqx.tree_pformat(self)
        units = self.unit if isinstance(self.unit, str) else ", ".join(self.unit)
        unit = f" {units}" if units else ""
        bounds = self._bounds()
        comma = "," if bounds else ""
        value = np.array2string(initial, precision=6)
        return f"Parameter({value}{unit}{comma}{bounds})"


class ParameterSet(eqx.Module):
    """All parameters of a design, in the form of one vector.

    Args:
        parameters: Parameters, in the order of the vector.
        constants: Leaves of the tree that are not identified; None in the positions of
            the parameters.
        structure: Structure of the tree that the design takes.
        names: Names of the entries of the vector.
        units: Units of the entries of the vector.
    """

    parameters: tuple[Parameter, ...]
    constants: Any
    structure: Any = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)

    @property
    def bounded(self) -> frozenset[str]:
        """Names of the entries that have a bound."""
        return frozenset(
            name
            for parameter, names in zip(
                self.parameters, self._split(self.names), strict=True
            )
            for name in names
            if parameter.lower is not None or parameter.upper is not None
        )

    @classmethod
    def from_tree(cls, start: Any) -> "ParameterSet":
        """Collect the parameters of a tree.

        Args:
            start: Tree that a design takes. Each `Parameter` in it is identified or, if
                there is none, each number.

        Returns:
            The parameters of the tree.

        Raises:
            ValueError: The tree contains neither parameters nor numbers.
        """
        leaves, structure = jax.tree_util.tree_flatten_with_path(
            start, is_leaf=_is_parameter
        )
        has_parameters = any(_is_parameter(leaf) for _, leaf in leaves)
        is_identified = _is_parameter if has_parameters else _is_number
        parameters, constants, names, units = [], [], [], []
        for path, leaf in leaves:
            if not is_identified(leaf):
                constants.append(leaf)
                continue
            parameter = leaf if _is_parameter(leaf) else Parameter(leaf)
            constants.append(None)
            parameters.append(parameter)
            names += entry_names(path_name(path), parameter.value.shape)
            for index in np.ndindex(parameter.value.shape):
                unit = parameter.unit
                units.append(unit if isinstance(unit, str) else unit[index[-1]])
        if not parameters:
            raise ValueError(
                f"`start` is {start!r}, but must have a parameter to identify: floats, "
                "arrays of them, or `Parameter`s."
            )
        return cls(
            tuple(parameters), tuple(constants), structure, tuple(names), tuple(units)
        )

    def vector(
        self, normalized: Float[Array, " parameters"]
    ) -> Float[Array, " parameters"]:
        """Values of the parameters as a vector, in their units."""
        return jnp.concatenate([jnp.ravel(value) for value in self._values(normalized)])

    def tree(self, normalized: Float[Array, " parameters"]) -> Any:
        """Values of the parameters and the constants, in the tree that the design takes.

        Args:
            normalized: Normalized parameters.
        """
        values = iter(self._values(normalized))
        leaves = [next(values) if leaf is None else leaf for leaf in self.constants]
        return jax.tree.unflatten(self.structure, leaves)

    def unflatten(self, vector: Float[Array, " parameters"]) -> Any:
        """Arrange one number for each parameter in the tree that the design takes.

        Args:
            vector: Number for each parameter, for example its standard error.

        Returns:
            The tree; None in the positions of the constants.
        """
        parts = zip(self.parameters, self._split(vector), strict=True)
        shaped = (part.reshape(parameter.value.shape) for parameter, part in parts)
        leaves = [next(shaped) if leaf is None else None for leaf in self.constants]
        return jax.tree.unflatten(self.structure, leaves)

    def scales(
        self, normalized: Float[Array, " parameters"]
    ) -> Float[Array, " parameters"]:
        """Reference sizes with respect to which changes of the values are relative.

        Args:
            normalized: Normalized parameters.

        Returns:
            For a parameter with a bound, the distance to the bound; otherwise the larger
            one of the absolute value and the initial scale; in their units.
        """
        names, bounded = self.names, self.bounded
        free = jnp.asarray([name not in bounded for name in names])
        derivatives = jnp.abs(self.derivatives(normalized))
        sizes = jnp.maximum(derivatives, jnp.abs(self.vector(normalized)))
        return jnp.where(free, sizes, derivatives)

    def derivatives(
        self, normalized: Float[Array, " parameters"]
    ) -> Float[Array, " parameters"]:
        """Derivative of each value with respect to its normalized parameter."""
        return jax.jvp(self.vector, (normalized,), (jnp.ones_like(normalized),))[1]

    def _values(self, normalized: Float[Array, " parameters"]) -> list[Array]:
        parts = zip(self.parameters, self._split(normalized), strict=True)
        return [
            parameter.value_at(part.reshape(parameter.value.shape))
            for parameter, part in parts
        ]

    def _split(self, vector: Any) -> list[Any]:
        """Split a vector into the entries of each parameter."""
        sizes = [parameter.value.size for parameter in self.parameters]
        ends = np.cumsum([0, *sizes])
        return [vector[start:end] for start, end in pairwise(ends)]


def _is_parameter(leaf: Any) -> bool:
    return isinstance(leaf, Parameter)


def _is_number(leaf: Any) -> bool:
    """Whether a leaf is a number or an array of real numbers.

    Integers are accepted, because users write 80 for 80.0.
    """
    if isinstance(leaf, int) and not isinstance(leaf, bool):
        return True
    return eqx.is_inexact_array_like(leaf)
