"""Plots of fatigue."""

from typing import TYPE_CHECKING

import numpy as np

from ..solve.fatigue import Fatigue
from .figure_style import DARK_BLUE, GRAY, GREEN, new_axes, RED


if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_fatigue(fatigue: Fatigue, axes: "Axes | None" = None) -> "Axes":
    """Draw the Goodman diagram: stress amplitude over mean stress of each hinge.

    Stresses are relative to the endurance limit and the ultimate strength of the material
    of their hinge. Below the line, the life is infinite.

    Args:
        fatigue: Result of `fatigue`, not a batch.
        axes: Axes to draw on. By default new ones are created.

    Returns:
        The axes.

    Raises:
        ImportError: Matplotlib is not installed.
        ValueError: This is a batch.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material.named("spring steel")
        >>> leaf = tj.flexures.leaf(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
        >>> hinge = tj.Hinge("leaf", "wall", "block", leaf, at=(0, 0, 0))
        >>> bodies = [tj.Body("wall"), tj.Body("block")]
        >>> mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
        >>> bent = tj.equilibrium(mechanism, loads=[tj.Load("block", moment=0.1)])
        >>> cycle = tj.fatigue(mechanism, [mechanism.reference, bent])
        >>> axes = tj.plotting.draw_fatigue(cycle)
    """
    if fatigue.mean.ndim != 1:
        raise ValueError(
            f"`fatigue` is a batch of shape {fatigue.mean.shape[:-1]}, but one can be "
            "drawn: `jax.tree.map(lambda values: values[0], fatigue)` is the first."
        )
    from .labels import Labels

    means = np.asarray(fatigue.mean / fatigue.ultimate_strength)
    amplitudes = np.asarray(fatigue.amplitude / fatigue.endurance_limit)
    axes = new_axes((6.0, 4.2)) if axes is None else axes
    left, top = min(0.0, 1.2 * means.min()), max(1.0, amplitudes.max())
    line = np.array([(left, 1.0), (0.0, 1.0), (1.0, 0.0)])
    axes.plot(*line.T, color=DARK_BLUE, label="limit of infinite life (Goodman)")
    axes.fill_between(*line.T, color=GREEN, alpha=0.12, linewidth=0)
    finite = np.asarray(~fatigue.infinite_life)
    for chosen, color, label in (
        (~finite, GREEN, "infinite life"),
        (finite, RED, "finite life"),
    ):
        if chosen.any():
            axes.plot(means[chosen], amplitudes[chosen], "o", color=color, label=label)
    axes.axvline(0.0, color=GRAY, linewidth=0.8)
    axes.set_xlim(left, max(1.05, 1.1 * means.max()))
    axes.set_ylim(0.0, 1.15 * top)
    axes.set_xlabel("mean stress / ultimate strength")
    axes.set_ylabel("stress amplitude / endurance limit")
    axes.legend(frameon=False, fontsize="small")
    labels = Labels.of(axes)
    for name, mean, amplitude in zip(fatigue.names, means, amplitudes, strict=True):
        labels.add(name, np.array([mean, amplitude]), np.array([0.0, 1.0]), zorder=5)
    return axes
