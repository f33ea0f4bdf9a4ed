"""Plots of frequency responses."""

from typing import Literal, TYPE_CHECKING

import numpy as np

from .._utils.validation import require_choice
from ..mechanism.mechanism import COORDINATES
from ..solve.frequency_response import FrequencyResponse
from .figure_style import DARK_BLUE, prefixed_unit, subplots


if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_frequency_response(
    response: FrequencyResponse, body: str, coordinate: Literal["angle", "x", "y"]
) -> "Figure":
    """Draw amplitude and phase of a displacement over the frequency.

    Args:
        response: Result of `frequency_response`, not a batch.
        body: Name of the body.
        coordinate: Its coordinate.

    Returns:
        The figure: the amplitude, and the phase below it. A displacement that follows the
        excitation has the phase 0°, and a negative phase is a lag.

    Raises:
        ImportError: Matplotlib is not installed.
        ValueError: This is a batch, there is no such body, or the coordinate is unknown.

    Example:
        >>> import twistorjax as tj
        >>> stage = tj.examples.stage.microstage()
        >>> push = tj.Load("6", force=(1.0, 0.0))
        >>> response = tj.frequency_response(
        ...     stage, np.geomspace(10.0, 300.0, 200), loads=[push]
        ... )
        >>> figure = tj.plotting.draw_frequency_response(response, "4", "x")
    """
    if response.frequencies.ndim != 1:
        raise ValueError(
            f"`response` is a batch of shape {response.frequencies.shape[:-1]}, but one "
            "response can be drawn: `jax.tree.map(lambda values: values[0], response)`."
        )
    column = COORDINATES.index(require_choice("`coordinate`", coordinate, COORDINATES))
    amplitudes = np.asarray(response.displacement(body))[:, column]
    sizes, frequencies = np.abs(amplitudes), np.asarray(response.frequencies)
    factor, unit = prefixed_unit(
        "rad" if coordinate == "angle" else "m", float(np.nanmax(sizes, initial=0.0))
    )
    figure, (above, below) = subplots(2, 1, size=(6.0, 4.6), sharex=True)
    above.loglog(frequencies, factor * sizes, color=DARK_BLUE)
    phases = np.angle(amplitudes)
    # Without damping, the response lags by half a turn above a resonance.
    phases = np.unwrap(np.where(phases > np.pi - 1e-9, -np.pi, phases))
    below.plot(frequencies, np.degrees(phases), color=DARK_BLUE)
    above.set_ylabel(f"{coordinate} of {body} ({unit})")
    below.set_ylabel("phase (°)")
    below.set_xlabel("frequency (Hz)")
    for axes in (above, below):
        axes.grid(alpha=0.3)
    return figure
