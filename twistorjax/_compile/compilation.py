"""Compilation in less time, for programs that run only a few times."""

import contextlib
import gc
import os
from collections.abc import Callable, Iterator
from functools import partial, wraps
from typing import Any

import equinox as eqx
import jax
import jaxlib.version

from .._utils.host import is_traced, runs_line_by_line
from .._utils.progress import compiling
from .stored_gradients import with_gradient
from .stored_traces import stored


_JAXLIB = tuple(map(int, jaxlib.version.__version__.split(".")[:2]))
# The fusion emitters of XLA take 40 % of the time of the compilation of a motion, the
# higher levels of optimization take 15 %, and these passes take 5 %, because they change
# one operation after another and XLA simplifies the program again after each change. The
# motion does not run faster with them (jaxlib 0.10.2; `benchmarks.first_calls`). The
# emitters cannot be switched off from jaxlib 0.11 on.
_FAST = {
    **({"xla_cpu_use_fusion_emitters": False} if _JAXLIB < (0, 11) else {}),
    "xla_backend_optimization_level": 1,
    "xla_disable_hlo_passes": "reshape-mover,while-loop-invariant-code-motion",
    # The more parts of a program are compiled side by side, the slower it is loaded.
    "xla_cpu_parallel_codegen_split_count": 4,
}
_NOT_OPTIMIZED = {**_FAST, "xla_backend_optimization_level": 0}


def fast_compile(
    function: Callable,
    *,
    optimize: bool = True,
    store: bool = True,
    jit: Callable[..., Any] = eqx.filter_jit,
    **settings: Any,
) -> Callable:
    """Compile a function with settings of XLA that reduce the compilation time.

    Its traces are stored on disk; see `stored`. An option in the environment variable
    `XLA_FLAGS` is not replaced. This holds also for a gradient outside of compiled
    functions; see `with_gradient`. Inside another compiled function, for other
    derivatives, and while JAX vectorizes the function, the settings have no effect.

    Args:
        optimize: Whether XLA optimizes the program. Without optimization, the compilation
            of a simulation takes half the time, and a run at least twice the time, which
            pays off for a program that runs once. Its gradient computes the value again.
        store: Whether traces are stored. Those with callbacks to Python cannot be stored.
        jit: `equinox.filter_jit`, or `jax.jit`, whose calls take less time.
        settings: Arguments of `jit`.
    """
    function = _traced_quickly(function)
    in_program = jit(function, **settings)
    if store:
        in_program = with_gradient(
            function,
            in_program,
            partial(_part, optimize=optimize),
            None if optimize else lambda *values, **named: compiled(*values, **named),
        )
    compiled = _compile(function, in_program, optimize, store, jit, **settings)
    return compiled


def _part(function: Callable, optimize: bool) -> Callable:
    """Compile one of the two programs of a gradient."""
    return _compile(function, eqx.filter_jit(function), optimize)


def _compile(
    function: Callable,
    in_program: Callable,
    optimize: bool = True,
    store: bool = True,
    jit: Callable[..., Any] = eqx.filter_jit,
    **settings: Any,
) -> Callable:
    """Compile a function as `fast_compile` does.

    `in_program` is called instead if JAX is tracing an argument.
    """
    traced = stored(function) if store else function
    options = _options(_FAST if optimize else _NOT_OPTIMIZED)
    fast = jit(traced, compiler_options=options, **settings)

    @wraps(function)
    def compiled(*arguments: Any, **static: Any) -> Any:
        nonlocal fast
        if is_traced((arguments, static)) or jax.default_backend() != "cpu":
            return in_program(*arguments, **static)
        try:
            return fast(*arguments, **static)
        except ValueError as error:  # inside another program, of constant arguments
            if "top-level" not in str(error):
                raise
        except jax.errors.JaxRuntimeError as error:
            if not _are_unknown(error):
                raise
            fast = in_program
        return in_program(*arguments, **static)

    return compiled


def compile_lowered(lowered: jax.stages.Lowered, platform: str) -> jax.stages.Compiled:
    """Compile a program with the settings of `fast_compile`."""
    if platform == "cpu":
        try:
            return lowered.compile(compiler_options=_options(_FAST))
        except jax.errors.JaxRuntimeError as error:
            if not _are_unknown(error):
                raise
    return lowered.compile()


def _options(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of XLA that `XLA_FLAGS` does not replace.

    An option that is given with the same value is kept, so that the programs in the cache
    do not depend on whether `configure` was called before.
    """
    given = os.environ.get("XLA_FLAGS", "")
    return {
        name: value
        for name, value in options.items()
        if name not in given or f"{name}={value}".lower() in given
    }


def _are_unknown(error: Exception) -> bool:
    """Decide whether XLA does not know an option; they are not a stable interface."""
    return "No such compile option" in str(error)


# JAX does not accept options of `fast_compile` in programs that it differentiates or
# vectorizes.
FAST_COMPILATION = "xla_cpu_use_fusion_emitters=false"
# XLA calls one function for each operation, which takes longer than an operation with
# small arrays. A loop whose operations read and write less than this number of bytes
# becomes one function. Of a motion, these are the inner loops. With the outer loop as
# well, its gradient would compile in up to twice the time (`benchmarks.motion`).
FAST_LOOPS = "xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000"
# Versions of jaxlib that have an option.
_JAXLIB_WITH = {FAST_COMPILATION: {(0, 10)}, FAST_LOOPS: {(0, 10), (0, 11), (0, 12)}}


def add_xla_option(option: str) -> None:
    """Set an option of XLA for all programs of this process.

    An option in `XLA_FLAGS` is not replaced.

    Args:
        option: `FAST_COMPILATION` or `FAST_LOOPS`.
    """
    name, given = option.split("=")[0], os.environ.get("XLA_FLAGS", "")
    # XLA ends the process if it does not know an option.
    if _JAXLIB in _JAXLIB_WITH[option] and name not in given:
        os.environ["XLA_FLAGS"] = f"{given} --{option}".strip()


@contextlib.contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Pause the garbage collection of Python.

    While JAX traces a program, the number of objects grows, which causes collections.
    Without them, the first call of a motion takes 6 % less time.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _traced_quickly(function: Callable) -> Callable:
    """Return a function that JAX traces in less time.

    Its trace is made with the mesh of devices that is in effect. JAX computes gradients
    with an explicit mesh. Inner functions that were traced without one would be traced
    again for the gradient, which takes seconds.
    """

    @wraps(function)
    def traced(*arguments: Any, **static: Any) -> Any:
        if runs_line_by_line():
            return function(*arguments, **static)
        compiling()
        with (
            _no_garbage_collection(),
            jax.sharding.use_abstract_mesh(jax.sharding.get_abstract_mesh()),
        ):
            return function(*arguments, **static)

    return traced
