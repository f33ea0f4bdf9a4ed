"""Motion of a mechanism in time, under loads, drives and constraints."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from .._utils.types import Poses, PosesLike, Scalar
from .._utils.validation import require_float64
from ..mechanism.constraints import AbstractConstraint, ConstraintSet, gather_constraints
from ..mechanism.loads import Drive, driven, Load, loaded_bodies
from ..mechanism.mechanism import Mechanism
from . import initial_state as begin, motion_errors
from .collocation import Gauss, Radau
from .motion import Energies, Motion
from .motion_system import equation, State, System
from .projection import Projected
from .results import raise_failed, RESULTS
from .static_system import DofPartition
from .statics import Equilibrium, free_coordinates


# Other solvers than those of this library give up below this share of the slowest period.
_LEAST_STEP = 1e-12

Loading = Sequence[Load] | Callable[[Scalar], Sequence[Load]]
Driving = Sequence[Drive] | Callable[[Scalar], Sequence[Drive]]


def simulate(
    mechanism: Mechanism,
    times: Float[ArrayLike, " times"] | Sequence[ArrayLike],
    *,
    loads: Loading = (),
    drives: Driving = (),
    constraints: Sequence[AbstractConstraint] = (),
    start: PosesLike | Equilibrium | None = None,
    velocities: Mapping[str, Sequence[ArrayLike] | Array] | None = None,
    tolerance: ArrayLike = 1e-6,
    solver: dfx.AbstractSolver | None = None,
    step: ArrayLike | None = None,
    controller: dfx.AbstractStepSizeController | None = None,
    saveat: dfx.SaveAt | None = None,
    event: dfx.Event | None = None,
    progress_meter: dfx.AbstractProgressMeter | None = None,
    adjoint: dfx.AbstractAdjoint | None = None,
    max_steps: int = 100_000,
    energies: bool = True,
    throw: bool = True,
) -> Motion:
    """How a mechanism moves under loads, imposed motions and constraints.

    Held and driven coordinates are given exactly, and their reactions returned; the
    driven ones' velocities and accelerations follow by differentiation. The motion has
    derivatives in reverse, by everything that made the mechanism; forwards with
    `adjoint=diffrax.ForwardMode()`.

    Args:
        mechanism: its bodies that can move need mass and inertia, about an origin at
            their centre of mass.
        times: at which to tell the motion, from its start to its end; s.
        loads: on its bodies; or a function of time that gives them.
        drives: of coordinates that are not held; or a function of time that gives them,
            smooth in it. A new function is compiled anew: define it once.
        constraints: what else must stay as it is: pins, sliders, any equation.
        start: poses at the start, by default at rest, or an equilibrium; rad, m, m.
        velocities: of some bodies at the start, by default none: a mapping from the name
            to (rate of turning, velocity along x and along y); rad/s, m/s, m/s.
        tolerance: error that a step may make: in angles, and in displacements and
            velocities measured by a lever of the mechanism and its slowest period. The
            error of the whole is larger by some ten times, or by as many as the motion
            itself magnifies them.
        solver: by default `Radau()`; `Gauss()` with a `step` for motion without damping;
            or any other of diffrax.
        step: of constant length, instead of steps chosen by the tolerance; s.
        controller: of the steps, in diffrax's sense, instead of the tolerance.
        saveat: what to keep, in diffrax's sense, instead of the `times` but the first
            and the last: every step, or the whole as a function of time.
        event: that ends the motion, in diffrax's sense. Its condition is called with the
            time and, for the state, `poses` and `velocities`.
        progress_meter: in diffrax's sense, by default none.
        adjoint: how to differentiate, in diffrax's sense, by default in reverse.
        max_steps: of the solver, altogether.
        energies: whether to account for the work done and dissipated, for a tenth of the
            time. Without, these are zero.
        throw: whether a failure is raised, or only told by the answer.

    Returns:
        The motion.

    Raises:
        ValueError: double precision is off; a name is unknown; a coordinate is driven
            twice, or driven and held; a body that moves has no mass; times do not
            increase; a drive or a constraint does not fit the start; a shape is wrong or
            a value not finite.
        RuntimeError: the motion did not reach its end; the text says why and when. That
            no hinge is beyond the range of its energy is seen at the times that are kept.

    Source:
        Equations 5.24, 5.25 and 6.4 of the dissertation.

    Example:
        >>> from twistorjax import Body, Hinge, Mechanism, Quadratic
        >>> spring = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 100.0])))
        >>> hinge = Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
        >>> block = Body("block", mass=1.0, inertia=0.1)
        >>> mechanism = Mechanism([Body("wall"), block], [hinge], fixed=["wall"])
        >>> pulled = [[0, 0, 0], [0, 0.1, 0]]
        >>> swing = simulate(mechanism, [0.0, jnp.pi / 10], start=pulled)
        >>> swing.displacement("block")[-1, 1]  # half a period later
        Array(-0.1000..., dtype=float64)
    """
    require_float64(mechanism.reference)
    instants = begin.times(times)
    first = instants[0]
    begin.limits(tolerance, max_steps, step)
    if step is None and controller is None and isinstance(solver, Gauss):
        raise ValueError(
            "`Gauss()` does not choose its steps: give it a `step`, short against the "
            "fastest motion that matters."
        )
    with begin.compiling(first, drives=drives, loads=loads):
        now = drives(first) if callable(drives) else drives
        acting = loads(first) if callable(loads) else loads
    loaded_bodies(mechanism, acting)
    places, _ = driven(mechanism, now)
    free = free_coordinates(len(mechanism.names), mechanism.fixed, places)
    moved = jnp.zeros_like(mechanism.reference)
    if start is not None:
        moved = mechanism.displacements(start, "start", one=True)
        begin.finite("start", moved)
    rates = begin.velocities(mechanism, velocities, free)
    joints = gather_constraints(mechanism, constraints)
    if throw:
        motion_errors.refuse(
            mechanism, drives, joints, moved, first, velocities is not None
        )
    with begin.compiling(first, drives=drives, loads=loads):
        answer = _solve(
            mechanism,
            instants,
            loads if callable(loads) else tuple(loads),
            drives if callable(drives) else tuple(drives),
            joints,
            moved,
            rates,
            jnp.asarray(tolerance, float),
            None if step is None else jnp.asarray(step, float),
            Radau() if solver is None else solver,
            controller,
            saveat,
            event,
            dfx.NoProgressMeter() if progress_meter is None else progress_meter,
            dfx.RecursiveCheckpointAdjoint() if adjoint is None else adjoint,
            max_steps,
            energies,
            DofPartition(free, places),
        )
    if not throw:
        return answer
    why = partial(motion_errors.failure, answer, mechanism, drives, joints, moved, first)
    return raise_failed(answer, why)


@eqx.filter_jit
def _solve(
    mechanism: Mechanism,
    times: Float[Array, " times"],
    loads: Loading,
    drives: Driving,
    joints: ConstraintSet,
    moved: Poses,
    given: Poses | None,
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
    places: DofPartition,
) -> Motion:
    collocated = isinstance(solver, Radau | Gauss)
    start = begin.begin(
        mechanism, times, loads, drives, joints, moved, given, energies, places,
        tolerance, step, needs_rates=not collocated,
    )  # fmt: skip
    system = start.system
    if controller is None and step is not None:
        controller = dfx.ConstantStepSize()
    elif controller is None:
        controller = dfx.PIDController(
            rtol=0.0,
            atol=start.tolerance,
            norm=system.size,
            pcoeff=0.3,
            icoeff=0.4,
            # other solvers would shorten steps for ever where a value is not finite
            dtmin=None if collocated else _LEAST_STEP * system.period,
            force_dtmin=False,
        )
    if joints.size and not collocated:
        solver = Projected(solver)
    solution = dfx.diffeqsolve(
        equation,
        solver,
        start.times[0],
        start.times[-1],
        start.step,
        start.state,
        args=system,
        saveat=_kept(dfx.SaveAt() if saveat is None else saveat, start),
        stepsize_controller=controller,
        event=None if event is None else _seen(event),
        progress_meter=progress_meter,
        adjoint=adjoint,
        max_steps=max_steps,
        throw=False,
    )
    assert solution.ts is not None and solution.ys is not None
    ended = RESULTS.promote(solution.result)
    lost = (ended == RESULTS.nonfinite) | (ended == RESULTS.nonfinite_input)
    final = solution.ys[1]
    there = jnp.all(jnp.isfinite(final.place)) & jnp.all(jnp.isfinite(final.rate))
    ended = RESULTS.where(lost | ~there, RESULTS.not_finite, ended)
    not_converged = ended == RESULTS.nonlinear_divergence
    ended = RESULTS.where(not_converged, RESULTS.step_too_long, ended)
    began = start.result == RESULTS.successful
    result = RESULTS.where(began, ended, start.result)
    solution = eqx.tree_at(
        lambda solution: (solution.ts, solution.ys),
        solution,
        jax.tree.map(
            lambda value: jnp.where(began, value, jnp.nan), (solution.ts, solution.ys)
        ),
    )
    at, kept = solution.ts[0], solution.ys[0]
    there = jnp.isfinite(at)
    tell = jax.vmap(partial(_told, system))(jnp.where(there, at, start.times[0]), kept)
    beyond = jax.vmap(mechanism.hinge_assembly.out_of_range)(tell[0])
    out = jnp.cumsum(there & jnp.any(beyond, axis=1)) > 0
    ended_well = (result == RESULTS.successful) | (result == RESULTS.event_occurred)
    left = jnp.any(out)
    result = RESULTS.where(ended_well & left, RESULTS.out_of_range, result)
    there = there & ~out
    last = jnp.max(jnp.where(there, at, times[0]))
    tell = jax.tree.map(
        lambda value: jnp.where(
            there.reshape(-1, *(value.ndim - 1) * (1,)), value, jnp.nan
        ),
        tell,
    )
    displacements, velocities, reactions, pushes, energy = tell
    return Motion(
        times=jnp.where(there, at, jnp.nan),
        displacements=displacements,
        velocities=velocities,
        reference=mechanism.reference,
        reactions=reactions,
        pushes=pushes,
        energies=energy,
        reached=jnp.where(left | ~began, last, solution.ts[1][-1]),
        steps=solution.stats["num_steps"],
        rejected=solution.stats["num_rejected_steps"],
        result=result,
        solution=solution,
        system=None if solution.interpolation is None else system,
        names=mechanism.names,
        joints=tuple(joints.owners()),
    )


def _told(system: System, time: Scalar, state: State):
    """All that is told of an instant."""
    place, rate = system.project(time, state.place, state.rate)
    displacements, velocities = system.spread(time, place, rate)
    now = system.instant(time, place, rate)
    works = state.work if state.work.size else jnp.zeros(3)
    energy = Energies(
        elastic=system.mechanism.hinge_assembly.energy(displacements),
        kinetic=jnp.sum(system.inertia * velocities.reshape(-1) ** 2) / 2,
        dissipated=works[0],
        by_loads=works[1],
        by_drives=works[2],
    )
    return displacements, velocities, now.reactions, now.push, energy


def _kept(saveat: dfx.SaveAt, start: begin.Beginning) -> dfx.SaveAt:
    """What is to be kept, and where it ended."""
    own = dfx.SubSaveAt(ts=start.times) if saveat.subs is None else saveat.subs
    if not isinstance(own, dfx.SubSaveAt) or own.fn is not dfx.SubSaveAt(t1=True).fn:
        raise ValueError(
            "`saveat` has several `subs` or a `fn` of its own, but a motion tells all "
            "that there is at the times that it keeps: give `ts`, `steps` or `dense`."
        )
    if saveat.subs is not None and own.ts is not None:
        # a motion that cannot begin has no times between which its own could lie
        began = start.result == RESULTS.successful
        ts = jnp.where(began, jnp.asarray(own.ts, float), start.times[0])
        own = eqx.tree_at(lambda own: own.ts, own, ts)
    return dfx.SaveAt(
        subs=[own, dfx.SubSaveAt(t1=True)],
        dense=saveat.dense,
        solver_state=saveat.solver_state,
        controller_state=saveat.controller_state,
        made_jump=saveat.made_jump,
    )


class Snapshot(eqx.Module):
    """What the condition of an event sees.

    Args:
        poses: of the bodies; rad, m, m.
        displacements: of the bodies from rest; rad, m, m.
        velocities: of the bodies; rad/s, m/s, m/s.
    """

    poses: Poses
    displacements: Poses
    velocities: Poses


def _seen(event: dfx.Event) -> dfx.Event:
    """An event whose conditions see bodies instead of free coordinates."""

    def wrapped(condition):
        def see(t, y, args, **more):
            displacements, velocities = args.spread(t, y.place, y.rate)
            poses = args.mechanism.reference + displacements
            return condition(t, Snapshot(poses, displacements, velocities), args, **more)

        return see

    conditions = jax.tree.map(wrapped, event.cond_fn, is_leaf=callable)
    return dfx.Event(conditions, event.root_finder, event.direction)
