"""Solutions as labeled tables with units."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import Array, Shaped

from .._utils.validation import require_package


if TYPE_CHECKING:
    import xarray


_NOISE = 1e-18  # Smaller displacements are rounding errors; rad, m


def cells(displacement: np.ndarray) -> list[str]:
    """Return the cells of a printed table for the coordinates of a displacement."""
    return [f"{0.0 if abs(value) < _NOISE else value:>13.6g}" for value in displacement]


class Column(eqx.Module):
    """One quantity of a solution, with its unit and the names of its axes.

    Args:
        values: Values, with one axis for each name in `axes`. In a batch, the axes of the
            batch precede them.
        axes: Names of the axes, such as "body" or "time". A column with the name of its
            only axis contains the coordinates along this axis.
        unit: Unit of the values; "1" if they have none; empty if it is unknown.
        labels: Names of the entries along an axis, as pairs of the axis and the names.
    """

    values: Shaped[Any, "..."]
    axes: tuple[str, ...] = eqx.field(static=True, default=())
    unit: str = eqx.field(static=True, default="")
    labels: tuple[tuple[str, tuple[str, ...]], ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        if isinstance(self.axes, str):
            raise ValueError(
                f"`axes` of a column is {self.axes!r}, but must be names of axes. If it "
                f"is the unit, write Column(values, unit={self.axes!r})."
            )


Columns = dict[str, Column]


def columns(
    values: Shaped[Array, "..."],
    axes: Sequence[str],
    *names_and_units: tuple[str, str],
    **labels: Sequence[str],
) -> Columns:
    """Split the last axis of an array into columns, one for each name and unit.

    `axes` are the names of the other axes, and `labels` the names of the entries along
    some of them.
    """
    names = tuple((axis, tuple(entries)) for axis, entries in labels.items())
    return {
        name: Column(values[..., index], tuple(axes), unit, names)
        for index, (name, unit) in enumerate(names_and_units)
    }


class Tabular(eqx.Module):
    """A solution that can be converted to a table."""

    @abstractmethod
    def columns(self) -> Columns:
        """Return the columns of the table, by name."""

    def to_xarray(self) -> "xarray.Dataset":
        """Convert the solution to an xarray dataset with names and units.

        Raises:
            ImportError: xarray is not installed.
            ValueError: This is a batch of solutions.
        """
        table = self.columns()
        for column in table.values():
            shape = np.shape(column.values)
            if batch := shape[: len(shape) - len(column.axes)]:
                raise ValueError(
                    f"This is a batch of solutions of shape {batch}. Convert them one by "
                    "one: `jax.tree.map(lambda array: array[0], solution)` is the first "
                    "solution."
                )
        return dataset(table)


def dataset(
    table: Columns, attributes: Mapping[str, Mapping[str, Any]] | None = None
) -> "xarray.Dataset":
    """Convert columns to an xarray dataset.

    A column that has the name of its only axis becomes a coordinate. Variables may have
    additional attributes.
    """
    xarray = require_package("xarray", "Tables", "data")
    variables, coordinates = {}, {}
    for name, column in table.items():
        attrs = dict((attributes or {}).get(name, {}))
        if column.unit:
            attrs["units"] = column.unit
        variable = (column.axes, np.asarray(column.values), attrs)
        (coordinates if column.axes == (name,) else variables)[name] = variable
        coordinates.update({axis: list(labels) for axis, labels in column.labels})
    return xarray.Dataset(variables, coordinates)
