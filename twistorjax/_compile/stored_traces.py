"""Traced functions on disk, so that later processes need not trace them again.

JAX's cache of compiled programs saves the compilation, but a new process traces each
function before it finds the program, which takes most of the time that is left. A stored
trace is a program of `jax.export`, and the structure of its result. If a trace cannot be
stored or loaded, for whatever reason, the function is traced.
"""

import contextlib
import functools
import hashlib
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
from jax.core import Tracer

from .._utils.host import is_traced
from .result_structure import from_text, to_text
from .trace_folder import TraceFolder
from .trace_keys import canonical_text, NoCanonicalTextError


try:
    from .program_call import call_program
except (ImportError, AttributeError):  # The internals of JAX have changed.
    call_program = None


# What a trace depends on, besides the sources of this package
_DISTRIBUTIONS = ("jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpy")
_NO_INFLUENCE = ("cache", "compilation", "log", "traceback", "dump")


_folder: TraceFolder | None = None


def store_traces_in(
    path: Path | None, size: int | float = math.inf, *, shared: bool = False
) -> None:
    """Choose the folder of the traces.

    Args:
        size: Largest total size of its files, by default without a limit; bytes. The
            traces that have not been used for the longest time are deleted first.
        shared: Whether traces are loaded that other users may have stored.
    """
    global _folder
    _folder = None
    # The sources are read now, because they may change while the process runs.
    if path is not None and call_program is not None and _environment() is not None:
        _folder = TraceFolder(path, size, shared)


def stored(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function to be compiled, whose trace is loaded from disk if it is there.

    A trace is stored if all static arguments have a canonical text. Functions and classes
    of users have none, because their contents may change.

    Args:
        function: Function of pytrees, without side effects while it is traced.

    Returns:
        The function, for `jax.jit` or `equinox.filter_jit`. It is not differentiable.
    """

    @functools.wraps(function)
    def loaded_or_traced(*arguments: Any, **settings: Any) -> Any:
        is_program = is_traced((arguments, settings)) and jax.device_count() == 1
        if _folder is None or not is_program:
            return function(*arguments, **settings)
        # An error of the function is raised again below; others are of changes in JAX.
        with contextlib.suppress(Exception):
            return _load_or_trace(_folder, function, arguments, settings)
        return function(*arguments, **settings)

    return loaded_or_traced


@dataclass(frozen=True)
class _Placeholder:
    """Placeholder of an array in a stored result."""

    index: int  # Index of the array among the results of the program
    weak: bool  # Whether its type is weak, as that of a Python number

    def value(self, values: Any) -> Any:
        """Return the array from the results of the program, whose types are not weak."""
        value = values[self.index]
        if not self.weak:
            return value
        return jax.lax.convert_element_type_p.bind(
            value, new_dtype=value.dtype, weak_type=True, sharding=None
        )


class _Trace(NamedTuple):
    """A traced function."""

    program: Any  # Program of the arrays, as `jax.export` returns it
    result: Any  # Result of the function, with placeholders instead of arrays

    @classmethod
    def of(
        cls, function: Callable[..., Any], arguments: tuple, settings: dict
    ) -> "_Trace":
        """Trace a function."""
        inputs, constants = eqx.partition((arguments, settings), is_traced)
        leaves, structure = jax.tree.flatten(inputs)
        results = []

        def program(*arrays: Any) -> list[Any]:
            inputs = jax.tree.unflatten(structure, arrays)
            arguments, settings = eqx.combine(inputs, constants)
            outputs, others = eqx.partition(
                function(*arguments, **settings), eqx.is_array
            )
            values, output_structure = jax.tree.flatten(outputs)
            weak = [getattr(value, "weak_type", False) for value in values]
            placeholders = map(_Placeholder, range(len(values)), weak)
            results.append(
                eqx.combine(jax.tree.unflatten(output_structure, placeholders), others)
            )
            return [jax.lax.convert_element_type(value, value.dtype) for value in values]

        # Custom calls need not be stable, because the key contains the version of JAX.
        any_call = jax.export.DisabledSafetyCheck.custom_call("ALL")
        export = jax.export.export(jax.jit(program), disabled_checks=[any_call])
        return cls(export(*map(_shape, leaves)), results[0])

    @classmethod
    def from_bytes(cls, content: bytes) -> "_Trace":
        """Read a trace that `to_bytes` has returned."""
        structure, program = content.split(b"\n", 1)
        return cls(jax.export.deserialize(bytearray(program)), from_text(structure))

    def to_bytes(self) -> bytes:
        """Convert a trace to bytes, unless its result has no text."""
        text = to_text(self.result).encode()
        return b"\n".join((text, bytes(self.program.serialize())))

    def call(self, inputs: Sequence[Any]) -> Any:
        """Compute the result of the function."""
        assert call_program is not None
        values = call_program(self.program, inputs)
        return jax.tree.map(
            lambda leaf: leaf.value(values) if isinstance(leaf, _Placeholder) else leaf,
            self.result,
        )


def _load_or_trace(
    folder: TraceFolder, function: Callable[..., Any], arguments: tuple, settings: dict
) -> Any:
    """Call a function by its stored trace; otherwise trace it, and store the trace."""
    key = _key(function, arguments, settings)
    inputs = list(filter(is_traced, jax.tree.leaves((arguments, settings))))
    if (content := folder.read(key)) is not None:
        with contextlib.suppress(Exception):  # It is replaced by a new one.
            return _Trace.from_bytes(content).call(inputs)
    trace = _Trace.of(function, arguments, settings)
    result = trace.call(inputs)
    # The sources may have changed since this process started.
    if str(_environment()).startswith(_sources()):
        with contextlib.suppress(NoCanonicalTextError):
            folder.write(key, trace.to_bytes())
    return result


def _shape(leaf: Any) -> Any:
    """Return the shape of an array that JAX is tracing, and other values unchanged."""
    if not isinstance(leaf, Tracer):
        return leaf
    return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, weak_type=leaf.weak_type)


def _key(function: Callable[..., Any], arguments: tuple, settings: dict) -> str:
    """Return the name of the file with a trace."""
    text = canonical_text((function, *jax.tree.map(_shape, (arguments, settings))))
    return hashlib.sha256(f"{_environment()} {_options()} {text}".encode()).hexdigest()


@functools.cache
def _environment() -> str | None:
    """Return a text that identifies this package and those that it uses.

    It is None if they are installed without their sources or without their versions.
    """
    try:
        sources = _sources()
        versions = [version(distribution) for distribution in _DISTRIBUTIONS]
    except (OSError, PackageNotFoundError):
        return None
    variables = sorted(item for item in os.environ.items() if item[0].startswith("EQX_"))
    return f"{sources} {versions} {variables}" if sources else None


def _sources() -> str:
    """Return a text that identifies the sources of this package; empty if it has none."""
    sources = hashlib.sha256()
    paths = sorted(Path(__file__).parents[1].rglob("*.py"))
    for path in paths:
        sources.update(path.read_bytes())
    return sources.hexdigest() if paths else ""


def _options() -> str:
    """Return the options of JAX that may change a trace."""
    return str(
        [
            # The attribute is the value in this context, for example in `jax.enable_x64`.
            (name, getattr(jax.config, name, value))
            for name, value in sorted(jax.config.values.items())
            if not any(part in name for part in _NO_INFLUENCE)
        ]
    )
