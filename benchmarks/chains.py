"""Chains of a thousand hinges and more, wound up by a moment."""

import time
from collections.abc import Iterator

import jax
import numpy as np

import twistorjax as tj

from .measure import at_most, Row, seconds


TURN = 3.0  # of the last body; rad
HINGES = 1000, 3000


def slender(hinges: int) -> tj.Mechanism:
    """A beam of unit length and bending stiffness, clamped at one end."""
    leaf = tj.Quadratic(np.diag(stiffness(hinges)), "twist")
    size = 1 / hinges
    bodies = [tj.Body(str(k), (0.0, k * size, 0.0)) for k in range(hinges + 1)]
    joints = [
        tj.Hinge(str(k), str(k), str(k + 1), leaf, (0.0, (k + 0.5) * size, 0.0))
        for k in range(hinges)
    ]
    return tj.Mechanism(bodies, joints, fixed=["0"])


def stiffness(hinges: int) -> np.ndarray:
    """Rotation, axial and shear stiffness of each hinge; N m/rad, N/m, N/m."""
    return np.array([1.0, 1e6, 12.0 * hinges**2]) * hinges


def tip(hinges: int) -> np.ndarray:
    """Where the last body's origin ends, exactly: on a polygon; m."""
    angles = TURN / hinges * np.arange(hinges + 1)
    links = np.stack([np.cos(angles), np.sin(angles)]) / hinges
    return links.sum(axis=1) - (links[:, 0] + links[:, -1]) / 2


def run() -> Iterator[Row]:
    """The rows of the table."""
    for hinges, bound in zip(HINGES, (2.0, 20.0), strict=True):
        mechanism = slender(hinges)
        load = tj.Load(str(hinges), (TURN, 0.0, 0.0))

        def wind(mechanism: tj.Mechanism, load: tj.Load = load) -> tj.Equilibrium:
            return tj.equilibrium(mechanism, loads=[load])

        started = time.perf_counter()
        wound = jax.block_until_ready(wind(mechanism))
        first = time.perf_counter() - started
        what = f"chain of {hinges:,} hinges wound by 3 rad"
        yield Row(f"{what}: first call, compiled in it", first, "s")
        again = seconds(wind, mechanism, repeats=3)
        yield at_most(f"{what}: once compiled", again, "s", bound)
        error = np.max(np.abs(wound.pose(str(hinges))[1:] - tip(hinges)))
        yield at_most(f"{what}: error of the tip", float(error), "m", 1e-6)
