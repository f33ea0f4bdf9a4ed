"""Parameters to identify: numbers of a design, with units and bounds.

The optimization works with dimensionless *normalized parameters*. They are zero at the
initial values. A small normalized parameter is the relative change of its value or, if
the parameter has a bound, of its distance to the bound. All real numbers are mapped to
values between the bounds, so the optimization itself has no constraints.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from .._utils.host import as_float, concrete, on_host
from .._utils.types import ArrayOfNumbers, Numbers
from .vector_layout import VectorLayout


class Parameter(eqx.Module):
    """Number or array that is identified from measurements, or optimized.

    Args:
        value: Initial value, between the bounds, or at one of them in `optimize` and
            `explore`.
        unit: Unit of the value, for printing only; no value is converted. An array has
            one unit, or one for each entry of its last axis.
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
        self.value = as_float(value)
        self.unit = unit if isinstance(unit, str) else tuple(unit)
        shape = self.value.shape
        if not isinstance(unit, str) and (not shape or len(unit) != shape[-1]):
            raise ValueError(
                f"`unit` has {len(unit)} entries, but the `Parameter` has shape {shape}: "
                "give one unit, or one for each entry of the last axis."
            )
        self.lower = None if lower is None or lower == -np.inf else float(lower)
        self.upper = None if upper is None or upper == np.inf else float(upper)
        self.scale = None if scale is None else as_float(scale)
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
        low, high = parameter_bounds(self)
        if not np.all((low <= initial) & (initial <= high)):
            raise ValueError(
                f"The value of a `Parameter` is {initial.tolist()}, but must not be"
                f"{self._bounds(' or', ('below', 'above'))}."
            )
        if lower is not None or upper is not None:
            return
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
        return self.slope_at(as_float(np.zeros(self.value.shape)))

    def value_at(self, normalized: Numbers) -> Numbers:
        """Compute the value from the normalized parameter.

        Args:
            normalized: Normalized parameter; zero gives the initial value.

        Returns:
            The value, which lies between the bounds; in the unit of the parameter.
        """
        return as_float(self._value_and_slope(normalized)[0])

    def slope_at(self, normalized: Numbers) -> Numbers:
        """Differentiate the value with respect to the normalized parameter.

        Args:
            normalized: Normalized parameter.

        Returns:
            The derivative, in the unit of the parameter.
        """
        return as_float(self._value_and_slope(normalized)[1])

    def _value_and_slope(
        self, normalized: Numbers
    ) -> tuple[ArrayOfNumbers, ArrayOfNumbers]:
        """Compute the value and its derivative, both in the unit of the parameter."""
        scale = self.value if self.scale is None else self.scale
        xp, (value, scale, change) = on_host(self.value, scale, normalized)
        lower, upper = self.lower, self.upper
        if lower is not None and upper is not None:
            position = xp.log((value - lower) / (upper - value)) + change
            # the logistic function of the position, and of its negative
            below = xp.exp(-xp.logaddexp(0.0, -position))
            above = xp.exp(-xp.logaddexp(0.0, position))
            span = upper - lower
            return lower + span * below, span * below * above
        if lower is not None:
            slope = (value - lower) * xp.exp(change)
            return lower + slope, slope
        if upper is not None:
            slope = (upper - value) * xp.exp(-change)
            return upper - slope, slope
        if self.scale is None:
            size = xp.abs(value)
            scale = xp.where(size > 0, size, xp.max(size))
        return value + scale * change, xp.broadcast_to(scale, value.shape)

    def _bounds(
        self, word: str = " and", sides: tuple[str, str] = ("above", "below")
    ) -> str:
        """Text of the bounds, which starts with a space; empty if there is none."""
        texts = [
            f" {side} {bound:g}"
            for side, bound in zip(sides, (self.lower, self.upper), strict=True)
            if bound is not None
        ]
        return word.join(texts)

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
    """All parameters of a design function, in the form of one vector."""

    parameters: list[Parameter]
    layout: VectorLayout
    names: tuple[str, ...] = eqx.field(static=True)  # Names of the entries of the vector
    units: tuple[str, ...] = eqx.field(static=True)  # Units of the entries of the vector

    @classmethod
    def from_tree(cls, start: Any) -> "ParameterSet":
        """Collect the parameters of the argument of a design function.

        Each `Parameter` in it is identified or, if there is none, each number.
        """
        layout, parameters = VectorLayout.of(
            as_parameters(start, _is_number), is_parameter, lambda leaf: leaf.value.shape
        )
        names = layout.entry_names
        if not names:
            raise ValueError(
                f"`start` is {start!r}, but must have a parameter to identify: floats, "
                "arrays of them, or `Parameter`s."
            )
        units = tuple(unit for each in parameters for unit in parameter_units(each))
        for name, parameter in zip(layout.names, parameters, strict=True):
            initial = concrete(parameter.value)
            if initial is not None and np.any(
                np.isin(initial, parameter_bounds(parameter))
            ):
                raise ValueError(
                    f"The parameter {name!r} begins at a bound, which is excluded in an "
                    f"identification: {parameter!r}. Begin between the bounds."
                )
        return cls(parameters, layout, names, units)

    @property
    def bounds(
        self,
    ) -> tuple[Float[np.ndarray, " parameters"], Float[np.ndarray, " parameters"]]:
        """Lower and upper bounds of the values, infinite if there is none."""
        counts = [each.value.size for each in self.parameters]
        lower, upper = zip(*map(parameter_bounds, self.parameters), strict=True)
        return np.repeat(lower, counts), np.repeat(upper, counts)

    @property
    def is_bounded(self) -> Bool[np.ndarray, " parameters"]:
        lower, upper = self.bounds
        return np.isfinite(lower) | np.isfinite(upper)

    def vector(
        self, normalized: Float[Array, " parameters"]
    ) -> Float[Array, " parameters"]:
        """Values of the parameters as a vector, in their units."""
        return self._vector(Parameter.value_at, normalized)

    def derivatives(
        self, normalized: Float[Array, " parameters"]
    ) -> Float[Array, " parameters"]:
        """Derivative of each value with respect to its normalized parameter."""
        return self._vector(Parameter.slope_at, normalized)

    def tree(self, normalized: Float[Array, " parameters"]) -> Any:
        """Argument of the design function: values of the parameters, and constants."""
        return self.layout.design(self._map(Parameter.value_at, normalized))

    def unflatten(self, vector: Float[Array, " parameters"]) -> Any:
        """Arrange one number for each parameter, such as its standard error, in a pytree.

        It has the structure of `start`, with None in place of the constants.
        """
        leaves = map(as_float, self.layout.split(vector))
        return jax.tree.unflatten(self.layout.structure, leaves)

    def scales(
        self, normalized: Float[Array, " parameters"]
    ) -> Float[Array, " parameters"]:
        """Reference sizes with respect to which changes of the values are relative.

        For a parameter with a bound, it is the distance to the bound; otherwise the
        larger one of the absolute value and the initial scale.
        """
        xp, (derivatives, values) = on_host(
            self.derivatives(normalized), self.vector(normalized)
        )
        derivatives = xp.abs(derivatives)
        largest = xp.maximum(derivatives, xp.abs(values))
        return as_float(xp.where(self.is_bounded, derivatives, largest))

    def _map(
        self,
        function: Callable[[Parameter, Numbers], Numbers],
        normalized: Float[Array, " parameters"],
    ) -> list[Numbers]:
        """Call a function of each parameter and its normalized parameter."""
        parts = map(as_float, self.layout.split(normalized))
        return list(map(function, self.parameters, parts))

    def _vector(
        self,
        function: Callable[[Parameter, Numbers], Numbers],
        normalized: Float[Array, " parameters"],
    ) -> Float[Array, " parameters"]:
        """Join the results of a function of each parameter."""
        xp, arrays = on_host(*self._map(function, normalized))
        return as_float(xp.concatenate([xp.ravel(array) for array in arrays]))


def as_parameters(design: Any, is_number: Callable[[Any], bool]) -> Any:
    """Replace each number by a `Parameter`, if a design has no `Parameter`."""
    if any(map(is_parameter, jax.tree.leaves(design, is_leaf=is_parameter))):
        return design
    return jax.tree.map(lambda leaf: Parameter(leaf) if is_number(leaf) else leaf, design)


def is_parameter(leaf: Any) -> bool:
    """Whether a leaf is a `Parameter`."""
    return isinstance(leaf, Parameter)


def parameter_bounds(parameter: Parameter) -> tuple[float, float]:
    """Lower and upper bound, infinite if there is none."""
    lower = -np.inf if parameter.lower is None else parameter.lower
    upper = np.inf if parameter.upper is None else parameter.upper
    return lower, upper


def parameter_units(parameter: Parameter) -> list[str]:
    """Unit of each entry of a parameter, in row-major order."""
    return np.broadcast_to(parameter.unit, parameter.value.shape).ravel().tolist()


def _is_number(leaf: Any) -> bool:
    """Whether a leaf is a number or an array of real numbers.

    Integers are accepted, because users write 80 for 80.0.
    """
    if isinstance(leaf, int) and not isinstance(leaf, bool):
        return True
    return eqx.is_inexact_array_like(leaf)
