"""Random wrenches met, and none foretold: section 7.1."""

import pathlib

import numpy as np
import pytest
from helpers import assert_close

import twistorjax as tj
from twistorjax.examples import random_data


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def study():
    return random_data.study()


def test_the_trials_are_those_of_the_dissertation():
    reference = pathlib.Path(__file__).parent / "reference" / "random_trials.csv"
    given, trials = tj.energies.read_trials(reference), random_data.trials()
    np.testing.assert_array_equal(trials.poses, given.poses)
    np.testing.assert_array_equal(trials.wrenches, given.wrenches)
    largest = np.abs(trials.wrenches).max(axis=0)
    assert_close(largest, np.array([0.944, 0.836, 0.959]), digits=3)  # as it prints


def test_others_are_of_their_kind():
    trials = random_data.trials(seed=5)
    angles, x, y = np.asarray(trials.poses).T
    assert len(trials) == 17
    assert np.abs(angles).max() < np.pi / 8
    assert np.abs(np.arctan2(y, x)).max() < np.pi / 8
    assert np.all((np.hypot(x, y) >= 3) & (np.hypot(x, y) < 6))
    assert np.abs(trials.wrenches).max() < 1
    assert not np.allclose(trials.poses, random_data.trials(seed=6).poses)


def test_they_are_interpolated_within_the_printed_errors(study):
    assert (study.fit.equations, study.fit.terms, study.fit.rank) == (51, 69, 51)
    printed = np.array([2.64e-5, 1.53e-5, 4.2e-6])
    assert np.all(study.fit.training.largest < printed)
    assert_close(study.fitted, study.trials.wrenches, digits=5)
    assert "interpolates" in str(study.fit.warning)


def test_none_is_foretold_by_the_others(study):
    """Worse than to foretell no wrench at all, whose relative error is one."""
    assert np.all(study.held_out.relative > 1)
    gap = study.foretold - np.asarray(study.trials.wrenches)
    assert_close(study.held_out.largest, np.abs(gap).max(axis=0), digits=9)
    row = 4  # as an independent fit without it has it
    others = study.trials[np.arange(17) != row]
    with pytest.warns(UserWarning, match="interpolates"):
        fit = tj.fit_energy(
            *(others, 4), redundant=True, reference="free", ridge=0.0,
            scale=float(study.fit.energy.scale),
        )  # fmt: skip
    wrench = fit.energy.wrench(study.trials.poses[row])
    np.testing.assert_allclose(wrench, study.foretold[row], rtol=1e-6)


def test_it_prints_and_draws_itself(study):
    mpl = pytest.importorskip("matplotlib")
    mpl.use("agg")
    assert "69 coefficients for 51 numbers, rank 51" in repr(study)
    figure = random_data.plot(study)
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["moment (N m)", "force 1 (N)", "force 2 (N)"]
    given = figure.axes[0].lines[1]
    assert_close(given.get_ydata(), study.trials.wrenches[:, 0])
    mpl.pyplot.close(figure)
