"""Marks on a drawing: frames, forces and moments, pins and sliders."""

from collections.abc import Sequence
from typing import NamedTuple, TYPE_CHECKING

import numpy as np

from ..mechanism.constraints import AbstractConstraint, Pin, Slider
from ..mechanism.loads import Load, loaded_bodies
from ..mechanism.mechanism import Mechanism
from .figure_style import BLACK, BLUE, BROWN, prefixed_unit
from .shapes import attached_frame, hinge_frames, mechanism_size, to_world


if TYPE_CHECKING:
    from matplotlib.axes import Axes


# Lengths relative to the size of the mechanism.
_LONGEST_FORCE, _SHORTEST_FORCE, _MOMENT_RADIUS, _FRAME = 0.2, 0.06, 0.06, 0.07
_NEGLIGIBLE = 1e-3  # relative to the largest load effect

# Style of the labels of forces and moments.
_VALUE_STYLE = {
    "fontsize": "small",
    "zorder": 7,
    "bbox": {"boxstyle": "square,pad=0.1", "facecolor": "white", "alpha": 0.7, "lw": 0},
}


class Wrenches(NamedTuple):
    """Forces and moments that are drawn in one color."""

    points: np.ndarray  # Points of application in world coordinates, one in each row; m
    wrenches: np.ndarray  # Moment and force at each point, in world axes; N m, N, N
    color: str  # Color of the arrows and their labels


def mark_frames(
    axes: "Axes", mechanism: Mechanism, poses: np.ndarray, unit: float
) -> None:
    """Draw the frames of the bodies at some poses, and both frames of each hinge."""
    size = mechanism_size(mechanism)
    for pose in poses:
        _mark_frame(axes, pose, _FRAME * size, unit, BLUE)
    for hinge in range(len(mechanism.hinge_names)):
        for frame in hinge_frames(mechanism, poses, hinge):
            _mark_frame(axes, frame, 0.6 * _FRAME * size, unit, BROWN)


def _mark_frame(
    axes: "Axes", pose: np.ndarray, length: float, unit: float, color: str
) -> None:
    """Draw the axes of a frame from its pose (rad, m, m) and their length (m)."""
    corners = unit * to_world(pose, length * np.array([[0, 0], [1, 0], [0, 1.0]]))
    for tip, width in ((corners[1], 1.6), (corners[2], 0.8)):  # Axis 1 is thicker.
        _arrow(axes, corners[0], tip, color, width, 8)


def wrenches_of_loads(
    mechanism: Mechanism, poses: np.ndarray, loads: Sequence[Load], color: str
) -> Wrenches:
    """Compute the wrenches of loads in world axes, at the points of application."""
    bodies = loaded_bodies(mechanism, loads)
    points, wrenches = np.zeros((len(bodies), 2)), np.zeros((len(bodies), 3))
    for row, (body, load) in enumerate(zip(bodies, loads, strict=True)):
        moment, *force = np.asarray(load.wrench)
        rotation = np.array([poses[body][0] if load.follower else 0.0, 0.0, 0.0])
        points[row] = to_world(poses[body], np.asarray(load.at)[None])[0]
        wrenches[row] = [moment, *to_world(rotation, np.array([force]))[0]]
    return Wrenches(points, wrenches, color)


def mark_wrenches(
    axes: "Axes",
    groups: Sequence[Wrenches],
    size: float,
    unit: float,
    *,
    hinge_forces: np.ndarray | None = None,
) -> None:
    """Draw forces as straight arrows and moments as curved arrows, with their values.

    The effect of a wrench is its moment, or its force times the size (m) of the
    mechanism. The length of a straight arrow is proportional to the effect of the force,
    down to a shortest length. A force or moment is left out if its effect is below a
    thousandth of the largest effect on the mechanism, because it may consist of rounding
    errors. The forces of hinges on bodies also count as effects.
    """
    effects = [_effects(group.wrenches, size) for group in groups]
    longest = np.max(np.concatenate(effects), initial=0.0)
    largest = longest
    if hinge_forces is not None:
        largest = np.max(_effects(hinge_forces, size), initial=longest)
    for group, group_effects in zip(groups, effects, strict=True):
        for point, (moment, *force), (moment_effect, force_effect) in zip(
            unit * group.points, group.wrenches, group_effects, strict=True
        ):
            arc_direction = np.array([1.0, 0.0])
            if force_effect > _NEGLIGIBLE * largest:
                length = max(_SHORTEST_FORCE, _LONGEST_FORCE * force_effect / longest)
                _mark_force(axes, point, force, unit * size * length, group.color)
                arc_direction = -np.array(force)
            if moment_effect > _NEGLIGIBLE * largest:
                radius = unit * size * _MOMENT_RADIUS
                _mark_moment(axes, point, moment, radius, arc_direction, group.color)


def _effects(wrenches: np.ndarray, size: float) -> np.ndarray:
    """Return moment, and force times the size (m) of the mechanism, as columns; N m."""
    forces = np.linalg.norm(wrenches[:, 1:], axis=1)
    return np.stack([np.abs(wrenches[:, 0]), size * forces], axis=1)


def _mark_force(
    axes: "Axes", point: np.ndarray, force: Sequence[float], length: float, color: str
) -> None:
    """Draw a force (N) as an arrow; point and length are in units of the axes."""
    from .labels import Labels

    magnitude = float(np.linalg.norm(force))
    direction = np.array(force) / magnitude
    tip = point + length * direction
    _arrow(axes, point, tip, color, 2.0, 14)
    factor, name = prefixed_unit("N", magnitude)
    text = f"{factor * magnitude:.3g} {name}"
    Labels.of(axes).add(text, tip, direction, color=color, **_VALUE_STYLE)


def _mark_moment(
    axes: "Axes",
    point: np.ndarray,
    moment: float,
    radius: float,
    direction: np.ndarray,
    color: str,
) -> None:
    """Draw a moment (N m) as an arc of 120 degrees about a point.

    Point and radius are in units of the axes. The direction is that from the point to the
    middle of the arc.
    """
    from .labels import Labels

    direction = direction / np.linalg.norm(direction)
    middle, sense = np.arctan2(direction[1], direction[0]), np.sign(moment)
    start, end = (
        point + radius * np.array([np.cos(angle), np.sin(angle)])
        for angle in middle + sense * np.radians([-60.0, 60.0])
    )
    _arrow(axes, start, end, color, 2.0, 12, f"arc3,rad={0.55 * sense}")
    factor, name = prefixed_unit("N m", abs(moment))
    text = f"{factor * abs(moment):.3g} {name}"
    anchor = point + 1.1 * radius * direction
    Labels.of(axes).add(text, anchor, direction, color=color, **_VALUE_STYLE)


def mark_constraints(
    axes: "Axes",
    mechanism: Mechanism,
    poses: np.ndarray,
    constraints: Sequence[AbstractConstraint],
    unit: float,
) -> None:
    """Draw pins as rings and sliders as blocks on rails.

    Other constraints are not drawn, because they have no position.
    """
    from matplotlib.patches import Circle, Polygon

    size = unit * mechanism_size(mechanism)
    style = {"facecolor": "white", "edgecolor": BLACK, "linewidth": 1.2, "zorder": 4}
    for constraint in constraints:
        bodies = [mechanism.index(name) for name in constraint.bodies]
        if isinstance(constraint, Pin):
            frame = np.concatenate([[0.0], np.asarray(constraint.at)])
            x, y = unit * attached_frame(mechanism, poses, bodies[1], frame)[1:]
            axes.add_patch(Circle((x, y), 0.013 * size, **style))
        elif isinstance(constraint, Slider):
            guide, block = (
                attached_frame(mechanism, poses, body, constraint.at) * [1, unit, unit]
                for body in bodies
            )
            rail = to_world(guide, size * np.array([[-0.12, 0], [0.12, 0.0]]))
            axes.plot(*rail.T, color=BLACK, linewidth=3, zorder=3.5)
            corners = np.array([[-1, -0.6], [1, -0.6], [1, 0.6], [-1, 0.6]])
            corners = to_world(block, 0.03 * size * corners)
            axes.add_patch(Polygon(corners, closed=True, **style))


def _arrow(
    axes: "Axes",
    start: np.ndarray,
    end: np.ndarray,
    color: str,
    width: float,
    head: int,
    connection: str = "arc3",
) -> None:
    """Draw an arrow from `start` to `end` (units of the axes).

    The width of the line and the size of the head are in points. `connection` is a
    connection style of matplotlib, by default a straight line.
    """
    from matplotlib.patches import FancyArrowPatch

    (x0, y0), (x1, y1) = start, end
    axes.add_patch(
        FancyArrowPatch(
            (x0, y0), (x1, y1), arrowstyle="-|>", mutation_scale=head, color=color,
            linewidth=width, shrinkA=0, shrinkB=0, connectionstyle=connection, zorder=6,
        )
    )  # fmt: skip
    axes.update_datalim([(x0, y0), (x1, y1)])
