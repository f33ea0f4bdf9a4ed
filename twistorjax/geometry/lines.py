"""Line vectors of the plane: forces, and the lines on which they act.

A line vector `(moment, l, h)` has a magnitude and direction `(l, h)` and a line, told by
its moment about the origin, but no point of that line. A wrench is one, and wrenches on
a body add up to one. Sections 2.2 and 2.4 of the dissertation.

The resultant worked out there is right as a sum, `(6 + 3 sqrt 3, F, F)` with
`F = 3 (1 + sqrt 3) / 2`. Its magnitude is printed without the `1 / sqrt 2` that two equal
components leave: it is 5.796, not `3 + 3 sqrt 3` = 8.196. It meets the x axis where
moment over F says, at `sqrt(3) + 1`; the text has `sqrt(3) - 1`.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._utils.types import Point, Scalar, Wrench
from .se2 import _cross


def line(start: Point, end: Point) -> Float[Array, "3"]:
    """The line vector that leads from one point to another.

    Args:
        start: a point on the line; m.
        end: another; m.

    Returns:
        `(moment, l, h)`, the Pluecker coordinates: twice the area that it spans with the
        origin, and its two components; m2, m, m.

    Source:
        Equations 2.48 to 2.51 of the dissertation.

    Example:
        >>> line(jnp.array([4.0, 0.0]), jnp.array([4.0, 2.0]))
        Array([8., 0., 2.], dtype=float64)
    """
    along = end - start
    return jnp.concatenate([_cross(start, along)[None], along])


def force(at: Point, force: Point) -> Wrench:
    """The wrench about the origin of a force that acts at a point.

    Args:
        at: any point of the force's line; m.
        force: its components; N.

    Source:
        Equations 2.74 and 2.75 of the dissertation.

    Example:
        >>> half = jnp.array([jnp.sqrt(3) / 2, 0.5])  # section 2.4: 3 N at 30 degrees
        >>> force(jnp.array([4.0, 0.0]), 3 * half)
        Array([6.        , 2.59807621, 1.5       ], dtype=float64)
    """
    return jnp.concatenate([_cross(at, force)[None], force])


class Resultant(eqx.Module):
    """The one force that does what many do together, and where it acts.

    Args:
        magnitude: of the force; N.
        direction: angle of the force against the x axis; rad.
        foot: the point of its line nearest the origin, infinite for a couple; m.
    """

    magnitude: Scalar
    direction: Scalar
    foot: Point


def resultant(wrench: Wrench) -> Resultant:
    """The magnitude, direction and line of a wrench.

    Args:
        wrench: about the origin, of one force or the sum of many; N m, N, N.

    Source:
        Equations 2.77 to 2.80 of the dissertation.

    Example:
        >>> resultant(jnp.array([-6.0, 3.0, 0.0])).foot
        Array([0., 2.], dtype=float64)
    """
    moment, fx, fy = wrench
    square = fx**2 + fy**2
    pushes = square > 0
    safe = jnp.where(pushes, square, 1.0)
    foot = moment * jnp.stack([fy, -fx]) / safe
    return Resultant(
        magnitude=jnp.where(pushes, jnp.sqrt(safe), 0.0),
        direction=jnp.where(pushes, jnp.arctan2(fy, jnp.where(pushes, fx, 1.0)), 0.0),
        foot=jnp.where(pushes, foot, jnp.inf),
    )
