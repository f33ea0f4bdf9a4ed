"""Natural modes of a stiffness and an inertia, with constraints."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..._utils.pytrees import stop_gradient
from ..._utils.types import Poses, Scalar
from ...assembly.factored import FactoredStiffness
from ...linalg.block_factors import BlockInverses, Layout
from ...linalg.constraints import null_space
from ...linalg.eigenvalues import modes, Stiffness
from ...linalg.lowest_modes import has_subspace, lowest_modes, response
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
    mechanism: Mechanism, system: System, displacements: Poses, count: int
) -> NaturalModes:
    """Compute the lowest modes at displacements (rad, m, m), without follower loads."""
    free, units = system.free, _units(mechanism, system)
    stiffness = system.factored_stiffness(displacements)
    layout = subspace_layout(system, count)
    if layout is not None:
        scaled = ScaledStiffness(stiffness, units, layout)
        root, vectors = lowest_modes(scaled, count=count)
        return _natural_modes(root, units[:, None] * vectors, stiffness)
    stiffness, basis = stiffness.dense(), jnp.diag(units)
    if system.constraints.size:
        geometric = system.constraint_stiffness(displacements)
        stiffness = stiffness.plus(geometric[free[:, None], free])
        jacobian = system.jacobian(displacements)[:, free]
        basis = basis @ null_space(jacobian * units[None])[1]
    root, vectors = modes(stiffness.reduced(basis))
    return _natural_modes(root[:count, :count], basis @ vectors[:, :count], stiffness)


def subspace_layout(system: System, count: int) -> Layout | None:
    """Return the layout with which `natural_modes` computes only the lowest modes.

    It is None if all modes are computed.
    """
    return system.layout if has_subspace(len(system.free), count) else None


def static_rest(
    mechanism: Mechanism,
    system: System,
    displacements: Poses,
    lowest: NaturalModes,
    forces: Float[Array, "free rights"],
) -> Float[Array, "free rights"]:
    """Compute the static response of all modes but the lowest ones; rad, m, m."""
    units, layout = _units(mechanism, system), system.layout
    assert layout is not None
    scaled = ScaledStiffness(system.factored_stiffness(displacements), units, layout)
    vectors, rights = lowest.shapes / units[:, None], units[:, None] * forces
    zero = jnp.zeros(forces.shape[1])
    return units[:, None] * response(scaled, vectors, zero, rights)


def _units(mechanism: Mechanism, system: System) -> Float[Array, " free"]:
    """Return the reciprocal square roots of the inertia."""
    return 1 / jnp.sqrt(mechanism.inertia().reshape(-1)[system.free])


def _natural_modes(
    root: Float[Array, "modes modes"],
    shapes: Float[Array, "free modes"],
    stiffness: FactoredStiffness | Stiffness,
) -> NaturalModes:
    """Decide which modes are unstable."""
    constant, moved = stop_gradient((stiffness, shapes))
    errors, angular = constant.rounding_errors(moved), jnp.diagonal(root)
    return NaturalModes(angular, shapes, (angular < 0) & (angular**2 > errors))


class ScaledStiffness(eqx.Module):
    """Stiffness of many bodies, in units in which their inertia is one."""

    stiffness: FactoredStiffness
    units: Float[Array, " free"]  # Reciprocal square roots of the inertia
    layout: Layout = eqx.field(static=True)

    def diagonal(self) -> Float[Array, " free"]:
        return self.layout.diagonal(self._blocks())

    def times(
        self, vectors: Float[Array, "free vectors"]
    ) -> Float[Array, "free vectors"]:
        units = self.units[:, None]
        return units * self.stiffness.times(units * vectors)

    def gram(
        self, vectors: Float[Array, "free vectors"]
    ) -> Float[Array, "vectors vectors"]:
        return self.stiffness.gram(self.units[:, None] * vectors)

    def inverse(self, shift: Scalar) -> BlockInverses:
        shifts = shift * jnp.eye(self.layout.size)[None]
        return BlockInverses.of(self._blocks().at[0].add(shifts), self.layout)

    def _blocks(self) -> Float[Array, "3 blocks size size"]:
        """Arrange the scaled stiffness in blocks on, below, and above the diagonal."""
        return self.layout.scaled(self.stiffness.blocks(self.layout), self.units)
