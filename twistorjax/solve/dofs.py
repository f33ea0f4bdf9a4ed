"""Degrees of freedom of a mechanism: free, prescribed, and fixed."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Inexact

from .._utils.types import Poses
from ..mechanism.mechanism import Mechanism
from ..mechanism.scatter import gather_entries


class DofPartition(NamedTuple):
    """Partition of the degrees of freedom: free, prescribed, and fixed.

    A mechanism has three degrees of freedom for each body: angle, x, y.

    Args:
        total: Number of degrees of freedom.
        free: Indices of those that are solved for.
        prescribed: Indices of those whose displacement is prescribed. All others are
            fixed.
    """

    total: int
    free: tuple[int, ...]
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
