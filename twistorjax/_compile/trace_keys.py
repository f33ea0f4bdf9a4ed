"""Text that identifies a value in every process, for the keys of stored results."""

import dataclasses
import enum
import functools
import sys
import types
from collections.abc import Iterable
from typing import Any

import jax
import numpy as np
from jax.core import Tracer


# The text names the functions and classes of these packages. Their contents are known
# from the versions of the packages, unlike those of a script or a notebook.
_LIBRARIES = frozenset(("jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax"))
_PACKAGES = _LIBRARIES | {"builtins", "collections", "functools", "numpy", "twistorjax"}
_PLAIN = (type(None), bool, int, float, complex, str, bytes)


class NoCanonicalTextError(TypeError):
    """A value contains a function or an object that no text identifies."""


def canonical_text(value: Any) -> str:
    """Return a text that is equal for values that lead to the same traced function.

    Args:
        value: Value of any type. Put a `jax.ShapeDtypeStruct` in place of each array that
            JAX is tracing.

    Returns:
        The text. Arrays are identified by their entries.

    Raises:
        NoCanonicalTextError: The value contains, for example, a function of the user.

    Example:
        >>> canonical_text((1, "name"))
        "tuple(int 1,str 'name',)"
    """
    parts: list[str] = []
    try:
        _Writer(parts).write(value)
    except RecursionError:
        raise NoCanonicalTextError("a value that is nested too deeply") from None
    return "".join(parts)


class _Writer:
    """Appends the text of values to a list, with references to objects seen before."""

    def __init__(self, parts: list[str]):
        self.add = parts.append
        self.seen: dict[int, int] = {}
        self.kept: list[Any] = []  # so that no `id` is used twice

    def write(self, value: Any) -> None:
        kind = type(value)
        if kind in _PLAIN:
            self.add(f"{kind.__name__} {value!r}")
        elif isinstance(value, jax.ShapeDtypeStruct):
            self.add(f"shape {value.shape} {value.dtype.name} {value.weak_type}")
        elif isinstance(value, np.ndarray | np.generic | jax.Array):
            self._write_array(value)
        elif isinstance(value, np.dtype):
            self._write_dtype(value)
        elif kind is tuple:
            self._write_all(tuple, value)
        elif id(value) in self.seen:
            self.add(f"seen {self.seen[id(value)]}")
        else:
            self.seen[id(value)] = len(self.seen)
            self.kept.append(value)
            self._write_object(value)

    def _write_array(self, array: Any) -> None:
        is_jax = isinstance(array, jax.Array)
        is_plain = is_jax or type(array) is np.ndarray or isinstance(array, np.generic)
        if isinstance(array, Tracer) or not is_plain:
            raise NoCanonicalTextError(f"an array of {type(array)}")
        kind = (
            f"jax {getattr(array, 'weak_type', None)}" if is_jax else type(array).__name__
        )
        self.add(f"array {kind} {array.shape} ")
        self._write_dtype(array.dtype)
        self.add(f" {np.asarray(array).tobytes().hex()}")

    def _write_dtype(self, dtype: Any) -> None:
        if not isinstance(dtype, np.dtype) or dtype.hasobject or dtype.fields:
            raise NoCanonicalTextError(f"the dtype {dtype}")
        self.add(f"dtype {dtype.name}")

    def _write_object(self, value: Any) -> None:
        name = importable_name(value)
        if name is not None:
            self.add(f"name {name}")
        elif isinstance(value, types.FunctionType):
            self._write_function(value)
        elif isinstance(value, type):
            raise NoCanonicalTextError(f"{value.__module__}.{value.__qualname__}")
        elif isinstance(value, tuple | list):
            self._write_all(type(value), value)
        elif isinstance(value, frozenset):
            self._write_all(frozenset, sorted(map(canonical_text, value)))
        elif isinstance(value, dict | types.MappingProxyType):
            self._write_all(type(value), (*value.keys(), *value.values()))
        elif isinstance(value, enum.Enum):
            self._write_all(type(value), (value.name,))
        elif isinstance(value, functools.partial):
            self._write_all(type(value), (value.func, value.args, value.keywords))
        elif isinstance(value, types.MethodType):
            self._write_all(type(value), (value.__func__, value.__self__))
        elif isinstance(value, jax.tree_util.PyTreeDef):
            numbered = jax.tree.unflatten(value, range(value.num_leaves))
            self._write_all(jax.tree_util.PyTreeDef, (numbered,))
        elif dataclasses.is_dataclass(value):
            fields = dataclasses.fields(value)
            values = [getattr(value, field.name, None) for field in fields]
            self._write_all(type(value), values)
        else:
            raise NoCanonicalTextError(f"an object of {type(value)}")

    def _write_function(self, function: types.FunctionType) -> None:
        """Write a function of a package that is not found by its name."""
        # A decorator may have changed `__module__`, but not the module of the code.
        module = function.__globals__.get("__name__", "")
        if module.startswith("jaxtyping."):  # It only checks the types of arguments.
            self.write(getattr(function, "__wrapped__", None))
            return
        code = function.__code__
        if not is_known_module(module):
            raise NoCanonicalTextError(f"{module}.{function.__qualname__}")
        # Several functions may be in one line.
        constants = [value for value in code.co_consts if type(value) in _PLAIN]
        location = f"{code.co_qualname} {code.co_firstlineno} {code.co_code.hex()}"
        self.add(f"function {module}.{location} {constants} {code.co_names}")
        if function.__closure__ or function.__defaults__ or function.__kwdefaults__:
            try:
                cells = [cell.cell_contents for cell in function.__closure__ or ()]
            except ValueError:
                raise NoCanonicalTextError(f"empty cell of {location}") from None
            values = cells, function.__defaults__, function.__kwdefaults__
            self._write_all(tuple, values)

    def _write_all(self, kind: type, values: Iterable[Any]) -> None:
        if kind in (tuple, list, dict):
            self.add(kind.__name__)
        else:
            self.write(kind)
        self.add("(")
        for value in values:
            self.write(value)
            self.add(",")
        self.add(")")


def is_known_module(name: str) -> bool:
    """Decide whether a module belongs to a package whose version is in the keys."""
    return name.partition(".")[0] in _PACKAGES


def importable_name(value: Any) -> str | None:
    """Return the name of a function or class of a package."""
    module = getattr(value, "__module__", None)
    qualified_name = getattr(value, "__qualname__", None)
    if not isinstance(module, str) or not isinstance(qualified_name, str):
        return None
    if not is_known_module(module):
        return None
    found: Any = sys.modules.get(module)
    for name in qualified_name.split("."):
        found = getattr(found, name, None)
    return f"{module}.{qualified_name}" if found is value else None
