"""Fits of rational energies, and energies of point charges."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, for_each, some_poses

import twistorjax as tj
from twistorjax.energies.strains import Coordinates


CHARGES_A, SITES_A = [1.5, -0.5, 2.0], [[0.3, 0.1], [-0.2, 0.4], [0.0, -0.5]]
# These are so far from the charges of body A that they do not coincide at any pose.
CHARGES_B, SITES_B = [-1.0, 0.7], [[9.0, 0.2], [8.5, -0.6]]


def charges():
    return tj.energies.PointCharges(CHARGES_A, SITES_A, CHARGES_B, SITES_B, constant=3.0)


def coulomb(angle, x, y):
    """Energy, and wrench on b in its axes, from Coulomb's law in complex numbers."""
    rotation, energy, moment, force = np.exp(1j * angle), 0.0, 0.0, 0.0
    for charge_a, site_a in zip(CHARGES_A, SITES_A, strict=True):
        for charge_b, site_b in zip(CHARGES_B, SITES_B, strict=True):
            gap = complex(x, y) + rotation * complex(*site_b) - complex(*site_a)
            energy += 3.0 * charge_a * charge_b / abs(gap)
            # Equal charges repel each other. The force on the hinge is the reaction to
            # the force on body B.
            pair = -3.0 * charge_a * charge_b * gap / abs(gap) ** 3 / rotation
            force += pair
            moment += (complex(*site_b).conjugate() * pair).imag
    return energy, [moment, force.real, force.imag]


def test_point_charges_obey_coulombs_law():
    energy = charges()
    poses = some_poses(3, 8)
    stored, wrenches = zip(*(coulomb(*pose) for pose in poses), strict=True)
    assert_close(for_each(energy, poses), stored)
    assert_close(for_each(energy.wrench, poses), wrenches)


def test_charges_of_one_body_do_not_interact():
    """Two charges on body B are one meter apart; only pairs of A and B have an energy."""
    energy = tj.energies.PointCharges(
        [1.0], [[0.0, 0.0]], [1.0, 1.0], [[0.0, 0.0], [1.0, 0.0]]
    )
    assert_close(energy(jnp.array([0.0, 1.0, 0.0])), 1.5 * 8.9875517862e9)
    assert np.isinf(energy(jnp.zeros(3)))  # two charges at the same position


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("given", "message"),
    [
        (([1.0], [[0.0, 0.0, 0.0]]), "`sites_a` has shape (1, 3), but for 1 charges"),
        (([], []), "`charges_a` has shape (0,), but must be a list of at least one"),
        (([1.0], [[0.0, 0.0]], [1.0]), "`sites_b` is not given"),
        (([1.0], [[0.0, np.nan]]), "`sites_a[0]` is [ 0. nan], but must be finite"),
    ],
)
def test_invalid_charges_raise_an_error(given, message):
    with pytest.raises(ValueError) as error:
        tj.energies.PointCharges(*given)
    assert message in str(error.value)


def random_rational(coordinates: Coordinates = "twistor"):
    """A rational energy with a denominator between 0.2 and 1.8 at the poses below."""
    powers = tj.energies.monomials(2, coordinates)
    numerator, denominator = np.random.default_rng(4).normal(size=(2, len(powers)))
    constant = np.array([not any(row) for row in powers], float)
    denominator = (
        constant + 0.5 * (1 - constant) * denominator / np.abs(denominator).sum()
    )
    return tj.energies.Rational(
        tj.energies.Polynomial(numerator, powers, coordinates, 0.8),
        tj.energies.Polynomial(denominator, powers, coordinates, 0.8),
    )


def random_trials(energy, count=40, seed=0, size=0.8):
    poses = jnp.array(np.random.default_rng(seed).uniform(-size, size, (count, 3)))
    energies, wrenches = jax.jit(
        jax.vmap(lambda pose: (energy(pose), energy.wrench(pose)))
    )(poses)
    return tj.energies.Trials(poses, wrenches, energies)


@pytest.mark.parametrize("coordinates", ["twistor", "twist"])
def test_fit_recovers_a_rational_energy(coordinates):
    """The energies determine its additive constant, which the wrenches do not."""
    truth = random_rational(coordinates)
    trials, new_trials = random_trials(truth), random_trials(truth, seed=1)
    fit = tj.energies.fit_rational(
        trials, 2, coordinates=coordinates, ridge=0.0, scale=0.5, held_out=new_trials
    )
    assert fit.rank == fit.terms
    assert fit.held_out is not None and new_trials.energies is not None
    assert fit.held_out.largest_energy < 1e-9
    assert np.all(fit.held_out.largest_wrench < 1e-8)
    energies = for_each(fit.energy, new_trials.poses)
    assert_close(energies, new_trials.energies, digits=9)
    assert 0 < fit.smallest_ratio < fit.largest_ratio


BASE = tj.energies.Polynomial([2.0, 1.0, 1.0], [(0,) * 4, (0, 0, 2, 0), (0, 0, 0, 2)])


def test_reported_errors_are_those_of_the_fitted_energy():
    """The wrenches of the energy are its derivatives; also at larger displacements."""
    settings = {"count": 20, "seed": 1, "size": 1.6}
    trials, others = random_trials(charges()), random_trials(charges(), **settings)
    fit = tj.energies.fit_rational(trials, 2, base=BASE, scale=0.5, held_out=others)
    fitted = random_trials(fit.energy, **settings)
    assert others.energies is not None and fitted.energies is not None
    energies = np.asarray(others.energies) - np.asarray(fitted.energies)
    assert others.wrenches is not None and fitted.wrenches is not None
    wrenches = np.asarray(others.wrenches) - np.asarray(fitted.wrenches)
    errors = fit.held_out
    assert errors is not None
    np.testing.assert_allclose(errors.largest_energy, np.abs(energies).max(), rtol=1e-7)
    expected = np.sqrt(np.mean(wrenches**2, axis=0))
    np.testing.assert_allclose(errors.rms_wrench, expected, rtol=1e-7)
    poses = np.concatenate([trials.poses, others.poses])
    ratios = for_each(fit.energy.denominator, poses) / for_each(BASE, poses)
    np.testing.assert_allclose(fit.smallest_ratio, ratios.min(), rtol=1e-9)
    np.testing.assert_allclose(fit.largest_ratio, ratios.max(), rtol=1e-9)


def noise():
    """Return trials with random energies. Unregularized fits of them are singular."""
    poses = random_trials(charges()).poses
    return tj.energies.Trials(
        poses, energies=np.random.default_rng(7).normal(size=len(poses))
    )


def test_ridge_prevents_singularities():
    with pytest.warns(UserWarning, match="the denominator changes sign"):
        unregularized = tj.energies.fit_rational(noise(), 2, ridge=0.0)
    assert unregularized.has_singularities
    assert "warning: the denominator changes sign" in repr(unregularized)
    poses = 2 * np.asarray(random_trials(charges(), 60, seed=3).poses)
    fit = tj.energies.fit_rational(noise(), 2, regular_poses=poses)
    assert fit.ridge > 1e-4
    assert np.min(for_each(fit.energy.denominator, poses)) > 0.1
    assert not fit.has_singularities


def test_denominator_can_be_the_base_only():
    fit = tj.energies.fit_rational(noise(), 2, base=BASE, denominator="base", scale=0.5)
    poses = some_poses(2, 12)
    assert_close(for_each(fit.energy.denominator, poses), for_each(BASE, poses))
    assert (fit.smallest_ratio, fit.largest_ratio) == (1.0, 1.0)


def test_fit_that_interpolates_raises_a_warning():
    interpolates = "27 coefficients for 5 measured values"
    with pytest.warns(UserWarning, match=interpolates) as found:
        fit = tj.energies.fit_rational(noise()[np.arange(5)], 2, ridge=0.0)
    assert found[0].filename == __file__
    assert fit.rank == fit.value_count == 5


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"ridge": -1.0}, "`ridge` is -1.0"),
        ({"scale": 0.0}, "`scale` is 0.0"),
        ({"denominator": "none"}, "must be one of 'free', 'base'"),
        ({"regular_poses": [[0.0, 1.0]]}, "`regular_poses` has shape (1, 2)"),
        (
            {"base": tj.energies.Polynomial([1.0], [(0, 0, 0)], "twist")},
            "`base` is a polynomial of the twist, but must be one of the twistor",
        ),
        (
            {"base": tj.energies.Polynomial([1.0], [(2, 0, 0, 0)])},
            "write sigma^2 as 1 - xi^2",
        ),
        (
            {"base": tj.energies.Polynomial([1.0], [(0, 1, 0, 0)])},
            "must be positive at all",
        ),
    ],
)
def test_invalid_settings_raise_an_error(settings, message):
    with pytest.raises(ValueError) as error:
        tj.energies.fit_rational(noise(), 2, **settings)
    assert message in str(error.value)


def test_trials_without_energies_raise_an_error():
    trials = tj.energies.Trials([[0.1, 0.0, 0.0]], [[1.0, 0.0, 0.0]])
    with pytest.raises(ValueError, match="give both, or use `fit_energy`"):
        tj.energies.fit_rational(trials, 2)
