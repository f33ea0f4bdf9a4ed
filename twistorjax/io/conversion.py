"""Energies and mechanisms as records of JSON files, and back."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._utils.json_files import EntryError
from .._utils.types import Corners
from ..energies.axial_spring import AxialSpring
from ..energies.base import AbstractEnergy, Scaled, Sum, validation_error
from ..energies.beam_column import BeamColumn
from ..energies.damping import ViscousDamping
from ..energies.mixed import MixedEnergy
from ..energies.one_freedom import OneFreedomEnergy
from ..energies.point_charges import PointCharges
from ..energies.polynomial import Polynomial, Rational, SumOfSquares
from ..energies.quadratic import Quadratic
from ..energies.stress_model import AbstractStressModel, Strengths
from ..energies.validity import WithValidityRange
from ..flexures.beams.stress_models import (
    BeamColumnStress,
    BeamStress,
    MechanismStress,
    SectionStress,
)
from ..flexures.condensed import Condensed
from ..mechanism.body import Body
from ..mechanism.hinge import AbstractOutline, Hinge
from ..mechanism.material import Expansion
from ..mechanism.mechanism import COORDINATES, Mechanism
from ..mechanism.sub_mechanism import SubMechanism


_CLASSES = {
    energy_class.__name__: energy_class
    for energy_class in (
        Quadratic,
        Polynomial,
        Rational,
        SumOfSquares,
        MixedEnergy,
        BeamColumn,
        WithValidityRange,
        OneFreedomEnergy,
        Condensed,
        PointCharges,
        AxialSpring,
        Sum,
        Scaled,
    )
}


_STRESS_MODELS = {
    model.__name__: model
    for model in (SectionStress, BeamColumnStress, BeamStress, MechanismStress)
}


def energy_record(energy: AbstractEnergy) -> dict[str, Any]:
    """Return the content of the record of an energy, for `write_record`.

    Raises:
        ValueError: The energy, or an energy in it, is of another class.
    """
    try:
        return _record("An energy", energy, _CLASSES)
    except RecursionError:
        raise ValueError(
            "The energy cannot be saved, because it has too many nested sums."
        ) from None


def _record(noun: str, value: Any, classes: Mapping[str, type]) -> dict[str, Any]:
    """Return the content of the record of an energy or a stress model.

    Raises:
        ValueError: It is of another class.
    """
    name = type(value).__name__
    if classes.get(name) is not type(value):
        raise ValueError(
            f"{noun} of the class {name} cannot be saved. Classes that can be saved are "
            f"{', '.join(classes)}."
        )
    content = {
        field.name: _content(getattr(value, field.name)) for field in fields(value)
    }
    return {"kind": name, **content}


def _content(value: Any) -> Any:
    """Return the content of a field of a record."""
    if isinstance(value, AbstractEnergy):
        return _record("An energy", value, _CLASSES)
    if isinstance(value, AbstractStressModel):
        return _record("A stress model", value, _STRESS_MODELS)
    if isinstance(value, SubMechanism):
        return sub_mechanism_record(value)
    if isinstance(value, Strengths):
        return value._asdict()
    return [_content(part) for part in value] if isinstance(value, tuple) else value


def _stress_from_record(record: Any) -> AbstractStressModel:
    """Create a stress model from its record."""

    def to_argument(name: str, value: Any) -> Any:
        if value is None or isinstance(value, str):
            return value
        if name == "parts":
            return tuple(map(_stress_from_record, value))
        if name == "powers":
            return tuple(map(tuple, value))
        if name == "strengths":
            return Strengths(**arguments(value))
        return jnp.asarray(value, float)

    def arguments(record: Any) -> dict[str, Any]:
        names = record.__struct_fields__
        return {name: to_argument(name, getattr(record, name)) for name in names}

    return _STRESS_MODELS[type(record).__name__](**arguments(record))


def energy_from_record(record: Any, entry: str) -> AbstractEnergy:
    """Create an energy from its record, which has this name in the file.

    Raises:
        EntryError: The values of the record do not make a valid energy.
    """

    def to_argument(name: str, value: Any) -> Any:
        if name == "part":
            return sub_mechanism_from_record(value, f"{entry}.part")
        if value is None:
            return None
        if name == "stress_model":
            return _stress_from_record(value)
        if hasattr(value, "__struct_fields__"):  # the record of an energy
            return energy_from_record(value, f"{entry}.{name}")
        if name == "parts":
            return tuple(to_argument(f"parts[{k}]", part) for k, part in enumerate(value))
        if name in ("powers", "coordinates", "flexure", "freedom"):
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


def mechanism_from_record(record: Any, name: str) -> Mechanism:
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


def mechanism_record(mechanism: Mechanism) -> dict[str, Any]:
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
    return {"mechanism": mechanism_record(part.mechanism), "second": part.second}


def sub_mechanism_from_record(record: Any, entry: str) -> SubMechanism:
    """Create a sub-mechanism from its record, which has this name in the file.

    Raises:
        EntryError: The values of the record do not make a valid sub-mechanism.
    """
    mechanism = mechanism_from_record(record.mechanism, f"{entry}.mechanism")
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
