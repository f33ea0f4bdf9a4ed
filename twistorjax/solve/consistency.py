"""Checks of constraints: whether they are independent, and what is wrong with them."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import Flag, Poses, Scalar
from ..mechanism.constraints import ConstraintSet
from ..mechanism.mechanism import Mechanism
from .dofs import DofPartition
from .small_matrices import inverse
from .system import System


# Violations of the constraints up to this size are rounding errors: in rad, and in
# lengths of the mechanism.
EXACT = 1e-9
_LARGEST_INVERSE = 1e12  # of the Gram matrix of independent constraints


def independent_rows(jacobian: Float[Array, "entries n"]) -> Flag:
    """Decide whether the rows of a constraint Jacobian are linearly independent.

    Args:
        jacobian: Derivatives of the violations by displacements, the columns scaled by
            the units of the degrees of freedom.
    """
    if len(jacobian) > jacobian.shape[1]:
        return jnp.zeros((), bool)
    rows = jacobian / jnp.linalg.norm(jacobian, axis=1, keepdims=True)
    return jnp.max(jnp.abs(inverse(rows @ rows.T)), initial=0.0) < _LARGEST_INVERSE


def independent(system: System, displacements: Poses) -> Flag:
    """Decide whether the constraints of a system are independent at displacements."""
    if not system.constraints.size:
        return jnp.ones((), bool)
    units = system.free_units()
    return independent_rows(system.jacobian(displacements)[:, system.free] * units[None])


def lever_of(mechanism: Mechanism) -> float:
    """Compute the length of a mechanism by which displacements are scaled; m."""
    free = DofPartition.of(mechanism).free
    return float(mechanism.hinge_assembly.lever(free)) or 1.0


def constraint_error(
    constraints: ConstraintSet,
    dofs: DofPartition,
    mechanism: Mechanism,
    displacements: Poses,
    time: Scalar | float = 0.0,
) -> str:
    """Name the constraints that are violated, or that repeat or contradict others.

    Args:
        constraints: The constraints.
        dofs: Partition of the degrees of freedom.
        mechanism: The mechanism.
        displacements: Displacements at the start; rad, m, m.
        time: Time at the start; s.

    Returns:
        One sentence for each such constraint; empty if there is none.
    """
    now = jnp.asarray(time, float)
    violation = np.asarray(constraints.violation(displacements, now))
    units = np.where(np.array(dofs.free) % 3 == 0, 1.0, lever_of(mechanism))
    jacobian = np.asarray(constraints.jacobian(displacements, now))
    jacobian = jacobian[:, list(dofs.free)] * units[None]
    size = np.linalg.norm(jacobian, axis=1)
    size = np.where(size > 0, size, 1.0)
    jacobian, share = jacobian / size[:, None], np.abs(violation) / size
    names = constraints.names()
    sentences = []
    for name in dict.fromkeys(names):
        rows = [k for k, owner in enumerate(names) if owner == name]
        before = jacobian[: rows[0]]
        rank = np.linalg.matrix_rank(before, 1e-9) if len(before) else 0
        gained = np.linalg.matrix_rank(jacobian[: rows[-1] + 1], 1e-9) - rank
        worst, violated = np.abs(violation[rows]).max(), share[rows].max() > EXACT
        if gained < len(rows) and violated:
            sentences.append(
                f"{name!r} contradicts those before it: it leaves a violation of "
                f"{worst:.3g} that no displacement removes."
            )
        elif gained < len(rows):
            sentences.append(
                f"{name!r} is redundant: {len(rows) - gained} of its {len(rows)} entries "
                "follow from those before it and from fixed or prescribed coordinates. "
                "Leave it out."
            )
        elif violated:
            sentences.append(f"{name!r} is violated by {worst:.3g} at the start.")
    return " ".join(sentences)
