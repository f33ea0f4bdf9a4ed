"""Line vectors of the plane: forces and their lines of action.

A line vector `(moment, l, h)` has a magnitude, a direction `(l, h)` and a line. The
moment about the origin determines the line, but no point on it. A wrench is a line
vector, and the sum of the wrenches on a body is a wrench. Sections 2.2 and 2.4 of the
dissertation.

Corrections to section 2.4: the resultant `(6 + 3 sqrt(3), F, F)` with
`F = 3 (1 + sqrt(3)) / 2` is correct, but two numbers after it are not. The magnitude is
`sqrt(2) F = 5.796`, not `3 + 3 sqrt(3) = 8.196`. The line intersects the x axis at
`moment / F = sqrt(3) + 1`, not at `sqrt(3) - 1`.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from .._utils.types import Point, Scalar, Wrench
from .se2 import cross


@jax.jit
def line(start: Point, end: Point) -> Wrench:
    """Compute the line vector from one point to another.

    Args:
        start: Start point; m.
        end: End point; m.

    Returns:
        The Pluecker coordinates `(moment, l, h)`: the moment of the vector about the
        origin, and its two components; m^2, m, m.

    Source:
        Equations 2.48 to 2.51 of the dissertation.

    Example:
        >>> line(jnp.array([4.0, 0.0]), jnp.array([4.0, 2.0]))
        Array([8., 0., 2.], dtype=float64)
    """
    along = end - start
    return jnp.concatenate([cross(start, along)[None], along])


@jax.jit
def force(point: Point, force: Point) -> Wrench:
    """Compute the wrench about the origin of a force that acts at a point.

    Args:
        point: Any point on the line of action; m.
        force: Components of the force; N.

    Returns:
        The moment about the origin, and the force; N m, N, N.

    Source:
        Equations 2.74 and 2.75 of the dissertation. The example is from its section 2.4.

    Example:
        >>> direction = jnp.array([jnp.sqrt(3) / 2, 0.5])  # at 30 degrees
        >>> force(jnp.array([4.0, 0.0]), 3 * direction)
        Array([6.        , 2.59807621, 1.5       ], dtype=float64)
    """
    return jnp.concatenate([cross(point, force)[None], force])


class Resultant(eqx.Module):
    """Magnitude, direction and line of action of a wrench.

    Args:
        magnitude: Magnitude of the force; N.
        direction: Angle between the force and the x axis; rad.
        foot: Point on the line of action that is closest to the origin; m. It is infinite
            for a couple.
    """

    magnitude: Scalar
    direction: Scalar
    foot: Point


@jax.jit
def resultant(wrench: Wrench) -> Resultant:
    """Compute the magnitude, the direction and the line of action of a wrench.

    Args:
        wrench: Wrench about the origin, of one force or of a sum of forces; N m, N, N.

    Returns:
        The resultant. If the force is zero, the magnitude and the direction are zero, and
        the foot is infinite.

    Source:
        Equations 2.77 to 2.80 of the dissertation.

    Example:
        >>> resultant(jnp.array([-6.0, 3.0, 0.0])).foot
        Array([0., 2.], dtype=float64)
    """
    moment, fx, fy = wrench
    square = fx**2 + fy**2
    has_force = square > 0
    safe = jnp.where(has_force, square, 1.0)
    foot = moment * jnp.stack([fy, -fx]) / safe
    return Resultant(
        magnitude=jnp.where(has_force, jnp.sqrt(safe), 0.0),
        direction=jnp.where(
            has_force, jnp.arctan2(fy, jnp.where(has_force, fx, 1.0)), 0.0
        ),
        foot=jnp.where(has_force, foot, jnp.inf),
    )
