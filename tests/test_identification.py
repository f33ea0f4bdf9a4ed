"""Identification: estimates, optimizers, bounds, and the checks of the arguments."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix as optx
import pytest
import scipy.optimize
from helpers import assert_close, mostly_slow
from identification_helpers import (
    body_at,
    FormulaTest,
    free_vibration,
    minimize_formula,
    positive,
    push,
    spring,
    TRUE,
)

import twistorjax as tj
from twistorjax.examples import identification, stage
from twistorjax.identification import BodySensor, HingeTest, StaticTest, VibrationTest


def test_one_stiffness_and_its_standard_error_follow_from_hookes_law():
    """From x = F / k follows dk = k^2 dx / F."""
    data = push(5.0, standard_deviation=1e-4).measurement([[0.04]])
    result = tj.identify(spring, {"along": positive(30.0, "N/m")}, [data])
    assert_close(result.estimates["along"], 125.0, digits=7)
    assert_close(result.standard_errors["along"], 125.0**2 * 1e-4 / 5.0, digits=6)
    assert_close(result.values, [125.0], digits=7)


@pytest.mark.slow
def test_readings_are_weighted_by_their_variances():
    """The compliance is the weighted mean of the single compliances."""
    forces = np.array([1.0, 2.0, 5.0])
    readings = np.array([0.0102, 0.0199, 0.0507])
    deviations = np.array([1e-4, 2e-4, 5e-4])
    data = [
        push(force, deviation).measurement([[reading]])
        for force, reading, deviation in zip(forces, readings, deviations, strict=True)
    ]
    result = tj.identify(spring, {"along": positive(80.0)}, data)
    weights = (forces / deviations) ** 2
    compliance = np.sum(weights * readings / forces) / np.sum(weights)
    assert_close(result.estimates["along"], 1 / compliance, digits=7)
    assert_close(result.covariance[0, 0], compliance**-4 / np.sum(weights), digits=5)


def test_two_parameters_of_a_nonlinear_model_agree_with_scipy():
    """SciPy minimizes the same residuals at large rotations, by finite differences."""
    wrenches = [(0.3, 20.0, 5.0), (0.6, -10.0, 30.0), (-0.2, 5.0, -25.0)]
    sensors = [
        BodySensor("block", "x", 1e-3, at=(0.3, 0.1)),
        BodySensor("block", "y", 1e-3),
    ]
    test = StaticTest([[tj.Load("block", wrench)] for wrench in wrenches], sensors)

    @jax.jit
    def predict(k):
        return test.predict(spring({"rotation": k[0], "along": k[1]}), throw=False)

    exact = np.asarray(predict(np.array([TRUE["rotation"], TRUE["along"]])))
    readings = exact + 1e-3 * np.random.default_rng(0).normal(size=exact.shape)
    start = {"rotation": positive(1.5), "along": positive(60.0)}
    result = tj.identify(spring, start, [test.measurement(readings)])

    def residuals(k):
        return np.ravel(np.asarray(predict(k)) - readings) / 1e-3

    peer = scipy.optimize.least_squares(
        residuals, [1.5, 60.0], x_scale=[1, 60], xtol=1e-15
    )
    estimates = [result.estimates[name] for name in ("rotation", "along")]
    assert_close(estimates, peer.x, digits=6)
    covariance = np.linalg.inv(peer.jac.T @ peer.jac)[::-1, ::-1]
    assert result.names == ("along", "rotation")
    np.testing.assert_allclose(result.covariance, covariance, rtol=1e-4)
    errors = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(errors, errors)
    np.testing.assert_allclose(result.correlation, correlation, rtol=1e-3)


def test_natural_frequencies_determine_stiffnesses():
    """A frequency is the root of stiffness over mass, divided by two pi."""
    test = VibrationTest(3, [0.01, 0.02, 0.03])
    frequencies = np.sqrt([1.0 / 0.1, 100 / 2.0, 400 / 2.0]) / (2 * np.pi)
    start = {name: positive(1.3 * value) for name, value in TRUE.items()}
    result = tj.identify(spring, start, [test.measurement(frequencies[:, None])])
    for name, value in TRUE.items():
        assert_close(result.estimates[name], value, digits=7)
    for (name, value), deviation, frequency in zip(
        TRUE.items(), (0.01, 0.02, 0.03), frequencies, strict=True
    ):
        expected = 2 * value * deviation / frequency
        assert_close(result.standard_errors[name], expected, digits=5)


def test_wrenches_of_a_single_hinge_determine_its_stiffness():
    trials = tj.energies.Trials(
        [[0.0, 0.01, 0.0], [0.0, 0.02, 0.0]],
        [[0.0, 1.1, 0.0], [0.0, 2.0, 0.0]],
        wrench_deviations=[0.1, 0.1, 0.1],
    )
    data = HingeTest.from_trials("spring", trials)
    result = tj.identify(spring, {"along": positive(50.0)}, [data])
    assert_close(result.estimates["along"], (0.011 + 0.04) / 5e-4, digits=6)


def test_missing_readings_are_left_out():
    small_force = tj.Load("block", force=(5e-6, 8e-6))  # it hardly rotates the block
    sensors = [BodySensor("block", name, 1e-10) for name in ("x", "y")]
    test = StaticTest([[small_force]], sensors)
    start = {"along": positive(50.0), "across": positive(500.0)}
    result = tj.identify(spring, start, [test.measurement([[4e-8, np.nan]])])
    assert_close(result.estimates["along"], 125.0, digits=7)
    assert result.reading_count == 1
    assert "across" in result.undetermined_directions[0]


@pytest.fixture(scope="module")
def vibration_data():
    """Noisy measurements of a free vibration of the block."""
    sensors = [BodySensor("block", name, 1e-5) for name in ("angle", "x", "y")]
    times = np.linspace(0.0, 1.0, 21)
    test = free_vibration(times, sensors, velocity=(1.0, 0.3, 0.2), tolerance=1e-8)
    return [test.synthetic_data(spring(TRUE), jax.random.key(3))]


VIBRATION_START = {
    "rotation": positive(1.2),
    "along": positive(80.0),
    "across": positive(500.0),
}


@pytest.fixture(scope="module")
def vibration_result(vibration_data):
    """Identification of three stiffnesses from a free vibration of the block."""
    return tj.identify(spring, VIBRATION_START, vibration_data)


def test_a_motion_determines_all_three_stiffnesses(vibration_result):
    for name, value in TRUE.items():
        error = abs(vibration_result.estimates[name] - value)
        assert error < 4 * vibration_result.standard_errors[name] < 0.02 * value
    assert not vibration_result.warnings
    rms = np.sqrt(np.mean(np.square(vibration_result.residuals[0])))
    assert 0.7 < rms < 1.3


def test_the_jacobian_of_a_motion_agrees_with_finite_differences(vibration_result):
    problem = vibration_result.problem
    residuals = jax.jit(lambda point: problem.residuals(point))
    point, step = np.asarray(vibration_result.normalized), 1e-4
    jacobian = np.asarray(vibration_result.jacobian)
    for change, column in zip(step * np.eye(3), jacobian.T, strict=True):
        forward, backward = (np.asarray(residuals(point + d)) for d in (change, -change))
        difference = (forward - backward) / (2 * step)
        tolerance = 1e-4 * np.max(np.abs(difference))
        np.testing.assert_allclose(column, difference, atol=tolerance)


@pytest.mark.slow
def test_gradients_in_reverse_and_forward_mode_are_equal(vibration_data):
    start = tj.identify(spring, VIBRATION_START, vibration_data, max_steps=1, throw=False)
    forward = start.jacobian.T @ start.residuals[0].reshape(-1)
    reverse = start.problem.evaluate(start.normalized, forward=False)
    np.testing.assert_allclose(reverse.derivatives, forward, rtol=1e-7)


@pytest.mark.parametrize(
    "method",
    mostly_slow(
        [optx.LevenbergMarquardt(1e-9, 1e-9), optx.Dogleg(1e-9, 1e-9), optax.sgd(0.5),
         optax.adam(0.05)],
        fast=2,
    ),
    ids=["marquardt", "dogleg", "sgd", "adam"],
)  # fmt: skip
def test_all_optimizers_find_the_same_minimum(method):
    data = [push(5.0).measurement([[0.04]])]
    result = tj.identify(
        spring, {"along": positive(60.0)}, data, method=method, throw=False
    )
    assert_close(result.estimates["along"], 125.0, digits=4)


def test_gradient_descent_in_reverse_mode_finds_the_minimum_and_its_standard_error():
    test = FormulaTest(lambda k: jnp.stack([5.0 / k[0]]), jnp.array([1e-4]))
    result = tj.identify(
        body_at,
        {"a": positive(100.0), "b": 0.0},
        [test.measurement([[0.04]])],
        method=optax.adam(0.02),
        reverse=True,
        max_steps=400,
        throw=False,
    )
    assert_close(result.estimates["a"], 125.0, digits=4)
    assert_close(result.standard_errors["a"], 125.0**2 * 1e-4 / 5.0, digits=3)


def test_restarts_find_the_smallest_of_several_minima():
    """A search that starts one period of the vibration away ends in another minimum.

    The residuals are those of the free vibration of a mass, in closed form.
    """
    times = np.linspace(0.0, 3.0, 25)

    @jax.jit
    def vibration(stiffness):
        frequency = jnp.sqrt(stiffness / 2.0)
        return jnp.sin(frequency * times) / frequency

    def design(parameters):
        return body_at({"a": parameters["along"], "b": 0.0})

    test = FormulaTest(lambda u: vibration(u[0]), jnp.full(25, 1e-3))
    data = [test.measurement(np.asarray(vibration(100.0))[:, None])]
    start = {"along": positive(190.0)}
    single = tj.identify(design, start, data, throw=False)
    several = tj.identify(
        design, start, data, restarts=8, restart_standard_deviation=0.7, throw=False
    )
    assert abs(single.estimates["along"] / 100 - 1) > 0.1
    assert_close(several.estimates["along"], 100.0, digits=3)
    assert several.losses.shape == (9,)
    assert any("starts ended with a larger loss" in text for text in several.warnings)


@pytest.mark.slow
def test_a_start_without_a_solution_raises_the_error_of_the_solve():
    data = [push(5.0).measurement([[0.04]])]
    too_large = StaticTest(
        [[tj.Load("block", moment=20.0)]], [BodySensor("block", "angle", 1e-3)]
    )
    start = {"rotation": positive(1.0)}
    message = r"a solve fails.*No equilibrium .* was found"
    with pytest.raises(RuntimeError, match=message):
        tj.identify(spring, start, [too_large.measurement([[1.0]]), *data])


@pytest.mark.slow
def test_the_search_rejects_steps_to_points_where_a_solve_fails():
    """The moment of the twistor's spring is at most 2 k, so a softer one buckles."""
    test = StaticTest(
        [[tj.Load("block", moment=1.9)]], [BodySensor("block", "angle", 1e-3)]
    )
    angle = 2 * np.arcsin(1.9 / 2 / 2 / 0.96) * 1.0
    stiffness = 1.9 / 2 / np.sin(angle / 2) / np.cos(angle / 2)
    data = [test.measurement([[angle]])]
    result = tj.identify(spring, {"rotation": positive(8.0)}, data)
    assert_close(result.estimates["rotation"], stiffness, digits=5)


@pytest.mark.slow
def test_a_search_that_does_not_converge_is_reported():
    data = [push(5.0).measurement([[0.04]])]
    start = {"along": positive(1.0)}
    with pytest.raises(RuntimeError, match=r"has not converged.*2 evaluations"):
        tj.identify(spring, start, data, max_steps=2)
    result = tj.identify(spring, start, data, max_steps=2, throw=False)
    assert tj.result_names(result.result) == "not_converged"
    assert "has not converged" in repr(result)


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"start": {}}, "must have a parameter to identify"),
        ({"data": []}, "`data` is empty"),
        ({"data": push(5.0)}, "StaticTest|sequence|list"),
        ({"data": [push(5.0)]}, r"`data\[0\]` is a StaticTest"),
        ({"method": "adam"}, "`method` is 'adam', but must be an optimizer"),
        ({"huber_threshold": 0.0}, "`huber_threshold` is 0.0, but must be a positive"),
        ({"huber_threshold": True}, "`huber_threshold` is True, but must be a positive"),
        ({"restarts": 2, "key": "a"}, "`key` is 'a', but must be an integer"),
        ({"restarts": 2, "key": 10**20}, "`key` is 100000000000000000000, but must be"),
        ({"restarts": -1}, "`restarts` is -1"),
        ({"restart_standard_deviation": 0.0}, "`restart_standard_deviation` is 0.0, but"),
        ({"tolerance": 1.0}, "`tolerance` is 1.0, but must be between 0 and 1"),
        ({"max_steps": 0}, "`max_steps` is 0, but must be at least 1"),
    ],
)
def test_wrong_arguments_are_rejected(wrong, message):
    data = [push(5.0).measurement([[0.04]])]
    arguments = {"start": {"along": positive(1.0)}, "data": data} | wrong
    with pytest.raises((ValueError, TypeError), match=message):
        tj.identify(spring, arguments.pop("start"), arguments.pop("data"), **arguments)


def test_a_design_that_jax_cannot_compile_is_rejected():
    data = [push(5.0).measurement([[0.04]])]

    def branching(k):
        return spring({"along": k["along"] if k["along"] > 0 else 1.0})

    start = {"along": positive(1.0)}
    with pytest.raises(ValueError, match="`design` is a function that JAX cannot"):
        tj.identify(branching, start, data)
    with pytest.raises(ValueError, match="`design` returns a dict, but must return a"):
        tj.identify(lambda k: k, start, data)
    with pytest.raises(KeyError) as error:
        tj.identify(lambda k: spring({"along": k["across"]}), start, data)
    assert "The parameters are 'along'." in error.value.__notes__


def test_a_large_constant_residual_does_not_affect_the_other_residuals():
    """One residual is a million standard deviations for all values of the parameters."""

    def function(u):
        return jnp.stack([0 * u[0] + 1e6, u[0] - 1.0, u[0] + u[1] - 3.0, u[1] - 2.1])

    result = minimize_formula(function, [1.0, 1e-4, 0.1, 0.1], {"a": 1.1, "b": 3.0})
    assert_close(result.estimates["a"], 1.0, digits=6)
    assert_close(result.estimates["b"], 2.05, digits=5)


def test_a_parameter_without_bounds_may_grow_by_a_factor_of_one_thousand():
    result = minimize_formula(
        lambda u: jnp.stack([u[0] - 1.0, u[1] - 2.0]), [0.1, 0.1], {"a": 1e-3, "b": 1.0}
    )
    assert_close(result.estimates["a"], 1.0, digits=6)
    assert not result.undetermined_directions  # 0.1 is a tenth of the estimate


def test_a_search_that_ends_at_a_failing_solve_has_not_converged():
    def function(u):
        failure = jnp.where(u[0] > 1.5, jnp.nan, 0.0)
        return jnp.stack([u[0] - 3.0 + failure, u[1] - 0.3, u[0] * u[1] ** 2 - 0.9])

    result = minimize_formula(function, 3 * [1e-3], {"a": 1.0, "b": 1.0}, throw=False)
    assert tj.result_names(result.result) == "not_converged"


@pytest.mark.slow
def test_a_weak_parameter_does_not_stop_the_search_for_another():
    """The readings hardly depend on the rotational stiffness."""
    sensors = [BodySensor("block", "x", 3e-3), BodySensor("block", "angle", 3.0)]
    loads = [tj.Load("block", (1e-3, force, 0.0)) for force in (1.0, 2.0, 5.0)]
    test = StaticTest([[load] for load in loads], sensors)
    data = [test.synthetic_data(spring({"along": 100.0, "rotation": 1.0}))]
    start = {"along": positive(90.0), "rotation": positive(2.0)}
    result = tj.identify(spring, start, data)
    assert_close(result.estimates["along"], 100.0, digits=3)
    (direction,) = result.undetermined_directions
    assert "rotation" in direction and "along" not in direction


@pytest.mark.slow
def test_the_gain_of_the_stage_determines_the_web_and_not_the_modulus():
    result = identification.identify_stage_web(elongation=False)
    gain = stage.amplification(stage.microstage(result.estimates["web"])).gain
    assert_close(gain, 27.95, digits=7)
    # The measured gain is known to 0.15; its derivative is -50661 /m at 250 um.
    assert 2.5e-6 < result.standard_errors["web"] < 3.5e-6
    both = identification.identify_stage_web()
    assert both.standard_errors["modulus"] == jnp.inf
    direction = both.undetermined_directions[0]
    assert "modulus" in direction and "web" not in direction
    assert any("12.8 times as large" in text for text in both.warnings)


@pytest.mark.release
def test_the_motion_of_a_linkage_determines_the_stiffnesses_of_one_hinge():
    exact = identification.identify_hinge_a()
    for name, value in identification.LEAF.items():
        assert abs(exact.estimates[name] / value - 1) < 1e-6
    noisy = identification.identify_hinge_a(jax.random.key(0))
    for name, value in identification.LEAF.items():
        error = abs(noisy.estimates[name] - value)
        assert error < 4 * noisy.standard_errors[name]
    assert not noisy.warnings


@pytest.mark.release
def test_a_bench_of_three_leaves_determines_the_coefficients_of_beam_theory():
    result = identification.identify_leaf(jax.random.key(2))
    for name, factor in result.estimates.items():
        assert abs(factor - 1) < 4 * result.standard_errors[name]
    assert result.standard_errors["rotation_shortening"] < 2e-3
    assert result.standard_errors["transverse_shortening"] < 5e-3


@pytest.mark.release
def test_a_camera_and_the_moment_of_the_drive_determine_twelve_stiffnesses():
    result = identification.identify_twelve_stiffnesses(jax.random.key(1))
    true = {"A": [0.071875, 862500.0, 2156.25], "D": [0.14375, 1.725e6, 17250.0]}
    for name, row in true.items():
        error = np.abs(result.estimates[name] - np.array(row))
        assert np.all(error < 4 * np.asarray(result.standard_errors[name]))
    # The rotational stiffnesses are strongly correlated.
    assert result.standard_errors["A"][0] > 0.1 * true["A"][0]
