"""Motion of a mechanism under loads, prescribed motions, and constraints."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import diffrax as dfx
import jax.numpy as jnp

from .._compile.traced_function import traced
from .._utils.host import as_float, is_traced, on_host, program_input
from .._utils.progress import announced
from .._utils.pytrees import stop_gradient
from .._utils.types import NumberLike, TimesLike, VelocityLike
from .._utils.validation import require_float64
from ..mechanism.changes import HingeChanges, TemperatureInTime
from ..mechanism.constraints import (
    AbstractConstraint,
    gather_constraints,
    require_rigid_joints,
)
from ..mechanism.loads import LoadSet, prescribed_dofs
from ..mechanism.mechanism import Mechanism
from ..results.codes import finish
from .equations.dofs import displacements_at_start, DofPartition
from .integration.adjoint import StepwiseAdjoint
from .integration.arguments import (
    check_finite,
    check_settings,
    check_times,
    check_velocities,
    explain_compilation,
    pad_times,
)
from .integration.choice import chosen_solver
from .integration.collocation import Gauss, Radau
from .integration.errors import StartOfMotion
from .integration.program import (
    Driving,
    Loading,
    solve_motion,
    solve_with_callbacks,
    Strokes,
)
from .integration.solution import Motion
from .statics.solution import StateLike


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
        solver: Solver: `Gauss()` with a `step` for motion without damping, or any solver
            of diffrax. By default it is the implicit `Radau()`, or the explicit
            `diffrax.Tsit5()` if there are neither constraints nor a `step`, the matrices
            of the mechanism are large enough to be solved in blocks (40 bodies or more),
            and about a thousand explicit steps are enough for their stability. In a batch
            and inside `jax.jit` it is `Radau()`. `Motion.method` is its name.
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
            mechanism.hinges_in(changes.state(mechanism, first))  # checks the names
    load_set = LoadSet.of(mechanism, first_loads)
    dofs = DofPartition.of(mechanism, prescribed_dofs(mechanism, first_drives)[0])
    displacements = jnp.zeros_like(mechanism.reference)
    if start is not None:
        displacements = displacements_at_start(mechanism, start)
        check_finite("start", displacements)
    rates = check_velocities(mechanism, velocities, dofs.free)
    # In a program, thousands of masses that are gathered one by one take long to compile.
    inertia = mechanism.inertia()
    constraint_set = gather_constraints(mechanism, constraints)
    if temperature is not None:
        require_rigid_joints(mechanism, constraints)
    start_of_motion = StartOfMotion(
        mechanism, drives, constraint_set, displacements, first, dofs, rates is not None
    )
    if throw:
        start_of_motion.check()
    # In a program that is traced, for example for a batch, padding would only cost time.
    arguments = mechanism, instants, loads, drives, strokes, constraint_set, displacements
    pad = saveat is None and not is_traced((*arguments, tolerance))
    time_count = len(instants)
    if solver is None:
        solver = Radau()
        if step is None and controller is None and not constraint_set.size:
            duration = as_float(host_instants[-1] - host_instants[0])
            solver = chosen_solver(mechanism, inertia, dofs, displacements, duration)
    has_defaults = all(
        setting is None for setting in (adjoint, controller, saveat, event)
    )
    stepwise = has_defaults and isinstance(solver, Radau | Gauss)
    if adjoint is None:
        adjoint = StepwiseAdjoint() if stepwise else dfx.RecursiveCheckpointAdjoint()
    solve = solve_motion if progress_meter is None else solve_with_callbacks
    with explain_compilation(first, **functions):
        motion = solve(
            mechanism,
            inertia,
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

    def error(name: str, batch_index: tuple[int, ...]) -> Exception:
        start, known = stop_gradient((start_of_motion, motion))
        return start.error(known, name, batch_index)

    return finish(motion, throw, error)
