"""Displacements of the plane as twistors: the Clifford parameters and their algebra.

A twistor `(sigma, xi, x1, x2)` is the multivector
`sigma + xi e1e2 + x1 e1e + x2 e2e` of the plane's homogeneous model, in which `e` is the
point at infinity and `e e = 0`. It sees a displacement from the frame half way along it,
so that both ends of a hinge see the same one but for its sign. Sections 2.1.5, 2.7 and
2.8 of the dissertation.

Points are moved by the sandwich `q* x q`. With the printed `e . e* = 1` (equation 2.24)
that turns them forwards but shifts them backwards; with `e . e* = -1`, and points
`x + x x e / 2 + e*`, it does both as said. Products of twistors know `e` by `e e = 0`
alone, so nothing else changes. (Equation 2.156 leaves the sign of a translation as it is
in the conjugate, which hides this, but then `q* q` is not one.)

Two of its printed products are in the wrong order: with points moved by `q* x q`, the
displacement done first stands on the left. Equations 2.159 and 2.160 have it on the
right; evaluated as they stand they give `... + 0 e1e + 2 e2e` and
`... + sqrt(3) e1e - e2e`, not the value `... + sqrt(3) e1e + e2e` printed after them,
which the other order does give.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from .._utils.types import Point, Pose, Scalar, Twist, Twistor
from . import se2


def twistor(pose: Pose) -> Twistor:
    """The Clifford parameters of a displacement.

    Args:
        pose: the second frame seen from the first; rad, m, m. The angle may exceed a
            turn: twistors repeat only after two.

    Returns:
        `(cos(angle / 2), sin(angle / 2), x1, x2)` with half the translation, resolved
        in the frame half way; -, -, m, m.

    Source:
        Equations 2.124 and 2.129 to 2.135 of the dissertation; its section 2.7.4 is the
        example.

    Example:
        >>> twistor(jnp.array([jnp.pi / 3, 2.0, 2 * jnp.sqrt(3)]))
        Array([0.8660254 , 0.5       , 1.73205081, 1.        ], dtype=float64)
    """
    half = pose[0] / 2
    cos, sin = jnp.cos(half), jnp.sin(half)
    x, y = pose[1] / 2, pose[2] / 2
    return jnp.stack([cos, sin, cos * x + sin * y, cos * y - sin * x])


def pose(twistor: Twistor) -> Pose:
    """The pose that a twistor stands for.

    Args:
        twistor: of unit norm, as every displacement's is; -, -, m, m.

    Returns:
        The pose; its angle is that between minus and plus a full turn of which `sigma`
        and `xi` are cosine and sine of the half.

    Source:
        Equations 2.171 and 2.172 of the dissertation.

    Example:
        >>> pose(jnp.array([0.0, 1.0, 0.5, 0.0]))  # half a turn
        Array([3.14159265, 0.        , 1.        ], dtype=float64)
    """
    sigma, xi, x1, x2 = twistor
    x, y = 2 * (sigma * x1 - xi * x2), 2 * (sigma * x2 + xi * x1)
    return jnp.stack([2 * jnp.arctan2(xi, sigma), x, y])


def product(first: Twistor, second: Twistor) -> Twistor:
    """The geometric product: two displacements in a row, each in the fixed axes.

    The displacement done first stands on the left, so that
    `twistor(se2.compose(outer, inner))` is `product(twistor(inner), twistor(outer))`.

    Example:
        >>> shift, turn = jnp.array([[1.0, 0, 2, 0], [jnp.sqrt(0.75), 0.5, 0, 0]])
        >>> product(shift, turn)  # section 2.7.4, the second way
        Array([0.8660254 , 0.5       , 1.73205081, 1.        ], dtype=float64)
    """
    a, b, a1, a2 = first
    c, d, c1, c2 = second
    return jnp.stack(
        [
            a * c - b * d,
            a * d + b * c,
            a * c1 + a1 * c + b * c2 - a2 * d,
            a * c2 + a2 * c - b * c1 + a1 * d,
        ]
    )


def conjugate(twistor: Twistor) -> Twistor:
    """The displacement back: its product with the twistor is one.

    Example:
        >>> there = jnp.array([0.6, 0.8, 1.0, 2.0])
        >>> product(there, conjugate(there))
        Array([1., 0., 0., 0.], dtype=float64)
    """
    return twistor * jnp.array([1.0, -1.0, -1.0, -1.0])


def move(twistor: Twistor, point: Point) -> Point:
    """Where a displacement takes a point: the sandwich `q* x q`.

    Args:
        twistor: of unit norm; -, -, m, m.
        point: in the fixed axes; m.

    Source:
        Equations 2.151 to 2.157 of the dissertation.

    Example:
        >>> move(jnp.array([jnp.sqrt(0.75), 0.5, 0.0, 0.0]), jnp.array([1.0, 0.0]))
        Array([0.5      , 0.8660254], dtype=float64)
    """
    sigma, xi, x1, x2 = twistor
    # the right factor first: the vector part of x q, half way there
    half_x = sigma * point[0] - xi * point[1] + x1
    half_y = sigma * point[1] + xi * point[0] + x2
    # and then the conjugate, for the second half
    x = sigma * half_x - xi * half_y + sigma * x1 - xi * x2
    y = sigma * half_y + xi * half_x + sigma * x2 + xi * x1
    return jnp.stack([x, y])


class Displacement(eqx.Module):
    """A relative displacement as an energy sees it: its angle, and its twistor.

    The angle is kept beside the twistor because energies of the twist need it, and
    because it counts turns.

    Args:
        angle: of the second frame against the first; rad.
        sigma: cosine of the half angle.
        xi: sine of the half angle.
        x1: half the translation along axis 1 of the frame half way; m.
        x2: half the translation along axis 2 of the frame half way; m.
    """

    angle: Scalar
    sigma: Scalar
    xi: Scalar
    x1: Scalar
    x2: Scalar

    @classmethod
    def of(cls, pose: Pose) -> "Displacement":
        """The displacement that a pose stands for."""
        return cls(pose[0], *twistor(pose))

    def strain(self) -> Twist:
        """Twice the vector part of the twistor, which near rest is the twist."""
        return jnp.stack([2 * self.xi, 2 * self.x1, 2 * self.x2])

    def twist(self) -> Twist:
        """The constant twist that reaches the displacement; see `se2.twist`."""
        stretch = 2 / se2.sinc(self.angle / 2, self.xi)
        return jnp.stack([self.angle, stretch * self.x1, stretch * self.x2])


@jax.custom_jvp
def half_turn(angle: Scalar, cos: Scalar, sin: Scalar) -> tuple[Scalar, Scalar]:
    """Cosine and sine of half an angle, which are known already, as its functions.

    For derivatives of any order without a sine or cosine being computed again: products
    of twistors need none, and on a processor they are the costly part of a hinge.
    """
    del angle
    return cos, sin


@half_turn.defjvp
def _(primals, tangents):
    cos, sin = half_turn(*primals)
    rate = tangents[0] / 2
    return (cos, sin), (-sin * rate, cos * rate)
