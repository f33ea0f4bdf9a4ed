"""Objective function of an identification: the residuals and their derivatives."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._utils.pytrees import value_and_jacfwd
from ...designs.parameters import ParameterSet
from ...mechanism.mechanism import Mechanism
from ..experiments.measurement import Measurement
from .optimizer import Evaluation


class IdentificationProblem(eqx.Module):
    """A mechanism with unknown parameters, and the measurements on it.

    The loss is half the sum of the squared residuals. Huber's loss replaces the square of
    a residual by a linear function beyond a threshold. To minimize it by least squares,
    each residual is transformed so that its square is twice Huber's function.
    """

    # Design function, which builds the mechanism from the parameters
    design: Callable[[Any], Mechanism]
    parameters: ParameterSet  # Parameters with their initial values
    data: tuple[Measurement, ...]
    held_out: tuple[Measurement, ...]  # Measurements that are not used for the estimates
    # Threshold of Huber's loss, in standard deviations; None for ordinary least squares
    huber_threshold: float | None = eqx.field(static=True)

    def mechanism(self, normalized: Float[Array, " parameters"]) -> Mechanism:
        mechanism = self.design(self.parameters.tree(normalized))
        if not isinstance(mechanism, Mechanism):
            raise ValueError(
                f"`design` returns a {type(mechanism).__name__}, but must return a "
                "`Mechanism` that is built from the parameters."
            )
        return mechanism

    def residuals(
        self, normalized: Float[Array, " parameters"], *, forward: bool = True
    ) -> Float[Array, " readings"]:
        """Compute the residuals of all tests, transformed if the loss is Huber's.

        For `forward`, see `AbstractTest.predict`.
        """
        mechanism = self.mechanism(normalized)
        tables = []
        for measurement in self.data:
            try:
                tables.append(measurement.residuals(mechanism, forward=forward))
            except ValueError as error:
                raise ValueError(f"{measurement.test!r}: {error}") from error
        residuals = jnp.concatenate([table.reshape(-1) for table in tables])
        if self.huber_threshold is None:
            return residuals
        is_large = jnp.abs(residuals) > self.huber_threshold
        magnitude = jnp.where(is_large, jnp.abs(residuals), 1.0)
        root = jnp.sqrt(self.huber_threshold * (2 * magnitude - self.huber_threshold))
        return jnp.where(is_large, jnp.sign(residuals) * root, residuals)

    def untransformed_residuals(
        self, residuals: Float[Array, " readings"]
    ) -> Float[Array, " readings"]:
        """Recover the residuals of the readings from those of Huber's loss."""
        if self.huber_threshold is None:
            return residuals
        is_large = jnp.abs(residuals) > self.huber_threshold
        magnitude = (residuals**2 / self.huber_threshold + self.huber_threshold) / 2
        return jnp.where(is_large, jnp.sign(residuals) * magnitude, residuals)

    def untransformed_jacobian(
        self, evaluation: Evaluation
    ) -> Float[Array, "readings parameters"]:
        """Recover the Jacobian of the readings' residuals from that of Huber's loss."""
        if self.huber_threshold is None:
            return evaluation.derivatives
        magnitude = jnp.maximum(jnp.abs(evaluation.residuals), self.huber_threshold)
        factor = magnitude / self.huber_threshold
        return evaluation.derivatives * factor[:, None]

    def evaluate(
        self, normalized: Float[Array, " parameters"], *, forward: bool = True
    ) -> Evaluation:
        """Compute the residuals and their derivatives.

        If not `forward`, only the gradient of the loss is computed, in reverse mode.
        """
        if forward:
            return Evaluation(*value_and_jacfwd(self.residuals, normalized))

        def loss(normalized: Array) -> tuple[Array, Array]:
            residuals = self.residuals(normalized, forward=False)
            return jnp.sum(residuals**2) / 2, residuals

        gradient, residuals = jax.grad(loss, has_aux=True)(normalized)
        return Evaluation(residuals, gradient)
