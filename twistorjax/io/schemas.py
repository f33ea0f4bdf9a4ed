"""Layout of the JSON files of energies and mechanisms.

The schemas check fields, types, numbers of entries and kinds. What follows from several
entries together, such as the symmetry of a stiffness, is checked by the classes that are
made of them. This module is imported only where a file is read or written, so that
msgspec is not loaded before.
"""

import re
from typing import Annotated, Any, get_args, TypeVar

import msgspec
from msgspec import Meta

from .._utils.json_files import entry, shown
from .._utils.validation import shorten
from ..energies.polynomial import LARGEST_POWER


Record = TypeVar("Record", bound=msgspec.Struct)

Pair = tuple[float, float]
Triple = tuple[float, float, float]
Matrix = tuple[Triple, Triple, Triple]
Power = Annotated[int, Meta(ge=0, le=LARGEST_POWER)]
Powers = list[list[Power]]
Corners = Annotated[list[Pair], Meta(min_length=3)]


class _Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An object of a file. Every field must be there, and no other may."""


class _Kind(_Record, frozen=True, tag_field="kind", tag=True):
    """An energy; the field `kind` has the name of its class."""


class Quadratic(_Kind, frozen=True):
    """A `Quadratic` energy."""

    stiffness: Matrix
    coordinates: str


class Polynomial(_Kind, frozen=True):
    """A `Polynomial`."""

    coefficients: list[float]
    scale: float
    powers: Powers
    coordinates: str


class Rational(_Kind, frozen=True):
    """A `Rational`; its parts are energies of any kind."""

    numerator: "Energy"
    denominator: "Energy"


class SumOfSquares(_Kind, frozen=True):
    """A denominator `SumOfSquares`; every row of coefficients fits the powers."""

    coefficients: list[list[float]]
    scale: float
    powers: Powers
    coordinates: str

    def __post_init__(self) -> None:
        for place, row in enumerate(self.coefficients):
            if len(row) != len(self.powers):
                raise ValueError(
                    f"`coefficients[{place}]` has {len(row)} entries, but there are "
                    f"{len(self.powers)} `powers`: a coefficient is needed for each."
                )


class MixedEnergy(_Kind, frozen=True):
    """A `MixedEnergy` energy."""

    coefficients: list[float]
    length: float
    force: float
    powers: Powers


class WithValidityRange(_Kind, frozen=True):
    """A `WithValidityRange` energy."""

    energy: "Energy"
    turn: float
    force: float
    error: Triple


class PointCharges(_Kind, frozen=True):
    """A `PointCharges` energy."""

    charges_a: list[float]
    sites_a: list[Pair]
    charges_b: list[float]
    sites_b: list[Pair]
    constant: float


class Sum(_Kind, frozen=True):
    """A `Sum` of one part or more."""

    parts: Annotated[list["Energy"], Meta(min_length=1)]


class Scaled(_Kind, frozen=True):
    """A `Scaled` energy."""

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
    """A `ViscousDamping` damping."""

    damping: Matrix
    coordinates: str
    resisted: bool


class Body(_Record, frozen=True):
    """A body of a mechanism."""

    name: str
    pose: Triple
    mass: float | None
    inertia: float | None
    outline: Corners | None


class Hinge(_Record, frozen=True):
    """A hinge of a mechanism; a damping that is a number is a time."""

    name: str
    first: str
    second: str
    at: Triple
    energy: Energy
    damping: float | Damping | None
    outline: Corners | None


class Mechanism(_Record, frozen=True):
    """A mechanism; `fixed` has names of bodies, or their held coordinates by name."""

    bodies: list[Body]
    hinges: list[Hinge]
    fixed: dict[str, Any] | list[str]

    def __post_init__(self) -> None:
        # not by the types above, for msgspec does not report the name of the body
        if not isinstance(self.fixed, dict):
            return
        for name, chosen in self.fixed.items():
            listed = chosen if isinstance(chosen, list) else [chosen]
            strange = [part for part in listed if not isinstance(part, str)]
            if strange or not isinstance(chosen, list):
                raise ValueError(
                    f"`{entry(['fixed', name])}` has {shown((strange or listed)[0])}, but "
                    "must be a list of coordinates: 'angle', 'x' and 'y'."
                )


def is_energy(value: Any) -> bool:
    """Whether a value is the record of an energy."""
    return isinstance(value, _Kind)


SCHEMAS: dict[str, Any] = {"energy": Energy, "mechanism": Mechanism}


def converted(tree: Any, kind: str) -> Any:
    """Convert the content of a file into a record of its schema.

    Args:
        tree: Objects, lists and values, as `read_json` returns them.
        kind: "energy" or "mechanism".

    Returns:
        A record of this module.

    Raises:
        ValueError: The content does not fit the schema. The message names the entry.
    """
    try:
        return msgspec.convert(tree, SCHEMAS[kind], strict=True)
    except msgspec.ValidationError as error:
        raise ValueError(_in_words(str(error), tree, kind)) from None


_PLACE = re.compile(r"(.*) - at `\$((?:\.\w+|\[\d+\])*)`", re.DOTALL)
_TYPE = re.compile(
    r"Expected `(?P<types>[^`]+)`(?: of length (?P<length>(?:>= )?\d+)"
    r"| (?P<limit>[<>]= \d+))?(?:, got .+)?"
)
_TYPES = {
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
    "object": "an object",
    "null": "null",
}


def _in_words(message: str, tree: Any, kind: str) -> str:
    """A message of msgspec as a sentence that names the entry and shows its value."""
    place = _PLACE.fullmatch(message)
    what, path = place.groups() if place else (message, "")
    keys = [
        int(key[1:-1]) if key[0] == "[" else key[1:]
        for key in re.findall(r"\.\w+|\[\d+\]", path)
    ]
    value: Any = tree
    try:
        for key in keys:
            value = value[key]
    except (KeyError, IndexError, TypeError):
        keys, what = [], message  # the name of an unknown field may look like a place
    name = f"the entry `{entry([kind, *keys])}`"
    if keys and keys[-1] == "kind":  # only energies have this field
        kinds = ", ".join(each.__name__ for each in get_args(Energy))
        return f"{name} is {shown(value)}, but must be one of {kinds}."
    if match := _TYPE.fullmatch(what):
        return f"{name} is {shown(value)}, but must be {_needed(match)}."
    for theirs, ours in (
        ("Object missing required", "lacks the"),
        ("Object contains unknown", "has the unknown"),
    ):
        if what.startswith(theirs):
            field = shorten(what.removeprefix(theirs).strip(), 80)
            return f"{name} {ours} {field}."
    return f"{name}: {what}"


def _needed(match: re.Match[str]) -> str:
    """The type that is needed, in words."""
    words = " or ".join(_TYPES.get(part, part) for part in match["types"].split(" | "))
    if match["length"]:
        return f"{words} of {match['length'].replace('>= ', 'at least ')} entries"
    if match["limit"]:
        limit = match["limit"].replace(">= ", "at least ").replace("<= ", "at most ")
        return f"{words}, {limit}"
    return words
