"""Functions that several tests use: comparison of arrays, and random test data."""

import jax.numpy as jnp
import jax.random as jr
import numpy as np


def assert_close(actual, expected, *, digits=12):
    """Check the shape, and the values up to a number of digits or decimals."""
    assert np.shape(actual) == np.shape(expected)
    tolerance = 10.0**-digits
    np.testing.assert_allclose(actual, expected, rtol=tolerance, atol=tolerance)


def some_poses(seed, count=64):
    """Return random poses; the first have angles at which a formula may be singular."""
    special = [0.0, 1e-9, 1e-4, jnp.pi / 2, jnp.pi, -jnp.pi, 1.9 * jnp.pi]
    poses = jr.uniform(jr.key(seed), (count, 3), minval=-3.0, maxval=3.0)
    poses = poses.at[: len(special), 0].set(jnp.array(special))
    return poses.at[0].set(0.0)


def some_stiffness(seed):
    """Return a random symmetric, positive definite matrix without zeros."""
    root = jr.normal(jr.key(seed), (3, 3))
    return root @ root.T + jnp.eye(3)
