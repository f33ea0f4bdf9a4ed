"""Parameters to identify: numbers of a design, with units and bounds.

The optimization works with dimensionless *normalized parameters*. They are zero at the
initial values. A small normalized parameter is the relative change of its value or, if
the parameter has a bound, of its distance to the bound. All real numbers are mapped to
values between the bounds, so the optimization itself has no constraints.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .._utils.compilation import fast_compile
from .._utils.host import concrete
from .._utils.pytrees import entry_names, path_name
from .._utils.types import ArrayOfNumbers, Numbers


class Parameter(eqx.Module):
    """Number or array that is identified from measurements, or optimized.

    Args:
        value: Initial value, between the bounds.
        unit: Unit of the value, for printing. An array has one unit, or one for each
            entry of its last axis.
        lower: Lower bound, which `identify` excludes and `optimize` includes. Give 0 for
            stiffnesses and lengths that are identified.
        upper: Upper bound, as the lower one.
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
        self.lower = None if lower is None or lower == -np.inf else float(lower)
        self.upper = None if upper is None or upper == np.inf else float(upper)
        self.scale = None if scale is None else jnp.asarray(scale, float)
        for name, bound in (("lower", self.lower), ("upper", self.upper)):
            if bound is not None and not np.isfinite(bound):
                raise ValueError(
                    f"`{name}` of a `Parameter` is {bound!r}, but must be a number. "
                    "Leave out a bound that does not exist."
                )
        lower, upper = self.lower, self.upper
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
        change = concrete(self.initial_scale())
        if change is not None and not np.all((change > 0) & np.isfinite(change)):
            raise ValueError(
                "A `Parameter` without bounds has the value 0, so the size of a typical "
                "change is not known: give it as `scale`."
            )

    def initial_scale(self) -> Numbers:
        """Derivative of the value with respect to the normalized parameter, at zero.

        Returns:
            The derivative, in the unit of the parameter.
        """
        if self.lower is not None or self.upper is not None:
            zeros, ones = jnp.zeros_like(self.value), jnp.ones_like(self.value)
            return jax.jvp(self.value_at, (zeros,), (ones,))[1]
        if self.scale is not None:
            return jnp.broadcast_to(self.scale, self.value.shape)
        magnitude = jnp.abs(self.value)
        return jnp.where(magnitude > 0, magnitude, jnp.max(magnitude))

    def value_at(self, normalized: Numbers) -> Numbers:
        """Compute the value from the normalized parameter.

        Args:
            normalized: Normalized parameter; zero gives the initial value.

        Returns:
            The value, which lies between the bounds; in the unit of the parameter.
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
    """All parameters of a design function, in the form of one vector.

    Args:
        parameters: The argument of the design function, with a `Parameter` in place of
            each identified leaf and None in place of the others.
        constants: The same pytree with the other leaves only.
        names: Names of the entries of the vector.
        units: Units of the entries of the vector.
        bounded: Names of the entries that have a bound.
    """

    parameters: Any
    constants: Any
    names: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)
    bounded: frozenset[str] = eqx.field(static=True)

    @classmethod
    def from_tree(cls, start: Any) -> "ParameterSet":
        """Collect the parameters of a pytree.

        Args:
            start: Argument of a design function. Each `Parameter` in it is identified or,
                if there is none, each number.

        Returns:
            The parameters.

        Raises:
            ValueError: The pytree contains neither parameters nor numbers.
        """
        has_parameters = any(
            map(_is_parameter, jax.tree.leaves(start, is_leaf=_is_parameter))
        )
        is_identified = _is_parameter if has_parameters else _is_number
        parameters, constants = eqx.partition(start, is_identified, is_leaf=_is_parameter)
        if not has_parameters:
            parameters = jax.tree.map(Parameter, parameters)
        leaves = jax.tree_util.tree_leaves_with_path(parameters, is_leaf=_is_parameter)
        names, units, bounded = [], [], []
        for path, parameter in leaves:
            entries = entry_names(path_name(path), parameter.value.shape)
            names += entries
            for index in np.ndindex(parameter.value.shape):
                unit = parameter.unit
                units.append(unit if isinstance(unit, str) else unit[index[-1]])
            if parameter.lower is not None or parameter.upper is not None:
                bounded += entries
        if not names:
            raise ValueError(
                f"`start` is {start!r}, but must have a parameter to identify: floats, "
                "arrays of them, or `Parameter`s."
            )
        return cls(parameters, constants, tuple(names), tuple(units), frozenset(bounded))

    @fast_compile
    def vector(
        self, normalized: Float[Array, " parameters"]
    ) -> Float[Array, " parameters"]:
        """Values of the parameters as a vector, in their units."""
        return ravel_pytree(self._values(normalized))[0]

    def tree(self, normalized: Float[Array, " parameters"]) -> Any:
        """Argument of the design function: values of the parameters, and constants."""
        return eqx.combine(self._values(normalized), self.constants)

    def unflatten(self, vector: Float[Array, " parameters"]) -> Any:
        """Arrange one number for each parameter in a pytree.

        Args:
            vector: Number for each parameter, for example its standard error.

        Returns:
            A pytree with the structure of `start`; None in place of the constants.
        """
        values = jax.tree.map(
            lambda parameter: parameter.value, self.parameters, is_leaf=_is_parameter
        )
        return ravel_pytree(values)[1](vector)

    @fast_compile
    def scales(
        self, normalized: Float[Array, " parameters"]
    ) -> Float[Array, " parameters"]:
        """Reference sizes with respect to which changes of the values are relative.

        Returns:
            For a parameter with a bound, the distance to the bound; otherwise the larger
            one of the absolute value and the initial scale; in their units.
        """
        is_free = jnp.asarray([name not in self.bounded for name in self.names])
        derivatives = jnp.abs(self.derivatives(normalized))
        largest = jnp.maximum(derivatives, jnp.abs(self.vector(normalized)))
        return jnp.where(is_free, largest, derivatives)

    @fast_compile
    def derivatives(
        self, normalized: Float[Array, " parameters"]
    ) -> Float[Array, " parameters"]:
        """Derivative of each value with respect to its normalized parameter."""
        return jax.jvp(self.vector, (normalized,), (jnp.ones_like(normalized),))[1]

    def _values(self, normalized: Float[Array, " parameters"]) -> Any:
        """Values of the parameters in their pytree, in their units."""
        return jax.tree.map(
            Parameter.value_at,
            self.parameters,
            self.unflatten(normalized),
            is_leaf=_is_parameter,
        )


def _is_parameter(leaf: Any) -> bool:
    return isinstance(leaf, Parameter)


def _is_number(leaf: Any) -> bool:
    """Whether a leaf is a number or an array of real numbers.

    Integers are accepted, because users write 80 for 80.0.
    """
    if isinstance(leaf, int) and not isinstance(leaf, bool):
        return True
    return eqx.is_inexact_array_like(leaf)
