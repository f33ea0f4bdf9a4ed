"""JSON files of mechanisms."""

from pathlib import Path
from typing import Any

import numpy as np

from .._utils.json_files import EntryError
from .._utils.types import Corners
from .._utils.validation import require_float64
from ..energies.damping import ViscousDamping
from ..mechanism.body import Body
from ..mechanism.expansion import Expansion
from ..mechanism.hinge import Hinge
from ..mechanism.mechanism import COORDINATES, Mechanism
from ..mechanism.outline import AbstractOutline
from ..mechanism.sub_mechanism import SubMechanism
from .energies import energy_from_record, energy_record


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
    from .records import write_record

    require_float64(mechanism.reference)
    write_record(path, "mechanism", _mechanism_record(mechanism))


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
    from .records import read_record

    record = read_record(path, "mechanism")
    try:
        return _mechanism_from_record(record, "mechanism")
    except EntryError as error:
        raise ValueError(f"{path}: {error}") from error


def _mechanism_from_record(record: Any, name: str) -> Mechanism:
    """Create a mechanism from its record, which has this name in the file.

    Raises:
        EntryError: The values of the record do not make a valid mechanism.
    """
    from msgspec.json import encode

    entry = name
    try:
        bodies = []
        for k, body in enumerate(record.bodies):
            entry = f"{name}.bodies[{k}]"
            outline = _to_array(body.outline)
            bodies.append(
                Body(
                    body.name,
                    body.pose,
                    body.mass,
                    body.inertia,
                    outline,
                    body.expansion,
                )
            )
        hinges, energies = [], {}
        for k, hinge in enumerate(record.hinges):
            entry = f"{name}.hinges[{k}]"
            content = encode(hinge.energy)
            if content not in energies:
                energies[content] = energy_from_record(hinge.energy, f"{entry}.energy")
            hinges.append(
                Hinge(
                    hinge.name,
                    hinge.first,
                    hinge.second,
                    energies[content],
                    hinge.at,
                    damping=_damping_from_record(hinge.damping),
                    outline=_outline_from_record(hinge.outline, f"{entry}.outline"),
                    misfit=hinge.misfit,
                    expansion=_expansion_from_record(hinge.expansion),
                )
            )
        entry = name
        return Mechanism(bodies, hinges, fixed=record.fixed)
    except EntryError:
        raise
    except ValueError as error:
        raise EntryError(f"the entry `{entry}`: {error}") from error


def _outline_from_record(record: Any, entry: str) -> np.ndarray | SubMechanism | None:
    """Create the outline of a hinge from its record, which has this name in the file."""
    if hasattr(record, "__struct_fields__"):
        return sub_mechanism_from_record(record, entry)
    return _to_array(record)


def _mechanism_record(mechanism: Mechanism) -> dict[str, Any]:
    """Return the content of the record of a mechanism, for `write_record`."""
    misfits = mechanism.hinge_assembly.misfits
    if misfits is not None and np.any(np.asarray(misfits)[:, 3:]):
        raise ValueError(
            "The mechanism has been expanded by `at_temperature`, but a file contains a "
            "mechanism before its expansion. Save that mechanism."
        )
    bodies = [
        {
            "name": name,
            "pose": mechanism.reference[row],
            "mass": mechanism.masses[row],
            "inertia": mechanism.inertias[row],
            "outline": mechanism.outlines[row],
            "expansion": mechanism.expansions[row],
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
                "at": mechanism.at[row],
                "energy": energy_record(energy),
                "damping": damping,
                "outline": _outline_record(mechanism.hinge_outlines[row]),
                "misfit": mechanism.misfit_of(name),
                "expansion": mechanism.hinge_expansions[row],
            }
        )
    fixed: dict[str, list[str]] = {}
    for dof in mechanism.fixed:
        name = mechanism.names[dof // 3]
        fixed.setdefault(name, []).append(COORDINATES[dof % 3])
    return {"bodies": bodies, "hinges": hinges, "fixed": fixed}


def _outline_record(outline: Corners | AbstractOutline | None) -> Any:
    """Return the content of the record of the outline of a hinge."""
    return sub_mechanism_record(outline) if isinstance(outline, SubMechanism) else outline


def sub_mechanism_record(part: SubMechanism) -> dict[str, Any]:
    """Return the content of the record of a sub-mechanism, for `write_record`."""
    return {"mechanism": _mechanism_record(part.mechanism), "second": part.second}


def sub_mechanism_from_record(record: Any, entry: str) -> SubMechanism:
    """Create a sub-mechanism from its record, which has this name in the file.

    Raises:
        EntryError: The values of the record do not make a valid sub-mechanism.
    """
    mechanism = _mechanism_from_record(record.mechanism, f"{entry}.mechanism")
    try:
        return SubMechanism(mechanism, record.second)
    except ValueError as error:
        raise EntryError(f"the entry `{entry}`: {error}") from error


def _damping_from_record(record: Any) -> ViscousDamping | float | None:
    """Create a damping from its record; a number is a damping time in s."""
    if record is None or isinstance(record, float):
        return record
    return ViscousDamping(
        np.array(record.damping), record.coordinates, resisted=record.resisted
    )


def _expansion_from_record(record: Any) -> Expansion | None:
    """Create the thermal expansion of a hinge from its record."""
    if record is None:
        return None
    return Expansion(
        record.coefficient,
        length=record.length,
        ends=_to_array(record.ends),
        arc_length=record.arc_length,
        centroid=record.centroid,
    )


def _to_array(rows: Any) -> np.ndarray | None:
    """Convert nested sequences of numbers into an array."""
    return None if rows is None else np.array(rows, float)
