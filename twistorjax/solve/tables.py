"""Answers as labelled tables, with their units."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import Array, Shaped

from .._utils.validation import require_package


if TYPE_CHECKING:
    import xarray


class Column(eqx.Module):
    """One quantity of an answer, with its unit and what its axes are.

    Args:
        values: an axis for each name; more come before them in a batch.
        axes: what they are: "body", "time". A column that is named as its axis holds the
            places along it.
        unit: "1" where there is none; nothing where it is not known.
        labels: what the entries of an axis are called, in pairs of the axis and these.
    """

    values: Shaped[Any, "..."]
    axes: tuple[str, ...] = eqx.field(static=True, default=())
    unit: str = eqx.field(static=True, default="")
    labels: tuple[tuple[str, tuple[str, ...]], ...] = eqx.field(static=True, default=())


Columns = dict[str, Column]


def columns(
    values: Shaped[Array, "..."],
    axes: Sequence[str],
    *names_and_units: tuple[str, str],
    **labels: Sequence[str],
) -> Columns:
    """The entries of the last axis, each as a column.

    Args:
        values: with the axes, and one more for the entries.
        axes: what the others are.
        names_and_units: of each entry.
        labels: what the entries of an axis are called.
    """
    kept = tuple((axis, tuple(names)) for axis, names in labels.items())
    return {
        name: Column(values[..., place], tuple(axes), unit, kept)
        for place, (name, unit) in enumerate(names_and_units)
    }


class Tabular(eqx.Module):
    """An answer that can be told as a table."""

    @abstractmethod
    def columns(self) -> Columns:
        """Its quantities, by name."""

    def to_xarray(self) -> "xarray.Dataset":
        """The answer as a dataset, with names and units.

        Raises:
            ImportError: xarray is not installed.
            ValueError: this is a batch of answers.
        """
        told = self.columns()
        for column in told.values():
            shape = np.shape(column.values)
            if batch := shape[: len(shape) - len(column.axes)]:
                raise ValueError(
                    f"This is a batch of answers, of shape {batch}: make a table of one, "
                    "`jax.tree.map(lambda array: array[0], answer)`."
                )
        return dataset(told)


def dataset(
    told: Columns, attributes: Mapping[str, Mapping[str, Any]] | None = None
) -> "xarray.Dataset":
    """Columns as a dataset; those that are named as their axis as its coordinates.

    Args:
        told: the columns.
        attributes: more of them, beside their units, by name.

    Raises:
        ImportError: xarray is not installed.
    """
    xarray = require_xarray()
    variables, coordinates = {}, {}
    for name, column in told.items():
        more = dict((attributes or {}).get(name, {}))
        if column.unit:
            more["units"] = column.unit
        variable = (column.axes, np.asarray(column.values), more)
        (coordinates if column.axes == (name,) else variables)[name] = variable
        coordinates.update({axis: list(labels) for axis, labels in column.labels})
    return xarray.Dataset(variables, coordinates)


def require_xarray():
    """xarray, where it is installed.

    Raises:
        ImportError: it is not.
    """
    return require_package("xarray", "Tables", "data")
