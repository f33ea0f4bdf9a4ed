"""Errors and warnings of a static equilibrium."""

from collections.abc import Callable

import numpy as np

from ..._utils.pytrees import stop_gradient
from ..._utils.types import Poses
from ...mechanism.mechanism import Mechanism
from ...results.codes import finish, result_message
from ..equations.problem import Problem
from ..equations.state import warn_outside_linear_range
from ..equations.system import System
from .solution import Equilibrium


# A stiffness below this fraction of the largest one does not count in messages.
_NO_STIFFNESS = 1e-12


def describe_free_motions(
    mechanism: Mechanism, system: System, displacements: Poses
) -> str:
    """Name the bodies that can move without any resistance, for a message."""
    from ..equations.mobility import analyze

    if not np.all(np.isfinite(displacements)):
        return ""
    analysis = analyze(mechanism, system, displacements, ratio=_NO_STIFFNESS)
    if not analysis.motion_descriptions:
        return ""
    return f" Nothing resists the {'; the '.join(analysis.motion_descriptions)}."


def finish_equilibrium(
    solution: Equilibrium,
    throw: bool,
    problem: Problem | None = None,
    first_critical_point: Callable[[], str] | None = None,
) -> Equilibrium:
    """Return the solution; if it failed and may `throw`, raise its error.

    The problem is needed only to name the hinges that are out of range, and the
    inconsistent constraints. A function describes the critical point that the load
    increments did not pass.
    """

    def error(item: str, batch_index: tuple[int, ...]) -> Exception:
        known, known_problem = stop_gradient((solution, problem))
        fraction = np.asarray(known.fraction)[batch_index]
        steps = np.asarray(known.steps)[batch_index]
        where = ""
        if batch_index:
            where = f" at index {', '.join(map(str, batch_index))} of the batch"
        text = result_message(item)
        if known_problem is not None and not batch_index:
            mechanism, reached = known_problem.mechanism, known.reached
            if item == "out_of_range":
                text += f" {mechanism.range_messages(mechanism.reference + reached)}"
            if item == "inconsistent_constraints":
                return known_problem.inconsistency(reached)
            ended = item in ("no_equilibrium", "steps_used_up")
            if ended and first_critical_point is not None:
                description = first_critical_point()
                if description:
                    text = result_message("no_equilibrium") + description
            if ended and mechanism.hinge_assembly.misfits is not None:
                text += " Misfits are applied in the same increments as the loads."
            if item == "unstable":
                text += describe_free_motions(mechanism, known_problem.system, reached)
        return RuntimeError(
            f"{text} (fraction {fraction:.4g}, {steps} Newton steps{where})"
        )

    solution = finish(solution, throw, error)
    if throw and problem is not None:
        warn_outside_linear_range(problem.mechanism, solution.range_shares)
    return solution
