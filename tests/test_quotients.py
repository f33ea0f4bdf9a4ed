"""Quotients from measurements, and the charges whose energy they meet."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, some_poses

import twistorjax as tj


pytestmark = pytest.mark.slow


CHARGES, SITES = [1.5, -0.5, 2.0], [[0.3, 0.1], [-0.2, 0.4], [0.0, -0.5]]
FAR, THERE = [-1.0, 0.7], [[9.0, 0.2], [8.5, -0.6]]  # beyond reach of the poses


def charges():
    return tj.energies.PointCharges(CHARGES, SITES, FAR, THERE, constant=3.0)


def moved_by_hand(angle, x, y):
    """Energy and wrench pair by pair, in complex numbers; the wrench in b's axes."""
    turn, energy, moment, force = np.exp(1j * angle), 0.0, 0.0, 0.0
    for charge, site in zip(CHARGES, SITES, strict=True):
        for other, place in zip(FAR, THERE, strict=True):
            gap = complex(x, y) + turn * complex(*place) - complex(*site)
            energy += 3.0 * charge * other / abs(gap)
            # B is pushed away by like charges: it pushes the coupling back
            push = -3.0 * charge * other * gap / abs(gap) ** 3 / turn
            force += push
            moment += (complex(*place).conjugate() * push).imag
    return energy, [moment, force.real, force.imag]


def test_charges_push_by_the_inverse_square_of_their_distance():
    energy = charges()
    for pose in np.asarray(some_poses(3, 8)):
        stored, wrench = moved_by_hand(*pose)
        assert_close(energy(jnp.array(pose)), stored)
        assert_close(energy.wrench(jnp.array(pose)), wrench)


def test_a_charge_sees_those_of_the_other_body_alone():
    """Two like charges a metre apart, both on one body: only the pair between counts."""
    energy = tj.energies.PointCharges(
        [1.0], [[0.0, 0.0]], [1.0, 1.0], [[0.0, 0.0], [1.0, 0.0]]
    )
    assert_close(energy(jnp.array([0.0, 1.0, 0.0])), 1.5 * 8.9875517862e9)
    assert np.isinf(energy(jnp.zeros(3)))  # where sites meet


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("given", "message"),
    [
        (([1.0], [[0.0, 0.0, 0.0]]), "`sites_a` has shape (1, 3), but for 1 charges"),
        (([], []), "`charges_a` has shape (0,), but must be a list of at least one"),
        (([1.0], [[0.0, 0.0]], [1.0]), "`sites_b` are not given"),
        (([1.0], [[0.0, np.nan]]), "`sites_a[0]` is [ 0. nan], but must be finite"),
    ],
)
def test_charges_that_do_not_fit_are_told(given, message):
    with pytest.raises(ValueError) as error:
        tj.energies.PointCharges(*given)
    assert message in str(error.value)


def a_quotient(coordinates="twistor"):
    """One with a denominator between 0.2 and 1.8 at the poses below."""
    powers = tj.energies.monomials(2, coordinates)
    numerator, denominator = np.random.default_rng(4).normal(size=(2, len(powers)))
    one = np.array([not any(row) for row in powers], float)
    denominator = one + 0.5 * (1 - one) * denominator / np.abs(denominator).sum()
    return tj.energies.Rational(
        tj.energies.Polynomial(numerator, powers, coordinates, 0.8),
        tj.energies.Polynomial(denominator, powers, coordinates, 0.8),
    )


def some_trials(energy, count=40, seed=0, size=0.8):
    poses = jnp.array(np.random.default_rng(seed).uniform(-size, size, (count, 3)))
    energies, wrenches = jax.jit(
        jax.vmap(lambda pose: (energy(pose), energy.wrench(pose)))
    )(poses)
    return tj.energies.Trials(poses, wrenches, energies)


@pytest.mark.parametrize("coordinates", ["twistor", "twist"])
def test_a_quotient_is_found_again(coordinates):
    """From wrenches and energies; its constant, which no wrench tells, included."""
    truth = a_quotient(coordinates)
    trials, fresh = some_trials(truth), some_trials(truth, seed=1)
    fit = tj.energies.fit_rational(
        trials, 2, coordinates=coordinates, ridge=0.0, scale=0.5, held_out=fresh
    )
    assert fit.rank == fit.terms
    assert fit.held_out.largest_energy < 1e-9
    assert np.all(fit.held_out.largest < 1e-8)
    assert_close(fit.energy(fresh.poses[0]), fresh.energies[0], digits=9)
    assert 0 < fit.lowest < fit.highest


BASE = tj.energies.Polynomial([2.0, 1.0, 1.0], [(0,) * 4, (0, 0, 2, 0), (0, 0, 0, 2)])


def test_its_errors_are_those_of_its_energy():
    """As the quotient itself says, by differentiation; of poses farther out, too."""
    beyond = {"count": 20, "seed": 1, "size": 1.6}
    trials, others = some_trials(charges()), some_trials(charges(), **beyond)
    fit = tj.energies.fit_rational(trials, 2, base=BASE, scale=0.5, held_out=others)
    mine = some_trials(fit.energy, **beyond)
    energies = np.asarray(others.energies - mine.energies)
    wrenches = np.asarray(others.wrenches - mine.wrenches)
    told = fit.held_out
    np.testing.assert_allclose(told.largest_energy, np.abs(energies).max(), rtol=1e-7)
    expected = np.sqrt(np.mean(wrenches**2, axis=0))
    np.testing.assert_allclose(told.wrench, expected, rtol=1e-7)
    poses = [*trials.poses, *others.poses]
    ratios = [fit.energy.denominator(pose) / BASE(pose) for pose in poses]
    np.testing.assert_allclose(fit.lowest, min(ratios), rtol=1e-9)
    np.testing.assert_allclose(fit.highest, max(ratios), rtol=1e-9)


def noisy():
    """Energies without rhyme, which a free denominator meets by poles between them."""
    poses = some_trials(charges()).poses
    return tj.energies.Trials(
        poses, energies=np.random.default_rng(7).normal(size=len(poses))
    )


def test_a_ridge_keeps_poles_away():
    with pytest.warns(UserWarning, match="the denominator changes sign"):
        free = tj.energies.fit_rational(noisy(), 2, ridge=0.0)
    assert free.has_poles
    assert "warning: the denominator changes sign" in repr(free)
    asked = 2 * np.asarray(some_trials(charges(), 60, seed=3).poses)
    kept = tj.energies.fit_rational(noisy(), 2, clear_of=asked)
    assert kept.ridge > 1e-4
    denominators = [kept.energy.denominator(jnp.asarray(pose)) for pose in asked]
    assert min(denominators) > 0.1
    assert not kept.has_poles


def test_a_base_alone_is_the_denominator_at_any_pose():
    fit = tj.energies.fit_rational(noisy(), 2, base=BASE, denominator="base", scale=0.5)
    for pose in some_poses(2, 12):
        assert_close(fit.energy.denominator(pose), BASE(pose))
    assert (fit.lowest, fit.highest) == (1.0, 1.0)


def test_a_fit_that_interpolates_is_told():
    with pytest.warns(UserWarning, match="interpolates: 27 coefficients for 5 numbers"):
        fit = tj.energies.fit_rational(noisy()[np.arange(5)], 2, ridge=0.0)
    assert fit.rank == fit.equations == 5


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"ridge": -1.0}, "`ridge` is -1.0"),
        ({"scale": 0.0}, "`scale` is 0.0"),
        ({"denominator": "none"}, "must be one of 'free', 'base'"),
        ({"clear_of": [[0.0, 1.0]]}, "`clear_of` has shape (1, 2)"),
        (
            {"base": tj.energies.Polynomial([1.0], [(0, 0, 0)], "twist")},
            "`base` is a polynomial of the twist, but must be one of the twistor",
        ),
        ({"base": tj.energies.Polynomial([1.0], [(2, 0, 0, 0)])}, "write it as 1 - xi^2"),
        (
            {"base": tj.energies.Polynomial([1.0], [(0, 1, 0, 0)])},
            "must be positive at all",
        ),
    ],
)
def test_bad_settings_are_told(settings, message):
    with pytest.raises(ValueError) as error:
        tj.energies.fit_rational(noisy(), 2, **settings)
    assert message in str(error.value)


def test_wrenches_alone_are_refused():
    trials = tj.energies.Trials([[0.1, 0.0, 0.0]], [[1.0, 0.0, 0.0]])
    with pytest.raises(ValueError, match="give both, or take `fit_energy`"):
        tj.energies.fit_rational(trials, 2)
