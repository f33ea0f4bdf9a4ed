"""Loads, misfits, and constraint forces under which load increments begin."""

from typing import Any, NamedTuple

from jaxtyping import Array, Float

from .._utils.types import Entries
from ..mechanism.loads import LoadSet
from ..mechanism.mechanism import Mechanism


class LoadState(NamedTuple):
    """What acts on a mechanism at the equilibrium from which load increments begin.

    Loads and misfits change in proportion from these to the given ones. If the loads at
    the start were unknown forces of constant direction, the stiffness of loads beside the
    origin of a body and the geometric stiffness of preloaded hinges would be wrong.

    Args:
        loads: The loads.
        misfits: The five numbers of the misfit of each hinge; None if there are none.
        constraint_forces: Constraint forces; None if they are zero or unknown; N m, N.
    """

    loads: LoadSet
    misfits: Float[Array, "hinges 5"] | None = None
    constraint_forces: Entries | None = None

    @classmethod
    def of(cls, mechanism: Mechanism, start: Any, entries: int) -> "LoadState | None":
        """Return the state of an equilibrium from which the solver starts.

        Args:
            mechanism: The mechanism.
            start: An equilibrium, poses, or None for the reference configuration.
            entries: Number of scalar equations of the constraints.

        Returns:
            The state; None if it is unknown, as for poses.
        """
        if start is None:
            return cls(LoadSet.of(mechanism, ()))
        loads = getattr(start, "loads", None)
        if not isinstance(loads, LoadSet):
            return None
        misfits, forces = start.misfits, start.constraint_forces
        if misfits is not None and len(misfits) != len(mechanism.hinge_names):
            return None
        known = entries and forces.shape == (entries,)
        return cls(loads, misfits, forces if known else None)
