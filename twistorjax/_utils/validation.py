"""Validation of arguments, and the messages of its errors.

A value that JAX is tracing is not known. It cannot raise an error; most functions of this
module then return it unchanged.
"""

import importlib
from collections.abc import Iterable, Sequence
from types import ModuleType
from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .types import NumberLike, Numbers, NumbersLike


Choice = TypeVar("Choice", bound=str)

PLURAL = {"body": "bodies", "hinge": "hinges", "coordinate": "coordinates"}


def concrete(value: Any) -> np.ndarray | None:
    """Return a value as a NumPy array; `None` if JAX is tracing it."""
    return None if isinstance(value, Tracer) else np.asarray(value)


def all_concrete(values: Iterable[Any]) -> list[np.ndarray] | None:
    """Return values as NumPy arrays; `None` if JAX is tracing one of them."""
    arrays = [concrete(value) for value in values]
    known = [array for array in arrays if array is not None]
    return known if len(known) == len(arrays) else None


def require_choice(name: str, value: Choice, choices: Sequence[str]) -> Choice:
    """Require one of several strings.

    Args:
        name: Name of the argument, for the message.
        value: Value of the argument.
        choices: The strings that are allowed.

    Returns:
        The value.

    Raises:
        ValueError: The value is not one of the choices.
    """
    if value not in choices:
        listed = ", ".join(repr(choice) for choice in choices)
        raise ValueError(f"{name} is {value!r}, but must be one of {listed}.")
    return value


def index_of(where: str, noun: str, name: str, names: Sequence[str]) -> int:
    """Find a name in a list of names.

    Args:
        where: The argument that has the name, for the message.
        noun: What is named: a key of `PLURAL`.
        name: The name.
        names: All names.

    Returns:
        The index of the name.

    Raises:
        ValueError: The name is not in the list.
    """
    if name not in names:
        listed = ", ".join(map(repr, names))
        raise ValueError(
            f"{where} names the {noun} {name!r}, but the {PLURAL[noun]} are {listed}."
        )
    return names.index(name)


def shorten(text: str, length: int = 60) -> str:
    """Shorten a text for a message by leaving out its middle part.

    Args:
        text: The text.
        length: Number of characters up to which a text is returned unchanged.

    Returns:
        The text, or its beginning and its end.
    """
    if len(text) <= length:
        return text
    return f"{text[: length * 2 // 3]}...{text[-(length // 4) :]}"


def require_text(name: str, value: Any) -> str:
    """Require a non-empty string.

    Args:
        name: Name of the argument, for the message.
        value: Value of the argument.

    Returns:
        The value.

    Raises:
        ValueError: The value is not a string, or it is empty.
    """
    if not isinstance(value, str) or not value:
        raise ValueError(f"{name} is {value!r}, but must be a string that is not empty.")
    return value


def require_package(name: str, feature: str, extra: str) -> ModuleType:
    """Import an optional package.

    Args:
        name: Name of the package.
        feature: What needs the package, as a plural noun for the message.
        extra: Extra of twistorjax that installs the package.

    Returns:
        The package.

    Raises:
        ImportError: The package is not installed. The message says how to install it.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(
            f'{feature} need {name}: install it with `pip install "twistorjax[{extra}]"`.'
        ) from error


def require_float64(array: Array) -> None:
    """Require double precision, because single precision is too inaccurate for flexures.

    Args:
        array: An array of the model that is going to be solved.

    Raises:
        ValueError: The array is in single precision, or double precision is disabled.
    """
    if array.dtype != jnp.float64 or jnp.result_type(float) != jnp.float64:
        raise ValueError(
            "twistorjax needs double precision, but an array is in single precision, or "
            "double precision is disabled in JAX. Enable it before you create any array:"
            '\n\n    jax.config.update("jax_enable_x64", True)\n'
        )


def compilation_error(name: str, subject: str, error: Exception) -> ValueError:
    """Create the error for a user's function that JAX cannot trace.

    Args:
        name: Name of the function.
        subject: What `if` must not depend on, as words that follow it: "about the time".
        error: The error that JAX raised.

    Returns:
        The error. Its message says how to write the function.
    """
    return ValueError(
        f"`{name}` is a function that JAX cannot compile. Write it with jax.numpy "
        "instead of numpy or math, and with `jax.numpy.where` instead of `if` "
        f"{subject}. JAX says: {str(error).splitlines()[0]}"
    )


def require_kind(name: str, values: Sequence[Any], kind: type) -> None:
    """Require a sequence of instances of one class.

    Args:
        name: Name of the argument, for the message.
        values: The sequence.
        kind: The class.

    Raises:
        ValueError: The argument is a single instance, or one of its entries is of another
            class.
    """
    if isinstance(values, kind):
        raise ValueError(f"`{name}` is one {kind.__name__}: put it in a list, [...].")
    for index, value in enumerate(values):
        if not isinstance(value, kind):
            raise ValueError(
                f"`{name}[{index}]` is a {type(value).__name__}, but must be a "
                f"{kind.__name__}."
            )


def require_interval(
    name: str, value: NumberLike, low: float, high: float, requirement: str
) -> Numbers:
    """Require a number above `low` and not above `high`.

    Args:
        name: Name of the argument, for the message.
        value: Value of the argument.
        low: Lower limit, which is excluded.
        high: Upper limit, which is included.
        requirement: Words of the message that follow "but".

    Returns:
        The value. A traced value outside the interval becomes NaN; a batched solve then
        reports the failure in `result` for this design only.

    Raises:
        ValueError: The value is known and is not a number or is outside the interval.
    """
    known = concrete(value)
    if known is None:
        traced = jnp.asarray(value, float)
        return jnp.where((traced > low) & (traced <= high), traced, jnp.nan)
    if not np.issubdtype(known.dtype, np.number) or known.shape != ():
        raise ValueError(f"{name} is {value!r}, but must be a number.")
    if not low < float(known) <= high:  # also true for NaN
        raise ValueError(f"{name} is {known:g}, but {requirement}.")
    return jnp.asarray(value, float)


def require_positive(name: str, value: NumberLike) -> Numbers:
    """Require a positive, finite number.

    Args:
        name: Name of the argument, for the message.
        value: Value of the argument.

    Returns:
        The value; NaN if it is traced and not positive. See `require_interval`.

    Raises:
        ValueError: The value is known and is not a positive, finite number.
    """
    largest = float(np.finfo(float).max)
    return require_interval(name, value, 0.0, largest, "must be positive and finite")


def require_corners(
    name: str, value: NumberLike | Sequence[Any]
) -> Float[Array, "corners 2"]:
    """Require the corners of a polygon.

    Args:
        name: Name of the argument, for the message.
        value: Rows (x, y); m.

    Returns:
        The corners; m.

    Raises:
        ValueError: The shape is wrong, or a known entry is not finite.
    """
    array = jnp.asarray(value, float)
    if array.ndim != 2 or array.shape[0] < 3 or array.shape[1] != 2:
        raise ValueError(
            f"{name} has shape {array.shape}, but must have a row (x, y) for each of "
            "three corners or more."
        )
    known = concrete(array)
    if known is not None and not np.all(np.isfinite(known)):
        row = int(np.argwhere(~np.isfinite(known))[0][0])
        raise ValueError(f"{name} has {known[row].tolist()}, but must be finite.")
    return array


def require_row(
    name: str, value: NumbersLike, entries: str, size: int = 3
) -> Float[Array, " size"]:
    """Require a vector of a given size.

    Args:
        name: Name of the argument, for the message.
        value: Value of the argument.
        entries: Names of the entries, for the message.
        size: Number of entries.

    Returns:
        The vector.

    Raises:
        ValueError: The shape is wrong, or a known entry is not finite.
    """
    if isinstance(value, tuple | list):
        value = jnp.stack([jnp.asarray(entry, float) for entry in value])
    array = jnp.asarray(value, float)
    if array.shape != (size,):
        raise ValueError(f"{name} has shape {array.shape}, but must be {entries}.")
    known = concrete(array)
    if known is not None and not np.all(np.isfinite(known)):
        raise ValueError(f"{name} is {known.tolist()}, but must be finite.")
    return array


def require_distinct(noun: str, names: Sequence[str]) -> tuple[str, ...]:
    """Return names, and raise a ValueError if one occurs twice.

    Args:
        noun: What the names are names of, for the message.
        names: The names.
    """
    distinct: set[str] = set()
    for name in names:
        if name in distinct:
            raise ValueError(f"The {noun} {name!r} is given twice; names must differ.")
        distinct.add(name)
    return tuple(names)
