"""Messages on paths and on equilibria under increasing loads that fail."""

import jax.numpy as jnp

from ..._utils.pytrees import stop_gradient
from ...mechanism.loads import LoadSet
from ...results.codes import result_message
from ..equations.problem import Problem
from ..statics.errors import describe_free_motions
from ..statics.solution import Equilibrium, StateLike
from .program import PathRun, run_path
from .start import regular_point
from .system import PathSystem


_POINTS = 60  # of the path; the critical point is close to its start


def describe_critical_point(
    problem: Problem, start: StateLike | None, solution: Equilibrium
) -> str:
    """Return a sentence about the first critical point after the reached equilibrium.

    It is empty if no critical point was found.
    """
    problem, solution = stop_gradient((problem, solution))
    mechanism = problem.mechanism
    if start is not None or mechanism.hinge_assembly.misfits is not None:
        return ""  # The forces at the start, or the misfits, change along the path.
    begin = jnp.zeros_like(mechanism.reference)
    system = PathSystem.of(problem, LoadSet.of(mechanism, ()), begin)
    limits, step = jnp.array([-1.0, 1.0]), jnp.array(0.05)
    first = regular_point(solution.reached, solution.fraction)
    criticals = run_path(system, first, limits, step, None, _POINTS, _POINTS, 1).criticals
    if not int(criticals.number):
        return ""
    fraction = float(criticals.points[0, -1])
    kind = "branch" if bool(criticals.is_branch[0]) else "limit"
    if (times := int(criticals.multiplicities[0])) > 1:
        kind = f"{times}-fold {kind}"
    return f" There is a {kind} point at the fraction {fraction:.8g}."


def path_message(item: str, system: PathSystem, run: PathRun) -> str:
    """Return the message of a failure of a path, by the name of the result."""
    text = result_message(item)
    if item == "out_of_range":
        text += f" {system.range_messages(run.trace.reached)}"
    if item == "unstable":
        equations = system.at(jnp.zeros(()))
        text += describe_free_motions(system.mechanism, equations, system.start)
    return text
