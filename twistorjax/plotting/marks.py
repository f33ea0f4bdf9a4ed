"""What is marked on a drawing: frames, forces and moments, pins and sliders."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..mechanism.constraints import AbstractConstraint, Pin, Slider
from ..mechanism.loads import Load, loaded_bodies
from ..mechanism.mechanism import Mechanism
from .canvas import BLUE, GREEN, ORANGE, readable, RED
from .shapes import carried, placed, ports, size_of


if TYPE_CHECKING:
    from matplotlib.axes import Axes


# as parts of the mechanism's size
_LONGEST, _SHORTEST, _ROUND, _FRAME = 0.2, 0.06, 0.06, 0.07
_LEAST = 1e-3  # of the largest: smaller forces and moments are left out


def mark_frames(
    axes: "Axes", mechanism: Mechanism, poses: np.ndarray, unit: float
) -> None:
    """Draws the frames of the bodies, and those in which hinges grip them.

    Args:
        axes: on which to draw.
        mechanism: whose frames they are.
        poses: of its bodies; rad, m, m.
        unit: how many of the axes' units a metre is.
    """
    size = size_of(mechanism)
    for pose in poses:
        _frame(axes, pose, _FRAME * size, unit, BLUE)
    for hinge in range(len(mechanism.hinge_names)):
        for port in ports(mechanism, poses, hinge):
            _frame(axes, port, 0.6 * _FRAME * size, unit, ORANGE)


def _frame(
    axes: "Axes", pose: np.ndarray, length: float, unit: float, color: str
) -> None:
    corners = unit * placed(pose, length * np.array([[0, 0], [1, 0], [0, 1.0]]))
    for tip, wide in ((corners[1], 1.6), (corners[2], 0.8)):  # axis 1 is the thicker
        _arrow(axes, corners[0], tip, color, wide, 8)


def mark_loads(
    axes: "Axes",
    mechanism: Mechanism,
    poses: np.ndarray,
    loads: Sequence[Load],
    unit: float,
) -> None:
    """Draws loads as arrows from where they act, with their sizes.

    Args:
        axes: on which to draw.
        mechanism: that they load.
        poses: of its bodies; rad, m, m.
        loads: forces and moments.
        unit: how many of the axes' units a metre is.
    """
    places, wrenches = [], []
    for body, load in zip(loaded_bodies(mechanism, loads), loads, strict=True):
        moment, *force = np.asarray(load.wrench)
        turned = np.array([poses[body][0] if load.follower else 0.0, 0.0, 0.0])
        places.append(placed(poses[body], np.asarray(load.at)[None])[0])
        wrenches.append([moment, *placed(turned, np.array([force]))[0]])
    _mark(axes, np.array(places), np.array(wrenches), RED, size_of(mechanism), unit)


def mark_reactions(
    axes: "Axes",
    mechanism: Mechanism,
    poses: np.ndarray,
    reactions: np.ndarray,
    unit: float,
) -> None:
    """Draws what bodies receive from outside where they are held or driven.

    Args:
        axes: on which to draw.
        mechanism: that is held.
        poses: of its bodies; rad, m, m.
        reactions: about each body's origin; N m, N, N.
        unit: how many of the axes' units a metre is.
    """
    _mark(axes, poses[:, 1:], reactions, GREEN, size_of(mechanism), unit)


def _mark(
    axes: "Axes",
    places: np.ndarray,
    wrenches: np.ndarray,
    color: str,
    size: float,
    unit: float,
) -> None:
    """Arrows as long as forces are large, and turning ones for moments, behind them."""
    if not len(places):
        return
    forces = np.linalg.norm(wrenches[:, 1:], axis=1)
    moments = np.abs(wrenches[:, 0])
    # as far as they can be told from nothing
    shown = forces > _LEAST * forces.max()
    turning = moments > _LEAST * max(moments.max(), size * forces.max())
    for k, place in enumerate(unit * places):
        away = np.array([1.0, 0.0])
        if shown[k]:
            along = wrenches[k, 1:] / forces[k]
            part = max(_SHORTEST, _LONGEST * forces[k] / forces.max())
            tip, away = place + unit * size * part * along, -along
            _arrow(axes, place, tip, color, 2.0, 14)
            factor, name = readable("N", forces[k])
            _tell(axes, tip, f"{factor * forces[k]:.3g} {name}", color, along)
        if turning[k]:
            radius, way = unit * size * _ROUND, np.sign(wrenches[k, 0])
            middle = np.arctan2(away[1], away[0])
            start, end = (
                place + radius * np.array([np.cos(angle), np.sin(angle)])
                for angle in middle + way * np.radians([-60.0, 60.0])
            )
            _arrow(axes, start, end, color, 2.0, 12, f"arc3,rad={0.55 * way}")
            factor, name = readable("N m", moments[k])
            text = f"{factor * moments[k]:.3g} {name}"
            _tell(axes, place + 1.1 * radius * away, text, color, away)


def mark_constraints(
    axes: "Axes",
    mechanism: Mechanism,
    poses: np.ndarray,
    constraints: Sequence[AbstractConstraint],
    unit: float,
) -> None:
    """Draws pins as rings, sliders as blocks on rails; other constraints have no place.

    Args:
        axes: on which to draw.
        mechanism: whose bodies they join.
        poses: of its bodies; rad, m, m.
        constraints: on them.
        unit: how many of the axes' units a metre is.
    """
    from matplotlib.patches import Circle, Polygon

    size = unit * size_of(mechanism)
    style = {"facecolor": "white", "edgecolor": "#202020", "linewidth": 1.2, "zorder": 4}
    for constraint in constraints:
        bodies = [mechanism.index(name) for name in constraint.bodies]
        if isinstance(constraint, Pin):
            frame = np.concatenate([[0.0], np.asarray(constraint.at)])
            x, y = unit * carried(mechanism, poses, bodies[1], frame)[1:]
            axes.add_patch(Circle((x, y), 0.013 * size, **style))
        elif isinstance(constraint, Slider):
            guide, block = (
                carried(mechanism, poses, body, constraint.at) * [1, unit, unit]
                for body in bodies
            )
            rail = placed(guide, size * np.array([[-0.12, 0], [0.12, 0.0]]))
            axes.plot(*rail.T, color="#202020", linewidth=3, zorder=3.5)
            corners = np.array([[-1, -0.6], [1, -0.6], [1, 0.6], [-1, 0.6]])
            corners = placed(block, 0.03 * size * corners)
            axes.add_patch(Polygon(corners, closed=True, **style))


def _arrow(
    axes: "Axes",
    start: np.ndarray,
    end: np.ndarray,
    color: str,
    wide: float,
    head: int,
    bend: str = "arc3",
) -> None:
    from matplotlib.patches import FancyArrowPatch

    (x0, y0), (x1, y1) = start, end
    axes.add_patch(
        FancyArrowPatch(
            (x0, y0), (x1, y1), arrowstyle="-|>", mutation_scale=head, color=color,
            linewidth=wide, shrinkA=0, shrinkB=0, connectionstyle=bend, zorder=6,
        )
    )  # fmt: skip
    axes.update_datalim([(x0, y0), (x1, y1)])


def _tell(
    axes: "Axes", place: np.ndarray, text: str, color: str, along: np.ndarray
) -> None:
    """A number beyond the tip of an arrow."""
    dx, dy = 5 * along / np.linalg.norm(along)
    sides = "left" if dx > 2 else "right" if dx < -2 else "center"
    heights = "bottom" if dy > 2 else "top" if dy < -2 else "center"
    axes.annotate(
        text, tuple(place), xytext=(dx, dy), textcoords="offset points", color=color,
        ha=sides, va=heights, zorder=7, fontsize="small",
        bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "alpha": 0.7, "lw": 0},
    )  # fmt: skip
