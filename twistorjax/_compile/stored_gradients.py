"""Reverse-mode derivatives that are two compiled programs, whose traces are stored."""

import hashlib
import re
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array

from .trace_keys import canonical_text, NoCanonicalTextError


try:
    from jax.core import ShapedArray
    from jax.interpreters.ad import Zero
except ImportError:  # The internals of JAX have changed.
    ShapedArray = Zero = None


def with_gradient(
    function: Callable,
    in_program: Callable,
    compile_part: Callable[[Callable], Callable],
    value_again: Callable | None = None,
) -> Callable:
    """Return a function whose gradient is computed by two programs.

    JAX compiles a function that it differentiates without the settings of `fast_compile`,
    and traces it in each process. Here the value with its residuals, and the gradient,
    are two functions that are compiled with these settings (`benchmarks.first_calls`).

    Args:
        function: Function of pytrees.
        in_program: The same function, which is called inside another program, for other
            derivatives, and if an argument contains a function of the user, which may
            depend on values that JAX is tracing.
        compile_part: Function that compiles one of the programs.
        value_again: The compiled function, if it runs for less time than residuals take
            to compile. The gradient's program then computes the value once more.
    """

    @compile_part
    def forward(perturbed: Any, arguments: tuple) -> tuple[Any, list[Array], str]:
        value, pullback = _linearize(function, perturbed, arguments)
        residuals, structure = jax.tree.flatten(pullback)
        return value, residuals, _identity(structure)

    @compile_part
    def backward(
        perturbed: Any,
        arguments: tuple,
        residuals: Sequence[Array],
        identity: str,
        gradient: Any,
    ) -> tuple:
        shapes = eqx.filter_eval_shape(_linearize, function, perturbed, arguments)
        structure = jax.tree.structure(shapes[1])
        if _identity(structure) == identity:
            pullback = jax.tree.unflatten(structure, residuals)
        else:  # There are no residuals, or they are those of another trace.
            _, pullback = _linearize(function, perturbed, arguments)
        (by_arguments,) = pullback(_with_zeros(gradient, shapes[0]))
        return by_arguments

    @eqx.filter_custom_vjp
    def differentiable(arguments: tuple) -> Any:
        positional, named = arguments
        return in_program(*positional, **named)

    @differentiable.def_fwd
    def _value_and_residuals(perturbed: Any, arguments: tuple) -> tuple[Any, Any]:
        if value_again is not None:
            positional, named = arguments
            return value_again(*positional, **named), ([], "", perturbed)
        value, residuals, identity = forward(perturbed, arguments)
        return value, (residuals, identity, perturbed)

    @differentiable.def_bwd
    def _gradient(residuals: Any, gradient: Any, _: Any, arguments: tuple) -> Any:
        arrays, identity, perturbed = residuals
        return backward(perturbed, arguments, arrays, identity, gradient)

    @wraps(function)
    def call(*positional: Any, **named: Any) -> Any:
        arguments = positional, named
        if _is_gradient_of_known_values(arguments) and _has_text(arguments):
            return jax.tree.map(_without_tangent, differentiable(arguments))
        return in_program(*positional, **named)

    return call


def _is_gradient_of_known_values(arguments: Any) -> bool:
    """Decide whether JAX is tracing arguments only for a gradient, outside of programs.

    The values of the arguments are then known.
    """
    tracers = [leaf for leaf in jax.tree.leaves(arguments) if isinstance(leaf, Tracer)]
    return bool(tracers) and all(
        getattr(tracer._trace, "is_vjp", False)
        and not isinstance(getattr(tracer, "primal", tracer), Tracer)
        for tracer in tracers
    )


@eqx.filter_jit  # traced once for both programs
def _linearize(function: Callable, perturbed: Any, arguments: tuple) -> tuple[Any, Any]:
    """Return the value of a function, and the function that computes its gradient."""
    differentiated, constant = eqx.partition(arguments, perturbed)

    def value(differentiated: tuple) -> Any:
        positional, named = eqx.combine(differentiated, constant)
        return function(*positional, **named)

    return eqx.filter_vjp(value, differentiated)


def _with_zeros(gradient: Any, value: Any) -> Any:
    """Replace the gradients that are None by zeros.

    Products with symbolic zeros, if JAX has them, are not computed.
    """

    def zero(shape: Any, part: Any) -> Any:
        if part is not None:
            return part
        if Zero is None or ShapedArray is None:
            return jnp.zeros(shape.shape, shape.dtype)
        return Zero(ShapedArray(shape.shape, shape.dtype))

    return jax.tree.map(zero, eqx.filter(value, _is_inexact), gradient)


def _without_tangent(value: Any) -> Any:
    """Return an integer or boolean array that JAX does not differentiate.

    All results of `jax.custom_vjp` have tangents, also integers. Bitwise operations
    have none.
    """
    return value & value if eqx.is_array(value) and not _is_inexact(value) else value


def _is_inexact(value: Any) -> bool:
    return hasattr(value, "dtype") and jnp.issubdtype(value.dtype, jnp.inexact)


def _identity(structure: Any) -> str:
    """Return a text that differs if the residuals have another meaning."""
    text = re.sub(r" at 0x[0-9a-f]+", "", str(structure))
    return hashlib.sha256(text.encode()).hexdigest()


def _has_text(value: Any) -> bool:
    """Decide whether a value, apart from its arrays, has a canonical text.

    A function of the user has none, and neither has an array that JAX is tracing, if it
    is inside of a function.
    """
    try:
        canonical_text(eqx.filter(value, eqx.is_array, inverse=True))
    except NoCanonicalTextError:
        return False
    return True
