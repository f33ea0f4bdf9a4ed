"""Plots of the motion of a port."""

from typing import TYPE_CHECKING

import numpy as np

from ..solve.port_motion import PortMotion
from .figure_style import DARK_BLUE, GRAY, ORANGE, prefixed_unit, subplots


if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_port_motion(motion: PortMotion) -> "Figure":
    """Draw output, gain, and parasitic motion of a port over the travel of its input.

    Args:
        motion: Result of `port_motion`, not a batch.

    Returns:
        A figure with four panels: the output, and the output of the rigid mechanism if
        its gain is known; the gain; and the two parasitic coordinates.

    Raises:
        ImportError: Matplotlib is not installed.
        ValueError: This is a batch.

    Example:
        >>> import twistorjax as tj
        >>> stage = tj.examples.stage.microstage()
        >>> drive = tj.Drive("6", x=1e-6)
        >>> motion = tj.port_motion(stage, "4", direction="x", drive=drive)
        >>> figure = tj.plotting.draw_port_motion(motion)
    """
    if motion.travel.ndim != 1:
        raise ValueError(
            f"`motion` is a batch of shape {motion.travel.shape[:-1]}, but one motion "
            "can be drawn: `jax.tree.map(lambda values: values[0], motion)` is the first."
        )
    table = motion.columns()
    travel = np.asarray(motion.travel)
    factor, travel_unit = prefixed_unit(motion.unit, np.nanmax(np.abs(travel)))
    figure, panels = subplots(2, 2, size=(8.0, 5.6))
    curves = {f"output {motion.direction}": table[f"displacement_{motion.direction}"]}
    curves["gain"] = table["gain"]
    for name in motion.parasitic:
        curves[f"parasitic {name}"] = table[f"displacement_{name}"]
    for (label, column), axes in zip(curves.items(), panels.flat, strict=True):
        values = np.asarray(column.values)
        scale, shown = prefixed_unit(column.unit, np.nanmax(np.abs(values)))
        color = ORANGE if label.startswith("parasitic") else DARK_BLUE
        axes.plot(factor * travel, scale * values, color=color)
        axes.set_xlabel(f"travel of the input ({travel_unit})")
        axes.set_ylabel(f"{label} ({shown})" if shown else label)
        axes.grid(alpha=0.3)
        if label.startswith("output") and motion.rigid_gain is not None:
            rigid = scale * float(motion.rigid_gain) * travel
            axes.plot(
                factor * travel,
                rigid,
                color=GRAY,
                linestyle="--",
                label="rigid mechanism",
            )
            axes.legend()
        if label == "gain":  # a constant gain is a horizontal line, not rounding errors
            middle, span = np.nanmean(values), np.nanmax(values) - np.nanmin(values)
            margin = max(span, 1e-3 * abs(middle))
            axes.set_ylim(np.nanmin(values) - margin, np.nanmax(values) + margin)
            axes.ticklabel_format(useOffset=False)
    return figure
