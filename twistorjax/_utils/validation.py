"""Validation of arguments, and the messages of its errors.

A function `require_...` takes the name of an argument, for the message, and its value. It
returns the value, or raises a ValueError. The name is written with its backticks, except
for `require_instance` and `require_kind`, which add them. A value that JAX is tracing is
not known, so most functions return it unchanged.
"""

import contextlib
import importlib
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import FrameType, ModuleType
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .host import as_float, concrete, on_host
from .polygons import crossing_edges
from .types import ArrayOfNumbers, NumberLike, Numbers, NumbersLike


Choice = TypeVar("Choice", bound=str)
Kind = TypeVar("Kind")

# Packages whose frames stand between a call of a user and a warning. A frame without a
# module is that of a type checker.
_BETWEEN = {__name__.partition(".")[0], "equinox", "jax", "jaxtyping", "beartype", ""}

_LONGEST_NAME = 200  # characters
_LONGEST = 2.0  # dimension of a flexure; m
_FARTHEST = 1e100  # coordinate of a pose; m

PLURAL = {"body": "bodies", "hinge": "hinges", "coordinate": "coordinates"}


def warn(message: str) -> None:
    """Warn, and refer to the line of the user's program that called this library."""
    frame = sys._getframe(1)
    while frame.f_back is not None and _module(frame).partition(".")[0] in _BETWEEN:
        frame = frame.f_back
    registry = frame.f_globals.setdefault("__warningregistry__", {})
    file = frame.f_code.co_filename
    warnings.warn_explicit(
        message, UserWarning, file, frame.f_lineno, _module(frame), registry
    )


def _module(frame: FrameType) -> str:
    """Return the name of the module of a frame; empty if it has none."""
    return frame.f_globals.get("__name__", "")


def require_choice(name: str, value: Choice, choices: Sequence[str]) -> Choice:
    """Require one of several strings."""
    if value not in choices:
        raise ValueError(
            f"{name} is {quote(value)}, but must be one of {listing(choices)}."
        )
    return value


def require_names(argument: str, names: Any) -> None:
    """Check that names are not one string, whose letters would be taken for names."""
    if isinstance(names, str):
        raise ValueError(
            f"{argument} is the string {names!r}, but must be a list of names, such as "
            f"[{names!r}]."
        )


def index_of(where: str, noun: str, name: str, names: Sequence[str]) -> int:
    """Return the index of a name in a list of names; `noun` is a key of `PLURAL`."""
    if name not in names:
        raise ValueError(
            f"{where} names the {noun} {quote(name)}, but the {PLURAL[noun]} are "
            f"{listing(names)}."
        )
    return names.index(name)


def shorten(text: str, length: int = 60) -> str:
    """Shorten a text of more than `length` characters by leaving out its middle part."""
    if len(text) <= length:
        return text
    return f"{text[: length * 2 // 3]}...{text[-(length // 4) :]}"


def quote(value: Any) -> str:
    """Return the text of a value for a message; the type of an object of the library."""
    text = repr(value)
    if "\n" in text or isinstance(value, eqx.Module):
        return _with_article(type(value).__name__)
    return shorten(text, 100)


def _with_article(noun: str) -> str:
    return f"{'an' if noun[0] in 'AEIOU' else 'a'} {noun}"


def listing(names: Iterable[Any], none: str = "none") -> str:
    """List names for a message, without those in the middle of a long list."""
    return shorten(", ".join(map(quote, names)), 600) or none


@contextlib.contextmanager
def missing_parameters_noted(parameters: Any) -> Iterator[None]:
    """List the given parameters if a function of the user reads another one."""
    try:
        yield
    except KeyError as error:
        if isinstance(parameters, Mapping):
            error.add_note(f"The parameters are {listing(parameters)}.")
        raise


def require_text(name: str, value: Any) -> str:
    """Require a string that is not empty, and not too long to be shown in messages."""
    if not isinstance(value, str) or not value:
        raise ValueError(
            f"{name} is {quote(value)}, but must be a string that is not empty."
        )
    if len(value) > _LONGEST_NAME:
        raise ValueError(
            f"{shorten(name, 200)} is {quote(value)}, which has {len(value):,} "
            f"characters, but must have at most {_LONGEST_NAME}."
        )
    return value


def require_package(name: str, feature: str, extra: str) -> ModuleType:
    """Import an optional package; `feature` is a plural noun for what needs it."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(
            f'{feature} need {name}: install it with `pip install "twistorjax[{extra}]"`.'
        ) from error


def require_float64(array: Array) -> None:
    """Require double precision, because single precision is too inaccurate for flexures.

    The array is any array of the model that is going to be solved.
    """
    if array.dtype != jnp.float64 or jnp.result_type(float) != jnp.float64:
        raise ValueError(
            "twistorjax needs double precision, but an array is in single precision, or "
            "double precision is disabled in JAX. Enable it before you create any array: "
            "`twistorjax.configure()`."
        )


def require_same_precision(name: str, part: Any) -> None:
    """Require that a part of a model was created in the precision that JAX now has."""
    precision = jnp.result_type(float)
    for leaf in jax.tree.leaves(part):
        kind = getattr(leaf, "dtype", precision)
        if kind != precision and jnp.issubdtype(kind, jnp.floating):
            raise ValueError(
                f"{name} has numbers of type {kind}, but JAX computes with {precision}. "
                "Call `twistorjax.configure()` first, and create all parts of the "
                "mechanism afterwards."
            )


def compilation_error(name: str, subject: str, error: Exception) -> ValueError:
    """Create the error for a user's function that JAX cannot trace.

    The `subject` is what `if` must not depend on, as words that follow it: "about the
    time".
    """
    return ValueError(
        f"`{name}` is a function that JAX cannot compile. Write it with jax.numpy "
        "instead of numpy or math, and with `jax.numpy.where` instead of `if` "
        f"{subject}. JAX says: {str(error).splitlines()[0]}"
    )


def require_instance(name: str, value: Any, kind: type[Kind]) -> Kind:
    """Require an instance of a class."""
    if not isinstance(value, kind):
        raise ValueError(
            f"`{name}` is a {type(value).__name__}, but must be "
            f"{_with_article(kind.__name__)}."
        )
    return value


def require_kind(name: str, values: Iterable[Any], kind: type[Kind]) -> tuple[Kind, ...]:
    """Require a sequence of instances of one class; a single instance is rejected."""
    if isinstance(values, kind):
        raise ValueError(f"`{name}` is one {kind.__name__}: put it in a list, [...].")
    if not isinstance(values, Iterable):
        raise ValueError(
            f"`{name}` is {quote(values)}, but must be a list of objects of the class "
            f"{kind.__name__}."
        )
    return tuple(
        require_instance(f"{name}[{index}]", value, kind)
        for index, value in enumerate(values)
    )


def require_interval(
    name: str, value: NumberLike, low: float, high: float, requirement: str
) -> Numbers:
    """Require a number above `low` and not above `high`.

    The message ends with "but" and the `requirement`. A traced value outside the interval
    becomes NaN; a batched solve then reports the failure in `result` for this design
    only.
    """
    known = concrete(value)
    if known is None:
        traced = jnp.asarray(value, float)
        return jnp.where((traced > low) & (traced <= high), traced, jnp.nan)
    if not np.issubdtype(known.dtype, np.number) or known.shape != ():
        raise ValueError(f"{name} is {quote(value)}, but must be a number.")
    if not low < float(known) <= high:  # also true for NaN
        raise ValueError(f"{name} is {known:g}, but {requirement}.")
    return as_float(known)


def require_positive(name: str, value: NumberLike) -> Numbers:
    """Require a positive, finite number; NaN if it is traced and not positive."""
    largest = float(np.finfo(float).max)
    return require_interval(name, value, 0.0, largest, "must be positive and finite")


def require_length(
    name: str, value: NumberLike, modulus: NumberLike | None = None
) -> Numbers:
    """Require a positive dimension of a flexure, and warn if it seems to be in mm; m.

    A Young's modulus of exactly 1 makes a study dimensionless, so there is no warning.
    """
    length = require_positive(name, value)
    if modulus is None or not np.all(concrete(modulus) == np.array(1.0)):
        warn_if_long(name, length, _LONGEST, "a flexure")
    return length


def warn_if_long(name: str, value: NumberLike, longest: float, part: str) -> None:
    """Warn of a length or a displacement (m) that is so large that it seems to be in mm.

    That of a usual `part`, such as "a flexure", is at most `longest`; m.
    """
    known = concrete(value)
    if known is not None and known.shape == () and abs(float(known)) > longest:
        warn(
            f"{name} is {float(known):g} m, which is large for {part}. Lengths are in "
            "meters: 50 mm is 50e-3."
        )


def require_positive_fields(part: Any, *names: str, or_zero: Sequence[str] = ()) -> None:
    """Require positive, finite numbers in fields of a part that are known and not None.

    The fields `or_zero` may also be zero.
    """
    for name in (*names, *or_zero):
        value = getattr(part, name)
        values = None if value is None else concrete(value)
        if values is None:
            continue
        valid = np.isfinite(values) & ((values > 0) | ((values == 0) & (name in or_zero)))
        if not np.all(valid):
            index = tuple(map(int, np.argwhere(~valid)[0]))
            where = name + "".join(f"[{k}]" for k in index)
            requirement = "zero or positive" if name in or_zero else "positive"
            raise ValueError(
                f"`{where}` is {values[index]:g}, but must be {requirement} and finite."
            )


def require_finite(name: str, value: NumberLike) -> Numbers:
    """Require a finite number; NaN if it is traced and not finite."""
    largest = float(np.finfo(float).max)
    return require_interval(name, value, -np.inf, largest, "must be finite")


def require_shape(
    name: str,
    value: ArrayOfNumbers | Sequence[Any],
    shape: tuple[int | None, ...],
    requirement: str,
) -> Numbers:
    """Require an array of a given shape; None is an axis of any length.

    The message ends with "but must" and the `requirement`, such as "have a row (angle, x,
    y) for each trial".
    """
    try:
        array = as_float(value)
    except ValueError:
        raise ValueError(
            f"{name} has entries of different lengths, but must {requirement}."
        ) from None
    lengths = zip(shape, array.shape, strict=False)
    matches = [required in (None, length) for required, length in lengths]
    if array.ndim != len(shape) or not all(matches):
        raise ValueError(f"{name} has shape {array.shape}, but must {requirement}.")
    return array


def require_array(
    name: str,
    value: ArrayOfNumbers | Sequence[Any],
    shape: tuple[int | None, ...],
    requirement: str,
) -> Numbers:
    """Require an array of a given shape without NaN and infinity; see `require_shape`."""
    array = require_shape(name, value, shape, requirement)
    known = concrete(array)
    if known is not None and not np.all(np.isfinite(known)):
        index = int(np.argwhere(~np.isfinite(known))[0][0])
        raise ValueError(
            f"{name} has {known[index].tolist()} at index {index}, but must be finite."
        )
    return array


def require_row(
    name: str, value: NumbersLike, entries: str, size: int = 3
) -> Float[Array, " size"]:
    """Require a finite vector of `size` numbers, which the message calls `entries`."""
    return require_array(name, value, (size,), f"be {entries}")


def require_pose(name: str, value: NumbersLike) -> Float[Array, "3"]:
    """Require a finite pose or displacement (angle, x, y), and check its angle."""
    pose = require_row(name, value, "(angle, x, y)")
    known = concrete(pose)
    if known is not None:
        warn_if_degrees(f"The angle of {name}", known[0])
        if float(np.max(np.abs(known[1:]))) > _FARTHEST:
            raise ValueError(
                f"{name} is {quote(known.tolist())}, but x and y must be between "
                f"-{_FARTHEST:g} and {_FARTHEST:g} m: powers of larger lengths overflow."
            )
    return pose


def warn_if_degrees(name: str, angle: NumberLike) -> None:
    """Warn if an angle that is not traced is more than a full turn; rad."""
    known = concrete(angle)
    if known is not None and abs(value := float(known)) > 2 * np.pi:
        warn(
            f"{name} is {value:g} rad, more than a full turn. Angles are in radians: "
            f"{value:g} degrees are {np.radians(value):.6g} rad."
        )


def require_corners(
    name: str, value: NumberLike | Sequence[Any]
) -> Float[Array, "corners 2"]:
    """Require the corners of a polygon that does not cross itself; m.

    Corners may be repeated, and their order may be clockwise or counterclockwise; see
    `crossing_edges`.
    """
    requirement = "have a row (x, y) for each of three corners or more"
    array = require_array(name, value, (None, 2), requirement)
    if len(array) < 3:
        raise ValueError(f"{name} has shape {array.shape}, but must {requirement}.")
    known = concrete(array)
    if known is not None:
        require_simple_polygon(name, known)
    return array


def require_simple_polygon(name: str, corners: Float[np.ndarray, "corners 2"]) -> None:
    """Require a polygon that does not cross itself; m."""
    edges = crossing_edges(corners)
    if edges is not None:
        first, second = (
            f"edge {edge} from {_point(corners[edge])} to "
            f"{_point(corners[(edge + 1) % len(corners)])}"
            for edge in edges
        )
        raise ValueError(
            f"{name} crosses itself: {first} crosses {second}. List the corners in the "
            "order in which they follow each other along the boundary."
        )


def _point(point: Float[np.ndarray, "2"]) -> str:
    """Format the coordinates of a point for a message."""
    return f"({point[0]:.6g}, {point[1]:.6g})"


def require_deviations(
    name: str, value: ArrayOfNumbers | Sequence[Any], shape: tuple[int, ...]
) -> Numbers:
    """Require positive, finite standard deviations that can be broadcast to a shape."""
    given = as_float(value)
    numbers, (values,) = on_host(given)
    try:
        array = as_float(numbers.broadcast_to(values, shape))
    except ValueError:
        raise ValueError(
            f"{name} has shape {given.shape}, but must have shape {shape} or one that "
            "can be broadcast to it."
        ) from None
    known = concrete(given)
    if known is not None:
        wrong = known[~((known > 0) & np.isfinite(known))]
        if wrong.size:
            raise ValueError(f"{name} has {wrong[0]:g}, but must be positive and finite.")
    return array


def require_distinct(noun: str, names: Sequence[str]) -> tuple[str, ...]:
    """Require that no name occurs twice; the noun says what they are names of."""
    distinct: set[str] = set()
    for name in names:
        if name in distinct:
            raise ValueError(
                f"The {noun} {quote(name)} is given twice; names must differ."
            )
        distinct.add(name)
    return tuple(names)
