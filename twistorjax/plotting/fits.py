"""Comparisons of fits with the data, and distributions of their errors."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from .figure_style import BLACK, DARK_BLUE, GRAY, ORANGE


if TYPE_CHECKING:
    from matplotlib.axes import Axes


_FIT_COLORS = (DARK_BLUE, ORANGE, GRAY)


def draw_ranked(
    axes: "Axes",
    data: Float[np.ndarray, " trials"],
    fitted: Mapping[str, Float[np.ndarray, " trials"]],
    unit: str,
) -> None:
    """Draw energies in ascending order, and their predictions by fits.

    The limits of the axes follow from the data. The legend counts the predictions that
    lie outside. The first fit is drawn on top.
    """
    order = np.argsort(data)
    ranks = np.arange(1, len(data) + 1)
    margin = 0.25 * np.ptp(data)
    low, high = data.min() - margin, data.max() + margin
    for depth, ((name, values), color) in enumerate(
        zip(fitted.items(), _FIT_COLORS, strict=False)
    ):
        outside = int(np.sum(~((values >= low) & (values <= high))))
        label = f"{name} ({outside} outside)" if outside else name
        axes.plot(
            ranks, values[order], ".", color=color, markersize=3, label=label,
            zorder=3 - 0.1 * depth, rasterized=True,
        )  # fmt: skip
    axes.plot(ranks, data[order], color=BLACK, linewidth=1, label="exact", zorder=4)
    axes.set_ylim(low, high)
    axes.set_xlabel("trial, by its exact energy")
    axes.set_ylabel(f"energy ({unit})")
    axes.legend(markerscale=3, fontsize="small", loc="upper left")


def draw_distribution(
    axes: "Axes", errors: Mapping[str, Float[np.ndarray, " trials"]], unit: str
) -> None:
    """Draw the share of trials whose absolute error exceeds each value."""
    for (name, values), color in zip(errors.items(), _FIT_COLORS, strict=False):
        sizes = np.sort(np.abs(values))[::-1]
        shares = np.arange(1, len(sizes) + 1) / len(sizes)
        axes.step(sizes, shares, color=color, label=name)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(alpha=0.3)
    axes.set_xlabel(f"error of the energy ({unit})")
    axes.set_ylabel("share of trials with a larger error")


def draw_numbers(
    axes: "Axes",
    data: Float[np.ndarray, " trials"],
    fitted: Mapping[str, Float[np.ndarray, " trials"]],
) -> None:
    """Draw one number for each trial, and its predictions by fits.

    The scale is linear up to the power of ten above the data and logarithmic above it, so
    that predictions with large errors are visible, too.
    """
    trials = np.arange(1, len(data) + 1)
    axes.axhline(0, color="#d5d5d5", linewidth=0.8, zorder=0)
    axes.plot(
        trials, data, "o", color=BLACK, fillstyle="none", markersize=9, label="given"
    )
    for (name, values), color, mark in zip(
        fitted.items(), _FIT_COLORS, ".v^", strict=False
    ):
        axes.plot(trials, values, mark, color=color, label=name)
    largest = max(np.abs(values).max() for values in (data, *fitted.values()))
    first, last = (math.ceil(np.log10(size)) for size in (np.abs(data).max(), largest))
    decades = 10.0 ** np.arange(first, last + 1)
    axes.set_yscale("symlog", linthresh=decades[0], linscale=2)
    axes.set_yticks([*-decades[::-1], 0.0, *decades])
    axes.set_ylim(-1.5 * decades[-1], 1.5 * decades[-1])
    axes.set_xticks(trials)
