"""A mechanism at given poses, drawn on matplotlib axes."""

from typing import TYPE_CHECKING

import numpy as np

from .._types import Corners, PosesLike
from ..mechanism import Mechanism
from ..solve.motion import Motion
from ..solve.statics import Equilibrium
from .canvas import new_axes


if TYPE_CHECKING:
    from matplotlib.axes import Axes


BODY, HELD, HINGE, GHOST = "#b8cfe3", "#d5d5d5", "#e08214", "#8a8a8a"
_DOT = 0.012  # radius of a hinge without an outline, as a part of the mechanism's size


def draw(
    mechanism: Mechanism,
    poses: PosesLike | Equilibrium | Motion | None = None,
    *,
    magnify: float | int = 1.0,
    ghost: bool = True,
    names: bool = True,
    axes: "Axes | None" = None,
) -> "Axes":
    """Draws a mechanism: bodies by their outlines, hinges between them, as they bend.

    A body without an outline is drawn as lines from its origin to its hinges; a hinge
    without one as a dot.

    Args:
        mechanism: what to draw.
        poses: of its bodies, by default at rest, or an equilibrium, or a motion for its
            end; rad, m, m.
        magnify: a factor on displacements, angles included; stated on the axes.
        ghost: whether the shape at rest is shown too, where it differs.
        names: whether bodies and hinges are labelled.
        axes: on which to draw, by default new ones.

    Returns:
        The axes, with millimetres on them.

    Raises:
        ImportError: matplotlib is not installed.

    Example:
        >>> from twistorjax.cases import stage
        >>> axes = draw(stage.microstage())
        >>> axes.get_xlabel()
        'x (mm)'
    """
    rest = np.asarray(mechanism.rest)
    displacements = np.zeros_like(rest)
    if isinstance(poses, Equilibrium | Motion):
        poses = poses.poses if isinstance(poses, Equilibrium) else poses.poses[-1]
    if poses is not None:
        displacements = np.asarray(mechanism._displacements(poses))
    moved = rest + magnify * displacements
    if axes is None:
        axes = new_axes((7, 6))
    if ghost and np.any(displacements):
        draw_ghost(mechanism, axes)
    for shape, colour in shapes(mechanism, moved):
        closed = colour != HINGE
        _polygon(
            axes, shape, facecolor=colour, edgecolor="#404040" if closed else colour,
            linewidth=0.8, zorder=1 if closed else 2,
        )  # fmt: skip
    if names:
        _label(axes, mechanism, moved)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")
    if magnify != 1:
        title = f"displacements magnified {magnify:g} times"
        if ghost and np.any(displacements):
            title += "; dotted: at rest"
        axes.set_title(title, fontsize="medium")
    return axes


def draw_ghost(mechanism: Mechanism, axes: "Axes") -> None:
    """Dots the bodies at rest."""
    for shape, colour in shapes(mechanism, np.asarray(mechanism.rest)):
        if colour != HINGE:
            _polygon(axes, shape, fill=False, edgecolor=GHOST, linestyle=":", zorder=3)


def shapes(mechanism: Mechanism, poses: np.ndarray) -> list[tuple[np.ndarray, str]]:
    """Polygons in the world, in metres, and their colours.

    By NumPy: as operations of JAX, one by one, a frame of a film would take ten times as
    long.
    """
    size = np.ptp(np.concatenate([mechanism.rest, mechanism.at])[:, 1:], axis=0).max()
    held = set(mechanism.held)
    drawn = []
    for body, outline in enumerate(mechanism.outlines):
        colour = HELD if {3 * body, 3 * body + 1, 3 * body + 2} <= held else BODY
        if outline is not None:
            drawn.append((_placed(poses[body], outline), colour))
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    dot = _DOT * (size or 1.0) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    for hinge, (ends, outline) in enumerate(
        zip(mechanism.couplings.ends, mechanism.hinge_outlines, strict=True)
    ):
        ports = _ports(mechanism, poses, hinge)
        corners = np.zeros((1, 2)) if outline is None else np.asarray(outline)
        reach = np.array([corners[:, 0].min(), corners[:, 0].max()])
        for body, port, along in zip(ends, ports, reach, strict=True):
            if mechanism.outlines[body] is None:
                (grip,) = _placed(port, np.array([[along, 0.0]]))
                drawn.append((np.stack([poses[body][1:], grip]), BODY))
        if outline is None:
            middle = (ports[0][1:] + ports[1][1:]) / 2
            drawn.append((middle + dot, HINGE))
        else:
            drawn.append((_bent(*ports, reach, corners), HINGE))
    return drawn


def _placed(pose: np.ndarray, corners: np.ndarray | Corners) -> np.ndarray:
    cos, sin = np.cos(pose[0]), np.sin(pose[0])
    return pose[1:] + np.asarray(corners) @ np.array([[cos, sin], [-sin, cos]])


def _ports(
    mechanism: Mechanism, poses: np.ndarray, hinge: int
) -> tuple[np.ndarray, np.ndarray]:
    """The frames in which a hinge grips its bodies, in the world."""
    ends, arms = mechanism.couplings.ends[hinge], mechanism.couplings.arms[hinge]
    angle = float(mechanism.at[hinge, 0])
    ports = []
    for body, arm in zip(ends, arms, strict=True):
        turned = poses[body] - np.array([float(mechanism.rest[body, 0]), 0.0, 0.0])
        place = _placed(turned, arm[None])[0]
        ports.append(np.array([angle + turned[0], *place]))
    return ports[0], ports[1]


def _bent(
    first: np.ndarray, second: np.ndarray, reach: np.ndarray, outline: np.ndarray
) -> np.ndarray:
    """An outline whose ends are clamped to the two ports, bent as a beam between."""
    length = reach[1] - reach[0]
    ends = np.stack([reach, np.zeros(2)], axis=1)
    start, end = _placed(first, ends), _placed(second, ends)
    # Hermite's cubic: where the first end is and the last, and how they point
    a, b = start[0], end[1]
    da, db = start[1] - start[0], end[1] - end[0]
    u = (outline[:, :1] - reach[0]) / length
    middle = (
        (1 + 2 * u) * (1 - u) ** 2 * a
        + u * (1 - u) ** 2 * da
        + u**2 * (3 - 2 * u) * b
        - u**2 * (1 - u) * db
    )
    slope = 6 * u * (1 - u) * (b - a) + (1 - u) * (1 - 3 * u) * da - u * (2 - 3 * u) * db
    normal = np.stack([-slope[:, 1], slope[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return middle + outline[:, 1:] * normal


def _polygon(axes: "Axes", corners: np.ndarray, **style) -> None:
    from matplotlib.patches import Polygon

    axes.add_patch(Polygon(1e3 * corners, closed=True, **style))


def _label(axes: "Axes", mechanism: Mechanism, poses: np.ndarray) -> None:
    for name, pose, outline in zip(
        mechanism.names, poses, mechanism.outlines, strict=True
    ):
        x, y = 1e3 * (pose[1:] if outline is None else _inside(_placed(pose, outline)))
        axes.annotate(name, (x, y), ha="center", va="center", zorder=5)
    for hinge, name in enumerate(mechanism.hinge_names):
        _, x, y = 1e3 * _ports(mechanism, poses, hinge)[0]
        axes.annotate(
            name, (x, y), xytext=(0, 7), ha="center", zorder=5,
            textcoords="offset points", color="#8c3b00", fontstyle="italic",
        )  # fmt: skip


def _inside(corners: np.ndarray) -> np.ndarray:
    """A point well inside a polygon, whatever its shape: the best of a grid.

    Of points as far from the edges, that nearest the mean corner.
    """
    from matplotlib.path import Path

    columns, rows = np.linspace(corners.min(axis=0), corners.max(axis=0), 30).T
    grid = np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2)
    grid = grid[Path(corners).contains_points(grid)]
    start, end = corners, np.roll(corners, -1, axis=0)
    along = end - start
    share = np.einsum("gck,ck->gc", grid[:, None] - start, along)
    share = np.clip(share / np.sum(along**2, axis=1), 0, 1)[..., None]
    gaps = np.linalg.norm(grid[:, None] - start - share * along, axis=2).min(axis=1)
    strayed = np.linalg.norm(grid - corners.mean(axis=0), axis=1)
    return grid[np.argmax(gaps - 0.05 * strayed)]
