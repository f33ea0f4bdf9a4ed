"""What was fitted beside what was measured, and how the errors are spread."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from .canvas import GRAY, INK, ORANGE


if TYPE_CHECKING:
    from matplotlib.axes import Axes


GIVEN = "#202020"
COLORS = (INK, ORANGE, GRAY)


def draw_ranked(
    axes: "Axes",
    given: Float[np.ndarray, " trials"],
    fitted: Mapping[str, Float[np.ndarray, " trials"]],
    unit: str,
) -> None:
    """Draws numbers in the order of their size, and what fits make of each.

    The axes keep to the range of the numbers; the legend counts what lies outside.

    Args:
        axes: on which to draw.
        given: the numbers, as measured or exact.
        fitted: what each fit makes of them, by its name; the first lies on top.
        unit: of the numbers.
    """
    order = np.argsort(given)
    ranks = np.arange(1, len(given) + 1)
    spread = np.ptp(given)
    low, high = given.min() - 0.25 * spread, given.max() + 0.25 * spread
    for depth, ((name, values), color) in enumerate(
        zip(fitted.items(), COLORS, strict=False)
    ):
        outside = int(np.sum(~((values >= low) & (values <= high))))
        label = f"{name} ({outside} outside)" if outside else name
        axes.plot(
            ranks, values[order], ".", color=color, markersize=3, label=label,
            zorder=3 - 0.1 * depth, rasterized=True,
        )  # fmt: skip
    axes.plot(ranks, given[order], color=GIVEN, linewidth=1, label="exact", zorder=4)
    axes.set_ylim(low, high)
    axes.set_xlabel("trial, by its exact energy")
    axes.set_ylabel(f"energy ({unit})")
    axes.legend(markerscale=3, fontsize="small", loc="upper left")


def draw_distribution(
    axes: "Axes", errors: Mapping[str, Float[np.ndarray, " trials"]], unit: str
) -> None:
    """Draws the share of trials whose error is above each size.

    Args:
        axes: on which to draw.
        errors: of each fit, by its name.
        unit: of the errors.
    """
    for (name, values), color in zip(errors.items(), COLORS, strict=False):
        sizes = np.sort(np.abs(values))[::-1]
        shares = np.arange(1, len(sizes) + 1) / len(sizes)
        axes.step(sizes, shares, color=color, label=name)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(alpha=0.3)
    axes.set_xlabel(f"error of the energy ({unit})")
    axes.set_ylabel("share of trials with a larger one")


def draw_numbers(
    axes: "Axes",
    given: Float[np.ndarray, " trials"],
    fitted: Mapping[str, Float[np.ndarray, " trials"]],
) -> None:
    """Draws the number that each trial gave, and what fits make of it.

    Large ones are drawn by their logarithm, so that those that are far off are seen too.

    Args:
        axes: on which to draw.
        given: the numbers, as measured.
        fitted: what each fit makes of them, by its name.
    """
    places = np.arange(1, len(given) + 1)
    axes.axhline(0, color="#d5d5d5", linewidth=0.8, zorder=0)
    axes.plot(
        places, given, "o", color=GIVEN, fillstyle="none", markersize=9, label="given"
    )
    for (name, values), color, mark in zip(fitted.items(), COLORS, ".v^", strict=False):
        axes.plot(places, values, mark, color=color, label=name)
    # even up to a power of ten that is above all given ones, and by tenfolds beyond
    reach = max(np.abs(values).max() for values in (given, *fitted.values()))
    first, last = (math.ceil(np.log10(size)) for size in (np.abs(given).max(), reach))
    decades = 10.0 ** np.arange(first, last + 1)
    axes.set_yscale("symlog", linthresh=decades[0], linscale=2)
    axes.set_yticks([*-decades[::-1], 0.0, *decades])
    axes.set_ylim(-1.5 * decades[-1], 1.5 * decades[-1])
    axes.set_xticks(places)
