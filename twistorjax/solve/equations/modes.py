"""Natural modes of a stiffness and an inertia, with constraints."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..._utils.pytrees import stop_gradient
from ..._utils.types import Poses
from ...linalg.constraints import null_space
from ...linalg.eigenvalues import modes, rounding_errors, Stiffness
from ...mechanism.mechanism import Mechanism
from .system import System


class NaturalModes(NamedTuple):
    """Modes of vibration of the free degrees of freedom."""

    # Angular frequencies, negative for unstable modes; rad/s
    angular: Float[Array, " modes"]
    # Mass-normalized mode shapes, one in each column; rad/(kg^0.5 m), 1/kg^0.5
    shapes: Float[Array, "free modes"]
    # Whether the stiffness of each mode is negative, and not zero within rounding errors
    unstable: Bool[Array, " modes"]


def natural_modes(
    mechanism: Mechanism, system: System, displacements: Poses
) -> NaturalModes:
    """Compute the modes at given displacements (rad, m, m), without follower loads."""
    free = system.free
    units = 1 / jnp.sqrt(mechanism.inertia().reshape(-1)[free])
    rows, weights, remainder = system.hinges.factored(displacements, system.dofs.free)
    _, by_angle = system.loads.apply(displacements)
    # Without follower loads, only the moments of the loads depend on the angles.
    remainder = remainder - jnp.diag(by_angle.reshape(-1)[free])
    basis = jnp.diag(units)
    if system.constraints.size:
        geometric = system.constraint_stiffness(displacements)
        remainder = remainder + geometric[free[:, None], free]
        jacobian = system.jacobian(displacements)[:, free]
        basis = basis @ null_space(jacobian * units[None])[1]
    stiffness = Stiffness(rows, weights, remainder)
    root, vectors = modes(stiffness.reduced(basis))
    angular, shapes = jnp.diagonal(root), basis @ vectors
    errors = rounding_errors(*stop_gradient((stiffness, shapes)))
    return NaturalModes(angular, shapes, (angular < 0) & (angular**2 > errors))
