"""Plots of the waves in a lattice."""

from typing import TYPE_CHECKING

import numpy as np

from ..solve.dispersion import Dispersion
from .figure_style import DARK_BLUE, new_axes, ORANGE, prefixed_unit


if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_dispersion(dispersion: Dispersion, axes: "Axes | None" = None) -> "Axes":
    """Draw the frequencies of waves over a path of wave vectors, and the band gaps.

    A band gap is a range of frequencies that none of the given waves has. Between them,
    bands may touch.

    Args:
        dispersion: Result of `dispersion` for a path, such as `UnitCell.wave_vectors`.
        axes: Axes to draw on. By default new ones are created.

    Returns:
        The axes. The abscissa is the length of the path; rad/m.

    Raises:
        ImportError: Matplotlib is not installed.
        ValueError: This is a batch, or there is only one wave vector.

    Example:
        >>> import numpy as np
        >>> import twistorjax as tj
        >>> joint = tj.Quadratic(np.diag([1.5e-3, 1.2e5, 1.2e3]))
        >>> cell = tj.lattices.rotating_squares(joint, pitch=0.1, angle=0.4, mass=1e-3)
        >>> waves = cell.wave_vectors([(0, 0), (0.5, 0), (0.5, 0.5), (0, 0)], 10)
        >>> draw_dispersion(tj.dispersion(cell, waves)).get_ylabel()
        'frequency (kHz)'
    """
    if dispersion.frequencies.ndim != 2 or len(dispersion.frequencies) < 2:
        raise ValueError(
            f"`dispersion` has frequencies of shape {dispersion.frequencies.shape}, but "
            "must be those of one lattice for two wave vectors or more."
        )
    frequencies = np.asarray(dispersion.frequencies)
    steps = np.linalg.norm(np.diff(np.asarray(dispersion.wave_vectors), axis=0), axis=1)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    factor, unit = prefixed_unit("Hz", float(np.nanmax(frequencies)))
    axes = new_axes((6.0, 4.5)) if axes is None else axes
    axes.plot(path, factor * frequencies, color=DARK_BLUE)
    lowest, highest = np.nanmin(frequencies, axis=0), np.nanmax(frequencies, axis=0)
    below = np.maximum.accumulate(highest)[:-1]
    for low, high in zip(factor * below, factor * lowest[1:], strict=True):
        if high > low:
            axes.axhspan(low, high, color=ORANGE, alpha=0.25, linewidth=0)
    axes.set_xlim(0.0, float(path[-1]))
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("path of the wave vector (rad/m)")
    axes.set_ylabel(f"frequency ({unit})")
    return axes
