"""Bodies and hinges that occur several times, with values that may vary."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Generic, TypeVar

import jax
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import TypeAliasType

from .._utils.host import as_float, on_host, take_rows
from .._utils.stacking import Copies, PerPart
from .._utils.types import Poses
from .._utils.validation import (
    index_of,
    require_distinct,
    require_instance,
    require_same_precision,
)
from ..assembly.kinematics import misfit_numbers
from .body import Body
from .hinge import check_energy, frame_and_misfit, Hinge


Part = TypeVar("Part", Body, Hinge)


@dataclass(frozen=True, eq=False, repr=False)
class PartCopies(Generic[Part]):
    """Copies of a body or of a hinge.

    Args:
        part: The body or hinge; arrays that vary have a first axis of copies.
        names: Names of the copies.
        ends: Names of the two bodies of each hinge; empty for bodies.
        varies: Whether each array of the part varies.
    """

    part: Part
    names: tuple[str, ...]
    ends: tuple[tuple[str, str], ...]
    varies: tuple[bool, ...]

    @classmethod
    def of_one(cls, part: Part) -> "PartCopies[Part]":
        """Return a single part as one copy."""
        ends = ((part.first, part.second),) if isinstance(part, Hinge) else ()
        return cls(part, (part.name,), ends, len(jax.tree.leaves(part)) * (False,))

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, copy: int) -> Part:
        part = PerPart.of([self._whole()])[copy]
        named = {"name": self.names[copy]}
        if self.ends:
            named["first"], named["second"] = self.ends[copy]
        for field, text in named.items():  # of a new object that nobody else has
            object.__setattr__(part, field, text)
        return part

    def __iter__(self) -> Iterator[Part]:
        return (self[copy] for copy in range(len(self)))

    def take(self, rows: Sequence[int]) -> "PartCopies[Part]":
        """Select some of the copies."""
        if list(rows) == list(range(len(self))):
            return self
        at = np.array(rows)
        leaves, structure = jax.tree.flatten(self.part)
        leaves = [
            take_rows(leaf, at) if varies else leaf
            for leaf, varies in zip(leaves, self.varies, strict=True)
        ]
        return PartCopies(
            jax.tree.unflatten(structure, leaves),
            tuple(self.names[row] for row in rows),
            tuple(self.ends[row] for row in rows if self.ends),
            self.varies,
        )

    def values(self, *fields: str) -> Copies:
        """Return a field of all copies, or several fields."""
        if not any(self.varies):
            return Copies(attrgetter(*fields)(self.part), len(self))
        return self._whole().part(attrgetter(*fields))

    def rows(self, field: str) -> Float[Array | np.ndarray, "copies _"]:
        """Return an array in a field, with a row for each copy."""
        value, count, varies = self.values(field)
        if varies and any(varies):
            return value
        xp, (array,) = on_host(value)
        return xp.broadcast_to(array, (count, *array.shape))

    def _whole(self) -> Copies:
        return Copies(self.part, len(self), self.varies)


@dataclass(frozen=True, repr=False)
class PartCopy(Generic[Part]):
    """A body or a hinge of a lattice, with the fields of a `Body` or a `Hinge`.

    Neighboring copies of one part are joined again in a `Mechanism`, which is faster than
    if each was a part of its own.

    Args:
        name: Name of the part.
    """

    name: str
    _copies: PartCopies[Part]
    _row: int

    def __getattr__(self, field: str) -> Any:
        return getattr(self._copies[self._row], field)

    def __repr__(self) -> str:
        return repr(self._copies[self._row])


# A body or a hinge, which may be a copy
BodyLike = TypeAliasType("BodyLike", Body | PartCopy[Body])
HingeLike = TypeAliasType("HingeLike", Hinge | PartCopy[Hinge])


def copies_of(name: str, parts: Any, kind: type[Part]) -> list[PartCopies[Part]]:
    """Check the bodies or hinges of a user; `name` is that of the argument."""
    if isinstance(parts, kind | PartCopy):
        raise ValueError(f"`{name}` is one {kind.__name__}: put it in a list, [...].")
    runs: list[tuple[PartCopies, list[int]]] = []
    for index, part in enumerate(parts):
        if not isinstance(part, PartCopy) or not isinstance(part._copies.part, kind):
            one = PartCopies.of_one(require_instance(f"{name}[{index}]", part, kind))
            runs.append((one, [0]))
        elif runs and runs[-1][0] is part._copies:
            runs[-1][1].append(part._row)
        else:
            runs.append((part._copies, [part._row]))
    checked = [copies.take(rows) for copies, rows in runs]
    noun = kind.__name__.lower()
    for copies in checked:
        require_same_precision(f"The {noun} {copies.names[0]!r}", copies.part)
    return checked


def distinct_names(noun: str, copies: Sequence[PartCopies]) -> tuple[str, ...]:
    """Join the names of all parts, which must differ."""
    return require_distinct(noun, [name for part in copies for name in part.names])


def per_part(field: str, copies: Sequence[PartCopies]) -> PerPart:
    """Join a field of all parts."""
    return PerPart.of([part.values(field) for part in copies])


def indices_of_ends(
    hinges: Sequence[PartCopies[Hinge]], names: Sequence[str]
) -> tuple[tuple[int, int], ...]:
    """Find the two bodies of each hinge, by their index in the names of the bodies."""
    rows = {name: row for row, name in enumerate(names)}

    def row(hinge: str, end: str, body: str) -> int:
        if body not in rows:
            index_of(f"`{end}` of the hinge {hinge!r}", "body", body, names)
        return rows[body]

    return tuple(
        (row(hinge, "first", first), row(hinge, "second", second))
        for copies in hinges
        for hinge, (first, second) in zip(copies.names, copies.ends, strict=True)
    )


def check_energies(hinges: Sequence[PartCopies[Hinge]]) -> None:
    """Check the energies of all hinges; one that many hinges share is checked once."""
    different = {id(copies.part.energy): copies for copies in reversed(hinges)}
    for copies in different.values():
        if any(copies.values("energy").flags):
            for hinge in copies:
                check_energy(hinge)
        else:
            check_energy(copies.part)


def frames_and_misfits(
    hinges: Sequence[PartCopies[Hinge]],
    ends: Sequence[tuple[int, int]],
    reference: Poses,
) -> tuple[Float[Array, "hinges 3"], Float[Array, "hinges 6"] | None]:
    """Compute the poses of all hinges in the reference configuration, and misfits.

    The misfits are None if no hinge has one.
    """
    _, (poses,) = on_host(reference)
    frames, misfits, start = [], [], 0
    for copies in hinges:
        if copies.part.ports is None:
            frames.append(copies.rows("at"))
            misfit = copies.part.misfit
            if misfit is not None:
                misfit = misfit_numbers(as_float(copies.rows("misfit")))
            misfits.append(misfit)
        else:
            first, second = (as_float(poses[row]) for row in ends[start])
            frame, misfit = frame_and_misfit(copies.part, first, second)
            frames.append(frame[None])
            misfits.append(None if misfit is None else misfit[None])
        start += len(copies)
    at = joined(frames)
    if all(misfit is None for misfit in misfits):
        return at, None
    rows = [
        np.zeros((len(copies), 6)) if misfit is None else misfit
        for copies, misfit in zip(hinges, misfits, strict=True)
    ]
    return at, joined(rows)


def joined(rows: Sequence[Array | np.ndarray]) -> Float[Array, "_ _"]:
    """Join rows of several parts; there must be at least one part."""
    xp, arrays = on_host(*rows)
    return as_float(xp.concatenate(arrays))
