"""Energy of a flexure that is curved without load, as by a temperature gradient."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._utils.types import Pose, Scalar
from ..geometry.twistors import Displacement
from .base import AbstractEnergy, AbstractWrapper
from .solver_protocols import newton_model, Stress


class NaturallyCurved(AbstractWrapper):
    """The energy of a straight flexure, to which a constant natural curvature is given.

    The energy of bending of a leaf is the integral of `E I (k - k0)^2 / 2` with the
    natural curvature k0, and the integral of its curvature k is the rotation of its ends.
    So k0 adds the term `-E I k0 angle`, at any displacement and axial force.

    Args:
        energy: The energy without natural curvature.
        turn: Rotation of the ends of the free flexure, k0 times its length; rad.
        loads: Moment and transverse force by which the turn is prevented, divided by it;
            see `curvature_loads`; N m/rad, N/rad.
    """

    energy: AbstractEnergy
    turn: Scalar
    loads: Float[Array, "2"]

    def stored_energy(self, displacement: Displacement) -> Scalar:
        energy = self.energy.stored_energy(displacement)
        constant = self.turn**2 * self.loads[0] / 2  # The free flexure stores no energy.
        return energy - self.turn * self._work(displacement) + constant

    def newton_model(self, stress: Stress) -> AbstractEnergy:
        model = newton_model(self.energy, self.without_curvature(stress))
        return NaturallyCurved(model, self.turn, self.loads)

    def without_curvature(self, stress: Stress) -> Stress:
        """Return the stress of the energy without natural curvature; N m, N, N."""
        moment, axial, transverse = stress
        by_moment, by_force = self.turn * self.loads
        return moment + by_moment, axial, transverse + by_force

    def slope_by_turn(self, displacement: Displacement) -> Scalar:
        """Differentiate the energy with respect to the turn; J/rad."""
        return self.turn * self.loads[0] - self._work(displacement)

    def _work(self, displacement: Displacement) -> Scalar:
        """Compute the work of the loads in a displacement, divided by the turn; J/rad."""
        by_moment, by_force = self.loads
        return by_moment * displacement.angle + by_force * 2 * displacement.x2


def curvature_loads(energy: AbstractEnergy) -> Float[Array, "2"]:
    """Compute moment and transverse force that prevent a unit of natural turn.

    They follow from the stiffness in the reference configuration, without axial force.
    The moment is E I / L for a prismatic leaf, also if it is curved. For other flexures
    the loads are exact to first order.

    Returns:
        The moment and the force, divided by the turn; N m/rad, N/rad.
    """

    def stored_energy(pose: Pose) -> Scalar:
        return energy.stored_energy(Displacement.from_pose(pose))

    # Only two rows of the stiffness are needed. With `tangent_stiffness`, JAX confuses
    # the axes of nested batches in derivatives (0.10).
    _, row_times = jax.linearize(jax.grad(stored_energy), jnp.zeros(3))
    by_turn = row_times(jnp.array([1.0, 0.0, 0.0]))
    by_stretch = row_times(jnp.array([0.0, 1.0, 0.0]))
    resists = by_stretch[1] > 0
    ratio = jnp.where(resists, by_turn[1] / jnp.where(resists, by_stretch[1], 1.0), 0.0)
    loads = by_turn - ratio * by_stretch
    return jnp.stack([loads[0], loads[2]])
