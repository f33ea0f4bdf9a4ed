"""Energy of a flexure that is curved without load, as by a temperature gradient."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._utils.types import Pose, Scalar
from ..geometry.twistors import Displacement
from .base import AbstractEnergy, AbstractWrapper, Stress


class NaturallyCurved(AbstractWrapper):
    """The energy of a flexure, to which a constant natural curvature is given.

    The energy of bending of a leaf is the integral of `E I (k - k0)^2 / 2` with the
    natural curvature k0, and the integral of its curvature k is the rotation of its ends.
    So k0 adds the term `-E I k0 angle`, at any displacement and axial force.
    """

    energy: AbstractEnergy  # The energy without natural curvature
    turn: Scalar  # Rotation of the ends of the free flexure, k0 times its length; rad
    # Loads by which the turn is prevented, divided by it; see `curvature_loads`
    loads: Float[Array, "4"]

    @property
    def is_unloaded(self) -> bool:
        return False

    def stored_energy(self, displacement: Displacement) -> Scalar:
        energy = self.energy.stored_energy(displacement)
        constant = self.turn**2 * self.loads[3] / 2  # The free flexure stores no energy.
        return energy - self.turn * self._work(displacement) + constant

    def newton_model(self, stress: Stress) -> AbstractEnergy:
        model = self.energy.newton_model(self.without_curvature(stress))
        return NaturallyCurved(model, self.turn, self.loads)

    def without_curvature(self, stress: Stress) -> Stress:
        """Return the stress of the energy without natural curvature; N m, N, N."""
        moment, axial, transverse = stress
        by_moment, by_axial, by_transverse, _ = self.turn * self.loads
        return moment + by_moment, axial + by_axial, transverse + by_transverse

    def slope_by_turn(self, displacement: Displacement) -> Scalar:
        """Differentiate the energy with respect to the turn; J/rad."""
        return self.turn * self.loads[3] - self._work(displacement)

    def _work(self, displacement: Displacement) -> Scalar:
        """Compute the work of the loads in a displacement, divided by the turn; J/rad."""
        by_moment, by_axial, by_transverse, _ = self.loads
        chord = by_axial * displacement.x1 + by_transverse * displacement.x2
        return by_moment * displacement.angle + 2 * chord


def curvature_loads(energy: AbstractEnergy, free: Float[Array, "3"]) -> Float[Array, "4"]:
    """Compute moment and forces that prevent a unit of natural turn, and their work.

    They follow from the stiffness in the reference configuration, without axial force.
    For a prismatic leaf, also if it is curved, they are the moment E I / L and no force.
    For other flexures they are exact to first order.

    `free` is the displacement of the free flexure, divided by its turn: 1, and the
    position of the centroid of its center line, turned by -90 degrees (m). The result has
    moment, axial force, and transverse force, divided by the turn, and their work in the
    displacement of the free flexure; N m/rad, N/rad, N/rad, J/rad^2.
    """

    def stored_energy(pose: Pose) -> Scalar:
        return energy.stored_energy(Displacement.from_pose(pose))

    # With `tangent_stiffness`, JAX confuses the axes of nested batches in derivatives
    # (0.10).
    _, stiffness_times = jax.linearize(jax.grad(stored_energy), jnp.zeros(3))
    loads = stiffness_times(free)
    return jnp.append(loads, jnp.sum(loads * free))
