"""Programs that run some ten times, compiled in half the time."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp


_OPTIONS = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}


def fast_compile(function: Callable) -> Callable:
    """The function as a compiled program, for which less is done to make it fast.

    To compile a motion and its derivatives takes as long as to run them a hundred times.
    With less of XLA's work it takes half of that, and runs half as fast. Not for what is
    being traced: there the outermost program decides.
    """
    jit: Any = eqx.filter_jit  # whose annotations leave out what it hands on
    programs = {True: jit(function, compiler_options=_OPTIONS), False: jit(function)}

    def called(*arguments: Any) -> Any:
        return programs[_offered()](*arguments)

    return called


@lru_cache
def _offered() -> bool:
    """Whether this XLA has the options, which it does not promise to keep."""
    if jax.default_backend() != "cpu":
        return False
    try:
        jax.jit(jnp.sin).lower(1.0).compile(compiler_options=_OPTIONS)
    except Exception:  # of a kind that XLA does not tell
        return False
    return True
