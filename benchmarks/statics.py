"""Equilibria of the micropositioning stage and of chains, single and in batches."""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np

import twistorjax as tj
from twistorjax.examples import stage

from .measure import at_least, at_most, compiled, Row, seconds


DESIGNS = 10_000


def gain(web: jax.Array) -> jax.Array:
    """Compute the nonlinear gain of a stage with a given web (m)."""
    return stage.amplification(stage.microstage(web), throw=False).gain


def linearized_gain(web: jax.Array) -> jax.Array:
    """Compute the gain of a stage with a given web (m) by linearization."""
    linear = tj.linearize(stage.microstage(web), {"6": ["x"]})
    solution = linear(drives=[tj.Drive("6", x=stage.TRAVEL)], throw=False)
    return solution.displacement("4")[1] / stage.TRAVEL


def chain(hinges: int) -> tj.Mechanism:
    """Build a row of leaves whose first body is fixed."""
    leaf = tj.Quadratic(np.diag([1.0, 1e4, 1.0]))
    bodies = [tj.Body(str(k), (0.0, float(k), 0.0)) for k in range(hinges + 1)]
    leaves = [
        tj.Hinge(str(k), str(k), str(k + 1), leaf, (0.0, k + 0.5, 0.0))
        for k in range(hinges)
    ]
    return tj.Mechanism(bodies, leaves, fixed=["0"])


def run() -> Iterator[Row]:
    """Yield the rows of the table."""
    mechanism = stage.microstage()
    drives = [tj.Drive("6", x=stage.TRAVEL)]

    def solve(mechanism: tj.Mechanism) -> tj.Equilibrium:
        return tj.equilibrium(mechanism, drives=drives, throw=False)

    program, compile_time = compiled(solve, mechanism)
    yield at_most("stage: compilation of the equilibrium", compile_time, "s", 2.0)
    repeated = seconds(program, mechanism, repeats=301)
    what = "stage: one equilibrium, by the compiled program"
    yield at_most(what, 1e3 * repeated, "ms", 0.15)
    repeated = seconds(solve, mechanism, repeats=301)
    what = "stage: one equilibrium, by a call of `equilibrium`"
    yield at_most(what, 1e3 * repeated, "ms", 0.15)

    webs = jnp.linspace(0.2e-3, 0.4e-3, DESIGNS)
    for what, function, bound in (
        ("stage: nonlinear gains", gain, 50_000),
        ("stage: nonlinear gains and derivatives", jax.value_and_grad(gain), 25_000),
        ("stage: linearized gains", linearized_gain, None),
    ):
        program, compile_time = compiled(jax.vmap(function), webs)
        rate = DESIGNS / seconds(program, webs)
        yield Row(f"{what}: compilation for {DESIGNS:,} designs", compile_time, "s")
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
        yield Row(f"chain of {hinges:,} hinges: compilation", times[hinges], "s")
    ratio = times[1000] / times[10]
    what = "chain of 1,000 hinges: compilation time relative to 10 hinges"
    yield at_most(what, ratio, "x", 2.0)
