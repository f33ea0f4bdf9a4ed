"""Records of energies and mechanisms in JSON files.

A record has the name and the fields of the class that is created from it. The types of
the fields are the layout of the files, which is checked when a file is read or written.
Properties of several entries together, such as the symmetry of a stiffness, are checked
by the classes. This module is imported only where a file is read or written, because it
imports msgspec.
"""

# ruff: noqa: D101

import re
from pathlib import Path
from typing import Annotated, Any, get_args, Literal

import msgspec
import numpy as np
from msgspec import Meta

from .._utils.json_files import (
    describe_value,
    entry_name,
    find_invalid_entry,
    read_json,
    write_json,
)
from .._utils.validation import shorten
from ..energies.polynomial import LARGEST_POWER


VERSION = 6
# Version 2 has neither misfits nor expansions, version 3 no sub-mechanisms, version 4 no
# stress models, and version 5 no beam-columns.
_READABLE_VERSIONS = (2, 3, 4, 5, VERSION)

Pair = tuple[float, float]
Triple = tuple[float, float, float]
Matrix = tuple[Triple, Triple, Triple]
Power = Annotated[int, Meta(ge=0, le=LARGEST_POWER)]
Powers = list[list[Power]]
Corners = Annotated[list[Pair], Meta(min_length=3)]
_SECTIONS = Meta(min_length=201, max_length=201)
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]


class _Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base class of all objects in a file. Fields without a default are required."""


class Strengths(_Record, frozen=True):
    static: Positive | None
    ultimate: Positive | None
    endurance: Positive | None


class _StressRecord(_Record, frozen=True, tag_field="kind", tag=True):
    """Base class of stress models. The field `kind` holds the name of the class."""


class SectionStress(_StressRecord, frozen=True):
    arm: NotNegative
    thickness: Positive
    width: Positive
    ratio: NotNegative
    strengths: Strengths


class BeamColumnStress(_StressRecord, frozen=True):
    length: Positive
    thickness: Positive
    width: Positive
    modulus: Positive
    strengths: Strengths
    shear_ratio: Positive | None = None


class BeamStress(_StressRecord, frozen=True):
    thickness: Annotated[list[Positive], _SECTIONS]
    curvature: Annotated[list[float], _SECTIONS] | None
    length: Positive
    width: Positive
    modulus: Positive
    bending_factor: Positive
    shear_ratio: Positive | None
    strengths: Strengths
    law: Literal["linear", "saint-venant-kirchhoff"]


class MechanismStress(_StressRecord, frozen=True):
    parts: Annotated[list["StressModel"], Meta(min_length=1)]
    coefficients: list[list[list[float]]]
    length: Positive
    force: Positive
    strengths: Strengths
    powers: Powers
    freedom: Literal["rotation", "transverse"]

    def __post_init__(self) -> None:
        shape = len(self.parts), 6, len(self.powers)
        lengths = [len(self.coefficients), *map(len, self.coefficients)]
        rows = [len(row) for part in self.coefficients for row in part]
        if lengths != [shape[0]] + shape[0] * [6] or any(n != shape[2] for n in rows):
            raise ValueError(
                f"`coefficients` must have the shape {shape}: six rows for each of the "
                "`parts`, with one coefficient for each of the `powers`."
            )
        if any(len(row) != 3 for row in self.powers):
            raise ValueError("Each row of `powers` must have three entries.")


StressModel = SectionStress | BeamColumnStress | BeamStress | MechanismStress


class _EnergyRecord(_Record, frozen=True, tag_field="kind", tag=True):
    """Base class of energies. The field `kind` holds the name of the class."""


class Quadratic(_EnergyRecord, frozen=True):
    stiffness: Matrix
    coordinates: str
    flexure: bool = False
    stress_model: StressModel | None = None


class Polynomial(_EnergyRecord, frozen=True):
    coefficients: list[float]
    scale: float
    powers: Powers
    coordinates: str


class Rational(_EnergyRecord, frozen=True):
    numerator: "Energy"
    denominator: "Energy"


class SumOfSquares(_EnergyRecord, frozen=True):
    coefficients: list[list[float]]
    scale: float
    powers: Powers
    coordinates: str

    def __post_init__(self) -> None:
        for k, row in enumerate(self.coefficients):
            if len(row) != len(self.powers):
                raise ValueError(
                    f"`coefficients[{k}]` has {len(row)} entries, but there are "
                    f"{len(self.powers)} `powers`. Give one coefficient for each of them."
                )


class MixedEnergy(_EnergyRecord, frozen=True):
    coefficients: list[float]
    length: float
    force: float
    powers: Powers
    flexure: bool = False
    stress_model: StressModel | None = None


class BeamColumn(_EnergyRecord, frozen=True):
    length: Positive
    bending_stiffness: Positive
    axial_stiffness: Positive
    shear_stiffness: Positive | None = None
    stress_model: StressModel | None = None


class WithValidityRange(_EnergyRecord, frozen=True):
    energy: "Energy"
    rotation: float
    force: float
    error: Triple
    displacement: float | None = None
    stress_model: StressModel | None = None


class OneFreedomEnergy(_EnergyRecord, frozen=True):
    coefficients: list[float]
    length: float
    force: float
    powers: Powers
    freedom: str


class Condensed(_EnergyRecord, frozen=True):
    part: "SubMechanism"


class PointCharges(_EnergyRecord, frozen=True):
    charges_a: list[float]
    sites_a: list[Pair]
    charges_b: list[float]
    sites_b: list[Pair]
    constant: float


class AxialSpring(_EnergyRecord, frozen=True):
    stiffness: float
    length: float


class Sum(_EnergyRecord, frozen=True):
    parts: Annotated[list["Energy"], Meta(min_length=1)]


class Scaled(_EnergyRecord, frozen=True):
    factor: float
    energy: "Energy"


Energy = (
    Quadratic
    | Polynomial
    | Rational
    | SumOfSquares
    | MixedEnergy
    | BeamColumn
    | WithValidityRange
    | OneFreedomEnergy
    | Condensed
    | PointCharges
    | AxialSpring
    | Sum
    | Scaled
)


class Damping(_Record, frozen=True):
    damping: Matrix
    coordinates: str
    resisted: bool


class Body(_Record, frozen=True):
    name: str
    pose: Triple
    mass: float | None
    inertia: float | None
    outline: Corners | None
    expansion: float | None = None


class Expansion(_Record, frozen=True):
    coefficient: float
    length: float | None = None
    ends: Annotated[list[Pair], Meta(min_length=2, max_length=2)] | None = None
    arc_length: float | None = None
    centroid: Pair | None = None


class Hinge(_Record, frozen=True):
    name: str
    first: str
    second: str
    at: Triple
    energy: Energy
    damping: float | Damping | None  # A number is a damping time; s.
    outline: "Corners | SubMechanism | None"
    misfit: Triple | None = None
    expansion: Expansion | None = None


class Mechanism(_Record, frozen=True):
    bodies: list[Body]
    hinges: list[Hinge]
    fixed: dict[str, Any] | list[str]

    def __post_init__(self) -> None:
        # msgspec would not report the name of the body.
        if not isinstance(self.fixed, dict):
            return
        for name, coordinates in self.fixed.items():
            is_list = isinstance(coordinates, list)
            listed = coordinates if is_list else [coordinates]
            invalid = [value for value in listed if not isinstance(value, str)]
            if invalid or not is_list:
                raise ValueError(
                    f"`{entry_name(['fixed', name])}` has "
                    f"{describe_value((invalid or listed)[0])}, but must be a list of "
                    "coordinates: 'angle', 'x' and 'y'."
                )


class SubMechanism(_Record, frozen=True):
    mechanism: Mechanism
    second: str


_KINDS: dict[str, Any] = {"energy": Energy, "mechanism": Mechanism}


def write_record(path: str | Path, kind: str, content: Any) -> None:
    """Write a record to a JSON file, if it can be read again.

    Args:
        path: Path of the file.
        kind: "energy" or "mechanism".
        content: Content of the record: dictionaries, lists, arrays and values.

    Raises:
        ValueError: The record cannot be read again: a value is not finite, a text cannot
            be encoded, or the layout is wrong. Nothing is written.
        OSError: The file cannot be written.
    """
    content = msgspec.to_builtins(
        content, enc_hook=lambda array: np.asarray(array).tolist()
    )
    try:
        if error_message := find_invalid_entry({kind: content}):
            raise ValueError(error_message)
        _convert(content, kind)
    except ValueError as error:
        raise ValueError(f"{path} is not written: {error}") from None
    write_json(path, {"twistorjax": VERSION, kind: content})


def read_record(path: str | Path, kind: str) -> Any:
    """Read a record from a JSON file.

    Args:
        path: Path of the file.
        kind: "energy" or "mechanism".

    Returns:
        The record, as an instance of its class in this module.

    Raises:
        ValueError: The file is damaged, of another version or of another kind, or has
            another layout.
        OSError: The file cannot be read.
    """
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
    if set(content) != {"twistorjax", kind}:
        raise ValueError(
            f"{path} has the fields {shorten(', '.join(content))}, but must have "
            f"only `twistorjax` and `{kind}`."
        )
    try:
        return _convert(content[kind], kind)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _convert(content: Any, kind: str) -> Any:
    """Convert the content of a file into a record; a message names the invalid entry."""
    try:
        return msgspec.convert(content, _KINDS[kind], strict=True)
    except msgspec.ValidationError as error:
        raise ValueError(_message(str(error), content, kind)) from None


_PATH = re.compile(r"(.*) - at `\$((?:\.\w+|\[\d+\])*)`", re.DOTALL)
_TYPE = re.compile(
    r"Expected `(?P<types>[^`]+)`(?: of length (?P<length>(?:>= )?\d+)"
    r"| (?P<limit>[<>]=? [\d.]+))?(?:, got .+)?"
)
_TYPE_NAMES = {
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
    "object": "an object",
    "null": "null",
}


def _message(original: str, content: Any, kind: str) -> str:
    """Convert a message of msgspec into one that names the entry and shows its value."""
    match = _PATH.fullmatch(original)
    problem, path = match.groups() if match else (original, "")
    keys = [
        int(key[1:-1]) if key[0] == "[" else key[1:]
        for key in re.findall(r"\.\w+|\[\d+\]", path)
    ]
    value: Any = content
    try:
        for key in keys:
            value = value[key]
    except (KeyError, IndexError, TypeError):
        # The name of an unknown field can look like a path.
        keys, problem = [], original
    name = f"the entry `{entry_name([kind, *keys])}`"
    if keys and keys[-1] == "kind":  # of an energy or a stress model
        records = StressModel if "stress_model" in keys else Energy
        kinds = ", ".join(record.__name__ for record in get_args(records))
        return f"{name} is {describe_value(value)}, but must be one of {kinds}."
    if match := _TYPE.fullmatch(problem):
        return f"{name} is {describe_value(value)}, but must be {_expected(match)}."
    for prefix, verb in (
        ("Object missing required", "lacks the"),
        ("Object contains unknown", "has the unknown"),
    ):
        if problem.startswith(prefix):
            field = shorten(problem.removeprefix(prefix).strip(), 80)
            return f"{name} {verb} {field}."
    return f"{name}: {problem}"


def _expected(match: re.Match[str]) -> str:
    """Describe the type that a message of msgspec expects."""
    words = " or ".join(
        _TYPE_NAMES.get(name, name) for name in match["types"].split(" | ")
    )
    if match["length"]:
        return f"{words} of {match['length'].replace('>= ', 'at least ')} entries"
    if match["limit"]:
        sign, number = match["limit"].split()
        relation = {">=": "at least", "<=": "at most", ">": "above"}[sign]
        return f"{words}, {relation} {float(number):g}"
    return words
