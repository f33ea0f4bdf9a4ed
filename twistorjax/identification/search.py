"""Search for the best parameters: one run of an optimizer, or several side by side."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._compile.compilation import fast_compile
from .._utils.progress import progress_bar
from .._utils.pytrees import select
from .estimation.objective import IdentificationProblem
from .estimation.optimizer import AbstractOptimizer, Evaluation, from_numpy


class SearchState(eqx.Module):
    """State of a search after some steps."""

    # Normalized parameters of the next evaluation
    point: Float[Array, "*restarts parameters"]
    # Normalized parameters with the smallest loss so far
    best_point: Float[Array, "*restarts parameters"]
    best: Evaluation  # Residuals and derivatives at the best point
    # Norm of the residuals at the best point, in standard deviations
    residual_norm: Float[Array, "*restarts"]
    optimizer_state: Any
    # Whether the optimizer has converged, or a solve has failed at the start
    done: Bool[Array, "*restarts"]
    steps: Int[Array, "*restarts"]  # Number of evaluations


def search_with_progress(
    problem: IdentificationProblem,
    optimizer: AbstractOptimizer,
    start: Float[Array, " parameters"],
    max_steps: int,
    forward: bool,
    progress: bool,
) -> SearchState:
    """Run one search in a Python loop, so that it can be watched and interrupted."""
    state, point = None, start
    with progress_bar(max_steps, "evaluation", progress, leave=False) as bar:
        for _ in range(max_steps):
            evaluation = _compiled_evaluate(problem, point, forward)
            state = _init(optimizer, point, evaluation) if state is None else state
            state = _compiled_step(optimizer, state, evaluation)
            point = state.point
            bar.update()
            bar.set_postfix_str(f"residual {float(state.residual_norm):.4g}")
            if bool(state.done):
                break
    assert state is not None
    return state


@fast_compile
def search_compiled(
    problem: IdentificationProblem,
    optimizer: AbstractOptimizer,
    starts: Float[Array, "*restarts parameters"],
    max_steps: int,
    forward: bool,
) -> SearchState:
    """Run searches from one or several starts in one compiled program."""

    def search(start: Array) -> SearchState:
        shapes = jax.eval_shape(lambda: problem.evaluate(start, forward=forward))
        arrays, static = eqx.partition(_init(optimizer, start, shapes), eqx.is_array)

        def step(arrays: Any) -> Any:
            state = eqx.combine(arrays, static)
            evaluation = problem.evaluate(state.point, forward=forward)
            return eqx.filter(_step(optimizer, state, evaluation), eqx.is_array)

        def is_running(arrays: Any) -> Array:
            return ~arrays.done & (arrays.steps < max_steps)

        return eqx.combine(jax.lax.while_loop(is_running, step, arrays), static)

    return search(starts) if starts.ndim == 1 else eqx.filter_vmap(search)(starts)


def _init(
    optimizer: AbstractOptimizer, point: Array, evaluation: Evaluation
) -> SearchState:
    """Create the state before the first step, with the shapes of an evaluation."""
    unknown = jax.tree.map(
        lambda leaf: from_numpy(np.full(leaf.shape, np.nan)), evaluation
    )
    return SearchState(
        point=point,
        best_point=point,
        best=unknown,
        residual_norm=from_numpy(0.0),
        optimizer_state=optimizer.init(point, unknown),
        done=from_numpy(False),
        steps=from_numpy(0),
    )


def _step(
    optimizer: AbstractOptimizer, state: SearchState, evaluation: Evaluation
) -> SearchState:
    """Advance a search by one step, after the evaluation of its current point."""
    is_first = state.steps == 0
    point, optimizer_state, converged = optimizer.step(
        state.point, evaluation, state.optimizer_state
    )
    is_better = is_first | (evaluation.loss < state.best.loss)
    best_point, best = select(
        is_better, (state.point, evaluation), (state.best_point, state.best)
    )
    failed_at_start = is_first & ~jnp.isfinite(evaluation.loss)
    return SearchState(
        point=point,
        best_point=best_point,
        best=best,
        residual_norm=jnp.sqrt(2 * best.loss),
        optimizer_state=optimizer_state,
        done=converged | failed_at_start,
        steps=state.steps + 1,
    )


_compiled_step = fast_compile(_step, optimize=False)

_compiled_evaluate = fast_compile(
    lambda problem, point, forward: problem.evaluate(point, forward=forward)
)
