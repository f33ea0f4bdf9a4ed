"""Equilibria of long chains of hinges that a moment bends into an arc."""

import time
from collections.abc import Iterator

import jax
import numpy as np

import twistorjax as tj

from .measure import at_most, Row, seconds


END_ROTATION = 3.0  # rotation of the last body; rad
HINGES = 10, 100, 1000, 3000


def slender_chain(hinges: int) -> tj.Mechanism:
    """Build a cantilever of unit length and unit bending stiffness."""
    leaf = tj.Quadratic(np.diag(stiffness(hinges)), "twist")
    size = 1 / hinges
    bodies = [tj.Body(str(k), (0.0, k * size, 0.0)) for k in range(hinges + 1)]
    leaves = [
        tj.Hinge(str(k), str(k), str(k + 1), leaf, (0.0, (k + 0.5) * size, 0.0))
        for k in range(hinges)
    ]
    return tj.Mechanism(bodies, leaves, fixed=["0"])


def stiffness(hinges: int) -> np.ndarray:
    """Return the rotation, axial, and shear stiffness of a hinge; N m/rad, N/m, N/m."""
    return np.array([1.0, 1e6, 12.0 * hinges**2]) * hinges


def exact_tip(hinges: int) -> np.ndarray:
    """Return the exact position of the last body's origin; m.

    All hinges rotate by the same angle, so the bodies form a regular polygonal chain.
    """
    angles = END_ROTATION / hinges * np.arange(hinges + 1)
    links = np.stack([np.cos(angles), np.sin(angles)]) / hinges
    return links.sum(axis=1) - (links[:, 0] + links[:, -1]) / 2


def run() -> Iterator[Row]:
    """Yield the rows of the table."""
    for hinges, bound in zip(HINGES, (0.2, 0.2, 2.0, 20.0), strict=True):
        mechanism = slender_chain(hinges)
        # The bending stiffness and the length are 1, so the moment equals the rotation.
        load = tj.Load(str(hinges), (END_ROTATION, 0.0, 0.0))

        def solve(mechanism: tj.Mechanism, load: tj.Load = load) -> tj.Equilibrium:
            return tj.equilibrium(mechanism, loads=[load])

        start = time.perf_counter()
        solution = jax.block_until_ready(solve(mechanism))
        first = time.perf_counter() - start
        chain = f"chain of {hinges:,} hinges, end rotated by 3 rad"
        yield Row(f"{chain}: with compilation", first, "s")
        repeated = seconds(solve, mechanism, repeats=3)
        yield at_most(f"{chain}: without compilation", repeated, "s", bound)
        error = np.max(np.abs(solution.pose(str(hinges))[1:] - exact_tip(hinges)))
        yield at_most(f"{chain}: error of the end position", float(error), "m", 1e-6)
