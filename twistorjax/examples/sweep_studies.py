"""Studies of one design of the stage or of a linkage, to be swept over many."""

from collections.abc import Mapping

import jax.numpy as jnp
from jaxtyping import ArrayLike

from ..solve.results import RESULTS
from ..solve.tables import Column
from ..solve.vibrations import vibrations
from .four_bar import drive, four_bar
from .stage import Amplification, amplify, microstage, TRAVEL, WEB


# of the driven linkage: from rest to where it is turned furthest, and back
_TIMES = tuple(0.01 * k for k in range(21))


def stage_gain(design: Mapping[str, ArrayLike]) -> Amplification:
    """The amplification of a stage.

    Args:
        design: some of `web`, `hole` and `travel`, by default as they were built; m.

    Example:
        >>> stage_gain({"web": 0.25e-3}).gain
        Array(27.62804368, dtype=float64)
    """
    built = {"web": WEB, "hole": 3e-3, "travel": TRAVEL, **design}
    stage = microstage(built["web"], hole=built["hole"])
    return amplify(stage, built["travel"], throw=False)


def driven_linkage(design: Mapping[str, ArrayLike]) -> dict[str, Column | RESULTS]:
    """A linkage of like leaves as it is turned forth and back once.

    Args:
        design: some of `length` and `thickness` of its leaves, by default as built; m.

    Returns:
        How far link 3 moves at most along x, the largest moment that drives link 2, the
        slowest natural frequency of the linkage while link 2 is held.
    """
    built = {"length": 10e-3, "thickness": 1e-3, **design}
    linkage = four_bar(length=built["length"], thickness=built["thickness"])
    motion = drive(linkage, _TIMES, tolerance=1e-6, throw=False)
    free = vibrations(linkage, driven={"2": ["angle"]}, throw=False)
    return {
        "travel": Column(jnp.max(jnp.abs(motion.displacement("3")[:, 1])), (), "m"),
        "moment": Column(jnp.max(jnp.abs(motion.reaction("2")[:, 0])), (), "N m"),
        "frequency": Column(free.frequencies[0], (), "Hz"),
        "result": motion.result,
    }
