"""Values that JAX is tracing, and computations on the host of values that it is not."""

from collections.abc import Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from .types import Numbers


def concrete(value: Any) -> np.ndarray | None:
    """Return numbers as a NumPy array; `None` if JAX is tracing one of them."""
    is_sequence = isinstance(value, list | tuple)
    traced = is_traced(value) if is_sequence else isinstance(value, Tracer)
    return None if traced else np.asarray(value)


def all_concrete(values: Iterable[Any]) -> list[np.ndarray] | None:
    """Return values as NumPy arrays; `None` if JAX is tracing one of them."""
    arrays = [concrete(value) for value in values]
    concrete_arrays = [array for array in arrays if array is not None]
    return concrete_arrays if len(concrete_arrays) == len(arrays) else None


def is_traced(tree: Any) -> bool:
    """Decide whether JAX is tracing a leaf of a pytree."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def runs_line_by_line() -> bool:
    """Decide whether JAX compiles no functions, as with `tj.configure(debug=True)`."""
    config: Any = jax.config
    return config.jax_disable_jit


def on_host(*values: Any) -> tuple[Any, Sequence[Any]]:
    """Return NumPy, or `jax.numpy` if a value is traced, and the values as its arrays.

    An eager operation of `jax.numpy` compiles a program, so that a mechanism of concrete
    values would compile dozens of programs before anything is solved
    (`benchmarks.first_calls`).
    """
    arrays = all_concrete(values)
    return (jnp, values) if arrays is None else (np, arrays)


def tree_on_host(tree: Any) -> tuple[Any, Any]:
    """Return the module for a formula and its arrays, as `on_host`, for a pytree."""
    leaves, structure = jax.tree.flatten(tree)
    xp, arrays = on_host(*leaves)
    return xp, jax.tree.unflatten(structure, arrays)


def as_float(value: Any) -> Numbers:
    """Convert real numbers, or lists of real numbers, to a JAX array.

    Values that are not traced are converted by NumPy, which compiles no program.
    """
    if any(np.iscomplexobj(leaf) for leaf in jax.tree.leaves(value)):
        raise TypeError(f"{value!r} is complex, but real numbers are needed.")
    return jnp.asarray(value if is_traced(value) else np.asarray(value, float), float)


def program_input(value: Any, dtype: type) -> Any:
    """Convert a number to an argument of a compiled program.

    A call takes 30 us less for each argument that is an array of NumPy and not of JAX.
    """
    known = concrete(value)
    return jnp.asarray(value, dtype) if known is None else known.astype(dtype)


def take_rows(values: Any, rows: Any) -> Any:
    """Select rows of an array, without a compilation if it is not traced."""
    known = concrete(values)
    return values[rows] if known is None else jax.device_put(known[rows])


def padded_size(count: int, smallest: int = 1) -> int:
    """Return the size to which arrays are padded, so that many sizes share a program.

    The size is a power of two, and the `smallest` one or more.
    """
    return max(smallest, 1 << max(0, count - 1).bit_length())
