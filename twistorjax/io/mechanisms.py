"""Mechanisms as JSON, written and read to the last bit."""

from pathlib import Path
from typing import Any

import numpy as np

from .._utils.json_files import EntryError
from .._utils.validation import require_float64
from ..energies.damping import ViscousDamping
from ..mechanism.body import Body
from ..mechanism.hinge import Hinge
from ..mechanism.mechanism import COORDINATES, Mechanism
from .energies import energy_from, energy_told, read_record, write_record


def save_mechanism(mechanism: Mechanism, path: str | Path) -> None:
    """Write a mechanism as JSON, to the last bit.

    Args:
        mechanism: The mechanism. The energies of its hinges must be of the kinds that
            `save_energy` can write.
        path: Path of the file. A file that exists is replaced once the new one is
            complete.

    Raises:
        ValueError: Double precision is off; a hinge has an energy of another kind; a
            name cannot be written as UTF-8; a value is not finite. Nothing is written.
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
    bodies = [
        {
            "name": name,
            "pose": _numbers(mechanism.reference[row]),
            "mass": _numbers(mechanism.masses[row]),
            "inertia": _numbers(mechanism.inertias[row]),
            "outline": _numbers(mechanism.outlines[row]),
        }
        for row, name in enumerate(mechanism.names)
    ]
    hinges = []
    for row, (name, (first, second)) in enumerate(
        zip(mechanism.hinge_names, mechanism.hinge_assembly.ends, strict=True)
    ):
        energy, damping = mechanism.hinge_assembly.energy_and_damping_of(row)
        hinges.append(
            {
                "name": name,
                "first": mechanism.names[first],
                "second": mechanism.names[second],
                "at": _numbers(mechanism.at[row]),
                "energy": energy_told(energy),
                "damping": _damping_told(damping),
                "outline": _numbers(mechanism.hinge_outlines[row]),
            }
        )
    fixed: dict[str, list[str]] = {}
    for place in mechanism.fixed:
        name = mechanism.names[place // 3]
        fixed.setdefault(name, []).append(COORDINATES[place % 3])
    model = {"bodies": bodies, "hinges": hinges, "fixed": fixed}
    write_record(path, "mechanism", model)


def load_mechanism(path: str | Path) -> Mechanism:
    """Read a mechanism that `save_mechanism` wrote, or that was written by hand.

    Args:
        path: Path of the file.

    Returns:
        The mechanism. Hinges whose energies are equal share one.

    Raises:
        ValueError: The file is damaged or of another version; an entry is unknown,
            missing, of a wrong type or out of range; or the entries do not make a
            mechanism. The message names the file and the entry.
        OSError: The file cannot be read.
    """
    from msgspec.json import encode

    model = read_record(path, "mechanism")
    where = "mechanism"
    try:
        bodies = []
        for k, told in enumerate(model.bodies):
            where = f"mechanism.bodies[{k}]"
            bodies.append(
                Body(
                    told.name,
                    told.pose,
                    told.mass,
                    told.inertia,
                    _array(told.outline),
                )
            )
        hinges, energies = [], {}
        for k, told in enumerate(model.hinges):
            where = f"mechanism.hinges[{k}]"
            content = encode(told.energy)
            if content not in energies:
                energies[content] = energy_from(told.energy, f"{where}.energy")
            hinges.append(
                Hinge(
                    *(told.name, told.first, told.second, energies[content], told.at),
                    damping=_damping_of(told.damping),
                    outline=_array(told.outline),
                )
            )
        where = "mechanism"
        return Mechanism(bodies, hinges, fixed=model.fixed)
    except EntryError as error:
        raise ValueError(f"{path}: {error}") from error
    except ValueError as error:
        raise ValueError(f"{path}: the entry `{where}`: {error}") from error


def _damping_of(record: Any) -> ViscousDamping | float | None:
    """The damping of a record; a number is a time, in s."""
    if record is None or isinstance(record, float):
        return record
    return ViscousDamping(
        np.array(record.damping), record.coordinates, resisted=record.resisted
    )


def _array(rows: Any) -> np.ndarray | None:
    return None if rows is None else np.array(rows, float)


def _numbers(value: Any) -> Any:
    return None if value is None else np.asarray(value).tolist()


def _damping_told(damping: ViscousDamping | Any) -> Any:
    """The record of a damping; that of a time is a number, in s."""
    if not isinstance(damping, ViscousDamping):
        return _numbers(damping)
    return {
        "damping": _numbers(damping.damping),
        "coordinates": damping.coordinates,
        "resisted": damping.resisted,
    }
