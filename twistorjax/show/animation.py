"""A mechanism in motion, on matplotlib axes."""

from typing import cast, TYPE_CHECKING

import numpy as np

from ..mechanism import Mechanism
from ..solve.motion import Motion
from .canvas import new_axes
from .drawing import draw, draw_ghost, shapes


if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Polygon


def animate(
    mechanism: Mechanism,
    motion: Motion,
    *,
    magnify: float | int = 1.0,
    slower: float | int = 1.0,
    frames: int = 120,
    axes: "Axes | None" = None,
) -> "FuncAnimation":
    """Draws a mechanism at each time of a motion, one after another.

    Args:
        mechanism: what moved.
        motion: of it, told at times evenly apart, so that it runs evenly.
        magnify: a factor on displacements, angles included; stated on the axes.
        slower: than it was, by this factor.
        frames: how many to draw at most, evenly chosen; each takes a tenth of a second.
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
        >>> "<script" in film.to_jshtml()
        True
    """
    times = np.asarray(motion.times)
    poses = np.asarray(motion.poses)
    if poses.ndim != 3:
        raise ValueError(
            f"`motion` is a batch of motions, of shape {poses.shape[:-3]}: animate one."
        )
    kept = np.flatnonzero(np.isfinite(times))
    chosen = np.linspace(0, len(kept) - 1, min(frames, len(kept))).round().astype(int)
    kept = kept[chosen]
    if axes is None:
        axes = new_axes((5, 5))
    from matplotlib.animation import FuncAnimation

    rest = np.asarray(mechanism.rest)
    placed = rest + magnify * (poses - rest)
    already = len(axes.patches)
    first = motion.poses[kept[0]]
    draw(mechanism, first, magnify=magnify, ghost=False, names=False, axes=axes)
    moving = cast("list[Polygon]", list(axes.patches)[already:])
    draw_ghost(mechanism, axes)
    every = [corners for k in kept for corners, _ in shapes(mechanism, placed[k])]
    axes.set(**_limits(np.concatenate(every)))
    stated = axes.get_title()

    def frame(k: int) -> list["Polygon"]:
        for patch, (corners, _) in zip(moving, shapes(mechanism, placed[k]), strict=True):
            patch.set_xy(1e3 * corners)
        title = f"{times[k]:.4g} s" + (f"; {stated}" if stated else "")
        axes.set_title(title, fontsize="medium")
        return moving

    length = 1e3 * slower * (times[kept[-1]] - times[kept[0]])
    return FuncAnimation(
        cast("Figure", axes.get_figure(root=True)),
        frame,
        frames=[int(k) for k in kept],
        interval=max(20.0, length / max(1, len(kept) - 1)),
    )


def _limits(corners: np.ndarray) -> dict[str, tuple[float, float]]:
    """Limits of the axes, with some room around the corners; mm."""
    low, high = 1e3 * corners.min(axis=0), 1e3 * corners.max(axis=0)
    margin = 0.05 * np.max(high - low)
    low, high = low - margin, high + margin
    return {"xlim": (low[0], high[0]), "ylim": (low[1], high[1])}
