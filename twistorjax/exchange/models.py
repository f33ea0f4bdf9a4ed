"""Mechanisms as JSON, written and read to the last bit."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from .._checks import need_float64
from ..body import Body
from ..damping import Viscous
from ..hinge import Hinge
from ..mechanism import COORDINATES, Mechanism
from ..storage import energy_from, energy_told, read_record, write_record


_BODY = ("name", "rest", "mass", "inertia", "outline")
_HINGE = ("name", "first", "second", "at", "energy", "damping", "outline")
_DAMPING = ("damping", "coordinates", "resisted")
_MODEL = ("bodies", "hinges", "held")


def save_mechanism(mechanism: Mechanism, path: str | Path) -> None:
    """Writes a mechanism as JSON, to the last bit.

    Args:
        mechanism: whose hinges have energies that `save_energy` can write.
        path: of the file; one that is there is replaced.

    Raises:
        ValueError: double precision is off; a hinge has an energy of another kind.
        OSError: the file cannot be written.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> from twistorjax.cases import stage
        >>> with TemporaryDirectory() as folder:
        ...     save_mechanism(stage.microstage(), f"{folder}/stage.json")
        ...     load_mechanism(f"{folder}/stage.json")
        Mechanism of 6 bodies (1, 2, 3, 4, 5, 6), 7 hinges (a, b, c, d, e, f, g);
        held: 1, angle and y of 6
    """
    need_float64(mechanism.rest)
    bodies = [
        {
            "name": name,
            "rest": _numbers(mechanism.rest[row]),
            "mass": _numbers(mechanism.masses[row]),
            "inertia": _numbers(mechanism.inertias[row]),
            "outline": _numbers(mechanism.outlines[row]),
        }
        for row, name in enumerate(mechanism.names)
    ]
    hinges = []
    for row, (name, (first, second)) in enumerate(
        zip(mechanism.hinge_names, mechanism.couplings.ends, strict=True)
    ):
        energy, damping = mechanism.couplings.energy_and_damping_of(row)
        hinges.append(
            {
                "name": name,
                "first": mechanism.names[first],
                "second": mechanism.names[second],
                "at": _numbers(mechanism.at[row]),
                "energy": energy_told(energy),
                "damping": None if damping is None else _damping_told(damping),
                "outline": _numbers(mechanism.hinge_outlines[row]),
            }
        )
    held: dict[str, list[str]] = {}
    for place in mechanism.held:
        name = mechanism.names[place // 3]
        held.setdefault(name, []).append(COORDINATES[place % 3])
    model = {"bodies": bodies, "hinges": hinges, "held": held}
    write_record(path, "mechanism", model)


def load_mechanism(path: str | Path) -> Mechanism:
    """Reads a mechanism that `save_mechanism` wrote, or that was written by hand.

    Raises:
        ValueError: the file is not whole, of another version, lacks a field or has one
            that is unknown, or makes no mechanism.
        OSError: the file cannot be read.
    """
    model = read_record(path, "mechanism")
    try:
        _need("the mechanism", model, _MODEL)
        bodies = [
            Body(**_outlined(_need(f"bodies[{k}]", body, _BODY)))
            for k, body in enumerate(model["bodies"])
        ]
        hinges, kinds = [], {}
        for k, hinge in enumerate(model["hinges"]):
            told = _outlined(_need(f"hinges[{k}]", hinge, _HINGE))
            damping = told["damping"]
            if isinstance(damping, dict):
                _need(f"the damping of hinges[{k}]", damping, _DAMPING)
                damping = Viscous(
                    np.array(damping["damping"], float), damping["coordinates"],
                    resisted=damping["resisted"],
                )  # fmt: skip
            # hinges of one kind share their energy, as those that were written did
            kind = json.dumps(told["energy"])
            if kind not in kinds:
                try:
                    kinds[kind] = energy_from(told["energy"])
                except (ValueError, TypeError) as error:
                    where = f"the energy of hinges[{k}], {told['name']!r}"
                    raise ValueError(f"{where}: {error}") from error
            told |= {"energy": kinds[kind], "damping": damping}
            hinges.append(Hinge(**told))
        return Mechanism(bodies, hinges, held=model["held"])
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path} holds no mechanism: {error}") from error


def _outlined(record: dict[str, Any]) -> dict[str, Any]:
    """The record with its outline as an array."""
    if (outline := record["outline"]) is None:
        return record
    try:
        corners = np.array(outline, float).reshape(-1, 2)
    except ValueError:
        raise ValueError(
            f"`outline` of {record['name']!r} must be rows (x, y), three or more."
        ) from None
    if len(corners) < 3:
        raise ValueError(
            f"`outline` of {record['name']!r} has {len(corners)} corners, not three."
        )
    return {**record, "outline": corners}


def _numbers(value: Any) -> Any:
    return None if value is None else np.asarray(value).tolist()


def _damping_told(damping: Viscous) -> dict[str, Any]:
    return {
        "damping": _numbers(damping.damping),
        "coordinates": damping.coordinates,
        "resisted": damping.resisted,
    }


def _need(where: str, record: Any, fields: tuple[str, ...]) -> dict[str, Any]:
    """The record, if it has these fields and no other."""
    if not isinstance(record, dict):
        raise ValueError(f"{where} is a {type(record).__name__}, but must be an object.")
    missing = [name for name in fields if name not in record]
    unknown = [name for name in record if name not in fields]
    if missing or unknown:
        words = [
            f"{word} {', '.join(map(repr, names))}"
            for word, names in (("lacks", missing), ("has the unknown", unknown))
            if names
        ]
        raise ValueError(f"{where} {' and '.join(words)}.")
    return record
