"""Keys of traced programs, which are equal if the programs compute the same."""

import functools
import types
import weakref
from collections.abc import Hashable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer


# Parameters that define the program of a function with a derivative rule of its own
_CUSTOM_RULES = ("custom_jvp_call", "custom_vjp_call")
_PRIMAL = ("call_jaxpr", "fun_jaxpr")


class Identity:
    """An object that is equal only to itself, and that is kept."""

    def __init__(self, value: Any):
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Identity) and self.value is other.value

    def __hash__(self) -> int:
        return id(self.value)


def program_key(program: Any) -> Hashable:
    """Return the key of a program that JAX has traced.

    Args:
        program: The program: a `ClosedJaxpr`, whose constants are in the key, or a
            `Jaxpr`; or another value.

    Returns:
        The key. It does not contain derivative rules that are not those of JAX, so that
        the derivatives of programs with the same key may differ.
    """
    return _Builder().value(program)


def has_derivative_rules(program: Any) -> bool:
    """Decide whether a program has derivative rules that are not those of JAX."""
    builder = _Builder()
    builder.value(program)
    return builder.has_rules


# Keys of inner programs, which JAX keeps for functions that it has traced before
_known: weakref.WeakKeyDictionary[Any, tuple[Hashable, bool]] = (
    weakref.WeakKeyDictionary()
)


class _Builder:
    """Builds the key of a program.

    Args:
        has_rules: Whether a derivative rule was left out.
        has_constants: Whether an inner program has constants, which may change.
        open: Functions that contain the one whose key is built.
    """

    def __init__(self) -> None:
        self.has_rules = self.has_constants = False
        self.open: list[int] = []

    def jaxpr(self, jaxpr: Any) -> Hashable:
        if (known := _known.get(jaxpr)) is not None:
            self.has_rules |= known[1]
            return known[0]
        builder = _Builder()
        builder.open = self.open
        numbers: dict[Any, int] = {}

        def defined(variables: Any) -> tuple[Hashable, ...]:
            for variable in variables:
                numbers[variable] = len(numbers)
            return tuple(variable.aval for variable in variables)

        def used(atom: Any) -> Hashable:
            if hasattr(atom, "val"):  # a number
                return atom.aval, builder.value(atom.val)
            return numbers[atom]

        inputs = defined(jaxpr.constvars), defined(jaxpr.invars)
        equations = tuple(
            (
                equation.primitive,
                builder.parameters(equation),
                tuple(map(used, equation.invars)),
                defined(equation.outvars),
            )
            for equation in jaxpr.eqns
        )
        key = _Key((inputs, equations, tuple(map(used, jaxpr.outvars))))
        self.has_rules |= builder.has_rules
        self.has_constants |= builder.has_constants
        if not builder.has_constants:
            _known[jaxpr] = key, builder.has_rules
        return key

    def parameters(self, equation: Any) -> Hashable:
        parameters = equation.params
        if equation.primitive.name.startswith(_CUSTOM_RULES):
            self.has_rules = True
            parameters = {name: parameters.get(name) for name in _PRIMAL}
        return self.value(parameters)

    def value(self, value: Any) -> Hashable:
        kind = type(value)
        if isinstance(value, Tracer):
            self.has_constants = True
            return Identity(value)
        if hasattr(value, "jaxpr") and hasattr(value, "consts"):
            self.has_constants |= bool(value.consts)
            return self.jaxpr(value.jaxpr), self.value(list(value.consts))
        if hasattr(value, "eqns"):
            return self.jaxpr(value)
        if isinstance(value, np.ndarray | np.generic | jax.Array) or (
            hasattr(value, "__array__") and hasattr(value, "dtype")
        ):
            self.has_constants |= bool(value.ndim)
            if jnp.issubdtype(value.dtype, jax.dtypes.extended):
                return Identity(value)
            array = np.asarray(value)
            weak = getattr(value, "weak_type", False)
            return "array", array.dtype.str, array.shape, weak, array.tobytes()
        if isinstance(value, float):  # NaN differs from itself, and 0.0 equals -0.0.
            return kind, value.hex()
        if isinstance(value, complex):
            return kind, value.real.hex(), value.imag.hex()
        if isinstance(value, Mapping):
            return kind, tuple((key, self.value(value[key])) for key in value)
        if isinstance(value, tuple | list):
            return kind, tuple(map(self.value, value))
        if isinstance(value, functools.partial):
            return kind, self.value((value.func, value.args, value.keywords))
        if isinstance(value, types.MethodType):
            return kind, self.value((value.__func__, value.__self__))
        if isinstance(value, types.FunctionType):
            return self.function(value)
        try:
            hash(value)
        except TypeError:
            return Identity(value)
        return kind, value

    def function(self, function: types.FunctionType) -> Hashable:
        """Return the key of a function that is called when the program runs.

        JAX or the user may have created it while the program was traced.
        """
        self.has_constants = True
        if id(function) in self.open:
            return "recursive", self.open.index(id(function))
        self.open.append(id(function))
        try:
            cells = [cell.cell_contents for cell in function.__closure__ or ()]
            parts = cells, function.__defaults__, function.__kwdefaults__
            return function.__code__, Identity(function.__globals__), self.value(parts)
        except (ValueError, RecursionError):  # an empty cell
            return Identity(function)
        finally:
            self.open.pop()


class _Key:
    """A tuple whose hash is computed once."""

    def __init__(self, parts: tuple):
        self.parts, self.hash = parts, hash(parts)

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        return (
            isinstance(other, _Key)
            and self.hash == other.hash
            and self.parts == other.parts
        )

    def __hash__(self) -> int:
        return self.hash
