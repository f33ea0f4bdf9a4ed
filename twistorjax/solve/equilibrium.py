"""Static equilibrium of a mechanism under loads and prescribed displacements."""

from collections.abc import Sequence

import jax.numpy as jnp

from .._utils.progress import announced
from .._utils.types import NumberLike, Pose, Poses
from .._utils.validation import warn
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Drive, Load, loaded_bodies
from ..mechanism.mechanism import Mechanism

# These names are in `tj.solve`, whose stub can only import from files of its own folder.
from ..results.codes import result_names as result_names, RESULTS as RESULTS
from ..results.tables import Column as Column
from .equations.problem import Problem
from .statics.errors import finish_equilibrium
from .statics.solution import Equilibrium, StateLike
from .statics.solver import solve


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
    if not 0 < tolerance < 1 or max_steps < 1:
        raise ValueError(
            f"`tolerance` is {tolerance!r} and `max_steps` is {max_steps!r}, but "
            "`tolerance` must be between 0 and 1, and `max_steps` at least 1."
        )
    problem = Problem.of(mechanism, loads, drives, constraints, time)
    if loads and all(map(mechanism.is_fixed, loaded_bodies(mechanism, loads))):
        warn(
            "All loads act on fixed bodies, so they have no effect. Give the names of "
            "bodies that can move."
        )
    solution = solve(problem, start, tolerance, max_steps)

    def first_critical_point() -> str:
        from .continuation.diagnosis import describe_critical_point

        return describe_critical_point(problem, start, solution)

    return finish_equilibrium(solution, throw, problem, first_critical_point)


def inner_displacements(mechanism: Mechanism, second: str, pose: Pose) -> Poses:
    """Compute the equilibrium of the inner bodies at a displacement of body B.

    The mechanism is that of the sub-mechanism, without validity ranges, and displacements
    are in its frame. They are NaN if there is no equilibrium.
    """
    if len(mechanism.names) == 2:
        row = mechanism.index(second)
        return jnp.zeros_like(mechanism.reference).at[row].set(pose)
    moved = Drive(second, angle=pose[0], x=pose[1], y=pose[2])
    return equilibrium(mechanism, drives=[moved], throw=False).displacements
