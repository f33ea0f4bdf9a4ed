"""JSON files of energies and mechanisms."""

import warnings
from pathlib import Path
from typing import TypeVar

from .._utils.json_files import (
    describe_value,
    find_invalid_entry,
    read_json,
    TOO_DEEP,
    write_json,
)
from .._utils.validation import require_float64, require_instance, shorten
from ..energies.base import AbstractEnergy
from ..mechanism.mechanism import Mechanism
from .records import Entry, from_record, to_record


VERSION = 6
# Version 2 has neither misfits nor expansions, version 3 no sub-mechanisms, version 4 no
# stress models, and version 5 no beam-columns.
_READABLE_VERSIONS = (2, 3, 4, 5, VERSION)

Model = TypeVar("Model", AbstractEnergy, Mechanism)


def save_energy(energy: AbstractEnergy, path: str | Path) -> None:
    """Write an energy to a JSON file without rounding.

    Args:
        energy: Energy of a class of the library except `ExactBeam`, or a sum or a
            multiple of such energies.
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
    _save("energy", AbstractEnergy, energy, path)


def load_energy(path: str | Path) -> AbstractEnergy:
    """Read an energy from a JSON file that `save_energy` wrote.

    Args:
        path: Path of the file.

    Returns:
        The same energy, without rounding.

    Raises:
        ValueError: The file is damaged or of another version, or an entry is unknown,
            missing or out of range. The message names the file and the entry.
        OSError: The file cannot be read.
    """
    return _load("energy", AbstractEnergy, path)


def save_mechanism(mechanism: Mechanism, path: str | Path) -> None:
    """Write a mechanism to a JSON file without rounding.

    Args:
        mechanism: The mechanism. The energies of its hinges must be of the classes that
            `save_energy` can write.
        path: Path of the file. A file that exists is replaced once the new one is
            complete.

    Raises:
        ValueError: Double precision is disabled; the mechanism is that at another
            temperature; a hinge has an energy of another class; a name cannot be written
            as UTF-8; or a value is not finite. Nothing is written.
        OSError: The file cannot be written.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> from twistorjax.examples import stage
        >>> with TemporaryDirectory() as folder:
        ...     save_mechanism(stage.microstage(), f"{folder}/stage.json")
        ...     load_mechanism(f"{folder}/stage.json")
        Mechanism of 6 bodies (1, 2, 3, 4, 5, 6), 7 hinges (a, b, c, d, e, f, g);
        fixed: 1, angle and y of 6
    """
    require_float64(mechanism.reference)
    _save("mechanism", Mechanism, mechanism, path)


def load_mechanism(path: str | Path) -> Mechanism:
    """Read a mechanism from a JSON file that `save_mechanism` or a user wrote.

    All values are in SI units. The manual page on files shows the layout.

    Args:
        path: Path of the file.

    Returns:
        The mechanism. Hinges with equal energies share one energy.

    Raises:
        ValueError: The file is damaged or of another version; an entry is unknown,
            missing, of a wrong type or out of range; or the entries do not make a valid
            mechanism. The message names the file and the entry.
        OSError: The file cannot be read.
    """
    return _load("mechanism", Mechanism, path)


def _save(name: str, kind: type[Model], model: Model, path: str | Path) -> None:
    """Write the file of a model, if it can be read again."""
    try:
        content = to_record(require_instance(name, model, kind))
        if error := find_invalid_entry({name: content}):
            raise ValueError(error)
        with warnings.catch_warnings(action="ignore"):
            from_record(kind, Entry(content, (name,)))
    except RecursionError:
        raise ValueError(f"{path} is not written: the {name} {TOO_DEEP}") from None
    except ValueError as error:
        raise ValueError(f"{path} is not written: {error}") from None
    write_json(path, {"twistorjax": VERSION, name: content})


def _load(name: str, kind: type[Model], path: str | Path) -> Model:
    content = read_json(path)
    if not isinstance(content, dict):
        raise ValueError(f"{path} is {describe_value(content)}, but must be an object.")
    version = content.get("twistorjax")
    if type(version) is not int or version not in _READABLE_VERSIONS:
        raise ValueError(
            f"{path} has a layout that this version of twistorjax cannot read: its field "
            f"`twistorjax` is {describe_value(version)}, but must be "
            f"one of {', '.join(map(str, _READABLE_VERSIONS))}."
        )
    if set(content) != {"twistorjax", name}:
        raise ValueError(
            f"{path} has the fields {shorten(', '.join(content))}, but must have "
            f"only `twistorjax` and `{name}`."
        )
    try:
        return from_record(kind, Entry(content[name], (name,)))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
