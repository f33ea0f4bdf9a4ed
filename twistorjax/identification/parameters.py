"""What is to be found: numbers of a design, with their units and bounds."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .._utils.pytrees import entry_names, path_name
from .._utils.validation import concrete


class Parameter(eqx.Module):
    """A number, or an array of them, that a fit is to find.

    Args:
        value: from which to begin.
        unit: for printing; of an array one, or one for each entry of its last axis.
        above: what it always exceeds: 0 for a stiffness or a length.
        below: what it never reaches.
        scale: how far a sensible change goes. By default the value's own size, of a zero
            in an array that of its largest; where there is a bound, the distance to it.

    Raises:
        ValueError: the value is not finite, or not between its bounds; a free one is
            zero and has no scale.

    Example:
        >>> Parameter(250e-6, "m", above=0)
        Unknown(0.00025 m, above 0)
    """

    value: Float[Array, "..."]
    unit: str | tuple[str, ...] = eqx.field(static=True)
    above: float | None = eqx.field(static=True)
    below: float | None = eqx.field(static=True)
    scale: Float[Array, "..."] | None

    def __init__(
        self,
        value: ArrayLike,
        unit: str | Sequence[str] = "",
        *,
        above: float | int | None = None,
        below: float | int | None = None,
        scale: ArrayLike | None = None,
    ):
        self.value = jnp.asarray(value, float)
        self.unit = unit if isinstance(unit, str) else tuple(unit)
        shape = self.value.shape
        if not isinstance(unit, str) and (not shape or len(unit) != shape[-1]):
            raise ValueError(
                f"`unit` has {len(unit)} entries, but the `Parameter` has shape {shape}: "
                "give one, or one for each entry of its last axis."
            )
        self.above = None if above is None else float(above)
        self.below = None if below is None else float(below)
        self.scale = None if scale is None else jnp.asarray(scale, float)
        if self.scale is not None and (above is not None or below is not None):
            raise ValueError(
                "An `Parameter` with a bound is measured by the distance to it: leave out "
                "`scale`."
            )
        seen = concrete(self.value)
        if seen is None:
            return
        if not np.all(np.isfinite(seen)):
            raise ValueError(f"An `Parameter` is {seen.tolist()}, but must be finite.")
        if above is not None and below is not None and not above < below:
            raise ValueError(
                f"An `Parameter` is to lie above {above:g} and below {below:g}: are the "
                "bounds exchanged?"
            )
        low = -np.inf if self.above is None else self.above
        high = np.inf if self.below is None else self.below
        if not np.all((low < seen) & (seen < high)):
            raise ValueError(
                f"An `Parameter` starts at {seen.tolist()}, but must start{self._bounds()}."
            )
        size = concrete(self._size())
        if size is not None and not np.all((size > 0) & np.isfinite(size)):
            raise ValueError(
                "A free `Parameter` starts at zero, so its size cannot be seen: give its "
                "`scale`, how far a sensible change goes."
            )

    def _size(self) -> Float[Array, "..."]:
        """How far a unit step from the value goes."""
        if self.above is not None and self.below is not None:
            part = (self.value - self.above) / (self.below - self.above)
            return (self.below - self.above) * part * (1 - part)
        if self.above is not None:
            return self.value - self.above
        if self.below is not None:
            return self.below - self.value
        if self.scale is None:
            size = jnp.abs(self.value)
            return jnp.where(size > 0, size, jnp.max(size))
        return jnp.broadcast_to(self.scale, self.value.shape)

    def at(self, step: Float[Array, "..."]) -> Float[Array, "..."]:
        """The value a step away, within the bounds; at step 0 it is the start.

        A small step is a relative change, of the value or of its distance to a bound.
        """
        if self.above is not None and self.below is not None:
            part = (self.value - self.above) / (self.below - self.above)
            start = jnp.log(part / (1 - part))
            span = self.below - self.above
            return self.above + span * jax.nn.sigmoid(start + step)
        if self.above is not None:
            return self.above + (self.value - self.above) * jnp.exp(step)
        if self.below is not None:
            return self.below - (self.below - self.value) * jnp.exp(-step)
        return self.value + self._size() * step

    def _bounds(self) -> str:
        words = [
            f" {side} {bound:g}"
            for side, bound in (("above", self.above), ("below", self.below))
            if bound is not None
        ]
        return " and".join(words)

    def __repr__(self) -> str:
        seen = concrete(self.value)
        if seen is None:
            return eqx.tree_pformat(self)
        told = self.unit if isinstance(self.unit, str) else ", ".join(self.unit)
        unit = f" {told}" if told else ""
        bounds = self._bounds()
        comma = "," if bounds else ""
        return f"Unknown({np.array2string(seen, precision=6)}{unit}{comma}{bounds})"


class ParameterSet(eqx.Module):
    """All unknowns of a design, as one row of steps from where they start.

    Args:
        leaves: the unknowns, in the order of the row.
        reference: what else the design takes, as it is, with nothing where the unknowns are.
        names: one for each entry of the row.
        units: likewise.
    """

    leaves: tuple[Parameter, ...]
    rest: Any
    tree: Any = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)

    @property
    def bounded(self) -> frozenset[str]:
        """The names of those with a bound."""
        return frozenset(
            name
            for unknown, names in zip(self.leaves, self._cut(self.names), strict=True)
            for name in names
            if unknown.above is not None or unknown.below is not None
        )

    @classmethod
    def of(cls, start: Any) -> "ParameterSet":
        """Those of a tree: each `Parameter`, or, where there is none, each number."""
        paths, tree = jax.tree_util.tree_flatten_with_path(start, is_leaf=_is_unknown)
        sought = (
            _is_unknown if any(_is_unknown(leaf) for _, leaf in paths) else _is_number
        )
        leaves, rest, names, units = [], [], [], []
        for path, leaf in paths:
            if not sought(leaf):
                rest.append(leaf)
                continue
            unknown = leaf if _is_unknown(leaf) else Parameter(leaf)
            rest.append(None)
            leaves.append(unknown)
            names += entry_names(path_name(path), unknown.value.shape)
            for place in np.ndindex(unknown.value.shape):
                unit = unknown.unit
                units.append(unit if isinstance(unit, str) else unit[place[-1]])
        if not leaves:
            raise ValueError(
                f"`start` is {start!r}, but must have something to find: floats, arrays "
                "of them, or `Parameter`s."
            )
        return cls(tuple(leaves), tuple(rest), tree, tuple(names), tuple(units))

    def flat(self, steps: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
        """The values, in a row."""
        return jnp.concatenate([jnp.ravel(part) for part in self._parts(steps)])

    def at(self, steps: Float[Array, " unknowns"]) -> Any:
        """The tree that the design takes."""
        parts = iter(self._parts(steps))
        leaves = [next(parts) if leaf is None else leaf for leaf in self.rest]
        return jax.tree.unflatten(self.tree, leaves)

    def like(self, row: Float[Array, " unknowns"]) -> Any:
        """A number for each unknown, in the tree that the design takes."""
        parts = zip(self.leaves, self._cut(row), strict=True)
        shaped = (part.reshape(unknown.value.shape) for unknown, part in parts)
        leaves = [next(shaped) if leaf is None else None for leaf in self.rest]
        return jax.tree.unflatten(self.tree, leaves)

    def sizes(self, steps: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
        """How large each is, by which its change counts as a relative one.

        The distance to a bound; of free ones the value, or their size at the start where
        that is larger.
        """
        names, bounded = self.names, self.bounded
        free = jnp.asarray([name not in bounded for name in names])
        slopes = jnp.abs(self.slopes(steps))
        return jnp.where(free, jnp.maximum(slopes, jnp.abs(self.flat(steps))), slopes)

    def slopes(self, steps: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
        """How fast each value changes with its own step."""
        return jax.jvp(self.flat, (steps,), (jnp.ones_like(steps),))[1]

    def _parts(self, steps: Float[Array, " unknowns"]) -> list[Array]:
        parts = zip(self.leaves, self._cut(steps), strict=True)
        return [unknown.at(part.reshape(unknown.value.shape)) for unknown, part in parts]

    def _cut(self, row: Any) -> list[Any]:
        """A row's entries for each of the leaves."""
        ends = np.cumsum([0, *(unknown.value.size for unknown in self.leaves)])
        return [row[start:end] for start, end in pairwise(ends)]


def _is_unknown(leaf: Any) -> bool:
    return isinstance(leaf, Parameter)


def _is_number(leaf: Any) -> bool:
    if isinstance(leaf, int) and not isinstance(leaf, bool):
        return True  # a whole one by chance
    return eqx.is_inexact_array_like(leaf)
