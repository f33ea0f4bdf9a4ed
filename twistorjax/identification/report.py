"""Result of an identification: estimates, uncertainties and warnings."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._utils.compilation import fast_compile
from .._utils.host import all_concrete
from .._utils.types import BatchFlag, BatchScalar, Parameters, Scalar
from ..solve.results import result_names, RESULTS
from . import diagnostics
from .objective import IdentificationProblem
from .optimizer import exceeds_rounding


class Identification(eqx.Module):
    """Estimated parameters of a mechanism, and their uncertainties.

    The uncertainties follow from the linearization of the model at the estimates. They
    assume that the errors of the readings are normal, independent, and as large as the
    given standard deviations.

    Args:
        estimates: Estimated values, in a pytree with the structure of `start`.
        normalized: Normalized parameters at the estimates: dimensionless changes from the
            initial values, which are relative changes if they are small.
        jacobian: Derivatives of the residuals with respect to the normalized parameters.
        residuals: Residuals of each measurement: predicted minus measured values, divided
            by the standard deviations of the readings.
        held_out_residuals: Residuals of the measurements that were held out.
        loss: Half the sum of the squared residuals, or Huber's loss.
        losses: Loss at the end of the search from each start.
        steps: Number of evaluations.
        result: Result code; `result_names` returns its name.
        problem: Design function, parameters, and measurements.
    """

    estimates: Any
    normalized: Float[Array, "*batch parameters"]
    jacobian: Float[Array, "*batch readings parameters"]
    residuals: tuple[Float[Array, "*batch _rows _columns"], ...]
    held_out_residuals: tuple[Float[Array, "*batch _rows _columns"], ...]
    loss: BatchScalar
    losses: Float[Array, "*batch restarts"]
    steps: Int[Array, "*batch"]
    result: RESULTS
    problem: IdentificationProblem

    @property
    def succeeded(self) -> BatchFlag:
        """Whether the search has converged."""
        return self.result == RESULTS.successful

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of `covariance`."""
        return self.problem.parameters.names

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters, in the order of `names`."""
        return self.problem.parameters.units

    @property
    def values(self) -> Parameters:
        """Estimated values as a vector, in the order of `names`."""
        return self.problem.parameters.vector(self.normalized)

    @property
    @fast_compile
    def normalized_covariance(self) -> Float[Array, "parameters parameters"]:
        """Covariance of the normalized parameters.

        The variance of a parameter that the readings do not determine is infinite. For
        Huber's loss the covariance takes the distribution of the residuals into account.
        """
        _, singular_values, directions = jnp.linalg.svd(
            self.jacobian, full_matrices=False
        )
        determined = exceeds_rounding(singular_values)
        divisor = jnp.where(determined, singular_values, 1.0)
        inverse = jnp.where(determined, 1 / divisor, 0.0)
        root = directions.T * inverse[None]
        covariance = root @ root.T
        if self.problem.huber_threshold is not None:
            factor = self._huber_correction(self.problem.huber_threshold)
            covariance = factor * covariance
        kept = jnp.where(determined[:, None], directions, 0.0)
        undetermined = jnp.sum(kept**2, axis=0) < 1 - 1e-9
        diagonal = jnp.where(undetermined, jnp.inf, jnp.diagonal(covariance))
        return jnp.where(jnp.eye(diagonal.size, dtype=bool), diagonal[None], covariance)

    def _huber_correction(self, threshold: float) -> Scalar:
        """Factor by which Huber's loss increases the covariance, at least 1.

        The threshold of Huber's loss is in standard deviations.

        Source:
            Huber, Robust Statistics, 1981, section 7.6.
        """
        residuals = jnp.concatenate([table.reshape(-1) for table in self.residuals])
        exists = jnp.concatenate(
            [jnp.isfinite(each.values).reshape(-1) for each in self.problem.data]
        )
        count = jnp.sum(jnp.where(exists, 1.0, 0.0))
        parameters = float(len(self.names))
        clipped = jnp.clip(residuals, -threshold, threshold)
        is_small = exists & (jnp.abs(residuals) <= threshold)
        share = jnp.sum(jnp.where(is_small, 1.0, 0.0)) / count
        variance = jnp.sum(clipped**2) / jnp.maximum(count - parameters, 1.0)
        small_sample = 1 + parameters / count * (1 - share) / share
        return jnp.maximum(small_sample**2 * variance / share**2, 1.0)

    @property
    @fast_compile
    def covariance(self) -> Float[Array, "parameters parameters"]:
        """Covariance of the estimates, in the products of their units.

        The variance of a parameter that the readings do not determine is infinite.
        """
        derivatives = self.problem.parameters.derivatives(self.normalized)
        covariance = self.normalized_covariance
        scaled = covariance * derivatives[:, None] * derivatives[None]
        return jnp.where(jnp.isinf(covariance), jnp.inf, scaled)

    @property
    @fast_compile
    def standard_errors(self) -> Any:
        """Standard errors of the estimates, in a pytree with the structure of `start`."""
        standard_errors = jnp.sqrt(jnp.diagonal(self.covariance))
        return self.problem.parameters.unflatten(standard_errors)

    @property
    @fast_compile
    def correlation(self) -> Float[Array, "parameters parameters"]:
        """Correlation matrix of the estimates."""
        covariance = self.normalized_covariance
        errors = jnp.sqrt(jnp.diagonal(covariance))
        correlation = covariance / (errors[:, None] * errors[None])
        return jnp.where(jnp.eye(errors.size, dtype=bool), 1.0, correlation)

    def confidence_interval(self, level: float = 0.95) -> tuple[Any, Any]:
        """Compute confidence intervals of the parameters, within their bounds.

        Args:
            level: Confidence level: share of such intervals that contain the true value.

        Returns:
            The lower and the upper limits, each in a pytree with the structure of
            `start`.

        Raises:
            ValueError: The level is not between 0 and 1.
        """
        if not 0 < level < 1:
            raise ValueError(f"`level` is {level}, but must be between 0 and 1: 0.95.")
        quantile = jax.scipy.special.ndtri((1 + level) / 2)
        half_width = quantile * jnp.sqrt(jnp.diagonal(self.normalized_covariance))
        parameters = self.problem.parameters
        low = parameters.vector(self.normalized - half_width)
        high = parameters.vector(self.normalized + half_width)
        return parameters.unflatten(low), parameters.unflatten(high)

    @property
    def mechanism(self) -> Any:
        """Mechanism that the design function builds from the estimates."""
        return self.problem.design(self.estimates)

    @property
    def reading_count(self) -> int:
        """Number of readings from which the parameters were estimated."""
        return diagnostics.count_readings(self.problem.data)

    @property
    def undetermined_directions(self) -> tuple[str, ...]:
        """Descriptions of the changes of the parameters that the readings do not show.

        A direction is undetermined if its standard error is larger than a relative change
        of the parameters by 100 %.
        """
        return diagnostics.undetermined_directions(self)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reasons to doubt the estimates or their standard errors."""
        return diagnostics.warnings(self)

    def __repr__(self) -> str:
        name = result_names(self.result)
        arrays = [self.normalized, self.jacobian, *self.residuals]
        if name is None or np.shape(name) or all_concrete(arrays) is None:
            return eqx.tree_pformat(self)
        return diagnostics.summary(self)
