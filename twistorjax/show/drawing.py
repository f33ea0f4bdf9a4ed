"""A mechanism at given poses, drawn on matplotlib axes."""

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import se2
from .._types import Corners, Pose, Poses
from ..mechanism import Mechanism
from ..solve.statics import Equilibrium


if TYPE_CHECKING:
    from matplotlib.axes import Axes


BODY, HELD, HINGE, GHOST = "#b8cfe3", "#d5d5d5", "#e08214", "#8a8a8a"
_DOT = 0.012  # radius of a hinge without an outline, as a part of the mechanism's size


def draw(
    mechanism: Mechanism,
    poses: Poses | Equilibrium | None = None,
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
        poses: of its bodies, by default at rest, or an equilibrium; rad, m, m.
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
    try:
        from matplotlib import pyplot as plt
    except ImportError as error:
        raise ImportError(
            'Pictures need matplotlib: install it with `pip install "twistorjax[show]"`.'
        ) from error

    rest = np.asarray(mechanism.rest)
    displacements = np.zeros_like(rest)
    if isinstance(poses, Equilibrium):
        poses = poses.poses
    if poses is not None:
        displacements = np.asarray(mechanism._displacements(poses))
    moved = rest + magnify * displacements
    if axes is None:
        _, axes = plt.subplots(figsize=(7, 6), layout="constrained")
    if ghost and np.any(displacements):
        for shape, colour in _shapes(mechanism, rest):
            if colour != HINGE:
                _polygon(
                    axes, shape, fill=False, edgecolor=GHOST, linestyle=":", zorder=3
                )
    for shape, colour in _shapes(mechanism, moved):
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


def _shapes(mechanism: Mechanism, poses: np.ndarray) -> list[tuple[np.ndarray, str]]:
    """Polygons in the world, in metres, and their colours."""
    size = np.ptp(np.concatenate([mechanism.rest, mechanism.at])[:, 1:], axis=0).max()
    held = set(mechanism.held)
    shapes = []
    for body, outline in enumerate(mechanism.outlines):
        colour = HELD if {3 * body, 3 * body + 1, 3 * body + 2} <= held else BODY
        if outline is not None:
            shapes.append((_placed(poses[body], outline), colour))
    turn = jnp.linspace(0, 2 * jnp.pi, 24, endpoint=False)
    dot = _DOT * (size or 1.0) * jnp.stack([jnp.cos(turn), jnp.sin(turn)], axis=1)
    for name, ends, outline in zip(
        mechanism.hinge_names,
        mechanism.couplings.ends,
        mechanism.hinge_outlines,
        strict=True,
    ):
        ports = mechanism.ports(name, jnp.asarray(poses))
        reach = jnp.zeros(2)
        if outline is not None:
            reach = jnp.stack([jnp.min(outline[:, 0]), jnp.max(outline[:, 0])])
        for body, port, along in zip(ends, ports, reach, strict=True):
            if mechanism.outlines[body] is None:
                grip = se2.act(port, jnp.stack([along, jnp.zeros(())]))
                shapes.append((np.stack([poses[body][1:], np.asarray(grip)]), BODY))
        if outline is None:
            middle = (ports[0][1:] + ports[1][1:]) / 2
            shapes.append((np.asarray(middle[None] + dot), HINGE))
        else:
            shapes.append((_bent(*ports, reach, outline), HINGE))
    return shapes


def _placed(pose: np.ndarray, outline: Corners) -> np.ndarray:
    return np.asarray(jax.vmap(se2.act, (None, 0))(jnp.asarray(pose), outline))


def _bent(
    first: Pose, second: Pose, reach: Float[Array, "2"], outline: Corners
) -> np.ndarray:
    """An outline whose ends are clamped to the two ports, bent as a beam between."""
    length = reach[1] - reach[0]
    across = jnp.zeros_like(reach)
    start, end = (
        jnp.stack(
            [se2.act(port, corner) for corner in jnp.stack([reach, across], axis=1)]
        )
        for port in (first, second)
    )
    # Hermite's cubic: where the first end is and the last, and how they point
    a, b = start[0], end[1]
    da, db = start[1] - start[0], end[1] - end[0]

    def placed(corner):
        u = (corner[0] - reach[0]) / length
        middle = (
            (1 + 2 * u) * (1 - u) ** 2 * a
            + u * (1 - u) ** 2 * da
            + u**2 * (3 - 2 * u) * b
            - u**2 * (1 - u) * db
        )
        slope = (
            6 * u * (1 - u) * (b - a) + (1 - u) * (1 - 3 * u) * da - u * (2 - 3 * u) * db
        )
        normal = jnp.stack([-slope[1], slope[0]]) / jnp.linalg.norm(slope)
        return middle + corner[1] * normal

    return np.asarray(jax.vmap(placed)(outline))


def _polygon(axes: "Axes", corners: np.ndarray, **style) -> None:
    from matplotlib.patches import Polygon

    axes.add_patch(Polygon(1e3 * corners, closed=True, **style))


def _label(axes: "Axes", mechanism: Mechanism, poses: np.ndarray) -> None:
    for name, pose, outline in zip(
        mechanism.names, poses, mechanism.outlines, strict=True
    ):
        x, y = 1e3 * (pose[1:] if outline is None else _inside(_placed(pose, outline)))
        axes.annotate(name, (x, y), ha="center", va="center", zorder=5)
    for name in mechanism.hinge_names:
        port, _ = mechanism.ports(name, jnp.asarray(poses))
        _, x, y = 1e3 * np.asarray(port)
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
