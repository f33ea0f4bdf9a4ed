"""Linkages of pivots that are condensed to one hinge each, and of all their leaves."""

import statistics
import time
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np

import twistorjax as tj

from .measure import at_least, at_most, Row


LINKAGES = 10_000
STEEL = tj.Material(modulus=210e9, poisson=0.3)
UP = np.pi / 2
# Bodies and place of each pivot of a four-bar linkage; m
PLACES = {
    "a": ("ground", "left", -40e-3, 0.0),
    "b": ("left", "coupler", -40e-3, 60e-3),
    "c": ("right", "coupler", 40e-3, 60e-3),
    "d": ("ground", "right", 40e-3, 0.0),
}


def bodies() -> list[tj.Body]:
    """Create the links."""
    return [
        tj.Body("ground"),
        tj.Body("left", (0.0, -40e-3, 30e-3)),
        tj.Body("coupler", (0.0, 0.0, 60e-3)),
        tj.Body("right", (0.0, 40e-3, 30e-3)),
    ]


def condensed_linkage(energy: tj.AbstractEnergy) -> tj.Mechanism:
    """Build the linkage with one hinge for each pivot."""
    hinges = [
        tj.Hinge(name, first, second, energy, at=(UP, x, y))
        for name, (first, second, x, y) in PLACES.items()
    ]
    return tj.Mechanism(bodies(), hinges, fixed=["ground"])


def whole_linkage(pivot: tj.SubMechanism, leaf: tj.AbstractEnergy) -> tj.Mechanism:
    """Build the linkage with all leaves of the pivots."""
    part, hinges, links = pivot.mechanism, [], bodies()
    for name, (first, second, x, y) in PLACES.items():
        place = jnp.array([UP, x, y])
        names = {pivot.first: first, pivot.second: second}
        for body, reference in zip(part.names, part.reference, strict=True):
            if body not in names:
                names[body] = f"{name} {body}"
                links.append(
                    tj.Body(names[body], tj.geometry.se2.compose(place, reference))
                )
        for row, (a, b) in enumerate(part.hinge_assembly.ends):
            hinges.append(
                tj.Hinge(
                    f"{name} {row}",
                    names[part.names[a]],
                    names[part.names[b]],
                    leaf,
                    at=tj.geometry.se2.compose(place, part.at[row]),
                )
            )
    return tj.Mechanism(links, hinges, fixed=["ground"])


def run() -> Iterator[Row]:
    """Yield the rows of the table."""
    beam = tj.flexures.Beam(STEEL, length=20e-3, thickness=0.4e-3, width=10e-3)
    leaf = tj.surrogate(beam, rotation=0.5)
    pivots = {
        "cross-spring": tj.flexures.cross_spring_pivot(beam, leaf),
        "cartwheel": tj.flexures.cartwheel_pivot(beam, leaf),
    }
    scales = jnp.linspace(0.9, 1.1, LINKAGES)
    for name, pivot in pivots.items():
        tj.surrogate(pivot, rotation=0.36, force=60.0)
        start = time.perf_counter()
        fast = jax.block_until_ready(tj.surrogate(pivot, rotation=0.36, force=60.0))
        took = time.perf_counter() - start
        yield at_most(f"surrogate of a {name} pivot, once compiled", took, "s", 1.0)

        def torque(mechanism: tj.Mechanism) -> jax.Array:
            drive = tj.Drive("left", angle=0.2)
            solution = tj.equilibrium(mechanism, drives=[drive], throw=False)
            return solution.reaction("left")[0]

        @jax.jit
        @jax.vmap
        def condensed(scale, fast=fast):
            return torque(condensed_linkage(scale * fast))

        @jax.jit
        @jax.vmap
        def whole(scale, pivot=pivot):
            return torque(whole_linkage(pivot, scale * leaf))

        times: dict[str, list[float]] = {"condensed": [], "whole": []}
        results = {}
        for _ in range(6):  # in turn, because the load of the machine changes
            for kind, function in (("condensed", condensed), ("whole", whole)):
                start = time.perf_counter()
                results[kind] = jax.block_until_ready(function(scales))
                times[kind].append(time.perf_counter() - start)
        seconds = {kind: statistics.median(values[1:]) for kind, values in times.items()}
        error = jnp.max(jnp.abs(results["condensed"] / results["whole"] - 1))
        linkages = f"linkages of four {name} pivots"
        yield Row(f"{linkages}, condensed", LINKAGES / seconds["condensed"], "1/s")
        ratio = seconds["whole"] / seconds["condensed"]
        yield at_least(f"{linkages}: rate, over that of all leaves", ratio, "x", 5.0)
        yield at_most(f"{linkages}: error of the torque", 100 * float(error), "%", 0.1)
