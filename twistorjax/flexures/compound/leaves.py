"""Helper of ready-made flexures: bodies and leaves in the plane."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ..._utils.host import as_float, on_host
from ..._utils.types import Corners, NumberLike, Pose, Scalar
from ..._utils.validation import require_instance
from ...energies.base import AbstractEnergy
from ...mechanism.body import Body
from ...mechanism.hinge import Hinge
from ...mechanism.mechanism import Mechanism
from ...mechanism.sub_mechanism import SubMechanism
from ..beams.beam import Beam
from .chain import beam_outline


FIRST, SECOND = "A", "B"  # names of the outer bodies of ready-made flexures


def require_leaf(beam: Beam, energy: AbstractEnergy) -> None:
    """Check a leaf of a ready-made flexure, which must be straight."""
    require_instance("beam", beam, Beam)
    if not isinstance(energy, AbstractEnergy):
        raise ValueError(
            f"`energy` is a {type(energy).__name__}, but must be an energy, such as "
            "`tj.surrogate(beam, rotation=0.5)`."
        )
    if beam.curvature is not None:
        raise ValueError("`beam` is curved, but the leaves of this flexure are straight.")


class Leaf(NamedTuple):
    """A leaf on a line through a point."""

    first: str  # Name of the body at its first end
    second: str  # Name of the body at its second end
    point: tuple[Scalar | float, Scalar | float]  # A point on its axis; m
    angle: Scalar | float  # Direction of its axis, from the first end to the second; rad
    start: Scalar | float  # Distance of the first end from the point along the axis; m


def assemble(
    beam: Beam,
    energy: AbstractEnergy,
    leaves: Sequence[Leaf],
    inner: Sequence[Body] = (),
) -> SubMechanism:
    """Connect body A, body B, and inner bodies by equal leaves.

    The frame of the flexure is that of the world.
    """
    outline = beam_outline(beam)
    hinges = [
        Hinge(
            f"leaf {k + 1}",
            leaf.first,
            leaf.second,
            energy,
            _middle(leaf, beam.length),
            outline=outline,
        )
        for k, leaf in enumerate(leaves)
    ]
    bodies = [Body(FIRST), Body(SECOND), *inner]
    return SubMechanism(Mechanism(bodies, hinges, fixed=[FIRST]), SECOND)


def _middle(leaf: Leaf, length: Scalar) -> Pose:
    """Compute the pose of the middle of a leaf; rad, m, m."""
    xp, (x, y, angle, start, length) = on_host(
        *leaf.point, leaf.angle, leaf.start, length
    )
    distance = start + length / 2
    return as_float(
        xp.stack([angle, x + distance * xp.cos(angle), y + distance * xp.sin(angle)])
    )


def box(width: NumberLike, height: NumberLike) -> Corners:
    """Return the corners of a rectangle around the origin; m."""
    xp, (width, height) = on_host(width, height)
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    return as_float(corners * xp.stack([width, height])[None])


def largest_thickness(beam: Beam) -> Scalar:
    """Return the thickness at the middle or at an end, whichever is larger; m."""
    half = beam.length / 2
    return jnp.maximum(beam.profile(jnp.zeros(())), beam.profile(half))


def sector(inner: Scalar, outer: Scalar, first: Scalar, last: Scalar) -> Corners:
    """Return the corners of a sector of a ring between two angles (rad); m."""
    xp, (inner, outer, first, last) = on_host(inner, outer, first, last)
    angles = first + (last - first) * np.linspace(0.0, 1.0, 61)
    directions = xp.stack([xp.cos(angles), xp.sin(angles)], axis=1)
    return as_float(xp.concatenate([outer * directions, inner * directions[::-1]]))
