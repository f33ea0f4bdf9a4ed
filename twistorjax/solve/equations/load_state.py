"""Loads, misfits, and constraint forces under which load increments begin."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from ...mechanism.constraints import ConstraintSet
from ...mechanism.loads import LoadSet
from ...mechanism.mechanism import Mechanism


class LoadState(NamedTuple):
    """What acts on a mechanism at the equilibrium from which load increments begin.

    Loads and misfits change in proportion from these to the given ones. If the loads at
    the start were unknown forces of constant direction, the stiffness of loads beside the
    origin of a body and the geometric stiffness of preloaded hinges would be wrong.
    """

    loads: LoadSet
    # The six numbers of the misfit of each hinge; None if there are none
    misfits: Float[Array | np.ndarray, "hinges 6"] | None
    # Constraint forces; None if there are no constraints; N m, N
    constraint_forces: Float[Array | np.ndarray, " entries"] | None

    @classmethod
    def of(
        cls,
        mechanism: Mechanism,
        start: Any,
        loads: LoadSet,
        constraints: ConstraintSet,
    ) -> "LoadState | None":
        """Return the state of the configuration from which the solver starts.

        Everything is zero in the reference configuration. It has the same structure as
        the state of an equilibrium, so that both use the same compiled program.

        Args:
            start: An equilibrium, poses, or None for the reference configuration.
            loads: Loads to which those of the start change.
            constraints: The constraints. Constraint forces of other ones are not used.

        Returns:
            The state; None if it is unknown, as for poses.
        """
        new_misfits = mechanism.hinge_assembly.misfits
        misfits = None if new_misfits is None else np.zeros(new_misfits.shape)
        forces = np.zeros(constraints.size) if constraints.size else None
        if start is None:
            return cls(loads.zero(), misfits, forces)
        if not isinstance(first := getattr(start, "loads", None), LoadSet):
            return None
        if start.misfits is not None:
            if len(start.misfits) != len(mechanism.hinge_names):
                return None
            misfits = start.misfits
        if constraints.size and start.constraint_names == constraints.names():
            forces = start.constraint_forces
        return cls(loads.zero().plus(first), misfits, forces)
