"""Levenberg-Marquardt method for least squares, based on singular values."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._utils.pytrees import select
from ..._utils.types import Flag, Scalar
from .optimizer import AbstractOptimizer, Evaluation, from_numpy, ROUNDING


class _State(eqx.Module):
    point: Float[Array, " parameters"]  # Point at which the last step was accepted
    evaluation: Evaluation  # Evaluation at this point; NaN before the first step
    damping: Scalar  # Levenberg-Marquardt parameter
    reduction: Scalar  # Factor of the damping after a step that agrees with the model
    has_failed: Flag  # Whether a solve has failed at a previous point
    # Decrease of the loss that the linear model predicts for the next step
    predicted_decrease: Scalar


class LevenbergMarquardt(AbstractOptimizer):
    """Levenberg-Marquardt method, based on singular values.

    Each step is the smallest change that solves the damped linear model. A parameter
    with a bound changes by a factor of e at most. Along directions that the readings do
    not determine, the parameters remain as they are. The method of the same name in
    optimistix takes more than twice as long until its first step, with its import and its
    compilation, and, if the residuals vanish at the solution, more than twice as many
    steps, because it reduces the damping more slowly.

    The method has converged if one of three criteria is met. They use the decrease of the
    loss that the linear model predicts. The undamped step has the largest predicted
    decrease.

    1. The undamped step changes each normalized parameter by less than the tolerance, and
       its predicted decrease is at most `1e-4 + 1e-6 * loss`.
    2. The predicted decrease of the undamped step is at most 1e-8, and at most 1e-8 times
       the loss per reading. The distance to the minimum is then about 1e-4 standard
       errors or less.
    3. The last step was rejected although no solve has failed so far, and the predicted
       decrease of the next step is less than the tolerance times the loss. Rounding
       errors of the loss then prevent a further decrease.

    Source:
        Nocedal and Wright, Numerical Optimization, section 10.3; Moré, The
        Levenberg-Marquardt algorithm, Lecture Notes in Mathematics 630, 1978.
    """

    tolerance: float  # Of the criteria 1 and 3
    # One for each parameter with a bound, zero for the others
    bounded: Float[Array, " parameters"]
    # Initial value of each parameter, divided by its scale. The sum of the offset and the
    # normalized parameter is the value of a parameter without bounds, over its scale.
    offsets: Float[Array, " parameters"]

    def init(self, point: Float[Array, " parameters"], evaluation: Evaluation) -> _State:
        return _State(
            point=point,
            evaluation=evaluation,
            damping=from_numpy(1e-2),
            reduction=from_numpy(0.1),
            has_failed=from_numpy(False),
            predicted_decrease=from_numpy(0.0),
        )

    def step(
        self, point: Float[Array, " parameters"], evaluation: Evaluation, state: _State
    ) -> tuple[Float[Array, " parameters"], _State, Flag]:
        decrease = state.evaluation.loss - evaluation.loss
        accepted = jnp.isfinite(evaluation.loss)
        has_failed = state.has_failed | ~accepted
        accepted &= decrease > 1e-3 * state.predicted_decrease
        agrees = decrease > 0.5 * state.predicted_decrease
        is_first = jnp.isinf(state.evaluation.loss)
        factor = jnp.where(is_first | ~agrees, 1.0, state.reduction)
        stronger = jnp.maximum(state.reduction / 2, 0.1)
        reduction = jnp.where(agrees, stronger, state.reduction)
        damping = jnp.where(accepted, factor, 4.0) * state.damping
        reduction = jnp.where(accepted, reduction, 0.5)
        point, evaluation = select(
            accepted, (point, evaluation), (state.point, state.evaluation)
        )

        components, singular_values, directions = self._linearize(point, evaluation)
        largest = jnp.max(singular_values, initial=0.0)
        relevant = singular_values > ROUNDING * largest
        components = jnp.where(relevant, components, 0.0)
        damped = jnp.where(relevant, singular_values**2 + damping, 1.0)
        change = -components * singular_values / damped
        longest = jnp.max(jnp.abs(change @ directions) * self.bounded)
        change = change / jnp.maximum(1.0, longest)
        remaining = components + singular_values * change
        predicted_decrease = jnp.sum(components**2 - remaining**2) / 2

        undamped = components / jnp.where(relevant, singular_values, 1.0)
        largest_decrease = jnp.sum(components**2) / 2
        step_converged = jnp.max(jnp.abs(undamped @ directions)) < self.tolerance
        step_converged &= largest_decrease <= 1e-4 + 1e-6 * evaluation.loss
        per_reading = jnp.minimum(1.0, evaluation.loss / evaluation.residuals.size)
        loss_converged = largest_decrease <= 1e-8 * per_reading
        rounding_reached = predicted_decrease < self.tolerance * evaluation.loss
        rounding_reached &= ~accepted & ~has_failed
        converged = step_converged | loss_converged | rounding_reached
        state = _State(
            point, evaluation, damping, reduction, has_failed, predicted_decrease
        )
        return point + change @ directions, state, converged

    def _linearize(
        self, point: Float[Array, " parameters"], evaluation: Evaluation
    ) -> tuple[
        Float[Array, " rank"], Float[Array, " rank"], Float[Array, "rank parameters"]
    ]:
        """Compute the singular value decomposition of the linear model about a point.

        Each column of the Jacobian is divided by its norm before the decomposition, so
        that a badly scaled parameter is not damped more than the others. The results are
        the components of the residuals along the left singular vectors, the singular
        values, and the right singular vectors as changes of the normalized parameters.
        """
        jacobian = jnp.where(
            jnp.isfinite(evaluation.derivatives), evaluation.derivatives, 0.0
        )
        free_sizes = jnp.maximum(1.0, jnp.abs(self.offsets + point))
        sizes = jnp.where(self.bounded > 0, 1.0, free_sizes)
        jacobian = jacobian * sizes[None]
        jacobian, row_space = _determined_part(evaluation.residuals, jacobian)
        # The column of an undetermined parameter is not scaled up, because this would
        # turn the step into its direction.
        norms = jnp.maximum(1.0, jnp.sqrt(jnp.sum(jacobian**2, axis=0)))
        left, singular_values, right = jnp.linalg.svd(
            jacobian / norms[None], full_matrices=False
        )
        # The projection gives the shortest one of all steps with the same effect.
        directions = (right / norms[None]) @ row_space * sizes[None]
        return evaluation.residuals @ left, singular_values, directions


def _determined_part(
    residuals: Float[Array, " readings"], jacobian: Float[Array, "readings parameters"]
) -> tuple[Float[Array, "readings parameters"], Float[Array, "parameters parameters"]]:
    """Part of a Jacobian that belongs to directions which the readings determine.

    The derivatives are those with respect to relative changes of the parameters. A
    direction is not determined if a change by 100 % changes the readings by less than one
    standard deviation, and if its residual is smaller than three standard deviations.
    Otherwise the errors of the readings would change the parameters by more than 100 %,
    and the optimizer would follow a long curve of nearly equal residuals.
    """
    left, singular_values, right = jnp.linalg.svd(jacobian, full_matrices=False)
    largest = jnp.max(singular_values, initial=0.0)
    determined = (singular_values >= 1) | (jnp.abs(residuals @ left) >= 3)
    determined &= singular_values > ROUNDING * largest
    kept = jnp.where(determined[:, None], right, 0.0)
    return (left * singular_values[None]) @ kept, kept.T @ kept
