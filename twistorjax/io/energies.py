"""JSON files of energies, from which a fitted hinge can be read again."""

import dataclasses
from pathlib import Path
from typing import Any, TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from .._utils.json_files import (
    describe_value,
    EntryError,
    find_invalid_entry,
    read_json,
    write_json,
)
from .._utils.validation import shorten
from ..energies.base import AbstractEnergy, Scaled, Sum, validation_error
from ..energies.mixed import MixedEnergy
from ..energies.point_charges import PointCharges
from ..energies.polynomial import Polynomial, Rational, SumOfSquares
from ..energies.quadratic import Quadratic
from ..energies.validity import WithValidityRange


if TYPE_CHECKING:
    from . import schemas


VERSION = 2
_CLASSES = {
    energy_class.__name__: energy_class
    for energy_class in (
        Quadratic,
        Polynomial,
        Rational,
        SumOfSquares,
        MixedEnergy,
        WithValidityRange,
        PointCharges,
        Sum,
        Scaled,
    )
}


def save_energy(energy: AbstractEnergy, path: str | Path) -> None:
    """Write an energy to a JSON file without rounding.

    Args:
        energy: Energy of one of the classes `Quadratic`, `Polynomial`, `Rational`,
            `SumOfSquares`, `MixedEnergy`, `WithValidityRange` and `PointCharges`, or a
            sum or a multiple of such energies.
        path: Path of the file. A file that exists is replaced once the new one is
            complete.

    Raises:
        ValueError: The energy is of another class, or has a value that is not finite.
            Nothing is written.
        OSError: The file cannot be written.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> from twistorjax.energies import Polynomial
        >>> rotational = Polynomial(coefficients=[0.1], powers=[(0, 2, 0, 0)])
        >>> with TemporaryDirectory() as folder:
        ...     save_energy(rotational, f"{folder}/hinge.json")
        ...     load_energy(f"{folder}/hinge.json").coefficients
        Array([0.1], dtype=float64)
    """
    write_record(path, "energy", energy_record(energy))


def load_energy(path: str | Path) -> AbstractEnergy:
    """Read an energy from a JSON file that `save_energy` wrote.

    Args:
        path: Path of the file.

    Returns:
        The energy.

    Raises:
        ValueError: The file is damaged or of another version, or an entry is unknown,
            missing or out of range. The message names the file and the entry.
        OSError: The file cannot be read.
    """
    record = read_record(path, "energy")
    try:
        return energy_from_record(record, "energy")
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def write_record(path: str | Path, kind: str, record: Any) -> None:
    """Write a record to a JSON file, if it can be read again.

    Args:
        path: Path of the file.
        kind: "energy" or "mechanism".
        record: The record, which consists of dictionaries, lists and values.

    Raises:
        ValueError: The record cannot be read again: a value is not finite, a text cannot
            be encoded, or the record does not fit its schema. Nothing is written.
        OSError: The file cannot be written.
    """
    from .schemas import convert_record

    try:
        if error_message := find_invalid_entry({kind: record}):
            raise ValueError(error_message)
        convert_record(record, kind)
    except ValueError as error:
        raise ValueError(f"{path} is not written: {error}") from None
    write_json(path, {"twistorjax": VERSION, kind: record})


def read_record(path: str | Path, kind: str) -> Any:
    """Read a record from a JSON file.

    Args:
        path: Path of the file.
        kind: "energy" or "mechanism".

    Returns:
        The record, as an instance of its class in `schemas`.

    Raises:
        ValueError: The file is damaged, of another version or of another kind, or does
            not fit the schema.
        OSError: The file cannot be read.
    """
    from .schemas import convert_record

    content = read_json(path)
    if not isinstance(content, dict):
        raise ValueError(f"{path} is {describe_value(content)}, but must be an object.")
    version = content.get("twistorjax")
    if type(version) is not int or version != VERSION:
        raise ValueError(
            f"{path} has a layout that this version of twistorjax cannot read: its field "
            f"`twistorjax` is {describe_value(version)}, but must be {VERSION}."
        )
    if set(content) != {"twistorjax", kind}:
        raise ValueError(
            f"{path} has the fields {shorten(', '.join(content))}, but must have "
            f"only `twistorjax` and `{kind}`."
        )
    try:
        return convert_record(content[kind], kind)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def energy_record(energy: AbstractEnergy) -> dict[str, Any]:
    """Convert an energy into a record.

    Args:
        energy: The energy.

    Returns:
        The record, which consists of dictionaries, lists and values.

    Raises:
        ValueError: The energy cannot be saved.
    """
    name = type(energy).__name__
    if _CLASSES.get(name) is not type(energy):
        raise ValueError(
            f"An energy of the class {name} cannot be saved. Classes that can be saved "
            f"are {', '.join(_CLASSES)}."
        )

    def to_plain(value: Any) -> Any:
        if isinstance(value, AbstractEnergy):
            return energy_record(value)
        if isinstance(value, tuple):
            return [to_plain(part) for part in value]
        if isinstance(value, str | int):
            return value
        return np.asarray(value).tolist()

    record: dict[str, Any] = {"kind": name}
    try:
        for field in dataclasses.fields(energy):
            record[field.name] = to_plain(getattr(energy, field.name))
    except RecursionError:
        raise ValueError(
            "The energy cannot be saved, because it has too many nested sums."
        ) from None
    return record


def energy_from_record(record: "schemas.Energy", entry: str) -> AbstractEnergy:
    """Create an energy from its record.

    Args:
        record: The record, which fits its schema.
        entry: Name of the record in the file, for messages.

    Returns:
        The energy.

    Raises:
        EntryError: The values of the record do not make a valid energy.
    """
    from .schemas import is_energy

    def to_argument(name: str, value: Any) -> Any:
        if is_energy(value):
            return energy_from_record(value, f"{entry}.{name}")
        if name == "parts":
            return tuple(to_argument(f"parts[{k}]", part) for k, part in enumerate(value))
        if name in ("powers", "coordinates"):
            return value
        return jnp.asarray(value, float)

    names = record.__struct_fields__
    arguments = {name: to_argument(name, getattr(record, name)) for name in names}
    try:
        energy = _CLASSES[type(record).__name__](**arguments)
        if message := validation_error(energy):
            raise ValueError(message)
        return energy
    except ValueError as error:
        raise EntryError(f"the entry `{entry}`: {error}") from error
