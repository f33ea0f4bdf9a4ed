"""Looking at values while they can be seen, and saying what is wrong with them."""

import importlib
from collections.abc import Iterable, Sequence
from types import ModuleType
from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float


Choice = TypeVar("Choice", bound=str)

PLURAL = {"body": "bodies", "hinge": "hinges", "coordinate": "coordinates"}


def concrete(value: Any) -> np.ndarray | None:
    """The value as NumPy has it, or nothing where JAX is tracing it."""
    return None if isinstance(value, Tracer) else np.asarray(value)


def all_concrete(values: Iterable[Any]) -> list[np.ndarray] | None:
    """The values as NumPy has them, or nothing where JAX is tracing one."""
    seen = [concrete(value) for value in values]
    found = [value for value in seen if value is not None]
    return found if len(found) == len(seen) else None


def require_choice(name: str, value: Choice, choices: Sequence[str]) -> Choice:
    """The value, if it is one of the choices."""
    if value not in choices:
        listed = ", ".join(repr(choice) for choice in choices)
        raise ValueError(f"{name} is {value!r}, but must be one of {listed}.")
    return value


def index_of(where: str, noun: str, name: str, names: Sequence[str]) -> int:
    """The place of a name among those there are."""
    if name not in names:
        has = ", ".join(map(repr, names))
        raise ValueError(
            f"{where} names the {noun} {name!r}, but the {PLURAL[noun]} are {has}."
        )
    return names.index(name)


def shorten(words: str, most: int = 60) -> str:
    """The words, with the middle left out if they are longer than so many characters."""
    if len(words) <= most:
        return words
    return f"{words[: most * 2 // 3]}...{words[-(most // 4) :]}"


def require_text(what: str, value: Any) -> str:
    """The value, if it is some text."""
    if not isinstance(value, str) or not value:
        raise ValueError(f"{what} is {value!r}, but must be some text.")
    return value


def require_package(name: str, what: str, extra: str) -> ModuleType:
    """A package that need not be installed.

    Args:
        name: of the package.
        what: needs it.
        extra: of this library's extras, the one that installs it.

    Raises:
        ImportError: it is not installed; the text says how to.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(
            f'{what} need {name}: install it with `pip install "twistorjax[{extra}]"`.'
        ) from error


def require_float64(array: Array) -> None:
    """Refuses single precision, in which equilibria of flexures are lost to rounding."""
    if array.dtype != jnp.float64 or jnp.result_type(float) != jnp.float64:
        raise ValueError(
            "twistorjax solves in double precision, but this mechanism was made in "
            "single precision, or JAX has the double one off. Before any array is made, "
            "write:"
            '\n\n    jax.config.update("jax_enable_x64", True)\n'
        )


def compilation_error(name: str, about: str, error: Exception) -> ValueError:
    """What is said of a user's function that JAX could not trace."""
    return ValueError(
        f"`{name}` is a function that cannot be compiled. Write it with jax.numpy "
        "instead of numpy or math, and with `jax.numpy.where` instead of `if` "
        f"{about}. JAX says: {str(error).splitlines()[0]}"
    )


def require_kind(name: str, values: Sequence[Any], kind: type) -> None:
    """Refuses anything but a sequence of things of one kind."""
    if isinstance(values, kind):
        raise ValueError(f"`{name}` is one {kind.__name__}: put it in a list, [...].")
    for place, value in enumerate(values):
        if not isinstance(value, kind):
            raise ValueError(
                f"`{name}[{place}]` is a {type(value).__name__}, but must be a "
                f"{kind.__name__}."
            )


def require_interval(
    name: str, value: ArrayLike, low: float, high: float, needed: str
) -> Float[Array, "..."]:
    """The value, if it lies strictly above `low` and not above `high`.

    Seen while building, a value outside is an error. Traced, it becomes NaN, so that in
    a batch it harms its own lane alone: every solve reports such a lane in its `result`.
    """
    seen = concrete(value)
    if seen is None:
        traced = jnp.asarray(value, float)
        return jnp.where((traced > low) & (traced <= high), traced, jnp.nan)
    if not np.issubdtype(seen.dtype, np.number) or seen.shape != ():
        raise ValueError(f"{name} is {value!r}, but must be a number.")
    if not low < float(seen) <= high:  # NaN fails too
        raise ValueError(f"{name} is {seen:g}, but {needed}.")
    return jnp.asarray(value, float)


def require_positive(name: str, value: ArrayLike) -> Float[Array, "..."]:
    """The value, if it is positive and finite; see `within`."""
    largest = float(np.finfo(float).max)
    return require_interval(name, value, 0.0, largest, "must be positive and finite")


def require_corners(
    name: str, value: ArrayLike | Sequence[Any]
) -> Float[Array, "corners 2"]:
    """The corners of an outline, finite as far as can be seen."""
    array = jnp.asarray(value, float)
    if array.ndim != 2 or array.shape[0] < 3 or array.shape[1] != 2:
        raise ValueError(
            f"{name} has shape {array.shape}, but must have a row (x, y) for each of "
            "three corners or more."
        )
    seen = concrete(array)
    if seen is not None and not np.all(np.isfinite(seen)):
        place = int(np.argwhere(~np.isfinite(seen))[0][0])
        raise ValueError(f"{name} has {seen[place].tolist()}, but must be finite.")
    return array


def require_row(
    name: str, value: ArrayLike | Sequence[ArrayLike], what: str, size: int = 3
) -> Float[Array, " size"]:
    """The value as an array of so many entries, finite as far as can be seen."""
    if isinstance(value, tuple | list):
        value = jnp.stack([jnp.asarray(entry, float) for entry in value])
    array = jnp.asarray(value, float)
    if array.shape != (size,):
        raise ValueError(f"{name} has shape {array.shape}, but must be {what}.")
    seen = concrete(array)
    if seen is not None and not np.all(np.isfinite(seen)):
        raise ValueError(f"{name} is {seen.tolist()}, but must be finite.")
    return array
