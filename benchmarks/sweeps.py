"""Sweeps over many designs, on all cores or accelerators: `python -m benchmarks.sweeps`.

The sweeps run in a separate process, because the number of devices on a processor
must be set before JAX is used for the first time.
"""

import json
import os
import subprocess
import sys
import tempfile
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

from .first_calls import empty_cache
from .measure import at_least, at_most, Row
from .peers_motion import RELEASED
from .statics import linearized_gain


LEAF_LENGTH = 10e-3  # m
GAINS = "sweep: stage: nonlinear gains"
MOTIONS = f"sweep: {RELEASED}: motion for 0.2 s"


def run() -> Iterator[Row]:
    """Measure the sweeps in a separate process, and yield the rows of the table."""
    process = subprocess.run(
        [sys.executable, "-m", __name__], stdout=subprocess.PIPE, text=True, check=True
    )
    for line in process.stdout.splitlines():
        yield Row(**json.loads(line))
    with empty_cache() as environment:
        _processor_time_of(1, environment)
        times = [_processor_time_of(parts, environment) for parts in (1, 5)]
    what = "sweep in a store: processor time that a further part takes"
    yield Row(what, (times[1] - times[0]) / 4, "s")


def _processor_time_of(parts: int, environment: dict[str, str]) -> float:
    """Measure a sweep whose parts are computed by a process each, one by one; s."""
    code = (
        "import sys, numpy as np; from benchmarks import sweeps; sweeps.tj.configure(); "
        "designs = {'width': np.linspace(5e-3, 20e-3, 2_000)}; "
        "store, k, n = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]); "
        "sweeps.tj.sweep(sweeps.support_stiffness, designs, store=store, "
        "chunk_size=200, part=(k, n))"
    )
    start = _processor_time_of_processes()
    with tempfile.TemporaryDirectory() as folder:
        for k in range(1, parts + 1):
            where = [f"{folder}/designs.zarr", str(k), str(parts)]
            command = [sys.executable, "-c", code, *where]
            subprocess.run(command, env=environment, check=True)
    return _processor_time_of_processes() - start


def _processor_time_of_processes() -> float:
    """Return the time of all processes that have ended; s."""
    times = os.times()
    return times.children_user + times.children_system


def gain(design: dict[str, Any]) -> dict[str, Any]:
    """Compute the nonlinear gain of a stage."""
    amplification = stage_gain(design)
    return {"gain": amplification.gain, "result": amplification.result}


def linear_gain(design: dict[str, Any]) -> dict[str, Any]:
    """Compute the gain of a stage for small displacements."""
    return {"gain": linearized_gain(design["web"])}


def frequencies(design: dict[str, Any]) -> dict[str, Any]:
    """Compute the three lowest natural frequencies of a stage with a fixed input."""
    modes = tj.vibrations(stage.microstage(design["web"]), {"6": ["x"]}, throw=False)
    return {"frequency": modes.frequencies[:3], "result": modes.result}


@cache
def leaf() -> tj.energies.WithValidityRange:
    """Create a surrogate of an exact leaf, valid for rotations of up to 20 degrees."""
    beam = tj.flexures.Beam(
        stage.aluminum(), length=LEAF_LENGTH, thickness=LEAF_LENGTH / 10, width=5e-3
    )
    return tj.flexures.surrogate(beam, rotation=np.radians(20))


def parallel_guide(design: dict[str, Any]) -> dict[str, Any]:
    """Compute the change of height of a parallel guide with two surrogate leaves."""
    hinges = [
        tj.Hinge(name, "base", "table", leaf(), (jnp.pi / 2, x, LEAF_LENGTH / 2))
        for name, x in (("left", -LEAF_LENGTH), ("right", LEAF_LENGTH))
    ]
    bodies = [tj.Body("base"), tj.Body("table", (0.0, 0.0, LEAF_LENGTH))]
    guide = tj.Mechanism(bodies, hinges, fixed=["base"])
    drive = tj.Drive("table", x=design["travel"])
    solution = tj.equilibrium(guide, drives=[drive], throw=False)
    height_change = solution.displacement("table")[2]
    return {"height_change": height_change, "result": solution.result}


def support_stiffness(design: dict[str, Any]) -> dict[str, Any]:
    """Compute the support stiffness along z of a guide at three strokes."""
    steel = tj.Material(modulus=210e9, poisson=0.3)
    leaf = tj.flexures.leaf(steel, length=40e-3, thickness=0.3e-3, width=design["width"])
    hinges = [
        tj.Hinge(name, "wall", "table", leaf, at=(0.0, 20e-3, y))
        for name, y in (("lower", -20e-3), ("upper", 20e-3))
    ]
    bodies = [tj.Body("wall"), tj.Body("table", (0.0, 20e-3, 0.0))]
    guide = tj.Mechanism(bodies, hinges, fixed=["wall"])

    def at(stroke: jax.Array) -> jax.Array:
        drives = [tj.Drive("table", y=stroke)]
        solution = tj.equilibrium(guide, drives=drives, throw=False)
        model = tj.out_of_plane(guide, solution)
        return 1 / model.compliance_at("table")[0, 0]

    return {"stiffness": jax.vmap(at)(jnp.array([0.0, 2e-3, 4e-3]))}


def released(design: dict[str, Any]) -> dict[str, Any]:
    """Simulate the motion of a released four-bar linkage for 0.2 s."""
    linkage = four_bar.four_bar(
        damping=four_bar.RELEASED_DAMPING, thickness=design["thickness"]
    )
    motion = four_bar.released_motion(
        linkage, [0.0, 0.2], tolerance=1e-4, energies=False, throw=False
    )
    return {"angle": motion.displacement("2")[-1, 0], "result": motion.result}


def measure_sweeps() -> Iterator[Row]:
    """Yield the rows of the table, measured in this process."""
    mesh = jax.make_mesh((jax.device_count(),), ("designs",))
    accelerated = jax.default_backend() != "cpu"

    def timed(
        study: Callable, name: str, low: float, high: float, count: int, **settings: Any
    ) -> tuple[float, float]:
        """Time a sweep with compilation and without; s."""
        designs, times = {name: np.linspace(low, high, count)}, []
        for _ in range(4):
            start = time.perf_counter()
            table = tj.sweep(study, designs, mesh=mesh, **settings)
            times.append(time.perf_counter() - start)
            assert bool(table.succeeded.all())
        return times[0], float(np.median(times[1:]))

    webs = ("web", 0.2e-3, 0.4e-3)
    first, repeated = timed(gain, *webs, 100_000)
    what = "sweep: stage: nonlinear gains of 100,000 designs, with compilation"
    yield Row(what, first, "s")
    bound = 1e7 if accelerated else 100_000
    yield at_least(GAINS, 100_000 / repeated, "/s", bound)
    per_design = {}
    for count in (100, 1_000, 10_000, 1_000_000):
        per_design[count] = timed(gain, *webs, count)[1] / count
        what = f"sweep: stage: nonlinear gains, {count:,} designs"
        yield Row(what, 1 / per_design[count], "/s")
    ratio = per_design[1_000_000] / per_design[10_000]
    what = "sweep: stage: time per design, 1,000,000 designs relative to 10,000"
    yield at_most(what, ratio, "x", 1.2)
    repeated = timed(gain, *webs, 100_000, derivatives=("gain",))[1]
    what = "sweep: stage: nonlinear gains and exact derivatives"
    yield at_least(what, 100_000 / repeated, "/s", 50_000)
    repeated = timed(linear_gain, *webs, 400_000)[1]
    yield at_least("sweep: stage: linearized gains", 400_000 / repeated, "/s", 400_000)
    repeated = timed(frequencies, *webs, 20_000)[1]
    yield Row("sweep: stage: three natural frequencies", 20_000 / repeated, "/s")
    leaf()  # Create the surrogate now, not while the study is traced.
    repeated = timed(parallel_guide, "travel", 1e-5, 1e-3, 20_000)[1]
    what = "sweep: parallel guide with two surrogate leaves"
    yield Row(what, 20_000 / repeated, "/s")
    widths = ("width", 5e-3, 20e-3)
    repeated = timed(support_stiffness, *widths, 10_000)[1]
    what = "sweep: parallel guide: support stiffness out of the plane at three strokes"
    yield Row(what, 10_000 / repeated, "/s")
    count = 100_000 if accelerated else 500
    chunk_size = None if accelerated else 64
    thicknesses = ("thickness", 0.9e-3, 1e-3)
    repeated = timed(released, *thicknesses, count, chunk_size=chunk_size)[1]
    rate = count / repeated
    yield at_least(MOTIONS, rate, "/s", 5e4) if accelerated else Row(MOTIONS, rate, "/s")

    distributions = {"web": tj.sweeps.Normal(np.full(7, stage.WEB), 10e-6)}
    result = tj.sweeps.tolerances(stage_gain, distributions, "gain", mesh=mesh)
    tolerances = "tolerances: stage with seven webs of 250 ± 10 µm"
    mean = f"{tolerances}: mean gain"
    yield Row(f"{mean}, sampled", result.mean, "")
    deviation = f"{tolerances}: standard deviation of the gain"
    yield Row(f"{deviation}, sampled", result.standard_deviation, "")
    yield Row(f"{mean}, first order", result.nominal, "")
    yield Row(f"{deviation}, first order", result.first_order_standard_deviation, "")


def ratios(rows: list[Row]) -> Iterator[Row]:
    """Compare the rates of sweeps with those of EXUDYN on all cores, in the same run.

    The latter are those on one core times the number of cores.
    """
    values = {row.benchmark: row.value for row in rows}
    peers = {
        GAINS: "EXUDYN: stage: nonlinear gains, on one core",
        MOTIONS: f"EXUDYN: {RELEASED}: simulations, on one core",
    }
    for what, peer in peers.items():
        if peer in values:
            ratio = values[what] / (values[peer] * (os.cpu_count() or 1))
            name = f"{what}: rate relative to EXUDYN on all cores"
            yield at_least(name, ratio, "x", 20.0)


if __name__ == "__main__":
    if os.environ.get("JAX_PLATFORMS", "cpu") == "cpu":
        # `process_cpu_count` exists from Python 3.13 on.
        cores = getattr(os, "process_cpu_count", os.cpu_count)() or 1
        jax.config.update("jax_num_cpu_devices", cores)
    for row in measure_sweeps():
        print(json.dumps(asdict(row)), flush=True)
