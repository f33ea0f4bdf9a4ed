"""A mechanism in motion, on matplotlib axes."""

from typing import cast, TYPE_CHECKING

import numpy as np

from ..mechanism import Mechanism
from ..solve.motion import Motion
from .drawing import draw


if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def animate(
    mechanism: Mechanism,
    motion: Motion,
    *,
    magnify: float | int = 1.0,
    slower: float | int = 1.0,
    axes: "Axes | None" = None,
) -> "FuncAnimation":
    """Draws a mechanism at each time of a motion, one after another.

    Args:
        mechanism: what moved.
        motion: of it, told at times evenly apart, so that it runs evenly.
        magnify: a factor on displacements, angles included; stated on the axes.
        slower: than it was, by this factor.
        axes: on which to draw, by default new ones.

    Returns:
        The animation: save it by its `save("motion.gif")` or `save("motion.mp4")`; in a
        notebook show `IPython.display.HTML(animation.to_jshtml())`.

    Raises:
        ImportError: matplotlib is not installed.

    Example:
        >>> from twistorjax.cases import four_bar
        >>> linkage = four_bar.four_bar()
        >>> film = animate(linkage, four_bar.drive(linkage), slower=10)
        >>> film.to_jshtml()[:7]
        '<script'
    """
    try:
        from matplotlib import pyplot as plt
        from matplotlib.animation import FuncAnimation
    except ImportError as error:
        raise ImportError(
            'Pictures need matplotlib: install it with `pip install "twistorjax[show]"`.'
        ) from error

    times = np.asarray(motion.times)
    poses = np.asarray(motion.poses)
    if poses.ndim != 3:
        raise ValueError(
            f"`motion` is a batch of motions, of shape {poses.shape[:-3]}: animate one."
        )
    kept = np.flatnonzero(np.isfinite(times))
    if axes is None:
        _, axes = plt.subplots(figsize=(5, 5), layout="constrained")
    limits = _limits(mechanism, poses[kept], magnify)

    def frame(k: int) -> list:
        axes.clear()
        draw(mechanism, poses[k], magnify=magnify, names=False, axes=axes)
        axes.set(**limits)
        title = axes.get_title()
        axes.set_title(
            f"{times[k]:.4g} s" + (f"; {title}" if title else ""), fontsize="medium"
        )
        return list(axes.patches)

    length = 1e3 * slower * (times[kept[-1]] - times[kept[0]])
    return FuncAnimation(
        cast("Figure", axes.get_figure(root=True)),
        frame,
        frames=[int(k) for k in kept],
        interval=max(20.0, length / max(1, len(kept) - 1)),
    )


def _limits(mechanism: Mechanism, poses: np.ndarray, magnify: float | int) -> dict:
    """Limits of the axes within which the whole motion lies; mm."""
    rest = np.asarray(mechanism.rest)
    moved = rest + magnify * (poses - rest)
    points = []
    for body, outline in enumerate(mechanism.outlines):
        corners = np.zeros((1, 2)) if outline is None else np.asarray(outline)
        cos, sin = np.cos(moved[:, body, :1]), np.sin(moved[:, body, :1])
        x = moved[:, body, 1:2] + cos * corners[:, 0] - sin * corners[:, 1]
        y = moved[:, body, 2:3] + sin * corners[:, 0] + cos * corners[:, 1]
        points.append(np.stack([x, y], axis=-1).reshape(-1, 2))
    every = 1e3 * np.concatenate(points)
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.05 * np.max(high - low)
    return {
        "xlim": (low[0] - margin, high[0] + margin),
        "ylim": (low[1] - margin, high[1] + margin),
    }
