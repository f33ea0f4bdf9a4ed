"""The program that integrates a motion and evaluates it at the saved times."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import TypeAliasType

from ..._compile.compilation import fast_compile
from ..._utils.types import Count, PoseLike, Poses, Scalar, Wrenches
from ...mechanism.changes import HingeChanges
from ...mechanism.constraints import ConstraintSet
from ...mechanism.loads import Drive, Load, LoadSet
from ...mechanism.mechanism import Mechanism
from ...results.codes import is_success, RESULTS
from ..equations.dofs import DofPartition
from .collocation import Gauss, Radau
from .diffrax_interface import (
    convert_result,
    Projected,
    smaller_program,
    with_end,
    with_snapshots,
)
from .initial_value import initial_value_problem
from .solution import Energies, Motion
from .system import equation, MotionSystem, State


# Solvers other than those of this library stop if the step is below this fraction of the
# slowest period.
_SMALLEST_STEP = 1e-12

# A constant list, or a function of time (s) that returns a list
Loading = TypeAliasType("Loading", Sequence[Load] | Callable[[Scalar], Sequence[Load]])

Driving = TypeAliasType("Driving", Sequence[Drive] | Callable[[Scalar], Sequence[Drive]])

# Constant strokes by hinges, or a function of time (s) that returns them
Strokes = TypeAliasType(
    "Strokes", Mapping[str, PoseLike] | Callable[[Scalar], Mapping[str, PoseLike]]
)


def _solve(
    mechanism: Mechanism,
    inertia: Wrenches,
    times: Float[Array, " times"],
    loads: LoadSet | Callable[[Scalar], Sequence[Load]],
    drives: Driving,
    changes: HingeChanges | None,
    constraints: ConstraintSet,
    start: Poses,
    velocities: Poses | None,
    tolerance: Scalar,
    step: Scalar | None,
    solver: dfx.AbstractSolver,
    controller: dfx.AbstractStepSizeController | None,
    saveat: dfx.SaveAt | None,
    event: dfx.Event | None,
    progress_meter: dfx.AbstractProgressMeter,
    adjoint: dfx.AbstractAdjoint,
    max_steps: int,
    energies: bool,
    dofs: DofPartition,
    time_count: Count,
) -> Motion:
    """Integrate the equations of motion; see `simulate`."""
    method, collocation = type(solver).__name__, isinstance(solver, Radau | Gauss)
    saveat = dfx.SaveAt() if saveat is None else saveat
    problem = initial_value_problem(
        mechanism, inertia, times, loads, drives, changes, constraints, start, velocities,
        energies, dofs, tolerance, step, check_accelerations=not collocation,
        time_count=time_count, saved_times=getattr(saveat.subs, "ts", None),
    )  # fmt: skip
    system = problem.system
    own_controller = controller is None
    if controller is None and step is not None:
        controller = dfx.ConstantStepSize()
    elif controller is None:
        controller = dfx.PIDController(
            rtol=0.0,
            atol=problem.tolerance,
            norm=system.norm,
            pcoeff=0.3,
            icoeff=0.4,
            # Other solvers would shorten steps forever if a value is not finite.
            dtmin=None if collocation else _SMALLEST_STEP * system.period,
            force_dtmin=False,
        )
    if constraints.size and not collocation:
        solver = Projected(solver)
    with smaller_program(own_controller):
        solution = dfx.diffeqsolve(
            equation,
            solver,
            problem.times[0],
            problem.times[-1],
            problem.step,
            problem.state,
            args=system,
            saveat=with_end(saveat, problem),
            stepsize_controller=controller,
            event=None if event is None else with_snapshots(event),
            progress_meter=progress_meter,
            adjoint=adjoint,
            max_steps=max_steps,
            throw=False,
        )
    assert solution.ts is not None and solution.ys is not None
    final = solution.ys[1]
    finite = jnp.all(jnp.isfinite(final.position)) & jnp.all(jnp.isfinite(final.rate))
    result = convert_result(solution.result, finite)
    started = problem.result == RESULTS.successful
    result = RESULTS.where(started, result, problem.result)
    solution = eqx.tree_at(
        lambda solution: (solution.ts, solution.ys),
        solution,
        jax.tree.map(
            lambda value: jnp.where(started, value, jnp.nan), (solution.ts, solution.ys)
        ),
    )
    saved_times, states = solution.ts[0], solution.ys[0]
    valid = jnp.isfinite(saved_times)
    output_times = jnp.where(valid, saved_times, problem.times[0])
    output = jax.vmap(partial(_output, system))(output_times, states)
    outside = jax.vmap(lambda time, at: system.hinges(time).out_of_range(at))(
        output_times, output[0]
    )
    after_exit = jnp.cumsum(valid & jnp.any(outside, axis=1)) > 0
    left_range = is_success(result) & jnp.any(after_exit)
    result = RESULTS.where(left_range, RESULTS.out_of_range, result)
    valid = valid & ~after_exit
    last = jnp.max(jnp.where(valid, saved_times, times[0]))
    displacements, rates, reactions, multipliers, energy = jax.tree.map(
        lambda value: jnp.where(
            valid.reshape(-1, *(value.ndim - 1) * (1,)), value, jnp.nan
        ),
        output,
    )
    hinge_states = jax.vmap(system.hinge_state)(output_times)
    return Motion(
        times=jnp.where(valid, saved_times, jnp.nan),
        displacements=displacements,
        velocities=rates,
        reference=mechanism.reference,
        reactions=reactions,
        constraint_forces=multipliers,
        energies=energy,
        reached=jnp.where(jnp.any(after_exit) | ~started, last, solution.ts[1][-1]),
        steps=solution.stats["num_steps"],
        rejected=solution.stats["num_rejected_steps"],
        result=result,
        solution=solution,
        system=None if solution.interpolation is None else system,
        strokes=hinge_states.strokes,
        temperature=hinge_states.temperature,
        names=mechanism.names,
        constraint_names=constraints.names(),
        method=method,
    )


solve_motion = fast_compile(_solve)

solve_with_callbacks = fast_compile(_solve, store=False)


def _output(system: MotionSystem, time: Scalar, state: State):
    """Compute the quantities of a `Motion` at one time."""
    position, rate = system.project(time, state.position, state.rate)
    displacements, velocities = system.expand(time, position, rate)
    now = system.instant(time, position, rate)
    works = state.work if state.work.size else jnp.zeros(3)
    by_strokes = works[3] if works.size > 3 else jnp.zeros(())
    energy = Energies(
        elastic=system.hinges(time).energy(displacements),
        kinetic=jnp.sum(system.inertia * velocities.reshape(-1) ** 2) / 2,
        dissipated=works[0],
        by_loads=works[1],
        by_drives=works[2],
        by_strokes=by_strokes,
    )
    return displacements, velocities, now.reactions, now.multipliers, energy
