"""Compilation with reduced optimization, for programs that run only a few times."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp


_OPTIONS = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}


def fast_compile(function: Callable) -> Callable:
    """Compile a function with reduced optimization by XLA.

    The full compilation of a simulation and its derivatives takes as long as about one
    hundred runs. Reduced optimization halves the compilation time and doubles the time
    of a run, which pays off for the ten evaluations of a typical identification. Inside
    another compiled function the reduced optimization has no effect.

    Args:
        function: Function of pytrees, as for `equinox.filter_jit`.

    Returns:
        The compiled function.
    """
    jit: Any = eqx.filter_jit  # its annotations do not contain `compiler_options`
    programs = {True: jit(function, compiler_options=_OPTIONS), False: jit(function)}

    def compiled(*arguments: Any) -> Any:
        return programs[_options_are_available()](*arguments)

    return compiled


@lru_cache
def _options_are_available() -> bool:
    """Whether this version of XLA accepts the options, which are not a stable API."""
    if jax.default_backend() != "cpu":
        return False
    try:
        jax.jit(jnp.sin).lower(1.0).compile(compiler_options=_OPTIONS)
    except Exception:  # XLA does not document the type of this exception
        return False
    return True
