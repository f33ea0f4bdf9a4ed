"""Viscous damping of a hinge (chapters 3 and 4 of the dissertation)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from typing_extensions import TypeAliasType

from .._utils.host import as_float
from .._utils.types import Matrix, MatrixLike, NumberLike, Pose, Scalar, Twist, Wrench
from .._utils.validation import require_choice
from ..geometry import se2
from ..geometry.twistors import Displacement
from .strains import Coordinates, half_square, matrix_error, strain


class ViscousDamping(eqx.Module):
    """Viscous damping of a hinge, a quadratic form of the strain rate.

    The damping is defined by Rayleigh's dissipation function, half the dissipated power:
    `rate . damping . rate / 2`.

    Args:
        damping: Symmetric matrix without negative eigenvalues. The order of rows and
            columns is rotation, axis 1, axis 2; N m s/rad, N s/rad, N s/m.
        coordinates: Strain whose rate is damped: "twistor" for `2 (xi, x1, x2)`, or
            "twist". The dissertation uses the twistor in both of its chapters, also
            together with energies of the twist (equation 3.64 equals 4.42).
        resisted: If True, the damping acts only on strain rates that the hinge's energy
            resists. The ends of a flexure approach each other when it bends, but this
            does not stretch the flexure. If it were damped as an axial strain, the
            flexure would dissipate about a hundred times as much.

    Raises:
        ValueError: The matrix is not 3 by 3, is not symmetric, has a negative eigenvalue
            or a value that is not finite; the coordinates are unknown.

    Source:
        Equations 3.62 to 3.64 and 4.40 to 4.42 of the dissertation.
    """

    damping: Matrix
    coordinates: Coordinates = eqx.field(static=True)
    resisted: bool = eqx.field(static=True)

    def __init__(
        self,
        damping: MatrixLike,
        coordinates: Coordinates = "twistor",
        *,
        resisted: bool = False,
    ):
        self.resisted = resisted
        self.damping = as_float(damping)
        self.coordinates = require_choice(
            "`coordinates`", coordinates, ("twistor", "twist")
        )
        if error := matrix_error("damping", self.damping):
            raise ValueError(f"A `ViscousDamping` cannot be created: {error}")

    def __call__(self, pose: Pose, rate: Pose) -> Scalar:
        """Compute the dissipation function, half the dissipated power.

        Returns:
            Half the dissipated power; W.
        """

        def strain_of(pose: Pose) -> Twist:
            return jnp.stack(strain(Displacement.from_pose(pose), self.coordinates))

        _, strain_rate = jax.jvp(strain_of, (pose,), (rate,))
        return half_square(self.damping, tuple(strain_rate))

    def wrench(self, pose: Pose, velocity_a: Twist, velocity_b: Twist) -> Wrench:
        """Compute the viscous wrench that body B exerts on the hinge.

        It is the derivative of the dissipation function with respect to the velocity of
        frame b.

        Args:
            pose: Pose of frame b relative to frame a; rad, m, m.
            velocity_a: Velocity of frame a, in its own axes; rad/s, m/s, m/s.
            velocity_b: Velocity of frame b, in its own axes; rad/s, m/s, m/s.

        Returns:
            The wrench about the origin of frame b, in the axes of b; N m, N, N.

        Example:
            >>> damper = ViscousDamping(3.0 * jnp.eye(3))
            >>> pose, velocity_a = jnp.zeros(3), jnp.zeros(3)
            >>> velocity_b = jnp.array([2.0, 0.0, 0.0])  # rad/s, m/s, m/s
            >>> damper.wrench(pose, velocity_a, velocity_b)
            Array([6., 0., 0.], dtype=float64)
        """

        def dissipation(velocity_b: Twist) -> Scalar:
            angular_rate = velocity_b[0] - velocity_a[0]
            lever = jnp.stack([-pose[2], pose[1]])
            linear_rate = (
                se2.rotate(pose[0], velocity_b[1:])
                - velocity_a[1:]
                - velocity_a[0] * lever
            )
            return self(pose, jnp.concatenate([angular_rate[None], linear_rate]))

        return jax.grad(dissipation)(velocity_b)


# Damping of a hinge, or the time by which its stiffness is multiplied (s)
DampingLike = TypeAliasType("DampingLike", ViscousDamping | NumberLike)
