"""Animations of motions, vibrations and equilibrium paths, on matplotlib axes."""

import math
from typing import cast, NamedTuple, TYPE_CHECKING

import numpy as np
from jaxtyping import ArrayLike, Float
from typing_extensions import TypeAliasType

from .._utils.validation import quote, require_instance
from ..mechanism.mechanism import Mechanism
from ..results.solutions import BodyPoses
from ..solve.continuation.solution import Path
from ..solve.integration.solution import Motion
from ..solve.vibration_results import OutOfPlaneVibrations, Vibrations
from .drawing import (
    ARE_CLOSED,
    color_bar,
    Colors,
    draw_dotted,
    draw_reference,
    draw_shapes,
    figure_size,
    grouped_corners,
    paint,
    part_values,
)
from .figure_style import length_unit, new_axes
from .oblique import FLAT, OBLIQUE_AXES, vibration_shapes
from .shapes import mechanism_size, shapes, with_flexure_outlines


if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure


_AMPLITUDE = 0.08  # of a vibration, relative to the size of the mechanism
_FRAMES_PER_PERIOD = 30  # of a vibration


class _Frames(NamedTuple):
    """Frames of an animation: poses (rad, m, m), titles, and the time of each frame."""

    poses: np.ndarray
    titles: list[str]
    interval: float  # ms


# What can be animated; poses in rad, m, m
Animated = TypeAliasType(
    "Animated",
    BodyPoses | Vibrations | Float[ArrayLike, "frames bodies 3"],
)


def animate(
    mechanism: Mechanism,
    motion: Animated,
    *,
    mode: int = 0,
    magnify: float | int = 1.0,
    slower: float | int = 1.0,
    frames: int = 120,
    color: Colors | None = None,
    label: str = "",
    axes: "Axes | None" = None,
) -> "FuncAnimation":
    """Animate a motion, a vibration mode, a path, or a batch of equilibria.

    All frames have the same duration. The speed of the animation is therefore correct
    only if the times of the motion are evenly spaced.

    Args:
        mechanism: The mechanism.
        motion: A motion, vibrations, an equilibrium path, states of a bistable mechanism,
            a batch of equilibria, or poses; rad, m, m. One mode of the vibrations is
            shown. Its amplitude is 8 % of the size of the mechanism. Vibrations out of
            the plane are shown in an oblique view, colored by z.
        mode: Index of the vibration mode. Mode 0 has the lowest frequency.
        magnify: Factor on all displacements, including angles. It is stated in the title.
        slower: Factor by which the animation is slower than the motion.
        frames: Maximum number of frames, which are chosen evenly. Drawing a frame takes
            about 0.1 s.
        color: What colors the hinges or the bodies, as in `draw`. The color bar holds for
            all frames.
        label: Label of the color bar, with the unit of the numbers in `color`.
        axes: Axes to draw on. By default new ones are created.

    Returns:
        The animation. A notebook displays it; `save("motion.gif", writer="pillow")` and
        `save("motion.mp4")` write files.

    Raises:
        ImportError: Matplotlib is not installed.
        ValueError: `motion` is a batch of motions or of vibrations, or a single
            equilibrium; or there is no such mode.

    Example:
        >>> from twistorjax.examples import four_bar
        >>> linkage = four_bar.four_bar()
        >>> motion = four_bar.driven_motion(linkage)
        >>> animation = animate(linkage, motion, slower=10)
        >>> "<script" in animation.to_jshtml()
        True
    """
    from matplotlib.animation import FuncAnimation

    require_instance("mechanism", mechanism, Mechanism)
    mechanism = with_flexure_outlines(mechanism)
    unit, unit_name = length_unit(mechanism_size(mechanism))
    if isinstance(motion, OutOfPlaneVibrations):
        count = min(_FRAMES_PER_PERIOD, frames)
        drawn, flat, values, title = vibration_shapes(
            mechanism, motion, mode, magnify, count
        )
        titles, interval = count * [title], 2000 / count
        label, names = "z, relative to the largest", OBLIQUE_AXES
    else:
        flat = []
        sequence = _frames(mechanism, motion, mode, magnify, slower, frames)
        displacements = (sequence.poses - np.asarray(mechanism.reference)) / magnify
        values, label = part_values(mechanism, displacements, color, label)
        drawn = [shapes(mechanism, poses, magnify) for poses in sequence.poses]
        titles, interval, names = sequence.titles, sequence.interval, ("x", "y")
    corners = np.concatenate([shape.corners for frame in drawn for shape in frame])
    if axes is None:
        width, height = figure_size(corners, bool(values))
        axes = new_axes((5.0, 5.0 * height / width))
    if flat:
        draw_dotted(axes, flat, unit, **FLAT)
    collections = draw_shapes(axes, drawn[0], unit, {})
    if not flat:
        draw_reference(mechanism, axes)
    fills = color_bar(axes, values, label) if values else None
    axes.set(aspect="equal", **_limits(unit * corners))
    for axis, name in zip("xy", names, strict=True):
        axes.set(**{f"{axis}label": f"{name} ({unit_name})"})

    def update(k: int) -> list["PolyCollection"]:
        for collection, parts, closed in zip(
            collections, grouped_corners(drawn[k]), ARE_CLOSED, strict=True
        ):
            collection.set_verts([unit * part for part in parts], closed=closed)
        if fills is not None:
            paint(collections, drawn[k], fills[k])
        axes.set_title(titles[k], fontsize="medium")
        return collections

    figure = cast("Figure", axes.get_figure(root=True))
    animation = FuncAnimation(
        figure,
        update,
        frames=len(drawn),
        interval=max(20.0, interval),
    )
    animation._repr_html_ = lambda: _html(animation, figure)
    return animation


def _html(animation: "FuncAnimation", figure: "Figure") -> str:
    """Convert an animation for a notebook, and close its figure.

    A notebook would otherwise also display the figure as a still picture.
    """
    from matplotlib import pyplot as plt

    plt.close(figure)
    with plt.rc_context({"savefig.dpi": 72}):  # A notebook stores every frame.
        return animation.to_jshtml()


def _frames(
    mechanism: Mechanism,
    motion: Animated,
    mode: int,
    magnify: float | int,
    slower: float | int,
    frames: int,
) -> _Frames:
    """Compute the frames of an animation; see `animate` for the arguments."""
    reference = np.asarray(mechanism.reference)
    if isinstance(motion, Vibrations):
        return _vibration_frames(mechanism, motion, mode, magnify, frames)
    times = np.asarray(motion.times if isinstance(motion, Motion) else ())
    poses = np.asarray(motion.poses if isinstance(motion, BodyPoses) else motion)
    if not np.issubdtype(poses.dtype, np.number):
        raise ValueError(
            f"`motion` is {quote(motion)}, but must be a motion, vibrations, a path, or "
            "a batch of equilibria or poses."
        )
    if poses.ndim > 3:
        raise ValueError(
            f"`motion` is a batch of motions, of shape {poses.shape[:-3]}. Animate one "
            "of them."
        )
    if poses.ndim != 3:
        raise ValueError(
            "`motion` is one equilibrium. Give a batch of equilibria, or use `draw`."
        )
    finite = np.flatnonzero(np.all(np.isfinite(poses), axis=(1, 2)))
    if not len(finite):
        raise ValueError("`motion` has no finite pose: no solve succeeded.")
    count = min(frames, len(finite))
    rows = finite[np.linspace(0, len(finite) - 1, count).round().astype(int)]
    drawn_poses = (reference + magnify * (poses - reference))[rows]
    suffix = "" if magnify == 1 else f"; displacements magnified {magnify:g} times"
    if isinstance(motion, Path):
        factors = np.asarray(motion.load_factors)[rows]
        titles = [f"load factor {factor:.3f}{suffix}" for factor in factors]
        return _Frames(drawn_poses, titles, 3000 / count)
    if not len(times):
        titles = [f"{row + 1} of {len(poses)}{suffix}" for row in rows]
        return _Frames(drawn_poses, titles, 3000 / count)
    spacing = max(float(np.ptp(times[rows])), 1e-12) / max(1, count - 1)
    digits = max(0, math.ceil(-math.log10(spacing)))
    titles = [f"{times[row]:.{digits}f} s{suffix}" for row in rows]
    duration = 1e3 * slower * float(times[rows[-1]] - times[rows[0]])
    return _Frames(drawn_poses, titles, duration / max(1, count - 1))


def _vibration_frames(
    mechanism: Mechanism,
    vibrations: Vibrations,
    mode: int,
    magnify: float | int,
    frames: int,
) -> _Frames:
    """Compute the frames of one period of a vibration mode; see `animate`."""
    reference = np.asarray(mechanism.reference)
    frequencies = np.asarray(vibrations.frequencies)
    if frequencies.ndim != 1 or not -len(frequencies) <= mode < len(frequencies):
        raise ValueError(
            f"`mode` is {mode}, and the frequencies have shape {frequencies.shape}. "
            "Animate the vibrations of one mechanism, and one of its modes."
        )
    shape = np.asarray(vibrations.shapes)[mode]
    step = 1e-6  # small enough that the displacements are linear in it
    largest = max(
        np.abs(after.corners - before.corners).max()
        for before, after in zip(
            shapes(mechanism, reference), shapes(mechanism, reference + step * shape),
            strict=True,
        )
    )  # fmt: skip
    amplitude = magnify * _AMPLITUDE * mechanism_size(mechanism) / (1e6 * largest or 1.0)
    count = min(_FRAMES_PER_PERIOD, frames)
    phases = np.sin(2 * np.pi * np.arange(count) / count)
    title = f"vibration at {frequencies[mode]:.5g} Hz, arbitrary amplitude"
    poses = reference + amplitude * phases[:, None, None] * shape
    return _Frames(poses, count * [title], 2000 / count)


def _limits(corners: np.ndarray) -> dict[str, tuple[float, float]]:
    """Compute limits of the axes with a margin around the corners."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = 0.05 * np.max(high - low)
    low, high = low - margin, high + margin
    return {"xlim": (low[0], high[0]), "ylim": (low[1], high[1])}
