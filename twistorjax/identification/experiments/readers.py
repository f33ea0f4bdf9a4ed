"""Measurements from text files and xarray datasets, with units in each column."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np

from ..._utils.csv_files import CsvFile, unit_factor
from ..._utils.validation import shorten
from ...mechanism.loads import Drive, Load
from .measurement import Measurement
from .motion import MotionTest
from .sensors import BodySensor, HingeSensor, UNITS
from .statics import StaticTest
from .vibrations import require_ascending, VibrationTest


if TYPE_CHECKING:
    import xarray


_LOADS = ("moment", "force_x", "force_y")
_DRIVES = ("angle", "x", "y")
# Quantities that do not belong to a body or a hinge.
_GLOBAL_UNITS = {"time": "s", "frequency": "Hz"}


class _Column(NamedTuple):
    role: str  # "body" or "hinge" for readings, "load", "drive", "time" or "frequency"
    subject: str  # Name of the body or hinge; empty for times and frequencies
    quantity: str  # Quantity, for example "force_x"
    values: np.ndarray  # Values in SI units
    # Whether the values are poses in the world frame, not displacements
    absolute: bool = False

    @property
    def name(self) -> str:
        """Name of the column without its role and unit, for example "3.force_x"."""
        return f"{self.subject}.{self.quantity}" if self.subject else self.quantity


class _Table(NamedTuple):
    source: str  # Name of the file or the dataset, for messages
    columns: list[_Column]  # Columns, without those of standard deviations
    # Standard deviations by role and name of the column; SI units
    standard_deviations: dict[tuple[str, str], np.ndarray]

    def with_role(self, *roles: str) -> list[_Column]:
        """Columns with one of these roles, in the order of the roles."""
        return [
            column for role in roles for column in self.columns if column.role == role
        ]


def read_measurements(
    source: "str | Path | xarray.Dataset",
    *,
    standard_deviations: Mapping[str, float] | None = None,
    **settings: Any,
) -> Measurement:
    """Read measurements from a text file of separated values or an xarray dataset.

    The name of each column contains the quantity and its unit. `3.x_um` is the
    displacement of body 3 along x in micrometers, `hinge_a.force_1_N` a force on hinge a,
    and `sd_3.x_um` the standard deviation of `3.x`. An empty entry is a missing reading.
    The other columns define the kind of the test:

    - `time_s`: a motion, with a row for each time.
    - `load_3.force_x_N`, `load_3.moment_Nm`, `drive_6.x_um`: static load cases, with a
      row for each load case.
    - `frequency_Hz`, without other columns of readings: natural frequencies in ascending
      order.

    Args:
        source: File, separated by commas, semicolons or tabs; or dataset over `time` or
            `load_case`, and `body`, in which each variable has the attribute `units`, as
            that of `motion.to_xarray()`. In a dataset "angle", "x" and "y" are poses in
            the world frame, and `displacement_x` etc. are displacements. Loads and drives
            are named `load_force_x` or `drive_x`, standard deviations `sd_x`.
        standard_deviations: Standard deviations of the readings by name: `{"3.x": 1e-6}`,
            or `{"x": 1e-6}` for all bodies; SI units. They replace those of the columns
            `sd_...`, and are required for readings without such a column.
        settings: Further arguments of the test; see `MotionTest`, `StaticTest` and
            `VibrationTest`. A motion needs an initial state, loads, or drives.

    Returns:
        The test with its readings.

    Raises:
        ValueError: A column is not known, its unit is not one of its quantity, an entry
            is not a number, or a standard deviation is missing.
        OSError: The file cannot be read.

    Example:
        >>> import xarray
        >>> travel = ("time", "body"), [[0.0], [1e-3], [2e-3]], {"units": "m"}
        >>> times = ("time", [0.0, 0.1, 0.2], {"units": "s"})
        >>> table = xarray.Dataset({"x": travel}, {"time": times, "body": ["block"]})
        >>> velocities = {"block": (0.0, 0.01, 0.0)}  # 10 mm/s along x
        >>> read_measurements(
        ...     table, standard_deviations={"x": 1e-6}, velocities=velocities
        ... )
        3 readings of MotionTest at 3 times up to 0.2 s, sensors: block.x
    """
    is_file = isinstance(source, str | Path)
    table = _read_file(Path(source)) if is_file else _read_dataset(source)
    given = dict(standard_deviations or {})
    _check_columns(table, given)
    readings = table.with_role("body", "hinge")
    inputs = table.with_role("load", "drive")
    times, frequencies = table.with_role("time"), table.with_role("frequency")
    if inputs and (times or frequencies):
        raise ValueError(
            f"{table.source} has {inputs[0].name} as a {inputs[0].role}, but only "
            "load cases have such columns: give `loads=` or `drives=` instead."
        )
    if frequencies:
        (column,) = frequencies
        if other := readings or times:
            raise ValueError(
                f"{table.source} has the column of {other[0].name} beside that of "
                "frequencies, but a file of natural frequencies has no other readings."
            )
        deviations = _standard_deviation(table, column, given)
        test = VibrationTest(len(column.values), deviations, **settings)
        return test.measurement(column.values[:, None])
    if not readings:
        raise ValueError(f"{table.source} has no readings: add columns such as `3.x_um`.")
    values = np.stack([column.values for column in readings], axis=1)
    columns = [_standard_deviation(table, column, given) for column in readings]
    deviations = np.stack(columns, axis=1)
    sensors = [
        _make_sensor(column, smallest)
        for column, smallest in zip(readings, np.nanmin(deviations, axis=0), strict=True)
    ]
    if times:
        motion_test = MotionTest(times[0].values, sensors, **settings)
        return motion_test.measurement(values, deviations)
    if not inputs:
        raise ValueError(
            f"{table.source} has neither times, nor loads or drives: add the column "
            "`time_s`, or columns such as `load_3.force_x_N` or `drive_6.x_um`."
        )
    load_cases = [_make_load_case(inputs, row) for row in range(len(values))]
    return StaticTest(load_cases, sensors, **settings).measurement(values, deviations)


def _check_columns(table: _Table, standard_deviations: Mapping[str, float]) -> None:
    """Check that no column is repeated, and that each standard deviation has a column."""
    names = [column.name for column in table.columns]
    keys = [(column.role, column.name) for column in table.columns]
    if repeated := [name for role, name in keys if keys.count((role, name)) > 1]:
        raise ValueError(f"{table.source} has {repeated[0]} twice, in different units.")
    allowed_names = {*names, *(column.quantity for column in table.columns)}
    unmatched = [
        name for role, name in table.standard_deviations if (role, name) not in keys
    ]
    unmatched += [name for name in standard_deviations if name not in allowed_names]
    if unmatched:
        raise ValueError(
            f"There is a standard deviation of {shorten(unmatched[0])!r}, but "
            f"{table.source} has no such readings: it has "
            f"{shorten(', '.join(names), 300)}."
        )


def _standard_deviation(
    table: _Table, column: _Column, given: Mapping[str, float]
) -> np.ndarray:
    """Standard deviations of the readings of one column, in its SI unit.

    Those that the user gives by name have priority over those of the table.
    """
    for name in (column.name, column.quantity):
        if name in given:
            return np.full(len(column.values), float(given[name]))
    if (column.role, column.name) not in table.standard_deviations:
        raise ValueError(
            f"{table.source} has no standard deviation of {column.name}: add a column "
            f"`sd_{column.name}_...`, or give `standard_deviations={{"
            f"{column.name!r}: ...}}`."
        )
    return table.standard_deviations[column.role, column.name]


def _make_sensor(column: _Column, standard_deviation: float) -> BodySensor | HingeSensor:
    """Sensor that corresponds to a column of readings."""
    quantity: Any = column.quantity
    if column.role == "hinge":
        return HingeSensor(column.subject, quantity, standard_deviation)
    return BodySensor(
        column.subject, quantity, standard_deviation, absolute=column.absolute
    )


def _make_load_case(inputs: Sequence[_Column], row: int) -> list[Load | Drive]:
    """Loads and prescribed displacements of the load case in one row."""
    wrenches: dict[str, list[float]] = {}
    displacements: dict[str, dict[str, float]] = {}
    for column in inputs:
        value = float(column.values[row])
        if column.role == "load":
            wrench = wrenches.setdefault(column.subject, [0.0, 0.0, 0.0])
            wrench[_LOADS.index(column.quantity)] = value
        else:
            displacements.setdefault(column.subject, {})[column.quantity] = value
    loads: list[Load | Drive] = [Load(body, wrench) for body, wrench in wrenches.items()]
    return loads + [Drive(body, **values) for body, values in displacements.items()]


def _read_file(path: Path) -> _Table:
    file = CsvFile(path)
    if not len(file):
        raise ValueError(f"{path} has no readings: it has only the line of column names.")
    table = _Table(str(path), [], {})
    for header in file.names:
        is_deviation, role, subject, quantity, factor = _parse_header(str(path), header)
        allow_empty = role in ("body", "hinge") and not is_deviation
        values = file.numbers(header, factor=factor, allow_empty=allow_empty)
        if role == "frequency" and not is_deviation:
            require_ascending(values, file.location)
        column = _Column(role, subject, quantity, values)
        if is_deviation:
            table.standard_deviations[column.role, column.name] = values
        else:
            table.columns.append(column)
    return table


def _parse_header(source: str, header: str) -> tuple[bool, str, str, str, float]:
    """Parse the header of a column of a text file, such as "sd_hinge_a.force_1_mN".

    The results are whether the values are standard deviations, the role, the name of the
    body or hinge, the quantity, and the factor from its unit to the SI unit.
    """
    name = header.removeprefix("sd_")
    is_deviation = name != header
    match = re.fullmatch(r"(?:(load|drive|hinge)_)?(.+)\.([a-z_12]+)_([^_]+)", name)
    if match:
        role, subject, quantity, unit = match.groups()
        role = role or "body"
        if quantity in {"load": _LOADS, "drive": _DRIVES}.get(role, tuple(UNITS)):
            factor = _unit_factor(source, header, quantity, unit)
            return is_deviation, role, subject, quantity, factor
    else:
        quantity, _, unit = name.rpartition("_")
        if quantity in _GLOBAL_UNITS:
            factor = _unit_factor(source, header, quantity, unit)
            return is_deviation, quantity, "", quantity, factor
    raise ValueError(
        f"{source} has the column {shorten(header)!r}, but a column is "
        f"`<body>.<quantity>_<unit>` with one of {', '.join(UNITS)}; or starts with "
        "`hinge_`, `load_`, `drive_` or `sd_`; or is `time_s` or `frequency_Hz`."
    )


def _unit_factor(source: str, header: str, quantity: str, unit: str) -> float:
    """Factor from the unit of a column to the SI unit of its quantity."""
    si_unit = UNITS.get(quantity) or _GLOBAL_UNITS[quantity]
    return unit_factor(source, header, quantity, si_unit, unit)


def _read_dataset(dataset: Any) -> _Table:
    table = _Table("the dataset", [], {})
    if "time" in dataset.dims:
        values = np.asarray(dataset["time"].values, float)
        unit = str(dataset["time"].attrs.get("units", "s"))
        factor = _unit_factor(table.source, "time", "time", unit)
        table.columns.append(_Column("time", "", "time", factor * values))
    for header, variable in dataset.data_vars.items():
        name, role = str(header).removeprefix("sd_"), "body"
        for prefix in ("load", "drive"):
            if name.startswith(f"{prefix}_"):
                role, name = prefix, name.removeprefix(f"{prefix}_")
        quantity = name.removeprefix("displacement_")
        if name == "frequency":
            role, bodies = "frequency", [""]
        elif quantity in UNITS and "body" in variable.dims:
            bodies = [str(body) for body in dataset["body"].values]
        else:
            continue  # energies and other variables that no sensor measures
        units = variable.attrs.get("units")
        if units is None:
            raise ValueError(
                f"{table.source} has {header!r} without `units` in its attributes."
            )
        factor = _unit_factor(table.source, str(header), quantity, str(units))
        rows = np.asarray(variable.values, float).reshape(-1, len(bodies))
        if "body" in variable.dims and variable.dims[-1] != "body":
            rows = np.asarray(variable.transpose(..., "body").values, float)
        absolute = role == "body" and quantity == name and name in _DRIVES
        for body, values in zip(bodies, rows.T, strict=True):
            column = _Column(role, body, quantity, factor * values, absolute)
            if str(header).startswith("sd_"):
                table.standard_deviations[column.role, column.name] = column.values
            else:
                table.columns.append(column)
    return table
