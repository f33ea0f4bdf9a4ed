"""Functions of pytrees: grouping by structure, names of leaves, and derivatives."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float


Tree = TypeVar("Tree")


def group_by_structure(trees: Sequence[Any]) -> list[list[int]]:
    """Return the indices of the pytrees of each group that can be stacked.

    All pytrees of a group have the same structure, and their leaves have the same shapes
    and dtypes.
    """
    groups: dict[Any, list[int]] = {}
    for index, tree in enumerate(trees):
        leaves, structure = jax.tree.flatten(tree)
        shapes = tuple((np.shape(leaf), jnp.result_type(leaf)) for leaf in leaves)
        groups.setdefault((structure, shapes), []).append(index)
    return list(groups.values())


def path_name(path: Sequence[Any]) -> str:
    """Return the name of a leaf, such as "leaf.length"; "value" if the path is empty."""
    return jax.tree_util.keystr(tuple(path), simple=True, separator=".") or "value"


def entry_names(name: str, shape: tuple[int, ...]) -> list[str]:
    """Return the names of the entries of an array, such as "web[0]" and "web[1]".

    They are in row-major order. A scalar has only `name`.
    """
    indices = (", ".join(map(str, index)) for index in np.ndindex(shape))
    return [f"{name}[{index}]" if index else name for index in indices]


def stop_gradient(tree: Any) -> Any:
    """Return a pytree whose arrays are constants for differentiation.

    It is for values that change how a result is computed, but not the result. Apply it to
    the inputs of a computation: JAX traces tangents also if they are dropped at its end.
    """
    arrays, others = eqx.partition(tree, eqx.is_array)
    return eqx.combine(jax.lax.stop_gradient(arrays), others)


def select(condition: Any, values: Tree, others: Tree) -> Tree:
    """Return the first of two pytrees where a condition is true, and else the second."""
    return jax.tree.map(partial(jnp.where, condition), values, others)


def split_last_axis(array: Any, shapes: Sequence[tuple[int, ...]]) -> list[Any]:
    """Split the last axis of an array of JAX or NumPy into parts of the given shapes."""
    ends = np.cumsum([math.prod(shape) for shape in shapes])
    return [
        array[..., end - math.prod(shape) : end].reshape((*array.shape[:-1], *shape))
        for end, shape in zip(ends, shapes, strict=True)
    ]


def is_zero(tangent: Any) -> bool:
    """Decide whether a tangent in a rule with symbolic zeros is that of a constant.

    Without symbolic zeros, a rule of `jax.custom_jvp` computes the terms of all
    arguments, also of those that are constants, and XLA does not remove these zeros.
    """
    return isinstance(tangent, SymbolicZero)


def jvp_of_varied(
    function: Callable[..., Tree], primals: tuple, tangents: tuple
) -> tuple[Tree, Tree]:
    """Compute a function, and its derivative in the direction of tangents.

    If a tangent is a symbolic zero (see `is_zero`), the derivative with respect to its
    array is not computed.
    """
    rates = jax.tree.map(lambda rate: None if is_zero(rate) else rate, tangents)
    value, derivative = eqx.filter_jvp(function, primals, rates)

    def materialized(part: Array, rate: Array | None) -> Array:
        return jnp.zeros_like(part) if rate is None else rate

    return value, jax.tree.map(materialized, value, derivative)


@eqx.filter_custom_jvp
def with_derivative(rule: Callable[..., Tree], value: Tree, *arguments: Any) -> Tree:
    """Return a value that is known, with derivatives with respect to the arguments.

    `rule(value, arguments, tangents)` returns its tangent, for example from equations
    that the value solves. Tangents of arrays that do not vary are None.
    """
    del rule, arguments
    return value


@with_derivative.def_jvp
def _(primals, tangents):
    rule, _, *arguments = primals
    value = with_derivative(*primals)
    return value, rule(value, arguments, tangents[2:])


def value_and_jacfwd(
    function: Callable[[Array], Array], point: Float[Array, " entries"]
) -> tuple[Array, Array]:
    """Compute a function of a vector and its Jacobian in one pass, in forward mode.

    The last axis of the Jacobian is that of the vector.
    """

    def directional_derivative(direction: Array) -> tuple[Array, Array]:
        return jax.jvp(function, (point,), (direction,))

    basis = jnp.eye(point.size, dtype=point.dtype)
    return jax.vmap(directional_derivative, out_axes=(None, -1))(basis)


def largest_of(values: Array, axis: int = -1) -> Array:
    """Return the largest values along an axis, with the derivatives of these entries.

    The derivative of `jnp.max` compares the values with their maximum. A compiled program
    may compute them again with other rounding errors; then none of them is equal, and the
    derivative is zero or NaN.
    """
    index = jnp.argmax(jax.lax.stop_gradient(values), axis=axis, keepdims=True)
    return jnp.take_along_axis(values, index, axis=axis).squeeze(axis)
