"""Optimizers of optax and least-squares solvers of optimistix, for an identification."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
import optimistix as optx
from jaxtyping import Array, Float

from ..._utils.pytrees import select
from ..._utils.types import Flag, Scalar
from .optimizer import AbstractOptimizer, Evaluation, from_numpy


class GradientDescent(AbstractOptimizer):
    """Gradient descent by an optimizer of optax.

    If the Jacobian of the residuals is known, the natural gradient is used. It measures a
    change of the parameters by its effect on the readings, so that directions with a
    small effect converge as fast as others. `optax.sgd(1.0)` is then the Gauss-Newton
    method, damped while the residuals are large.

    Source:
        Amari, Neural Computation 10, 1998; the damping of Yamashita and Fukushima,
        Computing Supplementum 15, 2001.
    """

    optimizer: optax.GradientTransformation = eqx.field(static=True)
    tolerance: float  # Converged if a step changes each normalized parameter by less
    needs_jacobian: ClassVar[bool] = False

    def init(self, point: Float[Array, " parameters"], evaluation: Evaluation) -> Any:
        del evaluation
        inner = jax.tree.map(from_numpy, self.optimizer.init(point))
        return point, inner, from_numpy(0.0)

    def step(
        self, point: Float[Array, " parameters"], evaluation: Evaluation, state: Any
    ) -> tuple[Float[Array, " parameters"], Any, Flag]:
        previous, inner, initial_norm = state
        evaluation, initial_norm = _scale_to_unit_norm(evaluation, initial_norm)
        failed = ~jnp.isfinite(evaluation.loss)
        gradient = evaluation.gradient
        if evaluation.derivatives.ndim == 2:
            jacobian = jnp.where(failed, 0.0, evaluation.derivatives)
            residuals = jnp.where(failed, 0.0, evaluation.residuals)
            left, singular, right = jnp.linalg.svd(jacobian, full_matrices=False)
            largest = jnp.max(singular, initial=0.0)
            damped = singular**2 + 1e-2 * jnp.sum(residuals**2) * largest**2
            positive = damped > 0
            divisor = jnp.where(positive, damped, 1.0)
            inverse = jnp.where(positive, singular / divisor, 0.0)
            gradient = (inverse * (residuals @ left)) @ right
        extended = optax.with_extra_args_support(self.optimizer)
        change: Any
        with jax.numpy_dtype_promotion("standard"):  # optax needs implicit promotion
            change, updated = extended.update(
                gradient, inner, point, value=evaluation.loss, grad=gradient
            )
        next_point = jnp.where(failed, (previous + point) / 2, point + change)
        previous, inner = select(failed, (previous, inner), (point, updated))
        converged = (jnp.max(jnp.abs(change)) < self.tolerance) & ~failed
        return next_point, (previous, inner, initial_norm), converged


class OptimistixSolver(AbstractOptimizer):
    """Least-squares solver of optimistix that evaluates the residuals once in a step."""

    # Solver, for example `LevenbergMarquardt`, `Dogleg` or `GaussNewton`
    solver: optx.AbstractLeastSquaresSolver

    def init(self, point: Float[Array, " parameters"], evaluation: Evaluation) -> Any:
        shape = jax.eval_shape(lambda: evaluation.residuals)
        inner = self.solver.init(
            _linearized_residuals, point, evaluation, {}, shape, None, frozenset()
        )
        return inner, point, from_numpy(0.0)

    def step(
        self, point: Float[Array, " parameters"], evaluation: Evaluation, state: Any
    ) -> tuple[Float[Array, " parameters"], Any, Flag]:
        del point
        inner, accepted_point, initial_norm = state
        evaluation, initial_norm = _scale_to_unit_norm(evaluation, initial_norm)
        failed = ~jnp.isfinite(evaluation.loss)
        # Large residuals make the solver reject a point at which a solve fails.
        evaluation = Evaluation(
            jnp.where(failed, 1e3, evaluation.residuals),
            jnp.where(failed, 0.0, evaluation.derivatives),
        )
        arguments = evaluation, {}
        accepted_point, inner, _ = self.solver.step(
            _linearized_residuals, accepted_point, *arguments, inner, frozenset()
        )
        converged, _ = self.solver.terminate(
            _linearized_residuals, accepted_point, *arguments, inner, frozenset()
        )
        return inner.y_eval, (inner, accepted_point, initial_norm), converged


def _scale_to_unit_norm(
    evaluation: Evaluation, initial_norm: Scalar
) -> tuple[Evaluation, Scalar]:
    """Divide the residuals by their norm at the start, and return this norm, too.

    Learning rates and tolerances of optax and optimistix assume losses of order one. The
    norm is zero before the first evaluation.
    """
    norm = jnp.sqrt(2 * evaluation.loss)
    usable = jnp.isfinite(norm) & (norm > 0)
    initial_norm = jnp.where(
        (initial_norm == 0) & usable, jnp.where(usable, norm, 1.0), initial_norm
    )
    scale = jnp.where(initial_norm > 0, initial_norm, 1.0)
    derivatives = evaluation.derivatives
    derivatives = derivatives / (scale**2 if derivatives.ndim == 1 else scale)
    return Evaluation(evaluation.residuals / scale, derivatives), initial_norm


def _linearized_residuals(
    point: Float[Array, " parameters"], evaluation: Evaluation
) -> tuple[Array, None]:
    """Residuals of an evaluation as a function of the point, for optimistix.

    The value does not depend on the point; the derivative is that of the evaluation.
    """

    @jax.custom_jvp
    def residuals(point):
        del point
        return evaluation.residuals

    @residuals.defjvp
    def _(primals, tangents):
        del primals
        return evaluation.residuals, evaluation.derivatives @ tangents[0]

    return residuals(point), None
