"""Names of parameters, outputs and axes that a dataset or a store can hold."""

from collections.abc import Iterable, Mapping, Sequence

from .._utils.validation import quote, require_text
from ..designs.names import RESERVED
from ..results.tables import Columns


def check_outputs(
    parameters: Iterable[str], grid: Sequence[str], outputs: Columns
) -> None:
    """Check that a dataset can hold the outputs of a study and their axes.

    `grid` has the names of the parameters that are axes of the dataset; it is empty if
    the designs are not a grid. `outputs` are those of a batch of designs.
    """
    parameters, design_axes = set(parameters), {"design", *grid}
    used = {*parameters, *design_axes, *RESERVED}
    labels: dict[str, tuple[str, ...]] = {}
    for name, column in outputs.items():
        require_text("The name of an output", name)
        if name in used:
            raise ValueError(
                f"The study returns an output {quote(name)}, but this name is reserved, "
                "or is the name of a parameter or an axis. Rename the output."
            )
        if shared := sorted(design_axes & {*column.axes}):
            raise ValueError(
                f"The output {quote(name)} has an axis {quote(shared[0])}, but this is "
                "an axis of the designs. Rename the axis."
            )
        if len(column.axes) != len(column.values.shape) - 1:
            raise ValueError(
                f"The output {quote(name)} has shape {column.values.shape[1:]}, but its "
                f"axes are {column.axes}. Give one name for each axis."
            )
        lengths = dict(zip(column.axes, column.values.shape[1:], strict=True))
        for axis, axis_labels in column.labels:
            if len(axis_labels) != lengths.get(axis, len(axis_labels)):
                raise ValueError(
                    f"The output {quote(name)} has {lengths[axis]} entries along "
                    f"{quote(axis)}, but {len(axis_labels)} labels. Give one label for "
                    "each entry."
                )
            if labels.setdefault(axis, axis_labels) != axis_labels:
                raise ValueError(
                    f"The axis {quote(axis)} of {quote(name)} has other labels than the "
                    "same axis of another output. Rename one of the axes."
                )
    own_coordinates = (name for name, column in outputs.items() if column.axes == (name,))
    for axis in (*labels, *own_coordinates):
        if axis in parameters or (axis in labels and axis in outputs):
            raise ValueError(
                f"{quote(axis)} is an axis with its own values or labels, but it is also "
                "the name of a parameter or an output. Rename one of them."
            )


def check_storable(names: Iterable[str]) -> None:
    """Check that a store can hold variables of these names, each of which is a folder."""
    for name in names:
        if (
            not name.isprintable()
            or any(character in name for character in " /\\")
            or name.startswith("__")
            or not name.strip(".")
            or name in ("finished", "zarr.json")
        ):
            raise ValueError(
                f"A `store` cannot hold the name {quote(name)}. Names in a store must "
                "not contain spaces, slashes or control characters, must not begin with "
                "'__' or consist of dots, and must not be 'finished' or 'zarr.json'. "
                "Rename it, or sweep without a store."
            )


def coordinate_names(parameters: Iterable[str], outputs: Columns) -> Mapping[str, str]:
    """Name the variables that hold the values along an axis for each design.

    An output with the name of its own axis, such as the times of a motion, holds the
    values along this axis. It becomes a coordinate of the dataset if it is the same for
    all designs. While the sweep runs, the values are stored for each design in
    `<axis>_coordinate`.
    """
    names: dict[str, str] = {}
    for axis, column in outputs.items():
        if column.axes != (axis,):
            continue
        variable = f"{axis}_coordinate"
        if variable in {*parameters, *outputs}:
            raise ValueError(
                f"A parameter or an output has the name {quote(variable)}, but this name "
                f"is used for the values along the axis {quote(axis)}. Rename it."
            )
        names[variable] = axis
    return names
