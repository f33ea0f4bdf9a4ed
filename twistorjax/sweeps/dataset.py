"""How a sweep's numbers become one dataset."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, TYPE_CHECKING

import jax
import numpy as np

from ..solve.results import RESULT_NAMES
from ..solve.tables import Column, Columns
from .designs import Designs
from .names import check_columns, check_storable, places_of
from .outputs import StudyOutput


if TYPE_CHECKING:
    import xarray


# of a design that nothing is known of yet
UNKNOWN = -1
# what the numbers of `result` mean, as the CF conventions have it
OUTCOMES = {
    "result": {
        "flag_values": [*range(len(RESULT_NAMES)), UNKNOWN],
        "flag_meanings": " ".join([*RESULT_NAMES, "not_computed"]),
    }
}


class Layout:
    """Names, axes and units of all that a sweep keeps.

    Args:
        lanes: the designs.
        told: of one chunk of them, as shapes.
        units: of what does not tell its own, by name.

    Raises:
        ValueError: a name is used twice, or not known; an answer tells another unit than
            it is given; an axis has two lengths.
    """

    def __init__(self, designs: Designs, told: StudyOutput, units: Mapping[str, str]):
        self.designs = designs
        self.places = places_of(designs.names, told.columns)
        kept = {axis: name for name, axis in self.places.items()}
        own = {kept.get(name, name): column for name, column in told.columns.items()}
        self._names = tuple(own)
        check_columns(designs.names, self.grid, told.columns)
        own |= {"succeeded": Column(told.succeeded), "result": Column(told.result)}
        for name, unit in units.items():
            if name in own and own[name].unit not in ("", unit):
                raise ValueError(
                    f"`units` gives {name!r} the unit {unit!r}, but the study tells it "
                    f"in {own[name].unit!r}: leave it out."
                )
        units = {**{name: column.unit for name, column in own.items()}, **units}
        if strange := [name for name in units if name not in (*own, *designs.names)]:
            there = ", ".join((*designs.names, *self._names))
            raise ValueError(f"`units` names {strange[0]!r}, but there are {there}.")
        for whole in self._names:
            for parameter in designs.names:
                if (slope := f"{whole}_by_{parameter}") in own and not units[slope]:
                    units[slope] = _ratio(units.get(whole, ""), units.get(parameter, ""))
        self.fixed = self._parameters(units)
        self.by_design = {
            name: Column(
                jax.ShapeDtypeStruct(
                    (len(designs), *column.values.shape[1:]), column.values.dtype
                ),
                ("design", *column.axes),
                units[name],
                column.labels,
            )
            for name, column in own.items()
        }
        self._check_axes()

    def check_storable(self) -> None:
        """Refuse names that a store cannot keep.

        Raises:
            ValueError: There is one; the message names it.
        """
        columns = (self.fixed | self.by_design).values()
        labeled = [axis for column in columns for axis, _ in column.labels]
        check_storable((*self.fixed, *self.by_design, *self.places.values(), *labeled))

    def values(self, told: StudyOutput) -> dict[str, np.ndarray]:
        """The numbers of one chunk, by name."""
        columns = zip(self._names, told.columns.values(), strict=True)
        values = {name: np.asarray(column.values) for name, column in columns}
        return values | {
            "succeeded": np.asarray(told.succeeded),
            "result": np.asarray(told.result),
        }

    def empty(self) -> dict[str, np.ndarray]:
        """Room for the numbers of all designs."""
        return {
            name: np.empty(column.values.shape, column.values.dtype)
            for name, column in self.by_design.items()
        }

    def size(self, answers: bool) -> int:
        """Size of the arrays of the table; bytes.

        Args:
            answers: Whether answers are counted, or parameters alone.
        """
        columns = self.fixed | (self.by_design if answers else {})
        return sum(
            math.prod(column.values.shape) * np.dtype(column.values.dtype).itemsize
            for column in columns.values()
        )

    @property
    def grid(self) -> tuple[str, ...]:
        """The parameters whose combinations the designs are, if they are those."""
        return () if self.designs.dims == ("design",) else self.designs.dims

    @property
    def attributes(self) -> dict[str, Any]:
        """What the parameters are: coordinates."""
        return {"coordinates": " ".join(self.designs.names)} if not self.grid else {}

    def _parameters(self, units: Mapping[str, str]) -> Columns:
        designs, told = self.designs, {}
        for name, array in zip(designs.names, designs.arrays, strict=True):
            axes = ("design", *(f"{name}_{k}" for k in range(array.ndim - 1)))
            if self.grid:
                axes = (name,)
            told[name] = Column(array, axes, units.get(name, ""))
        return told

    def _check_axes(self) -> None:
        lengths: dict[str, int] = {}
        for name, column in (self.by_design | self.fixed).items():
            for axis, length in zip(column.axes, column.values.shape, strict=True):
                if lengths.setdefault(axis, length) != length:
                    raise ValueError(
                        f"{name!r} has {length} entries along {axis!r}, where another "
                        f"has {lengths[axis]}: give one of them axes of other names."
                    )


def finished(
    table: "xarray.Dataset", grid: Sequence[str], named_places: Mapping[str, str]
) -> "xarray.Dataset":
    """The table of a sweep, from one that has all designs in a row.

    Args:
        table: over `design`.
        grid: parameters of which the designs are all combinations; none where they are
            no grid.
        named_places: The names of axes, by the names of their values for each design.
    """
    for name, plain in named_places.items():
        known = np.asarray(table["result"]) != UNKNOWN
        places = table[name] if known.all() else table[name][known]
        if not known.any():
            continue
        one = places[0].drop_vars(places.coords)
        if np.array_equal(places, np.broadcast_to(one, places.shape), equal_nan=True):
            table = table.drop_vars(name).assign_coords({plain: one})
    if grid:
        shape = [table.sizes[name] for name in grid]

        def unrolled(variable: "xarray.DataArray") -> Any:
            axes = (*grid, *map(str, variable.dims[1:]))
            values = variable.values.reshape(*shape, *variable.shape[1:])
            return axes, values, variable.attrs

        rows = [name for name in table.data_vars if "design" in table[name].dims]
        table = table.assign({name: unrolled(table[name]) for name in rows})
    return table


def _ratio(above: str, below: str) -> str:
    """The unit of a slope; nothing where one is not known."""
    if not above or not below:
        return ""
    if below == "1":
        return above
    return f"{above}/({below})" if " " in below or "/" in below else f"{above}/{below}"
