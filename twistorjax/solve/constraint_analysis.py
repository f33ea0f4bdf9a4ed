"""Mechanisms and over-constraints: motions and stresses that stiff hinges allow."""

from collections.abc import Mapping, Sequence

from .._utils.progress import announced
from .._utils.types import NumberLike
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.mechanism import Mechanism
from .equations.mobility import analyze, ConstraintAnalysis
from .equations.problem import Problem
from .equations.state import state_in_range
from .statics.solution import StateLike


@announced("constraint analysis")
def constraint_analysis(
    mechanism: Mechanism,
    *,
    ratio: float = 1e-3,
    about: StateLike | None = None,
    constraints: Sequence[AbstractConstraint] = (),
    prescribed: Sequence[str] | Mapping[str, Sequence[str]] = (),
    time: NumberLike = 0.0,
) -> ConstraintAnalysis:
    """Find motions that no stiff direction of a hinge resists, and over-constraints.

    The stiff directions of hinges are taken as rigid, and the others as free. A direction
    of a hinge is stiff if its stiffness is at least the `ratio` times the largest one of
    the mechanism. Rotational stiffnesses are divided by the square of a length: that of
    the flexure or the characteristic length of the mechanism, the larger one. For leaves
    of equal length, the ratio of transverse to axial stiffness is (thickness / length)^2,
    so that only their axial direction is stiff by default.

    Args:
        mechanism: The mechanism. It may have bodies without support.
        ratio: Ratio of stiffnesses above which a direction is stiff.
        about: Equilibrium or poses at which the mechanism is analyzed; by default the
            reference configuration; rad, m, m.
        constraints: Constraints between the bodies, which are rigid.
        prescribed: Coordinates with prescribed displacements, which cannot move; see
            `linearize`.
        time: Time at which time-dependent constraints are evaluated; s.

    Returns:
        The motions and the states of self-stress, by the names of bodies and hinges.

    Raises:
        ValueError: The ratio is not between 0 and 1, or a name is unknown.

    Source:
        Motions are the null space of the matrix of the constraint rows, and states of
        self-stress that of its transpose: Pellegrino and Calladine, Int. J. Solids
        Structures 22, 1986.

    Example:
        >>> import numpy as np
        >>> from twistorjax import Body, Hinge, Quadratic
        >>> leaf = Quadratic(np.diag([1.0, 1e8, 1e4]))
        >>> hinges = [
        ...     Hinge(name, "base", "table", leaf, at=(np.pi / 2, x, 0.0))
        ...     for name, x in (("left", -0.1), ("middle", 0.0), ("right", 0.1))
        ... ]
        >>> bodies = [Body("base"), Body("table")]
        >>> constraint_analysis(Mechanism(bodies, hinges, fixed=["base"]))
        1 motion that no stiff direction resists, 1 over-constraint
        motion of 'table', mainly x of 'table'
        over-constraint: release one of axial force of 'left', axial force of 'middle',
        axial force of 'right'
    """
    if not 0 < ratio < 1:
        raise ValueError(f"`ratio` is {ratio!r}, but must be between 0 and 1.")
    held = set(mechanism.dofs_of("prescribed", prescribed)) - set(mechanism.fixed)
    problem = Problem.of(
        mechanism, (), (), constraints, time, held=sorted(held), supported=False
    )
    state = state_in_range(mechanism, "about", about)
    return analyze(mechanism, problem.system, state, ratio)
