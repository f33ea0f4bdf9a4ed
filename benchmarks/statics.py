"""Equilibria of the stage and of a chain, alone and by the thousand."""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np

import twistorjax as tj
from twistorjax.examples import stage

from .measure import at_least, at_most, compiled, Row, seconds


WEBS = 10_000


def gain(web: jax.Array) -> jax.Array:
    """The nonlinear gain of a stage, from its geometry."""
    return stage.amplification(stage.microstage(web), throw=False).gain


def small_gain(web: jax.Array) -> jax.Array:
    """Its gain for small travels."""
    linear = tj.linearize(stage.microstage(web), {"6": ["x"]})
    moved = linear(drives=[tj.Drive("6", x=stage.TRAVEL)], throw=False)
    return moved.displacement("4")[1] / stage.TRAVEL


def chain(hinges: int) -> tj.Mechanism:
    """Leaves in a row, clamped at one end."""
    leaf = tj.Quadratic(np.diag([1.0, 1e4, 1.0]))
    bodies = [tj.Body(str(k), (0.0, float(k), 0.0)) for k in range(hinges + 1)]
    joints = [
        tj.Hinge(str(k), str(k), str(k + 1), leaf, (0.0, k + 0.5, 0.0))
        for k in range(hinges)
    ]
    return tj.Mechanism(bodies, joints, fixed=["0"])


def run() -> Iterator[Row]:
    """The rows of the table."""
    mechanism = stage.microstage()
    drives = [tj.Drive("6", x=stage.TRAVEL)]

    def solve(mechanism: tj.Mechanism) -> tj.Equilibrium:
        return tj.equilibrium(mechanism, drives=drives, throw=False)

    program, compile_time = compiled(solve, mechanism)
    yield at_most("stage: compile its equilibrium", compile_time, "s", 2.0)
    warm = seconds(program, mechanism, repeats=301)
    yield at_most("stage: one equilibrium, compiled", 1e3 * warm, "ms", 0.15)
    warm = seconds(solve, mechanism, repeats=301)
    yield at_most("stage: one call of `equilibrium`", 1e3 * warm, "ms", 0.15)

    webs = jnp.linspace(0.2e-3, 0.4e-3, WEBS)
    for what, function, bound in (
        ("stage: nonlinear gains", gain, 50_000),
        ("stage: gains and derivatives", jax.value_and_grad(gain), 25_000),
        ("stage: linearised gains", small_gain, None),
    ):
        program, compile_time = compiled(jax.vmap(function), webs)
        rate = WEBS / seconds(program, webs)
        yield Row(f"{what}: compile for {WEBS:,} webs", compile_time, "s")
        yield (
            Row(what, rate, "/s") if bound is None else at_least(what, rate, "/s", bound)
        )

    times = {}
    for hinges in (10, 1000):
        mechanism = chain(hinges)
        load = tj.Load(str(hinges), (0.0, 0.0, 1e-4))

        def bend(mechanism: tj.Mechanism, load: tj.Load = load) -> tj.Equilibrium:
            return tj.equilibrium(mechanism, loads=[load], throw=False)

        _, times[hinges] = compiled(bend, mechanism)
        yield Row(f"chain of {hinges} hinges: compile", times[hinges], "s")
    ratio = times[1000] / times[10]
    yield at_most("chain: compile 1000 hinges over 10", ratio, "x", 2.0)
