"""Sums of entries, inverses, and solutions of linear systems, single and in batches."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from twistorjax.linalg.elimination import inverse
from twistorjax.linalg.factors import factorize, solve_once
from twistorjax.linalg.sums import sum_entries


def test_sums_of_entries_and_their_derivatives_agree_with_numpy():
    """A sum is the product with a matrix, whose transpose has the derivatives."""
    rng = np.random.default_rng(2)
    source, target = rng.integers(0, 9, 40), rng.integers(0, 20, 40)
    signs = rng.choice([-1.0, 1.0], 40)
    matrix = np.zeros((20, 9))
    np.add.at(matrix, (target, source), signs)
    entries, weights = rng.normal(size=(3, 4, 9)), rng.normal(size=(3, 4, 20))

    def sums(entries):
        return sum_entries(entries, source, target, 20, signs)

    @jax.jit
    def sums_and_gradient(entries, weights):
        batch, pull_back = jax.vjp(jax.vmap(jax.vmap(sums)), entries)
        return sums(entries[0, 0]), batch, *pull_back(weights)

    single, batch, gradient = sums_and_gradient(entries, weights)
    np.testing.assert_allclose(single, matrix @ entries[0, 0], atol=1e-14)
    np.testing.assert_allclose(batch, entries @ matrix.T, atol=1e-14)
    np.testing.assert_allclose(gradient, weights @ matrix, atol=1e-14)


@pytest.mark.parametrize("batched", [(True, True), (True, False), (False, True)])
def test_a_batch_of_stiffnesses_is_solved_as_each_of_them(batched):
    """NumPy solves the systems; the smallest eigenvalue decides about stability."""
    rng = np.random.default_rng(0)
    roots, rights = rng.normal(size=(6, 5, 5)), rng.normal(size=(6, 2, 5))
    shifts = np.array([0.1, 1.0, -3.0, 0.5, -9.0, 2.0])  # two are unstable
    matrices = roots @ roots.transpose(0, 2, 1) + shifts[:, None, None] * np.eye(5)
    if not batched[0]:
        matrices = np.broadcast_to(matrices[0], matrices.shape)
    if not batched[1]:
        rights = np.broadcast_to(rights[0], rights.shape)
    stable = np.linalg.eigvalsh(matrices)[:, 0] > 0
    arguments = [
        values if axis else values[0]
        for values, axis in zip((matrices, rights), batched, strict=True)
    ]
    in_axes = [0 if axis else None for axis in batched]

    def solve(matrix, rights):
        return solve_once(matrix, rights, symmetric=True)

    found, found_stable = map(np.asarray, jax.jit(jax.vmap(solve, in_axes))(*arguments))
    assert np.array_equal(found_stable, stable)
    expected = np.linalg.solve(matrices[:, None], rights[..., None])[..., 0]
    np.testing.assert_allclose(found[stable], expected[stable], rtol=1e-9)


def test_derivatives_of_solutions_agree_with_numpy():
    """JAX needs a solution that does not depend on the batch of changes."""
    rng = np.random.default_rng(3)
    roots, changes, other = rng.normal(size=(3, 6, 5, 5))
    matrices = roots @ roots.transpose(0, 2, 1) + np.eye(5)
    changes = changes + changes.transpose(0, 2, 1)
    rights, right_changes = other[:, :2], other[:, 2:4]

    def solve(change, matrix, matrix_change, right, right_change):
        matrix = matrix + change * matrix_change
        right = right + change * right_change
        return solve_once(matrix, right, symmetric=True)[0]

    systems = matrices, changes, rights, right_changes
    solutions = np.linalg.solve(matrices[:, None], rights[..., None])[..., 0]
    differences = right_changes - np.einsum("brj,bji->bri", solutions, changes)
    expected = np.linalg.solve(matrices[:, None], differences[..., None])[..., 0]
    for derivative in (jax.jacfwd(solve), jax.jacrev(solve)):
        single = jax.jit(derivative)(0.0, *(values[0] for values in systems))
        np.testing.assert_allclose(single, expected[0], rtol=1e-8)
        batch = jax.jit(jax.vmap(derivative))(np.zeros(6), *systems)
        np.testing.assert_allclose(batch, expected, rtol=1e-8)


@pytest.mark.parametrize("imaginary", [0.0, 1.0j])
def test_inverses_in_batches_and_their_derivatives_agree_with_numpy(imaginary):
    """The symmetric part of each matrix is positive definite."""
    rng = np.random.default_rng(1)
    random = rng.normal(size=(4, 6, 5, 5))
    roots, skew, other, changes = random
    matrices = roots @ roots.transpose(0, 2, 1) + np.eye(5)
    matrices = matrices + skew - skew.transpose(0, 2, 1) + imaginary * other
    changes = changes.astype(matrices.dtype)
    inverses = np.linalg.inv(matrices)

    @jax.jit
    def inverses_rates_and_gradient(matrices, changes):
        _, pull_back = jax.vjp(jax.vmap(inverse), matrices)
        rates = [
            jax.jvp(function, (matrices,), (changes,))
            for function in (inverse, jax.vmap(inverse))
        ]
        return inverse(matrices[0]), rates, pull_back(changes)

    single, results, (gradient,) = inverses_rates_and_gradient(matrices, changes)
    for found, rates in results:
        np.testing.assert_allclose(found, inverses, rtol=1e-9, atol=1e-12)
        expected = -inverses @ changes @ inverses
        np.testing.assert_allclose(rates, expected, rtol=1e-8, atol=1e-11)
    np.testing.assert_allclose(single, inverses[0], rtol=1e-9, atol=1e-12)
    if not imaginary:
        transposed = inverses.transpose(0, 2, 1)
        expected = -transposed @ changes @ transposed
        np.testing.assert_allclose(gradient, expected, rtol=1e-8, atol=1e-11)


@pytest.mark.parametrize("size", [1, 5, 30])
def test_solutions_by_factors_and_their_derivatives_agree_with_numpy(size):
    """Stiffnesses of 24 rows and less are factorized by elimination, others by LAPACK."""
    rng = np.random.default_rng(size)
    root, change, force = rng.normal(size=(3, size, size))
    units = np.logspace(-3, 3, size)
    stiffness = units[:, None] * (root @ root.T + np.eye(size)) * units
    change = units[:, None] * (change + change.T) * units
    force = units * force[0]

    def solve(stiffness):
        return factorize(stiffness, symmetric=True).solve(jnp.asarray(force))

    found, rate = jax.jit(lambda *arguments: jax.jvp(solve, *arguments))(
        (stiffness,), (change,)
    )
    expected = np.linalg.solve(stiffness, force)
    expected_rate = -np.linalg.solve(stiffness, change @ expected)
    for value, exact in ((found, expected), (rate, expected_rate)):
        error = np.linalg.norm(units * (value - exact))
        assert error < 1e-9 * np.linalg.norm(units * exact)


@pytest.mark.parametrize("size", [1, 5, 30])
def test_solutions_of_a_stiffness_that_is_not_positive_definite_are_nan(size):
    @jax.jit
    @partial(jax.jacrev, has_aux=True)
    def derivatives_and_solution(factor, stiffness):
        factors = factorize(factor * stiffness, symmetric=True)
        solution, stable = factors.solve_and_check(jnp.ones(size))
        return solution, (solution, stable)

    stiffness = np.diag(np.logspace(-3, 3, size))
    _, (_, stable) = derivatives_and_solution(1.0, stiffness)
    assert stable
    stiffness[-1, -1] *= -1
    derivatives, (solution, stable) = derivatives_and_solution(1.0, stiffness)
    assert not stable
    assert np.all(np.isnan(solution))
    assert np.all(np.isnan(derivatives))


@pytest.mark.parametrize("size", [5, 30])
def test_stability_does_not_depend_on_the_forces(size):
    """JAX raises an error if it finds one value for each member of a batch of forces."""

    @jax.jit
    def are_stable(forces):
        factors = factorize(jnp.eye(size), symmetric=True)

        def is_stable(force):
            return factors.solve_and_check(force)[1]

        return jax.vmap(is_stable, out_axes=None)(forces)

    assert are_stable(np.ones((3, size)))
