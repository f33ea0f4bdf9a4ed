"""Comparisons of fits with the data, and distributions of their errors."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..identification.report import Identification
from .figure_style import BLACK, DARK_BLUE, GRAY, ORANGE, prefixed_unit, subplots


if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_FIT_COLORS = (DARK_BLUE, ORANGE, GRAY)


def draw_fit(identification: Identification) -> "Figure":
    """Draw what was measured beside what the identified mechanism predicts.

    Args:
        identification: Result of `identify`, not a batch.

    Returns:
        The figure, with a column for each sensor: above, readings and predictions over
        the time or the number of the reading; below, their differences in standard
        deviations, of which 95 % are expected within the gray band.

    Raises:
        ImportError: Matplotlib is not installed.
        ValueError: This is a batch.

    Example:
        >>> import twistorjax as tj
        >>> def design(parameters):
        ...     spring = tj.Quadratic(np.diag([1.0, 1e3, 1e3])) * parameters["factor"]
        ...     hinge = tj.Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
        ...     bodies = [tj.Body("wall"), tj.Body("block")]
        ...     return tj.Mechanism(bodies, [hinge], fixed=["wall"])
        >>> sensor = tj.identification.BodySensor("block", "x", standard_deviation=1e-5)
        >>> pulls = [[tj.Load("block", force=(force, 0.0))] for force in (1.0, 2.0)]
        >>> test = tj.identification.StaticTest(pulls, [sensor])
        >>> data = test.measurement([[0.98e-3], [2.01e-3]])
        >>> found = tj.identify(design, {"factor": tj.Parameter(1.1, lower=0)}, [data])
        >>> figure = tj.plotting.draw_fit(found)
    """
    if identification.normalized.ndim != 1:
        raise ValueError(
            f"`identification` is a batch of shape {identification.normalized.shape[:-1]}"
            ", but one can be drawn: `jax.tree.map(lambda values: values[0], batch)`."
        )
    problem = identification.problem
    data = [(part, "") for part in problem.data]
    data += [(part, ", held out") for part in problem.held_out]
    residuals = [*identification.residuals, *identification.held_out_residuals]
    panels = [
        (measurement, column, note, np.asarray(of_test)[:, column])
        for (measurement, note), of_test in zip(data, residuals, strict=True)
        for column in range(len(measurement.test.columns))
    ]
    figure, axes = subplots(
        2, len(panels), size=(4.0 * len(panels), 4.6), squeeze=False, sharex="col",
        height_ratios=[2, 1],
    )  # fmt: skip
    for (measurement, column, note, differences), (above, below) in zip(
        panels, axes.T, strict=True
    ):
        test = measurement.test
        values = np.asarray(measurement.values)[:, column]
        deviations = np.asarray(measurement.standard_deviations)[:, column]
        exists = np.isfinite(values)
        times = getattr(test, "times", None)
        at = np.arange(1, len(values) + 1) if times is None else np.asarray(times)
        factor, unit = prefixed_unit(
            test.units[column], float(np.max(np.abs(values[exists]), initial=0.0))
        )
        predicted = np.where(exists, values + deviations * differences, np.nan)
        above.errorbar(
            at, factor * values, factor * deviations,
            fmt="o", color=ORANGE, markersize=4, label="measured",
        )  # fmt: skip
        style = "x" if times is None else "-"
        above.plot(at, factor * predicted, style, color=DARK_BLUE, label="predicted")
        above.set_ylabel(f"{test.columns[column]} ({unit})")
        above.set_title(f"{type(test).__name__}{note}", fontsize="medium")
        above.legend(frameon=False, fontsize="small")
        below.axhspan(-1.96, 1.96, color=GRAY, alpha=0.2, linewidth=0)
        below.plot(at[exists], differences[exists], ".", color=DARK_BLUE)
        below.set_ylabel("difference (σ)")
        below.set_xlabel("reading" if times is None else "time (s)")
        if times is None:
            below.set_xticks(at)
        for each in (above, below):
            each.grid(alpha=0.3)
    return figure


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
