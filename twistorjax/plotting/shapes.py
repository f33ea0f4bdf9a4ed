"""Where the parts of a mechanism are, as polygons in the world.

By NumPy: as operations of JAX, one by one, a frame of a film would take ten times as
long.
"""

from typing import Literal, NamedTuple

import numpy as np

from .._utils.types import Corners, Pose
from ..mechanism.mechanism import Mechanism


_DOT = 0.015  # radius of a hinge without an outline, as a part of the mechanism's size


class Shape(NamedTuple):
    """A part of a mechanism.

    Args:
        kind: what it is: a body that can move, one that is held altogether, an arm that
            leads from the origin of a body without an outline to one of its hinges; a
            hinge with an outline, or without: a spring.
        corners: in the world, a row each; m.
        row: of the body or hinge.
    """

    kind: Literal["body", "held", "arm", "neck", "spring"]
    corners: np.ndarray
    row: int


def size_of(mechanism: Mechanism) -> float:
    """The longer side of the box around it at rest; m."""
    places = [np.concatenate([mechanism.reference, mechanism.at])[:, 1:]]
    for pose, outline in zip(
        np.asarray(mechanism.reference), mechanism.outlines, strict=True
    ):
        if outline is not None:
            places.append(placed(pose, outline))
    return float(np.ptp(np.concatenate(places), axis=0).max()) or 1.0


def shapes(mechanism: Mechanism, poses: np.ndarray) -> list[Shape]:
    """The parts of a mechanism, bodies first.

    Args:
        mechanism: what is drawn.
        poses: of its bodies; rad, m, m.
    """
    fixed_dofs = set(mechanism.fixed)
    bodies, arms, hinges = [], [], []
    for body, outline in enumerate(mechanism.outlines):
        fixed = {3 * body, 3 * body + 1, 3 * body + 2} <= fixed_dofs
        if outline is not None:
            corners = placed(poses[body], outline)
            bodies.append(Shape("held" if fixed else "body", corners, body))
    coil = _DOT * size_of(mechanism) * _coil()
    for hinge, (ends, outline) in enumerate(
        zip(mechanism.hinge_assembly.ends, mechanism.hinge_outlines, strict=True)
    ):
        both = ports(mechanism, poses, hinge)
        corners = np.zeros((1, 2)) if outline is None else np.asarray(outline)
        reach = np.array([corners[:, 0].min(), corners[:, 0].max()])
        for body, port, along in zip(ends, both, reach, strict=True):
            if mechanism.outlines[body] is None:
                (grip,) = placed(port, np.array([[along, 0.0]]))
                arms.append(Shape("arm", np.stack([poses[body][1:], grip]), body))
        if outline is None:
            # wound about the one port, and from there to the other
            way = np.linspace(0, 1, len(coil))[:, None]
            middle = (1 - way) * both[0][1:] + way * both[1][1:]
            hinges.append(Shape("spring", middle + coil, hinge))
        else:
            hinges.append(Shape("neck", _bent(*both, reach, corners), hinge))
    return bodies + arms + hinges


def placed(pose: np.ndarray, corners: np.ndarray | Corners) -> np.ndarray:
    """Points of a frame, in the world; m."""
    cos, sin = np.cos(pose[0]), np.sin(pose[0])
    return pose[1:] + np.asarray(corners) @ np.array([[cos, sin], [-sin, cos]])


def ports(
    mechanism: Mechanism, poses: np.ndarray, hinge: int
) -> tuple[np.ndarray, np.ndarray]:
    """The frames in which a hinge grips its bodies, in the world; rad, m, m."""
    ends, at = mechanism.hinge_assembly.ends[hinge], np.asarray(mechanism.at)[hinge]
    first, second = (carried(mechanism, poses, body, at) for body in ends)
    return first, second


def carried(
    mechanism: Mechanism, poses: np.ndarray, body: int, frame: np.ndarray | Pose
) -> np.ndarray:
    """Where a body has carried a frame that it has at rest; rad, m, m."""
    reference, frame = np.asarray(mechanism.reference)[body], np.asarray(frame)
    turned = poses[body] - np.array([reference[0], 0.0, 0.0])
    (place,) = placed(turned, (frame[1:] - reference[1:])[None])
    return np.array([frame[0] + turned[0], *place])


def _coil() -> np.ndarray:
    """A spiral of two turns from the origin, its last radius 1."""
    turn = np.linspace(0, 4 * np.pi, 49)
    return turn[:, None] / turn[-1] * np.stack([np.cos(turn), np.sin(turn)], axis=1)


def _bent(
    first: np.ndarray, second: np.ndarray, reach: np.ndarray, outline: np.ndarray
) -> np.ndarray:
    """An outline whose ends are clamped to the two ports, bent as a beam between."""
    length = reach[1] - reach[0]
    ends = np.stack([reach, np.zeros(2)], axis=1)
    start, end = placed(first, ends), placed(second, ends)
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
