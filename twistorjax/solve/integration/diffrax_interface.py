"""Settings and results of diffrax, as `simulate` needs them."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import diffrax as dfx
import equinox as eqx
import equinox.internal as eqxi
import jax.numpy as jnp
from jaxtyping import Array

from ...results.codes import result_of_status, RESULTS
from .initial_value import InitialValueProblem


@contextmanager
def smaller_program(own_controller: bool) -> Iterator[None]:
    """Trace diffrax without its checks at run time, and without one unrolled loop.

    The checks are callbacks to Python. JAX does not store a program with callbacks in its
    persistent cache, so each process would compile it again. The same arguments are
    checked in `initial_value`.

    diffrax goes back from the last time by 100 roundings, in 100 calls of `prevbefore`,
    which are a quarter of the operations of a motion (jaxlib 0.10.2: 1,700 of 7,100).
    Here the first call subtracts all of them, and the others return the same time. Other
    step size controllers than those of `simulate` may need an exact `prevbefore`.
    """
    error_if, exact_prevbefore = eqxi.error_if, eqxi.prevbefore
    earlier_times: list[Array] = []

    def prevbefore(time: Array) -> Array:
        if not any(time is earlier for earlier in earlier_times):
            time = time - 100 * (time - exact_prevbefore(time))
            earlier_times.append(time)
        return time

    eqxi.error_if = lambda value, *_, **__: value
    if own_controller:
        eqxi.prevbefore = prevbefore
    try:
        yield
    finally:
        eqxi.error_if, eqxi.prevbefore = error_if, exact_prevbefore


def convert_result(result: dfx.RESULTS, finite: Array) -> RESULTS:
    """Convert the result of diffrax; `finite` is true if the final state is finite."""
    codes: Any = dfx.RESULTS
    results = (
        (codes.successful, RESULTS.successful),
        (codes.event_occurred, RESULTS.event_occurred),
        (codes.max_steps_reached, RESULTS.max_steps_reached),
        (codes.dt_min_reached, RESULTS.step_too_short),
        (codes.nonlinear_divergence, RESULTS.step_too_long),
        (codes.nonfinite, RESULTS.not_finite),
        (codes.nonfinite_input, RESULTS.not_finite),
    )
    converted = result_of_status(result, results, RESULTS.solver_failed)
    return RESULTS.where(finite, converted, RESULTS.not_finite)


def with_end(saveat: dfx.SaveAt, problem: InitialValueProblem) -> dfx.SaveAt:
    """Add the final state to the saved states."""
    given = dfx.SubSaveAt(ts=problem.times) if saveat.subs is None else saveat.subs
    if not isinstance(given, dfx.SubSaveAt) or given.fn is not dfx.SubSaveAt(t1=True).fn:
        raise ValueError(
            "`saveat` has several `subs` or a `fn`, but a motion reports all quantities "
            "at all saved times. Give `ts`, `steps`, or `dense`."
        )
    if saveat.subs is not None and given.ts is not None:
        # A motion that cannot start has no times between its first and its last.
        started = problem.result == RESULTS.successful
        ts = jnp.where(started, jnp.asarray(given.ts, float), problem.times[0])
        given = eqx.tree_at(lambda given: given.ts, given, ts)
    return dfx.SaveAt(
        subs=[given, dfx.SubSaveAt(t1=True)],
        dense=saveat.dense,
        solver_state=saveat.solver_state,
        controller_state=saveat.controller_state,
        made_jump=saveat.made_jump,
    )
