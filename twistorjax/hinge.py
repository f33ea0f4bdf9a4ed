"""One elastic coupling between two bodies, and how it pulls on both."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import ArrayLike, Float

from ._checks import row, text
from ._types import Corners, Pose, Scalar
from .clifford import Displacement, half_turn
from .energy import AbstractEnergy


class Hinge(eqx.Module):
    """An elastic coupling between a frame on one body and a frame on another.

    Give the place of the hinge either once, as it stands in the world when nothing is
    loaded, or as the two frames in which it grips its bodies.

    Args:
        name: by which answers call it.
        first: name of body A, on which frame a sits.
        second: name of body B, on which frame b sits.
        energy: what it stores at a displacement of b against a.
        at: both frames at rest, in the world; rad, m, m. Axis 1 of a leaf or a notch
            lies along it and leads from the first body to the second: from base to table
            upwards its angle is pi / 2.
        ports: frame a in the frame of body A, and b in that of B; rad, m, m.
        outline: a closed polygon in the frame of the hinge, for drawing; m.

    Raises:
        ValueError: both or neither of `at` and `ports` are given; a hinge joins a body
            to itself; a shape is wrong or a value not finite.
    """

    name: str = eqx.field(static=True)
    first: str = eqx.field(static=True)
    second: str = eqx.field(static=True)
    energy: AbstractEnergy
    at: Pose | None
    ports: tuple[Pose, Pose] | None
    outline: Corners | None

    def __init__(
        self,
        name: str,
        first: str,
        second: str,
        energy: AbstractEnergy,
        at: Float[ArrayLike, "3"] | Sequence[ArrayLike] | None = None,
        *,
        ports: Sequence[Float[ArrayLike, "3"] | Sequence[ArrayLike]] | None = None,
        outline: Float[ArrayLike, "corners 2"] | None = None,
    ):
        self.name = text("The name of a hinge", name)
        self.first = text(f"`first` of the hinge {name!r}", first)
        self.second = text(f"`second` of the hinge {name!r}", second)
        if not isinstance(energy, AbstractEnergy):
            raise ValueError(
                f"`energy` of the hinge {name!r} is a {type(energy).__name__}, but must "
                "be an energy: `Quadratic(stiffness)`, `leaf(...)`, `notch(...)`."
            )
        self.energy = energy
        if first == second:
            raise ValueError(f"The hinge {name!r} joins the body {first!r} to itself.")
        if (at is None) == (ports is None):
            raise ValueError(
                f"The hinge {name!r} needs either `at`, its frame in the world at rest, "
                "or `ports`, its frames in both bodies: "
                + ("neither is given." if at is None else "both are given.")
            )
        place = f"of the hinge {name!r}"
        self.at = None if at is None else row(f"`at` {place}", at, "(angle, x, y)")
        if ports is None:
            self.ports = None
        else:
            in_first, in_second = (
                row(f"`ports[{k}]` {place}", port, "(angle, x, y)")
                for k, port in enumerate(ports)
            )
            self.ports = in_first, in_second
        self.outline = None if outline is None else jnp.asarray(outline, float)


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
        versine, sine = 2 * self.sin * self.sin, 2 * self.sin * self.cos
        return (
            -versine * self.arm_x - sine * self.arm_y,
            sine * self.arm_x - versine * self.arm_y,
        )


class Halfway(NamedTuple):
    """A displacement, and the frame half way along it, in the world."""

    displacement: Displacement
    cos: Scalar  # of that frame's angle
    sin: Scalar


def halfway(first: End, second: End, axis: tuple[Scalar, Scalar]) -> Halfway:
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
    return Halfway(displacement, cos, sin)


Three = tuple[Scalar, Scalar, Scalar]
Six = tuple[Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]


@jax.jit
def forces(
    energy: AbstractEnergy, first: End, second: End, axis: tuple[Scalar, Scalar]
) -> Six:
    """Derivative of a hinge's energy by the displacements of body A and of body B.

    The energy is differentiated by JAX in its own three coordinates. How these follow
    from the bodies' six is written out, here and in `tangent`: by JAX it takes twice the
    time to compile and 1.5 to 2 times the time to run a sweep of stages.
    """
    half = halfway(first, second, axis)
    slope, _ = _slopes(energy, half.displacement)
    return _pull(first, second, half, slope)


@jax.jit
def tension(
    energy: AbstractEnergy, first: End, second: End, axis: tuple[Scalar, Scalar]
) -> Three:
    """What the hinge bears: its energy's slopes by the energy's own coordinates."""
    half = halfway(first, second, axis)
    (g0, g1, g2), _ = _slopes(energy, half.displacement)
    longer, growth, _ = _stretch(energy, half.displacement)
    s1, s2 = g1 / longer, g2 / longer
    y1, y2 = 2 * half.displacement.x1, 2 * half.displacement.x2
    return g0 - growth * (y1 * s1 + y2 * s2), s1, s2


@jax.jit
def tangent(
    energy: AbstractEnergy,
    first: End,
    second: End,
    axis: tuple[Scalar, Scalar],
    borne: Three | None = None,
) -> tuple[Six, tuple[Six, Six, Six, Six, Six, Six], Scalar]:
    """The `forces`, their derivatives by the same six displacements, and their work.

    The work is a measure of the energy at play, never negative: sizes of slopes times
    sizes of what they are slopes by.

    Args:
        energy: of the hinge.
        first: its end on body A.
        second: its end on body B.
        axis: cosine and sine of its angle at rest.
        borne: the `tension` with which it stiffens as it turns, by default its own.
            Newton's method foresees it from its last step, and is then as fast for stiff
            hinges as for soft ones (Magisano, Leonetti and Garcea, Int. J. Num. Meth.
            Eng. 109, 2017).
    """
    half = halfway(first, second, axis)
    slopes, push = _slopes(energy, half.displacement)
    g0, g1, g2 = slopes
    one, zero = jnp.ones_like(g0), jnp.zeros_like(g0)
    (h00, h01, h02), (_, h11, h12), (_, _, h22) = (
        push(one, zero, zero),
        push(zero, one, zero),
        push(zero, zero, one),
    )
    c, s = half.cos, half.sin
    y1, y2 = 2 * half.displacement.x1, 2 * half.displacement.x2
    work = jnp.abs(g0 * half.displacement.angle) + jnp.abs(g1 * y1) + jnp.abs(g2 * y2)
    if borne is not None:
        # The slopes, and what the bend of the energy's own coordinates adds to the second
        # derivatives, by the tension foreseen instead of by that which it has.
        longer, growth, bend = _stretch(energy, half.displacement)
        b0, b1, b2 = borne
        over1, over2 = b1 - g1 / longer, b2 - g2 / longer
        h00 = h00 + bend * (y1 * over1 + y2 * over2)
        h01, h02 = h01 + growth * over1, h02 + growth * over2
        g0, g1, g2 = b0 + growth * (y1 * b1 + y2 * b2), longer * b1, longer * b2

    # The energy by (relative angle r, mean angle m, dx, dy), the difference of the ports'
    # positions in the world: turning the mean frame turns (y1, y2) backwards.
    fx, fy = c * g1 - s * g2, s * g1 + c * g2
    m0, m1, m2 = h01 * y2 - h02 * y1, h11 * y2 - h12 * y1, h12 * y2 - h22 * y1
    mm = m1 * y2 - m2 * y1 - g1 * y1 - g2 * y2
    rx, ry = c * h01 - s * h02, s * h01 + c * h02
    mx, my = c * (m1 - g2) - s * (m2 + g1), s * (m1 - g2) + c * (m2 + g1)
    cc, ss, cs = c * c, s * s, c * s
    xx = cc * h11 + ss * h22 - 2 * cs * h12
    yy = ss * h11 + cc * h22 + 2 * cs * h12
    xy = cs * (h11 - h22) + (cc - ss) * h12

    def turned(end: End, sign: int):
        # Turning one body by an angle changes r by -+1, m by 1/2, and (dx, dy) by the
        # hinge's sideways swing about the body's origin.
        turn_x, turn_y = end.turn()
        lever_x, lever_y = end.arm_x + turn_x, end.arm_y + turn_y
        swing_x, swing_y = -sign * lever_y, sign * lever_x
        by_r = sign * h00 + m0 / 2 + rx * swing_x + ry * swing_y
        by_m = sign * m0 + mm / 2 + mx * swing_x + my * swing_y
        by_x = sign * rx + mx / 2 + xx * swing_x + xy * swing_y
        by_y = sign * ry + my / 2 + xy * swing_x + yy * swing_y
        bend = -sign * (fx * lever_x + fy * lever_y)  # the swing's own turning
        return by_r, by_m, by_x, by_y, swing_x, swing_y, bend

    ar, am, ax, ay, swing_ax, swing_ay, bend_a = turned(first, -1)
    br, bm, bx, by, swing_bx, swing_by, bend_b = turned(second, 1)
    aa = -ar + am / 2 + ax * swing_ax + ay * swing_ay + bend_a
    ab = ar + am / 2 + ax * swing_bx + ay * swing_by
    bb = br + bm / 2 + bx * swing_bx + by * swing_by + bend_b
    pairs = (
        (aa, -ax, -ay, ab, ax, ay),
        (-ax, xx, xy, -bx, -xx, -xy),
        (-ay, xy, yy, -by, -xy, -yy),
        (ab, -bx, -by, bb, bx, by),
        (ax, -xx, -xy, bx, xx, xy),
        (ay, -xy, -yy, by, xy, yy),
    )
    return _pull(first, second, half, slopes), pairs, work


def _slopes(
    energy: AbstractEnergy, at: Displacement
) -> tuple[Three, Callable[..., Three]]:
    """The energy's derivatives by the angle and the half-way translation, linearised."""

    def stored(angle: Scalar, y1: Scalar, y2: Scalar) -> Scalar:
        cos, sin = half_turn(angle, at.sigma, at.xi)
        return energy.stored(Displacement(angle, cos, sin, y1 / 2, y2 / 2))

    return jax.linearize(
        jax.grad(stored, argnums=(0, 1, 2)), at.angle, 2 * at.x1, 2 * at.x2
    )


def _stretch(energy: AbstractEnergy, at: Displacement) -> Three:
    """The energy's stretch, and its first two derivatives by the angle."""

    def stretch(angle: Scalar) -> Scalar:
        cos, sin = half_turn(angle, at.sigma, at.xi)
        return energy.stretch(Displacement(angle, cos, sin, at.x1, at.x2))

    def growing(angle: Scalar) -> tuple[Scalar, Scalar]:
        return jax.jvp(stretch, (angle,), (jnp.ones_like(angle),))

    (value, slope), (_, bend) = jax.jvp(growing, (at.angle,), (jnp.ones_like(at.angle),))
    return value, slope, bend


def _pull(first: End, second: End, half: Halfway, slope: Three) -> Six:
    g0, g1, g2 = slope
    mean = half.displacement.x2 * g1 - half.displacement.x1 * g2
    fx, fy = half.cos * g1 - half.sin * g2, half.sin * g1 + half.cos * g2
    (turn_ax, turn_ay), (turn_bx, turn_by) = first.turn(), second.turn()
    lever_ax, lever_ay = first.arm_x + turn_ax, first.arm_y + turn_ay
    lever_bx, lever_by = second.arm_x + turn_bx, second.arm_y + turn_by
    on_first = mean - g0 + fx * lever_ay - fy * lever_ax
    on_second = mean + g0 - fx * lever_by + fy * lever_bx
    return on_first, -fx, -fy, on_second, fx, fy
