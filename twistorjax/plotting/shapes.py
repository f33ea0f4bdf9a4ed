"""Outlines of the parts of a mechanism, as polygons in world coordinates.

This module uses NumPy, because single operations of JAX would make a frame of an
animation ten times slower.
"""

from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._utils.stacking import PerPart
from .._utils.types import Corners, Pose
from ..energies.axial_spring import AxialSpring
from ..energies.contact import Stop
from ..energies.quadratic import Quadratic
from ..energies.stress_model import stress_model
from ..flexures.condensed import drawn_displacements
from ..flexures.leaf import leaf_outline
from ..mechanism.mechanism import Mechanism
from ..mechanism.sub_mechanism import SubMechanism


# Largest radius of a spring, relative to the size of the mechanism, and to the distances
# from the origins of bodies to their hinges
_SPRING_RADIUS, _SPRING_SHARE = 0.015, 0.15
_WINDINGS = 8  # of the zigzag line of an axial spring
_SLENDER = 2.0  # smallest ratio of length and thickness of a quadratic energy's beam


class Shape(NamedTuple):
    """Outline of a part of a mechanism."""

    # "body" is a body with an outline, and "fixed" is one whose three coordinates are
    # fixed. "line" is a line from the origin of a body without an outline to one of its
    # hinges. "hinge" is a hinge with an outline, and "spring" is a hinge without one: a
    # zigzag line between the ends of an `AxialSpring`, the two faces of a `Stop`, and
    # otherwise a spiral.
    kind: Literal["body", "fixed", "line", "hinge", "spring"]
    corners: np.ndarray  # Corners in world coordinates; m
    row: int  # Index of the body or hinge in the mechanism

    @property
    def part(self) -> tuple[str, int]:
        """Whether it is a "body" or a "hinge", and its index."""
        is_hinge = self.kind in ("hinge", "spring")
        return "hinge" if is_hinge else "body", self.row


def mechanism_size(mechanism: Mechanism) -> float:
    """Compute the longer side of the box around origins, hinges, and outlines; m.

    It is 1 m if all of them coincide. The mechanism is in its reference configuration.
    """
    points = [np.concatenate([mechanism.reference, mechanism.at])[:, 1:]]
    for pose, outline in zip(
        np.asarray(mechanism.reference), mechanism.outlines.on_host(), strict=True
    ):
        if outline is not None:
            points.append(to_world(pose, outline))
    for pose, outline in zip(
        np.asarray(mechanism.at), mechanism.hinge_outlines.on_host(), strict=True
    ):
        if isinstance(outline, SubMechanism):
            part = with_flexure_outlines(outline.mechanism)
            inner = shapes(part, np.asarray(part.reference))
            corners = np.concatenate([shape.corners for shape in inner])
            points.append(to_world(pose, corners))
    halves = _half_lengths(mechanism)
    for half, pose in zip(halves, np.asarray(mechanism.at), strict=True):
        points.append(to_world(pose, np.array([[-half, 0.0], [half, 0.0]])))
    return float(np.ptp(np.concatenate(points), axis=0).max()) or 1.0


def with_flexure_outlines(mechanism: Mechanism) -> Mechanism:
    """Give an outline to the flexures without one.

    It is the contour of a flexure that was created from dimensions, and the beam with the
    stiffness of another quadratic energy, unless it is longer than the mechanism.
    """
    outlines = list(mechanism.hinge_outlines.on_host())
    for group in mechanism.hinge_assembly.groups:
        missing = [k for k, row in enumerate(group.members) if outlines[row] is None]
        made = {}
        if stress_model(group.energy) is not None:
            for member in missing:
                model = stress_model(group.of_member(member)[0])
                assert model is not None
                made[member] = model.outline()
        elif missing and isinstance(group.energy, Quadratic):
            # Many hinges of a lattice have few kinds of stiffness.
            shape, size = (len(group.members), 3, 3), mechanism_size(mechanism)
            stiffness = np.broadcast_to(np.asarray(group.energy.stiffness), shape)
            kinds, kind_of = np.unique(stiffness, axis=0, return_inverse=True)
            of_kinds = [_beam_outline(kind, size) for kind in kinds]
            made = {member: of_kinds[kind_of.flat[member]] for member in missing}
        for member, outline in made.items():
            outlines[group.members[member]] = outline
    return eqx.tree_at(
        lambda new: new.hinge_outlines, mechanism, PerPart.of_each(outlines)
    )


def _beam_outline(stiffness: np.ndarray, longest: float) -> Corners | None:
    """Return the outline of the slender beam with a diagonal stiffness, if there is one.

    It is not longer than `longest`; m.
    """
    diagonal = np.diagonal(stiffness)
    if np.any(diagonal <= 0) or np.any(stiffness != np.diag(diagonal)):
        return None
    # A beam has the stiffness E I / L, E A / L, 12 E I / L^3, and I / A is h^2 / 12.
    thickness, length = np.sqrt(12 * diagonal[0] / diagonal[1:])
    if not _SLENDER * thickness <= length <= longest:
        return None
    return leaf_outline(length=length, thickness=thickness)


def shapes(
    mechanism: Mechanism, poses: np.ndarray, magnify: float | int = 1.0
) -> list[Shape]:
    """Compute outlines: of bodies, then lines of bodies without one, then of hinges.

    The gaps of stops are magnified, as are the displacements to the given poses, so that
    the faces of a closed stop meet.
    """
    bodies, lines, hinges = [], [], []
    outlines, halves = mechanism.outlines.on_host(), _half_lengths(mechanism)
    for body, outline in enumerate(outlines):
        fixed = mechanism.is_fixed(body)
        if outline is not None:
            corners = to_world(poses[body], outline)
            bodies.append(Shape("fixed" if fixed else "body", corners, body))
    arms = np.linalg.norm(np.asarray(mechanism.hinge_assembly.arms), axis=-1)
    radius = _SPRING_RADIUS * mechanism_size(mechanism)
    radius = min(radius, _SPRING_SHARE * float(np.median(arms)) or radius)
    spiral, stops = radius * _unit_spiral(), _stops(mechanism)
    for hinge, (ends, outline) in enumerate(
        zip(
            mechanism.hinge_assembly.ends,
            mechanism.hinge_outlines.on_host(),
            strict=True,
        )
    ):
        frames = hinge_frames(mechanism, poses, hinge)
        if isinstance(outline, SubMechanism):
            parts, attached = _parts(outline, frames, hinge)
            hinges.extend(parts)
            for body, tips in zip(ends, attached, strict=True):
                if outlines[body] is None:
                    arm = np.stack([poses[body][1:], np.mean(tips, axis=0)])
                    lines += [Shape("line", tips, body), Shape("line", arm, body)]
            continue
        half = halves[hinge]
        ends_on_axis = np.array([[-half, 0.0], [half, 0.0]])
        corners = ends_on_axis if outline is None else np.asarray(outline)
        extent = np.array([corners[:, 0].min(), corners[:, 0].max()])
        for body, frame, end in zip(ends, frames, extent, strict=True):
            if outlines[body] is None:
                (tip,) = to_world(frame, np.array([[end, _axis_at(corners, end)]]))
                lines.append(Shape("line", np.stack([poses[body][1:], tip]), body))
        if outline is None and hinge in stops:
            pairs = zip(frames, _faces(stops[hinge], magnify, radius), strict=True)
            faces = [to_world(frame, face) for frame, face in pairs]
            hinges += [Shape("spring", face, hinge) for face in faces]
        elif outline is None and half > 0:
            first, second = (
                to_world(frame, end[None])[0]
                for frame, end in zip(frames, ends_on_axis, strict=True)
            )
            hinges.append(Shape("spring", _zigzag(first, second, radius), hinge))
        elif outline is None:
            # The spiral starts at the first frame and ends at the second one.
            share = np.linspace(0, 1, len(spiral))[:, None]
            center = (1 - share) * frames[0][1:] + share * frames[1][1:]
            hinges.append(Shape("spring", center + spiral, hinge))
        else:
            hinges.append(Shape("hinge", _deform(*frames, extent, corners), hinge))
    return bodies + lines + hinges


def _parts(
    part: SubMechanism, frames: tuple[np.ndarray, np.ndarray], hinge: int
) -> tuple[list[Shape], tuple[np.ndarray, np.ndarray]]:
    """Return the outlines of a sub-mechanism between two frames (rad, m, m).

    They have the row of the hinge. Bodies A and B are drawn with the mechanism; the ends
    of the leaves on each of them are returned as well, in the order of their angles.
    """
    mechanism = with_flexure_outlines(part.mechanism)
    pose = np.array([frames[1][0] - frames[0][0], 0.0, 0.0])
    cos, sin = np.cos(frames[0][0]), np.sin(frames[0][0])
    pose[1:] = np.array([[cos, sin], [-sin, cos]]) @ (frames[1][1:] - frames[0][1:])
    displacements = np.asarray(drawn_displacements(part, jnp.asarray(pose)))
    rows = mechanism.index(part.first), mechanism.index(part.second)
    inner = [
        shape._replace(corners=to_world(frames[0], shape.corners))
        for shape in shapes(mechanism, np.asarray(mechanism.reference) + displacements)
    ]
    attached = []
    for row, frame in zip(rows, frames, strict=True):
        ends = [s.corners[-1] for s in inner if s.kind == "line" and s.row == row]
        tips = np.array(ends)
        arms = tips - np.mean(tips, axis=0)
        directions = np.arctan2(arms[:, 1], arms[:, 0]) - frame[0]
        attached.append(tips[np.argsort(np.mod(directions, 2 * np.pi))])
    parts = [
        shape._replace(row=hinge)
        for shape in inner
        if shape.kind != "line" or shape.row not in rows
    ]
    return parts, (attached[0], attached[1])


def to_world(pose: np.ndarray, points: np.ndarray | Corners) -> np.ndarray:
    """Transform points (m), one in each row, from a frame to world coordinates."""
    cos, sin = np.cos(pose[0]), np.sin(pose[0])
    return pose[1:] + np.asarray(points) @ np.array([[cos, sin], [-sin, cos]])


def hinge_frames(
    mechanism: Mechanism, poses: np.ndarray, hinge: int
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the poses of the frames of a hinge on its first and on its second body."""
    ends, at = mechanism.hinge_assembly.ends[hinge], np.asarray(mechanism.at)[hinge]
    first, second = (attached_frame(mechanism, poses, body, at) for body in ends)
    return first, second


def attached_frame(
    mechanism: Mechanism, poses: np.ndarray, body: int, frame: np.ndarray | Pose
) -> np.ndarray:
    """Compute the pose of a frame that is attached to a body, from its reference pose."""
    reference, frame = np.asarray(mechanism.reference)[body], np.asarray(frame)
    motion = poses[body] - np.array([reference[0], 0.0, 0.0])
    (origin,) = to_world(motion, (frame[1:] - reference[1:])[None])
    return np.array([frame[0] + motion[0], *origin])


def _axis_at(corners: np.ndarray, end: float) -> float:
    """Return the coordinate along axis 2 at an end of an outline; m.

    It is not zero for a curved leaf.
    """
    near = np.abs(corners[:, 0] - end) <= 0.02 * np.ptp(corners[:, 0])
    return float(np.mean(corners[near, 1]))


def _half_lengths(mechanism: Mechanism) -> np.ndarray:
    """Return half of the lengths of axial springs without an outline; m.

    They are zero for other hinges.
    """
    hinges = mechanism.hinge_assembly
    halves = np.zeros(len(hinges.ends))
    for group in hinges.groups:
        if isinstance(group.energy, AxialSpring):
            halves[list(group.members)] = np.asarray(group.energy.length) / 2
    has_outline = ~mechanism.hinge_outlines.is_none()
    return np.where(has_outline | ~hinges.sums.is_none(), 0.0, halves)


def _stops(mechanism: Mechanism) -> dict[int, Stop]:
    """Return the hinges that are a stop and nothing else, by their indices."""
    return {
        row: energy
        for group in mechanism.hinge_assembly.groups
        if isinstance(group.energy, Stop)
        for member, row in enumerate(group.members)
        if isinstance(energy := group.of_member(member)[0], Stop)
        and mechanism.hinge_assembly.sums[row] is None
    }


def _faces(stop: Stop, magnify: float, radius: float) -> list[np.ndarray]:
    """Return the faces of a stop in the frames on body A and on body B; m.

    They meet where the magnified gap is closed.
    """
    gap = magnify * float(stop.gap) * (1.0 if stop.direction[0] == "+" else -1.0)
    if stop.direction[1:] == "angle":
        directions = np.stack([np.cos([gap, 0.0]), np.sin([gap, 0.0])], axis=1)
        return [3 * radius * np.outer([0.0, 1.0], tip) for tip in directions]
    normal, face = np.eye(2) if stop.direction[1:] == "x" else np.eye(2)[::-1]
    return [place * normal + np.outer([-radius, radius], face) for place in (gap, 0.0)]


def _zigzag(first: np.ndarray, second: np.ndarray, radius: float) -> np.ndarray:
    """Return a zigzag line between two points, straight near both of them; m."""
    side = second - first
    across = np.array([-side[1], side[0]]) / (np.hypot(*side) or 1.0)
    along = np.concatenate([[0.0], np.linspace(0.2, 0.8, 2 * _WINDINGS + 1), [1.0]])
    height = np.zeros(len(along))
    height[2:-2] = np.tile([1.0, -1.0], _WINDINGS)[: len(height) - 4]
    return first + along[:, None] * side + radius * height[:, None] * across


def _unit_spiral() -> np.ndarray:
    """Compute a spiral of two turns that starts at the origin and ends at radius 1."""
    angle = np.linspace(0, 4 * np.pi, 49)
    return angle[:, None] / angle[-1] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def cubic(
    u: np.ndarray,
    start: np.ndarray | float,
    start_slope: np.ndarray | float,
    end: np.ndarray | float,
    end_slope: np.ndarray | float,
) -> np.ndarray:
    """Evaluate the cubic polynomial of Hermite between 0 and 1."""
    return (
        (1 + 2 * u) * (1 - u) ** 2 * start
        + u * (1 - u) ** 2 * start_slope
        + u**2 * (3 - 2 * u) * end
        - u**2 * (1 - u) * end_slope
    )


def center_line_point(
    first: np.ndarray, second: np.ndarray, outline: np.ndarray, share: float
) -> np.ndarray:
    """Return the point at a share of the length of a hinge between two frames; m."""
    extent = np.array([outline[:, 0].min(), outline[:, 0].max()])
    along = extent[0] + share * (extent[1] - extent[0])
    return _deform(first, second, extent, np.array([[along, 0.0]]))[0]


def _deform(
    first: np.ndarray, second: np.ndarray, extent: np.ndarray, outline: np.ndarray
) -> np.ndarray:
    """Deform the outline of a hinge along a cubic center line.

    The center line is the cubic Hermite polynomial whose ends have the positions and the
    directions that the poses of the two frames (rad, m, m) prescribe. The outline is that
    in the frame of the hinge (m). `extent` is its smallest and largest coordinate along
    axis 1; m.
    """
    length = extent[1] - extent[0]
    ends = np.stack([extent, np.zeros(2)], axis=1)
    start, end = to_world(first, ends), to_world(second, ends)
    a, b = start[0], end[1]
    da, db = start[1] - start[0], end[1] - end[0]
    u = (outline[:, :1] - extent[0]) / length
    center = cubic(u, a, da, b, db)
    slope = 6 * u * (1 - u) * (b - a) + (1 - u) * (1 - 3 * u) * da - u * (2 - 3 * u) * db
    normal = np.stack([-slope[:, 1], slope[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return center + outline[:, 1:] * normal
