"""Conversion of energies and mechanisms to the content of JSON files, and back.

An object of a file has the fields of the class that is created from it. The annotation of
a field is its type in the file, and a field with a default may be missing, as in files of
earlier layouts. Energies and stress models also have the field `kind`, the name of their
class. The values are checked by the classes.
"""

import json
from collections.abc import Callable, Collection, Sequence
from dataclasses import fields
from functools import cache
from inspect import Parameter, signature
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints, Literal, NamedTuple, Union

import equinox as eqx
from jaxtyping import AbstractArray, Array, Float
from typing_extensions import TypeAliasType

from .._utils.host import as_float
from .._utils.json_files import describe_value, entry_name, Keys
from .._utils.types import NumberLike, Point, Scalar
from .._utils.validation import listing
from ..energies.axial_spring import AxialSpring
from ..energies.base import AbstractEnergy, Scaled, Sum
from ..energies.beam_column import BeamColumn
from ..energies.contact import CornerContact, Stop
from ..energies.mixed import MixedEnergy
from ..energies.one_freedom import OneFreedomEnergy
from ..energies.point_charges import PointCharges
from ..energies.polynomial import Polynomial, Rational, SumOfSquares
from ..energies.quadratic import Quadratic
from ..energies.stress_model import AbstractStressModel
from ..energies.validity import WithValidityRange
from ..flexures.beams.stress_models import (
    BeamColumnStress,
    BeamStress,
    MechanismStress,
    SectionStress,
)
from ..flexures.condensed import Condensed
from ..flexures.contours.leaves import filleted_leaf, reinforced_leaf
from ..flexures.contours.notches import elliptical_notch, parabolic_notch, v_notch
from ..flexures.leaf import leaf, linear_leaf, quartic_leaf
from ..flexures.notch import notch
from ..mechanism.body import Body
from ..mechanism.hinge import AbstractOutline, Hinge
from ..mechanism.material import Expansion, Material
from ..mechanism.mechanism import COORDINATES, Mechanism
from ..mechanism.sub_mechanism import SubMechanism


# Energies and stress models that can be saved
_CLASSES = {
    saved.__name__: saved
    for saved in (
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
        Stop,
        CornerContact,
        Sum,
        Scaled,
        SectionStress,
        BeamColumnStress,
        BeamStress,
        MechanismStress,
    )
}
# Functions that create an energy from dimensions. A file that is read may have their
# names as `kind`.
_FLEXURES: dict[str, Callable[..., AbstractEnergy]] = {
    create.__name__: create
    for create in (
        leaf,
        linear_leaf,
        quartic_leaf,
        notch,
        filleted_leaf,
        reinforced_leaf,
        elliptical_notch,
        parabolic_notch,
        v_notch,
    )
}
# Base classes of objects with the field `kind`, and their names in messages
_NOUNS = {AbstractEnergy: "An energy", AbstractStressModel: "A stress model"}

# A file has the pose `at` of a hinge instead of its ports.
_NOT_IN_FILES = {"ports", "misfit_of_ports"}

# Types of JSON in words, for annotations and for the content of entries
_JSON_TYPES = {
    NoneType: "null",
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "text",
    Literal: "text",
    list: "a list",
    tuple: "a list",
    dict: "an object",
}


def to_record(value: Any) -> Any:
    """Convert a part of a model to the content of an entry: objects, lists, values."""
    if isinstance(value, Mechanism):
        value = _fields_of_mechanism(value)
    elif isinstance(value, eqx.Module):
        value = _fields(value)
    if isinstance(value, dict):
        return {name: to_record(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [to_record(part) for part in value]
    return value.tolist() if hasattr(value, "tolist") else value


def _fields(part: eqx.Module) -> dict[str, Any]:
    values = {field.name: getattr(part, field.name) for field in fields(part)}
    name = type(part).__name__
    for base, noun in _NOUNS.items():
        if isinstance(part, base):
            if _CLASSES.get(name) is not type(part):
                advice = ""
                if base is AbstractEnergy:
                    advice = " Sample an energy of your own, and fit it by `fit_energy`."
                raise ValueError(
                    f"{noun} of the class {name} cannot be saved. Classes that can be "
                    f"saved are {', '.join(_kinds(base))}.{advice}"
                )
            return {"kind": name, **values}
    return values


def _kinds(base: type) -> list[str]:
    """List the names of the subclasses that can be saved."""
    return [name for name, saved in _CLASSES.items() if issubclass(saved, base)]


def _fields_of_mechanism(mechanism: Mechanism) -> dict[str, Any]:
    assembly = mechanism.hinge_assembly
    if mechanism.thermal_strains is not None:
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
            "tilt_inertia": mechanism.tilt_inertias[row],
        }
        for row, name in enumerate(mechanism.names)
    ]
    hinges = []
    for row, name in enumerate(mechanism.hinge_names):
        first, second = assembly.ends[row]
        energy, damping = assembly.energy_and_damping_of(row)
        hinges.append(
            {
                "name": name,
                "first": mechanism.names[first],
                "second": mechanism.names[second],
                "at": mechanism.at[row],
                "energy": energy,
                "damping": damping,
                "outline": mechanism.hinge_outlines[row],
                "misfit": mechanism.misfit_of(name),
                "expansion": mechanism.hinge_expansions[row],
            }
        )
    fixed: dict[str, list[str]] = {}
    for dof in mechanism.fixed:
        name = mechanism.names[dof // 3]
        fixed.setdefault(name, []).append(COORDINATES[dof % 3])
    return {"bodies": bodies, "hinges": hinges, "fixed": fixed}


class Entry(NamedTuple):
    """An entry of a file."""

    content: Any
    keys: Keys  # from the root of the file

    def part(self, key: str | int) -> "Entry":
        return Entry(self.content[key], (*self.keys, key))

    @property
    def name(self) -> str:
        return f"the entry `{entry_name(self.keys)}`"

    def mismatch(self, expected: str) -> ValueError:
        """Create the error for an entry that is not what is expected."""
        value = describe_value(self.content)
        return ValueError(f"{self.name} is {value}, but must be {expected}.")

    def require_type(self, expected: Collection[str]) -> str:
        """Return the JSON type of the entry, which must be one of those expected."""
        found = _JSON_TYPES[type(self.content)]
        if found == "a whole number" and found not in expected:
            found = "a number"
        if found not in expected:
            raise self.mismatch(" or ".join(expected))
        return found


def from_record(annotation: Any, entry: Entry) -> Any:
    """Create a value of a type, such as a class, from its entry in a file."""
    options = {_json_type(option): option for option in _options(annotation)}
    if annotation is Material and isinstance(entry.content, str):
        return _named_material(entry)
    json_type = entry.require_type(options)
    option = options[json_type]
    if json_type == "an object":
        return _object(option, entry)
    if _is_array(option):
        return _array(option, entry)
    if json_type == "a list":
        item, _ = get_args(option)  # of `tuple[item, ...]`
        return tuple(from_record(item, entry.part(k)) for k in range(len(entry.content)))
    if get_origin(option) is Literal and entry.content not in get_args(option):
        raise entry.mismatch(f"one of {', '.join(get_args(option))}")
    return entry.content


def _options(annotation: Any) -> list[Any]:
    """List the types of a union."""
    if annotation is NumberLike:
        return _options(Scalar)
    if isinstance(annotation, TypeAliasType):
        return _options(annotation.__value__)
    if get_origin(annotation) in (Union, UnionType):
        return [option for part in get_args(annotation) for option in _options(part)]
    return [annotation]


def _json_type(annotation: Any) -> str:
    if _is_array(annotation):
        return "a list" if annotation.dim_str else "a number"
    return _JSON_TYPES.get(get_origin(annotation) or annotation, "an object")


def _is_array(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, AbstractArray)


def _array(annotation: Any, entry: Entry) -> Array:
    numbers = _numbers(annotation.dim_str.split(), entry)
    try:
        return as_float(numbers)
    except ValueError:
        raise ValueError(
            f"{entry.name} has rows of different lengths, but must be an array."
        ) from None


def _numbers(axes: Sequence[str], entry: Entry) -> Any:
    """Check nested lists of numbers; an axis is a name or, if it is fixed, a length."""
    entry.require_type(["a list" if axes else "a number"])
    if not axes:
        return entry.content
    axis, *inner = axes
    if axis.isdigit() and len(entry.content) != int(axis):
        raise entry.mismatch(f"a list of {axis} entries")
    return [_numbers(inner, entry.part(k)) for k in range(len(entry.content))]


def _object(annotation: Any, entry: Entry) -> Any:
    content = entry.content
    if get_origin(annotation) is dict:
        _, item = get_args(annotation)
        return {name: from_record(item, entry.part(name)) for name in content}
    create: Any = annotation
    if annotation in _NOUNS:
        create = _created_by_kind(annotation, entry)
        content = {name: part for name, part in content.items() if name != "kind"}
    create = _CREATE.get(create, create)
    layout = _layout(create)
    for name in content:
        if name not in layout:
            unknown = entry_name([name])
            raise ValueError(
                f"{entry.name} has the unknown field `{unknown}`. Its fields are "
                f"{listing(layout)}."
            )
    for name, (_, is_required) in layout.items():
        if is_required and name not in content:
            raise ValueError(f"{entry.name} lacks the field `{name}`.")
    arguments = {name: from_record(layout[name][0], entry.part(name)) for name in content}
    try:
        value = create(**arguments)
        if isinstance(value, AbstractEnergy) and (error := value.validation_error()):
            raise ValueError(error)
    except ValueError as error:
        raise ValueError(f"{entry.name}: {error}") from error
    return value


def _created_by_kind(base: type, entry: Entry) -> Callable[..., Any]:
    """Return the class or the function that the field `kind` names."""
    if "kind" not in entry.content:
        raise ValueError(f"{entry.name} lacks the field `kind`.")
    kind, creators = entry.part("kind"), {name: _CLASSES[name] for name in _kinds(base)}
    if base is AbstractEnergy:
        creators = creators | _FLEXURES
    if kind.content not in list(creators):
        raise kind.mismatch(f"one of {', '.join(creators)}")
    return creators[kind.content]


def _named_material(entry: Entry) -> Material:
    try:
        return Material.named(entry.content)
    except ValueError as error:
        raise ValueError(f"{entry.name}: {error}") from None


@cache
def _layout(create: Callable[..., Any]) -> dict[str, tuple[Any, bool]]:
    """Return the type of each field of an object, and whether it is required.

    They are those of the fields of a class, or of the parameters of a function. Those of
    a material are its arguments, because its strengths are one field.
    """
    parameters = signature(create).parameters
    if create is Material:
        types, names = get_type_hints(Material.__init__), list(parameters)
    elif isinstance(create, type):
        types = get_type_hints(create)
        names = [f.name for f in fields(create) if f.name not in _NOT_IN_FILES]
    else:
        types, names = get_type_hints(create), list(parameters)
    return {
        name: (
            types[name],
            name not in parameters or parameters[name].default is Parameter.empty,
        )
        for name in names
    }


def _create_mechanism(
    bodies: tuple[Body, ...],
    hinges: tuple[Hinge, ...],
    fixed: dict[str, tuple[str, ...]] | tuple[str, ...],
) -> Mechanism:
    """Create a mechanism in which equal energies of several hinges are one energy."""
    energies: dict[str, AbstractEnergy] = {}
    shared = []
    for hinge in hinges:
        content = json.dumps(to_record(hinge.energy))
        energy = energies.setdefault(content, hinge.energy)
        shared.append(eqx.tree_at(lambda hinge: hinge.energy, hinge, energy))
    return Mechanism(bodies, shared, fixed)


def _create_expansion(
    coefficient: Scalar,
    length: Scalar | None = None,
    ends: Float[Array, "2 2"] | None = None,
    arc_length: Scalar | None = None,
    centroid: Point | None = None,
) -> Expansion:
    return Expansion(
        coefficient, length=length, ends=ends, arc_length=arc_length, centroid=centroid
    )


# What creates objects of classes that are not created from their own fields
_CREATE: dict[type, Callable[..., Any]] = {
    AbstractOutline: SubMechanism,
    Expansion: _create_expansion,
    Mechanism: _create_mechanism,
}
