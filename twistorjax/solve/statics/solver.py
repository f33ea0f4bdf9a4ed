"""The program that finds an equilibrium, and its derivatives."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from ..._compile.compilation import fast_compile
from ..._utils.host import program_input
from ..._utils.pytrees import stop_gradient
from ..._utils.types import Count, Entries, Poses, Scalar
from ...assembly.assembly import HingeAssembly
from ...mechanism.constraints import ConstraintSet
from ...mechanism.loads import LoadSet
from ...results.codes import is_success, result_of_status, RESULTS
from ..equations.consistency import independent
from ..equations.dofs import displacements_at_start, DofPartition
from ..equations.load_state import LoadState
from ..equations.problem import Problem
from ..equations.stresses import report_stresses, reported_hinges
from ..equations.system import System
from . import newton
from .derivatives import differentiable_root
from .solution import Equilibrium, StateLike


def solve(
    problem: Problem,
    start: StateLike | None,
    tolerance: float = 1e-10,
    max_steps: int = 400,
) -> Equilibrium:
    """Compute the equilibrium from a start, or its failure; see `equilibrium`."""
    mechanism, constraints = problem.mechanism, problem.constraints
    displacements = np.zeros(mechanism.reference.shape)
    if start is not None:
        displacements = displacements_at_start(mechanism, start)
    # A call takes half the time (`benchmarks.statics`) by `jax.jit` instead of
    # `eqx.filter_jit`, which only constraints need, because they may contain functions,
    # and with parts of a system as arguments instead of a `System`.
    compiled = _solve_with_filter_jit if constraints.size else _solve_with_jit
    return compiled(
        mechanism.hinge_assembly,
        mechanism.reference,
        displacements,
        LoadState.of(mechanism, start, problem.loads, constraints),
        problem.loads,
        constraints,
        problem.targets,
        program_input(problem.time, float),
        program_input(tolerance, float),
        program_input(max_steps, int),
        dofs=problem.dofs,
        body_names=mechanism.names,
        hinge_names=reported_hinges(mechanism),
    )


def _solve(
    hinges: HingeAssembly,
    reference: Poses,
    start: Poses,
    at_start: LoadState | None,
    loads: LoadSet,
    constraints: ConstraintSet,
    targets: tuple[Scalar, ...],
    time: Scalar,
    tolerance: Scalar,
    max_steps: Count,
    *,
    dofs: DofPartition,
    body_names: tuple[str, ...],
    hinge_names: tuple[str, ...],
) -> Equilibrium:
    """Compute the equilibrium; see `equilibrium`."""
    system = System(hinges, loads, constraints, jnp.array(targets, float), time, dofs)
    solution = find_equilibrium(system, start, at_start, tolerance, max_steps)
    return _report_equilibrium(system, solution, reference, body_names, hinge_names)


def find_equilibrium(
    system: System,
    start: Poses,
    at_start: LoadState | None,
    tolerance: Scalar,
    max_steps: Count,
) -> newton.NewtonSolution:
    """Compute the displacements of the equilibrium, without derivatives."""
    system, start, at_start = stop_gradient((system, start, at_start))
    consistent = independent(system, start)
    solution = newton.solve_in_increments(
        replace(system, at_start=at_start), start, tolerance, max_steps
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


def _report_equilibrium(
    system: System,
    solution: newton.NewtonSolution,
    reference: Poses,
    body_names: tuple[str, ...],
    hinge_names: tuple[str, ...],
) -> Equilibrium:
    """Compute all results of an equilibrium that was found, with their derivatives."""
    hinges = system.hinges
    displacements, multipliers = _differentiable_state(system, solution)
    reactions, energy = system.reactions_and_energy(displacements, multipliers)
    result = search_result(system, solution)
    # If all displacements are prescribed, Newton's method does not evaluate the forces.
    finite = jnp.isfinite(energy) & jnp.all(jnp.isfinite(reactions))
    undefined = is_success(result) & ~finite
    result = RESULTS.where(undefined, RESULTS.not_finite, result)
    valid = is_success(result)
    if solution.multipliers is not None:  # no array of size zero; see `System.residual`
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
        names=body_names,
        constraint_names=system.constraints.names(),
        stresses=report_stresses(hinges, displacements, hinge_names, valid),
    )


def _differentiable_state(
    system: System, solution: newton.NewtonSolution
) -> tuple[Poses, Entries]:
    """Return displacements and constraint forces, with derivatives by the system."""
    flat, count = solution.displacements.reshape(-1), len(system.free)
    converged = solution.status == newton.CONVERGED
    root = flat[system.free]
    if solution.multipliers is not None:
        root = jnp.concatenate([root, solution.multipliers])
    root = differentiable_root(system, root, converged)
    prescribed = jnp.where(converged, system.targets, flat[system.prescribed])
    displacements = system.dofs.expand(root[:count], prescribed)
    return displacements, root[count:]


_solve_with_jit = fast_compile(
    _solve, jit=jax.jit, static_argnames=("dofs", "body_names", "hinge_names")
)
_solve_with_filter_jit = fast_compile(_solve)
