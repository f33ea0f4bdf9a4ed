"""Kinematics of a hinge: its displacement as a function of those of its two bodies."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._utils.host import as_float, on_host
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
    """

    angle: Scalar  # Rotation of the body; rad
    x: Scalar  # Displacement of the origin of the body along x; m
    y: Scalar  # Displacement of the origin of the body along y; m
    cos: Scalar  # Cosine of half the rotation
    sin: Scalar  # Sine of half the rotation
    # Distance along x from the origin of the body to the hinge, in the reference
    # configuration; m
    arm_x: Scalar
    arm_y: Scalar  # The same along y; m

    def arm_displacement(self) -> tuple[Scalar, Scalar]:
        """Compute the displacement of the hinge due to the rotation: (R - 1) arm; m."""
        return se2.rotation_displacement((self.arm_x, self.arm_y), self.cos, self.sin)


class Misfit(NamedTuple):
    """The displacement of frame b relative to frame a at which a hinge is not loaded.

    At a rotation theta of frame b, the translation in the mid-frame is measured from
    `cos(theta / 2) e + sin(theta / 2) f`.
    """

    angle: Scalar  # Rotation at which the hinge is not loaded; rad
    cos: Scalar  # Cosine of half this rotation
    sin: Scalar  # Sine of half this rotation
    e1: Scalar  # Component of e along axis 1; m
    e2: Scalar  # Component of e along axis 2; m
    f1: Scalar  # Component of f along axis 1; m
    f2: Scalar  # Component of f along axis 2; m
    # Rotation of the ends due to natural curvature, which is not a part of the
    # displacement; see `NaturallyCurved`; rad
    turn: Scalar

    @classmethod
    def of(cls, numbers: Float[Array, "*hinges 6"]) -> "Misfit":
        """Create a misfit from six numbers, to which further misfits may be added.

        The numbers are the rotation (rad) and the mid-frame translation (m, m) of the
        misfit; the distance (m, m) along both axes from the point of body A that the
        misfit belongs to, to that of body B, in the reference configuration; and the turn
        (rad). The frames of the hinge are halfway between these points.
        """
        angle, d1, d2, gap1, gap2, turn = jnp.moveaxis(numbers, -1, 0)
        cos, sin, tan = jnp.cos(angle / 2), jnp.sin(angle / 2), jnp.tan(angle / 4)
        return cls(angle, cos, sin, d1 - gap1, d2 - gap2, tan * d1, tan * d2, turn)

    @classmethod
    def with_rate(
        cls,
        numbers: Float[Array, "hinges 6"] | None,
        rates: Float[Array, "hinges 6"] | None,
    ) -> tuple["Misfit | None", "Misfit | None"]:
        """Create misfits and their time derivatives; None for those not given."""
        if numbers is None or rates is None:
            return None if numbers is None else cls.of(numbers), None
        return jax.jvp(cls.of, (numbers,), (rates,))


def misfit_numbers(poses: Float[Array, "*hinges 3"]) -> Float[Array, "*hinges 6"]:
    """Compute the six numbers of misfits, from displacements (angle, x, y); rad, m, m.

    The translations are resolved in the mid-frame.
    """
    xp, (known,) = on_host(poses)
    angle, x, y = xp.moveaxis(known, -1, 0)
    cos, sin, zero = xp.cos(angle / 2), xp.sin(angle / 2), 0 * angle
    along, across = cos * x + sin * y, cos * y - sin * x
    return as_float(xp.stack([angle, along, across, zero, zero, zero], axis=-1))


class Axis(NamedTuple):
    """Axis 1 of a hinge in the reference configuration, and the misfit of the hinge."""

    cos: Scalar  # Cosine of the angle of the axis
    sin: Scalar  # Sine of the angle of the axis
    misfit: Misfit | None = None  # The misfit, if any hinge of the mechanism has one
    misfit_rate: Misfit | None = None  # Its time derivative, if strokes change with time


class MidFrame(NamedTuple):
    """The displacement of a hinge, and its mid-frame."""

    # Displacement from the state in which the hinge is not loaded
    displacement: Displacement
    half: Two  # Half the translation of frame b relative to frame a, in the mid-frame; m
    cos: Scalar  # Cosine of the angle of the mid-frame in the world
    sin: Scalar  # Sine of the angle of the mid-frame in the world
    # Derivative of the translation of `displacement` with respect to the rotation, at a
    # constant translation of frame b; None without misfit; m/rad
    misfit_slope: Two | None = None
    # The second derivative; None without misfit; m/rad^2
    misfit_curvature: Two | None = None
    # Rates of the coordinates of the hinge, minus that of its turn, at constant poses of
    # its bodies; None if its misfit is constant; rad/s, m/s, m/s
    drift: Three | None = None
    # Derivative of the last two with respect to the rotation; m/(rad s)
    drift_slope: Two | None = None


def mid_frame(first: End, second: End, axis: Axis) -> MidFrame:
    """Compute the displacement and the mid-frame of a hinge.

    They follow from the cosines and sines of half angles, without other trigonometric
    functions.

    A misfit delta is divided among the two frames: the displacement is that between a
    displaced by delta^(1/2) and b displaced by delta^(-1/2), so that an exchange of the
    two bodies changes nothing. These two frames have the same mid-frame as a and b. With
    the rotation phi and the mid-frame translation d of delta, the displacement (theta, y)
    of b relative to a becomes (theta - phi, y - (cos(theta / 2) + tan(phi / 4)
    sin(theta / 2)) d).
    """
    arm_ax, arm_ay = first.arm_displacement()
    arm_bx, arm_by = second.arm_displacement()
    dx = (second.x - first.x) + (arm_bx - arm_ax)
    dy = (second.y - first.y) + (arm_by - arm_ay)
    sigma = second.cos * first.cos + second.sin * first.sin
    xi = second.sin * first.cos - second.cos * first.sin
    mean_cos = second.cos * first.cos - second.sin * first.sin
    mean_sin = second.sin * first.cos + second.cos * first.sin
    cos = mean_cos * axis.cos - mean_sin * axis.sin
    sin = mean_sin * axis.cos + mean_cos * axis.sin
    x1, x2 = (cos * dx + sin * dy) / 2, (cos * dy - sin * dx) / 2
    angle = second.angle - first.angle
    if axis.misfit is None:
        displacement = Displacement(angle, sigma, xi, x1, x2)
        return MidFrame(displacement, (x1, x2), cos, sin)
    angle_0, cos_0, sin_0, e1, e2, f1, f2, _ = axis.misfit
    free_1, free_2 = sigma * e1 + xi * f1, sigma * e2 + xi * f2
    displacement = Displacement(
        angle - angle_0,
        sigma * cos_0 + xi * sin_0,
        xi * cos_0 - sigma * sin_0,
        x1 - free_1 / 2,
        x2 - free_2 / 2,
    )
    misfit_slope = (xi * e1 - sigma * f1) / 2, (xi * e2 - sigma * f2) / 2
    misfit_curvature = free_1 / 4, free_2 / 4
    drift = drift_slope = None
    if axis.misfit_rate is not None:
        rate, _, _, e1, e2, f1, f2, turn_rate = axis.misfit_rate
        drift = -rate - turn_rate, -sigma * e1 - xi * f1, -sigma * e2 - xi * f2
        drift_slope = (xi * e1 - sigma * f1) / 2, (xi * e2 - sigma * f2) / 2
    return MidFrame(
        displacement,
        (x1, x2),
        cos,
        sin,
        misfit_slope,
        misfit_curvature,
        drift,
        drift_slope,
    )


class HingeKinematics(NamedTuple):
    """Derivatives of the coordinates of a hinge with respect to those of its bodies.

    The coordinates are the relative angle and the translation (y1, y2) in the mid-frame.
    They depend on the translations of the bodies only through their difference, so four
    displacements replace the six: rotation of A, rotation of B, and translation of B
    relative to A along x and along y.
    """

    middle: MidFrame  # Displacement and mid-frame of the hinge
    # Distance from the origin of body A to the hinge along axis 1 of the mid-frame; m
    a1: Scalar
    a2: Scalar  # The same along axis 2; m
    b1: Scalar  # Distance from the origin of body B to the hinge along axis 1; m
    b2: Scalar  # The same along axis 2; m

    @classmethod
    def of(cls, first: End, second: End, axis: Axis) -> "HingeKinematics":
        """Compute the kinematics of a hinge from its two ends; see `mid_frame`."""
        middle = mid_frame(first, second, axis)
        arms = []
        for end in (first, second):
            change_x, change_y = end.arm_displacement()
            x, y = end.arm_x + change_x, end.arm_y + change_y
            arms += [middle.cos * x + middle.sin * y, middle.cos * y - middle.sin * x]
        return cls(middle, *arms)

    def columns(self) -> tuple[Three, Three, Three, Three]:
        """Compute the derivatives of the coordinates by the four displacements."""
        c, s = self.middle.cos, self.middle.sin
        half_y1, half_y2 = self.middle.half
        one, zero = jnp.ones_like(c), jnp.zeros_like(c)
        k1, k2 = self.middle.misfit_slope or (zero, zero)
        return (
            (-one, half_y2 + self.a2 - k1, -half_y1 - self.a1 - k2),
            (one, half_y2 - self.b2 + k1, -half_y1 + self.b1 + k2),
            (zero, c, -s),
            (zero, s, c),
        )

    def rates(self, first: Three, second: Three) -> Three:
        """Compute the rates of the coordinates from the rates of (angle, x, y).

        The misfit is taken as constant.
        """
        four = first[0], second[0], second[1] - first[1], second[2] - first[2]
        return combine(self.columns(), four)

    def with_drift(self, rates: Three) -> Three:
        """Add the rates that are due to the change of the misfit."""
        drift = self.middle.drift
        if drift is None:
            return rates
        return rates[0] + drift[0], rates[1] + drift[1], rates[2] + drift[2]

    def geometric_stiffness(self, forces: Three) -> list[list[Scalar]]:
        """Compute the second derivatives of the coordinates times given forces.

        `forces` are those on the coordinates: the derivatives of the energy; N m,
        N, N. The result is the stiffness against the four displacements; N m/rad, N/rad.
        """
        _, g1, g2 = forces
        c, s = self.middle.cos, self.middle.sin
        x, y = c * g1 - s * g2, s * g1 + c * g2  # the force in world axes
        half_y1, half_y2 = self.middle.half
        same = -(g1 * half_y1 + g2 * half_y2) / 2
        mixed = same + (g1 * (self.b1 - self.a1) + g2 * (self.b2 - self.a2)) / 2
        if self.middle.misfit_curvature is not None:
            of_misfit = (
                g1 * self.middle.misfit_curvature[0]
                + g2 * self.middle.misfit_curvature[1]
            )
            same, mixed = same + of_misfit, mixed - of_misfit
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
        """Differentiate the rates of the coordinates by the four displacements.

        `rates` are those at a constant misfit; rad/s, m/s, m/s. `mean` is the mean
        angular velocity of the two bodies; rad/s.
        """
        c, s = self.middle.cos, self.middle.sin
        zero = jnp.zeros_like(c)
        middle = self.middle
        (k1, k2), (p1, p2), (r1, r2) = (
            part or (zero, zero)
            for part in (middle.misfit_slope, middle.misfit_curvature, middle.drift_slope)
        )
        rotation, along, across = (rate / 2 for rate in rates)
        along, across = along - k1 * rotation, across - k2 * rotation
        p1, p2 = 2 * p1 * rotation + r1, 2 * p2 * rotation + r2
        return (
            (zero, across - rotation * self.a1 - p1, -along - rotation * self.a2 - p2),
            (zero, across - rotation * self.b1 + p1, -along - rotation * self.b2 + p2),
            (zero, -mean * s, -mean * c),
            (zero, mean * c, -mean * s),
        )


def combine(columns: Sequence[Three], weights: Sequence[Scalar]) -> Three:
    """Multiply a matrix, given by its columns, and a vector."""
    total = [weights[0] * entry for entry in columns[0]]
    for column, weight in zip(columns[1:], weights[1:], strict=True):
        total = [old + weight * entry for old, entry in zip(total, column, strict=True)]
    return total[0], total[1], total[2]
