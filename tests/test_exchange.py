"""Mechanisms in files, read by others."""

import json
import subprocess
import sys
from xml.etree import ElementTree

import ezdxf
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from shapely.geometry import Polygon

import twistorjax as tj
from twistorjax.cases import four_bar, stage


MECHANISMS = {
    "stage": stage.microstage,
    "linkage": lambda: four_bar.four_bar("mixed", coordinates="twist"),
}


def leaves(mechanism):
    return jax.tree.leaves(mechanism)


@pytest.mark.parametrize("name", ["stage", "linkage"])
def test_a_mechanism_is_read_as_it_was_written(tmp_path, name):
    """To the last bit, and to the same file again."""
    written = MECHANISMS[name]()
    tj.save_mechanism(written, tmp_path / "one.json")
    read = tj.load_mechanism(tmp_path / "one.json")
    assert repr(read) == repr(written)
    for one, other in zip(leaves(written), leaves(read), strict=True):
        np.testing.assert_array_equal(one, other)
    tj.save_mechanism(read, tmp_path / "two.json")
    assert (tmp_path / "one.json").read_bytes() == (tmp_path / "two.json").read_bytes()


def test_a_mechanism_may_have_little(tmp_path):
    """No outlines, no masses; a leaf that shortens, damped by the rates of its twist."""
    spring = tj.quartic_leaf(tj.Material(69e9, 0.3), length=1.0, thickness=0.1, width=1)
    damping = tj.Viscous(np.diag([1.0, 2.0, 3.0]), "twist", resisted=True)
    hinge = tj.Hinge("h", "wall", "block", spring, at=(0.3, 0.2, 0.1), damping=damping)
    bodies = [tj.Body("wall"), tj.Body("block", (0.3, 0.1, 0.2))]
    held = {"wall": ["angle", "x", "y"], "block": ["y"]}
    written = tj.Mechanism(bodies, [hinge], held=held)
    tj.save_mechanism(written, tmp_path / "h.json")
    read = tj.load_mechanism(tmp_path / "h.json")
    assert repr(read) == repr(written) and read.masses == (None, None)
    for one, other in zip(leaves(written), leaves(read), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.update(colour="red"), "the mechanism has the unknown 'colour'"),
        (lambda m: m["bodies"][1].pop("mass"), "bodies[1] lacks 'mass'"),
        (
            lambda m: m["hinges"][0].update(stiff=1, at=None),
            "hinges[0] has the unknown 'stiff'",
        ),
        (lambda m: m["hinges"][2].update(first="7"), "names the body '7'"),
        (
            lambda m: m["hinges"][2]["energy"].update(kind="Rubber"),
            "the energy of hinges[2], 'c': `kind` is 'Rubber', but must be one",
        ),
        (
            lambda m: m["bodies"][1].update(outline=[[0, 1], [1]]),
            "`outline` of '2' must be rows (x, y)",
        ),
        (lambda m: m["bodies"][1].update(outline=[[0, 1]]), "has 1 corners"),
        (lambda m: m.update(bodies=[]), "names the body"),
        (lambda m: m["bodies"].append(3), "bodies[6] is a int"),
        (lambda m: m["bodies"][1].update(mass=-1), "`mass` of the body '2' is -1"),
    ],
)
def test_a_file_that_is_no_mechanism_is_refused(tmp_path, change, message):
    path = tmp_path / "stage.json"
    tj.save_mechanism(stage.microstage(), path)
    record = json.loads(path.read_text())
    change(record["mechanism"])
    path.write_text(json.dumps(record))
    with pytest.raises(ValueError) as error:
        tj.load_mechanism(path)
    assert message in str(error.value) and str(path) in str(error.value)


def test_a_file_of_another_kind_or_version_is_refused(tmp_path):
    path = tmp_path / "energy.json"
    tj.save_energy(tj.Quadratic(np.eye(3)), path)
    with pytest.raises(ValueError, match="must have `twistorjax` and `mechanism` alone"):
        tj.load_mechanism(path)
    path.write_text("[]")
    with pytest.raises(ValueError, match="is a list, but must be an object"):
        tj.load_mechanism(path)
    path.write_text('{"twistorjax": 99, "mechanism": {}}')
    with pytest.raises(ValueError, match="`twistorjax` is 99, but must be 1"):
        tj.load_mechanism(path)


def drawn_area(mechanism):
    """Of bodies and hinges, which touch and do not overlap; mm2."""
    parts = [*mechanism.outlines, *mechanism.hinge_outlines]
    return sum(Polygon(1e3 * np.asarray(part)).area for part in parts)


def test_what_is_cut_is_one_piece(tmp_path):
    """The stage is cut from one plate, by lines around what its parts fill."""
    mechanism = stage.microstage()
    tj.save_outline(mechanism, tmp_path / "stage.dxf")
    drawing = ezdxf.readfile(tmp_path / "stage.dxf")
    assert drawing.units == ezdxf.units.MM
    lines = list(drawing.modelspace())
    assert all(line.closed for line in lines)
    cut = [line for line in lines if line.dxf.layer == "cut"]
    areas = sorted(Polygon([p[:2] for p in line]).area for line in cut)
    # the frame and all that hangs on it, less the holes that it encloses
    assert_close(areas[-1] - sum(areas[:-1]), drawn_area(mechanism), digits=3)
    layers = [line.dxf.layer for line in lines]
    assert [layers.count(name) for name in ("body", "held", "neck")] == [5, 1, 7]


def test_an_svg_shows_the_same_upright_and_moved(tmp_path):
    """Its y points down; the linkage as it is moved."""
    linkage = four_bar.four_bar()
    poses = linkage.rest.at[2].add(jnp.array([0.0, 0.0, 4e-3]))
    tj.save_outline(linkage, tmp_path / "linkage.svg", poses)
    root = ElementTree.parse(tmp_path / "linkage.svg").getroot()
    height = float(root.attrib["height"].removesuffix("mm"))
    assert_close(height, 76.0, digits=6)  # 70 and 4, and a margin of 1
    top = 1e3 * (np.asarray(linkage.outlines[2]) + np.asarray(poses[2, 1:]))
    parts, cut = root
    assert (parts.attrib["id"], cut.attrib["id"], len(cut)) == ("parts", "cut", 1)
    told = parts[2].attrib["d"]
    corners = [pair.split(",") for pair in told.strip("MZ ").split(" L ")]
    assert_close(np.array(corners, float), np.asarray(top) * [1, -1], digits=8)


@pytest.mark.parametrize(
    ("name", "message"), [("a.pdf", "must end with .dxf or .svg"), ("a.svg", "No body")]
)
def test_an_outline_that_cannot_be_is_refused(tmp_path, name, message):
    spring = tj.Quadratic(np.eye(3))
    bodies = [tj.Body("a"), tj.Body("b", (0.0, 1.0, 0.0))]
    hinge = tj.Hinge("h", "a", "b", spring, at=(0.0, 0.5, 0.0))
    mechanism = tj.Mechanism(bodies, [hinge], held=["a"])
    with pytest.raises(ValueError, match=message):
        tj.save_outline(mechanism, tmp_path / name)


def test_a_script_for_exudyn_is_whole(tmp_path):
    """It compiles, and has what was given; run where EXUDYN is installed."""
    linkage = four_bar.four_bar()
    loads = [tj.Load("3", (0.0, 0.002, -0.001), at=(0.01, 0.0))]
    script = tj.exudyn_script(linkage, loads=loads, drives=[tj.Drive("2", angle=1e-4)])
    compile(script, "linkage.py", "exec")
    scope = {}
    for name in ("BODIES", "HINGES", "GIVEN", "LOADS"):
        start = script.index(f"{name} = ")
        end = script.index("\n\n" if name == "LOADS" else "\n#", start)
        exec(script[start:end], scope)
    np.testing.assert_array_equal(list(scope["BODIES"].values()), linkage.rest)
    assert ("2", 0, 1e-4) in scope["GIVEN"] and len(scope["GIVEN"]) == 4
    assert scope["LOADS"] == [("3", [0.0, 0.002, -0.001], [0.01, 0.0], False)]
    first, second, at, stiffness = scope["HINGES"]["B"]
    assert (first, second) == ("2", "3")
    assert_close(at, linkage.at[1])
    assert_close(np.array(stiffness), linkage.couplings.energy_of(1).stiffness)


def test_exudyn_finds_the_same_small_displacements(tmp_path):
    """With loads and drives so small that its linear springs are the same."""
    pytest.importorskip("exudyn")
    linkage = four_bar.four_bar("mixed")
    given = {
        "loads": [tj.Load("3", (0.0, 2e-6, -1e-6), at=(0.01, 0.0))],
        "drives": [tj.Drive("2", angle=1e-7)],
    }
    path = tmp_path / "linkage.py"
    path.write_text(tj.exudyn_script(linkage, **given))
    done = subprocess.run([sys.executable, path], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    rows = [line.split()[1:] for line in done.stdout.splitlines()[1:]]
    found = np.array(rows, float)
    moved = np.asarray(tj.equilibrium(linkage, **given).displacements)
    np.testing.assert_allclose(found, moved, rtol=1e-5, atol=1e-5 * np.abs(moved).max())
