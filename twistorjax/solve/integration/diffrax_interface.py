"""What `simulate` needs of diffrax: results, projection, events, and progress."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

import diffrax as dfx
import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jaxtyping import Array
from tqdm import tqdm

from ..._utils.progress import progress_bar
from ..._utils.types import Poses
from ...results.codes import result_of_status, RESULTS
from .initial_value import InitialValueProblem
from .system import MotionSystem, State


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


class Projected(dfx.AbstractWrappedSolver):
    """A solver of diffrax that projects the end of each step onto the constraints.

    The equations of motion set the second time derivative of the constraint violations to
    zero. Because of integration errors, the violations themselves would slowly grow.
    Therefore the displacements and velocities are projected after each step, in the
    metric of the inertia. The order of the solver does not change.

    Source:
        Hairer, Lubich and Wanner, Geometric Numerical Integration, algorithm IV.4.2.
    """

    solver: dfx.AbstractSolver

    @property
    def term_structure(self) -> Any:
        return self.solver.term_structure

    @property
    def interpolation_cls(self) -> Any:  # pyright: ignore
        return self.solver.interpolation_cls

    @property
    def term_compatible_contr_kwargs(self) -> Any:
        return self.solver.term_compatible_contr_kwargs

    @property
    def root_finder(self) -> Any:
        """Root finder of an implicit solver, whose tolerances diffrax sets."""
        return cast(dfx.AbstractImplicitSolver, self.solver).root_finder

    def order(self, terms):
        return self.solver.order(terms)

    def strong_order(self, terms):
        return self.solver.strong_order(terms)

    def error_order(self, terms):
        return self.solver.error_order(terms)

    def init(self, terms, t0, t1, y0, args):
        return self.solver.init(terms, t0, t1, y0, args)

    def func(self, terms, t0, y0, args):
        return self.solver.func(terms, t0, y0, args)

    def step(self, terms, t0, t1, y0: State, args: MotionSystem, solver_state, made_jump):
        # The state of the solver was computed before the projection of the last step. For
        # diffrax the projection is a jump.
        del made_jump
        end, error, dense, solver_state, result = self.solver.step(
            terms, t0, t1, y0, args, solver_state, True
        )
        time = jnp.asarray(t1)
        position, rate = args.project(time, end.position, end.rate)
        end = eqx.tree_at(lambda end: (end.position, end.rate), end, (position, rate))
        return end, error, dense, solver_state, result


class Snapshot(eqx.Module):
    """State of a motion, the argument of the condition of an event."""

    poses: Poses  # Poses of the bodies; rad, m, m
    # Displacements of the bodies from their reference poses; rad, m, m
    displacements: Poses
    velocities: Poses  # Velocities of the bodies; rad/s, m/s, m/s


def with_snapshots(event: dfx.Event) -> dfx.Event:
    """Convert an event whose conditions receive snapshots to one that receives states."""

    def wrapped(condition):
        def on_state(t, y, args, **more):
            displacements, velocities = args.expand(t, y.position, y.rate)
            poses = args.mechanism.reference + displacements
            return condition(t, Snapshot(poses, displacements, velocities), args, **more)

        return on_state

    conditions = jax.tree.map(wrapped, event.cond_fn, is_leaf=callable)
    return dfx.Event(conditions, event.root_finder, event.direction)


class ProgressBar(dfx.TqdmProgressMeter):
    """Progress bar for `simulate(progress_meter=...)`, which appears after one second.

    Args:
        refresh_steps: Number of steps of the solver between two updates of the bar.

    Example:
        >>> ProgressBar().refresh_steps
        20
    """

    @staticmethod
    def _init_bar() -> tqdm:
        return progress_bar(
            100,
            "%",
            True,
            delay=1.0,
            leave=False,
            bar_format="{percentage:.0f}% of the motion |{bar}| {elapsed}<{remaining}",
        )
