"""Identification of the parameters of a mechanism from measurements."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._compile.compilation import fast_compile
from .._compile.traced_function import traced
from .._utils.host import all_concrete, as_float, on_host
from .._utils.progress import announced
from .._utils.pytrees import split_last_axis
from .._utils.types import KeyLike
from .._utils.validation import (
    compilation_error,
    missing_parameters_noted,
    quote,
    require_float64,
    require_kind,
)
from ..designs.parameters import Parameter as Parameter, ParameterSet
from ..mechanism.mechanism import Mechanism
from ..results.codes import finish, result_message, RESULTS
from .estimation.levenberg_marquardt import LevenbergMarquardt
from .estimation.objective import IdentificationProblem
from .estimation.optimizer import AbstractOptimizer, from_numpy
from .experiments.measurement import as_pytree, Measurement, random_key
from .padding import cut, pad
from .report import Identification
from .search import search_compiled, search_with_progress, SearchState


if TYPE_CHECKING:
    import optax
    import optimistix as optx


# Gradient descent uses reverse mode by default if there are more parameters.
_MOST_IN_FORWARD_MODE = 32


@announced("identification")
def identify(
    design: Callable[[Any], Mechanism],
    start: Any,
    data: Sequence[Measurement],
    *,
    held_out: Sequence[Measurement] = (),
    method: "optax.GradientTransformation | optx.AbstractLeastSquaresSolver | None" = (
        None
    ),
    huber_threshold: float | None = None,
    restarts: int = 0,
    restart_standard_deviation: float = 0.5,
    key: KeyLike | None = None,
    tolerance: float = 1e-8,
    max_steps: int | None = None,
    reverse: bool | None = None,
    progress: bool = False,
    throw: bool = True,
) -> Identification:
    """Identify the parameters of a mechanism from measurements.

    The estimates minimize the sum of the squared residuals. A residual is the difference
    between the predicted and the measured value, divided by the standard deviation of the
    reading. The derivatives of equilibria, motions and natural frequencies are exact.
    The parameters are scaled by their sizes and stay within their bounds.

    Args:
        design: Design function, which builds the mechanism from the parameters. It is
            traced in each call, with the values that its variables have at this time.
        start: Argument of the design function: a pytree with the initial values. If it
            contains `Parameter`s, these are identified, with their units and bounds.
            Otherwise, all numbers in it are identified.
        data: Measurements, from `test.measurement(values)` of one or several tests.
        held_out: Further measurements, which are not used for the estimates. The result
            has their residuals.
        method: Optimizer, by default the Levenberg-Marquardt method. An optimizer of
            optax receives the natural gradient, which is the gradient of the loss times
            the inverse of the damped Gauss-Newton matrix; `optax.sgd(1.0)` takes damped
            Gauss-Newton steps. With reverse-mode derivatives it receives the gradient
            itself. Least-squares solvers of optimistix are accepted, too.
        huber_threshold: Threshold of Huber's loss, which reduces the effect of outliers:
            a residual above it counts linearly instead of quadratically; in standard
            deviations. With 1.345 the estimates lose 5 % of their efficiency if there are
            no outliers. An outlier that alone determines a parameter has its full effect.
            By default all residuals count quadratically.
        restarts: Number of additional random starts, which are solved side by side. The
            result with the smallest loss is returned.
        restart_standard_deviation: Standard deviation of the random starts about the
            first one, as a relative change of the parameters.
        key: Random key, or an integer seed, of the random starts.
        tolerance: Relative tolerance of the estimates.
        max_steps: Largest number of evaluations, by default 100, or 3000 for gradient
            descent.
        reverse: Whether gradient descent uses reverse-mode derivatives, which are faster
            for many parameters. By default it does for more than 32 parameters.
        progress: Whether to show a progress bar.
        throw: Whether a failure raises an error. If False, `result` holds the reason.

    Returns:
        The estimates and their uncertainties. If the search did not converge and `throw`
        is False, they are those of the smallest loss so far.

    Raises:
        ValueError: Double precision is not enabled; there is no parameter or no
            measurement; an argument is out of its range; a test names a body, a hinge or
            a coordinate that the mechanism lacks; or a predicted reading is not finite
            at the initial values, although no solve fails.
        RuntimeError: A solve fails at the initial values, or the search does not
            converge.

    Source:
        Nocedal and Wright, Numerical Optimization, chapter 10; Huber, Ann. Math. Stat.
        35, 1964.

    Example:
        >>> from twistorjax import Body, Hinge, Load, Mechanism, Quadratic
        >>> from twistorjax.identification import BodySensor, Parameter, StaticTest
        >>> def spring(stiffness):
        ...     energy = Quadratic(jnp.diag(jnp.stack([1.0, stiffness, 10.0])))
        ...     hinge = Hinge("spring", "wall", "block", energy, at=(0.0, 0.0, 0.0))
        ...     return Mechanism([Body("wall"), Body("block")], [hinge], fixed=["wall"])
        >>> push = Load("block", force=(5.0, 0.0))  # N
        >>> camera = BodySensor("block", "x", standard_deviation=1e-4)
        >>> test = StaticTest([[push]], [camera])
        >>> start = Parameter(80.0, "N/m", lower=0)
        >>> identify(spring, start, [test.measurement([[0.05]])])
        successful: 1 parameter from 1 reading in ... evaluations; RMS residual ...
        parameter         estimate    ± standard error
        value          100  ± 0.2 N/m
        warning: 1 reading for 1 parameter: ...
    """
    if restarts < 0:
        raise ValueError(f"`restarts` is {restarts}, but must be at least 0.")
    if not restart_standard_deviation > 0:
        raise ValueError(
            f"`restart_standard_deviation` is {restart_standard_deviation}, but must be "
            "positive."
        )
    if not 0 < tolerance < 1:
        raise ValueError(f"`tolerance` is {tolerance}, but must be between 0 and 1.")
    is_flag = isinstance(huber_threshold, bool)
    if huber_threshold is not None and (is_flag or not huber_threshold > 0):
        raise ValueError(
            f"`huber_threshold` is {huber_threshold}, but must be a positive number of "
            "standard deviations: 1.345."
        )
    parameters = ParameterSet.from_tree(start)
    data = require_kind("data", data, Measurement)
    optimizer, default_steps = _choose_optimizer(method, tolerance, parameters)
    max_steps = default_steps if max_steps is None else max_steps
    if max_steps < 1:
        raise ValueError(f"`max_steps` is {max_steps}, but must be at least 1.")
    held_out = require_kind("held_out", held_out, Measurement)
    if not data:
        raise ValueError("`data` is empty, but must have at least one measurement.")
    require_float64(jax.tree.leaves(parameters)[0])
    start_point = from_numpy(np.zeros(len(parameters.names)))
    shapes = eqx.filter_eval_shape(parameters.tree, start_point)
    try:
        with missing_parameters_noted(shapes):
            design = traced(design, shapes)
    except jax.errors.JAXTypeError as error:
        raise compilation_error("design", "about the parameters", error) from error
    problem = IdentificationProblem(
        as_pytree(design), parameters, data, held_out, huber_threshold
    )
    if reverse is None:
        reverse = len(parameters.names) > _MOST_IN_FORWARD_MODE
    forward = optimizer.needs_jacobian or not reverse
    arrays = jax.tree.leaves(eqx.filter((problem, key), eqx.is_array))
    unpadded, problem = problem, pad(problem)
    try:
        if restarts:
            shape = (restarts, start_point.size)
            noise = jax.random.normal(random_key(0 if key is None else key), shape)
            others = restart_standard_deviation * noise
            starts = jnp.concatenate([start_point[None], others])
            state = search_compiled(problem, optimizer, starts, max_steps, forward)
        elif all_concrete(arrays) is None:
            state = search_compiled(problem, optimizer, start_point, max_steps, forward)
        else:
            state = search_with_progress(
                problem, optimizer, start_point, max_steps, forward, progress
            )
    except jax.errors.JAXTypeError as error:
        raise compilation_error("design", "about the parameters", error) from error
    except ValueError:
        # An error describes a test, which should be the one that was given.
        jax.eval_shape(unpadded.residuals, start_point)
        raise
    identification = cut(_summarize(problem, state), unpadded)
    return finish(identification, throw, partial(_failure, identification))


def _choose_optimizer(
    method: Any, tolerance: float, parameters: ParameterSet
) -> tuple[AbstractOptimizer, int]:
    """Choose the optimizer, and its default for the largest number of evaluations."""
    if method is None:
        bounded = from_numpy(parameters.is_bounded.astype(float))
        zeros = from_numpy(np.zeros(len(parameters.names)))
        _, (values, scales) = on_host(
            parameters.vector(zeros), parameters.derivatives(zeros)
        )
        offsets = as_float(values / scales)
        return LevenbergMarquardt(tolerance, bounded, offsets), 100
    # Only other methods need these packages, which take time to load.
    import optax
    import optimistix as optx

    from .estimation.wrapped_optimizers import GradientDescent, OptimistixSolver

    if isinstance(method, optax.GradientTransformation):
        return GradientDescent(method, tolerance), 3000
    if isinstance(method, optx.AbstractLeastSquaresSolver):
        return OptimistixSolver(method), 100
    raise ValueError(
        f"`method` is {quote(method)}, but must be an optimizer of optax or a "
        "least-squares solver of optimistix: `optax.sgd(0.5)`, "
        "`optimistix.Dogleg(1e-8, 1e-8)`."
    )


@fast_compile
def _summarize(problem: IdentificationProblem, state: SearchState) -> Identification:
    """Summarize the search with the smallest loss, from the last states of all."""
    losses = jnp.atleast_1d(state.residual_norm**2 / 2)
    if state.done.ndim:
        best = jnp.argmin(losses)
        state = jax.tree.map(
            lambda leaf: leaf[best] if eqx.is_array(leaf) else leaf, state
        )
    normalized, evaluation = state.best_point, state.best
    if evaluation.derivatives.ndim == 1:  # in reverse mode only the gradient is known
        evaluation = problem.evaluate(normalized)
    residuals = problem.untransformed_residuals(evaluation.residuals)
    shapes = [measurement.values.shape for measurement in problem.data]
    held_out_residuals = ()
    if problem.held_out:
        mechanism = problem.mechanism(normalized)
        held_out_residuals = tuple(each.residuals(mechanism) for each in problem.held_out)
    result = RESULTS.where(state.done, RESULTS.successful, RESULTS.not_converged)
    failed = ~jnp.isfinite(evaluation.loss)
    result = RESULTS.where(failed, RESULTS.no_solution_at_start, result)
    return Identification(
        estimates=problem.parameters.tree(normalized),
        normalized=normalized,
        jacobian=problem.untransformed_jacobian(evaluation),
        residuals=tuple(split_last_axis(residuals, shapes)),
        held_out_residuals=held_out_residuals,
        loss=evaluation.loss,
        losses=losses,
        steps=state.steps,
        result=result,
        problem=problem,
    )


def _failure(
    identification: Identification, item: str, batch_index: tuple[int, ...]
) -> Exception:
    """Return the error of an identification that has failed."""
    message = result_message(item)
    problem = identification.problem
    if item == "no_solution_at_start" and not batch_index:
        mechanism = problem.mechanism(jnp.zeros_like(identification.normalized))
        for measurement in problem.data:
            try:
                measurement.test.predict(mechanism)
            except RuntimeError as error:
                return RuntimeError(f"{message} {measurement.test!r}: {error}")
        return ValueError(message)
    index = ", ".join(map(str, batch_index))
    where = f" at index {index} of the batch" if batch_index else ""
    steps = np.asarray(identification.steps)[batch_index]
    return RuntimeError(f"{message} ({steps} evaluations{where})")
