"""Two water molecules: what is true of them, and how well fits foretell it."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close

from twistorjax.examples import water


pytestmark = pytest.mark.slow


def test_molecules_are_alike_and_their_own_mirror_images():
    """The energy depends on xi^2, xi x2, x2^2 and x1^2 alone."""
    energies = jax.jit(jax.vmap(water.molecules()))
    poses = water.poses(2 * math.pi, 50, 0)
    angle, x, y = np.asarray(poses).T
    cos, sin = np.cos(angle), np.sin(angle)
    exchanged = (-angle, -cos * x - sin * y, sin * x - cos * y)
    for same in (exchanged, (-angle, x, -y), (angle + 2 * math.pi, x, y)):
        assert_close(energies(jnp.stack(same, axis=1)), energies(poses), digits=10)
    other = energies(jnp.stack((angle, -x, -y), axis=1))
    assert np.abs(other - energies(poses)).max() > 1e-3


def test_trials_lie_where_they_should():
    trials = water.trials(math.pi, 400, 3)
    angles, x, y = np.asarray(trials.poses).T
    for angle in (angles, np.arctan2(y, x)):
        assert math.pi / 2 > angle.max() > 1.4
        assert -math.pi / 2 <= angle.min() < -1.4
    distances = np.hypot(x, y)
    assert 3 <= distances.min() < 3.05
    assert 5.95 < distances.max() < 6


def test_a_power_of_the_distance_is_one():
    poses = water.poses(2 * math.pi, 10, 1)
    for pose in poses:
        expected = ((pose[1] ** 2 + pose[2] ** 2) / 20) ** 3
        assert_close(water.power_of_distance(6)(pose), expected)


@pytest.fixture(scope="module")
def sixth():
    return water.study(6, math.pi, seeds=[1])


def test_a_quotient_kept_from_poles_foretells_fresh_trials(sixth):
    """Ten times better than a plain one, and than a polynomial."""
    kept = sixth.held_out("kept from poles").item()
    assert kept < 1e-3
    assert kept < sixth.held_out("plain quotient").item() / 10
    assert kept < sixth.held_out("polynomial").item() / 10
    assert sixth.wrenches("kept from poles").item() < 0.05
    (fit,) = sixth.fits["kept from poles"]
    assert (fit.terms, fit.rank) == (59, 59)
    assert fit.lowest > 0.05


def test_a_plain_quotient_has_poles_between_its_trials(sixth):
    (fit,) = sixth.fits["plain quotient"]
    assert fit.has_poles
    assert sixth.held_out("plain quotient") > 5 * sixth.training("plain quotient")


def test_the_distance_alone_is_a_denominator_that_never_vanishes(sixth):
    fit = water.fit_quotient(
        sixth.trials[0], 6, denominator="base", held_out=sixth.fresh[0]
    )
    assert fit.terms == 30
    assert fit.held_out.largest_energy < sixth.held_out("polynomial").item() / 5


def test_a_study_prints_and_draws_itself(sixth):
    mpl = pytest.importorskip("matplotlib")
    mpl.use("agg")
    lines = repr(sixth).splitlines()
    assert "order 6, angles over 3.142 rad: 500 trials fitted, 2000 held" in lines[0]
    assert [line.split("  ")[0] for line in lines[3:]] == list(water.FITS)
    figure = water.plot(sixth)
    assert [axes.get_title() for axes in figure.axes[:2]] == [
        "500 trials fitted",
        "2000 trials held out",
    ]
    assert "(e²/Å)" in figure.axes[0].get_ylabel()
    mpl.pyplot.close(figure)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: water.study(5), "`order` is 5, but must be even"),
        (lambda: water.trials(7.0), "`span` is 7.0, but must be above 0"),
        (lambda: water.trials(points=0), "`points` is 0, but must be 1 or more"),
    ],
)
def test_what_makes_no_sense_is_told(make, message):
    with pytest.raises(ValueError) as error:
        make()
    assert message in str(error.value)
