"""Functions that several tests use: comparisons, derivatives, and random test data."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest


def assert_close(actual, expected, *, digits=12):
    """Check the shape, and the values up to a number of digits or decimals."""
    assert np.shape(actual) == np.shape(expected)
    tolerance = 10.0**-digits
    np.testing.assert_allclose(actual, expected, rtol=tolerance, atol=tolerance)


def with_value(function):
    """Return a function for `has_aux=True`, so that its derivative comes with its value.

    One program then computes both a derivative and the values for difference quotients.
    """

    def value_twice(argument):
        value = function(argument)
        return value, value

    return value_twice


def value_and_slopes(function, at):
    """Return a value, and its derivatives in forward mode and in reverse mode."""
    at = jnp.asarray(at)
    value, change = jax.linearize(function, at)
    forward = jax.vmap(change, out_axes=-1)(jnp.eye(at.size).reshape(-1, *at.shape))
    basis = jnp.eye(value.size).reshape(-1, *value.shape)
    (reverse,) = jax.vmap(jax.linear_transpose(change, at))(basis)
    shape = *value.shape, *at.shape
    return value, forward.reshape(shape), reverse.reshape(shape)


def for_each(function, *arguments):
    """Return the values of a function for each row of its arguments, as one program."""
    return np.asarray(jax.jit(jax.vmap(function))(*arguments))


def some_poses(seed, count=64):
    """Return random poses; the first have angles at which a formula may be singular."""
    special = [0.0, 1e-9, 1e-4, np.pi / 2, np.pi, -np.pi, 1.9 * np.pi]
    poses = np.random.default_rng(seed).uniform(-3.0, 3.0, (count, 3))
    poses[: len(special), 0] = special
    poses[0] = 0.0
    return poses


def some_stiffness(seed):
    """Return a random symmetric, positive definite matrix without zeros."""
    with jax.ensure_compile_time_eval():  # also inside of `jax.jit`
        root = np.asarray(jr.normal(jr.key(seed), (3, 3)))
    return root @ root.T + np.eye(3)


def one_slow(cases):
    """Mark the first case of a parametrized test as slow, and the others as release."""
    first, *others = cases
    slow = pytest.param(first, marks=pytest.mark.slow)
    return [slow, *(pytest.param(case, marks=pytest.mark.release) for case in others)]


def mostly_slow(cases, fast=1):
    """Mark all cases of a parametrized test as slow, except for the first ones."""
    return [
        case if k < fast else pytest.param(case, marks=pytest.mark.slow)
        for k, case in enumerate(cases)
    ]
