"""Plots of the motion and of the stiffness of a port."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Array

from ..solve.port_motion import PortMotion
from ..solve.stroke_stiffness import StrokeStiffness
from .figure_style import (
    BLACK,
    BLUE,
    DARK_BLUE,
    GRAY,
    GREEN,
    ORANGE,
    prefixed_unit,
    RED,
    subplots,
)


if TYPE_CHECKING:
    from matplotlib.figure import Figure


_CURVES = BLUE, ORANGE, GREEN, RED, GRAY, "#cc79a7"


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
    _require_single("motion", motion.travel)
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


def draw_stiffness(stroke: StrokeStiffness) -> "Figure":
    """Draw the driving and the support stiffness of a port over the stroke.

    Args:
        stroke: Result of `stiffness_over_stroke`, not a batch.

    Returns:
        A figure with two panels, of translational and of rotational stiffness, on
        logarithmic axes.

    Raises:
        ImportError: Matplotlib is not installed.
        ValueError: This is a batch.

    Example:
        >>> import twistorjax as tj
        >>> stage = tj.examples.stage.microstage()
        >>> drive = tj.Drive("6", x=1e-5)
        >>> stroke = tj.stiffness_over_stroke(stage, drive, body="4")
        >>> figure = tj.plotting.draw_stiffness(stroke)
    """
    _require_single("stroke", stroke.travel)
    travel = np.asarray(stroke.travel)
    factor, travel_unit = prefixed_unit(stroke.unit, np.nanmax(np.abs(travel)))
    table = stroke.columns()
    curves = {"driving": table["driving"]}
    for name in stroke.support:
        curves[f"support {name.replace('_', ' ')}"] = table[f"support_{name}"]
    panels: dict[str, dict[str, np.ndarray]] = {"N/m": {}, "N m/rad": {}}
    for label, column in curves.items():
        panels[column.unit][label] = np.asarray(column.values)
    figure, both = subplots(1, 2, size=(8.6, 3.8))
    colors = dict(zip(curves, (BLACK, *_CURVES), strict=False))
    for (unit, shown), axes in zip(panels.items(), both, strict=True):
        for label, values in shown.items():
            axes.plot(factor * travel, values, color=colors[label], label=label)
        axes.set_yscale("log")
        axes.set_xlabel(f"stroke ({travel_unit})")
        axes.set_ylabel(f"stiffness ({unit})")
        axes.grid(alpha=0.3)
        if shown:
            axes.legend(fontsize="small")
    return figure


def _require_single(name: str, travel: Array) -> None:
    """Require a result that is not a batch, by the travel in it."""
    if travel.ndim != 1:
        raise ValueError(
            f"`{name}` is a batch of shape {travel.shape[:-1]}, but one result can be "
            "drawn: `jax.tree.map(lambda values: values[0], batch)` is the first."
        )
