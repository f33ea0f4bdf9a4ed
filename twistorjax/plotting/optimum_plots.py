"""Plots of optimizations."""

from typing import TYPE_CHECKING

import numpy as np

from ..sweeps.optimization.optimum import Optimum
from .figure_style import DARK_BLUE, GRAY, ORANGE, prefixed_unit, RED, subplots


if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw_optimum(optimum: Optimum) -> "Figure":
    """Draw the margins of an optimum, and the ends of all searches.

    The margin of a limited output is its distance to the limit, divided by the limit. The
    margin of an active limit is zero.

    Args:
        optimum: Result of `optimize`.

    Returns:
        The figure: the margins on the left, and on the right the objective at the end of
        each search, the best one first. Searches that did not end at an optimum within
        all limits are gray. Without limits there is only the right part.

    Raises:
        ImportError: Matplotlib is not installed.

    Example:
        >>> import twistorjax as tj
        >>> optimum = tj.optimize(
        ...     lambda design: {"f": (design["x"] - 1.0) ** 2, "x": 1.0 * design["x"]},
        ...     {"x": tj.Parameter(0.5, lower=-2.0, upper=2.0)},
        ...     minimize="f",
        ...     limits={"x": tj.Limit(upper=0.8)},
        ...     starts=4,
        ... )
        >>> figure = tj.plotting.draw_optimum(optimum)
    """
    names = list(optimum.margins)
    height = max(3.2, 0.8 + 0.24 * len(names))
    if names:
        figure, (left, right) = subplots(1, 2, size=(9.0, height))
        _draw_margins(left, optimum)
    else:
        figure, right = subplots(size=(4.5, height))
    _draw_searches(right, optimum)
    return figure


def _draw_margins(left: "Axes", optimum: Optimum) -> None:
    names = list(optimum.margins)
    margins = 100 * np.array([optimum.margins[name] for name in names])
    colors = [ORANGE if abs(margin) < 1e-2 else DARK_BLUE for margin in margins]
    rows = np.arange(len(names))
    left.barh(rows, margins, color=colors)
    # A bar of an active limit has no length.
    active = np.abs(margins) < 1e-2
    left.plot(margins[active], rows[active], "o", color=ORANGE)
    left.set_yticks(rows, names)
    left.invert_yaxis()
    if np.max(np.abs(margins)) < 1:
        left.set_xlim(-1.0, 1.0)
    left.axvline(0.0, color=RED, linewidth=1.0)
    left.set_xlabel("margin (% of the limit)")
    left.grid(axis="x", alpha=0.3)


def _draw_searches(right: "Axes", optimum: Optimum) -> None:
    """Draw the objective at the end of each search, the best one first."""
    from matplotlib.ticker import MaxNLocator

    objectives = np.asarray(optimum.searches.objectives)
    shown = np.abs(objectives[np.isfinite(objectives)])
    factor, unit = prefixed_unit(optimum.unit, np.max(shown, initial=0.0))
    objectives = factor * objectives
    found = np.array([code == 0 for code in optimum.searches.results])
    order = np.lexsort(((-1 if optimum.maximized else 1) * objectives, ~found))
    ranks = np.arange(1, len(order) + 1)
    values, converged = objectives[order], found[order]
    right.plot(ranks[converged], values[converged], "o", color=DARK_BLUE, label="optimum")
    if not np.all(converged):
        label = "no optimum within all limits"
        right.plot(ranks[~converged], values[~converged], "x", color=GRAY, label=label)
        right.legend()
    unit = f" ({unit})" if unit not in ("", "1") else ""
    right.set_xlabel("search, the best one first")
    right.set_ylabel(f"{optimum.name}{unit} at its end")
    right.grid(alpha=0.3)
    right.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    right.set_xlim(0.5, len(order) + 0.5)
    # Differences that are rounding errors of the search are not magnified.
    shown = values[np.isfinite(values)]
    if shown.size and np.ptp(shown) < 1e-3 * np.max(np.abs(shown)):
        middle, half = np.mean(shown), 0.01 * np.max(np.abs(shown))
        right.set_ylim(middle - half, middle + half)
    right.ticklabel_format(axis="y", useOffset=False)
