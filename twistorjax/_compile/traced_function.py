"""Functions of the user, as programs that are traced when they are given to a solver.

JAX identifies a function by its object. It would use an earlier program although values
have changed that the function uses, and compile a new function with the same program.
"""

import functools
import itertools
from collections.abc import Callable, Hashable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import eval_jaxpr

from .program_key import has_derivative_rules, Identity, program_key
from .trace_keys import canonical_text, NoCanonicalTextError


class TracedFunction(eqx.Module):
    """A function that calls the program of another one."""

    # Arrays that the function uses, which are inputs of compiled programs
    constants: list[Any]
    # The program. Compiled programs are shared if it is equal.
    program: "_Program" = eqx.field(static=True)

    def __call__(self, *arguments: Any) -> Any:
        return self.program.call(self.constants, arguments)


class _Program:
    """A program, and the structure of its arguments and of its result."""

    def __init__(self, function: Callable[..., Any], examples: tuple):
        leaves, self._inputs = jax.tree.flatten(examples)
        self._is_array = [
            eqx.is_array(leaf) or isinstance(leaf, jax.ShapeDtypeStruct)
            for leaf in leaves
        ]
        closed, outputs, self._others = eqx.filter_make_jaxpr(function)(*examples)
        self._jaxpr, self._outputs = closed.jaxpr, jax.tree.structure(outputs)
        self.constants = [
            constant if isinstance(constant, jax.Array) else jnp.array(np.array(constant))
            for constant in closed.consts
        ]
        # Derivative rules are not in the key of the program.
        rules = function if has_derivative_rules(closed) else None
        structures = self._inputs, self._outputs, *jax.tree.flatten(self._others), rules
        self._key = program_key(self._jaxpr), *map(_hashable, structures)

    def call(self, constants: list[Any], arguments: tuple) -> Any:
        leaves = self._inputs.flatten_up_to(arguments)
        arrays = itertools.compress(leaves, self._is_array)
        values = eval_jaxpr(self._jaxpr, constants, *arrays)
        # A result that is a number in the program is not yet an array.
        outputs = jax.tree.unflatten(self._outputs, map(jnp.asarray, values))
        return eqx.combine(outputs, self._others)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Program) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)


def traced(function: Callable[..., Any], *examples: Any) -> Callable[..., Any]:
    """Trace a function of the user, with the values that it uses at this time.

    Args:
        examples: Its arguments; a number of type float without any.

    Returns:
        A function of arguments with the same structure and the same shapes. A function of
        the library, which uses no values that may change, is returned unchanged.
    """
    if isinstance(function, TracedFunction) or _is_constant(function):
        return function
    number = jax.ShapeDtypeStruct((), jnp.result_type(float))
    program = _Program(function, examples or (number,))
    return TracedFunction(program.constants, program)


def _is_constant(function: Callable[..., Any]) -> bool:
    """Decide whether a function is from a package, apart from arrays of a pytree."""
    is_tree = isinstance(function, jax.tree_util.Partial)
    if isinstance(function, functools.partial) and not is_tree:
        return False  # The entries of arrays in it may change.
    try:
        canonical_text(eqx.filter(function, eqx.is_array, inverse=True))
    except NoCanonicalTextError:
        return False
    return True


def _hashable(value: Any) -> Hashable:
    key = program_key(value)
    try:
        hash(key)
    except TypeError:
        return Identity(value)
    return key
