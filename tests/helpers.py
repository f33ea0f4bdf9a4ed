import jax.numpy as jnp
import jax.random as jr
import numpy as np


def assert_close(actual, expected, *, digits=12):
    """Equal in shape, and in value up to `digits` digits or decimals."""
    assert np.shape(actual) == np.shape(expected)
    tolerance = 10.0**-digits
    np.testing.assert_allclose(actual, expected, rtol=tolerance, atol=tolerance)


def some_poses(seed, count=64):
    """Poses at random, after those at which charts break: at rest and whole turns."""
    special = [0.0, 1e-9, 1e-4, jnp.pi / 2, jnp.pi, -jnp.pi, 1.9 * jnp.pi]
    poses = jr.uniform(jr.key(seed), (count, 3), minval=-3.0, maxval=3.0)
    poses = poses.at[: len(special), 0].set(jnp.array(special))
    return poses.at[0].set(0.0)


def some_stiffness(seed):
    """A symmetric, positive definite matrix with every coupling."""
    root = jr.normal(jr.key(seed), (3, 3))
    return root @ root.T + jnp.eye(3)
