"""Layout of the JSON files of energies and mechanisms.

The schemas check the fields, their types and the numbers of their entries. Properties of
several entries together, such as the symmetry of a stiffness, are checked by the classes
that are created from the records. This module is imported only where a file is read or
written, because it imports msgspec.
"""

import re
from typing import Annotated, Any, get_args

import msgspec
from msgspec import Meta

from .._utils.json_files import describe_value, entry_name
from .._utils.validation import shorten
from ..energies.polynomial import LARGEST_POWER


Pair = tuple[float, float]
Triple = tuple[float, float, float]
Matrix = tuple[Triple, Triple, Triple]
Power = Annotated[int, Meta(ge=0, le=LARGEST_POWER)]
Powers = list[list[Power]]
Corners = Annotated[list[Pair], Meta(min_length=3)]


class _Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base class of all objects in a file. All fields are required."""


class _EnergyRecord(_Record, frozen=True, tag_field="kind", tag=True):
    """Base class of energies. The field `kind` holds the name of the class."""


class Quadratic(_EnergyRecord, frozen=True):
    """Record of a `Quadratic` energy."""

    stiffness: Matrix
    coordinates: str


class Polynomial(_EnergyRecord, frozen=True):
    """Record of a `Polynomial` energy."""

    coefficients: list[float]
    scale: float
    powers: Powers
    coordinates: str


class Rational(_EnergyRecord, frozen=True):
    """Record of a `Rational` energy."""

    numerator: "Energy"
    denominator: "Energy"


class SumOfSquares(_EnergyRecord, frozen=True):
    """Record of a `SumOfSquares`, with one coefficient for each power in each row."""

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
    """Record of a `MixedEnergy`."""

    coefficients: list[float]
    length: float
    force: float
    powers: Powers


class WithValidityRange(_EnergyRecord, frozen=True):
    """Record of a `WithValidityRange` energy."""

    energy: "Energy"
    rotation: float
    force: float
    error: Triple


class PointCharges(_EnergyRecord, frozen=True):
    """Record of a `PointCharges` energy."""

    charges_a: list[float]
    sites_a: list[Pair]
    charges_b: list[float]
    sites_b: list[Pair]
    constant: float


class Sum(_EnergyRecord, frozen=True):
    """Record of a `Sum` of at least one energy."""

    parts: Annotated[list["Energy"], Meta(min_length=1)]


class Scaled(_EnergyRecord, frozen=True):
    """Record of a `Scaled` energy."""

    factor: float
    energy: "Energy"


Energy = (
    Quadratic
    | Polynomial
    | Rational
    | SumOfSquares
    | MixedEnergy
    | WithValidityRange
    | PointCharges
    | Sum
    | Scaled
)


class Damping(_Record, frozen=True):
    """Record of a `ViscousDamping`."""

    damping: Matrix
    coordinates: str
    resisted: bool


class Body(_Record, frozen=True):
    """Record of a `Body`."""

    name: str
    pose: Triple
    mass: float | None
    inertia: float | None
    outline: Corners | None


class Hinge(_Record, frozen=True):
    """Record of a `Hinge`. A damping that is a number is a damping time; s."""

    name: str
    first: str
    second: str
    at: Triple
    energy: Energy
    damping: float | Damping | None
    outline: Corners | None


class Mechanism(_Record, frozen=True):
    """Record of a `Mechanism`, with fixed bodies or fixed coordinates of each body."""

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


def is_energy(value: Any) -> bool:
    """Return whether a value is the record of an energy."""
    return isinstance(value, _EnergyRecord)


SCHEMAS: dict[str, Any] = {"energy": Energy, "mechanism": Mechanism}


def convert_record(content: Any, kind: str) -> Any:
    """Convert the content of a file into a record of its schema.

    Args:
        content: Dictionaries, lists and values, as `read_json` returns them.
        kind: "energy" or "mechanism".

    Returns:
        A record of this module.

    Raises:
        ValueError: The content does not fit the schema. The message names the entry.
    """
    try:
        return msgspec.convert(content, SCHEMAS[kind], strict=True)
    except msgspec.ValidationError as error:
        raise ValueError(_message(str(error), content, kind)) from None


_PATH = re.compile(r"(.*) - at `\$((?:\.\w+|\[\d+\])*)`", re.DOTALL)
_TYPE = re.compile(
    r"Expected `(?P<types>[^`]+)`(?: of length (?P<length>(?:>= )?\d+)"
    r"| (?P<limit>[<>]= \d+))?(?:, got .+)?"
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
    """Convert a message of msgspec into one that names the entry and shows its value.

    Args:
        original: Message of msgspec.
        content: Content of the file.
        kind: "energy" or "mechanism".

    Returns:
        The message.
    """
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
    if keys and keys[-1] == "kind":  # Only energies have this field.
        kinds = ", ".join(record.__name__ for record in get_args(Energy))
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
        limit = match["limit"].replace(">= ", "at least ").replace("<= ", "at most ")
        return f"{words}, {limit}"
    return words
