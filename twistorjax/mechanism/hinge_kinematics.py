"""Kinematics of a hinge: its displacement as a function of those of its two bodies."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp

from .._utils.types import Scalar
from ..geometry import se2
from ..geometry.twistors import Displacement


Two = tuple[Scalar, Scalar]
Three = tuple[Scalar, Scalar, Scalar]
Four = tuple[Scalar, Scalar, Scalar, Scalar]
Six = tuple[Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]


class End(NamedTuple):
    """One end of a hinge: the displacement of its body, and its position on the body.

    Displacements are measured from the reference pose, because differences of positions
    would lose digits if displacements are small compared with positions.

    Args:
        angle: Rotation of the body; rad.
        x: Displacement of the origin of the body along x; m.
        y: Displacement of the origin of the body along y; m.
        cos: Cosine of half the rotation.
        sin: Sine of half the rotation.
        arm_x: Distance along x from the origin of the body to the hinge, in the reference
            configuration; m.
        arm_y: The same along y; m.
    """

    angle: Scalar
    x: Scalar
    y: Scalar
    cos: Scalar
    sin: Scalar
    arm_x: Scalar
    arm_y: Scalar

    def arm_displacement(self) -> tuple[Scalar, Scalar]:
        """Compute the displacement of the hinge due to the rotation: (R - 1) arm; m."""
        return se2.rotation_displacement((self.arm_x, self.arm_y), self.cos, self.sin)


class MidFrame(NamedTuple):
    """The displacement of a hinge, and its mid-frame.

    Args:
        displacement: Displacement of frame b relative to frame a.
        cos: Cosine of the angle of the mid-frame in the world.
        sin: Sine of the angle of the mid-frame in the world.
    """

    displacement: Displacement
    cos: Scalar
    sin: Scalar


def mid_frame(first: End, second: End, axis: tuple[Scalar, Scalar]) -> MidFrame:
    """Compute the displacement and the mid-frame of a hinge.

    They follow from the cosines and sines of half angles, without other trigonometric
    functions. `axis` is the cosine and the sine of the angle of the hinge in the
    reference configuration.
    """
    arm_ax, arm_ay = first.arm_displacement()
    arm_bx, arm_by = second.arm_displacement()
    dx = (second.x - first.x) + (arm_bx - arm_ax)
    dy = (second.y - first.y) + (arm_by - arm_ay)
    sigma = second.cos * first.cos + second.sin * first.sin
    xi = second.sin * first.cos - second.cos * first.sin
    mean_cos = second.cos * first.cos - second.sin * first.sin
    mean_sin = second.sin * first.cos + second.cos * first.sin
    cos = mean_cos * axis[0] - mean_sin * axis[1]
    sin = mean_sin * axis[0] + mean_cos * axis[1]
    x1, x2 = (cos * dx + sin * dy) / 2, (cos * dy - sin * dx) / 2
    displacement = Displacement(second.angle - first.angle, sigma, xi, x1, x2)
    return MidFrame(displacement, cos, sin)


class HingeKinematics(NamedTuple):
    """Derivatives of the coordinates of a hinge with respect to those of its bodies.

    The coordinates are the relative angle and the translation (y1, y2) in the mid-frame.
    They depend on the translations of the bodies only through their difference, so there
    are four motions instead of six displacements: rotation of A, rotation of B, and
    translation of B relative to A along x and along y.

    Args:
        middle: Displacement and mid-frame of the hinge.
        a1: Distance from the origin of body A to the hinge along axis 1 of the mid-frame;
            m.
        a2: The same along axis 2; m.
        b1: Distance from the origin of body B to the hinge along axis 1; m.
        b2: The same along axis 2; m.
    """

    middle: MidFrame
    a1: Scalar
    a2: Scalar
    b1: Scalar
    b2: Scalar

    @classmethod
    def of(
        cls, first: End, second: End, axis: tuple[Scalar, Scalar]
    ) -> "HingeKinematics":
        """Compute the kinematics of a hinge from its two ends; see `mid_frame`."""
        middle = mid_frame(first, second, axis)
        arms = []
        for end in (first, second):
            change_x, change_y = end.arm_displacement()
            x, y = end.arm_x + change_x, end.arm_y + change_y
            arms += [middle.cos * x + middle.sin * y, middle.cos * y - middle.sin * x]
        return cls(middle, *arms)

    def columns(self) -> tuple[Three, Three, Three, Three]:
        """Compute the derivatives of the coordinates with respect to the motions."""
        c, s = self.middle.cos, self.middle.sin
        half_y1, half_y2 = self.middle.displacement.x1, self.middle.displacement.x2
        one, zero = jnp.ones_like(c), jnp.zeros_like(c)
        return (
            (-one, half_y2 + self.a2, -half_y1 - self.a1),
            (one, half_y2 - self.b2, -half_y1 + self.b1),
            (zero, c, -s),
            (zero, s, c),
        )

    def rates(self, first: Three, second: Three) -> Three:
        """Compute the rates of the coordinates from the rates of (angle, x, y)."""
        motions = first[0], second[0], second[1] - first[1], second[2] - first[2]
        return combine(self.columns(), motions)

    def geometric_stiffness(self, slopes: Three) -> list[list[Scalar]]:
        """Compute the second derivatives of the coordinates times given forces.

        `slopes` are the derivatives of the energy with respect to the coordinates; N m,
        N, N. The result is the stiffness with respect to the motions; N m/rad, N/rad.
        """
        _, g1, g2 = slopes
        c, s = self.middle.cos, self.middle.sin
        x, y = c * g1 - s * g2, s * g1 + c * g2  # the force in world axes
        at = self.middle.displacement
        same = -(g1 * at.x1 + g2 * at.x2) / 2
        mixed = same + (g1 * (self.b1 - self.a1) + g2 * (self.b2 - self.a2)) / 2
        zero = jnp.zeros_like(same)
        return [
            [same, mixed, -y / 2, x / 2],
            [mixed, same, -y / 2, x / 2],
            [-y / 2, -y / 2, zero, zero],
            [x / 2, x / 2, zero, zero],
        ]

    def rate_columns(
        self, rates: Three, mean: Scalar
    ) -> tuple[Three, Three, Three, Three]:
        """Differentiate the `rates` (rad/s, m/s, m/s) with respect to the motions.

        `mean` is the mean angular velocity of the two bodies; rad/s.
        """
        c, s = self.middle.cos, self.middle.sin
        rotation, along, across = (rate / 2 for rate in rates)
        zero = jnp.zeros_like(c)
        return (
            (zero, across - rotation * self.a1, -along - rotation * self.a2),
            (zero, across - rotation * self.b1, -along - rotation * self.b2),
            (zero, -mean * s, -mean * c),
            (zero, mean * c, -mean * s),
        )


def combine(columns: Sequence[Three], weights: Sequence[Scalar]) -> Three:
    """Multiply a matrix, given by its columns, and a vector."""
    total = [weights[0] * entry for entry in columns[0]]
    for column, weight in zip(columns[1:], weights[1:], strict=True):
        total = [old + weight * entry for old, entry in zip(total, column, strict=True)]
    return total[0], total[1], total[2]
