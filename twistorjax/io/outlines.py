"""SVG and DXF files with the outline of a mechanism, for cutting and for drawing."""

import math
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .._utils.stacking import PerPart
from .._utils.types import PosesLike
from .._utils.validation import require_package, require_simple_polygon
from ..mechanism.hinge import AbstractOutline
from ..mechanism.mechanism import Mechanism
from ..plotting.figure_style import FILLS, RED
from ..plotting.shapes import Shape, shapes, with_flexure_outlines


_MM = 1e3
# Gaps between bodies and hinges up to twice this width are closed: the width in mm, and
# the largest ratio to the mean thickness of a hinge
_GAP, _GAP_RATIO = 1e-4, 1 / 500
_MARGIN = 1.0  # of an SVG; mm
_SMALLEST, _LARGEST = 1e-9, 1e6  # sizes that files in millimeters can hold; m
# Corners are written as an arc if they are on one circle, up to a distance over the
# radius, if the angles between them are small, and if their number and the angle of the
# arc are not too small. Then a polygon, or part of an ellipse, is not taken for an arc.
_ARC_ERROR, _LARGEST_TURN = 1e-9, 0.06  # -, rad
_FEWEST_CHORDS, _SMALLEST_ARC = 6, 0.25  # -, rad
_FINE_TURN = 0.005  # of the chords of an arc that is deformed with its hinge; rad
_STYLES = {
    "cut": {"stroke": RED, "stroke-width": "0.1", "fill": "none"},
    **{kind: {"fill": color} for kind, color in FILLS.items()},
}

# Rows (x, y, bulge) of a closed line. The bulge is the tangent of a quarter of the angle
# of the arc from a point to the next one, zero for a straight edge.
Line = Float[np.ndarray, "_ 3"]


def save_outline(
    mechanism: Mechanism, path: str | Path, poses: PosesLike | None = None
) -> None:
    """Write the outline of a mechanism to a DXF or SVG file, in millimeters.

    The outline to be cut is that of the union of all bodies and hinges, so that parts
    that touch form one piece. In a DXF file it lies on the layer `cut`, and the separate
    outlines of the parts lie on the layers `body`, `fixed` and `hinge`. An SVG file has
    the groups `cut` and `parts`.

    Corners on one circle that follow each other within 3.4 degrees, and span 15 degrees
    or more, such as those of `notch_outline`, are written as circular arcs, which are
    bulges in a DXF file. Other contours are polygons.

    Args:
        mechanism: The mechanism. Bodies and hinges without an outline are left out.
        path: Path of the file, which ends with .dxf or .svg. A file that exists is
            replaced.
        poses: Poses of the bodies; rad, m, m. By default the reference configuration.

    Raises:
        ImportError: Ezdxf or shapely is not installed.
        ValueError: The path has another ending, no body and no hinge has an outline, or
            an outline is too small or too large, encloses no area, or crosses itself.
        OSError: The file cannot be written.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> from twistorjax.examples import stage
        >>> with TemporaryDirectory() as folder:
        ...     save_outline(stage.microstage(), f"{folder}/stage.svg")
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".dxf", ".svg"):
        raise ValueError(f"`path` is {str(path)!r}, but must end with .dxf or .svg.")
    mechanism = with_flexure_outlines(mechanism)
    current = np.asarray(mechanism.reference)
    if poses is not None:
        current = current + np.asarray(mechanism.displacements(poses))
        # The outlines of hinges are deformed.
        fine = PerPart.of_each(list(map(_with_fine_arcs, mechanism.hinge_outlines)))
        mechanism = eqx.tree_at(lambda new: new.hinge_outlines, mechanism, fine)
    parts = [shape for shape in shapes(mechanism, current) if shape.kind in _STYLES]
    if not parts:
        raise ValueError(
            "No body and no hinge of the mechanism has an outline. Give them `outline`, "
            "or make the bodies with `plate`."
        )
    count = sum(outline is not None for outline in mechanism.outlines)
    for part in parts[:count]:
        owner = f"body {mechanism.names[part.row]!r}"
        require_outline(f"The outline of the {owner}", part.corners)
    for part in parts[count:]:
        owner = f"hinge {mechanism.hinge_names[part.row]!r}"
        require_outline(f"The outline of the {owner}", part.corners)
    lines = [_with_arcs(_MM * part.corners) for part in parts]
    cut = [_with_arcs(ring) for ring in _union(parts)]
    (_write_dxf if suffix == ".dxf" else _write_svg)(path, parts, lines, cut)


def require_outline(name: str, corners: np.ndarray) -> None:
    """Check a contour in the world; m."""
    size, far = np.max(np.ptp(corners, axis=0)), np.max(np.abs(corners))
    if not (size >= _SMALLEST and far <= _LARGEST):
        raise ValueError(
            f"{name} has a size of {size:.4g} m and coordinates up to {far:.4g} m, but "
            f"must have a size of at least {_SMALLEST:g} m and coordinates up to "
            f"{_LARGEST:g} m."
        )
    require_simple_polygon(name, corners)
    x, y = ((corners - corners[0]) / size).T
    if not abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) > 1e-12:
        raise ValueError(f"{name} encloses no area.")


def _union(parts: list[Shape]) -> list[np.ndarray]:
    """Compute the corners (mm) of the boundaries of the union of all parts."""
    geometry = require_package("shapely", "Outlines", "export")
    polygons = [geometry.Polygon(_MM * part.corners) for part in parts]
    gaps = [
        2 * _GAP_RATIO * polygon.area / polygon.length
        for part, polygon in zip(parts, polygons, strict=True)
        if part.kind == "hinge"
    ]
    gap = min([_GAP, *gaps])
    grown = [polygon.buffer(gap, join_style="mitre") for polygon in polygons]
    union = geometry.union_all(grown).buffer(-gap, join_style="mitre")
    rings = []
    for piece in getattr(union, "geoms", [union]):
        for ring in (piece.exterior, *piece.interiors):
            rings.append(np.asarray(ring.simplify(gap / 100).coords)[:-1])
    return rings


def _with_arcs(corners: np.ndarray) -> Line:
    """Replace the chords of circles in a closed polygon by arcs."""
    points = corners[np.any(corners != np.roll(corners, -1, axis=0), axis=1)]
    chord = np.roll(points, -1, axis=0) - points
    before = np.roll(chord, 1, axis=0)
    cross = before[:, 0] * chord[:, 1] - before[:, 1] * chord[:, 0]
    turn = np.arctan2(cross, np.sum(before * chord, axis=1))
    smooth = (np.abs(turn) <= _LARGEST_TURN) & (turn != 0)
    reach = np.where(smooth, np.hypot(*(before + chord).T), 1.0)
    curvature = np.where(smooth, turn, 0.0) / reach
    # No arc passes the corner at which the curvature changes most.
    jump = np.where(smooth, np.abs(curvature - np.roll(curvature, 1)), np.inf)
    first = int(np.argmax(jump))
    if smooth[first] and abs(curvature[first]) > abs(curvature[first - 1]):
        first -= 1  # where a straight edge is tangent to the arc that starts there
    points = np.roll(points, -first, axis=0)
    closed = np.concatenate([points, points[:1]])
    signs = np.roll(smooth * np.sign(turn), -first)
    rows, start = [], 0
    while start < len(points):
        end, angles = start + _FEWEST_CHORDS - 1, np.zeros(1)
        while (more := _arc_angles(closed, signs, start, end + 1)) is not None:
            angles, end = more, end + 1
        if np.ptp(angles) < _SMALLEST_ARC:
            rows.append((*points[start], 0.0))
            start += 1
            continue
        # An even number of arcs of at most a quarter of a circle
        pieces = 2 * math.ceil(abs(angles[-1] - angles[0]) / np.pi - 1e-9)
        ends = np.round(np.linspace(0, end - start, pieces + 1)).astype(int)
        bulges = np.tan(np.diff(angles[ends]) / 4)
        rows += [
            (*points[start + k], bulge) for k, bulge in zip(ends, bulges, strict=False)
        ]
        start = end
    return np.array(rows)


def _arc_angles(
    closed: np.ndarray, signs: np.ndarray, start: int, end: int
) -> np.ndarray | None:
    """Return the angles (rad) of points of a closed line about the center of a circle.

    The last point of the line is the first one. The sign of the turn at a point is zero
    at the corner of an arc or of a straight edge. The result is None if the points are
    not on one circle.
    """
    if end >= len(closed) or abs(np.sum(signs[start + 1 : end])) < end - start - 1:
        return None
    points = closed[start : end + 1]
    third = (end - start) // 3
    origin, a, b = points[0], points[third] - points[0], points[2 * third] - points[0]
    normal = np.sum(a**2) * b - np.sum(b**2) * a
    area = a[0] * b[1] - a[1] * b[0]
    arms = points - origin - np.array([normal[1], -normal[0]]) / (2 * area)
    radius = np.hypot(*arms.T)
    if np.ptp(radius) > _ARC_ERROR * radius[0]:
        return None
    return np.unwrap(np.arctan2(arms[:, 1], arms[:, 0]))


def _with_fine_arcs(outline: Any) -> Any:
    """Divide the arcs of the outline of a hinge, if it is a polygon, into many chords."""
    if outline is None or isinstance(outline, AbstractOutline):
        return outline
    return with_chords(_with_arcs(np.asarray(outline)), _FINE_TURN)


def with_chords(line: Line, turn: float) -> np.ndarray:
    """Replace the arcs of a closed line by chords that turn by at most `turn`; rad."""
    points = []
    for (x, y, bulge), (next_x, next_y, _) in zip(
        line, np.roll(line, -1, 0), strict=True
    ):
        start, chord = complex(x, y), complex(next_x - x, next_y - y)
        angle = 4 * np.arctan(bulge)
        count = max(1, math.ceil(abs(angle) / turn))
        angles = angle * np.arange(count) / count
        if bulge:
            # An arc turns its tangent; a chord from its start has half of this turn.
            steps = (
                np.exp(0.5j * (angles - angle)) * np.sin(angles / 2) / np.sin(angle / 2)
            )
            points += list(start + chord * steps)
        else:
            points.append(start)
    return np.stack([np.real(points), np.imag(points)], axis=1)


def _write_dxf(
    path: Path, parts: list[Shape], lines: list[Line], cut: list[Line]
) -> None:
    """Write the lines of the parts and the boundaries of their union (mm) as DXF."""
    ezdxf = require_package("ezdxf", "DXF files", "export")
    drawing = ezdxf.new("R2010", units=4)  # millimeters
    space = drawing.modelspace()
    for name, color in (("cut", 1), ("body", 5), ("fixed", 8), ("hinge", 30)):
        drawing.layers.add(name, color=color)
    layers = ["cut"] * len(cut) + [part.kind for part in parts]
    for layer, line in zip(layers, [*cut, *lines], strict=True):
        space.add_lwpolyline(
            line.tolist(), format="xyb", close=True, dxfattribs={"layer": layer}
        )
    drawing.saveas(path)


def _write_svg(
    path: Path, parts: list[Shape], lines: list[Line], cut: list[Line]
) -> None:
    """Write the lines of the parts and the boundaries of their union (mm) as SVG."""
    corners = np.concatenate(cut)[:, :2]
    low, high = corners.min(axis=0), corners.max(axis=0)
    (left, bottom), (width, height) = low - _MARGIN, high - low + 2 * _MARGIN
    root = ElementTree.Element(
        "svg",
        xmlns="http://www.w3.org/2000/svg",
        width=f"{width:.9g}mm",
        height=f"{height:.9g}mm",
        viewBox=f"{left:.9g} {-bottom - height:.9g} {width:.9g} {height:.9g}",
    )
    group = ElementTree.SubElement(root, "g", id="parts")
    for part, line in zip(parts, lines, strict=True):
        _add_path(group, [line], _STYLES[part.kind])
    _add_path(ElementTree.SubElement(root, "g", id="cut"), cut, _STYLES["cut"])
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _add_path(
    group: ElementTree.Element, lines: list[Line], style: dict[str, str]
) -> None:
    """Add closed lines (mm) to a group. The y axis of an SVG points down."""
    commands = " ".join(map(_path_commands, lines))
    ElementTree.SubElement(group, "path", {"d": commands, **style})


def _path_commands(line: Line) -> str:
    """Return the commands of an SVG path that draw a closed line."""
    commands = [f"M {line[0, 0]:.9g},{-line[0, 1]:.9g}"]
    for (x, y, bulge), (next_x, next_y, _) in zip(
        line, np.roll(line, -1, 0), strict=True
    ):
        end = f"{next_x:.9g},{-next_y:.9g}"
        if bulge:
            half = 2 * np.arctan(abs(bulge))
            radius = np.hypot(next_x - x, next_y - y) / (2 * np.sin(half))
            commands.append(f"A {radius:.9g},{radius:.9g} 0 0 {int(bulge < 0)} {end}")
        else:
            commands.append(f"L {end}")
    if not line[-1, 2]:
        commands.pop()  # The path is closed by a straight line.
    return " ".join([*commands, "Z"])
