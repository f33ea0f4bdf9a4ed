"""Random wrenches are interpolated, but not predicted (section 7.1)."""

import pathlib

import numpy as np
import pytest
from helpers import assert_close

import twistorjax as tj
from twistorjax.examples import random_data


@pytest.fixture(scope="module")
def study():
    return random_data.study()


def test_the_trials_are_those_of_the_dissertation():
    reference = pathlib.Path(__file__).parent / "reference" / "random_trials.csv"
    expected, trials = tj.energies.read_trials(reference), random_data.trials()
    np.testing.assert_array_equal(trials.poses, expected.poses)
    np.testing.assert_array_equal(trials.wrenches, expected.wrenches)
    assert trials.wrenches is not None
    largest = np.abs(trials.wrenches).max(axis=0)
    printed = np.array([0.944, 0.836, 0.959])
    assert_close(largest, printed, digits=3)


def test_trials_of_a_seed_have_the_distribution_of_the_dissertation():
    trials = random_data.trials(seed=5)
    angles, x, y = np.asarray(trials.poses).T
    assert len(trials) == 17
    assert np.abs(angles).max() < np.pi / 8
    assert np.abs(np.arctan2(y, x)).max() < np.pi / 8
    assert np.all((np.hypot(x, y) >= 3) & (np.hypot(x, y) < 6))
    assert trials.wrenches is not None and np.abs(trials.wrenches).max() < 1
    assert not np.allclose(trials.poses, random_data.trials(seed=6).poses)


def test_training_errors_are_below_those_of_the_dissertation(study):
    assert (study.fit.value_count, study.fit.terms, study.fit.rank) == (51, 69, 51)
    printed = np.array([2.64e-5, 1.53e-5, 4.2e-6])
    assert np.all(study.fit.training.largest_wrench < printed)
    assert_close(study.fitted, study.trials.wrenches, digits=5)
    assert "interpolates" in str(study.fit.warning)


def test_no_trial_is_predicted_by_a_fit_to_the_others(study):
    """The relative errors exceed 1, which is the error of predicting zero."""
    assert np.all(study.held_out.relative > 1)
    error = study.predictions - np.asarray(study.trials.wrenches)
    assert_close(study.held_out.largest_wrench, np.abs(error).max(axis=0), digits=9)


def test_a_prediction_is_that_of_an_independent_fit_to_the_other_trials(study):
    row = 4
    others = study.trials[np.arange(17) != row]
    with pytest.warns(UserWarning, match="interpolates"):
        fit = tj.fit_energy(
            others,
            order=4,
            redundant=True,
            reference="free",
            ridge=0.0,
            scale=float(study.fit.energy.scale),
        )
    wrench = fit.energy.wrench(study.trials.poses[row])
    np.testing.assert_allclose(wrench, study.predictions[row], rtol=1e-6)


def test_a_study_is_printed_and_drawn(study):
    mpl = pytest.importorskip("matplotlib")
    mpl.use("agg")
    assert "69 coefficients, 51 measured values, rank 51" in repr(study)
    figure = random_data.plot(study)
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["moment (N m)", "force 1 (N)", "force 2 (N)"]
    measured = figure.axes[0].lines[1]
    assert_close(measured.get_ydata(), study.trials.wrenches[:, 0])
    mpl.pyplot.close(figure)
