"""Interface of the optimizers that find the parameters with the smallest residuals.

An evaluation of the residuals simulates all tests, so it is expensive and is compiled
once. An optimizer is compiled separately: its step takes the result of an evaluation and
returns the point of the next one. Solvers of optimistix, in contrast, call the function
themselves. The points are vectors of normalized parameters.
"""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..._utils.types import Flag, Scalar


# Sensitivities below this fraction of the largest one are rounding errors.
ROUNDING = 1e-10


def exceeds_rounding(
    sensitivities: Float[Array | np.ndarray, " n"],
) -> Bool[Array | np.ndarray, " n"]:
    """Determine which sensitivities of the residuals are larger than rounding errors.

    They are singular values or column norms of the Jacobian of the residuals. One above 1
    always counts: there a relative change of a parameter by 100 % changes the readings by
    more than one standard deviation.
    """
    largest = sensitivities.max(initial=0.0)
    return (sensitivities > ROUNDING * largest) | (sensitivities > 1)


class Evaluation(eqx.Module):
    """Residuals and derivatives at one point."""

    # Residual of each reading, in standard deviations; NaN if a solve fails
    residuals: Float[Array, " readings"]
    # Jacobian of the residuals; or gradient of the loss, if there are many parameters
    derivatives: Float[Array, "*readings parameters"]

    @property
    def loss(self) -> Scalar:
        """Half the sum of the squared residuals; infinite if a solve fails."""
        loss = jnp.sum(self.residuals**2) / 2
        return jnp.where(jnp.isfinite(loss), loss, jnp.inf)

    @property
    def gradient(self) -> Float[Array, " parameters"]:
        """Gradient of the loss; zero if a solve fails."""
        gradient = self.derivatives
        if gradient.ndim == 2:
            gradient = self.residuals @ gradient
        return jnp.where(jnp.isfinite(self.loss), gradient, 0.0)


class AbstractOptimizer(eqx.Module):
    """Method that chooses the next point from the evaluations so far.

    It needs the derivatives of all residuals, or only the gradient of the loss.
    """

    needs_jacobian: ClassVar[bool] = True

    @abstractmethod
    def init(self, point: Float[Array, " parameters"], evaluation: Evaluation) -> Any:
        """Create the first state, from an evaluation whose values are NaN."""

    @abstractmethod
    def step(
        self, point: Float[Array, " parameters"], evaluation: Evaluation, state: Any
    ) -> tuple[Float[Array, " parameters"], Any, Flag]:
        """Return the next point, the next state, and whether the method has converged."""


def from_numpy(value: Any) -> Array:
    """Create an array with NumPy, because `jax.numpy` would compile a program."""
    return jax.device_put(np.asarray(value))
