"""Traced functions on disk, so that later processes need not trace them again.

JAX's cache of compiled programs saves the compilation, but a new process traces each
function before it finds the program, which takes most of the time that is left. A stored
trace is a program of `jax.export`, and the structure of its result.
"""

import contextlib
import functools
import hashlib
import math
import os
import pickle
import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
from jax.core import ShapedArray, Tracer
from jax.extend.core import Primitive
from jax.extend.mlir import ir
from jax.extend.mlir.dialects import func
from jax.interpreters import mlir

from .canonical_text import canonical_text, NoCanonicalTextError
from .host import is_traced


# What a trace depends on, besides the sources of this package
_DISTRIBUTIONS = ("jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpy")
_NO_INFLUENCE = ("cache", "compilation", "log", "traceback", "dump")


class _Folder(NamedTuple):
    """Where traces are stored.

    Args:
        path: The folder.
        size: Largest total size of its files; infinite without a limit; bytes.
    """

    path: Path
    size: int | float


_folder: _Folder | None = None


def store_traces_in(path: Path | None, size: int | float = math.inf) -> None:
    """Choose the folder of the traces.

    Args:
        path: The folder, or None if no traces are stored.
        size: Largest total size of its files, by default without a limit; bytes. The
            traces that have not been used for the longest time are deleted first.
    """
    global _folder
    _folder = None if path is None else _Folder(path, size)
    if path is not None:
        _environment()  # before the sources may change


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
        inputs = list(filter(is_traced, jax.tree.leaves((arguments, settings))))
        if _folder is None or not inputs or jax.device_count() > 1:
            return function(*arguments, **settings)
        trace = _load_or_trace(_folder, function, arguments, settings)
        if trace is None:
            return function(*arguments, **settings)
        return trace.call(inputs)

    return loaded_or_traced


@dataclass(frozen=True)
class _Placeholder:
    """Placeholder of an array in a stored result.

    Args:
        index: Index of the array among the results of the program.
        weak: Whether its type is weak, as that of a Python number.
    """

    index: int
    weak: bool

    def value(self, values: Any) -> Any:
        """Return the array from the results of the program, whose types are not weak."""
        value = values[self.index]
        if not self.weak:
            return value
        return jax.lax.convert_element_type_p.bind(
            value, new_dtype=value.dtype, weak_type=True, sharding=None
        )


class _Trace(NamedTuple):
    """A traced function.

    Args:
        program: Program of the arrays.
        result: Result of the function, with placeholders instead of arrays.
    """

    program: jax.export.Exported
    result: Any

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

    def call(self, inputs: Sequence[Any]) -> Any:
        """Compute the result of the function."""
        values = _call.bind(*inputs, program=self.program)
        return jax.tree.map(
            lambda leaf: leaf.value(values) if isinstance(leaf, _Placeholder) else leaf,
            self.result,
        )


# The results of `Exported.call` are committed to a device, and JAX compiles a function
# again for committed arguments. This call leaves them uncommitted.
_call = Primitive("call_stored_trace")
_call.multiple_results = True


@_call.def_abstract_eval
def _shapes_of_results(*_: Any, program: jax.export.Exported) -> list[ShapedArray]:
    """Return the shapes of the results of a stored program."""
    return [ShapedArray(result.shape, result.dtype) for result in program.out_avals]


def _insert_program(
    context: mlir.LoweringRuleContext, *arguments: Any, program: jax.export.Exported
) -> Sequence[Any]:
    """Insert a stored program into the one that JAX is lowering, and call it."""
    if b"lapack" in program.mlir_module_serialized:
        # Only `Exported.call` prepares calls of LAPACK. It does so for each program, and
        # imports `scipy.linalg`, which takes a third of the time of `import jax`.
        by_jax = mlir.lower_fun(lambda *values: program.call(*values))
        return by_jax(context, *arguments)
    module = program.mlir_module(serialized=False)
    main: Any = ir.SymbolTable(module.operation)["main"]
    outer = context.module_context
    name = mlir.merge_mlir_modules(
        outer.module, program.fun_name, module, dst_symtab=outer.symbol_table
    )
    used = [arguments[index] for index in program.module_kept_var_idx]
    called = ir.FlatSymbolRefAttr.get(name)
    call = func.CallOp(main.type.results, called, used)  # pyright: ignore
    return call.results


mlir.register_lowering(_call, _insert_program)


def _load_or_trace(
    folder: _Folder, function: Callable[..., Any], arguments: tuple, settings: dict
) -> _Trace | None:
    """Load a trace, or trace a function and store the trace; None if it cannot be stored.

    The errors of the function are not raised.
    """
    try:
        key = _key(function, arguments, settings)
    except NoCanonicalTextError:
        return None
    trace = _load(folder.path / key)
    if trace is None:
        try:
            trace = _Trace.of(function, arguments, settings)
        except (ValueError, NotImplementedError):  # of the function, or of JAX
            return None
        _save(folder, key, trace)
    return trace


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
def _environment() -> str:
    """Return a text that identifies this package and those that it uses."""
    versions = [version(distribution) for distribution in _DISTRIBUTIONS]
    variables = sorted(item for item in os.environ.items() if item[0].startswith("EQX_"))
    return f"{_sources()} {versions} {variables}"


def _sources() -> str:
    """Return a text that identifies the sources of this package."""
    sources = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        sources.update(path.read_bytes())
    return sources.hexdigest()


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


def _load(path: Path) -> _Trace | None:
    """Read a trace; None if there is none, or if its file is damaged."""
    try:
        program, result = pickle.loads(path.read_bytes())
        os.utime(path)
        return _Trace(jax.export.deserialize(bytearray(program)), result)
    except Exception:  # a damaged file may cause any error
        return None


def _save(folder: _Folder, key: str, trace: _Trace) -> None:
    """Write a trace, unless its result has no canonical text."""
    try:
        canonical_text(trace.result)
        content = pickle.dumps((bytes(trace.program.serialize()), trace.result))
    except (NoCanonicalTextError, pickle.PicklingError, AttributeError, TypeError):
        return
    if not _environment().startswith(_sources()):
        return  # The sources have changed since this process started.
    try:
        folder.path.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder.path, delete=False) as file:
            file.write(content)
        Path(file.name).replace(folder.path / key)
        _delete_oldest(folder)
    except OSError as error:
        warnings.warn(
            f"A traced function was not stored in {str(folder.path)!r}: {error}",
            stacklevel=2,
        )


def _delete_oldest(folder: _Folder) -> None:
    """Delete the traces that have not been used for the longest time."""
    files = []
    for path in folder.path.glob("?" * 64):  # no temporary files of other processes
        with contextlib.suppress(FileNotFoundError):  # deleted by another process
            files.append((path.stat().st_mtime, path.stat().st_size, path))
    total = 0
    for _, size, path in sorted(files, reverse=True):
        total += size
        if total > folder.size:
            path.unlink(missing_ok=True)
