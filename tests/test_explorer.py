"""Sliders: what the drawing and the curve show is the equilibrium of the design."""

import json
import re
import shutil
import subprocess

import numpy as np
import pytest
from helpers import assert_close

import twistorjax as tj


LENGTH, WIDTH, MODULUS = 50e-3, 10e-3, 210e9
STEEL = tj.Material(modulus=MODULUS, poisson=0.3)
PARAMETERS = {
    "thickness": tj.Parameter(0.5e-3, "m", lower=0.28e-3, upper=0.7e-3),
    "force": tj.Parameter(0.1, "N", lower=-1.0, upper=1.0),
    "name": "tip",  # a constant
}


def spring(design):
    leaf = tj.flexures.leaf(
        STEEL, length=LENGTH, thickness=design["thickness"], width=WIDTH
    )
    square = 2e-3 * np.array([(0.0, -1.0), (2.0, -1.0), (2.0, 1.0), (0.0, 1.0)])
    bodies = [tj.Body("wall"), tj.Body("tip", (0.0, LENGTH, 0.0), outline=square)]
    hinge = tj.Hinge("leaf", "wall", "tip", leaf, at=(0.0, LENGTH / 2, 0.0))
    push = tj.Load(design["name"], force=(0.0, design["force"]))
    return tj.Mechanism(bodies, [hinge], fixed=["wall"]), {"loads": [push]}


def height(mechanism, solution):
    return 1e3 * solution.displacement("tip")[2]


@pytest.fixture(scope="module")
def explorer():
    return tj.explore(spring, PARAMETERS, {"y (mm)": height})


def deflection(thickness, force):
    """Compute the deflection of a cantilever beam; m."""
    return 4 * force * LENGTH**3 / (MODULUS * WIDTH * thickness**3)


def test_the_widget_answers_a_slider_with_the_equilibrium(explorer):
    widget = explorer.widget
    thickness, unit = (widget.page["sliders"][0][key] for key in ("value", "unit"))
    assert (thickness, unit) == (500.0, "µm")
    widget.request = {"number": 1, "values": [400.0, 0.05], "over": 1}
    state = widget.state
    expected = 1e3 * deflection(0.4e-3, 0.05)
    # the leaf is exact to second order in its rotation
    np.testing.assert_allclose(state["outputs"], [expected], rtol=2e-3)
    forces = np.linspace(-1.0, 1.0, len(state["at"]))
    assert_close(state["at"], forces)
    straight = np.abs(forces) < 0.1
    curve = np.array(state["along"])[straight, 0]
    straight_beam = 1e3 * deflection(0.4e-3, forces[straight])
    np.testing.assert_allclose(curve, straight_beam, rtol=2e-3)
    # The first shapes are the square of the tip, undisplaced and displaced; its center is
    # 2 mm beyond the tip.
    kinds, counts = zip(*widget.page["shapes"], strict=True)
    squares = [k for k, count in enumerate(counts) if count == 4]
    assert [kinds[k] for k in squares] == ["reference", "body"]
    corners = np.split(np.array(state["points"]).reshape(-1, 2), np.cumsum(counts)[:-1])
    moved = np.mean(corners[squares[1]] - corners[squares[0]], axis=0)
    angle = 1.5 * expected / (1e3 * LENGTH)
    np.testing.assert_allclose(moved[1], expected + 2 * angle, rtol=5e-3)


def test_a_mechanism_is_shown_without_a_curve():
    widget = tj.explore(spring, PARAMETERS).widget
    widget.request = {"number": 1, "values": [500.0, 0.0], "over": 1}
    assert widget.state["outputs"] == [] and widget.state["points"]


def test_a_design_without_an_equilibrium_is_explained(explorer):
    widget = explorer.widget
    widget.request = {"number": 2, "values": [1e-6, 1.0], "over": 0}
    assert widget.state["points"] == [] and widget.state["outputs"] == [None]
    assert len(widget.state["message"]) > 20


BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))),
    None,
)
PROBE = """<script type="module">
const pause = () => new Promise((done) => setTimeout(done, 20));
const shape = () => document.querySelectorAll(".tj-explorer path")[2].getAttribute("d");
const slide = async (slider, value) => {
    slider.value = value;
    slider.dispatchEvent(new Event("input"));
    await pause();
    const circle = document.querySelector("circle");
    return { text: slider.parentElement.textContent, shape: shape(),
             at: [circle.cx.baseVal.value, circle.cy.baseVal.value] };
};
const sliders = document.querySelectorAll("input[type=range]");
const found = [sliders[0].parentElement.textContent];
found.push(await slide(sliders[1], 0), await slide(sliders[1], 4));
found.push(await slide(sliders[0], 4));
const text = JSON.stringify(found);
document.body.append(Object.assign(document.createElement("pre"), { textContent: text }));
</script></html>"""


@pytest.mark.skipif(BROWSER is None, reason="There is no browser.")
def test_a_page_without_python_follows_its_sliders(explorer, tmp_path):
    page = tmp_path / "spring.html"
    explorer.save(page, levels=5)
    page.write_text(page.read_text().replace("</html>", PROBE))
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run"]
    command += [f"--user-data-dir={tmp_path}/user", "--virtual-time-budget=5000"]
    command += ["--dump-dom", page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    start, low, high, thick = json.loads(re.findall("<pre>(.*)</pre>", done.stdout)[0])
    assert start == "thickness500 µm"
    assert [low["text"], thick["text"]] == ["force-1 N", "thickness700 µm"]
    # The tip moves up with the force, and less if the leaf is thick.
    tops = [
        np.array(re.findall(r"[-\d.e]+", found["shape"]), float).reshape(-1, 2)[:, 1]
        for found in (low, high, thick)
    ]
    # y points down. Between -1 N and 1 N, the thin tip moves by 2, and the thick one at
    # 1 N is displaced by the ratio of the thicknesses to the power of three.
    assert np.mean(tops[1]) < np.mean(tops[2]) < np.mean(tops[0])
    displaced = np.mean(tops[0]) - np.array([np.mean(tops[1]), np.mean(tops[2])])
    thin = displaced[0] / 2
    np.testing.assert_allclose((displaced[1] - thin) / thin, (5 / 7) ** 3, rtol=0.02)
    assert low["at"][0] < high["at"][0] and low["at"][1] > high["at"][1]


@pytest.mark.parametrize(
    ("build", "parameters", "message"),
    [
        (spring, {"thickness": 0.5e-3}, "has no `Parameter`"),
        (spring, {"thickness": tj.Parameter(0.5e-3, "m", lower=0)}, "with both bounds"),
        (lambda _: "guide", PARAMETERS, "`build` returned 'guide'"),
    ],
)
def test_what_cannot_be_explored_is_refused(build, parameters, message):
    with pytest.raises(ValueError, match=message):
        tj.explore(build, parameters, {})


def test_a_curve_is_one_number():
    with pytest.raises(ValueError, match=r"`curves\['tip'\]` has shape \(3,\)"):
        tj.explore(spring, PARAMETERS, {"tip": lambda _, at: at.displacement("tip")})


def test_a_page_of_too_many_states_is_refused(explorer, tmp_path):
    with pytest.raises(ValueError, match="which gives 40,000 states of 2 parameters"):
        explorer.save(tmp_path / "spring.html", levels=200)
    with pytest.raises(ValueError, match=r"must end with \.html"):
        explorer.save(tmp_path / "spring.htm")


def test_displacements_may_be_magnified():
    moved = []
    for magnify in (1.0, 3.0):
        explorer = tj.explore(spring, PARAMETERS, magnify=magnify)
        explorer.widget.request = {"number": 1, "values": [500.0, 0.1], "over": 1}
        counts = [count for _, count in explorer.widget.page["shapes"]]
        points = np.array(explorer.widget.state["points"]).reshape(-1, 2)
        corners = np.split(points, np.cumsum(counts)[:-1])
        # The square of the tip at rest, and displaced
        rest, displaced = (part for part in corners if len(part) == 4)
        moved.append(np.mean(displaced - rest, axis=0)[1])
    np.testing.assert_allclose(moved[1], 3 * moved[0], rtol=1e-4)


@pytest.mark.untyped
def test_wrong_arguments_are_explained():
    with pytest.raises(ValueError, match=r"`curves` is .* must be a mapping from names"):
        tj.explore(spring, PARAMETERS, height)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="`build` is a function that JAX cannot compile"):
        tj.explore(spring, PARAMETERS, {"y": lambda _, at: float(at.energy)})
