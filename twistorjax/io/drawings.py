"""Outlines of bodies from DXF files of CAD programs."""

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from .._utils.csv_files import UNIT_FACTORS
from .._utils.validation import (
    quote,
    require_choice,
    require_names,
    require_package,
    shorten,
)
from .outlines import require_outline, with_chords


_UNITS = {**UNIT_FACTORS["m"], "in": 0.0254, "ft": 0.3048, "mil": 25.4e-6}
_CODES = {1: "in", 2: "ft", 4: "mm", 5: "cm", 6: "m", 9: "mil", 12: "nm", 13: "um"}
_TURN = 0.05  # of the chords of an arc, so that `save_outline` recognizes it; rad
_FINEST = 9  # a piece of a spline has at most two to this power of half chords
_SPLINE_ERROR = 1e-4  # distance of the chords of a spline from it, over its size
_GAP = 1e-6  # largest distance of ends that meet, over the size of all lines of a layer
_FARTHEST = 1e15  # coordinate in a file; others are damaged
_FRAME = 16  # flag of a vertex that is not on its polyline, but a point that controls it
_KINDS = {"LINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE", "LWPOLYLINE", "POLYLINE"}

# Points of an open line, or of a closed one, whose last point is the first one
Points = Float[np.ndarray, "_ 3"]


def load_outlines(
    path: str | Path, unit: str | None = None, layers: Sequence[str] | None = None
) -> dict[str, list[Float[np.ndarray, "_corners 2"]]]:
    """Read the closed contours in the model space of a DXF file.

    Contours are circles, ellipses, closed polylines and splines, and loops of lines, arcs
    and other open curves of one layer whose ends meet, in any order and direction. The
    references to blocks are resolved. Texts, dimensions, hatches and points are ignored.

    Arcs become chords that turn by at most 0.05 rad, with corners on the arc, so that
    `save_outline` writes arcs again. Ellipses have as many chords as circles. The chords
    of a spline have a distance of at most 1e-4 of its size from it. Ends meet if their
    distance is at most 1e-6 of the size of the layer.

    Args:
        path: Path of the file.
        unit: Unit of the coordinates: "m", "cm", "mm", "um", "nm", "in", "ft" or "mil".
            By default that of the header of the file, `$INSUNITS`, which this argument
            replaces.
        layers: Names of the layers to read. By default all layers.

    Returns:
        The contours of each layer. A contour is a polygon in the frame of the file, with
        counterclockwise corners; m. Layers and contours have the order of the file.

    Raises:
        FileNotFoundError: There is no such file.
        ImportError: Ezdxf is not installed.
        ValueError: The file is damaged or no DXF file, it has no unit, no contour or no
            such layer, a contour is open, or a contour has branches, crosses itself, or
            is not parallel to the xy plane.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> from twistorjax.examples import stage
        >>> from twistorjax.io import save_outline
        >>> with TemporaryDirectory() as folder:
        ...     save_outline(stage.microstage(), f"{folder}/stage.dxf")
        ...     outlines = load_outlines(f"{folder}/stage.dxf")
        >>> {layer: len(contours) for layer, contours in outlines.items()}
        {'cut': 4, 'fixed': 1, 'body': 5, 'hinge': 7}
    """
    code, lines = _read(path)
    if unit is None and (unit := _CODES.get(code)) is None:
        raise ValueError(
            f"The unit of {path} is not known: `$INSUNITS` in its header is {code}. Give "
            f"the unit of its coordinates as `unit`, one of {', '.join(_UNITS)}."
        )
    factor = _UNITS[require_choice("`unit`", unit, list(_UNITS))]
    if not lines:
        raise ValueError(
            f"{path} has no lines, arcs, circles, ellipses, splines or polylines in its "
            "model space."
        )
    require_names("`layers`", layers)
    for index, layer in enumerate(layers or ()):
        require_choice(f"`layers[{index}]`", layer, list(lines))
    return {
        layer: _contours(f"layer {quote(layer)} of {path}", [factor * p for p in points])
        for layer, points in lines.items()
        if layers is None or layer in layers
    }


def _read(path: str | Path) -> tuple[int, dict[str, list[Points]]]:
    """Return the code of the unit of a file, and the lines of its layers in this unit."""
    ezdxf = require_package("ezdxf", "DXF files", "export")
    try:
        drawing = ezdxf.readfile(path)
        lines: dict[str, list[Points]] = {}
        for layer, entity in _entities(drawing.modelspace()):
            points = np.array([tuple(point) for point in _points(entity)])
            if not np.all(np.abs(points) <= _FARTHEST):  # also true for NaN
                raise ValueError(f"{entity} has coordinates above {_FARTHEST:g}.")
            if len(points) > 1:
                lines.setdefault(layer, []).append(points)
        return drawing.units, lines
    except Exception as error:  # A parser of a damaged file fails in any way.
        if isinstance(error, OSError) and error.errno:
            raise
        cause = quote(str(error) or type(error).__name__)
        raise ValueError(f"{path} is damaged or not a DXF file: {cause}") from error


def _entities(entities: Iterable[Any], owner: str = "0") -> Iterator[tuple[str, Any]]:
    """Yield layers and entities. Layer 0 of a block is that of the reference to it."""
    for entity in entities:
        layer = owner if entity.dxf.layer == "0" else entity.dxf.layer
        if entity.dxftype() == "INSERT":
            # Several references are one entity with rows and columns.
            for insert in entity.multi_insert() if entity.mcount > 1 else [entity]:
                yield from _entities(insert.virtual_entities(), layer)
        elif entity.dxftype() in _KINDS:
            yield layer, entity


def _points(entity: Any) -> Iterable[Iterable[float]]:
    """Return the points of an entity in the world, in the unit of the file."""
    kind, dxf = entity.dxftype(), entity.dxf
    if kind == "LINE":
        return [dxf.start, dxf.end]
    if kind == "CIRCLE":
        return entity.vertices(np.linspace(0.0, 360.0, _count(360.0)))
    if kind == "ARC":
        return entity.vertices(entity.angles(_count(dxf.end_angle - dxf.start_angle)))
    if kind == "ELLIPSE":
        span = math.degrees(dxf.end_param - dxf.start_param)
        return entity.vertices(entity.params(_count(span)))
    if kind == "SPLINE":
        return _spline_points(entity)
    return _polyline_points(entity)


def _count(span: float) -> int:
    """Return the number of points of an arc, or of a circle if its span is 0; degrees."""
    return 1 + math.ceil(math.radians(span % 360 or 360) / _TURN)


def _spline_points(entity: Any) -> Points:
    """Divide a spline into chords. Ezdxf 1.4 evaluates periodic splines incorrectly."""
    from scipy.interpolate import BSpline

    curve = entity.construction_tool()
    controls = np.array([tuple(point) for point in curve.control_points])
    weights = np.reshape(curve.weights() or np.ones(len(controls)), (-1, 1))
    knots = np.array(entity.knots if len(entity.knots) else curve.knots())
    rational = BSpline(knots, np.hstack([controls * weights, weights]), curve.degree)
    breaks = np.unique(knots[curve.degree : len(controls) + 1])
    level = 2  # of the division of each piece of the spline
    while True:
        level += 1
        places = np.arange(0.0, len(breaks) - 1 + 2.0**-level, 2.0**-level)
        values = rational(np.interp(places, np.arange(len(breaks)), breaks))
        points = values[:, :3] / values[:, 3:]
        error = points[1::2] - (points[:-2:2] + points[2::2]) / 2
        accurate = np.max(np.abs(error)) <= _SPLINE_ERROR * np.max(np.ptp(controls, 0))
        if accurate or level == _FINEST:
            return points[::2]


def _polyline_points(entity: Any) -> Iterable[Iterable[float]]:
    """Return the points of a polyline; none if it is a mesh."""
    if entity.dxftype() == "LWPOLYLINE":
        rows, z, closed = entity.get_points("xyb"), entity.dxf.elevation, entity.closed
    elif entity.is_2d_polyline:
        corners = [each.dxf for each in entity.vertices if not each.dxf.flags & _FRAME]
        rows = [(*corner.location.vec2, corner.bulge) for corner in corners]
        z, closed = entity.dxf.elevation.z, entity.is_closed
    elif entity.is_3d_polyline:
        points = list(entity.points())
        return points + points[:1] * entity.is_closed
    else:
        return []
    line = np.reshape(rows, (-1, 3)).astype(float)
    if not closed:
        line[-1:, 2] = 0.0  # the bulge of the edge from the last point to the first one
    points = with_chords(line, _TURN).tolist()
    points += points[:1] * closed
    return entity.ocs().points_to_wcs((*point, z) for point in points)


def _contours(name: str, lines: list[Points]) -> list[Float[np.ndarray, "_corners 2"]]:
    """Return the contours of a layer, in the order of their first lines."""
    gap = _GAP * np.max(np.ptp(np.concatenate(lines)[:, :2], axis=0))
    loops, rest = {}, {}
    for index, line in enumerate(lines):
        if np.max(np.ptp(line[:, :2], axis=0)) > gap:
            closed = math.dist(line[0, :2], line[-1, :2]) <= gap
            (loops if closed else rest)[index] = line
    if rest:
        loops |= _joined(name, rest, gap)
    contours = []
    for number, index in enumerate(sorted(loops)):
        label, points = f"Contour {number} on the {name}", loops[index]
        if (height := np.ptp(points[:, 2])) > gap:
            raise ValueError(
                f"{label} is not parallel to the xy plane: its z coordinates differ by "
                f"{1e3 * height:.4g} mm. Project it onto the xy plane in the CAD program."
            )
        corners = points[:-1, :2]
        steps = corners - np.roll(corners, 1, axis=0)
        distinct = np.hypot(*steps.T) > 1e-9 * np.max(np.ptp(corners, axis=0))
        corners = corners[distinct]
        require_outline(label, corners)
        x, y = (corners - corners[0]).T
        area = np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
        contours.append(corners if area > 0 else corners[::-1].copy())
    return contours


def _joined(name: str, lines: dict[int, Points], gap: float) -> dict[int, Points]:
    """Join open lines to closed ones, by the keys of their first lines."""
    from scipy.spatial import KDTree

    keys = list(lines)
    # Ends 2k and 2k + 1 are the start and the end of line k.
    ends = np.array([lines[key][end, :2] for key in keys for end in (0, -1)])
    near = [set(found) for found in KDTree(ends).query_ball_point(ends, gap)]
    for wrong, problem, remedy in (
        ([len(found) > 2 for found in near], "branch", "Delete lines that occur twice"),
        ([len(found) < 2 for found in near], "are open", "Close them"),
    ):
        if any(wrong):
            points = dict.fromkeys(f"({x:.9g}, {y:.9g})" for x, y in 1e3 * ends[wrong])
            where = shorten(", ".join(points), 300)
            raise ValueError(
                f"The lines on the {name} {problem} at {where} mm. {remedy} in the CAD "
                "program, or read only other layers by `layers`."
            )
    loops, left = {}, set(range(len(keys)))
    for first, key in enumerate(keys):
        end, pieces = 2 * first, []
        while end // 2 in left:
            left.remove(end // 2)
            line = lines[keys[end // 2]][:: -1 if end % 2 else 1]
            pieces.append(line[:-1])
            (end,) = near[end ^ 1] - {end ^ 1}
        if pieces:
            loops[key] = np.concatenate([*pieces, pieces[0][:1]])
    return loops
