"""Equilibrium paths of the truss of von Mises: one by one, and in a batch."""

import time
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np

import twistorjax as tj
from twistorjax.examples.truss import limit_load, von_mises_truss

from .measure import at_least, at_most, Row, seconds


DESIGNS = 1000
PUSH = tj.Load("apex", force=(0.0, -40.0))


def snap_force(rise: jax.Array) -> jax.Array:
    """Return the force at which a truss snaps; N."""
    path = tj.path(von_mises_truss(rise), loads=[PUSH], max_points=100)
    return 40 * path.critical_points.load_factors[0]


def whole_path(truss: tj.Mechanism) -> jax.Array:
    """Return the energies of the points of a path, by a call outside `jax.jit`."""
    return tj.path(truss, loads=[PUSH]).energies


def run() -> Iterator[Row]:
    """Yield the rows of the table."""
    truss = von_mises_truss()
    start = time.perf_counter()
    jax.block_until_ready(whole_path(truss))
    name = "path of a truss through both limit points"
    yield Row(f"{name}: first call", time.perf_counter() - start, "s")
    one = seconds(whole_path, truss)
    yield Row(f"{name}: next calls", 1e3 * one, "ms")
    rises = jnp.linspace(0.2, 0.4, DESIGNS)
    batch = jax.jit(jax.vmap(snap_force))
    each = seconds(batch, rises, repeats=5) / DESIGNS
    name = f"snap forces of {DESIGNS:,} trusses in one batch"
    yield Row(f"{name}: one truss", 1e3 * each, "ms")
    yield at_least(f"{name}: times the rate of single calls", one / each, "x", 20)
    compiled = jax.jit(snap_force)
    yield Row("snap force of one truss, compiled", 1e3 * seconds(compiled, 0.3), "ms")
    exact = jax.vmap(limit_load)(rises)
    error = float(np.max(np.abs(batch(rises) / exact - 1)))
    yield at_most(f"{name}: relative error", error, "1", 1e-10)
    slopes = jax.jit(jax.vmap(jax.grad(snap_force)))
    each = seconds(slopes, rises, repeats=5) / DESIGNS
    yield Row(f"{name}, with derivatives: one truss", 1e3 * each, "ms")
