"""What a coupling dissipates as it moves: chapters 3 and 4 of the dissertation."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import ArrayLike, Float

from .._utils.types import Matrix, Pose, Scalar, Twist, Wrench
from .._utils.validation import require_choice
from ..geometry import se2
from ..geometry.twistors import Displacement
from .strains import Coordinates, half_square, matrix_error, strain


class ViscousDamping(eqx.Module):
    """What a coupling dissipates: half the damping times the square of the strain rate.

    Args:
        damping: symmetric, with no negative eigenvalue, ordered as a stiffness is;
            N m s/rad, N s/rad, N s/m.
        coordinates: whose rates the damping multiplies: the "twistor" strain's
            `2 (xi, x1, x2)` or the "twist"'s. The dissertation uses the twistor's in both
            of its chapters, even beside the energy of the twist (equation 3.64 is 4.42).
        resisted: whether only those rates count that the energy of its hinge resists. A
            flexure whose ends come nearer as it bends is not stretched by that: damped
            as if it were, it would lose a hundred times as much.

    Raises:
        ValueError: as for the stiffness of a `Quadratic`.

    Source:
        Equations 3.62 to 3.64 and 4.40 to 4.42 of the dissertation.
    """

    damping: Matrix
    coordinates: Coordinates = eqx.field(static=True)
    resisted: bool = eqx.field(static=True)

    def __init__(
        self,
        damping: Float[ArrayLike, "3 3"],
        coordinates: Coordinates = "twistor",
        *,
        resisted: bool = False,
    ):
        self.resisted = resisted
        self.damping = jnp.asarray(damping, float)
        self.coordinates = require_choice(
            "`coordinates`", coordinates, ("twistor", "twist")
        )
        if fault := matrix_error("damping", self.damping):
            raise ValueError(f"A `ViscousDamping` damping cannot be made: {fault}")

    def __call__(self, pose: Pose, rate: Pose) -> Scalar:
        """Half the power dissipated at a pose that changes at a rate; W."""

        def measure(pose: Pose) -> Twist:
            return jnp.stack(strain(Displacement.of(pose), self.coordinates))

        _, strain_rate = jax.jvp(measure, (pose,), (rate,))
        return half_square(self.damping, tuple(strain_rate))

    def wrench(self, pose: Pose, first: Twist, second: Twist) -> Wrench:
        """The viscous wrench that body B exerts on the coupling, about b, in its axes.

        The derivative of half the dissipated power by the velocity of b.

        Args:
            pose: frame b seen from frame a; rad, m, m.
            first: velocity of frame a, in its own axes; rad/s, m/s, m/s.
            second: velocity of frame b, in its own axes; rad/s, m/s, m/s.

        Example:
            >>> still, spin = jnp.zeros(3), jnp.array([2.0, 0.0, 0.0])
            >>> ViscousDamping(3.0 * jnp.eye(3)).wrench(jnp.zeros(3), still, spin)
            Array([6., 0., 0.], dtype=float64)
        """

        def dissipated(velocity: Twist) -> Scalar:
            turning = velocity[0] - first[0]
            lever = jnp.stack([-pose[2], pose[1]])
            drift = se2._turn(pose[0], velocity[1:]) - first[1:] - first[0] * lever
            return self(pose, jnp.concatenate([turning[None], drift]))

        return jax.grad(dissipated)(second)
