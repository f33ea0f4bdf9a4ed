"""Timing that waits for the answer, and keeps compilation apart."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax


@dataclass(frozen=True)
class Row:
    """One line of the table: what was measured, and what was asked."""

    what: str
    value: float
    unit: str
    asked: str = ""
    met: bool | None = None


def compiled(function: Callable, *arguments: Any) -> tuple[Callable, float]:
    """The function compiled for these arguments, and the seconds that took.

    Tracing, lowering and compiling, from nothing: earlier programs are forgotten.
    """
    jax.clear_caches()
    start = time.perf_counter()
    program = jax.jit(function).lower(*arguments).compile()
    return program, time.perf_counter() - start


def seconds(function: Callable, *arguments: Any, repeats: int = 11) -> float:
    """The median time of a call, once warm, until its answer is there."""
    answer = jax.block_until_ready(function(*arguments))
    if callable(answer) or not jax.tree.leaves(answer):
        raise TypeError("There is no answer to wait for: time a call that returns one.")
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def at_most(what: str, value: float, unit: str, bound: float) -> Row:
    """A row that is met by a value up to the bound."""
    return Row(what, value, unit, f"at most {bound:g}", bool(value <= bound))


def at_least(what: str, value: float, unit: str, bound: float) -> Row:
    """A row that is met by a value from the bound on."""
    return Row(what, value, unit, f"at least {bound:,g}", bool(value >= bound))
