"""The micropositioning stage against a solution with fifty digits and an experiment.

`reference/stage.json` was computed independently by Newton's method with fifty digits.
Three other programs agree with it to 1e-6.
"""

import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, mostly_slow

import twistorjax as tj
from twistorjax.examples import stage


REFERENCE = json.loads((Path(__file__).parent / "reference" / "stage.json").read_text())


@pytest.fixture(scope="module")
def result():
    return stage.amplification(stage.microstage())


def test_gain(result, validated):
    np.testing.assert_allclose(result.gain, REFERENCE["gain"], rtol=1e-10)
    oracle = "an independent derivation, minimized by Newton's method in NumPy"
    validated("The stage", "gain", result.gain, REFERENCE["gain"], oracle)


def test_energies_of_twist_and_twistor_give_nearly_the_same_gain(result):
    by_twist = stage.amplification(stage.microstage(coordinates="twist"))
    np.testing.assert_allclose(by_twist.gain, result.gain, rtol=2e-7)
    assert by_twist.gain != result.gain


def test_displacements(result):
    for body, (x, y, angle) in REFERENCE["displacements_m_m_rad"].items():
        actual = result.equilibrium.displacement(body)
        np.testing.assert_allclose(actual, [angle, x, y], rtol=1e-9, atol=1e-18)


def test_force_elongation_and_energy(result):
    printed_digits = 3e-6  # of the reference
    for actual, expected in (
        (result.input_force, REFERENCE["input_force_N"]),
        (result.elongation, REFERENCE["elongation_of_hinge_a_m"]),
        (result.equilibrium.energy, REFERENCE["strain_energy_J"]),
    ):
        np.testing.assert_allclose(actual, expected, rtol=printed_digits)


def test_the_hinges_store_the_work_of_the_input_force():
    """For a small input displacement, the work is half the force times displacement."""
    small = stage.amplification(stage.microstage(), travel=1e-9)
    work = small.input_force * 1e-9 / 2
    np.testing.assert_allclose(small.equilibrium.energy, work, rtol=1e-6)


@pytest.mark.parametrize(
    "derivative", mostly_slow([jax.grad, jax.jacfwd]), ids=["reverse", "forward"]
)
def test_derivative_of_the_gain_by_the_web(derivative):
    gain = derivative(lambda web: stage.amplification(stage.microstage(web)).gain)
    slope = jax.jit(gain)(stage.WEB)
    np.testing.assert_allclose(slope, REFERENCE["dgain_dweb_per_m"], rtol=2e-8)


def test_the_tolerance_of_the_web_exceeds_the_uncertainty_of_the_measured_gain():
    """An error of 25 um of a web of 250 um changes the gain by 1.26.

    The measured gains differ by 0.3, so they cannot distinguish two models.
    """

    def gain(web_error):
        return stage.amplification(stage.microstage(stage.WEB + web_error)).gain

    low, high = float(gain(25e-6)), float(gain(-25e-6))
    assert_close((high - low) / 2, 1.26, digits=2)
    assert low < stage.MEASURED_GAIN[0] < stage.MEASURED_GAIN[1] < high


def test_the_gain_of_stiff_hinges_approaches_that_of_rigid_levers_on_pins():
    """The limit follows from the lever arms of the drawing."""
    amplification = (44 - 3) / (44 - 35) * (24 - 0) / (3 - 0)
    assert_close(amplification, stage.RIGID_GAIN)
    assert_close(REFERENCE["rigid_lever_gain"], amplification, digits=8)

    def gain(factor):
        """The gain with axial and transverse stiffnesses multiplied by a factor."""
        mechanism = stage.microstage()
        (group,) = mechanism.hinge_assembly.groups
        assert isinstance(group.energy, tj.Quadratic)
        stiffness = np.asarray(group.energy.stiffness) * [1.0, factor, factor]
        energy = tj.Quadratic(stiffness)
        references = np.asarray(mechanism.reference)
        bodies = [
            tj.Body(name, reference)
            for name, reference in zip(mechanism.names, references, strict=True)
        ]
        hinges = [
            tj.Hinge(name, mechanism.names[first], mechanism.names[second], energy, at)
            for name, (first, second), at in zip(
                mechanism.hinge_names,
                mechanism.hinge_assembly.ends,
                np.asarray(mechanism.at),
                strict=True,
            )
        ]
        fixed = {"1": ("angle", "x", "y"), "6": ("angle", "y")}
        stiff = tj.Mechanism(bodies, hinges, fixed)
        linear = tj.linearize(stiff, {"6": ["x"]})
        displacement = linear(drives=[tj.Drive("6", x=1.0)]).displacement("4")
        return np.asarray(displacement)[1]

    errors = [amplification - gain(factor) for factor in (1e3, 1e5)]
    assert 0 < errors[1] < errors[0] / 80  # inversely proportional to the stiffness


def test_bodies_are_those_of_the_listing():
    mechanism = stage.microstage()
    for body, expected in REFERENCE["bodies"].items():
        row = mechanism.index(body)
        mass, inertia = mechanism.masses[row], mechanism.inertias[row]
        assert mass is not None and inertia is not None
        np.testing.assert_allclose(mass, expected["mass_kg"])
        np.testing.assert_allclose(inertia, expected["inertia_kg_m2"])
        position = np.asarray(mechanism.reference)[row, 1:]
        np.testing.assert_allclose(position, expected["position_m"])


def test_hinges_are_those_of_the_listing():
    mechanism = stage.microstage()
    for name, (first, second, x, y) in REFERENCE["hinges_m"].items():
        row = mechanism.hinge_names.index(name)
        ends = {mechanism.names[body] for body in mechanism.hinge_assembly.ends[row]}
        assert ends == {str(first), str(second)}
        np.testing.assert_allclose(np.asarray(mechanism.at)[row], [0.0, x, y])


@pytest.mark.slow
def test_a_batch_of_webs_equals_a_loop_over_them():
    webs = jnp.linspace(0.2e-3, 0.4e-3, 5)

    def gain(web):
        return stage.amplification(stage.microstage(web), throw=False).gain

    loop = jnp.stack([gain(web) for web in webs])
    np.testing.assert_allclose(jax.vmap(gain)(webs), loop, rtol=1e-12)


def test_a_web_outside_the_range_of_the_formula_raises_an_error():
    with pytest.raises(ValueError, match=r"`web / hole` is 0\.0333333, but the formula"):
        stage.microstage(0.1e-3)


def test_a_large_input_displacement_needs_no_initial_guess():
    """Body 3 rotates by half a radian at 700 times the displacement of the experiment."""
    with pytest.warns(UserWarning, match="of the hinge 'a' is .* times"):
        result = stage.amplification(stage.microstage(), travel=1e-3)
    assert abs(np.asarray(result.equilibrium.displacement("3"))[0]) > 0.5
    wrenches = eqx.filter_jit(stage.microstage().wrenches)(result.equilibrium.poses)
    np.testing.assert_allclose(np.asarray(wrenches)[3], np.zeros(3), atol=1e-6)
