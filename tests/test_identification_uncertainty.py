"""Uncertainty of estimates: undetermined directions, intervals, outliers, warnings."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from helpers import assert_close
from identification_helpers import (
    body_at,
    FormulaTest,
    minimize_formula,
    positive,
    push_series,
    spring,
)

import twistorjax as tj
from twistorjax.identification import (
    BodySensor,
    Parameter,
    posterior,
    rank_experiments,
    StaticTest,
)


def test_a_stiffness_that_is_never_loaded_is_not_determined():
    """It stays at its initial value, and its standard error is infinite."""
    test = FormulaTest(lambda k: jnp.stack([0.2 / k[0]]), jnp.array([1e-3]))
    start = {"a": positive(0.5, "N m/rad"), "b": positive(77.0, "N/m")}
    result = tj.identify(body_at, start, [test.measurement([[0.2]])])
    assert_close(result.estimates["b"], 77.0)
    assert result.standard_errors["b"] == np.inf
    assert np.isfinite(result.standard_errors["a"])
    (direction,) = result.undetermined_directions
    assert "b by" in direction and "a by" not in direction
    assert "N/m  not determined" in repr(result)
    low, high = result.confidence_interval()
    assert low["b"] == 0.0 and high["b"] == np.inf


def test_of_two_springs_in_series_only_the_compliance_is_determined():
    """Stiffening one spring and softening the other does not change the readings."""
    test = FormulaTest(lambda k: jnp.stack([1 / k[0] + 1 / k[1]]), jnp.array([1e-5]))
    start = {"a": positive(100.0), "b": positive(300.0)}
    result = tj.identify(body_at, start, [test.measurement([[0.02]])])
    a, b = (float(result.estimates[name]) for name in "ab")
    assert_close(1 / a + 1 / b, 0.02, digits=7)
    (description,) = result.undetermined_directions
    # The compliance 1/a + 1/b is constant if d ln a / a = - d ln b / b.
    direction = np.linalg.svd(np.asarray(result.jacobian))[2][-1]
    assert_close(direction[0] / direction[1], -a / b, digits=6)
    assert "a by" in description and "b by" in description
    assert "together" in description


def test_changes_are_relative_to_the_estimates():
    """Of springs in series between driven ends, only the ratio is determined."""
    travels = np.array([1e-3, 2e-3])
    test = FormulaTest(lambda k: travels * (k[1] / (k[0] + k[1])), jnp.full(2, 1e-6))
    start = {"a": Parameter(100.0), "b": Parameter(100.0)}
    result = tj.identify(body_at, start, [test.measurement([[0.25e-3], [0.5e-3]])])
    first, last = (float(result.estimates[name]) for name in "ab")
    assert_close(first / last, 3.0, digits=7)
    (direction,) = result.undetermined_directions
    assert "by +1 % and" in direction and direction.count("by +1 %") == 2


def displacement(k):
    """Displacement of a spring of the stiffness `a` under a force of 5 N."""
    return jnp.stack([5.0 / k[0]])


@pytest.mark.parametrize("deviation, effect", [(5.0, "0.0001"), (5e4, "less than 1e-06")])
def test_a_parameter_with_a_small_effect_on_the_readings_is_not_determined(
    deviation, effect
):
    data = [FormulaTest(displacement, jnp.array([deviation])).measurement([[0.05]])]
    result = tj.identify(body_at, {"a": positive(100.0), "b": 0.0}, data)
    (direction,) = result.undetermined_directions
    assert f"a by +1 % changes the readings by {effect} standard" in direction
    assert "not determined" in repr(result)


def test_hubers_loss_reduces_the_effect_of_an_outlier():
    forces = np.linspace(1.0, 5.0, 9)
    readings = forces / 100 + 1e-4 * np.array([0, 1, -1, 0.5, 300, -0.5, 1, -1, 0])
    test = FormulaTest(lambda k: forces / k[0], jnp.full(9, 1e-4))
    data, start = [test.measurement(readings[:, None])], {"a": positive(80.0), "b": 0.0}
    plain = tj.identify(body_at, start, data)
    robust = tj.identify(body_at, start, data, huber_threshold=1.345)
    assert abs(plain.estimates["a"] - 100) > 5
    assert abs(robust.estimates["a"] - 100) < 0.3
    too_large = "times as large as the standard deviations"
    assert any(too_large in text for text in plain.warnings)

    def huber_loss(k):
        magnitude = np.abs(forces / k - readings) / 1e-4
        linear = 1.345 * (magnitude - 1.345 / 2)
        return np.sum(np.where(magnitude < 1.345, magnitude**2 / 2, linear))

    peer = scipy.optimize.minimize_scalar(huber_loss, (90, 100, 110), tol=1e-12)
    assert isinstance(peer, scipy.optimize.OptimizeResult)
    assert_close(robust.estimates["a"], peer.x, digits=5)
    assert_close(robust.loss, peer.fun, digits=8)
    outlier = "outliers, in standard deviations: value in row 4 (-3"
    assert any(outlier in text for text in robust.warnings)
    assert not any("times as large" in text for text in robust.warnings)
    residual = (forces[4] / peer.x - readings[4]) / 1e-4
    assert_close(np.asarray(robust.residuals[0])[4, 0], residual, digits=5)


def test_standard_errors_of_hubers_loss_are_at_least_those_of_least_squares():
    """This holds even if all residuals are large, or all are zero."""
    readings = np.array([1.0, 1.01, 2.0, 2.01])

    def function(u):
        return jnp.concatenate([readings - u[0], jnp.stack([u[1] - 1.0, u[1] - 1.0])])

    deviations, start = 6 * [0.1], {"a": 1.2, "b": 1.1}
    plain = minimize_formula(function, deviations, start)
    robust = minimize_formula(function, deviations, start, huber_threshold=1.345)
    for name in start:
        assert robust.standard_errors[name] > 0.999 * plain.standard_errors[name] > 0.04


@pytest.mark.slow
def test_confidence_intervals_contain_the_true_value_as_often_as_their_level():
    """The share in 400 repetitions lies within three of its standard deviations."""
    forces = jnp.linspace(1.0, 5.0, 5)
    test = push_series(forces, 1e-3)

    def contains_true_value(key):
        noise = 1e-3 * jax.random.normal(key, (5, 1))
        data = test.measurement(forces[:, None] / 100.0 + noise)
        result = tj.identify(spring, {"along": positive(70.0)}, [data], throw=False)
        low, high = result.confidence_interval()
        return (low["along"] < 100.0) & (high["along"] > 100.0), result.succeeded

    keys = jax.random.split(jax.random.key(5), 400)
    contained, succeeded = jax.jit(jax.vmap(contains_true_value))(keys)
    assert jnp.all(succeeded)
    share = np.mean(np.asarray(contained))
    assert abs(share - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 400)


def test_intervals_of_hubers_loss_have_their_level_with_few_readings():
    """One of ten readings of a line has a sixfold error: 300 repetitions."""
    x = np.linspace(0.0, 1.0, 12)

    def contains_true_value(key):
        noise_key, outlier_key = jax.random.split(key)
        factor = jnp.where(jax.random.uniform(outlier_key, (12,)) < 0.1, 6.0, 1.0)
        values = 1.0 + 2.0 * x + 0.1 * factor * jax.random.normal(noise_key, (12,))
        test = FormulaTest(lambda u: u[0] + u[1] * x, 0.1 * jnp.ones(12))
        start = {"a": Parameter(1.3), "b": Parameter(1.7)}
        data = [test.measurement(values[:, None])]
        result = tj.identify(body_at, start, data, huber_threshold=1.345, throw=False)
        low, high = result.confidence_interval()
        return (low["b"] < 2.0) & (high["b"] > 2.0)

    keys = jax.random.split(jax.random.key(1), 300)
    share = np.mean(np.asarray(jax.jit(jax.vmap(contains_true_value))(keys)))
    assert abs(share - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 300)


@pytest.mark.slow
def test_uncertainties_of_a_batch_are_those_of_a_straight_line():
    """The covariance of the coefficients of `a + b x` is `s^2 inv(X^T X)`."""
    x, deviation = np.array([0.0, 0.3, 0.5, 1.0]), 0.1
    test = FormulaTest(lambda u: u[0] + u[1] * x, deviation * jnp.ones(4))
    start = {"a": Parameter(1.3), "b": Parameter(1.7)}

    def line(values):
        data = [test.measurement(values[:, None])]
        return tj.identify(body_at, start, data, throw=False)

    readings = jnp.array([[1.0, 1.6, 2.0, 3.0], [2.0, 2.5, 2.9, 3.2], [0.5, 0.5, 0.7, 1]])
    batch = jax.vmap(line)(readings)
    matrix = np.stack([np.ones(4), x], axis=1)
    covariance = deviation**2 * np.linalg.inv(matrix.T @ matrix)
    errors = np.sqrt(np.diagonal(covariance))
    exact = np.linalg.lstsq(matrix, np.asarray(readings).T)[0].T
    assert_close(batch.values, exact, digits=7)
    assert_close(batch.covariance, np.stack([covariance] * 3), digits=7)
    correlation = covariance / np.outer(errors, errors)
    assert_close(batch.correlation, np.stack([correlation] * 3), digits=7)
    assert_close(batch.standard_errors["b"], errors[[1, 1, 1]], digits=7)
    low, high = batch.confidence_interval()
    assert_close((high["a"] - low["a"]) / 2, 1.959964 * errors[[0, 0, 0]], digits=6)
    assert not np.any(batch.bound_sides)
    with pytest.raises(ValueError, match=r"a batch of the shape \(3,\). Select one"):
        _ = batch.warnings
    one = jax.tree.map(lambda array: array[1], batch)
    assert "2 parameters from 4 readings" in repr(one) and not one.warnings


@pytest.mark.parametrize(
    ("value", "bounds", "at_bound"),
    [
        (0.2, {"lower": 0.5}, 0.5),
        (0.48, {"lower": 0.5, "upper": 3.0}, 0.5),
        (2.5, {"upper": 2.0}, 2.0),
        (1.2, {"lower": 0.5, "upper": 2.0}, None),
        (1e7, {"lower": 0.0}, None),
    ],
)
def test_estimates_at_a_bound_and_their_uncertainties(value, bounds, at_bound):
    """Three readings of `b` have the standard error 0.1 / sqrt(3), also at a bound."""
    test = FormulaTest(lambda u: u[1] * jnp.ones(3), 0.1 * jnp.ones(3))
    data = [test.measurement(np.full((3, 1), value))]
    start = {"a": 0.0, "b": Parameter(1.0, "m", **bounds)}
    result = tj.identify(body_at, start, data, throw=False)
    error = 0.1 / np.sqrt(3)
    if at_bound is None:
        assert not any("bound" in text for text in result.warnings)
        return
    assert any(f"b is at its bound, {at_bound:g} m" in w for w in result.warnings)
    assert "at its bound" in repr(result) and "not determined" not in repr(result)
    assert_close(result.standard_errors["b"], error, digits=6)
    low, high = (limit["b"] for limit in result.confidence_interval())
    estimate, width = float(result.estimates["b"]), 1.959964 * error
    assert_close(low, max(estimate - width, bounds.get("lower", -np.inf)), digits=6)
    assert_close(high, min(estimate + width, bounds.get("upper", np.inf)), digits=6)


def test_a_confidence_interval_depends_on_its_level():
    data = [FormulaTest(displacement, jnp.array([1e-4])).measurement([[0.05]])]
    result = tj.identify(body_at, {"a": positive(80.0), "b": 0.0}, data)
    low, high = result.confidence_interval(0.6826894921)
    relative_error = float(result.standard_errors["a"]) / 100.0
    assert_close(low["a"], 100 * np.exp(-relative_error), digits=6)
    assert_close(high["a"], 100 * np.exp(relative_error), digits=6)
    with pytest.raises(ValueError, match=r"`level` is 95.0, but must be between 0 and 1"):
        result.confidence_interval(95.0)


def test_large_residuals_of_held_out_readings_are_reported():
    test = FormulaTest(displacement, jnp.array([1e-4]))
    data, held_out = [test.measurement([[0.04]])], [test.measurement([[0.05]])]
    start = {"a": positive(60.0), "b": 0.0}
    result = tj.identify(body_at, start, data, held_out=held_out)
    assert_close(result.held_out_residuals[0], [[-0.01 / 1e-4]], digits=6)
    text = "RMS residual of the held-out readings is 100 standard deviations"
    assert any(text in warning for warning in result.warnings)


@pytest.mark.release
def test_samples_have_the_mean_and_standard_deviation_of_the_posterior():
    """The reading is linear in the compliance, so both are known in closed form."""
    pytest.importorskip("blackjax")

    def design(k):
        one = jnp.ones(())
        return spring({"rotation": one, "along": 1 / k["compliance"], "across": one})

    test = push_series([1.0, 1.0, 1.0], 1e-3)
    readings = np.array([[0.0095], [0.0105], [0.0112]])
    start = {"compliance": Parameter(0.01, "m/N", scale=0.01)}
    data = [test.measurement(readings)]
    result = tj.identify(design, start, data)
    samples = posterior(result, draws=500, tune=200, chains=2)
    values = np.asarray(samples.posterior["compliance"])  # pyright: ignore[reportAttributeAccessIssue]
    assert values.shape == (2, 500)
    standard_deviation = 1e-3 / np.sqrt(3)
    assert abs(values.mean() - readings.mean()) < 0.2 * standard_deviation
    assert abs(values.std() / standard_deviation - 1) < 0.15
    robust = tj.identify(design, start, data, huber_threshold=1.345)
    with pytest.raises(ValueError, match="Huber's loss is not"):
        posterior(robust)


def guide_on_two_leaves(parameters):
    """A table on two leaves with an unknown modulus (Pa) and thickness (m)."""
    metal = tj.Material(modulus=parameters["modulus"], poisson=0.3)
    leaf = tj.flexures.leaf(
        metal, length=50e-3, thickness=parameters["thickness"], width=10e-3
    )
    up, table = np.pi / 2, tj.Body("table", pose=(0.0, 0.0, 50e-3))
    hinges = [
        tj.Hinge(name, "base", "table", leaf, at=(up, side * 40e-3, 25e-3))
        for name, side in (("left", -1), ("right", 1))
    ]
    return tj.Mechanism([tj.Body("base"), table], hinges, ["base"])


def guide_tests(laser_deviation):
    """Pulls, which show E t^3, and a press, which shows E t."""
    pulls = [[tj.Load("table", force=(force, 0.0))] for force in (1.0, 5.0)]
    press = [[tj.Load("table", force=(0.0, -50.0))]]
    return (
        StaticTest(pulls, [BodySensor("table", "x", 1e-6)]),
        StaticTest(press, [BodySensor("table", "y", laser_deviation)]),
    )


@pytest.mark.slow
def test_the_fit_stays_near_the_start_where_noise_would_determine_it():
    """The press shows a change of E t by 100 % as one third of a standard deviation."""
    pull, press = guide_tests(laser_deviation=3.5e-6)
    truth = guide_on_two_leaves({"modulus": 203e9, "thickness": 0.52e-3})
    start = {"modulus": positive(210e9), "thickness": positive(0.5e-3)}
    for seed in range(5):
        data = [pull.synthetic_data(truth, seed), press.synthetic_data(truth, seed + 100)]
        result = tj.identify(guide_on_two_leaves, start, data)
        # the change of E t^3 that is nearest to the start in relative changes
        change = np.log(203e9 * 0.52e-3**3 / (210e9 * 0.5e-3**3))
        nearest = change * np.array([1.0, 3.0]) / 10
        np.testing.assert_allclose(result.normalized, nearest, atol=5e-3)
        assert repr(result).count("  not determined") == 2


@pytest.mark.slow
def test_the_ranking_reports_that_its_prediction_depends_on_unknown_parameters():
    pull, press = guide_tests(laser_deviation=10e-9)
    truth = {"modulus": 203e9, "thickness": 0.52e-3}
    start = {"modulus": positive(400e9), "thickness": positive(0.42e-3)}
    data = [pull.synthetic_data(guide_on_two_leaves(truth), 0)]
    result = tj.identify(guide_on_two_leaves, start, data)
    ranking = rank_experiments(result, {"press": press})
    assert "warning: the measurements so far do not determine" in repr(ranking)
    data.append(press.synthetic_data(guide_on_two_leaves(truth), 1))
    final = tj.identify(guide_on_two_leaves, start, data)
    true_error = np.sqrt(np.diagonal(final.normalized_covariance))
    low, high = ranking.standard_errors_range
    assert np.all((low < true_error) & (true_error < high))
    assert np.all(ranking.standard_errors_after > 1.4 * true_error)
    certain = rank_experiments(final, {"press": press})
    assert "warning" not in repr(certain) and not certain.undetermined_directions
