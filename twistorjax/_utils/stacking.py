"""Values of many parts, stacked in groups of the same structure.

Many parts then have few arrays, so that a compiled program of a mechanism of a thousand
bodies has few arguments.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from operator import itemgetter
from typing import Any, Generic, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .host import all_concrete, concrete


Value = TypeVar("Value")


class Copies(NamedTuple):
    """A value of one or several parts."""

    value: Any
    number: int = 1  # of parts
    # For each array: whether it has a first axis with an entry for each part
    varies: Sequence[bool] | None = None

    @property
    def flags(self) -> Sequence[bool]:
        """Whether each array varies."""
        if self.varies is None:
            return len(jax.tree.leaves(self.value)) * (False,)
        return self.varies

    def varies_tree(self) -> Any:
        """Return a pytree like the value, with True for arrays that vary."""
        return jax.tree.unflatten(jax.tree.structure(self.value), self.flags)

    def part(self, select: Callable[[Any], Any]) -> "Copies":
        """Return a part of the value."""
        varies = jax.tree.leaves(select(self.varies_tree()))
        return Copies(select(self.value), self.number, varies)


class Group(NamedTuple):
    """Values of the same structure."""

    members: tuple[int, ...]  # Index of the part of each value
    value: Any  # The values, stacked; an array that all of them share is not stacked
    axes: tuple[int | None, ...]  # For each array: 0 if it is stacked, None if shared


def stack(entries: Sequence[Copies], *, share: bool = False) -> list[Group]:
    """Stack the values of parts that have the same structure, shapes, and dtypes.

    With `share`, an array is kept once if it is the same object in all entries.
    """
    found: dict[Any, list[tuple[int, int, list[Any], Sequence[bool]]]] = {}
    start = 0
    for copies in entries:
        (leaves, structure), count = jax.tree.flatten(copies.value), copies.number
        varies = copies.flags
        kinds = tuple(
            (np.shape(leaf)[bool(batched) :], jnp.result_type(leaf))
            for leaf, batched in zip(leaves, varies, strict=True)
        )
        parts = found.setdefault((structure, kinds), [])
        parts.append((start, count, leaves, varies))
        start += count
    groups = []
    for (structure, _), parts in found.items():
        members = tuple(first + k for first, count, _, _ in parts for k in range(count))
        columns, axes = [], []
        for k in range(structure.num_leaves):
            column = [(leaves[k], varies[k], count) for _, count, leaves, varies in parts]
            shared = (share or len(column) == 1) and all(
                leaf is column[0][0] and not varies for leaf, varies, _ in column
            )
            columns.append(column[0][0] if shared else _stacked(column))
            axes.append(None if shared else 0)
        groups.append(Group(members, jax.tree.unflatten(structure, columns), tuple(axes)))
    return groups


def member_of(value: Any, axes: Sequence[int | None], take: Callable[[Any], Any]) -> Any:
    """Return one of several stacked values; `take` selects its row of an array."""
    leaves, structure = jax.tree.flatten(value)
    of_member = [
        leaf if axis is None else take(leaf)
        for leaf, axis in zip(leaves, axes, strict=True)
    ]
    return jax.tree.unflatten(structure, of_member)


def _stacked(column: Sequence[tuple[Any, bool, int]]) -> Array:
    """Join arrays of some parts, without a compilation if they are not traced."""
    known = all_concrete([leaf for leaf, _, _ in column])
    xp: Any = jnp if known is None else np
    leaves = [leaf for leaf, _, _ in column] if known is None else known
    rows = [
        leaf if varies else xp.broadcast_to(leaf, (count, *np.shape(leaf)))
        for leaf, (_, varies, count) in zip(leaves, column, strict=True)
    ]
    joined = xp.concatenate(rows)
    return jnp.asarray(joined, joined.dtype)  # without a dtype, a program is compiled


class PerPart(eqx.Module, Generic[Value]):
    """One value for each of many parts, or None, as a sequence."""

    members: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    values: tuple[Any, ...]
    axes: tuple[tuple[int | None, ...], ...] = eqx.field(static=True)

    @classmethod
    def of(cls, entries: Sequence[Copies]) -> "PerPart":
        """Stack the values."""
        members, values, axes = zip(*stack(entries), strict=True) if entries else 3 * [()]
        return cls(tuple(members), tuple(values), tuple(axes))

    @classmethod
    def of_each(cls, values: Sequence[Any]) -> "PerPart":
        """Stack one value for each part."""
        return cls.of([Copies(value) for value in values])

    def __len__(self) -> int:
        return sum(map(len, self.members))

    def __getitem__(self, part: int | slice) -> Any:
        if isinstance(part, slice):
            return tuple(self[k] for k in range(len(self))[part])
        group, member = _positions(self.members)[part]
        return member_of(self.values[group], self.axes[group], partial(_row, member))

    def __iter__(self) -> Iterator[Any]:
        return (self[part] for part in range(len(self)))

    def on_host(self) -> list[Any]:
        """Return all values, with arrays of NumPy; they must not be traced."""
        values: list[Any] = len(self) * [None]
        for members, value, axes in zip(
            self.members, self.values, self.axes, strict=True
        ):
            known = jax.tree.map(np.asarray, value)
            for k, part in enumerate(members):
                values[part] = member_of(known, axes, itemgetter(k))
        return values

    def numbers(
        self, missing: float, shape: tuple[int, ...] = ()
    ) -> Float[Array | np.ndarray, "*values"]:
        """Return all values of a shape as an array, with a number for those missing."""
        known = all_concrete(jax.tree.leaves(self.values))
        xp: Any = jnp if known is None else np
        array = xp.full((len(self), *shape), missing)
        for members, value in zip(self.members, self.values, strict=True):
            if value is not None and known is None:
                array = array.at[np.array(members)].set(value)
            elif value is not None:
                array[np.array(members)] = np.asarray(value)
        return array

    def is_none(self) -> Bool[np.ndarray, " parts"]:
        """Decide whether each part has no value."""
        none = np.zeros(len(self), bool)
        for members, value in zip(self.members, self.values, strict=True):
            none[list(members)] = value is None
        return none


def _row(member: int, leaf: Any) -> Array:
    known = concrete(leaf)
    return leaf[member] if known is None else jax.device_put(known[member])


@lru_cache(maxsize=256)
def _positions(members: tuple[tuple[int, ...], ...]) -> list[tuple[int, int]]:
    """Return the group of each part, and its index in this group."""
    positions = {
        part: (group, k)
        for group, parts in enumerate(members)
        for k, part in enumerate(parts)
    }
    return [positions[part] for part in range(len(positions))]
