"""Energies in files, so that a hinge once fitted can be used again."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from .certified import Certified
from .coulomb import Coulomb
from .energy import AbstractEnergy, Quadratic, Scaled, Sum
from .polynomial import Polynomial, Rational, Squares
from .slender import Slender


VERSION = 1
_KINDS = {
    kind.__name__: kind
    for kind in (
        Quadratic,
        Polynomial,
        Rational,
        Squares,
        Slender,
        Certified,
        Coulomb,
        Sum,
        Scaled,
    )
}


def save_energy(energy: AbstractEnergy, path: str | Path) -> None:
    """Writes an energy as JSON, to the last bit.

    Args:
        energy: quadratic, polynomial, rational, slender or of charges; certified ones,
            their sums and multiples.
        path: of the file; one that is there is replaced.

    Raises:
        ValueError: the energy is of another kind.
        OSError: the file cannot be written.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> from twistorjax import Polynomial
        >>> with TemporaryDirectory() as folder:
        ...     save_energy(Polynomial([0.1], [(0, 2, 0, 0)]), f"{folder}/hinge.json")
        ...     load_energy(f"{folder}/hinge.json").coefficients
        Array([0.1], dtype=float64)
    """
    write_record(path, "energy", energy_told(energy))


def load_energy(path: str | Path) -> AbstractEnergy:
    """Reads an energy that `save_energy` wrote.

    Raises:
        ValueError: the file is not whole, of another version, or names what is unknown.
        OSError: the file cannot be read.
    """
    told = read_record(path, "energy")
    try:
        return energy_from(told)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path} holds no energy: {error}") from error


def write_record(path: str | Path, kind: str, told: Any) -> None:
    """Writes what is told of a thing of some kind."""
    text = json.dumps({"twistorjax": VERSION, kind: told}, indent=1)
    Path(path).write_text(text + "\n", encoding="utf-8")


def read_record(path: str | Path, kind: str) -> Any:
    """Reads what was told of a thing of that kind.

    Raises:
        ValueError: the file is not whole, of another version, or of another kind.
        OSError: the file cannot be read.
    """
    try:
        record = json.loads(Path(path).read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(
            f"{path} is not whole, or no JSON: {error}. Save the {kind} again."
        ) from error
    if not isinstance(record, dict):
        raise ValueError(f"{path} is a {type(record).__name__}, but must be an object.")
    version = record.get("twistorjax")
    if version is True or version != VERSION:
        raise ValueError(
            f"{path} has another layout than `save_{kind}` of this version writes: its "
            f"field `twistorjax` is {version!r}, but must be {VERSION}."
        )
    if set(record) != {"twistorjax", kind}:
        raise ValueError(
            f"{path} has the fields {', '.join(record)}, but must have `twistorjax` and "
            f"`{kind}` alone."
        )
    return record[kind]


def energy_told(energy: AbstractEnergy) -> dict[str, Any]:
    """What an energy is, as plain values."""
    if type(energy).__name__ not in _KINDS:
        raise ValueError(
            f"An energy of the kind {type(energy).__name__} cannot be saved, but only "
            f"{', '.join(_KINDS)}."
        )

    def plain(value: Any) -> Any:
        if isinstance(value, AbstractEnergy):
            return energy_told(value)
        if isinstance(value, tuple):
            return [plain(part) for part in value]
        if isinstance(value, str | int):
            return value
        return np.asarray(value).tolist()

    fields = dataclasses.fields(energy)
    told = {field.name: plain(getattr(energy, field.name)) for field in fields}
    return {"kind": type(energy).__name__, **told}


def energy_from(record: Any) -> AbstractEnergy:
    """The energy of which that was told."""
    if not isinstance(record, dict) or record.get("kind") not in _KINDS:
        came = record.get("kind") if isinstance(record, dict) else record
        raise ValueError(f"`kind` is {came!r}, but must be one of {', '.join(_KINDS)}.")
    kind = _KINDS[record["kind"]]
    fields = dataclasses.fields(kind)
    names = {field.name for field in fields}
    if set(record) - {"kind"} != names:
        raise ValueError(
            f"a {record['kind']} has the fields {', '.join(sorted(names))}, but "
            f"{', '.join(sorted(set(record) - {'kind'})) or 'none'} are there."
        )

    def whole(value: Any) -> Any:
        if isinstance(value, dict):
            return energy_from(value)
        if isinstance(value, list) and value and isinstance(value[0], dict):
            return tuple(energy_from(part) for part in value)
        return jnp.asarray(value, float) if isinstance(value, list | float) else value

    values = {
        field.name: record[field.name]
        if field.metadata.get("static")
        else whole(record[field.name])
        for field in fields
    }
    return kind(**values)
