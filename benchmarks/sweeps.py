"""Studies over many designs, on all cores or accelerators: `python -m benchmarks.sweeps`.

In a process of its own, for how many devices a processor is must be said before JAX is
first used.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistorjax as tj
from twistorjax.examples import four_bar, stage
from twistorjax.examples.sweep_studies import stage_gain

from .measure import at_least, at_most, Row
from .statics import small_gain


SHORT = 10e-3  # of the leaves; m


def run() -> Iterator[Row]:
    """The rows of the table."""
    done = subprocess.run(
        [sys.executable, "-m", __name__], stdout=subprocess.PIPE, text=True, check=True
    )
    for line in done.stdout.splitlines():
        yield Row(**json.loads(line))


def gain(design: dict[str, Any]) -> dict[str, Any]:
    """The nonlinear gain of a stage."""
    answer = stage_gain(design)
    return {"gain": answer.gain, "result": answer.result}


def linear_gain(design: dict[str, Any]) -> dict[str, Any]:
    """Its gain for small travels."""
    return {"gain": small_gain(design["web"])}


def frequencies(design: dict[str, Any]) -> dict[str, Any]:
    """Its three slowest vibrations, with the input held."""
    found = tj.vibrations(stage.microstage(design["web"]), {"6": ["x"]}, throw=False)
    return {"frequency": found.frequencies[:3], "result": found.result}


@cache
def leaf() -> tj.energies.WithValidityRange:
    """A leaf that is exact to 20 degrees."""
    beam = tj.flexures.Beam(
        stage.aluminium(), length=SHORT, thickness=SHORT / 10, width=5e-3
    )
    return tj.flexures.surrogate(beam, turn=np.radians(20))


def parallelogram(design: dict[str, Any]) -> dict[str, Any]:
    """A table on two distilled leaves, pushed aside."""
    hinges = [
        tj.Hinge(name, "base", "table", leaf(), (jnp.pi / 2, x, SHORT / 2))
        for name, x in (("left", -SHORT), ("right", SHORT))
    ]
    bodies = [tj.Body("base"), tj.Body("table", (0.0, 0.0, SHORT))]
    table = tj.Mechanism(bodies, hinges, fixed=["base"])
    pushed = tj.Drive("table", x=design["travel"])
    solution = tj.equilibrium(table, drives=[pushed], throw=False)
    return {"sinking": solution.displacement("table")[2], "result": solution.result}


def released(design: dict[str, Any]) -> dict[str, Any]:
    """A four-bar linkage let go for 0.2 s."""
    linkage = four_bar.four_bar(
        damping=four_bar.RELEASED_DAMPING, thickness=design["thickness"]
    )
    moved = four_bar.release(
        linkage, [0.0, 0.2], tolerance=1e-4, energies=False, throw=False
    )
    return {"angle": moved.displacement("2")[-1, 0], "result": moved.result}


def measured() -> Iterator[Row]:
    """The rows, in this process."""
    mesh = jax.make_mesh((jax.device_count(),), ("designs",))
    accelerated = jax.default_backend() != "cpu"

    def timed(
        study: Callable, name: str, low: float, high: float, count: int, **settings: Any
    ) -> tuple[float, float]:
        """Seconds with compilation, and without."""
        designs, times = {name: np.linspace(low, high, count)}, []
        for _ in range(4):
            begun = time.perf_counter()
            table = tj.sweep(study, designs, mesh=mesh, **settings)
            times.append(time.perf_counter() - begun)
            assert bool(table.succeeded.all())
        return times[0], float(np.median(times[1:]))

    webs = ("web", 0.2e-3, 0.4e-3)
    first, taken = timed(gain, *webs, 100_000)
    yield Row("sweep: stage: with compilation, 100,000 webs", first, "s")
    bound = 1e7 if accelerated else 100_000
    yield at_least("sweep: stage: nonlinear gains", 100_000 / taken, "/s", bound)
    each = {}
    for count in (10_000, 1_000_000):
        each[count] = timed(gain, *webs, count)[1] / count
        yield Row(f"sweep: stage: gains, {count:,} webs", 1 / each[count], "/s")
    ratio = each[1_000_000] / each[10_000]
    yield at_most("sweep: stage: cost of a design, 1e6 over 1e4", ratio, "x", 1.2)
    taken = timed(gain, *webs, 100_000, derivatives=("gain",))[1]
    what = "sweep: stage: gains and exact derivatives"
    yield at_least(what, 100_000 / taken, "/s", 50_000)
    taken = timed(linear_gain, *webs, 400_000)[1]
    yield at_least("sweep: stage: linearised gains", 400_000 / taken, "/s", 400_000)
    taken = timed(frequencies, *webs, 20_000)[1]
    yield Row("sweep: stage: three frequencies", 20_000 / taken, "/s")
    leaf()  # not while its sweep is traced
    taken = timed(parallelogram, "travel", 1e-5, 1e-3, 20_000)[1]
    yield Row("sweep: table on two distilled leaves", 20_000 / taken, "/s")
    count = 100_000 if accelerated else 500
    chunk = None if accelerated else 64
    taken = timed(released, "thickness", 0.9e-3, 1e-3, count, chunk=chunk)[1]
    what, bound = "sweep: linkages let go for 0.2 s", 5e4 if accelerated else None
    rate = count / taken
    yield Row(what, rate, "/s") if bound is None else at_least(what, rate, "/s", bound)

    spread = {"web": tj.sweeps.Normal(np.full(7, stage.WEB), 10e-6)}
    seen = tj.sweeps.tolerances(stage_gain, spread, "gain", mesh=mesh)
    yield Row("tolerances: gain, seven webs +- 10 um, drawn: mean", seen.mean, "")
    yield Row("tolerances: the same: deviation", seen.spread, "")
    yield Row("tolerances: the same, to first order: mean", seen.nominal, "")
    yield Row("tolerances: the same: deviation", seen.deviation, "")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    if os.environ.get("JAX_PLATFORMS", "cpu") == "cpu":
        jax.config.update("jax_num_cpu_devices", len(os.sched_getaffinity(0)))
    for row in measured():
        print(json.dumps(asdict(row)), flush=True)
