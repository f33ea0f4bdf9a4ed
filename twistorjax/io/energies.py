"""JSON files of energies, from which a fitted hinge can be read again."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import jax.numpy as jnp

from .._utils.json_files import EntryError
from ..energies.axial_spring import AxialSpring
from ..energies.base import AbstractEnergy, Scaled, Sum, validation_error
from ..energies.beam_column import BeamColumn
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
from ..flexures.compound.condensed import Condensed
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


def save_energy(energy: AbstractEnergy, path: str | Path) -> None:
    """Write an energy to a JSON file without rounding.

    Args:
        energy: Energy of one of the classes `Quadratic`, `Polynomial`, `Rational`,
            `SumOfSquares`, `MixedEnergy`, `BeamColumn`, `OneFreedomEnergy`,
            `WithValidityRange`, `Condensed`, `PointCharges` and `AxialSpring`, or a sum
            or a multiple of such energies.
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
    from .records import write_record

    write_record(path, "energy", energy_record(energy))


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
    from .records import read_record

    record = read_record(path, "energy")
    try:
        return energy_from_record(record, "energy")
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


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
        return _mechanisms().sub_mechanism_record(value)
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


def _mechanisms():
    """Return the module `mechanisms`, which imports this one."""
    from . import mechanisms

    return mechanisms


def energy_from_record(record: Any, entry: str) -> AbstractEnergy:
    """Create an energy from its record, which has this name in the file.

    Raises:
        EntryError: The values of the record do not make a valid energy.
    """

    def to_argument(name: str, value: Any) -> Any:
        if name == "part":
            return _mechanisms().sub_mechanism_from_record(value, f"{entry}.part")
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
