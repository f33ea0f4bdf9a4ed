"""SVG and DXF files with the outline of a mechanism, for cutting and for drawing."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from .._utils.types import PosesLike
from .._utils.validation import require_package
from ..mechanism.mechanism import Mechanism
from ..plotting.figure_style import FILLS, RED
from ..plotting.shapes import Shape, shapes


_MM = 1e3
_GAP = 1e-4  # Gaps between bodies and hinges up to twice this width are closed; mm.
_MARGIN = 1.0  # of an SVG; mm
_STYLES = {
    "cut": {"stroke": RED, "stroke-width": "0.1", "fill": "none"},
    **{kind: {"fill": color} for kind, color in FILLS.items()},
}


def save_outline(
    mechanism: Mechanism, path: str | Path, poses: PosesLike | None = None
) -> None:
    """Write the outline of a mechanism to a DXF or SVG file, in millimeters.

    The outline to be cut is that of the union of all bodies and hinges, so that parts
    that touch form one piece. In a DXF file it lies on the layer `cut`, and the separate
    outlines of the parts lie on the layers `body`, `fixed` and `hinge`. An SVG file has
    the groups `cut` and `parts`.

    Args:
        mechanism: The mechanism. Bodies and hinges without an outline are left out.
        path: Path of the file, which ends with .dxf or .svg. A file that exists is
            replaced.
        poses: Poses of the bodies; rad, m, m. By default the reference configuration.

    Raises:
        ImportError: Ezdxf or shapely is not installed.
        ValueError: The path has another ending, or no body and no hinge has an outline.
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
    current = np.asarray(mechanism.reference)
    if poses is not None:
        current = current + np.asarray(mechanism.displacements(poses))
    parts = [shape for shape in shapes(mechanism, current) if shape.kind in _STYLES]
    if not parts:
        raise ValueError(
            "No body and no hinge of the mechanism has an outline. Give them `outline`, "
            "or make the bodies with `plate`."
        )
    rings = _union(parts)
    (_write_dxf if suffix == ".dxf" else _write_svg)(path, parts, rings)


def _union(parts: list[Shape]) -> list[np.ndarray]:
    """Compute the corners (mm) of the boundaries of the union of all parts."""
    geometry = require_package("shapely", "Outlines", "export")
    polygons = [
        geometry.Polygon(_MM * part.corners).buffer(_GAP, join_style="mitre")
        for part in parts
    ]
    union = geometry.union_all(polygons).buffer(-_GAP, join_style="mitre")
    rings = []
    for piece in getattr(union, "geoms", [union]):
        for ring in (piece.exterior, *piece.interiors):
            rings.append(np.asarray(ring.simplify(_GAP / 10).coords)[:-1])
    return rings


def _write_dxf(path: Path, parts: list[Shape], rings: list[np.ndarray]) -> None:
    """Write the parts (m) and the boundaries of their union (mm) to a DXF file."""
    ezdxf = require_package("ezdxf", "DXF files", "export")
    drawing = ezdxf.new("R2010", units=4)  # millimeters
    space = drawing.modelspace()
    for name, color in (("cut", 1), ("body", 5), ("fixed", 8), ("hinge", 30)):
        drawing.layers.add(name, color=color)
    for ring in rings:
        space.add_lwpolyline(ring.tolist(), close=True, dxfattribs={"layer": "cut"})
    for part in parts:
        corners = (_MM * part.corners).tolist()
        space.add_lwpolyline(corners, close=True, dxfattribs={"layer": part.kind})
    drawing.saveas(path)


def _write_svg(path: Path, parts: list[Shape], rings: list[np.ndarray]) -> None:
    """Write the parts (m) and the boundaries of their union (mm) to an SVG file."""
    corners = np.concatenate(rings)
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
    for part in parts:
        _add_path(group, [_MM * part.corners], _STYLES[part.kind])
    _add_path(ElementTree.SubElement(root, "g", id="cut"), rings, _STYLES["cut"])
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _add_path(
    group: ElementTree.Element, rings: list[np.ndarray], style: dict[str, str]
) -> None:
    """Add closed polygons (mm) to a group. The y axis of an SVG points down."""
    commands = " ".join(
        "M " + " L ".join(f"{x:.9g},{-y:.9g}" for x, y in ring) + " Z" for ring in rings
    )
    ElementTree.SubElement(group, "path", {"d": commands, **style})
