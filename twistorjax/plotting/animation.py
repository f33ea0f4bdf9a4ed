"""A mechanism as it moves, on matplotlib axes."""

import math
from typing import cast, NamedTuple, TYPE_CHECKING

import numpy as np
from jaxtyping import ArrayLike, Float

from ..mechanism.mechanism import Mechanism
from ..solve.motion import Motion
from ..solve.statics import Equilibrium
from ..solve.vibrations import Vibrations
from .canvas import lengths, new_axes
from .drawing import draw, draw_ghost, figure_size
from .shapes import shapes, size_of


if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Polygon


_SWING = 0.08  # of a vibration, as a part of the mechanism's size
_PERIOD = 30  # frames of one


class _Film(NamedTuple):
    """Poses one after another, what is said of each, and how long they are shown."""

    poses: np.ndarray
    titles: list[str]
    interval: float  # ms


def animate(
    mechanism: Mechanism,
    moving: Motion | Vibrations | Equilibrium | Float[ArrayLike, "frames bodies 3"],
    *,
    mode: int = 0,
    magnify: float | int = 1.0,
    slower: float | int = 1.0,
    frames: int = 120,
    axes: "Axes | None" = None,
) -> "FuncAnimation":
    """Draws a mechanism as it moves: a motion, a vibration, a path of equilibria.

    Args:
        mechanism: what moves.
        moving: a motion, told at times evenly apart, so that it runs evenly; vibrations,
            of which one is shown, as large as can be seen; or equilibria one after
            another, as a batch of answers or of poses; rad, m, m.
        mode: which vibration, the slowest being 0.
        magnify: a factor on displacements, angles included; stated on the axes.
        slower: than a motion was, by this factor.
        frames: how many to draw at most, evenly chosen; each takes a tenth of a second.
        axes: on which to draw, by default new ones.

    Returns:
        The animation. A notebook shows it; `save("motion.gif", writer="pillow")` and
        `save("motion.mp4")` keep it.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: a batch of motions or of vibrations; there is no such mode; a single
            equilibrium.

    Example:
        >>> from twistorjax.examples import four_bar
        >>> linkage = four_bar.four_bar()
        >>> film = animate(linkage, four_bar.drive(linkage), slower=10)
        >>> "<script" in film.to_jshtml()
        True
    """
    film = _film(mechanism, moving, mode, magnify, slower, frames)
    if axes is None:
        wide, high = figure_size(mechanism, film.poses[0])
        axes = new_axes((5.0, 5.0 * high / wide))
    from matplotlib.animation import FuncAnimation

    unit, _ = lengths(size_of(mechanism))
    already = len(axes.patches)
    draw(mechanism, film.poses[0], ghost=False, names=False, axes=axes)
    parts = cast("list[Polygon]", list(axes.patches)[already:])
    draw_ghost(mechanism, axes)
    every = [part.corners for poses in film.poses for part in shapes(mechanism, poses)]
    axes.set(**_limits(unit * np.concatenate(every)))

    def frame(k: int) -> list["Polygon"]:
        for patch, part in zip(parts, shapes(mechanism, film.poses[k]), strict=True):
            patch.set_xy(unit * part.corners)
        axes.set_title(film.titles[k], fontsize="medium")
        return parts

    figure = cast("Figure", axes.get_figure(root=True))
    shown = FuncAnimation(
        figure, frame, frames=len(film.poses), interval=max(20.0, film.interval)
    )
    shown._repr_html_ = lambda: _html(shown, figure)
    return shown


def _html(shown: "FuncAnimation", figure: "Figure") -> str:
    """For a notebook, which would show the figure once more, and still."""
    from matplotlib import pyplot as plt

    plt.close(figure)
    with plt.rc_context({"savefig.dpi": 72}):  # a notebook keeps every frame
        return shown.to_jshtml()


def _film(
    mechanism: Mechanism,
    moving: Motion | Vibrations | Equilibrium | Float[ArrayLike, "frames bodies 3"],
    mode: int,
    magnify: float | int,
    slower: float | int,
    frames: int,
) -> _Film:
    reference = np.asarray(mechanism.reference)
    told = "" if magnify == 1 else f"displacements magnified {magnify:g} times"
    if isinstance(moving, Vibrations):
        frequencies, moved = np.asarray(moving.frequencies), np.asarray(moving.shapes)
        if frequencies.ndim != 1 or not -len(frequencies) <= mode < len(frequencies):
            raise ValueError(
                f"`mode` is {mode} of vibrations of shape {frequencies.shape}: animate "
                "those of one mechanism, and a mode that there is."
            )
        shape = moved[mode]
        largest = max(
            np.abs(after.corners - before.corners).max()
            for before, after in zip(
                shapes(mechanism, reference), shapes(mechanism, reference + 1e-6 * shape),
                strict=True,
            )
        )  # fmt: skip
        swing = magnify * _SWING * size_of(mechanism) / (1e6 * largest or 1.0)
        count = min(_PERIOD, frames)
        turns = np.sin(2 * np.pi * np.arange(count) / count)
        which = mode % len(frequencies) + 1
        title = f"vibration {which}: {frequencies[mode]:.5g} Hz, of any size"
        return _Film(
            reference + swing * turns[:, None, None] * shape,
            count * [title],
            2000 / count,
        )
    times, joined = np.zeros(0), "; " * bool(told)
    if isinstance(moving, Motion):
        times, poses = np.asarray(moving.times), np.asarray(moving.poses)
    else:
        poses = moving.poses if isinstance(moving, Equilibrium) else moving
        poses = np.asarray(poses)
    if poses.ndim != 3:
        what = (
            f"a batch of motions, of shape {poses.shape[:-3]}: animate one"
            if poses.ndim > 3
            else "one equilibrium: animate several one after another, or `draw` it"
        )
        raise ValueError(f"`moving` is {what}.")
    kept = np.flatnonzero(np.all(np.isfinite(poses), axis=(1, 2)))
    if not len(kept):
        raise ValueError("`moving` is nowhere finite: no solve of it succeeded.")
    chosen = np.linspace(0, len(kept) - 1, min(frames, len(kept))).round().astype(int)
    kept = kept[chosen]
    poses = reference + magnify * (poses - reference)
    if len(times):
        apart = max(float(np.ptp(times[kept])), 1e-12) / max(1, len(kept) - 1)
        digits = max(0, math.ceil(-math.log10(apart)))
        titles = [f"{times[k]:.{digits}f} s{joined}{told}" for k in kept]
        length = 1e3 * slower * float(times[kept[-1]] - times[kept[0]])
        return _Film(poses[kept], titles, length / max(1, len(kept) - 1))
    titles = [f"{k + 1} of {len(poses)}{joined}{told}" for k in kept]
    return _Film(poses[kept], titles, 3000 / len(kept))


def _limits(corners: np.ndarray) -> dict[str, tuple[float, float]]:
    """Limits of the axes, with some room around the corners."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = 0.05 * np.max(high - low)
    low, high = low - margin, high + margin
    return {"xlim": (low[0], high[0]), "ylim": (low[1], high[1])}
