"""Energies in files, so that a hinge once fitted can be used again."""

import dataclasses
from pathlib import Path
from typing import Any, TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from .._utils.json_files import EntryError, fault_of, read_json, shown, write_json
from .._utils.validation import shorten
from ..energies.base import AbstractEnergy, Quadratic, Scaled, Sum
from ..energies.mixed import MixedEnergy
from ..energies.point_charges import PointCharges
from ..energies.polynomial import Polynomial, Rational, SumOfSquares
from ..energies.validity import WithValidityRange


if TYPE_CHECKING:
    from . import schemas


VERSION = 1
_KINDS = {
    kind.__name__: kind
    for kind in (
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
    """Write an energy as JSON, to the last bit.

    Args:
        energy: quadratic, polynomial, rational, slender or of charges; certified ones,
            their sums and multiples.
        path: Path of the file. A file that exists is replaced once the new one is
            complete.

    Raises:
        ValueError: The energy is of another kind, or has a value that is not finite.
            Nothing is written.
        OSError: The file cannot be written.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> from twistorjax.energies import Polynomial
        >>> with TemporaryDirectory() as folder:
        ...     save_energy(Polynomial([0.1], [(0, 2, 0, 0)]), f"{folder}/hinge.json")
        ...     load_energy(f"{folder}/hinge.json").coefficients
        Array([0.1], dtype=float64)
    """
    write_record(path, "energy", energy_told(energy))


def load_energy(path: str | Path) -> AbstractEnergy:
    """Read an energy that `save_energy` wrote.

    Raises:
        ValueError: The file is damaged or of another version, or an entry is unknown,
            missing or out of range. The message names the file and the entry.
        OSError: The file cannot be read.
    """
    record = read_record(path, "energy")
    try:
        return energy_from(record, "energy")
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def write_record(path: str | Path, kind: str, told: Any) -> None:
    """Write a record, if it can be read again.

    Args:
        path: Path of the file.
        kind: "energy" or "mechanism".
        told: The record, of plain objects, lists and values.

    Raises:
        ValueError: The record cannot be read again: a value is not finite, a text cannot
            be encoded, or it does not fit its schema. Nothing is written.
        OSError: The file cannot be written.
    """
    from .schemas import converted

    try:
        if fault := fault_of({kind: told}):
            raise ValueError(fault)
        converted(told, kind)
    except ValueError as error:
        raise ValueError(f"{path} is not written: {error}") from None
    write_json(path, {"twistorjax": VERSION, kind: told})


def read_record(path: str | Path, kind: str) -> Any:
    """Read a record.

    Args:
        path: Path of the file.
        kind: "energy" or "mechanism".

    Returns:
        The record, as its class in `schemas`.

    Raises:
        ValueError: The file is damaged, of another version or of another kind, or does
            not fit the schema.
        OSError: The file cannot be read.
    """
    from .schemas import converted

    record = read_json(path)
    if not isinstance(record, dict):
        raise ValueError(f"{path} is {shown(record)}, but must be an object.")
    version = record.get("twistorjax")
    if type(version) is not int or version != VERSION:
        raise ValueError(
            f"{path} has another layout than `save_{kind}` of this version writes: its "
            f"field `twistorjax` is {shown(version)}, but must be {VERSION}."
        )
    if set(record) != {"twistorjax", kind}:
        raise ValueError(
            f"{path} has the fields {shorten(', '.join(record))}, but must have "
            f"`twistorjax` and `{kind}` alone."
        )
    try:
        return converted(record[kind], kind)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def energy_told(energy: AbstractEnergy) -> dict[str, Any]:
    """The record of an energy, of plain objects, lists and values.

    Raises:
        ValueError: The energy cannot be saved.
    """
    name = type(energy).__name__
    if _KINDS.get(name) is not type(energy):
        raise ValueError(
            f"An energy of the kind {name} cannot be saved, but only {', '.join(_KINDS)}."
        )

    def plain(value: Any) -> Any:
        if isinstance(value, AbstractEnergy):
            return energy_told(value)
        if isinstance(value, tuple):
            return [plain(part) for part in value]
        if isinstance(value, str | int):
            return value
        return np.asarray(value).tolist()

    told: dict[str, Any] = {"kind": name}
    try:
        for field in dataclasses.fields(energy):
            told[field.name] = plain(getattr(energy, field.name))
    except RecursionError:
        raise ValueError("An energy of so many nested sums cannot be saved.") from None
    return told


def energy_from(record: "schemas.Energy", where: str) -> AbstractEnergy:
    """Make an energy of its record.

    Args:
        record: The record, which fits its schema.
        where: Name of its entry in the file, for messages.

    Raises:
        EntryError: Its values do not make an energy.
    """
    from .schemas import is_energy

    def whole(name: str, value: Any) -> Any:
        if is_energy(value):
            return energy_from(value, f"{where}.{name}")
        if name == "parts":
            return tuple(whole(f"parts[{k}]", part) for k, part in enumerate(value))
        if name in ("powers", "coordinates"):
            return value
        return jnp.asarray(value, float)

    fields = record.__struct_fields__
    values = {name: whole(name, getattr(record, name)) for name in fields}
    try:
        energy = _KINDS[type(record).__name__](**values)
        if fault := energy.validation_error():
            raise ValueError(fault)
        return energy
    except ValueError as error:
        raise EntryError(f"the entry `{where}`: {error}") from error
