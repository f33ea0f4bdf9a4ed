"""Fits of mixed energies to trials."""

import pathlib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from helpers import assert_close

import twistorjax as tj


REFERENCE = pathlib.Path(__file__).parent / "reference"


@pytest.mark.parametrize(
    ("name", "limit"),
    [("fe_leaf", 2e-4), ("fe_notch", 1e-5)],
)
def test_mixed_energy_fits_finite_elements_to_their_own_error(name, limit, validated):
    """The held-out and the expected errors have the same order of magnitude."""
    trials = tj.energies.read_trials(REFERENCE / f"{name}.csv")
    fit = tj.fit_energy(
        trials, order=6, coordinates="mixed", symmetry="leaf", hold_out=0.2
    )
    assert fit.held_out is not None
    np.testing.assert_array_less(fit.held_out.relative, limit)
    np.testing.assert_array_less(fit.expected.relative, limit)
    assert np.all(fit.held_out.relative > fit.expected.relative / 10)
    hinge = {"fe_leaf": "a leaf", "fe_notch": "a notch"}[name]
    what = f"mixed energy of {hinge}, held-out trials (rms, worst component)"
    oracle = "plane finite elements"
    validated("Fits", what, 1 + np.max(fit.held_out.relative), 1.0, oracle)
    limited = fit.with_validity_range
    largest = trials.poses[np.argmax(np.abs(trials.poses[:, 0]))]
    assert_close(limited.wrench(largest), fit.energy.wrench(largest), digits=14)
    with pytest.raises(ValueError, match="Outside the validity range of the energy"):
        limited.wrench(1.01 * largest)


def test_fit_recovers_a_mixed_energy():
    leaf = tj.energies.MixedEnergy([0.5, 6.0, -1e-3, 0.6, -0.08, -0.01], [
        (2, 0, 0), (0, 2, 0), (0, 0, 2), (0, 2, 1), (2, 0, 1), (0, 2, 2),
    ], length=0.2, force=1.0)  # fmt: skip
    poses = np.random.default_rng(0).uniform(-1, 1, (30, 3)) * [0.5, 1e-3, 0.1]
    poses[:, 1] -= poses[:, 2] ** 2
    wrenches = jax.vmap(leaf.wrench)(jnp.array(poses))
    fit = tj.fit_energy(
        tj.energies.Trials(poses, wrenches),
        2,
        coordinates="mixed",
        symmetry="leaf",
        scale=0.2,
    )
    np.testing.assert_array_less(fit.training.relative, 1e-10)
    np.testing.assert_allclose(
        fit.energy.tangent_stiffness(), leaf.tangent_stiffness(), rtol=1e-8, atol=1e-8
    )


@pytest.mark.slow
def test_mixed_fit_to_noisy_trials_has_the_smallest_possible_error():
    """SciPy minimizes the errors of the predicted wrenches over all coefficients."""
    monomials = tj.energies.monomials(2, "mixed", symmetry="leaf")
    powers = tuple(row for row in monomials if sum(row) > 1)
    known = {(2, 0, 0): 0.5, (0, 2, 0): 6.0, (0, 2, 1): 0.6, (2, 0, 1): 0.08}
    leaf = tj.energies.MixedEnergy(
        [*known.values(), -1e-3], [*known, (0, 0, 2)], length=1.0, force=3.0
    )
    rng = np.random.default_rng(2)
    poses = rng.uniform(-1, 1, (60, 3)) * [0.5, 1e-3, 0.2]
    poses[:, 1] -= 0.2 * poses[:, 2] ** 2
    exact = np.asarray(jax.vmap(leaf.wrench)(jnp.asarray(poses)))
    deviations = 0.1 * np.sqrt(np.mean(exact**2, axis=0))
    noisy = exact + deviations * rng.normal(size=exact.shape)
    trials = tj.energies.Trials(poses, noisy, wrench_deviations=deviations)
    with pytest.warns(UserWarning, match="the error at new trials is up to 1"):
        fit = tj.fit_energy(
            trials, 2, coordinates="mixed", symmetry="leaf", ridge=0.0, scale=1.0
        )

    assert isinstance(fit.energy, tj.energies.MixedEnergy)
    found, force = fit.energy.coefficients, fit.energy.force

    @jax.jit
    def residuals(coefficients):
        energy = tj.energies.MixedEnergy(coefficients, powers, length=1.0, force=force)
        errors = jax.vmap(energy.wrench)(trials.poses) - noisy
        return (errors / deviations[None]).ravel()

    jacobian: Any = jax.jit(jax.jacfwd(residuals))
    units = np.abs(found)
    start = found + 0.03 * units * rng.normal(size=len(powers))
    smallest = scipy.optimize.least_squares(residuals, start, jacobian, x_scale=units)
    cost = jnp.sum(residuals(found) ** 2)
    np.testing.assert_allclose(cost, 2 * smallest.cost, rtol=1e-6)
    assert cost > 0.5 * residuals(found).size


@pytest.mark.parametrize("order", [-1, 0, 1, True])
def test_order_of_a_fit_is_at_least_that_of_a_stiffness(order):
    trials = tj.energies.read_trials(REFERENCE / "random_trials.csv")
    with pytest.raises(ValueError, match=f"`order` is {order}, but must be"):
        tj.fit_energy(trials, order, coordinates="mixed", symmetry="leaf")


def test_compliance_that_is_negative_without_load_raises_an_error():
    """It is 0.1 t^2 - 0.02 in a guided translation t, and all trials have t > 0.6."""
    rng = np.random.default_rng(0)
    t, n = rng.uniform(0.6, 1.0, 40), rng.uniform(-1.0, 1.0, 40)
    axial = -0.3 * t**2 + 2 * n * (0.1 * t**2 - 0.02)
    force = 6 * t + 0.6 * n * t - 0.2 * n**2 * t
    trials = tj.energies.Trials(
        np.stack([0 * t, axial, t], axis=1), np.stack([0 * t, n, force], axis=1)
    )
    with pytest.raises(ValueError, match="and in the reference configuration"):
        tj.fit_energy(trials, 4, coordinates="mixed", reference="unstressed")


@pytest.mark.slow
def test_message_names_the_reversed_force_if_there_is_no_mixed_energy():
    trials = tj.energies.read_trials(REFERENCE / "fe_leaf.csv")[np.arange(0, 122, 2)]
    assert trials.wrenches is not None
    reversed_force = tj.energies.Trials(
        trials.poses, trials.wrenches * np.array([[1.0, -1.0, 1.0]])
    )
    with pytest.raises(ValueError, match="forces along axis 1 is reversed"):
        tj.fit_energy(reversed_force, 4, coordinates="mixed", symmetry="leaf")


@pytest.mark.parametrize("forces", [[0.1, 0.0], [1e100, 1e-100]])
def test_huge_trials_are_reported(forces):
    poses = np.zeros((4, 3))
    poses[1:, 1:], poses[3, 0] = [[0.0, 0.1], [1e90, 0.0], [0.0, 1e100]], 1e100
    wrenches = np.zeros((4, 3))
    wrenches[1:3, 1] = forces
    with pytest.raises(ValueError, match="values of the `trials` are too large"):
        tj.fit_energy(tj.energies.Trials(poses, wrenches), coordinates="mixed")


def test_mixed_energy_of_unsuitable_trials_raises_an_error():
    trials = tj.energies.read_trials(REFERENCE / "random_trials.csv")
    poses, wrenches = np.asarray(trials.poses), np.asarray(trials.wrenches)
    pulls_when_compressed = tj.energies.Trials(poses * [0, 1, 1], -poses * [0, 1, -1])
    with pytest.raises(ValueError, match=r"No mixed energy was found.*sign rev"):
        tj.fit_energy(
            pulls_when_compressed, 2, coordinates="mixed", reference="unstressed"
        )
    for missing, unsuitable in (
        ("displacement", tj.energies.Trials(poses * [0, 0, 1], wrenches)),
        ("force", tj.energies.Trials(poses * [0, 1, 1], wrenches * [1, 0, 1])),
    ):
        with pytest.raises(ValueError, match=f"The axial {missing} of all"):
            tj.fit_energy(unsuitable, 2, coordinates="mixed")
    without_wrenches = tj.energies.Trials(trials.poses, energies=np.ones(17))
    with pytest.raises(ValueError, match="needs the wrench of each"):
        tj.fit_energy(without_wrenches, 2, coordinates="mixed")
    with pytest.warns(UserWarning, match="the error at new trials is up to 31"):
        fit = tj.fit_energy(without_wrenches, 2, symmetry="leaf")
    with pytest.raises(ValueError, match="has no validity range"):
        _ = fit.with_validity_range
