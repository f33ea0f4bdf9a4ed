"""Files of mechanisms and energies, and scripts for other programs."""

import errno
import json
import os
import pathlib
import re
import subprocess
import sys
import threading
from xml.etree import ElementTree

import equinox as eqx
import ezdxf.filemanagement
import ezdxf.math
import ezdxf.units
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from ezdxf.entities.lwpolyline import LWPolyline
from helpers import assert_close, for_each
from saved_models import GUIDE_BY_DIMENSIONS, saved_mechanism
from shapely.geometry import Polygon

import twistorjax as tj
from twistorjax.examples import four_bar, stage
from twistorjax.io import records


# The outlines of the saved models are those of no real body.
pytestmark = [
    pytest.mark.filterwarnings("ignore:The mass of the body"),
    pytest.mark.filterwarnings("ignore:The size of the outline"),
]


LAYOUTS = pathlib.Path(__file__).parent / "reference" / "layouts"
MECHANISMS = {
    "stage": stage.microstage,
    "linkage": lambda: four_bar.four_bar("leaves-and-notches", coordinates="twist"),
}


def assert_same_mechanism(mechanism, expected):
    """The two mechanisms have the same structure and exactly the same numbers."""
    assert repr(mechanism) == repr(expected)
    leaves, expected_leaves = jax.tree.leaves(mechanism), jax.tree.leaves(expected)
    for leaf, expected_leaf in zip(leaves, expected_leaves, strict=True):
        np.testing.assert_array_equal(leaf, expected_leaf)


@pytest.mark.parametrize("name", ["stage", "linkage"])
def test_a_mechanism_is_written_and_read_without_rounding(tmp_path, name):
    """The mechanism that was read is written to an identical file."""
    mechanism = MECHANISMS[name]()
    first, second = tmp_path / "first.json", tmp_path / "second.json"
    tj.io.save_mechanism(mechanism, first)
    loaded = tj.io.load_mechanism(first)
    assert_same_mechanism(loaded, mechanism)
    tj.io.save_mechanism(loaded, second)
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize("layout", [2, 3, 4, 5, 6])
def test_files_of_all_layouts_are_read(layout):
    """Each was written by the last version with its layout."""
    loaded = tj.io.load_mechanism(LAYOUTS / f"{layout}.json")
    expected = saved_mechanism(layout)
    assert jax.tree.structure(loaded) == jax.tree.structure(expected)
    leaves = zip(jax.tree.leaves(loaded), jax.tree.leaves(expected), strict=True)
    for leaf, expected_leaf in leaves:
        assert_close(leaf, expected_leaf, digits=15)


def test_the_layout_of_files_does_not_change(tmp_path):
    """The file has all energies and stress models that can be saved."""
    tj.io.save_mechanism(saved_mechanism(6), tmp_path / "6.json")
    text = (tmp_path / "6.json").read_text()
    assert text == (LAYOUTS / "6.json").read_text()
    assert set(records._CLASSES) == set(re.findall(r'"kind": "(\w+)"', text))


def test_equal_energies_of_hinges_are_one_object_when_they_are_read(tmp_path):
    springs = [tj.Quadratic(np.eye(3)), tj.Quadratic(np.eye(3))]
    hinges = [
        tj.Hinge(name, "a", "b", energy, at=(0, 0, 0))
        for name, energy in zip("gh", springs, strict=True)
    ]
    mechanism = tj.Mechanism([tj.Body("a"), tj.Body("b")], hinges, fixed=["a"])
    tj.io.save_mechanism(mechanism, tmp_path / "springs.json")
    loaded = tj.io.load_mechanism(tmp_path / "springs.json")
    (separate,), (shared,) = (each.hinge_assembly.groups for each in (mechanism, loaded))
    assert separate.batch_axes == (0,) and shared.batch_axes == (None,)


class Unknown(tj.energies.AbstractEnergy):
    def stored_energy(self, displacement):
        return displacement.angle**2


def test_an_energy_of_another_class_is_not_written(tmp_path):
    path = tmp_path / "energy.json"
    message = "An energy of the class Unknown cannot be saved. Classes that can be saved"
    with pytest.raises(ValueError, match=f"energy.json is not written: {message}"):
        tj.io.save_energy(2.0 * Unknown(), path)
    assert not path.exists()


def test_masses_and_outlines_are_optional(tmp_path):
    """A quartic leaf with viscous damping of the twist, between bodies without mass."""
    spring = tj.flexures.quartic_leaf(
        tj.Material(69e9, 0.3), length=1.0, thickness=0.1, width=1
    )
    damping = tj.energies.ViscousDamping(np.diag([1.0, 2.0, 3.0]), "twist", resisted=True)
    hinge = tj.Hinge("h", "wall", "block", spring, at=(0.3, 0.2, 0.1), damping=damping)
    bodies = [tj.Body("wall"), tj.Body("block", (0.3, 0.1, 0.2))]
    fixed = {"wall": ["angle", "x", "y"], "block": ["y"]}
    mechanism = tj.Mechanism(bodies, [hinge], fixed=fixed)
    tj.io.save_mechanism(mechanism, tmp_path / "h.json")
    loaded = tj.io.load_mechanism(tmp_path / "h.json")
    assert_same_mechanism(loaded, mechanism)
    assert tuple(loaded.masses) == (None, None)


@pytest.fixture(scope="module")
def file_of_stage(tmp_path_factory):
    """Write the stage to a file."""
    path = tmp_path_factory.mktemp("stage") / "stage.json"
    tj.io.save_mechanism(stage.microstage(), path)
    return path


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.update(color="red"), "`mechanism` has the unknown field `color`"),
        (
            lambda m: m["bodies"][1].pop("name"),
            "`mechanism.bodies[1]` lacks the field `name`",
        ),
        (
            lambda m: m["hinges"][0].update(stiff=1),
            "`mechanism.hinges[0]` has the unknown field `stiff`",
        ),
        (lambda m: m["hinges"][2].update(first="7"), "names the body '7'"),
        (
            lambda m: m["hinges"][2]["energy"].update(kind="Rubber"),
            '`mechanism.hinges[2].energy.kind` is "Rubber", but must be one of Quadratic',
        ),
        (
            lambda m: m["bodies"][1].update(outline=[[0, 1], [1], [2, 3]]),
            "bodies[1].outline[1]` is a list of 1 entry, but must be a list of 2 entries",
        ),
        (
            lambda m: m["bodies"][1].update(outline=[[0, 1]]),
            "`outline` of the body '2' has shape (1, 2), but must have a row (x, y) for",
        ),
        (
            lambda m: m["bodies"][1].update(outline=[[0, 0], [1, 1], [1, 0], [0, 1]]),
            "crosses itself: edge 0 from (0, 0) to (1, 1) crosses edge 2 from (1, 0)",
        ),
        (lambda m: m.update(bodies=[]), "names the body"),
        (
            lambda m: m["bodies"].append(3),
            "`mechanism.bodies[6]` is 3, but must be an object",
        ),
        (lambda m: m["bodies"][1].update(mass=-1), "`mass` of the body '2' is -1"),
    ],
)
def test_a_file_with_invalid_entries_is_rejected(
    tmp_path, file_of_stage, change, message
):
    path = tmp_path / "stage.json"
    record = json.loads(file_of_stage.read_text())
    change(record["mechanism"])
    path.write_text(json.dumps(record))
    with pytest.raises(ValueError) as error:
        tj.io.load_mechanism(path)
    assert message in str(error.value) and str(path) in str(error.value)


INVALID_TEXT = "a\\ud800"  # half of a surrogate pair, as JSON writes it


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"mass": 1.0', '"mass": NaN', "bodies[0].mass` is NaN, but must be finite"),
        ('"mass": 1.0', f'"mass": {10**400}', "bodies[0].mass` is Infinity"),
        ('"mass": 1.0', '"mass": 1, "mass": 2', 'has the field "mass" more than'),
        (
            '"pose": [',
            '"pose": [true, ',
            "bodies[0].pose` is a list of 4 entries, but must",
        ),
        (
            '"pose": [0.0',
            '"pose": ["0"',
            'bodies[0].pose[0]` is "0", but must be a number',
        ),
        ('"name": "b"', f'"name": "{INVALID_TEXT}"', "bodies[0].name` has the text"),
        (
            '"fixed": {',
            f'"fixed": {{"{INVALID_TEXT}": ["x"], ',
            "`mechanism.fixed` has the text",
        ),
        (
            '"fixed": {',
            '"fixed": {"c": 5, ',
            "fixed.c` is 5, but must be a list",
        ),
        ('"mass": 1.0', f'"mass": {"[" * 100_000}', "is nested too deeply"),
        ('"mass": 1.0', f'"mass": {"[" * 300 + "]" * 300}', "is nested too deeply"),
        ("[0.0, 3.0]", "[0.0, NaN]", "bodies[0].outline[2][1]` is NaN"),
        (
            '"Quadratic"',
            '["Quadratic"]',
            "kind` is a list of 1 entry, but must be one of",
        ),
        ("[2, 0, 0]", "[2.5, 0, 0]", "powers[0][0]` is 2.5, but must be a whole number"),
        ("[2, 0, 0]", "[Infinity, 0, 0]", "powers[0][0]` is Infinity"),
        ("[2, 0, 0]", f"[{10**400}, 0, 0]", "powers[0][0]` is Infinity"),
        (
            "[2, 0, 0]",
            "[-2, 0, 0]",
            "energy.parts[1]`: `powers[0]` is (-2, 0, 0), but must be 3 whole numbers",
        ),
        (
            "[2, 0, 0]",
            "[2000, 0, 0]",
            "`powers[0]` is (2000, 0, 0), but must be 3 whole numbers from 0 to 1000",
        ),
        ("[2, 0, 0]", "[2, 0]", "hinges[0].energy.parts[1]`: `powers[0]` is (2, 0)"),
        ('"parts": [', '"parts": [3, ', "energy.parts[0]` is 3, but must be an object"),
        ('"parts": [', '"parts": [[], ', "energy.parts[0]` is a list of 0 entries, but"),
        ("[5.0, 0.0, 0.0]", "[-5.0, 0.0, 0.0]", "energy.parts[0]`: A `Quadratic` energy"),
        ("[5.0, 0.0, 0.0]", "[5.0, 0.0]", "stiffness[0]` is a list of 2 entries, but"),
    ],
)
def test_the_message_names_a_damaged_entry(tmp_path, old, new, message):
    energy = tj.Quadratic(np.diag([5.0, 6.0, 7.0])) + tj.energies.Polynomial(
        [1.0], [(2, 0, 0)], "twist"
    )
    corners = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 3.0]])
    body = tj.Body("b", mass=1.0, inertia=1.0, outline=corners)
    hinge = tj.Hinge("h", "b", "c", energy, at=(0, 0, 0))
    mechanism = tj.Mechanism([body, tj.Body("c")], [hinge], fixed={"b": ["x"]})
    path = tmp_path / "model.json"
    tj.io.save_mechanism(mechanism, path)
    text = json.dumps(json.loads(path.read_text()))
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ValueError) as error:
        tj.io.load_mechanism(path)
    assert message in str(error.value) and str(path) in str(error.value)
    assert "\n" not in str(error.value) and len(str(error.value)) < 500


def test_a_file_that_is_not_json_is_rejected(tmp_path):
    path = tmp_path / "model.json"
    for content, message in (
        (b"", "is empty"),
        (b"\xff\xfe", "is empty"),  # the byte order mark of UTF-16
        (b"\xff\xff", "is damaged or not a JSON file"),
        (b"{", "is damaged or not a JSON file"),
    ):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=message):
            tj.io.load_energy(path)
    with pytest.raises(OSError):
        tj.io.load_mechanism(tmp_path)


def body_on_a_spring(name="b", **settings):
    hinge = tj.Hinge("h", "a", name, tj.Quadratic(np.eye(3)), at=(0, 0, 0))
    bodies = [tj.Body("a"), tj.Body(name, **settings)]
    return tj.Mechanism(bodies, [hinge], fixed=["a"])


def test_a_mechanism_that_cannot_be_read_again_is_not_written(tmp_path):
    """The older file is not changed, and no temporary file remains."""
    path = tmp_path / "model.json"
    tj.io.save_mechanism(body_on_a_spring(), path)
    before = path.read_bytes()
    with pytest.raises(ValueError, match=r"bodies\[1\]\.name` has the text"):
        tj.io.save_mechanism(body_on_a_spring("b\ud800"), path)
    finite = body_on_a_spring()
    infinite = eqx.tree_at(lambda m: m.reference, finite, jnp.full((2, 3), jnp.inf))
    with pytest.raises(ValueError, match=r"bodies\[0\]\.pose\[0\]` is Infinity"):
        tj.io.save_mechanism(infinite, path)
    energy = eqx.tree_at(lambda e: e.stiffness, tj.Quadratic(np.eye(3)), jnp.ones(3))
    with pytest.raises(ValueError, match=r"`energy\.stiffness"):
        tj.io.save_energy(energy, path)
    nested = spring = tj.Quadratic(np.eye(3))
    for _ in range(150):
        nested = nested + spring
    with pytest.raises(ValueError, match="nested"):
        tj.io.save_energy(nested, path)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_a_file_is_replaced_only_when_the_new_one_is_complete(tmp_path, monkeypatch):
    """This holds if the disk is full, too. Links and the file mode are preserved."""
    path, link = tmp_path / "model.json", tmp_path / "link.json"
    tj.io.save_mechanism(body_on_a_spring(), path)
    path.chmod(0o640)
    link.symlink_to(path)
    tj.io.save_mechanism(body_on_a_spring("c"), link)
    assert link.is_symlink() and path.stat().st_mode & 0o777 == 0o640
    assert tj.io.load_mechanism(path).names == ("a", "c")
    before = path.read_bytes()

    def raise_disk_full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.fsync", raise_disk_full)
    with pytest.raises(OSError, match="No space left on device") as error:
        tj.io.save_mechanism(body_on_a_spring("d"), path)
    assert error.value.filename == str(path)
    assert path.read_bytes() == before and set(tmp_path.iterdir()) == {path, link}


def test_what_is_no_regular_file_is_not_replaced(tmp_path):
    pipe, written = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(
        target=lambda: written.append(pipe.read_text()), daemon=True
    )
    reader.start()
    tj.io.save_mechanism(body_on_a_spring(), pipe)
    reader.join(timeout=10)
    assert pipe.is_fifo()
    assert json.loads(written[0])["mechanism"]["fixed"] == {"a": ["angle", "x", "y"]}


def test_a_warning_of_a_body_is_not_repeated_when_it_is_saved(tmp_path):
    with pytest.warns(UserWarning, match="more than a full turn"):
        mechanism = body_on_a_spring(pose=(90.0, 0.0, 0.0))
    tj.io.save_mechanism(mechanism, tmp_path / "model.json")


@pytest.mark.untyped
def test_invalid_outlines_and_powers_are_rejected():
    with pytest.raises(ValueError, match=r"`outline` of the body 'b' has \[.*nan"):
        tj.Body("b", outline=np.array([[0, 0], [1, 0], [0, np.nan]]))
    spring = tj.Quadratic(np.eye(3))
    with pytest.raises(ValueError, match="`outline` of the hinge 'h' has shape"):
        line = np.array([[0.0, 0.0], [1.0, 0.0]])
        tj.Hinge("h", "a", "b", spring, at=(0, 0, 0), outline=line)
    for power in (2.5, np.inf, 10**400, -1):
        with pytest.raises(ValueError, match=r"`powers\[0\]` is .* whole numbers from 0"):
            tj.energies.Polynomial([1.0], [(power, 0, 0)], "twist")  # pyright: ignore[reportArgumentType]


def test_a_file_of_another_kind_or_version_is_rejected(tmp_path):
    path = tmp_path / "energy.json"
    tj.io.save_energy(tj.Quadratic(np.eye(3)), path)
    with pytest.raises(ValueError, match="must have only `twistorjax` and `mechanism`"):
        tj.io.load_mechanism(path)
    path.write_text("[]")
    with pytest.raises(ValueError, match="is a list of 0 entries, but must be"):
        tj.io.load_mechanism(path)
    path.write_text('{"twistorjax": 99, "mechanism": {}}')
    with pytest.raises(
        ValueError, match="`twistorjax` is 99, but must be one of 2, 3, 4, 5"
    ):
        tj.io.load_mechanism(path)


def total_area(mechanism):
    """Area of bodies and hinges, which touch and hardly overlap; mm2."""
    parts = [*mechanism.outlines, *mechanism.hinge_outlines]
    return sum(Polygon(1e3 * np.asarray(part)).area for part in parts)


def lines_of(path):
    """Read the closed lines of a DXF file."""
    lines = []
    for line in ezdxf.filemanagement.readfile(path).modelspace():
        assert isinstance(line, LWPolyline) and line.closed
        lines.append(line)
    return lines


def polygon_of(line):
    """Return the polygon inside a line, with 1,000 chords for each arc."""
    rows = line.get_points("xyb")
    points = []
    for (*first, bulge), (*second, _) in zip(rows, rows[1:] + rows[:1], strict=True):
        points.append([first])
        if bulge:
            center, start, end, radius = ezdxf.math.bulge_to_arc(first, second, bulge)
            angles = np.linspace(start, end + 2 * np.pi * (end < start), 1001)
            directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
            arc = [center.x, center.y] + radius * directions
            points.append(arc[1:-1] if bulge > 0 else arc[-2:0:-1])
    return Polygon(np.concatenate(points))


def cut_of(path):
    """Return the part that a DXF file cuts; mm."""
    polygons = [polygon_of(line) for line in lines_of(path) if line.dxf.layer == "cut"]
    # The largest line is the outer boundary; the others are the holes.
    outer, *holes = sorted(polygons, key=lambda polygon: -polygon.area)
    return outer.difference(shapely.union_all(holes))


def test_the_outline_to_be_cut_is_exact(tmp_path):
    """The cut part is one piece, and the necks have their thickness and their area."""
    mechanism = stage.microstage()
    path = tmp_path / "stage.dxf"
    tj.io.save_outline(mechanism, path)
    assert ezdxf.filemanagement.readfile(path).units == ezdxf.units.MM
    part, lines = cut_of(path), lines_of(path)
    assert_close(part.area, total_area(mechanism), digits=4)
    for at in np.asarray(mechanism.at):
        distance = part.boundary.distance(shapely.Point(1e3 * at[1:]))
        assert_close(2 * distance, 0.25, digits=9)
    for line in lines:
        if line.dxf.layer == "hinge":
            assert_close(polygon_of(line).area, 3.0 * 3.25 - np.pi * 1.5**2, digits=5)
    bulges = [line.get_points("b") for line in lines if line.dxf.layer == "cut"]
    assert np.count_nonzero(np.concatenate(bulges)) == 7 * 4
    layers = [line.dxf.layer for line in lines]
    assert [layers.count(name) for name in ("body", "fixed", "hinge")] == [5, 1, 7]


SPRING = tj.Quadratic(np.eye(3))


def outlined_body(outline):
    """Return a mechanism with an outline of one body."""
    spring = tj.Hinge("h", "a", "b", SPRING, at=(0.0, 0.0, 0.0))
    return tj.Mechanism([tj.Body("a", outline=outline), tj.Body("b")], [spring], ["a"])


def part_of(outline):
    """Return a hinge between two blocks, 2 mm long, that are as high as its ends."""
    x, y = np.ptp(np.asarray(outline), axis=0)
    block = np.array([[-1, -0.5], [1, -0.5], [1, 0.5], [-1, 0.5]]) * [1e-3, y]
    bodies = [
        tj.Body("left", (0.0, -x / 2 - 1e-3, 0.0), outline=block),
        tj.Body("right", (0.0, x / 2 + 1e-3, 0.0), outline=block),
    ]
    hinge = tj.Hinge("h", "left", "right", SPRING, at=(0, 0, 0), outline=outline)
    return tj.Mechanism(bodies, [hinge], fixed=["left"])


@pytest.mark.parametrize("suffix", ["dxf", "svg"])
@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_a_notch_is_cut_with_its_thickness(tmp_path, suffix, scale):
    """Also a neck of 0.4 um between holes of 3 um. The arcs end at the height."""
    hole, web, height = 3e-3 * scale, 0.4e-3 * scale, 2e-3 * scale
    outline = tj.flexures.notch_outline(hole=hole, web=web, height=height)
    path = tmp_path / f"notch.{suffix}"
    tj.io.save_outline(part_of(outline), path)
    if suffix == "dxf":
        part = cut_of(path)
        center = shapely.Point(0.0, 0.0)
        distance = part.boundary.distance(center)
        x, y = np.array(polygon_of(lines_of(path)[-1]).exterior.coords).T / scale
        inside = np.abs(x) < 1.5 * np.sin(np.arccos(1 - 1.6 / 3)) - 1e-6
        exact = 0.2 + 1.5 - np.sqrt(1.5**2 - x**2)
        np.testing.assert_allclose(np.abs(y[inside]), exact[inside], atol=1e-8)
        assert_close(2 * distance / scale, 0.4, digits=8)
        return
    commands = ElementTree.parse(path).getroot()[1][0].attrib["d"].split(" ")
    radii = [
        float(commands[k + 1].split(",")[0])
        for k in range(len(commands))
        if commands[k] == "A"
    ]
    np.testing.assert_allclose(radii, 4 * [1.5 * scale], rtol=1e-7)
    ends = [word for word in commands if "," in word]
    points = np.array([word.split(",") for word in ends], float)
    assert any(
        np.allclose(point, [0.0, 0.2 * scale], atol=1e-8 * scale) for point in points
    )


@pytest.mark.parametrize(
    ("profile", "arcs"),
    [
        (tj.flexures.filleted_leaf_profile(length=0.02, thickness=5e-4, fillet=2e-3), 8),
        (tj.flexures.elliptical_notch_profile(length=0.02, web=2e-4, depth=4e-3), 0),
        (
            tj.flexures.reinforced_leaf_profile(
                length=0.02,
                thickness=3e-4,
                reinforced_length=0.014,
                reinforced_thickness=2e-3,
            ),
            0,
        ),
    ],
)
def test_contours_are_cut_with_small_chord_errors(tmp_path, profile, arcs):
    """Below 1e-4 of the smallest thickness, which is that of a corner."""
    steel = tj.Material(210e9, poisson=0.3)
    beam = tj.flexures.Beam(steel, length=0.02, thickness=profile, width=5e-3)
    pivot = tj.flexures.parallelogram(beam, SPRING, spacing=0.02)
    outline, _ = pivot.mechanism.hinge_outlines
    path = tmp_path / "contour.dxf"
    tj.io.save_outline(part_of(outline), path)
    (hinge,) = [line for line in lines_of(path) if line.dxf.layer == "hinge"]
    x, y, bulges = np.array(hinge.get_points("xyb")).T
    radius = np.hypot(np.diff(x), np.diff(y)) / (
        2 * np.sin(2 * np.arctan(np.abs(bulges[:-1])) + (bulges[:-1] == 0))
    )
    assert np.count_nonzero(np.isclose(radius[bulges[:-1] != 0], 2.0, rtol=1e-6)) == arcs
    thinnest = 1e3 * np.min(for_each(profile, np.linspace(-0.01, 0.01, 2001)))
    assert_close(2 * np.min(np.abs(y)), thinnest, digits=9)
    # Points between the corners of the part, at least 10 um from the blocks
    corners = shapely.get_coordinates(cut_of(path))
    share = np.linspace(0.0, 1.0, 9)[:, None, None]
    points = ((1 - share) * corners[:-1] + share * corners[1:]).reshape(-1, 2)
    points = points[np.abs(points[:, 0]) < 9.99]
    along = points[:, 0] / 1e3
    exact, slope = (
        1e3 / 2 * for_each(profile, along),
        for_each(jax.grad(profile), along) / 2,
    )
    error = np.abs(np.abs(points[:, 1]) - exact) / np.hypot(1.0, slope)
    assert np.max(error) < 1e-4 * thinnest


def test_the_arcs_of_a_displaced_notch_keep_their_accuracy(tmp_path):
    """The neck of a notch that is displaced as a rigid body has its thickness."""
    outline = tj.flexures.notch_outline(hole=3e-3, web=0.25e-3)
    mechanism = part_of(outline)
    pose = np.array([[0.3, 0.01, 0.02]])
    origin = np.asarray(mechanism.reference)
    turn = np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])
    moved = np.concatenate(
        [pose[0, 0] + origin[:, :1], pose[:, 1:] + origin[:, 1:] @ turn], 1
    )
    tj.io.save_outline(mechanism, tmp_path / "moved.dxf", moved)
    distance = cut_of(tmp_path / "moved.dxf").boundary.distance(shapely.Point(10.0, 20.0))
    assert_close(2 * distance, 0.25, digits=8)
    bent = origin + np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0]])
    tj.io.save_outline(mechanism, tmp_path / "bent.dxf", bent)
    (line,) = [
        line for line in lines_of(tmp_path / "bent.dxf") if line.dxf.layer == "hinge"
    ]
    assert len(line) > 500


def test_a_regular_polygon_with_few_corners_remains_a_polygon(tmp_path):
    angles = np.linspace(0.0, 2 * np.pi, 60, endpoint=False)
    corners = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    tj.io.save_outline(outlined_body(corners), tmp_path / "a.dxf")
    for line in lines_of(tmp_path / "a.dxf"):
        assert len(line) == 60 and not np.any(line.get_points("b"))


@pytest.mark.parametrize(
    ("outline", "message"),
    [
        (
            1e308 * np.eye(3)[:, :2],
            r"'a' has a size of 1e\+308 m and",
        ),
        (1e-300 * np.eye(3)[:, :2], "must have a size of at least 1e-09 m"),
        ([[0, 0], [1, 0], [2, 0]], "The outline of the body 'a' encloses no area"),
    ],
)
def test_an_outline_that_no_file_can_hold_is_rejected(tmp_path, outline, message):
    mechanism = outlined_body(outline)
    for name in ("a.dxf", "a.svg"):
        with pytest.raises(ValueError, match=message):
            tj.io.save_outline(mechanism, tmp_path / name)


def test_an_svg_shows_the_displaced_bodies_upright(tmp_path):
    """The y axis of an SVG points down."""
    linkage = four_bar.four_bar()
    poses = linkage.reference.at[2].add(jnp.array([0.0, 0.0, 4e-3]))
    tj.io.save_outline(linkage, tmp_path / "linkage.svg", poses)
    root = ElementTree.parse(tmp_path / "linkage.svg").getroot()
    height = float(root.attrib["height"].removesuffix("mm"))
    assert_close(height, 76.0, digits=6)  # 70 and 4, and a margin of 1
    top = 1e3 * (np.asarray(linkage.outlines[2]) + np.asarray(poses[2, 1:]))
    parts, cut = root
    assert (parts.attrib["id"], cut.attrib["id"], len(cut)) == ("parts", "cut", 1)
    commands = parts[2].attrib["d"]
    corners = [pair.split(",") for pair in commands.strip("MZ ").split(" L ")]
    assert_close(np.array(corners, float), np.asarray(top) * [1, -1], digits=8)


@pytest.mark.parametrize(
    ("name", "message"), [("a.pdf", "must end with .dxf or .svg"), ("a.svg", "No body")]
)
def test_an_outline_that_cannot_be_written_is_rejected(tmp_path, name, message):
    spring = tj.Quadratic(np.eye(3))
    bodies = [tj.Body("a"), tj.Body("b", (0.0, 1.0, 0.0))]
    hinge = tj.Hinge("h", "a", "b", spring, at=(0.0, 0.5, 0.0))
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["a"])
    with pytest.raises(ValueError, match=message):
        tj.io.save_outline(mechanism, tmp_path / name)


def test_a_script_for_exudyn_contains_the_mechanism_and_its_loads():
    linkage = four_bar.four_bar()
    loads = [tj.Load("3", (0.0, 0.002, -0.001), at=(0.01, 0.0))]
    script = tj.io.exudyn_script(linkage, loads=loads, drives=[tj.Drive("2", angle=1e-4)])
    compile(script, "linkage.py", "exec")
    scope = {}
    for name in ("BODIES", "HINGES", "PRESCRIBED", "LOADS"):
        start = script.index(f"{name} = ")
        end = script.index("\n\n" if name == "LOADS" else "\n#", start)
        exec(script[start:end], scope)
    np.testing.assert_array_equal(list(scope["BODIES"].values()), linkage.reference)
    assert ("2", 0, 1e-4) in scope["PRESCRIBED"] and len(scope["PRESCRIBED"]) == 4
    assert scope["LOADS"] == [("3", [0.0, 0.002, -0.001], [0.01, 0.0], False)]
    first, second, at, stiffness = scope["HINGES"]["B"]
    assert (first, second) == ("2", "3")
    assert_close(at, linkage.at[1])
    energy = linkage.hinge_assembly.energy_of(1)
    assert isinstance(energy, tj.Quadratic)
    assert_close(np.array(stiffness), energy.stiffness)


def test_exudyn_finds_the_same_small_displacements(tmp_path):
    """The loads are so small that its linear springs agree with the hinges."""
    pytest.importorskip("exudyn")
    linkage = four_bar.four_bar("leaves-and-notches")
    loads = [tj.Load("3", (0.0, 2e-6, -1e-6), at=(0.01, 0.0))]
    drives = [tj.Drive("2", angle=1e-7)]
    path = tmp_path / "linkage.py"
    path.write_text(tj.io.exudyn_script(linkage, loads=loads, drives=drives))
    process = subprocess.run([sys.executable, path], capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    rows = [line.split()[1:] for line in process.stdout.splitlines()[1:]]
    solution = tj.equilibrium(linkage, loads=loads, drives=drives)
    expected = np.asarray(solution.displacements)
    tolerance = 1e-5 * np.abs(expected).max()
    np.testing.assert_allclose(np.array(rows, float), expected, rtol=1e-5, atol=tolerance)


def _loaded(content, folder):
    path = folder / "guide.json"
    path.write_text(json.dumps({"twistorjax": 6, "mechanism": content}))
    return tj.io.load_mechanism(path)


def test_flexures_in_files_may_be_given_by_their_dimensions(tmp_path):
    guide = _loaded(GUIDE_BY_DIMENSIONS, tmp_path)
    steel = tj.Material.named("spring steel")
    leaf = tj.flexures.leaf(steel, length=0.05, thickness=0.5e-3, width=0.01)
    found = guide.hinge_assembly.energy_of(1)
    assert jax.tree.structure(found) == jax.tree.structure(leaf)
    for value, expected in zip(
        jax.tree.leaves(found), jax.tree.leaves(leaf), strict=True
    ):
        np.testing.assert_array_equal(value, expected)
    tj.io.save_mechanism(guide, tmp_path / "again.json")
    assert repr(tj.io.load_mechanism(tmp_path / "again.json")) == repr(guide)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("material", "steal", "energy.material`: There is no material 'steal'"),
        ("material", {"modulus": 210e9}, "energy.material` lacks the field `poisson`"),
        ("kind", "lef", 'kind` is "lef", but must be one of Quadratic'),
        ("length", "50 mm", 'energy.length` is "50 mm", but must be a number'),
        ("length", -1.0, "`length` is -1, but must be positive"),
        ("lenght", 1.0, "field `lenght`. Its fields are 'material', 'length', 'thick"),
        ("theory", "thick", 'theory` is "thick", but must be one of euler-bernoulli'),
    ],
)
def test_wrong_dimensions_in_files_are_named(field, value, message, tmp_path):
    content = json.loads(json.dumps(GUIDE_BY_DIMENSIONS))
    content["hinges"][0]["energy"][field] = value
    with pytest.raises(ValueError, match=re.escape(message)):
        _loaded(content, tmp_path)
