"""Four-bar linkages in motion, alone and by the thousand."""

import time
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np

import twistorjax as tj
from twistorjax.examples import four_bar

from .measure import at_least, at_most, compiled, Row, seconds


DESIGNS = 1000
TIMES = jnp.linspace(0.0, 0.2, 101)
RELEASED = "four-bar, let go for 0.2 s"
SWEPT = f"{DESIGNS} linkages, let go: on one core"


def released(thickness: jax.Array, tolerance: float) -> tj.Motion:
    """Link 3 let go at 10 m/s."""
    linkage = four_bar.four_bar(damping=1e-4, thickness=thickness)
    return four_bar.released_motion(
        linkage, TIMES, tolerance=tolerance, energies=False, throw=False
    )


def run() -> Iterator[Row]:
    """The rows of the table."""
    linkage = four_bar.four_bar()
    asked = jnp.array([0.0, 0.09, 0.18, 0.27, 0.36, 0.405])

    def driven(linkage: tj.Mechanism, tolerance: float) -> tj.Motion:
        return four_bar.driven_motion(linkage, asked, tolerance=tolerance, throw=False)

    program, compile_time = compiled(driven, linkage, 1e-8)
    yield at_most("four-bar, driven: compile", compile_time, "s", 5.0)
    warm = seconds(program, linkage, 1e-8)
    yield at_most("four-bar, driven for 0.405 s", 1e3 * warm, "ms", 40.0)
    moved, tight = program(linkage, 1e-8), program(linkage, 1e-11)
    error = float(jnp.max(jnp.abs(moved.displacements - tight.displacements)[..., 1:]))
    yield at_most("four-bar, driven: its error", error, "m", 1e-8)
    yield from _steps("four-bar, driven", moved, warm)

    tolerance = 1e-5
    program, compile_time = compiled(released, 1e-3, tolerance)
    yield at_most("four-bar, let go: compile", compile_time, "s", 5.0)
    warm = seconds(program, 1e-3, tolerance)
    yield Row(RELEASED, 1e3 * warm, "ms")
    moved, tight = program(1e-3, tolerance), program(1e-3, 1e-10)
    error = float(jnp.max(jnp.abs(moved.displacements - tight.displacements)[..., 0]))
    yield at_most("four-bar, let go: its error", error, "rad", 1e-4)
    yield from _steps("four-bar, let go", moved, warm)

    thicknesses = jnp.linspace(0.8e-3, 1.0e-3, DESIGNS)

    def sweep(thickness: jax.Array) -> jax.Array:
        return released(thickness, tolerance).displacements[:, 1:, 0]

    program, compile_time = compiled(jax.vmap(sweep), thicknesses)
    yield Row(f"{DESIGNS} linkages, let go: compile", compile_time, "s")
    jax.block_until_ready(program(thicknesses))
    start = time.process_time()
    jax.block_until_ready(program(thicknesses))
    rate = DESIGNS / (time.process_time() - start)
    yield Row(SWEPT, rate, "/s")


def _steps(what: str, moved: tj.Motion, warm: float) -> Iterator[Row]:
    count = int(np.asarray(moved.steps))
    yield Row(f"{what}: steps", count, "")
    yield Row(f"{what}: a step", 1e6 * warm / count, "us")


def beside(rows: list[Row]) -> Iterator[Row]:
    """How much faster it was than EXUDYN in the same run."""
    values = {row.what: row.value for row in rows}
    peer = values.get("EXUDYN: four-bar released: simulations, on one core")
    if peer is None:
        return
    once = 1e3 / values[RELEASED] / peer
    yield at_least(f"{RELEASED}: over EXUDYN", once, "x", 1.0)
    yield at_least(f"{SWEPT}, over EXUDYN", values[SWEPT] / peer, "x", 5.0)
