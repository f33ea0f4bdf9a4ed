"""How a hinge grips its two bodies, and how its displacement follows them."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp

from .._utils.types import Scalar
from ..geometry import se2
from ..geometry.twistors import Displacement


Two = tuple[Scalar, Scalar]
Three = tuple[Scalar, Scalar, Scalar]
Six = tuple[Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]
SixBySix = tuple[Six, Six, Six, Six, Six, Six]


class End(NamedTuple):
    """One end of a hinge: how far its body has moved, and where on the body it grips.

    Displacements are counted from rest, for which differences of positions would lose
    digits: a stage of 40 mm moves by micrometres.
    """

    angle: Scalar  # that the body has turned; rad
    x: Scalar  # that its origin has moved; m
    y: Scalar
    cos: Scalar  # of half the angle
    sin: Scalar
    arm_x: Scalar  # from the body's origin to the hinge, in world axes at rest; m
    arm_y: Scalar

    def turn(self) -> tuple[Scalar, Scalar]:
        """What the body's turning adds to the place of the hinge: (R - 1) arm."""
        return se2._swing((self.arm_x, self.arm_y), self.cos, self.sin)


class MidFrame(NamedTuple):
    """A displacement, and the frame half way along it, in the world."""

    displacement: Displacement
    cos: Scalar  # of that frame's angle
    sin: Scalar


def mid_frame(first: End, second: End, axis: tuple[Scalar, Scalar]) -> MidFrame:
    """The displacement of b against a, by products of half angles alone.

    Args:
        first: the end on body A.
        second: the end on body B.
        axis: cosine and sine of the hinge's angle at rest.
    """
    (turn_ax, turn_ay), (turn_bx, turn_by) = first.turn(), second.turn()
    dx = (second.x - first.x) + (turn_bx - turn_ax)
    dy = (second.y - first.y) + (turn_by - turn_ay)
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
    """How a hinge's coordinates follow its bodies.

    The coordinates are the relative angle and the translation (y1, y2) seen half way.
    Shifting body A is shifting body B backwards, so four motions of the six are told
    apart: turning A, turning B, and shifting B along x and along y.

    Args:
        half: where the hinge is.
        a1: from body A's origin to the hinge, in the axes half way; m.
        a2: the same, across.
        b1: from body B's origin to the hinge; m.
        b2: the same, across.
    """

    half: MidFrame
    a1: Scalar
    a2: Scalar
    b1: Scalar
    b2: Scalar

    @classmethod
    def of(
        cls, first: End, second: End, axis: tuple[Scalar, Scalar]
    ) -> "HingeKinematics":
        """The grip of a hinge on its two ends."""
        half = mid_frame(first, second, axis)
        levers = []
        for end in (first, second):
            turn_x, turn_y = end.turn()
            x, y = end.arm_x + turn_x, end.arm_y + turn_y
            levers += [half.cos * x + half.sin * y, half.cos * y - half.sin * x]
        return cls(half, *levers)

    def columns(self) -> tuple[Three, Three, Three, Three]:
        """The coordinates' derivatives by the four motions."""
        c, s = self.half.cos, self.half.sin
        y1, y2 = self.half.displacement.x1, self.half.displacement.x2  # halves
        one, zero = jnp.ones_like(c), jnp.zeros_like(c)
        return (
            (-one, y2 + self.a2, -y1 - self.a1),
            (one, y2 - self.b2, -y1 + self.b1),
            (zero, c, -s),
            (zero, s, c),
        )

    def rates(self, first: Three, second: Three) -> Three:
        """The coordinates' rates, for those of the bodies' (angle, x, y)."""
        motions = first[0], second[0], second[1] - first[1], second[2] - first[2]
        return combined(self.columns(), motions)

    def bend(self, slopes: Three) -> list[list[Scalar]]:
        """What slopes by the coordinates add to second derivatives by the motions."""
        _, g1, g2 = slopes
        c, s = self.half.cos, self.half.sin
        x, y = c * g1 - s * g2, s * g1 + c * g2  # the force, in the world
        own = -(g1 * self.half.displacement.x1 + g2 * self.half.displacement.x2) / 2
        mixed = own + (g1 * (self.b1 - self.a1) + g2 * (self.b2 - self.a2)) / 2
        zero = jnp.zeros_like(own)
        return [
            [own, mixed, -y / 2, x / 2],
            [mixed, own, -y / 2, x / 2],
            [-y / 2, -y / 2, zero, zero],
            [x / 2, x / 2, zero, zero],
        ]

    def turning(self, rates: Three, mean: Scalar) -> tuple[Three, Three, Three, Three]:
        """Derivatives of the `rates` by the four motions, the bodies' own rates kept.

        Args:
            rates: of the coordinates.
            mean: of the two bodies' rates of turning; rad/s.
        """
        c, s = self.half.cos, self.half.sin
        turn, along, across = (rate / 2 for rate in rates)
        zero = jnp.zeros_like(c)
        return (
            (zero, across - turn * self.a1, -along - turn * self.a2),
            (zero, across - turn * self.b1, -along - turn * self.b2),
            (zero, -mean * s, -mean * c),
            (zero, mean * c, -mean * s),
        )


def combined(columns: Sequence[Three], weights: Sequence[Scalar]) -> Three:
    """The columns of a matrix, times a vector."""
    total = [weights[0] * entry for entry in columns[0]]
    for column, weight in zip(columns[1:], weights[1:], strict=True):
        total = [old + weight * entry for old, entry in zip(total, column, strict=True)]
    return total[0], total[1], total[2]
