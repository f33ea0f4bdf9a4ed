"""Motion of a mechanism under loads, prescribed motions, and constraints."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import TypeAliasType

from .._compile.compilation import fast_compile
from .._compile.stored_gradients import fast_compile_with_gradient
from .._compile.traced_function import traced
from .._utils.host import as_float, is_traced, on_host, program_input
from .._utils.progress import announced
from .._utils.types import (
    Count,
    NumberLike,
    PoseLike,
    Poses,
    Scalar,
    TimesLike,
    VelocityLike,
)
from .._utils.validation import require_float64
from ..mechanism.changes import HingeChanges, TemperatureInTime
from ..mechanism.constraints import AbstractConstraint, ConstraintSet, gather_constraints
from ..mechanism.loads import Drive, Load, LoadSet, prescribed_dofs
from ..mechanism.mechanism import Mechanism
from ..results.codes import is_success, RESULTS, succeeded_or_raise
from .equations.dofs import displacements_at_start, DofPartition
from .events import with_snapshots
from .integration.adjoint import StepwiseAdjoint
from .integration.collocation import Gauss, Radau
from .integration.diffrax_interface import convert_result, smaller_program, with_end
from .integration.errors import StartOfMotion
from .integration.initial_value import (
    check_finite,
    check_settings,
    check_times,
    check_velocities,
    explain_compilation,
    initial_value_problem,
    pad_times,
)
from .integration.solution import Energies, Motion
from .integration.system import equation, MotionSystem, State
from .projection import Projected
from .statics.solution import StateLike


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


@announced("motion")
def simulate(
    mechanism: Mechanism,
    times: TimesLike,
    *,
    loads: Loading = (),
    drives: Driving = (),
    strokes: Strokes = MappingProxyType({}),
    temperature: TemperatureInTime | None = None,
    constraints: Sequence[AbstractConstraint] = (),
    start: StateLike | None = None,
    velocities: Mapping[str, VelocityLike] | None = None,
    tolerance: NumberLike = 1e-6,
    solver: dfx.AbstractSolver | None = None,
    step: NumberLike | None = None,
    controller: dfx.AbstractStepSizeController | None = None,
    saveat: dfx.SaveAt | None = None,
    event: dfx.Event | None = None,
    progress_meter: dfx.AbstractProgressMeter | None = None,
    adjoint: dfx.AbstractAdjoint | None = None,
    max_steps: int = 100_000,
    energies: bool = True,
    throw: bool = True,
) -> Motion:
    """Simulate the motion under loads, prescribed displacements, and constraints.

    Prescribed displacements are imposed exactly, and the reactions are returned. The
    prescribed velocities and accelerations are the time derivatives of the prescribed
    displacements. The motion has reverse-mode derivatives with respect to all values of
    the mechanism, the loads, and the initial state. For forward-mode derivatives, use
    `adjoint=diffrax.ForwardMode()`; for second derivatives, the forward-mode derivatives
    of the gradient.

    Args:
        mechanism: The mechanism. Bodies that can move need mass and inertia, and the
            origin of their frame at the center of mass.
        times: Times at which the motion is reported, from its start to its end; s.
        loads: Loads on its bodies, or a function of time that returns them.
        drives: Prescribed displacements of degrees of freedom that are not fixed, or a
            smooth function of time that returns them. Functions of time are traced in
            each call, with the values that their variables have at this time.
        strokes: Strokes of actuators, by the names of their hinges, or a smooth function
            of time that returns them; see `Mechanism.with_strokes`; rad, m, m.
        temperature: A smooth function of time that returns the change of the temperature
            of all parts (K), or a `Temperature` with the changes of single parts. For a
            constant one, simulate `Mechanism.at_temperature`.
        constraints: Pins, sliders, and other constraints between its bodies.
        start: Poses at the start, or an equilibrium; by default the reference
            configuration; rad, m, m.
        velocities: Initial velocities, a mapping from names of bodies to (angular
            velocity, velocity along x, velocity along y), in world axes; zero for the
            other bodies; rad/s, m/s, m/s.
        tolerance: Absolute tolerance on the error of one step: of rotations (rad), of
            displacements divided by a length, and of the rates of both times a time. The
            length is the root mean square distance of the hinges from the origins of the
            bodies that move. The time is an estimate of the longest vibration period
            divided by 2 pi, and at most the duration of the motion. The error of a whole
            motion is about ten times larger, and more if the motion is sensitive to its
            initial state.
        solver: Solver: `Radau()` by default; `Gauss()` with a `step` for motion without
            damping; or any solver of diffrax.
        step: Constant length of the steps; by default the tolerance determines them; s.
        controller: Step size controller of diffrax, which replaces the tolerance.
        saveat: `SaveAt` of diffrax, which replaces the `times` between the first and the
            last, for example `SaveAt(steps=True)` for every step, or `SaveAt(dense=True)`
            for the motion as a function of time (`Motion.at`). By default the motion is
            saved at `times`.
        event: Event of diffrax that ends the motion. Its condition is called with the
            time and, as the state, an object with `poses`, `displacements`, and
            `velocities` of the bodies. If a variable that it uses changes, define a new
            function.
        progress_meter: Progress meter of diffrax; by default none.
        adjoint: Method of differentiation of diffrax; by default reverse mode. It repeats
            the steps of the motion in reverse order, or is
            `diffrax.RecursiveCheckpointAdjoint()` with an `event`, a `saveat`, a
            `controller`, or another solver.
        max_steps: Largest number of steps of the solver.
        energies: Whether the dissipated energy and the work of loads are computed, which
            takes about a tenth of the run time. If False, they are zero, and
            `energies.imbalance` is not an error.
        throw: Whether a failure raises an error; otherwise it is reported by `result`.

    Returns:
        The motion at the given times. If `throw` is False and the motion stopped before
        its end, the rows of later times are NaN, and `result` is the reason.

    Raises:
        ValueError: Double precision is disabled, a name is unknown, a degree of freedom
            is prescribed twice or is fixed, a body that moves has no mass, times do not
            increase, a prescribed displacement or a constraint is not satisfied at the
            start, a shape is wrong, or a value is not finite.
        RuntimeError: The motion did not reach its end; the message says when and why.
            Validity ranges of hinges are checked at the saved times.

    Source:
        Equations 5.24, 5.25, and 6.4 of the dissertation.

    Example:
        >>> import jax.numpy as jnp
        >>> from twistorjax import Body, Hinge, Mechanism, Quadratic, simulate
        >>> spring = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 100.0])))
        >>> hinge = Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
        >>> block = Body("block", mass=1.0, inertia=0.1)
        >>> mechanism = Mechanism([Body("wall"), block], [hinge], fixed=["wall"])
        >>> released = [[0, 0, 0], [0, 0.1, 0]]  # angle (rad), x, y (m) of each body
        >>> half_period = jnp.pi / 10
        >>> motion = simulate(mechanism, [0.0, half_period], start=released)
        >>> motion.displacement("block")[-1, 1]
        Array(-0.1000..., dtype=float64)
    """
    require_float64(mechanism.reference)
    instants = check_times(times)
    _, (host_instants,) = on_host(instants)
    first = as_float(host_instants[0])  # `instants[0]` compiles for each number of times
    check_settings(tolerance, max_steps, step)
    if step is None and controller is None and isinstance(solver, Gauss):
        raise ValueError(
            "`solver` is `Gauss()`, which has no step size control. Give a `step` that "
            "is short compared with the period of the fastest motion of interest."
        )
    changes = HingeChanges.of(strokes, temperature)
    functions = {
        "loads": loads, "drives": drives, "strokes": strokes, "temperature": temperature,
    }  # fmt: skip
    with explain_compilation(first, **functions):
        first_drives = drives(first) if callable(drives) else drives
        first_loads = loads(first) if callable(loads) else loads
        if changes is not None:
            changes.state(mechanism, first).hinges(mechanism)  # checks the names
    load_set = LoadSet.of(mechanism, first_loads)
    dofs = DofPartition.of(mechanism, prescribed_dofs(mechanism, first_drives)[0])
    displacements = jnp.zeros_like(mechanism.reference)
    if start is not None:
        displacements = displacements_at_start(mechanism, start)
        check_finite("start", displacements)
    rates = check_velocities(mechanism, velocities, dofs.free)
    constraint_set = gather_constraints(mechanism, constraints)
    start_of_motion = StartOfMotion(
        mechanism, drives, constraint_set, displacements, first, dofs, rates is not None
    )
    if throw:
        start_of_motion.check()
    # In a program that is traced, for example for a batch, padding would only cost time.
    arguments = mechanism, instants, loads, drives, strokes, constraint_set, displacements
    pad = saveat is None and not is_traced((*arguments, tolerance))
    time_count = len(instants)
    solver = Radau() if solver is None else solver
    own = all(setting is None for setting in (adjoint, controller, saveat, event))
    stepwise = own and isinstance(solver, Radau | Gauss)
    if adjoint is None:
        adjoint = StepwiseAdjoint() if stepwise else dfx.RecursiveCheckpointAdjoint()
    solve = _solve_with_gradient if stepwise else _solve_with_any_derivatives
    if progress_meter is not None:
        solve = _solve_with_callbacks
    with explain_compilation(first, **functions):
        motion = solve(
            mechanism,
            pad_times(instants) if pad else instants,
            traced(loads) if callable(loads) else load_set,
            traced(drives) if callable(drives) else tuple(drives),
            None if changes is None else changes.traced(),
            constraint_set,
            displacements,
            rates,
            as_float(tolerance),
            None if step is None else as_float(step),
            solver,
            controller,
            saveat,
            event,
            dfx.NoProgressMeter() if progress_meter is None else progress_meter,
            adjoint,
            max_steps,
            energies,
            dofs,
            program_input(time_count, int),
        )
    if pad:
        motion = motion.first_times(time_count)
    if not throw:
        return motion
    return succeeded_or_raise(motion, partial(start_of_motion.error, motion))


def _solve(
    mechanism: Mechanism,
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
    collocation = isinstance(solver, Radau | Gauss)
    saveat = dfx.SaveAt() if saveat is None else saveat
    problem = initial_value_problem(
        mechanism, times, loads, drives, changes, constraints, start, velocities,
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
    )


_solve_with_gradient = fast_compile_with_gradient(_solve)
_solve_with_any_derivatives = fast_compile(_solve)
_solve_with_callbacks = fast_compile(_solve, store=False)


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
