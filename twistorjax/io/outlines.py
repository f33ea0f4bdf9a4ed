"""The outline of a mechanism, for machines that cut and programs that draw."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from .._utils.types import PosesLike
from .._utils.validation import require_package
from ..mechanism.mechanism import Mechanism
from ..plotting.canvas import FILLS, RED
from ..plotting.shapes import Shape, shapes


_MM = 1e3
_GAP = 1e-4  # closed between body and hinge; mm
_STYLES = {
    "cut": {"stroke": RED, "stroke-width": "0.1", "fill": "none"},
    **{kind: {"fill": color} for kind, color in FILLS.items()},
}


def save_outline(
    mechanism: Mechanism, path: str | Path, poses: PosesLike | None = None
) -> None:
    """Writes the outline of a mechanism as DXF or SVG, in millimetres.

    What is cut is the outline of all bodies and hinges together, so that what touches is
    one piece; in a DXF it lies on the layer `cut`, and each part by itself on `body`,
    `fixed` and `neck`; in an SVG the groups are `cut` and `parts`.

    Args:
        mechanism: whose bodies and hinges have outlines; those without are left out.
        path: of the file, which ends with .dxf or .svg; one that is there is replaced.
        poses: of the bodies, by default at rest; rad, m, m.

    Raises:
        ImportError: ezdxf or shapely is not installed.
        ValueError: the name ends otherwise, or nothing has an outline.
        OSError: the file cannot be written.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> from twistorjax.examples import stage
        >>> with TemporaryDirectory() as folder:
        ...     save_outline(stage.microstage(), f"{folder}/stage.svg")
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in (".dxf", ".svg"):
        raise ValueError(f"`path` is {str(path)!r}, but must end with .dxf or .svg.")
    reference = np.asarray(mechanism.reference)
    if poses is not None:
        reference = reference + np.asarray(mechanism.displacements(poses))
    parts = [part for part in shapes(mechanism, reference) if part.kind in _STYLES]
    if not parts:
        raise ValueError(
            "No body and no hinge has an outline: give them one by `outline=`, or make "
            "bodies by `plate`."
        )
    rings = _together(parts)
    (_write_dxf if kind == ".dxf" else _write_svg)(path, parts, rings)


def _together(parts: list[Shape]) -> list[np.ndarray]:
    """The closed lines around all parts, and around the holes in them; mm."""
    geometry = require_package("shapely", "Outlines", "export")
    joined = geometry.union_all(
        [
            geometry.Polygon(_MM * part.corners).buffer(_GAP, join_style="mitre")
            for part in parts
        ]
    ).buffer(-_GAP, join_style="mitre")
    rings = []
    for piece in getattr(joined, "geoms", [joined]):
        for ring in (piece.exterior, *piece.interiors):
            rings.append(np.asarray(ring.simplify(_GAP / 10).coords)[:-1])
    return rings


def _write_dxf(path: Path, parts: list[Shape], rings: list[np.ndarray]) -> None:
    ezdxf = require_package("ezdxf", "DXF files", "export")
    drawing = ezdxf.new("R2010", units=4)  # millimetres
    space = drawing.modelspace()
    for name, color in (("cut", 1), ("body", 5), ("held", 8), ("neck", 30)):
        drawing.layers.add(name, color=color)
    for ring in rings:
        space.add_lwpolyline(ring.tolist(), close=True, dxfattribs={"layer": "cut"})
    for part in parts:
        corners = (_MM * part.corners).tolist()
        space.add_lwpolyline(corners, close=True, dxfattribs={"layer": part.kind})
    drawing.saveas(path)


def _write_svg(path: Path, parts: list[Shape], rings: list[np.ndarray]) -> None:
    places = np.concatenate(rings)
    low, high = places.min(axis=0), places.max(axis=0)
    (left, bottom), (wide, high_) = low - 1, high - low + 2
    root = ElementTree.Element(
        "svg",
        xmlns="http://www.w3.org/2000/svg",
        width=f"{wide:.9g}mm",
        height=f"{high_:.9g}mm",
        viewBox=f"{left:.9g} {-bottom - high_:.9g} {wide:.9g} {high_:.9g}",
    )
    drawn = ElementTree.SubElement(root, "g", id="parts")
    for part in parts:
        _path(drawn, [_MM * part.corners], _STYLES[part.kind])
    _path(ElementTree.SubElement(root, "g", id="cut"), rings, _STYLES["cut"])
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _path(
    root: ElementTree.Element, rings: list[np.ndarray], style: dict[str, str]
) -> None:
    """Closed lines; y points down in an SVG."""
    told = " ".join(
        "M " + " L ".join(f"{x:.9g},{-y:.9g}" for x, y in ring) + " Z" for ring in rings
    )
    ElementTree.SubElement(root, "path", {"d": told, **style})
