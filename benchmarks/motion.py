"""Motions of four-bar linkages, single and in a batch."""

import time
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np

import twistorjax as tj
from twistorjax.examples import four_bar

from .measure import at_least, at_most, compiled, Row, seconds
from .peers_motion import PRESCRIBED, RELEASED


DESIGNS = 1000
TIMES = jnp.linspace(0.0, 0.2, 101)
RELEASED_MOTION = f"{RELEASED}: motion for 0.2 s"
BATCH = f"{DESIGNS:,} released four-bar linkages"
BATCH_SIMULATIONS = f"{BATCH}: simulations"


def released(thickness: jax.Array, tolerance: float) -> tj.Motion:
    """Simulate the linkage with an initial velocity of link 3 of 10 m/s.

    Args:
        thickness: Thickness of the leaves; m.
        tolerance: Tolerance of `simulate`.
    """
    linkage = four_bar.four_bar(damping=1e-4, thickness=thickness)
    return four_bar.released_motion(
        linkage, TIMES, tolerance=tolerance, energies=False, throw=False
    )


def run() -> Iterator[Row]:
    """Yield the rows of the table."""
    linkage = four_bar.four_bar()
    times = jnp.array([0.0, 0.09, 0.18, 0.27, 0.36, 0.405])

    def prescribed(linkage: tj.Mechanism, tolerance: float) -> tj.Motion:
        return four_bar.driven_motion(linkage, times, tolerance=tolerance, throw=False)

    program, compile_time = compiled(prescribed, linkage, 1e-8)
    yield at_most(f"{PRESCRIBED}: compilation", compile_time, "s", 5.0)
    elapsed = seconds(program, linkage, 1e-8)
    yield at_most(f"{PRESCRIBED}: motion for 0.405 s", 1e3 * elapsed, "ms", 40.0)
    motion, reference = program(linkage, 1e-8), program(linkage, 1e-11)
    errors = jnp.abs(motion.displacements - reference.displacements)[..., 1:]
    yield at_most(f"{PRESCRIBED}: error", float(jnp.max(errors)), "m", 1e-8)
    yield from _steps(PRESCRIBED, motion, elapsed)

    tolerance = 1e-5
    program, compile_time = compiled(released, 1e-3, tolerance)
    yield at_most(f"{RELEASED}: compilation", compile_time, "s", 5.0)
    elapsed = seconds(program, 1e-3, tolerance)
    yield Row(RELEASED_MOTION, 1e3 * elapsed, "ms")
    motion, reference = program(1e-3, tolerance), program(1e-3, 1e-10)
    errors = jnp.abs(motion.displacements - reference.displacements)[..., 0]
    yield at_most(f"{RELEASED}: error", float(jnp.max(errors)), "rad", 1e-4)
    yield from _steps(RELEASED, motion, elapsed)

    thicknesses = jnp.linspace(0.8e-3, 1.0e-3, DESIGNS)

    def angles(thickness: jax.Array) -> jax.Array:
        return released(thickness, tolerance).displacements[:, 1:, 0]

    program, compile_time = compiled(jax.vmap(angles), thicknesses)
    yield Row(f"{BATCH}: compilation", compile_time, "s")
    jax.block_until_ready(program(thicknesses))
    # The processor time is that of all cores together.
    start = time.process_time()
    jax.block_until_ready(program(thicknesses))
    rate = DESIGNS / (time.process_time() - start)
    yield Row(BATCH_SIMULATIONS, rate, "/s")


def _steps(what: str, motion: tj.Motion, elapsed: float) -> Iterator[Row]:
    """Yield the number of steps of a motion and the time per step.

    Args:
        what: Start of the names of the rows.
        motion: The motion.
        elapsed: Time of the simulation; s.
    """
    count = int(np.asarray(motion.steps))
    yield Row(f"{what}: steps", count, "")
    yield Row(f"{what}: time per step", 1e6 * elapsed / count, "us")


def ratios(rows: list[Row]) -> Iterator[Row]:
    """Compare the times of the released linkage with those of peers in the same run."""
    values = {row.benchmark: row.value for row in rows}
    for peer, bound in (("EXUDYN", 0.2), ("SciPy LSODA with Numba", 1.0)):
        elapsed = values.get(f"{peer}: {RELEASED}: one simulation, on one core")
        if elapsed is not None:
            ratio = 1e-3 * values[RELEASED_MOTION] / elapsed
            yield at_most(f"{RELEASED}: time relative to {peer}", ratio, "x", bound)
    rate = values.get(f"EXUDYN: {RELEASED}: simulations, on one core")
    if rate is not None:
        speed = values[BATCH_SIMULATIONS] / rate
        what = f"{BATCH}: speed relative to EXUDYN, on one core"
        yield at_least(what, speed, "x", 5.0)
