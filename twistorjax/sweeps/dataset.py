"""Layout of the dataset of a sweep: names, axes and units of its variables."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, TYPE_CHECKING

import jax
import numpy as np

from ..solve.results import RESULT_NAMES
from ..solve.tables import Column, Columns
from .designs import Designs
from .names import check_outputs, check_storable, coordinate_names
from .outputs import StudyOutput


if TYPE_CHECKING:
    import xarray


# value of `result` for a design that has not been evaluated
NOT_COMPUTED = -1
# meaning of the numbers of `result`, in the form of the CF conventions
RESULT_FLAGS = {
    "result": {
        "flag_values": [*range(len(RESULT_NAMES)), NOT_COMPUTED],
        "flag_meanings": " ".join([*RESULT_NAMES, "not_computed"]),
    }
}


class Layout:
    """Names, axes and units of all variables of a dataset.

    Args:
        designs: Designs of the sweep.
        output: Shapes of the outputs of one chunk of designs.
        units: Units of parameters, and of outputs without a unit of their own, by name.

    Raises:
        ValueError: A name is used twice or is unknown; a unit contradicts that of the
            output; or an axis has two lengths.

    Attributes:
        parameters: Columns of the parameters.
        outputs: Columns of the outputs of all designs, whose first axis is `design`.
            Their values are shapes.
        coordinates: Names of axes; see `coordinate_names`.
    """

    def __init__(self, designs: Designs, output: StudyOutput, units: Mapping[str, str]):
        self.designs = designs
        self.coordinates = coordinate_names(designs.names, output.columns)
        stored = {axis: name for name, axis in self.coordinates.items()}
        columns = {
            stored.get(name, name): column for name, column in output.columns.items()
        }
        self._names = tuple(columns)
        check_outputs(designs.names, self.grid, output.columns)
        columns |= {
            "succeeded": Column(output.succeeded),
            "result": Column(output.result),
        }
        units = self._all_units(columns, units)
        self.parameters = self._parameter_columns(units)
        self.outputs = {
            name: Column(
                jax.ShapeDtypeStruct(
                    (len(designs), *column.values.shape[1:]), column.values.dtype
                ),
                ("design", *column.axes),
                units[name],
                column.labels,
            )
            for name, column in columns.items()
        }
        self._check_lengths()

    def check_storable(self) -> None:
        """Check that a store can hold all variables.

        Raises:
            ValueError: A store cannot hold a name; the message contains it.
        """
        columns = (self.parameters | self.outputs).values()
        labeled = [axis for column in columns for axis, _ in column.labels]
        axes = self.coordinates.values()
        check_storable((*self.parameters, *self.outputs, *axes, *labeled))

    def values(self, output: StudyOutput) -> dict[str, np.ndarray]:
        """Name the values of one chunk of designs.

        Args:
            output: Outputs of the chunk.

        Returns:
            The values, by the name of their variable.
        """
        columns = zip(self._names, output.columns.values(), strict=True)
        values = {name: np.asarray(column.values) for name, column in columns}
        return values | {
            "succeeded": np.asarray(output.succeeded),
            "result": np.asarray(output.result),
        }

    def allocate(self) -> dict[str, np.ndarray]:
        """Allocate arrays for the outputs of all designs.

        Returns:
            The arrays, which are not initialized, by the name of their variable.
        """
        return {
            name: np.empty(column.values.shape, column.values.dtype)
            for name, column in self.outputs.items()
        }

    def memory_size(self, outputs: bool) -> int:
        """Compute the size of the arrays of the dataset.

        Args:
            outputs: Whether outputs are included, or parameters only.

        Returns:
            The size; bytes.
        """
        columns = self.parameters | (self.outputs if outputs else {})
        return sum(
            math.prod(column.values.shape) * np.dtype(column.values.dtype).itemsize
            for column in columns.values()
        )

    @property
    def grid(self) -> tuple[str, ...]:
        """Names of the parameters of a grid; empty if the designs are not a grid."""
        return () if self.designs.dims == ("design",) else self.designs.dims

    @property
    def attributes(self) -> dict[str, Any]:
        """Attributes of a store, by which xarray reads the parameters as coordinates."""
        return {"coordinates": " ".join(self.designs.names)} if not self.grid else {}

    def _all_units(self, columns: Columns, units: Mapping[str, str]) -> dict[str, str]:
        """Combine the units of the outputs, those of the user, and those of derivatives.

        Args:
            columns: Columns of the outputs, by name.
            units: Units that the user specifies, by name.

        Returns:
            The unit of each output, and of the parameters that have one; an empty string
            if a unit is unknown.
        """
        for name, unit in units.items():
            if name in columns and columns[name].unit not in ("", unit):
                raise ValueError(
                    f"`units` has the unit {unit!r} for {name!r}, but the study returns "
                    f"it in {columns[name].unit!r}. Remove it from `units`."
                )
        combined = {**{name: column.unit for name, column in columns.items()}, **units}
        for name in combined:
            if name not in (*columns, *self.designs.names):
                known = ", ".join((*self.designs.names, *self._names))
                raise ValueError(
                    f"`units` names {name!r}, but the parameters and outputs are {known}."
                )
        for name in self._names:
            for parameter in self.designs.names:
                derivative = f"{name}_by_{parameter}"
                if derivative in columns and not combined[derivative]:
                    combined[derivative] = _derivative_unit(
                        combined.get(name, ""), combined.get(parameter, "")
                    )
        return combined

    def _parameter_columns(self, units: Mapping[str, str]) -> Columns:
        """Create the columns of the parameters, with their units."""
        columns = {}
        for name, array in zip(self.designs.names, self.designs.arrays, strict=True):
            axes = ("design", *(f"{name}_{k}" for k in range(array.ndim - 1)))
            if self.grid:
                axes = (name,)
            columns[name] = Column(array, axes, units.get(name, ""))
        return columns

    def _check_lengths(self) -> None:
        """Check that each axis has the same length in all variables."""
        lengths: dict[str, int] = {}
        for name, column in (self.outputs | self.parameters).items():
            for axis, length in zip(column.axes, column.values.shape, strict=True):
                if lengths.setdefault(axis, length) != length:
                    raise ValueError(
                        f"{name!r} has {length} entries along {axis!r}, but another "
                        f"variable has {lengths[axis]}. Rename the axis of one of them."
                    )


def finish_dataset(
    table: "xarray.Dataset", grid: Sequence[str], coordinates: Mapping[str, str]
) -> "xarray.Dataset":
    """Give the dataset of a sweep its final axes and coordinates.

    Args:
        table: Dataset in which all outputs have the axis `design`.
        grid: Names of the parameters of a grid; empty if the designs are not a grid.
        coordinates: Names of axes; see `coordinate_names`.

    Returns:
        A dataset in which values along an axis that are the same for all designs are
        coordinates, and in which the parameters of a grid are axes.
    """
    for name, axis in coordinates.items():
        computed = np.asarray(table["result"]) != NOT_COMPUTED
        values = table[name] if computed.all() else table[name][computed]
        if not computed.any():
            continue
        first = values[0].drop_vars(values.coords)
        if np.array_equal(values, np.broadcast_to(first, values.shape), equal_nan=True):
            table = table.drop_vars(name).assign_coords({axis: first})
    if grid:
        shape = [table.sizes[name] for name in grid]

        def reshape(variable: "xarray.DataArray") -> Any:
            axes = (*grid, *map(str, variable.dims[1:]))
            values = variable.values.reshape(*shape, *variable.shape[1:])
            return axes, values, variable.attrs

        names = [name for name in table.data_vars if "design" in table[name].dims]
        table = table.assign({name: reshape(table[name]) for name in names})
    return table


def _derivative_unit(output: str, parameter: str) -> str:
    """Unit of the derivative of an output by a parameter; empty if one is unknown."""
    if not output or not parameter:
        return ""
    if parameter == "1":
        return output
    if " " in parameter or "/" in parameter:
        return f"{output}/({parameter})"
    return f"{output}/{parameter}"
