"""Layout of the dataset of a sweep, and check that it fits into the memory."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, TYPE_CHECKING

import jax
import numpy as np

from .._utils.validation import quote
from ..designs.designs import Designs
from ..results.codes import RESULT_NAMES
from ..results.tables import Column, Columns
from .names import check_outputs, check_storable, coordinate_names
from .outputs import StudyOutput


if TYPE_CHECKING:
    import xarray


# size of `succeeded` and `result` for one design; bytes
MINIMUM_OUTPUT_SIZE = 5

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

    `output` has the shapes of the outputs of one chunk of designs. `units` has those of
    parameters, and of outputs without a unit of their own.
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
        columns = (self.parameters | self.outputs).values()
        labeled = [axis for column in columns for axis, _ in column.labels]
        axes = self.coordinates.values()
        check_storable((*self.parameters, *self.outputs, *axes, *labeled))

    def values(self, output: StudyOutput) -> dict[str, np.ndarray]:
        """Return the values of one chunk of designs, by the name of their variable."""
        columns = zip(self._names, output.columns.values(), strict=True)
        values = {name: np.asarray(column.values) for name, column in columns}
        return values | {
            "succeeded": np.asarray(output.succeeded),
            "result": np.asarray(output.result),
        }

    def allocate(self) -> dict[str, np.ndarray]:
        """Allocate arrays for the outputs of all designs, by the name of their variable.

        The arrays are not initialized.
        """
        return {
            name: np.empty(column.values.shape, column.values.dtype)
            for name, column in self.outputs.items()
        }

    def memory_size(self, outputs: bool) -> int:
        """Compute the size of the parameters, and of the outputs if required; bytes."""
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

        The unit of an output is an empty string if it is unknown.
        """
        for name, unit in units.items():
            if name in columns and columns[name].unit not in ("", unit):
                raise ValueError(
                    f"`units` has the unit {quote(unit)} for {quote(name)}, but the "
                    f"study returns it in {columns[name].unit!r}. Remove it from `units`."
                )
        combined = {**{name: column.unit for name, column in columns.items()}, **units}
        for name in combined:
            if name not in (*columns, *self.designs.names):
                allowed = ", ".join((*self.designs.names, *self._names))
                raise ValueError(
                    f"`units` names {quote(name)}, but the parameters and outputs are "
                    f"{allowed}."
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
                        f"{quote(name)} has {length} entries along {quote(axis)}, but "
                        f"another variable has {lengths[axis]}. Rename the axis of one "
                        "of them."
                    )


def finish_dataset(
    table: "xarray.Dataset", grid: Sequence[str], coordinates: Mapping[str, str]
) -> "xarray.Dataset":
    """Reshape the outputs of a grid, and replace equal coordinates of all designs by one.

    All outputs have the axis `design`, or the axes of a grid, whose parameters become
    axes; `grid` is empty for other designs. `coordinates` has the axis of each variable
    `<axis>_coordinate`; see `coordinate_names`.
    """
    for name, axis in coordinates.items():
        computed = np.asarray(table["result"]) != NOT_COMPUTED
        if not computed.any():
            continue
        values = np.asarray(table[name])[computed]
        index = np.unravel_index(np.argmax(computed), computed.shape)
        first = table[name][index].drop_vars(table[name].coords)
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
