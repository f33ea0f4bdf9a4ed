"""The energy of two water molecules, and how well fits predict held-out trials."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close

from twistorjax.examples import water


def test_the_energy_is_symmetric_under_exchange_and_reflection():
    """The energy depends only on xi^2, xi x2, x2^2, and x1^2."""
    energies = jax.jit(jax.vmap(water.molecules()))
    poses = water.poses(2 * math.pi, 50, 0)
    angle, x, y = np.asarray(poses).T
    cos, sin = np.cos(angle), np.sin(angle)
    exchanged = (-angle, -cos * x - sin * y, sin * x - cos * y)
    reflected = (-angle, x, -y)
    full_revolution = (angle + 2 * math.pi, x, y)
    for equivalent in (exchanged, reflected, full_revolution):
        poses_of_equal_energy = jnp.stack(equivalent, axis=1)
        assert_close(energies(poses_of_equal_energy), energies(poses), digits=10)
    other = energies(jnp.stack((angle, -x, -y), axis=1))
    assert np.abs(other - energies(poses)).max() > 1e-3


def test_trials_fill_the_ranges_of_angle_direction_and_distance():
    trials = water.trials(math.pi, 400, 3)
    angles, x, y = np.asarray(trials.poses).T
    for angle in (angles, np.arctan2(y, x)):
        assert math.pi / 2 > angle.max() > 1.4
        assert -math.pi / 2 <= angle.min() < -1.4
    distances = np.hypot(x, y)
    assert 3 <= distances.min() < 3.05
    assert 5.95 < distances.max() < 6


def test_the_power_of_the_distance_is_exact():
    for pose in water.poses(2 * math.pi, 10, 1):
        expected = ((pose[1] ** 2 + pose[2] ** 2) / 20) ** 3
        assert_close(water.power_of_distance(6)(pose), expected)


@pytest.fixture(scope="module")
def study():
    """Fits of sixth order over half a revolution."""
    return water.study(6, math.pi, seeds=[1])


def test_a_regularized_rational_function_predicts_held_out_trials(study):
    """Its error is a tenth of that of the other fits."""
    error = study.held_out_error("regularized rational").item()
    assert error < 1e-3
    assert error < study.held_out_error("unregularized rational").item() / 10
    assert error < study.held_out_error("polynomial").item() / 10
    assert study.wrench_error("regularized rational").item() < 0.05
    (fit,) = study.fits["regularized rational"]
    assert (fit.terms, fit.rank) == (59, 59)
    assert fit.smallest_ratio > 0.05


def test_an_unregularized_rational_function_has_singularities_between_its_trials(study):
    (fit,) = study.fits["unregularized rational"]
    assert fit.has_singularities
    held_out_error = study.held_out_error("unregularized rational")
    assert held_out_error > 5 * study.training_error("unregularized rational")


def test_a_power_of_the_distance_as_denominator_predicts_held_out_trials(study):
    fit = water.fit_regularized(
        study.trials[0], 6, denominator="base", held_out=study.held_out_trials[0]
    )
    assert fit.terms == 30
    assert fit.held_out is not None
    assert fit.held_out.largest_energy < study.held_out_error("polynomial").item() / 5


def test_a_study_is_printed_and_drawn(study):
    mpl = pytest.importorskip("matplotlib")
    mpl.use("agg")
    lines = repr(study).splitlines()
    assert "order 6, angle range 3.142 rad: 500 fitted trials, 2000 held" in lines[0]
    assert [line.split("  ")[0] for line in lines[3:]] == list(water.FITS)
    figure = water.plot(study)
    assert [axes.get_title() for axes in figure.axes[:2]] == [
        "500 fitted trials",
        "2000 held-out trials",
    ]
    assert "(e²/Å)" in figure.axes[0].get_ylabel()
    mpl.pyplot.close(figure)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: water.study(5), "`order` is 5, but must be an even number"),
        (lambda: water.trials(7.0), "`angle_range` is 7.0, but must be positive"),
        (lambda: water.trials(points=0), "`points` is 0, but must be 1 or more"),
    ],
)
def test_invalid_arguments_are_reported(make, message):
    with pytest.raises(ValueError) as error:
        make()
    assert message in str(error.value)
