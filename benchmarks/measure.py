"""Rows of the table of benchmarks, and functions that measure times.

JAX returns before a computation has finished, so the functions wait for the result. They
measure the time of compilation separately.
"""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax


@dataclass(frozen=True)
class Row:
    """One row of the table.

    Args:
        benchmark: Name of the measured quantity.
        value: Result of the measurement.
        unit: Unit of the result.
        goal: Goal for the result, or empty if there is none.
        reached: Whether the goal is reached; None if there is no goal.
    """

    benchmark: str
    value: float
    unit: str
    goal: str = ""
    reached: bool | None = None


def compiled(function: Callable, *arguments: Any) -> tuple[Callable, float]:
    """Compile a function for given arguments, and measure the time.

    The time includes tracing and lowering. All programs that were compiled before are
    discarded first.

    Returns:
        The compiled function, and the time of compilation; s.
    """
    jax.clear_caches()
    start = time.perf_counter()
    program = jax.jit(function).lower(*arguments).compile()
    return program, time.perf_counter() - start


def seconds(function: Callable, *arguments: Any, repeats: int = 11) -> float:
    """Measure the median time of a call until its result is available; s.

    One more call before the measurement compiles the function.
    """
    result = jax.block_until_ready(function(*arguments))
    if callable(result) or not jax.tree.leaves(result):
        raise TypeError(
            "The function returns no array whose computation can be awaited. Return the "
            "result of the timed computation."
        )
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def at_most(benchmark: str, value: float, unit: str, bound: float) -> Row:
    """Create a row whose goal is an upper bound."""
    return Row(benchmark, value, unit, f"at most {bound:g}", bool(value <= bound))


def at_least(benchmark: str, value: float, unit: str, bound: float) -> Row:
    """Create a row whose goal is a lower bound."""
    return Row(benchmark, value, unit, f"at least {bound:,g}", bool(value >= bound))
