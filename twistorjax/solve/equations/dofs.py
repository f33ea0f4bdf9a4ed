"""Degrees of freedom of a mechanism, free, prescribed, and fixed, and their support."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Inexact

from ..._utils.host import as_float, on_host
from ..._utils.types import Poses, PosesOrResult
from ...linalg.sums import gather_entries
from ...mechanism.mechanism import COORDINATES, Mechanism


_FIXED = 1e-12  # displacement of a fixed coordinate that is a rounding error; rad, m


class DofPartition(NamedTuple):
    """Partition of the degrees of freedom: free, prescribed, and fixed.

    A mechanism has three degrees of freedom for each body: angle, x, y.
    """

    total: int  # Number of degrees of freedom
    free: tuple[int, ...]  # Indices of those that are solved for
    # Indices of those whose displacement is prescribed. All others are fixed.
    prescribed: tuple[int, ...] = ()

    @classmethod
    def of(cls, mechanism: Mechanism, prescribed: Sequence[int] = ()) -> "DofPartition":
        """Partition the degrees of freedom of a mechanism."""
        count = 3 * len(mechanism.names)
        not_free = {*mechanism.fixed, *prescribed}
        free = tuple(dof for dof in range(count) if dof not in not_free)
        return cls(count, free, tuple(prescribed))

    def expand(
        self,
        free: Inexact[Array, " free"],
        prescribed: Inexact[Array, " prescribed"],
    ) -> Inexact[Array, "bodies 3"]:
        """Arrange values by bodies; those of fixed degrees of freedom are zero."""
        dofs = (*self.free, *self.prescribed)
        source = np.full(self.total, len(dofs))
        source[list(dofs)] = np.arange(len(dofs))
        values = jnp.concatenate([free, prescribed, jnp.zeros(1, free.dtype)])
        return gather_entries(values, source).reshape(-1, 3)

    def reactions(self, forces: Inexact[Array, " dofs"]) -> Inexact[Array, "bodies 3"]:
        """Set forces on the free degrees of freedom to zero and arrange by bodies."""
        supported = np.ones(self.total)
        supported[list(self.free)] = 0.0
        return (jnp.asarray(supported, forces.dtype) * forces).reshape(-1, 3)


def displacements_at_start(mechanism: Mechanism, start: PosesOrResult) -> Poses:
    """Return the displacements of the bodies at a start; rad, m, m.

    Fixed coordinates have no displacement. All displacements are NaN if the start is
    traced, and displaces one of them.

    Raises:
        ValueError: The start is not that of the mechanism, or a fixed coordinate of a
            body is displaced.
    """
    displacements = mechanism.displacements(start, "start", single=True)
    xp, (known,) = on_host(displacements)
    fixed = np.zeros(displacements.size, bool)
    fixed[list(mechanism.fixed)] = True
    fixed = fixed.reshape(displacements.shape)
    moved = fixed & (abs(known) > _FIXED)
    if xp is np and np.any(moved):
        dof = int(np.argmax(moved))
        body, coordinate = divmod(dof, 3)
        raise ValueError(
            f"`start` displaces the {COORDINATES[coordinate]} of the body "
            f"{mechanism.names[body]!r} by {known.flat[dof]:.4g}, but it is fixed. "
            "Give a start in which it has its reference pose, or build the mechanism "
            "with another reference pose."
        )
    at_start = xp.where(xp.any(moved), xp.nan, xp.where(fixed, 0.0, known))
    return as_float(at_start)


def require_support(
    mechanism: Mechanism,
    constrained: Sequence[Sequence[int]],
    prescribed: Sequence[int] = (),
) -> None:
    """Check that hinges or constraints connect every body to a fixed one.

    Args:
        constrained: Indices of the bodies of each constraint.
        prescribed: Indices of the prescribed degrees of freedom, whose bodies are
            supported as well.

    Raises:
        ValueError: A body is not connected.
    """
    neighbors: dict[int, set[int]] = {}
    for group in (*mechanism.hinge_assembly.ends, *constrained):
        for body in group:
            neighbors.setdefault(body, set()).update(group)
    connected = {dof // 3 for dof in (*mechanism.fixed, *prescribed)}
    front = list(connected)
    while front:
        new = neighbors.get(front.pop(), set()) - connected
        connected |= new
        front.extend(new)
    names = [name for k, name in enumerate(mechanism.names) if k not in connected]
    if names:
        plural = len(names) > 1
        raise ValueError(
            f"The {'bodies' if plural else 'body'} {' and '.join(map(repr, names))} "
            f"{'are' if plural else 'is'} not connected to a body in `fixed` by hinges "
            "or constraints. Fix or prescribe the position of one of them, or add a "
            "hinge."
        )
