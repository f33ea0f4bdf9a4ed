"""Lattices: unit cells that are repeated in one or two directions."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from .._utils.host import as_float, concrete, is_traced, on_host
from .._utils.stacking import Copies, stack
from .._utils.types import GradientLike, Pose, ReducedVectorsLike, VectorsLike
from .._utils.validation import (
    index_of,
    listing,
    quote,
    require_array,
    require_distinct,
    require_kind,
)
from ..mechanism.body import Body
from ..mechanism.copies import PartCopies, PartCopy
from ..mechanism.hinge import Hinge
from ..mechanism.mechanism import Mechanism
from .periodicity import Periodicity


_SIDES = (("left", "right"), ("bottom", "top"))
_INDEXED = re.compile(r"(.*)\[(-?\d+(?:, *-?\d+)*)\]", re.DOTALL)


class UnitCell(eqx.Module):
    """Bodies and hinges that are repeated in one or two directions.

    Args:
        bodies: The bodies of one cell, in the reference configuration.
        hinges: The hinges that begin in this cell. The second body of a hinge may be in
            another cell: `"square[1, 0]"` is the body `"square"` of the next cell in the
            first direction, and `"square[1]"` that in a row.
        vectors: Vector from a cell to the next one, for each direction; m.

    Raises:
        ValueError: A name is unknown, occurs twice, or has an index that does not belong
            there or is not written as the lattice does; there are not one or two
            independent vectors; or a hinge has `ports`.

    Example:
        >>> import twistorjax as tj
        >>> spring = tj.Quadratic(np.diag([1.0, 100.0, 10.0]))
        >>> hinge = tj.Hinge("spring", "mass", "mass[1]", spring, at=(0, 0.05, 0))
        >>> cell = tj.lattices.UnitCell([tj.Body("mass")], [hinge], [(0.1, 0.0)])
        >>> row = tj.lattices.repeat(cell, 3)
        >>> tj.Mechanism(row.bodies, row.hinges, fixed=row.border("left"))
        Mechanism of 3 bodies (mass[0], mass[1], mass[2]), 2 hinges (spring[0],
        spring[1]); fixed: mass[0]
    """

    bodies: tuple[Body, ...]
    hinges: tuple[Hinge, ...]
    vectors: Float[Array, "directions 2"]

    def __init__(
        self,
        bodies: Sequence[Body],
        hinges: Sequence[Hinge],
        vectors: VectorsLike,
    ):
        self.bodies = require_kind("bodies", bodies, Body)
        self.hinges = require_kind("hinges", hinges, Hinge)
        self.vectors = as_float(vectors)
        if self.vectors.shape not in ((1, 2), (2, 2)):
            raise ValueError(
                f"`vectors` has shape {self.vectors.shape}, but must be one or two "
                "vectors (x, y), such as [(0.1, 0.0), (0.0, 0.1)]."
            )
        known = concrete(self.vectors)
        if known is not None:
            sizes = np.prod(np.linalg.norm(known, axis=1))
            area = np.sqrt(np.abs(np.linalg.det(known @ known.T)))
            if not area > 1e-9 * sizes:
                raise ValueError(
                    f"`vectors` is {known.tolist()}, but must be independent vectors."
                )
        names = require_distinct("body", [body.name for body in self.bodies])
        require_distinct("hinge", [hinge.name for hinge in self.hinges])
        for part in (*self.bodies, *self.hinges):
            if _INDEXED.fullmatch(part.name):
                raise ValueError(
                    f"{part.name!r} is the name of a part of a cell, but ends with an "
                    "index, which `repeat` adds to the names. Choose another name."
                )
        for hinge in self.hinges:
            if hinge.ports is not None:
                raise ValueError(
                    f"The hinge {hinge.name!r} of the cell has `ports`, but must have "
                    "`at`, its pose in the first cell."
                )
            where = f"`first` of the hinge {hinge.name!r}"
            index_of(where, "body", hinge.first, names)
            where = f"`second` of the hinge {hinge.name!r}"
            body, offset = self.second_of(hinge)
            index_of(where, "body", body, names)
            name = _name(body, offset) if any(offset) else body
            if hinge.second != name:
                raise ValueError(
                    f"{where} is {quote(hinge.second)}, but must be written {name!r}."
                )

    @property
    def directions(self) -> int:
        """Number of directions in which the cell is repeated."""
        return len(self.vectors)

    def second_of(self, hinge: Hinge) -> tuple[str, tuple[int, ...]]:
        """Return the second body of a hinge of the cell, and the index of its cell.

        Raises:
            ValueError: The index has the wrong number of entries.
        """
        found = _INDEXED.fullmatch(hinge.second)
        if found is None:
            return hinge.second, self.directions * (0,)
        body, text = found.groups()
        offset = tuple(map(int, text.split(",")))
        if len(offset) != self.directions:
            raise ValueError(
                f"`second` of the hinge {hinge.name!r} is {quote(hinge.second)}, but the "
                f"cell is repeated in {_count(self.directions, 'direction')}: give "
                f"{_count(self.directions, 'whole number')} in brackets."
            )
        return body, offset

    def wave_vectors(
        self, corners: ReducedVectorsLike, count: int
    ) -> Float[np.ndarray, "waves 2"]:
        """Return wave vectors along a path in the Brillouin zone.

        Args:
            corners: Corners of the path. Each has a number for each direction of the
                lattice: the wave vector k in units of the reciprocal lattice, for which
                the phase between neighboring cells is 2 pi times the number. The edge of
                the zone is at 0.5.
            count: Number of wave vectors between two corners.

        Returns:
            The wave vectors, from the first corner to the last one; rad/m.

        Raises:
            ValueError: There are fewer than two corners, a corner has the wrong length,
                `count` is not positive, or the vectors of the cell are traced.

        Example:
            >>> import twistorjax as tj
            >>> joint = tj.Quadratic(np.diag([1.5e-3, 1.2e5, 1.2e3]))
            >>> cell = tj.lattices.rotating_squares(joint, pitch=0.5, angle=0.4)
            >>> cell.wave_vectors([(0, 0), (0.5, 0)], 2)
            array([[0.        , 0.        ],
                   [1.57079633, 0.        ],
                   [3.14159265, 0.        ]])
        """
        points, vectors = np.asarray(corners, float), concrete(self.vectors)
        if points.ndim != 2 or len(points) < 2 or points.shape[1] != self.directions:
            raise ValueError(
                f"`corners` has shape {points.shape}, but must be two or more corners "
                f"with {_count(self.directions, 'number')} each, such as "
                f"{[self.directions * (0,), self.directions * (0.5,)]}."
            )
        if not isinstance(count, int) or count < 1:
            raise ValueError(f"`count` is {count!r}, but must be a positive integer.")
        if vectors is None:
            raise ValueError("The vectors of the cell are traced, so they are not known.")
        steps = np.linspace(points[:-1], points[1:], count, endpoint=False, axis=1)
        path = np.concatenate([steps.reshape(-1, self.directions), points[-1:]])
        # k . vector = 2 pi times the number, without a component across a row of cells
        return 2 * np.pi * path @ np.linalg.pinv(vectors).T

    def images(self) -> dict[str, tuple[Body, tuple[int, ...]]]:
        """Return bodies of other cells to which hinges of this cell are attached.

        Returns:
            The body of this cell, and the index of the other cell, by the names of the
            images, such as "square[1, 0]".
        """
        bodies = {body.name: body for body in self.bodies}
        images = {}
        for hinge in self.hinges:
            name, offset = self.second_of(hinge)
            if any(offset):
                images[hinge.second] = bodies[name], offset
        return images

    def mechanism(
        self, fixed: Sequence[str] | Mapping[str, Sequence[str]] = ()
    ) -> Mechanism:
        """Return one cell as a mechanism, with the images of bodies of its neighbors.

        With the constraints of `periodicity`, its equilibria are those of an infinite
        lattice in which all cells deform in the same way.

        Args:
            fixed: Bodies, or their coordinates, that cannot move; see `Mechanism`. In an
                infinite lattice, one body must be held in x and y.

        Returns:
            The mechanism. The images have the names that the hinges give them.

        Example:
            >>> import twistorjax as tj
            >>> joint = tj.Quadratic(np.diag([1.5e-3, 1.2e5, 1.2e3]))
            >>> cell = tj.lattices.rotating_squares(joint, pitch=15e-3, angle=0.4)
            >>> one = cell.mechanism(fixed={"a": ["x", "y"]})
            >>> pressed = tj.equilibrium(
            ...     one, constraints=cell.periodicity([[0.0, 0.0], [0.0, -0.05]])
            ... )
            >>> pressed.displacement("a[0, 1]")[2]  # 5 % of two pitches
            Array(-0.0015, dtype=float64)
        """
        bodies = list(self.bodies)
        for name, (body, offset) in self.images().items():
            xp, (pose, vectors) = on_host(body.pose, self.vectors)
            shift = xp.concatenate([np.zeros(1), np.array(offset, float) @ vectors])
            bodies.append(Body(name, as_float(pose + shift), outline=body.outline))
        return Mechanism(bodies, self.hinges, fixed)

    def periodicity(
        self, gradient: GradientLike = ((0.0, 0.0), (0.0, 0.0))
    ) -> tuple[Periodicity, ...]:
        """Return the constraints of a periodic lattice with a mean deformation.

        Args:
            gradient: Mean gradient of the displacement: entry (i, k) is the derivative of
                displacement i by coordinate k; -.

        Returns:
            Constraints for analyses of the `mechanism`, with the names of the images.
        """
        gradient = require_array("`gradient`", gradient, (2, 2), "be 2 by 2 numbers")
        _, (gradient, vectors) = on_host(gradient, self.vectors)
        return tuple(
            Periodicity(
                name,
                (body.name, name),
                as_float(gradient @ (np.array(offset, float) @ vectors)),
            )
            for name, (body, offset) in self.images().items()
        )


class Port(NamedTuple):
    """Place of a hinge that the lattice lacks at a border.

    Args:
        body: Name of the body to which the hinge would be attached.
        hinge: Name of the hinge in the unit cell.
        at: Pose of the hinge in the world; rad, m, m.
    """

    body: str
    hinge: str
    at: Pose


@dataclass(frozen=True, repr=False)
class Lattice:
    """Bodies and hinges of a repeated cell, for the arguments of a `Mechanism`.

    Args:
        bodies: Copies of the bodies of the cell, with names such as "square[3, 0]".
        hinges: Copies of the hinges, with names such as "joint[3, 0]". Hinges whose
            second body is not in the lattice are left out. Copies may be left out of the
            arguments of a `Mechanism`, as defects of the lattice.
        ports: Places of the hinges that are left out, for each side: "left" and "right"
            in the first direction, "bottom" and "top" in the second.
    """

    bodies: tuple[PartCopy[Body], ...]
    hinges: tuple[PartCopy[Hinge], ...]
    ports: dict[str, tuple[Port, ...]]

    def border(self, side: Literal["left", "right", "bottom", "top"]) -> tuple[str, ...]:
        """Return the names of the bodies at a border.

        They are the bodies to which more cells beyond the border would be attached, from
        cell to cell along the border.

        Args:
            side: The border.

        Returns:
            The names.

        Raises:
            ValueError: The lattice has no such border.
        """
        if side not in self.ports:
            raise ValueError(
                f"`side` is {quote(side)}, but the sides are {listing([*self.ports])}."
            )
        return tuple(dict.fromkeys(port.body for port in self.ports[side]))

    def __repr__(self) -> str:
        return f"Lattice of {len(self.bodies)} bodies and {len(self.hinges)} hinges"


def repeat(
    cell: UnitCell | Callable[[Any], UnitCell],
    counts: int | Sequence[int],
    field: Any = None,
) -> Lattice:
    """Repeat a unit cell in one or two directions.

    Values of the cell may vary over the lattice: then `cell` is a function that creates
    the cell for one entry of a `field`. Positions of hinges may vary as well; each hinge
    is placed by the cell in which it begins. All cells must have the same vectors.

    Args:
        cell: The cell; or a function of one entry of the field that returns it.
        counts: Number of cells in each direction.
        field: Array, or pytree of arrays, whose first axes are the cells in each
            direction. It may be traced, for derivatives.

    Returns:
        The lattice. The names of its parts end with the index of the cell.

    Raises:
        ValueError: A count is not positive, there is not one for each direction, or the
            cells of a field differ in their structure.

    Example:
        >>> import twistorjax as tj
        >>> def cell(stiffness):
        ...     spring = stiffness * tj.Quadratic(np.diag([1.0, 100.0, 10.0]))
        ...     hinge = tj.Hinge("spring", "mass", "mass[1]", spring, at=(0, 0.05, 0))
        ...     return tj.lattices.UnitCell([tj.Body("mass")], [hinge], [(0.1, 0.0)])
        >>> tj.lattices.repeat(cell, 3, np.array([1.0, 2.0, 3.0]))
        Lattice of 3 bodies and 2 hinges
    """
    counts = tuple(np.atleast_1d(np.asarray(counts)).tolist())
    if not counts or any(not isinstance(n, int) or n < 1 for n in counts):
        raise ValueError(
            f"`counts` is {quote(counts)}, but must be the number of cells in each "
            "direction: positive whole numbers, such as (10, 10)."
        )
    if field is not None:
        cells = _varied(cell, counts, field)
    elif isinstance(cell, UnitCell):
        number = int(np.prod(counts))
        bodies, hinges = (
            [Copies(part, number) for part in parts]
            for parts in (cell.bodies, cell.hinges)
        )
        cells = _Cells(cell, bodies, hinges)
    else:
        raise ValueError(
            f"`cell` is {quote(cell)}, but must be a `UnitCell`, or a function that "
            "creates one for each entry of `field`."
        )
    first = cells.first
    if len(counts) != first.directions:
        raise ValueError(
            f"`counts` is {counts}, but the cell is repeated in "
            f"{_count(first.directions, 'direction')}."
        )
    indices = np.array(list(np.ndindex(*counts)))
    xp, (vectors,) = on_host(first.vectors)
    shifts = xp.concatenate(
        [np.zeros((len(indices), 1)), indices.astype(float) @ vectors], axis=1
    )
    bodies = []
    for copies in cells.bodies:
        placed = _place(copies, "pose", shifts)
        bodies += _named(placed, _indexed(copies.value.name, indices))
    hinges = []
    # Those of each side, with their places along it
    ports: dict[str, list[tuple[tuple[int, ...], Port]]] = {
        side: [] for pair in _SIDES[: len(counts)] for side in pair
    }
    for copies in cells.hinges:
        placed, hinge = _place(copies, "at", shifts), copies.value
        second, offset = first.second_of(hinge)
        others = indices + np.array(offset)
        rows = np.flatnonzero(np.all((others >= 0) & (others < counts), axis=1))
        names, firsts = (_indexed(name, indices) for name in (hinge.name, hinge.first))
        ends = tuple(zip(firsts, _indexed(second, others), strict=True))
        of_cells = _named(placed, names, ends)
        hinges += [of_cells[row] for row in rows]
        xp, (at, vectors) = on_host(placed.value.at, first.vectors)
        step = xp.concatenate([np.zeros(1), np.array(offset, float) @ vectors])
        before = at - step[None]
        for sign, body, poses in ((1, hinge.first, at), (-1, second, before)):
            beyond = indices + sign * np.array(offset)
            outside = (beyond < 0) | (beyond >= counts)
            for row in np.flatnonzero(np.any(outside, axis=1)):
                direction = int(np.argmax(outside[row]))
                side = _SIDES[direction][int(beyond[row, direction] >= 0)]
                (name,) = _indexed(body, indices[[row]])
                place = tuple(np.delete(indices[row], direction).tolist())
                port = Port(name, hinge.name, as_float(poses[row]))
                ports[side].append((place, port))
    found = {
        side: tuple(port for _, port in sorted(of_side, key=itemgetter(0)))
        for side, of_side in ports.items()
    }
    return Lattice(tuple(bodies), tuple(hinges), found)


class _Cells(NamedTuple):
    """All cells of a lattice, before they are placed."""

    first: UnitCell
    bodies: list[Copies]
    hinges: list[Copies]


def _varied(
    cell: UnitCell | Callable[[Any], UnitCell], counts: tuple[int, ...], field: Any
) -> _Cells:
    """Create a cell for each entry of a field."""
    if isinstance(cell, UnitCell) or not jax.tree.leaves(field):
        raise ValueError(
            f"`cell` is {quote(cell)} and `field` is {quote(field)}, but with a field of "
            "arrays the cell must be a function that creates a `UnitCell` for each entry."
        )
    number = int(np.prod(counts))

    def in_a_row(leaf: Any) -> Any:
        xp, (array,) = on_host(leaf)
        if array.shape[: len(counts)] != counts:
            raise ValueError(
                f"`field` has an array of shape {array.shape}, but its first axes must "
                f"be the cells in each direction, {counts}."
            )
        return xp.reshape(array, (number, *array.shape[len(counts) :]))

    def entry(rows: Any, k: int) -> Any:
        return jax.tree.map(lambda leaf: leaf[k], rows)

    rows = jax.tree.map(in_a_row, field)
    first = _created(cell, entry(rows, 0))
    if is_traced(rows):
        return _traced_cells(cell, rows, first, number)
    others = [_created(cell, entry(rows, k)) for k in range(1, number)]
    known = concrete(first.vectors)
    for other in others:
        _require_same_structure(first, other)
        if known is not None and not np.allclose(
            known, other.vectors, rtol=1e-12, atol=0
        ):
            raise ValueError(
                f"The cells of `field` have different vectors, {known.tolist()} and "
                f"{np.asarray(other.vectors).tolist()}, but all must have the same ones."
            )
    cells = [first, *others]
    bodies, hinges = (
        [_stacked(parts) for parts in zip(*columns, strict=True)]
        for columns in (
            [made.bodies for made in cells],
            [made.hinges for made in cells],
        )
    )
    return _Cells(first, bodies, hinges)


def _traced_cells(
    cell: Callable[[Any], UnitCell], rows: Any, first: UnitCell, number: int
) -> _Cells:
    """Create the cells of a traced field at once."""
    first_leaves, structure = jax.tree.flatten(first)
    varies: list[bool] = []

    def leaves_of(row: Any) -> tuple[list[Array], Array]:
        other = _created(cell, row)
        _require_same_structure(first, other)
        leaves = jax.tree.leaves(other)
        # Values that do not depend on the field are the same objects.
        pairs = zip(leaves, first_leaves, strict=True)
        varies[:] = [new is not old for new, old in pairs]
        return leaves, other.vectors

    try:
        stacked, _ = jax.vmap(leaves_of, out_axes=(0, None))(rows)
    except ValueError as error:
        if "out_axes" not in str(error):
            raise
        raise ValueError(
            "The vectors of the cell depend on the entries of `field`, but all cells "
            "must have the same ones."
        ) from None
    leaves = [
        new if varied else old
        for new, old, varied in zip(stacked, first_leaves, varies, strict=True)
    ]
    cells, flags = (jax.tree.unflatten(structure, part) for part in (leaves, varies))
    bodies, hinges = (
        [
            Copies(part, number, jax.tree.leaves(of_part))
            for part, of_part in zip(parts, of_parts, strict=True)
        ]
        for parts, of_parts in (
            (cells.bodies, flags.bodies),
            (cells.hinges, flags.hinges),
        )
    )
    return _Cells(first, bodies, hinges)


def _created(cell: Callable[[Any], UnitCell], entry: Any) -> UnitCell:
    """Call the function of a user."""
    created = cell(entry)
    if not isinstance(created, UnitCell):
        raise ValueError(
            f"`cell` returned {quote(created)}, but must return a `UnitCell`."
        )
    return created


def _require_same_structure(first: UnitCell, other: UnitCell) -> None:
    """Check that two cells of a field have the same parts."""
    if jax.tree.structure(first) != jax.tree.structure(other):
        raise ValueError(
            "The cells of `field` differ in the names of their parts, in the classes of "
            "energies, or in the arguments that are given. Only numbers may vary."
        )


def _stacked(parts: Sequence[Body] | Sequence[Hinge]) -> Copies:
    """Stack the copies of a part."""
    groups = stack([Copies(part) for part in parts], share=True)
    if len(groups) > 1:
        raise ValueError(
            f"The part {parts[0].name!r} has arrays of different shapes in the cells of "
            "`field`, but only numbers may vary."
        )
    (group,) = groups
    return Copies(group.value, len(parts), [axis == 0 for axis in group.axes])


def _place(copies: Copies, field: str, shifts: Float[Any, "cells 3"]) -> Copies:
    """Move the copies of a part to their cells."""
    varies = copies.varies_tree()
    xp, (pose, by) = on_host(getattr(copies.value, field), shifts)
    part, varies = (
        eqx.tree_at(lambda part: getattr(part, field), tree, value)
        for tree, value in (
            (copies.value, as_float(xp.broadcast_to(pose, by.shape) + by)),
            (varies, True),
        )
    )
    return Copies(part, copies.number, jax.tree.leaves(varies))


def _named(
    copies: Copies, names: tuple[str, ...], ends: tuple[tuple[str, str], ...] = ()
) -> list[PartCopy[Any]]:
    parts = PartCopies(copies.value, names, ends, tuple(copies.flags))
    return [PartCopy(name, parts, row) for row, name in enumerate(names)]


def _indexed(name: str, indices: Int[np.ndarray, "cells directions"]) -> tuple[str, ...]:
    """Return the names of a part in some cells."""
    return tuple(_name(name, index) for index in indices.tolist())


def _name(part: str, index: Sequence[int]) -> str:
    return f"{part}[{', '.join(map(str, index))}]"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
