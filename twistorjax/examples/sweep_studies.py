"""Studies of one design of the stage or of a linkage, for `twistorjax.sweep`."""

import jax.numpy as jnp

from .._utils.pytrees import largest_of
from .._utils.types import NamedNumbers
from ..results.codes import RESULTS
from ..results.tables import Column
from ..solve.vibrations import vibrations
from .four_bar import driven_motion, four_bar
from .stage import Amplification, amplification, microstage, TRAVEL, WEB


_TIMES = tuple(0.01 * k for k in range(21))  # one cycle of the driven linkage; s


def stage_gain(design: NamedNumbers) -> Amplification:
    """Compute the amplification of a stage.

    Args:
        design: Any of `web`, `hole`, and `travel`; by default those of the stage as
            built; m.

    Returns:
        The amplification. Its `result` reports a failure.

    Example:
        >>> stage_gain({"web": 0.25e-3}).gain
        Array(27.62804368, dtype=float64)
    """
    values = {"web": WEB, "hole": 3e-3, "travel": TRAVEL, **design}
    stage = microstage(values["web"], hole=values["hole"])
    return amplification(stage, values["travel"], throw=False)


def driven_linkage(design: NamedNumbers) -> dict[str, Column | RESULTS]:
    """Simulate one cycle of a driven linkage with four identical leaves.

    Args:
        design: Any of `length` and `thickness` of the leaves; by default those of the
            dissertation; m.

    Returns:
        The largest displacement of link 3 along x ("travel"), the largest moment that
        drives link 2 ("moment"), and the lowest natural frequency of the linkage while
        link 2 is fixed ("frequency").
    """
    values = {"length": 10e-3, "thickness": 1e-3, **design}
    linkage = four_bar(length=values["length"], thickness=values["thickness"])
    motion = driven_motion(linkage, _TIMES, tolerance=1e-6, throw=False)
    modes = vibrations(linkage, prescribed={"2": ["angle"]}, throw=False)
    return {
        "travel": Column(largest_of(jnp.abs(motion.displacement("3")[:, 1])), (), "m"),
        "moment": Column(largest_of(jnp.abs(motion.reaction("2")[:, 0])), (), "N m"),
        "frequency": Column(modes.frequencies[0], (), "Hz"),
        "result": motion.result,
    }
