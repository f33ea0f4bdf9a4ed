"""Twistors: the Clifford parameters of planar displacements, and their algebra.

A twistor `(sigma, xi, x1, x2)` is the multivector
`sigma + xi e1e2 + x1 e1e + x2 e2e` of the homogeneous model of the plane. The vectors
`e1` and `e2` are the axes, `e*` represents the origin, and `e` represents the point at
infinity, with `e e = 0`. The translation is resolved in the mid-frame, which is halfway
between the two frames. If the two frames are exchanged, only the signs of
`(xi, x1, x2)` change. Sections 2.1.5, 2.7 and 2.8 of the dissertation.

A twistor `q` displaces a point `x` by the product `q* x q`, where `q*` is the conjugate
of `q`. In a product of two twistors, the left factor is therefore the displacement that
is applied first.

Errata of the dissertation:

* Equation 2.24: printed `e . e* = 1`; correct `e . e* = -1`. With the printed sign,
  `q* x q` translates points in the negative direction. Products of twistors depend on
  `e e = 0` only, so they do not change.
* Equation 2.40: printed `x - x x e / 2 + e*` for a point; correct
  `x + x x e / 2 + e*`, because of the sign in equation 2.24.
* Equation 2.156: printed `1 + Px / 2 e1e + Py / 2 e2e` for the conjugate of a
  translation by `(Px, Py)`; correct `1 - Px / 2 e1e - Py / 2 e2e`. With the printed
  signs, the product of the twistor and its conjugate is not 1.
* Equation 2.159: printed translation times rotation; correct rotation times translation,
  because the rotation is applied first. Its printed result
  `sqrt(3) / 2 + 1 / 2 e1e2 + sqrt(3) e1e + e2e` is that of the correct order. The
  printed order gives `0 e1e + 2 e2e`.
* Equation 2.160: printed rotation times translation; correct translation times rotation,
  because the translation is applied first. Its printed result, which is that of equation
  2.159, is that of the correct order. The printed order gives `sqrt(3) e1e - e2e`.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from .._utils.types import Point, Pose, Scalar, Twist, Twistor
from . import se2


@jax.jit
def twistor(pose: Pose) -> Twistor:
    """Compute the Clifford parameters of a displacement.

    Args:
        pose: Pose of the second frame relative to the first; rad, m, m. The angle may
            exceed 2 pi; twistors have a period of 4 pi.

    Returns:
        `(cos(angle / 2), sin(angle / 2), x1, x2)`, where `(x1, x2)` is half the
        translation, resolved in the mid-frame; -, -, m, m.

    Source:
        Equations 2.124 and 2.129 to 2.135 of the dissertation. The example is from its
        section 2.7.4.

    Example:
        >>> twistor(jnp.array([jnp.pi / 3, 2.0, 2 * jnp.sqrt(3)]))
        Array([0.8660254 , 0.5       , 1.73205081, 1.        ], dtype=float64)
    """
    half = pose[0] / 2
    cos, sin = jnp.cos(half), jnp.sin(half)
    x, y = pose[1] / 2, pose[2] / 2
    return jnp.stack([cos, sin, cos * x + sin * y, cos * y - sin * x])


@jax.jit
def pose(twistor: Twistor) -> Pose:
    """Compute the pose of a twistor.

    Args:
        twistor: Twistor of unit norm; -, -, m, m.

    Returns:
        The pose; rad, m, m. Its angle is between -2 pi and 2 pi.

    Source:
        Equations 2.171 and 2.172 of the dissertation.

    Example:
        >>> pose(jnp.array([0.0, 1.0, 0.5, 0.0]))  # a rotation by 180 degrees
        Array([3.14159265, 0.        , 1.        ], dtype=float64)
    """
    sigma, xi, x1, x2 = twistor
    x, y = 2 * (sigma * x1 - xi * x2), 2 * (sigma * x2 + xi * x1)
    return jnp.stack([2 * jnp.arctan2(xi, sigma), x, y])


@jax.jit
def product(first: Twistor, second: Twistor) -> Twistor:
    """Compute the geometric product of two twistors.

    The product is the twistor of two displacements in sequence, both of which refer to
    the same fixed axes. For poses, `product(twistor(inner), twistor(outer))` equals
    `twistor(se2.compose(outer, inner))`.

    Args:
        first: Twistor of the displacement that is applied first; -, -, m, m.
        second: Twistor of the displacement that is applied second; -, -, m, m.

    Returns:
        The twistor of the total displacement; -, -, m, m.

    Source:
        Section 2.7.4 of the dissertation. The example is equation 2.160, with the factors
        in the correct order.

    Example:
        >>> translation = jnp.array([1.0, 0.0, 2.0, 0.0])
        >>> rotation = jnp.array([jnp.sqrt(0.75), 0.5, 0.0, 0.0])
        >>> product(translation, rotation)
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


@jax.jit
def conjugate(twistor: Twistor) -> Twistor:
    """Compute the conjugate of a twistor: the twistor of the inverse displacement.

    Args:
        twistor: Twistor of unit norm; -, -, m, m.

    Returns:
        The conjugate; its product with the twistor is 1; -, -, m, m.

    Example:
        >>> displacement = jnp.array([0.6, 0.8, 1.0, 2.0])
        >>> product(displacement, conjugate(displacement))
        Array([1., 0., 0., 0.], dtype=float64)
    """
    return twistor * jnp.array([1.0, -1.0, -1.0, -1.0])


@jax.jit
def move(twistor: Twistor, point: Point) -> Point:
    """Displace a point by the product `q* x q`.

    Args:
        twistor: Twistor `q` of unit norm; -, -, m, m.
        point: Coordinates of the point in the fixed axes; m.

    Returns:
        The coordinates of the displaced point in the fixed axes; m.

    Source:
        Equations 2.151 to 2.157 of the dissertation.

    Example:
        >>> rotation = jnp.array([jnp.sqrt(0.75), 0.5, 0.0, 0.0])  # by 60 degrees
        >>> move(rotation, jnp.array([1.0, 0.0]))
        Array([0.5      , 0.8660254], dtype=float64)
    """
    sigma, xi, x1, x2 = twistor
    # The vector part of x q moves the point halfway.
    half_x = sigma * point[0] - xi * point[1] + x1
    half_y = sigma * point[1] + xi * point[0] + x2
    # The product with the conjugate q* from the left moves it by the second half.
    x = sigma * half_x - xi * half_y + sigma * x1 - xi * x2
    y = sigma * half_y + xi * half_x + sigma * x2 + xi * x1
    return jnp.stack([x, y])


class Displacement(eqx.Module):
    """A relative displacement: its angle and its twistor, the argument of an energy.

    The angle is stored in addition to the twistor because it counts full revolutions, and
    because energies in the coordinates of the twist need it.

    Args:
        angle: Angle of the second frame relative to the first; rad.
        sigma: Cosine of half the angle.
        xi: Sine of half the angle.
        x1: Half the translation along axis 1 of the mid-frame; m.
        x2: Half the translation along axis 2 of the mid-frame; m.
    """

    angle: Scalar
    sigma: Scalar
    xi: Scalar
    x1: Scalar
    x2: Scalar

    @classmethod
    def from_pose(cls, pose: Pose) -> "Displacement":
        """Create the displacement of a pose.

        Args:
            pose: Pose of the second frame relative to the first; rad, m, m.

        Returns:
            The displacement.
        """
        return cls(pose[0], *twistor(pose))

    def pose(self) -> Pose:
        """Return the pose of the second frame relative to the first; rad, m, m."""
        half_x = self.sigma * self.x1 - self.xi * self.x2
        half_y = self.xi * self.x1 + self.sigma * self.x2
        return jnp.stack([self.angle, 2 * half_x, 2 * half_y])

    def strain(self) -> Twist:
        """Return twice the vector part of the twistor; -, m, m.

        It equals the twist to first order.
        """
        return jnp.stack([2 * self.xi, 2 * self.x1, 2 * self.x2])

    def twist(self) -> Twist:
        """Return the constant twist of the displacement, see `se2.twist`; rad, m, m."""
        stretch = 2 / se2.sinc(self.angle / 2, self.sigma, self.xi)
        return jnp.stack([self.angle, stretch * self.x1, stretch * self.x2])


@jax.custom_jvp
def half_angle_cos_sin(angle: Scalar, cos: Scalar, sin: Scalar) -> tuple[Scalar, Scalar]:
    """Return the known cosine and sine of half an angle as functions of the angle.

    Derivatives of any order reuse the two values. Products of twistors give them without
    trigonometric functions, which on a CPU are the costly part of a hinge.

    Args:
        angle: The angle; rad. Only its derivatives are used.
        cos: Cosine of half the angle.
        sin: Sine of half the angle.

    Returns:
        `cos` and `sin`.
    """
    del angle
    return cos, sin


@half_angle_cos_sin.defjvp
def _half_angle_cos_sin_jvp(primals, tangents):
    cos, sin = half_angle_cos_sin(*primals)
    rate = tangents[0] / 2
    return (cos, sin), (-sin * rate, cos * rate)
