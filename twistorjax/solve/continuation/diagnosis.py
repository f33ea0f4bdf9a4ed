"""The critical point at which an equilibrium under increasing loads ends."""

import jax.numpy as jnp

from ..._utils.host import as_float
from ..._utils.types import NumberLike, Scalar
from ...mechanism.constraints import ConstraintSet
from ...mechanism.loads import LoadSet
from ...mechanism.mechanism import Mechanism
from ..equations.dofs import DofPartition
from ..statics.solution import Equilibrium
from .program import run_path
from .setup import regular_point
from .system import PathSystem


_POINTS = 60  # of the path; the critical point is close to its start


def describe_critical_point(
    mechanism: Mechanism,
    loads: LoadSet,
    constraints: ConstraintSet,
    targets: tuple[Scalar, ...],
    dofs: DofPartition,
    solution: Equilibrium,
    time: NumberLike,
) -> str:
    """Describe the first critical point after the equilibrium that was reached.

    Args:
        mechanism: The mechanism.
        loads: Its loads.
        constraints: Its constraints.
        targets: Displacements of the prescribed degrees of freedom; rad, m.
        dofs: Partition of the degrees of freedom.
        solution: The equilibrium, with the fraction of the loads that was reached.
        time: Time at which time-dependent constraints are evaluated; s.

    Returns:
        A sentence for an error message; empty if no critical point was found.
    """
    system = PathSystem(
        mechanism=mechanism,
        loads=loads,
        constant_loads=LoadSet.of(mechanism, ()),
        constraints=constraints,
        changes=None,
        start=jnp.zeros_like(mechanism.reference),
        targets=jnp.array(targets, float),
        time=as_float(time),
        dofs=dofs,
    )
    limits, step = jnp.array([-1.0, 1.0]), jnp.array(0.05)
    first = regular_point(solution.reached, solution.fraction)
    criticals = run_path(system, first, limits, step, None, _POINTS, 1).criticals
    if not int(criticals.number):
        return ""
    fraction = float(criticals.points[0, -1])
    kind = "branch" if bool(criticals.is_branch[0]) else "limit"
    if (times := int(criticals.multiplicities[0])) > 1:
        kind = f"{times}-fold {kind}"
    return f" There is a {kind} point at the fraction {fraction:.8g}."
