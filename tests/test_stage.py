"""The micropositioning stage against numbers of fifty digits and of an experiment.

`reference/stage.json` was computed independently: Newton's method in fifty digits, which
three other engines met to 1e-6.
"""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close

import twistorjax as tj
from twistorjax.examples import stage


pytestmark = pytest.mark.slow


REFERENCE = json.loads((Path(__file__).parent / "reference" / "stage.json").read_text())


@pytest.fixture(scope="module")
def moved():
    return stage.amplify(stage.microstage())


def test_the_gain(moved, validated):
    np.testing.assert_allclose(moved.gain, REFERENCE["gain"], rtol=1e-10)
    oracle = "a derivation of its own, minimised by Newton's method in NumPy"
    validated("The stage", "gain", moved.gain, REFERENCE["gain"], oracle)


def test_both_energies_give_the_same_gain_to_seven_digits(moved):
    by_twist = stage.amplify(stage.microstage(coordinates="twist"))
    np.testing.assert_allclose(by_twist.gain, moved.gain, rtol=2e-7)
    assert by_twist.gain != moved.gain


def test_the_displacements(moved):
    for body, (x, y, angle) in REFERENCE["displacements_m_m_rad"].items():
        actual = moved.equilibrium.displacement(body)
        np.testing.assert_allclose(actual, [angle, x, y], rtol=1e-9, atol=1e-18)


def test_force_compression_and_energy(moved):
    for actual, expected in (
        (moved.input_force, REFERENCE["input_force_N"]),
        (moved.compression, REFERENCE["compression_of_hinge_a_m"]),
        (moved.equilibrium.energy, REFERENCE["strain_energy_J"]),
    ):
        np.testing.assert_allclose(actual, expected, rtol=3e-6)  # as printed there


def test_the_drive_does_the_work_that_the_hinges_store():
    """Half force times travel, in the limit of small travels."""
    small = stage.amplify(stage.microstage(), travel=1e-9)
    work = small.input_force * 1e-9 / 2
    np.testing.assert_allclose(small.equilibrium.energy, work, rtol=1e-6)


@pytest.mark.parametrize("derivative", [jax.grad, jax.jacfwd], ids=["reverse", "forward"])
def test_the_gain_by_the_web(derivative):
    slope = derivative(lambda web: stage.amplify(stage.microstage(web)).gain)(
        jnp.array(stage.WEB)
    )
    np.testing.assert_allclose(slope, REFERENCE["dgain_dweb_per_m"], rtol=2e-8)


def test_the_tolerance_of_the_web_is_worth_more_than_the_experiment_tells():
    """25 um on a web of 250 um move the gain by 1.26: no model can be told by 0.3."""
    low, high = (
        stage.amplify(stage.microstage(stage.WEB + error)).gain
        for error in (25e-6, -25e-6)
    )
    assert_close((high - low) / 2, 1.26, digits=2)
    assert low < stage.MEASURED_GAIN[0] < stage.MEASURED_GAIN[1] < high


def test_rigid_levers_on_pins():
    """The limit of hinges that only turn: from the lever arms of the drawing."""
    amplification = (44 - 3) / (44 - 35) * (24 - 0) / (3 - 0)
    assert_close(amplification, stage.RIGID_GAIN)
    assert_close(REFERENCE["rigid_lever_gain"], amplification, digits=8)

    def gain(factor):
        mechanism = stage.microstage()
        (stack,) = mechanism.hinge_assembly.groups
        stretched = stack.energy.stiffness * jnp.array([1.0, factor, factor])[None]
        stiff = tj.Quadratic(stretched)
        bodies = [
            tj.Body(name, reference)
            for name, reference in zip(mechanism.names, mechanism.reference, strict=True)
        ]
        hinges = [
            tj.Hinge(name, mechanism.names[a], mechanism.names[b], stiff, at)
            for name, (a, b), at in zip(
                mechanism.hinge_names,
                mechanism.hinge_assembly.ends,
                mechanism.at,
                strict=True,
            )
        ]
        fixed = {"1": ("angle", "x", "y"), "6": ("angle", "y")}
        rigid = tj.Mechanism(bodies, hinges, fixed)
        small = tj.linearize(rigid, {"6": ["x"]})
        return small(drives=[tj.Drive("6", x=1.0)]).displacement("4")[1]

    shortfalls = [amplification - gain(factor) for factor in (1e3, 1e5)]
    assert 0 < shortfalls[1] < shortfalls[0] / 80  # as one over the stiffness
    assert_close(gain(1e5) + shortfalls[1], amplification)


def test_masses_are_those_of_the_listing():
    mechanism = stage.microstage()
    for body, expected in REFERENCE["bodies"].items():
        row = mechanism.index(body)
        np.testing.assert_allclose(mechanism.masses[row], expected["mass_kg"])
        np.testing.assert_allclose(mechanism.inertias[row], expected["inertia_kg_m2"])
        np.testing.assert_allclose(mechanism.reference[row, 1:], expected["position_m"])


def test_hinges_are_those_of_the_listing():
    mechanism = stage.microstage()
    for name, (first, second, x, y) in REFERENCE["hinges_m"].items():
        row = mechanism.hinge_names.index(name)
        ends = {mechanism.names[body] for body in mechanism.hinge_assembly.ends[row]}
        assert ends == {str(first), str(second)}
        np.testing.assert_allclose(mechanism.at[row], [0.0, x, y])


def test_a_batch_of_webs_is_the_loop_over_them():
    webs = jnp.linspace(0.2e-3, 0.4e-3, 5)

    def gain(web):
        return stage.amplify(stage.microstage(web), throw=False).gain

    loop = jnp.stack([gain(web) for web in webs])
    np.testing.assert_allclose(jax.vmap(gain)(webs), loop, rtol=1e-12)


def test_a_web_out_of_range_is_refused_by_name():
    with pytest.raises(ValueError, match=r"`web / hole` is 0\.0333333, but the formula"):
        stage.microstage(0.1e-3)


def test_large_travels_need_no_guessing():
    """A thousand times the experiment's travel turns the levers by half a radian."""
    far = stage.amplify(stage.microstage(), travel=1e-3)
    assert abs(far.equilibrium.displacement("3")[0]) > 0.5
    np.testing.assert_allclose(
        stage.microstage().wrenches(far.equilibrium.poses)[3], np.zeros(3), atol=1e-6
    )
