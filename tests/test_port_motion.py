"""Gain, parasitic motion, lost motion, and stiffness of ports along their travel."""

import json
import pathlib

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from helpers import assert_close

import twistorjax as tj
from twistorjax.examples import stage
from twistorjax.geometry import se2


REFERENCE = json.loads(
    (pathlib.Path(__file__).parent / "reference" / "beams.json").read_text()
)
UNIT = tj.Material(modulus=1.0, poisson=0.3)


def surrogate(slenderness, rotation):
    """Return a leaf of unit length and unit bending stiffness, without shear."""
    thickness = np.sqrt(12 / slenderness)
    beam = tj.flexures.Beam(
        UNIT, length=1.0, thickness=thickness, width=12 / thickness**3, shear_factor=1e6
    )
    return tj.flexures.surrogate(beam, rotation=rotation, order=6)


@pytest.fixture(scope="module")
def parallelogram():
    """Return the parallelogram of the reference: EA L^2 / EI = 30,000, spacing 0.6 L."""
    leaf = surrogate(30_000, 0.2)
    hinges = [
        tj.Hinge(name, "ground", "stage", leaf, at=(0.0, -0.5, y))
        for name, y in (("lower", -0.3), ("upper", 0.3))
    ]
    bodies = [tj.Body("ground"), tj.Body("stage")]
    return tj.Mechanism(bodies, hinges, fixed=["ground"])


@pytest.fixture(scope="module")
def displaced(parallelogram):
    """Return equilibria of the parallelogram, for each displacement of the reference."""
    rows = REFERENCE["parallelogram_w0.3_k33_30000"]["rows"]
    return {
        travel: tj.equilibrium(parallelogram, drives=[tj.Drive("stage", y=travel)])
        for travel in (0.05, *(row[0] for row in rows))
    }


@pytest.mark.slow
def test_force_and_parasitic_motion_of_a_parallelogram_are_those_of_exact_beams(
    displaced, validated
):
    ratios, travel = np.ones(3), 0.0
    for row in REFERENCE["parallelogram_w0.3_k33_30000"]["rows"]:
        travel, *expected, _ = row  # force, axial motion, rotation
        state = displaced[travel]
        reaction, moved = map(
            np.asarray, (state.reaction("stage"), state.displacement("stage"))
        )
        actual = [reaction[2], *moved[1::-1]]
        np.testing.assert_allclose(actual, expected, rtol=2e-3)
        ratios = np.array(actual) / expected
    what = f"parallel guide displaced by {travel:g} L: force, change of height, rotation"
    exact = np.ones(3)
    validated("Surrogates of leaves", what, ratios, exact, "exact beams, by SciPy")


@pytest.mark.slow
def test_stiffness_of_a_displaced_parallelogram_along_its_leaves(
    parallelogram, displaced, validated
):
    """It falls with the displacement. The reference has secants over forces of +-5."""
    column = REFERENCE["parallelogram_w0.3_k33_30000"]["rows"]
    travel, stiffness, along = 0.0, 0.0, jnp.zeros(())
    for travel, stiffness in [(0.05, 54_019), *((row[0], row[-1]) for row in column)]:
        state = displaced[travel]
        push = tj.Load("stage", force=(0.0, state.reaction("stage")[2]))
        port = tj.port_compliance(parallelogram, "stage", about=state, loads=[push])
        along = port.stiffness_along("x", held=["y"])
        np.testing.assert_allclose(along, stiffness, rtol=5e-3)
    what = f"axial stiffness of a parallel guide displaced by {travel:g} L"
    validated("Ports", what, along, stiffness, "exact beams, by SciPy")


@pytest.mark.slow
def test_parasitic_motion_of_a_parallelogram_is_that_of_exact_beams(parallelogram):
    """The forces, rotations, and axial displacements of the reference."""
    rows = REFERENCE["parallelogram_w0.3_k33_30000"]["rows"]
    drive = tj.Drive("stage", y=0.1)
    motion = tj.port_motion(
        parallelogram, "stage", direction="y", drive=drive, rigid_gain=1.0
    )
    for travel, force, axial, rotation, _ in rows:
        (k,) = np.flatnonzero(np.isclose(motion.travel, travel))
        assert_close(motion.gain[k], 1.0, digits=12)
        np.testing.assert_allclose(motion.force[k], force, rtol=2e-3)
        np.testing.assert_allclose(motion.parasitic["x"][k], axial, rtol=2e-3)
        np.testing.assert_allclose(motion.parasitic["angle"][k], rotation, rtol=2e-3)
    np.testing.assert_allclose(motion.lost_motion, 0.0, atol=1e-15)


@pytest.mark.slow
def test_center_of_a_cross_spring_pivot_is_that_of_exact_beams(validated):
    """The center of rotation of a pivot whose leaves cross in their middle.

    The instantaneous center belongs to the shift of the reference and its derivative.
    """
    given = np.array(REFERENCE["cross_spring_pivot_90deg"]["lambda_0.5"])
    axes = np.pi / 2 + np.array([1, -1]) * np.pi / 4
    leaf = surrogate(12 / 3e-4**2, 0.81)
    hinges = [
        tj.Hinge(str(k), "ground", "stage", leaf, at=(axis, 0.0, 0.0))
        for k, axis in enumerate(axes)
    ]
    pivot = tj.Mechanism([tj.Body("ground"), tj.Body("stage")], hinges, fixed=["ground"])
    motion = tj.port_motion(
        pivot,
        "stage",
        direction="angle",
        drive=tj.Drive("stage", angle=np.radians(40)),
        positions=9,
    )
    for degrees, stiffness, *shift in given:
        (k,) = np.flatnonzero(np.isclose(np.degrees(motion.travel), degrees))
        secant = motion.force[k] / motion.travel[k]
        np.testing.assert_allclose(secant, stiffness, rtol=2e-4)
        size = float(np.linalg.norm(shift))
        np.testing.assert_allclose(motion.displacement[k, 1:], shift, atol=5e-3 * size)
    # To third order, the shift is (c t^3, b t^2), with the two coefficients at 5 degrees.
    t = motion.travel[1]
    slope = np.array([3, 2]) * given[0, 2:] / t
    exact = given[0, 2:] + np.array([-slope[1], slope[0]])
    np.testing.assert_allclose(motion.center[1], exact, rtol=1e-2, atol=1e-4)
    validated(
        "Ports", "cross-spring pivot, 40°: center shift", motion.displacement[-1, 1:],
        given[-1, 2:], "exact beams, by SciPy",
    )  # fmt: skip


@pytest.mark.slow
def test_lost_motion_of_the_stage_is_the_loss_of_its_gain():
    """Rigid levers on pins would have the gain 328 / 9; the notches have 27.63."""
    drive = tj.Drive("6", x=stage.TRAVEL)
    motion = tj.port_motion(stage.microstage(), "4", direction="x", drive=drive)
    assert_close(motion.rigid_gain, stage.RIGID_GAIN, digits=9)
    lost = stage.TRAVEL - motion.output[-1] / stage.RIGID_GAIN
    assert_close(motion.lost_motion[-1] / lost, 1.0, digits=9)
    assert 0.24 < lost / stage.TRAVEL < 0.25
    np.testing.assert_allclose(motion.force[-1], 30.53, atol=5e-3)
    text = repr(motion)
    assert "gain of the rigid mechanism 36.4444" in text
    assert len(text.splitlines()) == 2 + 1 + 11 + 1
    assert motion.to_xarray()["lost_motion"].attrs["units"] == "m"
    figure = tj.plotting.draw_port_motion(motion)
    plt.close(figure)


def tilted_lever(stiffness=50.0):
    """Return a lever with a tilted frame on a hinge that couples all coordinates."""
    matrix = np.array([[2.0, 3.0, 1.0], [3.0, 0.0, 5.0], [1.0, 5.0, 80.0]])
    matrix = matrix + np.diag([0.0, 1.0, 0.0]) * stiffness
    hinge = tj.Hinge("hinge", "base", "lever", tj.Quadratic(matrix), at=(0.3, 0.1, 0.2))
    bodies = [tj.Body("base"), tj.Body("lever", (0.7, 0.4, -0.1))]
    return tj.Mechanism(bodies, [hinge], fixed=["base"])


PORT = (0.5, 0.3, -0.2)
TURN = tj.Drive("lever", angle=0.4)


def test_the_center_of_a_translation_is_not_printed():
    spring = tj.Quadratic(np.diag([2.0, 50.0, 80.0]))
    hinge = tj.Hinge("spring", "base", "table", spring, at=(0, 0, 0))
    guide = tj.Mechanism([tj.Body("base"), tj.Body("table")], [hinge], fixed=["base"])
    slide = tj.Drive("table", x=0.1)
    *_, last, note = repr(
        tj.port_motion(guide, "table", direction="x", drive=slide, positions=2)
    ).splitlines()
    assert last.split()[-2:] == ["-", "-"] and "in the axes of the port" in note


@pytest.fixture(scope="module")
def turned():
    """Motion of a port on the lever, at 401 positions."""
    return tj.port_motion(
        tilted_lever(), "lever", PORT, direction="y", drive=TURN, positions=401
    )


def test_displacements_and_centers_are_those_of_the_poses(turned):
    """Composition of poses, and the pole of a small displacement, as oracles."""
    mechanism, motion = tilted_lever(), turned
    states = [
        tj.equilibrium(mechanism, drives=[tj.Drive("lever", angle=angle)])
        for angle in (0.0, 0.2, 0.202)
    ]

    @jax.jit
    def expected(*poses):
        start, middle, after = (se2.compose(pose, jnp.array(PORT)) for pose in poses)
        pole = se2.pole(se2.compose(after, se2.inverse(middle)))  # in the world
        return se2.between(start, middle), se2.rotate(-start[0], pole - start[1:])

    displacement, center = expected(*(state.pose("lever") for state in states))
    found = np.asarray(motion.displacement)
    assert_close(found[200], displacement, digits=11)
    quotient = (found[201] - found[199]) / 0.002
    assert_close(np.asarray(motion.rate)[200], quotient, digits=5)
    np.testing.assert_allclose(np.asarray(motion.center)[201], center, atol=2e-3)


@pytest.mark.slow
def test_a_stroke_is_an_input():
    """A stage between an actuator and a spring; the travel is the stroke."""
    actuator = tj.Quadratic(np.diag([1.0, 300.0, 1.0]))
    spring = tj.Quadratic(np.diag([1.0, 100.0, 1.0]))
    hinges = [
        tj.Hinge("actuator", "wall", "stage", actuator, (0, 0, 0), damping=0.1),
        tj.Hinge("spring", "stage", "wall", spring, (0, 0, 0)),
    ]
    bodies = [tj.Body("wall"), tj.Body("stage")]
    mechanism = tj.Mechanism(bodies, hinges, fixed=["wall"])
    motion = tj.port_motion(
        mechanism, "stage", direction="x", strokes={"actuator": (0, -2e-3, 0)},
        rigid_gain=-1.0,
    )  # fmt: skip
    np.testing.assert_allclose(motion.gain, -0.75, rtol=1e-12)
    assert_close(1e3 * motion.lost_motion[-1], 0.5, digits=12)
    np.testing.assert_allclose(motion.force, 75.0 * motion.travel, rtol=1e-12)


def test_gains_are_differentiable_and_batched(turned):
    def gain(stiffness):
        motion = tj.port_motion(
            tilted_lever(stiffness), "lever", PORT, direction="y", drive=TURN,
            positions=3, throw=False,
        )  # fmt: skip
        return motion.gain[-1]

    differentiate = jax.jit(jax.vmap(jax.value_and_grad(gain)))
    values, slopes = map(np.asarray, differentiate(np.array([50.0, 49.99, 50.01])))
    assert_close(values[0], np.asarray(turned.gain)[-1], digits=12)
    assert_close(slopes[0] / ((values[2] - values[1]) / 0.02), 1.0, digits=6)


def test_inputs_that_are_not_one_coordinate_are_refused(turned):
    mechanism, both = tilted_lever(), tj.Drive("lever", x=0.1, y=0.1)
    with pytest.raises(ValueError, match="There must be one input"):
        tj.port_motion(mechanism, "lever", direction="x")
    with pytest.raises(ValueError, match="prescribes x, y of 'lever'"):
        tj.port_motion(mechanism, "lever", direction="x", drive=both)
    with pytest.raises(ValueError, match="has no translation"):
        tj.port_motion(mechanism, "lever", direction="x", strokes={"hinge": (0.1, 0, 0)})
    with pytest.raises(ValueError, match="2 actuators"):
        strokes = {"hinge": (0, 1, 0), "other": (0, 1, 0)}
        tj.port_motion(mechanism, "lever", direction="x", strokes=strokes)
    with pytest.raises(ValueError, match="Give `rigid_gain`"):
        _ = turned.lost_motion


@pytest.mark.release
def test_a_position_without_equilibrium_is_reported():
    leaf = tj.flexures.surrogate(
        tj.flexures.Beam(UNIT, length=1.0, thickness=0.1, width=12e3), rotation=0.1
    )
    hinge = tj.Hinge("leaf", "base", "table", leaf, at=(0, 0, 0))
    bodies = [tj.Body("base"), tj.Body("table")]
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["base"])
    drive = tj.Drive("table", angle=0.4)
    with pytest.raises(RuntimeError, match="outside the validity range"):
        tj.port_motion(mechanism, "table", direction="angle", drive=drive)
    motion = tj.port_motion(
        mechanism, "table", direction="angle", drive=drive, throw=False
    )
    np.testing.assert_array_equal(motion.succeeded, np.isfinite(motion.output))
    assert 1 < int(jnp.sum(motion.succeeded)) < 11


def test_a_travel_in_the_negative_direction_begins_at_zero():
    drive = tj.Drive("6", x=-1.35e-6)
    motion = tj.port_motion(
        tj.examples.stage.microstage(), "4", direction="x", drive=drive, positions=3
    )
    table = [line.split() for line in str(motion).splitlines()[3:6]]
    assert [row[0] for row in table] == ["0", "-6.75e-07", "-1.35e-06"]
