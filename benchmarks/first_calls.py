"""Times of first calls in a new process, without and with cached programs.

The start of Python, imports, and compilation are what a user waits for. All processes of
one kind use a cache folder that is empty at first, so the second process finds the
programs of the first one. The module `analyses` measures all analyses of mechanisms.
"""

import contextlib
import importlib.util
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial

from .measure import at_most, Row


REPEATS = 3  # of second calls

# Whole processes, with the largest multiple of the time of `import jax` for a second one.
PROCESSES = {
    "`import twistorjax`": (["-c", "import twistorjax"], 1.5),
    "`twistorjax stage`": (["-m", "twistorjax", "stage"], 2.5),
    "`twistorjax four-bar --json`": (["-m", "twistorjax", "four-bar", "--json"], 3.0),
    "`twistorjax identify`": (["-m", "twistorjax", "identify"], 5.0),
}

# Preparation and call, with the largest times of a first and a second one; s.
LINKAGE = (
    "from twistorjax.examples import four_bar; "
    "linkage = four_bar.four_bar(damping=four_bar.RELEASED_DAMPING); "
    "times = np.linspace(0.0, 0.2, 41)"
)
GRADIENT = (
    f"{LINKAGE}; numbers, rest = eqx.partition(linkage, eqx.is_inexact_array); "
    "value = lambda numbers: jnp.sum(four_bar.released_motion("
    "eqx.combine(numbers, rest), times, energies=False).displacements**2)"
)
IDENTIFICATION = (
    "from twistorjax.examples import identification as example; "
    "data = example.release_test().synthetic_data(example.linkage(example.LEAF)); "
    "guess = {name: tj.Parameter(example.START_RATIOS[name] * value, lower=0) "
    "for name, value in example.LEAF.items()}"
)
LEAF = (
    "steel = tj.Material(210e9, poisson=0.3); "
    "beam = tj.flexures.Beam(steel, length=0.05, thickness=0.5e-3, width=0.01)"
)
GUIDE = (
    f"{LEAF}; leaf = tj.flexures.surrogate(beam, rotation=0.35); "
    "hinge = tj.Hinge('leaf', 'wall', 'block', leaf, at=(0, 0, 0)); "
    "bodies = [tj.Body('wall'), tj.Body('block')]; "
    "guide = tj.Mechanism(bodies, [hinge], fixed=['wall']); "
    "push = lambda guide: tj.equilibrium(guide, loads=[tj.Load('block', moment=0.1)])"
)
CALLS = {
    "simulate": (LINKAGE, "four_bar.released_motion(linkage, times)", (3.0, 1.5)),
    "reverse-mode gradient of simulate": (
        GRADIENT,
        "jax.grad(value)(numbers)",
        (8.0, 3.0),
    ),
    "identify": (IDENTIFICATION, "tj.identify(example.linkage, guess, [data])", None),
    "surrogate": (LEAF, "tj.flexures.surrogate(beam, rotation=0.35)", (4.0, None)),
    "equilibrium with a surrogate": (GUIDE, "push(guide)", (3.0, None)),
    "reverse-mode gradient of an equilibrium with a surrogate": (
        GUIDE,
        "eqx.filter_grad(lambda guide: push(guide).displacement('block')[0])(guide)",
        (5.0, None),
    ),
}
# Numba compiles in each process. EXUDYN compiles nothing.
PEERS = {
    "SciPy LSODA with Numba": (
        "numba",
        "from benchmarks.peers_motion import COMPILED, FOUR_BARS",
        "FOUR_BARS[0][1](COMPILED, 1e-13, FOUR_BARS[0][3][COMPILED])[0]()",
    ),
    "EXUDYN": (
        "exudyn",
        "from benchmarks.peers_motion import exudyn_released",
        "exudyn_released()()",
    ),
}
FIRST_CALL = "first call of {} in a new process, {}"
SCRIPT = """
import time
import equinox as eqx, jax, jax.numpy as jnp, numpy as np
import twistorjax as tj
tj.configure(progress=False)
{setup}
start = time.perf_counter()
jax.block_until_ready(eqx.filter({call}, eqx.is_array))
print(time.perf_counter() - start)
"""


def run() -> Iterator[Row]:
    """Yield the rows of the table."""
    yield from _processes()
    yield from _calls()


@contextlib.contextmanager
def empty_cache() -> Iterator[dict[str, str]]:
    """Create the environment of processes whose common cache folder is empty at first."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "XDG_CACHE_HOME": cache}
        # An installation by pip contains compiled Python files, so let Python write them.
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        environment.pop("JAX_COMPILATION_CACHE_DIR", None)
        yield environment


def printed_times(arguments: list[str], environment: dict[str, str]) -> list[float]:
    """Run Python, and return the times that it prints, one in each line; s.

    Args:
        arguments: Arguments of Python.
        environment: Variables of the environment.
    """
    done = subprocess.run(
        [sys.executable, *arguments],
        env=environment,
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    return [float(line) for line in done.stdout.splitlines()]


def _first_and_later(elapsed: Callable[[dict[str, str]], float]) -> tuple[float, float]:
    """Measure the first call with an empty cache, and the median of later ones; s.

    `elapsed` measures a call in a process with the given environment.
    """
    with empty_cache() as environment:
        first, *later = (elapsed(environment) for _ in range(1 + REPEATS))
    return first, statistics.median(later)


def _processes() -> Iterator[Row]:
    """Measure whole processes, also in multiples of the time of `import jax`."""

    def elapsed(environment: dict[str, str], arguments: list[str]) -> float:
        start = time.perf_counter()
        subprocess.run(
            [sys.executable, *arguments],
            env=environment,
            check=True,
            stdout=subprocess.DEVNULL,
        )
        return time.perf_counter() - start

    def times(arguments: list[str]) -> tuple[float, float]:
        return _first_and_later(partial(elapsed, arguments=arguments))

    _, jax_time = times(["-c", "import jax"])
    yield Row("`import jax`", jax_time, "s")
    for name, (arguments, largest) in PROCESSES.items():
        first, second = times(arguments)
        yield Row(f"{name}: first call", first, "s")
        yield Row(f"{name}: second call", second, "s")
        what = f"{name}: second call, in multiples of `import jax`"
        yield at_most(what, second / jax_time, "x", largest)


def _calls() -> Iterator[Row]:
    """Measure first calls in a new process, after the imports."""
    for name, (setup, call, bounds) in CALLS.items():
        code = SCRIPT.format(setup=setup, call=call)

        def elapsed(environment: dict[str, str], code=code) -> float:
            return printed_times(["-c", code], environment)[0]

        first, second = _first_and_later(elapsed)
        for when, value, bound in zip(
            ("without a cache", "with a cache"),
            (first, second),
            bounds or (None, None),
            strict=True,
        ):
            what = FIRST_CALL.format(name, when)
            if bound is None:
                yield Row(what, value, "s")
            else:
                yield at_most(what, value, "s", bound)
    for name, (package, setup, call) in PEERS.items():
        if importlib.util.find_spec(package) is not None:
            code = SCRIPT.format(setup=f"import {package}; {setup}", call=call)
            value = printed_times(["-c", code], dict(os.environ))[0]
            yield Row(f"{name}: first motion in a new process", value, "s")
