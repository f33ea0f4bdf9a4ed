"""Measurements from files and datasets, their units told by each column."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np

from .._utils.csv_files import Columns
from .._utils.validation import shorten
from ..mechanism.loads import Drive, Load
from .measurement import Measurement
from .motion_test import MotionTest
from .sensors import BodySensor, HingeSensor, UNITS
from .static_test import StaticTest
from .vibration_test import need_ascending, VibrationTest


if TYPE_CHECKING:
    import xarray


_FACTORS = {
    "m": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9},
    "rad": {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": np.pi / 180},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3, "um/s": 1e-6},
    "rad/s": {"rad/s": 1.0, "deg/s": np.pi / 180},
    "N m": {"N m": 1.0, "Nm": 1.0, "Nmm": 1e-3, "mNm": 1e-3, "uNm": 1e-6},
    "N": {"N": 1.0, "mN": 1e-3, "uN": 1e-6, "kN": 1e3},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "Hz": {"Hz": 1.0, "kHz": 1e3},
}
_MICRO = str.maketrans("\u00b5\u03bc", "uu")  # the sign for micro, and the Greek letter
_LOADS = ("moment", "force_x", "force_y")
_DRIVES = ("angle", "x", "y")
_LONE = {"time": "s", "frequency": "Hz"}


class _Column(NamedTuple):
    """One column: whose it is, what, and its values in SI units."""

    role: str  # "read", "load", "drive", "hinge", "time" or "frequency"
    subject: str
    quantity: str
    values: np.ndarray
    absolute: bool = False

    @property
    def name(self) -> str:
        return f"{self.subject}.{self.quantity}" if self.subject else self.quantity


_Spreads = dict[tuple[str, str], np.ndarray]  # by role and name


def read_measurements(
    source: "str | Path | xarray.Dataset",
    *,
    deviations: Mapping[str, float] | None = None,
    **settings: Any,
) -> Measurement:
    """Measurements from a file of separated values, or from an xarray dataset.

    Each column tells what it is and in which unit: `3.x_um` is how far body 3 has moved
    along x, in micrometres; `hinge_a.force_1_N` what hinge a bears. Beside readings there
    are `time_s`, for a motion; or `load_3.force_x_N`, `load_3.moment_Nm` and
    `drive_6.x_um`, a trial a row, for trials at rest; or `frequency_Hz` alone, the
    slowest first. `sd_3.x_um` is the standard deviation of `3.x`. An empty entry is no
    reading.

    Args:
        source: the file, separated by commas, semicolons or tabs; or a dataset over
            `time` or `trial`, and `body`, with `units` in the attributes of each
            variable, as `motion.to_xarray()` makes it. There "angle", "x" and "y" tell
            where a body is; `displacement_x` and its like would
            how far it has moved. Loads and drives are `load_force_x`, `drive_x` and their
            like, standard deviations `sd_x`.
        deviations: standard deviations of readings without a column for them, by name:
            `{"3.x": 1e-6}`, or `{"x": 1e-6}` for all bodies; in SI units.
        settings: more for the test: for a motion how it begins and what drives it.

    Returns:
        The test, with what was measured in it.

    Raises:
        ValueError: a column is not known, its unit is not one of its quantity, an entry
            is no number, or a standard deviation is missing.
        OSError: the file cannot be read.

    Example:
        >>> import xarray
        >>> values = ("time", "body"), [[0.0], [1e-3], [2e-3]], {"units": "m"}
        >>> table = xarray.Dataset(
        ...     {"x": values},
        ...     {"time": ("time", [0.0, 0.1, 0.2], {"units": "s"}), "body": ["block"]},
        ... )
        >>> let_go = {"block": (0.0, 0.01, 0.0)}
        >>> read_measurements(table, deviations={"x": 1e-6}, velocities=let_go)
        3 readings of MotionTest at 3 times up to 0.2 s, read by block.x
    """
    if isinstance(source, str | Path):
        where, columns, spreads = str(source), *_from_file(Path(source))
    else:
        where, columns, spreads = "the dataset", *_from_dataset(source)
    by_role: dict[str, list[_Column]] = {}
    for column in columns:
        by_role.setdefault(column.role, []).append(column)
    readings = by_role.get("read", []) + by_role.get("hinge", [])
    names = [column.name for column in columns]
    roles = [(column.role, column.name) for column in columns]
    if twice := [name for role, name in roles if roles.count((role, name)) > 1]:
        raise ValueError(f"{where} tells {twice[0]} twice, in different units.")
    known = {*names, *(column.quantity for column in columns)}
    strange = [name for role, name in spreads if (role, name) not in roles]
    for name in (*strange, *(deviations or {})):
        if name in strange or name not in known:
            raise ValueError(
                f"There is a standard deviation of {shorten(name)!r}, but {where} has "
                f"no such readings: it has {shorten(', '.join(names), 300)}."
            )

    def deviation(column: _Column) -> np.ndarray:
        for name in (column.name, column.quantity):
            if deviations is not None and name in deviations:
                return np.full(len(column.values), float(deviations[name]))
        if (column.role, column.name) not in spreads:
            raise ValueError(
                f"{where} does not tell the standard deviation of {column.name}: add a "
                f"column `sd_{column.name}_...`, or give `deviations={{"
                f"{column.name!r}: ...}}`."
            )
        return spreads[column.role, column.name]

    given = by_role.get("load", []) + by_role.get("drive", [])
    if given and ("time" in by_role or "frequency" in by_role):
        raise ValueError(
            f"{where} tells {given[0].name} as a {given[0].role}, but only trials at "
            "rest have such columns: give what moves it as `loads=` or `drives=`."
        )
    if "frequency" in by_role:
        (column,) = by_role["frequency"]
        if readings or "time" in by_role:
            other = (readings or by_role["time"])[0].name
            raise ValueError(
                f"{where} has the column of {other} beside that of frequencies, but "
                "natural frequencies stand alone."
            )
        sizes = deviation(column)
        test = VibrationTest(len(column.values), sizes, **settings)
        return test.measured(column.values[:, None])
    if not readings:
        raise ValueError(f"{where} has no readings: columns such as `3.x_um`.")
    sizes = np.stack([deviation(column) for column in readings], axis=1)
    values = np.stack([column.values for column in readings], axis=1)
    sensors = [
        _sensor(column, np.nanmin(size))
        for column, size in zip(readings, sizes.T, strict=True)
    ]
    if "time" in by_role:
        (time,) = by_role["time"]
        motion = MotionTest(time.values, sensors, **settings)
        return motion.measured(values, sizes)
    if not given:
        raise ValueError(
            f"{where} tells neither times, nor loads or drives: give `time_s`, or "
            "columns such as `load_3.force_x_N` or `drive_6.x_um`."
        )
    trials = [_trial(given, row) for row in range(len(values))]
    return StaticTest(trials, sensors, **settings).measured(values, sizes)


def _sensor(column: _Column, deviation: float) -> BodySensor | HingeSensor:
    if column.role == "hinge":
        return HingeSensor(column.subject, column.quantity, deviation)  # pyright: ignore
    return BodySensor(
        column.subject,
        column.quantity,  # pyright: ignore[reportArgumentType]
        deviation,
        absolute=column.absolute,
    )


def _trial(given: list[_Column], row: int) -> list[Load | Drive]:
    """The loads and drives of one trial."""
    wrenches: dict[str, list[float]] = {}
    drives: dict[str, dict[str, float]] = {}
    for column in given:
        value = float(column.values[row])
        if column.role == "load":
            wrench = wrenches.setdefault(column.subject, [0.0, 0.0, 0.0])
            wrench[_LOADS.index(column.quantity)] = value
        else:
            drives.setdefault(column.subject, {})[column.quantity] = value
    parts: list[Load | Drive] = [Load(body, w) for body, w in wrenches.items()]
    return parts + [Drive(body, **moved) for body, moved in drives.items()]


def _from_file(path: Path) -> tuple[list[_Column], _Spreads]:
    file = Columns(path)
    if not len(file):
        raise ValueError(f"{path} has no readings: only the line of names.")
    columns, spreads = [], {}
    for title in file.names:
        spread, role, subject, quantity, unit = _parsed(str(path), title)
        blank = role in ("read", "hinge") and not spread
        values = file.numbers(title, unit=unit, blank=blank)
        if role == "frequency" and not spread:
            need_ascending(values, file.place)
        column = _Column(role, subject, quantity, values)
        if spread:
            spreads[column.role, column.name] = values
        else:
            columns.append(column)
    return columns, spreads


def _parsed(where: str, title: str) -> tuple[bool, str, str, str, float]:
    """What a column is: a deviation or not, its role, subject, quantity and unit."""
    rest = title.removeprefix("sd_")
    spread = rest != title
    match = re.fullmatch(r"(?:(load|drive|hinge)_)?(.+)\.([a-z_12]+)_([^_]+)", rest)
    if match:
        role, subject, quantity, unit = match.groups()
        role = role or "read"
        known = {"load": _LOADS, "drive": _DRIVES}.get(role, tuple(UNITS))
        if quantity in known:
            return spread, role, subject, quantity, _factor(where, title, quantity, unit)
    else:
        quantity, _, unit = rest.rpartition("_")
        if quantity in _LONE:
            return spread, quantity, "", quantity, _factor(where, title, quantity, unit)
    raise ValueError(
        f"{where} has the column {shorten(title)!r}, but a column is "
        f"`<body>.<quantity>_<unit>` with one of {', '.join(UNITS)}; or "
        "begins with `hinge_`, `load_`, `drive_` or `sd_`; or is `time_s` or "
        "`frequency_Hz`."
    )


def _factor(where: str, title: str, quantity: str, unit: str) -> float:
    """How many SI units a unit is."""
    factors = _FACTORS[UNITS.get(quantity) or _LONE[quantity]]
    if unit.translate(_MICRO) not in factors:
        raise ValueError(
            f"{where} has the column {shorten(title)!r} in {shorten(unit)!r}, but "
            f"{quantity} is told in {', '.join(factors)}; a letter µ is read as u."
        )
    return factors[unit.translate(_MICRO)]


def _from_dataset(table: Any) -> tuple[list[_Column], _Spreads]:
    columns, spreads = [], {}
    if "time" in table.dims:
        values = np.asarray(table["time"].values, float)
        unit = str(table["time"].attrs.get("units", "s"))
        factor = _factor("the dataset", "time", "time", unit)
        columns.append(_Column("time", "", "time", factor * values))
    for title, variable in table.data_vars.items():
        name = str(title).removeprefix("sd_")
        role = "read"
        for prefix in ("load", "drive"):
            if name.startswith(f"{prefix}_"):
                role, name = prefix, name.removeprefix(f"{prefix}_")
        moved = name.removeprefix("displacement_")
        if name == "frequency":
            role, bodies = "frequency", [""]
        elif moved in UNITS and "body" in variable.dims:
            bodies = [str(body) for body in table["body"].values]
        else:
            continue  # energies, and what else a table may tell
        units = variable.attrs.get("units")
        if units is None:
            raise ValueError(
                f"the dataset has {title!r} without `units` in its attributes."
            )
        factor = _factor("the dataset", str(title), moved, str(units))
        rows = np.asarray(variable.values, float).reshape(-1, len(bodies))
        if "body" in variable.dims and variable.dims[-1] != "body":
            rows = np.asarray(variable.transpose(..., "body").values, float)
        absolute = role == "read" and moved == name and name in _DRIVES
        for body, values in zip(bodies, rows.T, strict=True):
            column = _Column(role, body, moved, factor * values, absolute)
            if str(title).startswith("sd_"):
                spreads[column.role, column.name] = column.values
            else:
                columns.append(column)
    return columns, spreads
