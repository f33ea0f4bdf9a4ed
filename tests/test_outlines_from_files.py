"""Outlines of bodies from DXF files."""

from typing import Any

import ezdxf.filemanagement
import numpy as np
import pytest
from helpers import assert_close
from shapely import Polygon

import twistorjax as tj
from twistorjax.examples import stage


CHORDS_OF_CIRCLE = 126  # of at most 0.05 rad
SQUARE = [(0, 0), (2, 0), (2, 2), (0, 2)]


def read(tmp_path, draw, units=4, **settings):
    """Write the drawing of a function to a file, and read its outlines."""
    drawing = ezdxf.filemanagement.new("R2010", units=units)
    draw(drawing.modelspace())
    drawing.saveas(tmp_path / "drawing.dxf")
    return tj.io.load_outlines(tmp_path / "drawing.dxf", **settings)


def signed_area(corners):
    """Return the area of a polygon, which is positive if it is counterclockwise; mm2."""
    x, y = 1e3 * corners.T
    return np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2


def segment(radius, angle):
    """Area between an arc, divided into chords of at most 0.05 rad, and its chord."""
    count = np.ceil(angle / 0.05)
    return radius**2 / 2 * (count * np.sin(angle / count) - np.sin(angle))


def test_the_outlines_of_a_stage_are_read_as_they_were_written(tmp_path):
    mechanism = stage.microstage()
    tj.io.save_outline(mechanism, tmp_path / "stage.dxf")
    outlines = tj.io.load_outlines(tmp_path / "stage.dxf")
    assert list(outlines) == ["cut", "fixed", "body", "hinge"]
    bodies = [*outlines["fixed"], *outlines["body"]]
    for found, corners, pose in zip(
        bodies, mechanism.outlines, mechanism.reference, strict=True
    ):
        expected = Polygon(np.asarray(corners) + np.asarray(pose)[1:]).normalize()
        assert Polygon(found).normalize().equals_exact(expected, 1e-15)
    for found, (angle, *at) in zip(
        outlines["hinge"], np.asarray(mechanism.at), strict=True
    ):
        # The holes have a radius of 1.5 mm, and their centers a distance of 3.25 mm.
        normal = np.array([-np.sin(angle), np.cos(angle)])
        side = (found - at) @ normal
        arms = found - at - 1.625e-3 * np.sign(side)[:, None] * normal
        assert np.max(np.abs(np.hypot(*arms.T) / 1.5e-3 - 1)) < 1e-9
        assert_close(2 * np.min(np.abs(side)), 0.25e-3, digits=9)
        error = signed_area(found) - (3.0 * 3.25 - np.pi * 1.5**2)
        assert 0 < error < np.pi * 1.5**2 * 0.05**2 / 6


def test_the_arcs_of_an_outline_are_written_as_arcs_again(tmp_path):
    """A slot with round ends of 3 mm, one corner of which is repeated."""
    slot = [(0, -3, 0), (9, -3, 0), (9, -3, 1), (9, 3, 0), (0, 3, 1)]

    def draw(space):
        space.add_lwpolyline(slot, format="xyb", close=True)

    (outline,) = read(tmp_path, draw)["0"]
    assert len(outline) == 4 + 2 * 62
    assert_close(signed_area(outline), 9 * 6 + 2 * segment(3.0, np.pi), digits=12)
    hinge = tj.Hinge("h", "a", "b", tj.Quadratic(np.eye(3)), at=(0, 0, 0))
    bodies = [tj.Body("a", outline=outline), tj.Body("b")]
    tj.io.save_outline(tj.Mechanism(bodies, [hinge], ["a"]), tmp_path / "again.dxf")
    lines = ezdxf.filemanagement.readfile(tmp_path / "again.dxf").modelspace()
    line: Any
    for line in lines.query("LWPOLYLINE"):  # the part to be cut, and the body
        x, y, bulge = np.array(line.get_points("xyb")).T
        angles = 4 * np.arctan(np.abs(bulge))
        assert_close(np.sum(angles), 2 * np.pi, digits=9)
        chord = np.hypot(np.roll(x, -1) - x, np.roll(y, -1) - y)[bulge != 0]
        radius = chord / (2 * np.sin(angles[bulge != 0] / 2))
        assert_close(radius, np.full(len(radius), 3.0), digits=9)


@pytest.mark.parametrize("seed", range(3))
def test_edges_are_joined_in_any_order_and_direction(tmp_path, seed):
    """A plate with an arc outside and one inside of its right side, and a triangle."""
    rng = np.random.default_rng(seed)
    chains = [[(0, 0), (20, 0)], [(20, 14), (20, 16)], [(20, 16), (0, 16), (0, 0)]]
    chains += [[(50, 0), (60, 0)], [(60, 0), (50, 10)], [(50, 10), (50, 0)]]

    def draw(space):
        for index in rng.permutation(len(chains) + 2):
            if index < len(chains):
                points = chains[index][:: rng.choice([1, -1])]
                (space.add_line if len(points) == 2 else space.add_lwpolyline)(
                    *(points if len(points) == 2 else [points])
                )
            elif index == len(chains):  # from (20, 0) to (20, 8), outside
                space.add_arc((20, 4), 4, -90, 90)
            else:  # from (20, 8) to (20, 14), inside, and seen from below
                arc = space.add_arc((-20, 11), 3, 270, 90)
                arc.dxf.extrusion = (0, 0, -1)

    triangle, plate = sorted(read(tmp_path, draw)["0"], key=len)
    assert_close(signed_area(triangle), 50.0, digits=12)
    assert len(plate) == 6 + 2 * 62
    area = 20 * 16 + segment(4.0, np.pi) - segment(3.0, np.pi)
    assert_close(signed_area(plate), area, digits=12)


def test_a_circle_an_ellipse_and_a_spline_are_read_from_a_block(tmp_path):
    """The block is turned by 90 degrees, doubled, and moved."""

    def draw(space):
        block = space.doc.blocks.new("holes")
        block.add_circle((5, 0), 3)
        block.add_ellipse((0, 20), major_axis=(4, 0), ratio=0.5)
        angles = np.linspace(0, 2 * np.pi, 13)
        points = np.stack([40 + 6 * np.cos(angles), 6 * np.sin(angles)], axis=1)
        block.add_spline([*points.tolist()])
        place = {"rotation": 90, "xscale": 2, "yscale": 2, "layer": "holes"}
        space.add_blockref("holes", (100, 0), dxfattribs=place)

    circle, ellipse, spline = read(tmp_path, draw)["holes"]
    chords = CHORDS_OF_CIRCLE / (2 * np.pi) * np.sin(2 * np.pi / CHORDS_OF_CIRCLE)
    assert len(circle) == CHORDS_OF_CIRCLE
    assert_close(signed_area(circle), 4 * np.pi * 3**2 * chords, digits=9)
    assert_close(np.hypot(*(1e3 * circle - [100, 10]).T), np.full(len(circle), 6.0))
    assert_close(signed_area(ellipse), 4 * np.pi * 4 * 2 * chords, digits=9)
    # An interpolating spline of 12 points of a circle
    np.testing.assert_allclose(np.hypot(*(1e3 * spline - [100, 80]).T), 12, rtol=0.02)


def test_a_closed_spline_has_its_points_at_the_knots(tmp_path):
    """At the knots of a uniform cubic spline, points have the weights 1/6, 4/6, 1/6."""
    angles = np.arange(8) * np.pi / 4
    points = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    (smooth,) = read(tmp_path, lambda space: space.add_spline().set_closed(points))["0"]
    knots = (4 * points + np.roll(points, 1, 0) + np.roll(points, -1, 0))[:, :2] / 6
    distances = np.hypot(*(1e3 * smooth[:, None] - knots).transpose(2, 0, 1))
    assert np.max(np.min(distances, axis=0)) < 1e-12
    steps = np.hypot(*(smooth - np.roll(smooth, 1, axis=0)).T)
    assert np.max(steps) < 1.1 * np.min(steps)


@pytest.mark.parametrize(
    ("units", "unit", "factor"),
    [(1, None, 25.4), (6, None, 1e3), (0, "um", 1e-3), (1, "mm", 1.0)],
)
def test_units_are_those_of_the_file_or_of_the_argument(tmp_path, units, unit, factor):
    def draw(space):
        space.add_lwpolyline(SQUARE, close=True)

    (square,) = read(tmp_path, draw, units=units, unit=unit)["0"]
    assert_close(signed_area(square), 4 * factor**2)


@pytest.mark.parametrize(
    ("draw", "settings", "message"),
    [
        (lambda space: space.add_lwpolyline(SQUARE, close=True), {"units": 0},
         "The unit of .* is not known: .* is 0"),
        (lambda space: space.add_lwpolyline(SQUARE), {},
         r"layer '0' of .* are open at \(0, 0\), \(0, 2\) mm"),
        (lambda space: [space.add_line(SQUARE[a], SQUARE[b])
                        for a, b in ((0, 1), (1, 2), (2, 0), (2, 3))], {},
         r"branch at \(2, 2\) mm"),
        (lambda space: space.add_lwpolyline(
            [(0, 0), (2, 2), (2, 0), (0, 3)], close=True), {}, "Contour 0 .* crosses"),
        (lambda space: space.add_lwpolyline(
            [(0, 0), (2, 2), (1, 1)], close=True), {}, "Contour 0 .* encloses no area"),
        (lambda space: space.add_lwpolyline(
            SQUARE, close=True, dxfattribs={"extrusion": (1, 0, 1)}), {},
         "Contour 0 .* is not parallel to the xy plane"),
        (lambda space: space.add_circle((np.inf, 0), 1), {}, "coordinates above 1e.15"),
        (lambda space: space.add_blockref("b", (0, 0)), {}, "block definition for"),
        (lambda space: space.add_text("plate"), {}, "has no lines, arcs, circles"),
        (lambda space: space.add_lwpolyline(SQUARE, close=True), {"layers": ["table"]},
         "'table'"),
    ],
)  # fmt: skip
def test_what_is_no_outline_is_refused(tmp_path, draw, settings, message):
    with pytest.raises(ValueError, match=message) as error:
        read(tmp_path, draw, **settings)
    assert str(tmp_path) in str(error.value) or "layers" in settings


def test_a_file_that_is_missing_or_not_of_this_format_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError):
        tj.io.load_outlines(tmp_path / "missing.dxf")
    read(tmp_path, lambda space: space.add_circle((0, 0), 1))
    path = tmp_path / "drawing.dxf"
    content = path.read_bytes()
    for damaged in (b"", b"no drawing", content[:3000], content[: len(content) // 2]):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"drawing\.dxf is damaged or not a DXF"):
            tj.io.load_outlines(path)
