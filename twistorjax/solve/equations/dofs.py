"""Degrees of freedom of a mechanism, free, prescribed, and fixed, and their support."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Inexact

from ..._utils.host import concrete
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
        fixed: Inexact[Array, "bodies 3"] | None = None,
    ) -> Inexact[Array, "bodies 3"]:
        """Arrange values by bodies.

        Those of the fixed degrees of freedom are taken from `fixed`, by default zero.
        """
        dofs = (*self.free, *self.prescribed)
        source = len(dofs) + np.arange(self.total)
        source[list(dofs)] = np.arange(len(dofs))
        others = jnp.zeros(self.total, free.dtype) if fixed is None else fixed.reshape(-1)
        values = jnp.concatenate([free, prescribed, others])
        return gather_entries(values, source).reshape(-1, 3)

    def fixed_part(self, displacements: Poses) -> Poses:
        """Set all degrees of freedom to zero except the fixed ones."""
        fixed = np.ones(self.total)
        fixed[[*self.free, *self.prescribed]] = 0.0
        return jnp.asarray(fixed.reshape(-1, 3)) * displacements

    def reactions(self, forces: Inexact[Array, " dofs"]) -> Inexact[Array, "bodies 3"]:
        """Set forces on the free degrees of freedom to zero and arrange by bodies."""
        supported = np.ones(self.total)
        supported[list(self.free)] = 0.0
        return (jnp.asarray(supported, forces.dtype) * forces).reshape(-1, 3)


def displacements_at_start(mechanism: Mechanism, start: PosesOrResult) -> Poses:
    """Return the displacements of the bodies at a start; rad, m, m.

    Raises:
        ValueError: The start is not that of the mechanism, or a fixed coordinate of a
            body is displaced.
    """
    displacements = mechanism.displacements(start, "start", single=True)
    known = concrete(displacements)
    if known is None:
        return displacements
    moved = [dof for dof in mechanism.fixed if abs(known.flat[dof]) > _FIXED]
    if moved:
        body, coordinate = divmod(moved[0], 3)
        raise ValueError(
            f"`start` displaces the {COORDINATES[coordinate]} of the body "
            f"{mechanism.names[body]!r} by {known.flat[moved[0]]:.4g}, but it is fixed. "
            "Give a start in which it has its reference pose, or build the mechanism "
            "with another reference pose."
        )
    return displacements


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
