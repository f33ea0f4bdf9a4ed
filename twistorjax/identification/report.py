"""Result of an identification: estimates, uncertainties and warnings."""

from collections.abc import Callable
from functools import wraps
from statistics import NormalDist
from typing import Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._utils.host import all_concrete, as_float, on_host
from .._utils.types import BatchFlag, BatchScalar, NumberLike, Parameters
from ..results.codes import result_names, RESULTS
from . import diagnostics
from .estimation.objective import IdentificationProblem
from .estimation.optimizer import exceeds_rounding


# A parameter is at its bound if its distance to the bound is exp(-12) of the initial one;
# or if it is less than 1/e of the initial one, and the linearized model has its minimum
# beyond the bound, or nearer to it by a factor of ten.
_AT_BOUND, _NEAR_BOUND, _STEP_TO_BOUND = 12.0, 1.0, 0.9


_Method = TypeVar("_Method", bound=Callable[..., Any])


def _for_each(method: _Method) -> _Method:
    """Apply a method of one identification to each entry of a batch of them."""

    @wraps(method)
    def for_each(self: Any, *arguments: Any) -> Any:
        if self.normalized.ndim == 1:
            return method(self, *arguments)
        return eqx.filter_vmap(lambda one: for_each(one, *arguments))(self)

    return for_each  # pyright: ignore[reportReturnType]


class Identification(eqx.Module):
    """Estimated parameters of a mechanism, and their uncertainties.

    The uncertainties follow from the linearization of the model at the estimates. They
    assume that the errors of the readings are normal, independent, and as large as the
    given standard deviations. If an estimate is at its bound, they are those of the model
    without the bound, and a warning says so.

    The result of `jax.vmap` is a batch of identifications, with one more axis in all
    arrays. The texts are those of one identification:
    `jax.tree.map(lambda array: array[0], batch).warnings`.

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
    @_for_each
    def values(self) -> Float[Array, "*batch parameters"]:
        """Estimated values as a vector, in the order of `names`."""
        return self.problem.parameters.vector(self.normalized)

    @property
    @_for_each
    def normalized_covariance(self) -> Float[Array, "*batch parameters parameters"]:
        """Covariance of the normalized parameters.

        The variance of a parameter that the readings do not determine is infinite. For
        Huber's loss the covariance takes the distribution of the residuals into account.
        """
        xp, (jacobian, growth) = on_host(self.jacobian, self._distance_ratios())
        _, singular_values, directions = xp.linalg.svd(
            jacobian * growth[None], full_matrices=False
        )
        determined = exceeds_rounding(singular_values)
        divisor = xp.where(determined, singular_values, 1.0)
        inverse = xp.where(determined, 1 / divisor, 0.0)
        root = directions.T * inverse[None]
        covariance = root @ root.T
        if self.problem.huber_threshold is not None:
            factor = self._huber_correction(self.problem.huber_threshold)
            covariance = factor * covariance
        covariance = covariance * growth[:, None] * growth[None]
        kept = xp.where(determined[:, None], directions, 0.0)
        undetermined = xp.sum(kept**2, axis=0) < 1 - 1e-9
        diagonal = xp.where(undetermined, xp.inf, xp.diagonal(covariance))
        on_diagonal = np.eye(len(self.names), dtype=bool)
        return as_float(xp.where(on_diagonal, diagonal[None], covariance))

    def _distance_ratios(self) -> Parameters:
        """Ratio of the initial to the final distance of each parameter from its bound.

        It is at least 1. The readings hardly depend on the normalized value of a
        parameter near its bound; with this factor they depend on it as at the start.
        """
        parameters = self.problem.parameters
        start = as_float(np.zeros(len(self.names)))
        xp, (initial, final) = on_host(
            parameters.derivatives(start), parameters.derivatives(self.normalized)
        )
        lower, upper = parameters.bounds
        is_bounded = np.isfinite(lower) | np.isfinite(upper)
        ratios = initial / xp.maximum(final, 1e-100 * initial)
        return as_float(xp.where(is_bounded, xp.maximum(ratios, 1.0), 1.0))

    @property
    @_for_each
    def bound_sides(self) -> Int[Array, "*batch parameters"]:
        """Bound at which each estimate is: -1 for the lower, 1 for the upper, 0 for none.

        An estimate is also at its bound if the linearized model has its minimum at the
        bound or beyond it. The search ends before it has reached the bound if the rest of
        the distance is smaller than the standard error.
        """
        xp, (jacobian, growth, normalized, *tables) = on_host(
            self.jacobian, self._distance_ratios(), self.normalized, *self.residuals
        )
        residuals = xp.concatenate([table.reshape(-1) for table in tables])
        if (threshold := self.problem.huber_threshold) is not None:
            residuals = xp.clip(residuals, -threshold, threshold)
        left, singular_values, directions = xp.linalg.svd(
            jacobian * growth[None], full_matrices=False
        )
        determined = exceeds_rounding(singular_values)
        divisor = xp.where(determined, singular_values, 1.0)
        components = xp.where(determined, residuals @ left / divisor, 0.0)
        step = -growth * (components @ directions)
        lower, upper = self.problem.parameters.bounds

        def is_at_bound(change: Any, step: Any) -> Any:
            near = (change > _NEAR_BOUND) & (step >= _STEP_TO_BOUND)
            return near | (change > _AT_BOUND)

        at_lower = is_at_bound(-normalized, -step) & np.isfinite(lower)
        at_upper = is_at_bound(normalized, step) & np.isfinite(upper)
        sides = xp.where(at_lower, -1, xp.where(at_upper, 1, 0))
        return jnp.asarray(sides)

    def _huber_correction(self, threshold: float) -> NumberLike:
        """Factor by which Huber's loss increases the covariance, at least 1.

        The threshold of Huber's loss is in standard deviations.

        Source:
            Huber, Robust Statistics, 1981, section 7.6.
        """
        data = self.problem.data
        xp, tables = on_host(*self.residuals, *(each.values for each in data))
        residuals, values = (
            xp.concatenate([table.reshape(-1) for table in half])
            for half in (tables[: len(data)], tables[len(data) :])
        )
        exists = xp.isfinite(values)
        count = xp.sum(xp.where(exists, 1.0, 0.0))
        parameters = float(len(self.names))
        clipped = xp.clip(residuals, -threshold, threshold)
        is_small = exists & (xp.abs(residuals) <= threshold)
        share = xp.sum(xp.where(is_small, 1.0, 0.0)) / count
        variance = xp.sum(clipped**2) / xp.maximum(count - parameters, 1.0)
        small_sample = 1 + parameters / count * (1 - share) / share
        return xp.maximum(small_sample**2 * variance / share**2, 1.0)

    @property
    @_for_each
    def covariance(self) -> Float[Array, "*batch parameters parameters"]:
        """Covariance of the estimates, in the products of their units.

        The variance of a parameter that the readings do not determine is infinite.
        """
        xp, (covariance, derivatives) = on_host(
            self.normalized_covariance,
            self.problem.parameters.derivatives(self.normalized),
        )
        infinite = xp.isinf(covariance)
        finite = xp.where(infinite, 0.0, covariance)
        scaled = finite * derivatives[:, None] * derivatives[None]
        return as_float(xp.where(infinite, xp.inf, scaled))

    @property
    @_for_each
    def standard_errors(self) -> Any:
        """Standard errors of the estimates, in a pytree with the structure of `start`."""
        xp, (covariance,) = on_host(self.covariance)
        errors = as_float(xp.sqrt(xp.diagonal(covariance)))
        return self.problem.parameters.unflatten(errors)

    @property
    @_for_each
    def correlation(self) -> Float[Array, "*batch parameters parameters"]:
        """Correlation matrix of the estimates."""
        xp, (covariance,) = on_host(self.normalized_covariance)
        on_diagonal = np.eye(len(self.names), dtype=bool)
        errors = xp.sqrt(xp.diagonal(covariance))
        # An undetermined parameter has an infinite variance, and finite covariances.
        others = xp.where(on_diagonal, 0.0, covariance)
        correlation = others / (errors[:, None] * errors[None])
        return as_float(xp.where(on_diagonal, 1.0, correlation))

    @_for_each
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
        parameters = self.problem.parameters
        xp, (covariance, center, values, derivatives, sides) = on_host(
            self.normalized_covariance,
            self.normalized,
            self.values,
            parameters.derivatives(self.normalized),
            self.bound_sides,
        )
        quantile = NormalDist().inv_cdf((1 + level) / 2)
        half_width = quantile * xp.sqrt(xp.diagonal(covariance))
        # The normalized value of a parameter at its bound is no linear measure of it.
        nonlinear = xp.where(sides == 0, half_width, 0.0)
        linear = xp.where(sides == 0, 0.0, half_width * derivatives)
        limits = []
        for sign in (-1.0, 1.0):
            limit = parameters.vector(as_float(center + sign * nonlinear))
            at_bound = xp.clip(values + sign * linear, *parameters.bounds)
            limit = xp.where(sides == 0, limit, at_bound)
            limits.append(parameters.unflatten(as_float(limit)))
        return limits[0], limits[1]

    @property
    @_for_each
    def mechanism(self) -> Any:
        """Mechanism that the design function builds from the estimates."""
        return self.problem.design(self.estimates)

    @property
    def reading_count(self) -> int:
        """Number of readings from which the parameters were estimated."""
        self._require_one("reading_count")
        return diagnostics.count_readings(self.problem.data)

    @property
    def undetermined_directions(self) -> tuple[str, ...]:
        """Descriptions of the changes of the parameters that the readings do not show.

        A direction is undetermined if its standard error is larger than a relative change
        of the parameters by 100 %.
        """
        self._require_one("undetermined_directions")
        return diagnostics.undetermined_directions(self)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reasons to doubt the estimates or their standard errors."""
        self._require_one("warnings")
        return diagnostics.warnings(self)

    def _require_one(self, name: str) -> None:
        """Raise an error if this is a batch of identifications."""
        if self.normalized.ndim > 1:
            raise ValueError(
                f"`{name}` belongs to one identification, but this is a batch of the "
                f"shape {self.normalized.shape[:-1]}. Select one of them: "
                f"`jax.tree.map(lambda array: array[0], batch).{name}`."
            )

    def __repr__(self) -> str:
        name = result_names(self.result)
        arrays = [self.normalized, self.jacobian, *self.residuals]
        if name is None or np.shape(name) or all_concrete(arrays) is None:
            return eqx.tree_pformat(self)
        return diagnostics.summary(self)
