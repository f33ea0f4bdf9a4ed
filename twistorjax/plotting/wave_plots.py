"""Plots of the waves in a lattice."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..solve.dispersion import Dispersion
from .figure_style import DARK_BLUE, GRAY, new_axes, ORANGE, prefixed_unit


if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SAME_DIRECTION = 1e-6  # largest difference of the unit vectors of steps in line


def draw_dispersion(
    dispersion: Dispersion,
    axes: "Axes | None" = None,
    *,
    corners: Sequence[str] = (),
) -> "Axes":
    """Draw the frequencies of waves over a path of wave vectors, and the band gaps.

    A band gap is a range of frequencies that none of the given waves has. It is not drawn
    if the bands change by more than its width from one wave vector to the next, because
    they may cross between them; give more wave vectors to see it. A vertical line marks
    each corner of the path.

    Args:
        dispersion: Result of `dispersion` for a path, such as `UnitCell.wave_vectors`.
        axes: Axes to draw on. By default new ones are created.
        corners: Names of the corners, with both ends, such as ["Γ", "X", "M", "Γ"].

    Returns:
        The axes. The abscissa is the length of the path (rad/m), or the named corners.

    Raises:
        ImportError: Matplotlib is not installed.
        ValueError: This is a batch, there is only one wave vector, or the path has
            another number of corners.

    Example:
        >>> import numpy as np
        >>> import twistorjax as tj
        >>> joint = tj.Quadratic(np.diag([1.5e-3, 1.2e5, 1.2e3]))
        >>> cell = tj.lattices.rotating_squares(joint, pitch=0.1, angle=0.4, mass=1e-3)
        >>> waves = cell.wave_vectors([(0, 0), (0.5, 0), (0.5, 0.5), (0, 0)], 10)
        >>> bands = tj.dispersion(cell, waves)
        >>> axes = draw_dispersion(bands, corners=["Γ", "X", "M", "Γ"])
        >>> axes.get_ylabel()
        'frequency (kHz)'
    """
    if dispersion.frequencies.ndim != 2 or len(dispersion.frequencies) < 2:
        raise ValueError(
            f"`dispersion` has frequencies of shape {dispersion.frequencies.shape}, but "
            "must be those of one lattice for two wave vectors or more."
        )
    frequencies = np.asarray(dispersion.frequencies)
    steps = np.diff(np.asarray(dispersion.wave_vectors), axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    path = np.concatenate([[0.0], np.cumsum(lengths)])
    directions = steps / np.where(lengths, lengths, 1.0)[:, None]
    turns = np.linalg.norm(np.diff(directions, axis=0), axis=1) > _SAME_DIRECTION
    places = np.array([path[0], *path[1:-1][turns], path[-1]])
    if len(corners) not in (0, len(places)):
        raise ValueError(
            f"`corners` has {len(corners)} names, but the path has {len(places)} corners "
            "with both of its ends."
        )
    factor, unit = prefixed_unit("Hz", float(np.nanmax(frequencies)))
    axes = new_axes((6.0, 4.5)) if axes is None else axes
    axes.plot(path, factor * frequencies, color=DARK_BLUE)
    for low, high in _band_gaps(frequencies):
        axes.axhspan(factor * low, factor * high, color=ORANGE, alpha=0.25, linewidth=0)
    for place in places[1:-1]:
        axes.axvline(place, color=GRAY, linewidth=0.8)
    axes.set_xlim(0.0, float(path[-1]))
    axes.set_ylim(bottom=0.0)
    if corners:
        axes.set_xticks(places, corners)
    axes.set_xlabel("wave vector" if corners else "path of the wave vector (rad/m)")
    axes.set_ylabel(f"frequency ({unit})")
    return axes


def _band_gaps(frequencies: np.ndarray) -> np.ndarray:
    """Return the ends of the gaps between bands, a row for each gap; Hz."""
    changes = np.pad(np.abs(np.diff(frequencies, axis=0)), ((1, 1), (0, 0)))
    steps = np.maximum(changes[:-1], changes[1:])

    def ends(reach: np.ndarray | float) -> np.ndarray:
        highest = np.nanmax(frequencies + reach, axis=0)
        lowest = np.nanmin(frequencies - reach, axis=0)
        return np.stack([np.maximum.accumulate(highest)[:-1], lowest[1:]], axis=1)

    # Between two wave vectors, a band that another one crosses may go on by a step.
    low, high = ends(steps).T
    return ends(0.0)[low < high]
