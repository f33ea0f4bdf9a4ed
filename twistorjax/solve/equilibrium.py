"""Static equilibrium of a mechanism under loads and prescribed displacements."""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from .._compile.compilation import fast_compile
from .._utils.host import program_input
from .._utils.progress import announced
from .._utils.pytrees import stop_gradient
from .._utils.types import Count, NumberLike, Poses, Scalar
from .._utils.validation import require_float64
from ..assembly.assembly import HingeAssembly
from ..mechanism.constraints import AbstractConstraint, ConstraintSet, gather_constraints
from ..mechanism.loads import Drive, Load, LoadSet, prescribed_dofs
from ..mechanism.mechanism import Mechanism
from ..mechanism.support import require_support
from ..results.codes import (
    is_success,
    result_names as result_names,
    result_of_status,
    RESULTS as RESULTS,
)
from ..results.tables import Column as Column
from .equations.consistency import independent
from .equations.dofs import displacements_at_start, DofPartition
from .equations.load_state import LoadState
from .equations.system import System
from .statics import newton
from .statics.derivatives import differentiable_root
from .statics.errors import check_equilibrium
from .statics.solution import Equilibrium, StateLike
from .stresses import report_stresses, reported_hinges


@announced("equilibrium")
def equilibrium(
    mechanism: Mechanism,
    *,
    loads: Sequence[Load] = (),
    drives: Sequence[Drive] = (),
    constraints: Sequence[AbstractConstraint] = (),
    start: StateLike | None = None,
    time: NumberLike = 0.0,
    tolerance: float = 1e-10,
    max_steps: int = 400,
    throw: bool = True,
) -> Equilibrium:
    """Compute the static equilibrium under loads and prescribed displacements.

    Displacements may be large. The loads are applied in increments if one Newton solve
    does not converge, or if a fold may lie within an increment. The result is the
    equilibrium that is connected to `start`, by default the reference configuration; the
    manual describes two exceptions. Unstable equilibria are rejected. The result has
    derivatives of every order, in forward and in reverse mode, which are computed by the
    implicit function theorem.

    Args:
        mechanism: The mechanism. Without loads, the result is the equilibrium to which
            the misfits of its hinges deform it.
        loads: Loads on its bodies.
        drives: Prescribed displacements of degrees of freedom that are not fixed.
        constraints: Pins, sliders, and other constraints between its bodies. Mechanisms
            with constraints are solved with dense matrices.
        start: Equilibrium or poses at which the iteration starts; by default the
            reference configuration. The best start is an equilibrium whose loads are
            close to the new ones. Poses are kept in place by forces of constant
            direction, which are removed in increments; rad, m, m.
        time: Time at which time-dependent constraints are evaluated, by default zero; s.
        tolerance: Relative tolerance on the square root of the Newton energy decrement.
        max_steps: Largest total number of Newton steps of all load increments.
        throw: Whether a failure raises an error. In a batch, the failure of one design
            raises an error for the whole batch. If False, the arrays of a failed design
            are NaN, and the other designs are unaffected.

    Returns:
        The equilibrium. If `throw` is False and no equilibrium was found, its arrays are
        NaN and `result` is the reason.

    Raises:
        ValueError: Double precision is disabled, a name is unknown, a degree of freedom
            is prescribed twice or is fixed, constraints are redundant or contradict one
            another, `start` displaces a fixed body, a shape is wrong, or a setting is
            invalid.
        RuntimeError: No equilibrium was found; the message gives the reason.

    Source:
        Equations 5.25 and 6.4 of the dissertation without inertia.

    Example:
        >>> import jax.numpy as jnp
        >>> from twistorjax import Body, equilibrium, Hinge, Load, Mechanism, Quadratic
        >>> spring = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0])))
        >>> hinge = Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
        >>> mechanism = Mechanism([Body("wall"), Body("block")], [hinge], fixed=["wall"])
        >>> pushed = equilibrium(mechanism, loads=[Load("block", force=(5.0, 0.0))])
        >>> pushed.displacement("block"), pushed.reaction("wall")
        (Array([0.  , 0.05, 0.  ], dtype=float64), Array([ 0., -5.,  0.], dtype=float64))
    """
    require_float64(mechanism.reference)
    constraint_set = gather_constraints(mechanism, constraints)
    if not 0 < tolerance < 1 or max_steps < 1:
        raise ValueError(
            f"`tolerance` is {tolerance!r} and `max_steps` is {max_steps!r}, but "
            "`tolerance` must be between 0 and 1, and `max_steps` at least 1."
        )
    load_set = LoadSet.of(mechanism, loads)
    prescribed, targets = prescribed_dofs(mechanism, drives)
    require_support(mechanism, constraint_set.bodies, prescribed)
    dofs = DofPartition.of(mechanism, prescribed)
    begin = np.zeros(mechanism.reference.shape)
    if start is not None:
        begin = displacements_at_start(mechanism, start)
    # A call of a `jax.jit` function takes less time than one of `eqx.filter_jit`, but
    # constraints may contain functions.
    solve = _solve_with_functions if constraint_set.size else _solve
    solution = solve(
        mechanism.hinge_assembly,
        mechanism.reference,
        begin,
        LoadState.of(mechanism, start, load_set, constraint_set),
        load_set,
        constraint_set,
        targets,
        program_input(time, float),
        program_input(tolerance, float),
        program_input(max_steps, int),
        dofs=dofs,
        names=(mechanism.names, reported_hinges(mechanism)),
    )
    if not throw:
        return solution

    def first_critical_point() -> str:
        from .continuation.diagnosis import describe_critical_point

        if start is not None or mechanism.hinge_assembly.misfits is not None:
            return ""  # The forces at the start, or the misfits, change along the path.
        proportional = load_set, constraint_set, targets, dofs
        return describe_critical_point(mechanism, *proportional, solution, time)

    return check_equilibrium(
        solution, mechanism, constraint_set, dofs, time, first_critical_point
    )


def solve_equilibrium(
    hinges: HingeAssembly,
    reference: Poses,
    start_displacements: Poses,
    first: LoadState | None,
    loads: LoadSet,
    constraints: ConstraintSet,
    targets: tuple[Scalar, ...],
    time: Scalar,
    tolerance: Scalar,
    max_steps: Count,
    *,
    dofs: DofPartition,
    names: tuple[tuple[str, ...], tuple[str, ...]],
) -> Equilibrium:
    """Compute the equilibrium; see `equilibrium`."""
    system = System(hinges, loads, constraints, jnp.array(targets, float), time, dofs)
    solution = find_equilibrium(system, start_displacements, first, tolerance, max_steps)
    return report_equilibrium(
        system, solution, reference, start_displacements, names=names
    )


def find_equilibrium(
    system: System,
    start_displacements: Poses,
    first: LoadState | None,
    tolerance: Scalar,
    max_steps: Count,
) -> newton.NewtonSolution:
    """Compute the displacements of the equilibrium, without derivatives."""
    system, start, first = stop_gradient((system, start_displacements, first))
    consistent = independent(system, start)
    solution = newton.solve_in_increments(
        replace(system, first=first), start, tolerance, max_steps
    )
    failed = (solution.status != newton.NOT_FINITE) & ~consistent
    status = jnp.where(failed, newton.INCONSISTENT, solution.status)
    return solution._replace(status=status)


def search_result(system: System, solution: newton.NewtonSolution) -> RESULTS:
    """Return whether an equilibrium was found, and it is valid; otherwise the reason."""
    results = (
        (newton.NOT_FINITE, RESULTS.not_finite),
        (newton.UNSTABLE, RESULTS.unstable),
        (newton.STUCK, RESULTS.no_equilibrium),
        (newton.USED_UP, RESULTS.steps_used_up),
        (newton.INCONSISTENT, RESULTS.inconsistent_constraints),
    )
    result = result_of_status(solution.status, results, RESULTS.successful)
    outside = jnp.any(system.hinges.out_of_range(solution.displacements))
    outside &= solution.status == newton.CONVERGED
    return RESULTS.where(outside, RESULTS.out_of_range, result)


def report_equilibrium(
    system: System,
    solution: newton.NewtonSolution,
    reference: Poses,
    start_displacements: Poses,
    *,
    names: tuple[tuple[str, ...], tuple[str, ...]],
) -> Equilibrium:
    """Compute all results of an equilibrium that was found, with their derivatives."""
    hinges, flat = system.hinges, solution.displacements.reshape(-1)
    converged = solution.status == newton.CONVERGED
    root, multipliers = flat[system.free], jnp.zeros(0)
    if solution.multipliers is not None:
        root = jnp.concatenate([root, solution.multipliers])
    root = differentiable_root(system, root, start_displacements, converged)
    free = root
    if solution.multipliers is not None:
        free, multipliers = jnp.split(root, [len(system.free)])
    prescribed = jnp.where(converged, system.targets, flat[system.prescribed])
    displacements = system.dofs.expand(free, prescribed, start_displacements)
    reactions, energy = system.reactions_and_energy(displacements, multipliers)
    result = search_result(system, solution)
    # Newton's method does not evaluate forces at prescribed displacements alone.
    finite = jnp.isfinite(energy) & jnp.all(jnp.isfinite(reactions))
    undefined = is_success(result) & ~finite
    result = RESULTS.where(undefined, RESULTS.not_finite, result)
    valid = is_success(result)
    if solution.multipliers is not None:  # no array of size zero; see `System.equations`
        multipliers = jnp.where(valid, multipliers, jnp.nan)
    return Equilibrium(
        displacements=jnp.where(valid, displacements, jnp.nan),
        reference=reference,
        reactions=jnp.where(valid, reactions, jnp.nan),
        constraint_forces=multipliers,
        energy=jnp.where(valid, energy, jnp.nan),
        reached=solution.displacements,
        fraction=solution.fraction,
        steps=solution.steps,
        range_shares=hinges.range_shares(solution.displacements),
        loads=system.loads,
        misfits=hinges.misfits,
        result=result,
        names=names[0],
        constraint_names=system.constraints.names(),
        stresses=report_stresses(hinges, displacements, names[1], valid),
    )


_solve = fast_compile(solve_equilibrium, jit=jax.jit, static_argnames=("dofs", "names"))
_solve_with_functions = fast_compile(solve_equilibrium)
