"""Displacement and rate of a port, a frame on a body, from those of the body."""

import jax.numpy as jnp

from .._utils.types import Point, Pose, Scalar
from ..geometry import se2


def displacement_and_rate(
    reference: Scalar, frame: Pose, start: Pose, now: Pose, rate: Pose
) -> tuple[Pose, Pose]:
    """Compute displacement and rate of a port from those of its body (angle, x, y).

    `reference` is the angle of the body in the reference configuration; rad. `start` is
    the displacement of the body at the start of the travel; rad, m, m.
    """
    angle = now[0] - start[0]
    arm = se2.rotate(reference + start[0], frame[1:])
    turned = se2.rotation_displacement(tuple(arm), jnp.cos(angle / 2), jnp.sin(angle / 2))
    turned = jnp.stack(turned)
    translation = now[1:] - start[1:] + turned
    velocity = rate[1:] + rate[0] * _perpendicular(arm + turned)
    to_port = -(reference + start[0] + frame[0])
    displacement = jnp.append(angle, se2.rotate(to_port, translation))
    return displacement, jnp.append(rate[0], se2.rotate(to_port, velocity))


def _perpendicular(vector: Point) -> Point:
    """Rotate a vector by 90 degrees counterclockwise."""
    return jnp.stack([-vector[1], vector[0]])
