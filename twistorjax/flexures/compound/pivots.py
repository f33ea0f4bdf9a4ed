"""Ready-made flexures that are compliant in rotation.

They are sub-mechanisms of equal leaves, to be used as one hinge: `Condensed` is their
exact energy, and `surrogate` computes a fast one. The frame is at the center of rotation,
and axis 1 is the axis of symmetry, from body A to body B.
"""

import numpy as np

from ..._utils.types import NumberLike
from ..._utils.validation import require_interval, require_positive
from ...energies.base import AbstractEnergy
from ...mechanism.body import Body
from ...mechanism.sub_mechanism import SubMechanism
from ..beams.beam import Beam
from .leaves import (
    assemble,
    box,
    FIRST,
    largest_thickness,
    Leaf,
    require_leaf,
    SECOND,
    sector,
)


_ANGLE = "must be between 0 and pi, in radians"


def cross_spring_pivot(
    beam: Beam,
    energy: AbstractEnergy,
    *,
    angle: NumberLike = np.pi / 2,
    crossing: NumberLike = 0.5,
) -> SubMechanism:
    """Create a pivot of two leaves that cross without touching each other.

    Its rotational stiffness without a load is `8 E I / L (1 - 3 c + 3 c^2)`, with the
    length L of a leaf and the crossing c; the pivot with `c = 0.5` is the most compliant.

    Args:
        beam: A leaf; it gives the length and the outline.
        energy: Energy of a leaf, such as `surrogate(beam, rotation=0.5)`.
        angle: Angle between the leaves; rad.
        crossing: Position at which the leaves cross, as a fraction of their length from
            body A. With 0 or 1, they meet at a body.

    Returns:
        The pivot. Its leaves are "leaf 1" and "leaf 2".

    Raises:
        ValueError: The beam is curved, or an argument is out of its range.

    Source:
        Haringx, The cross-spring pivot as a constructional element, Appl. Sci. Res. A1,
        1949.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3)
        >>> beam = Beam(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
        >>> leaf = tj.flexures.leaf(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
        >>> pivot = tj.flexures.cross_spring_pivot(beam, leaf)
        >>> tj.flexures.Condensed(pivot).tangent_stiffness()[0, 0]  # 2 E I / L
        Array(0.875, dtype=float64)
    """
    require_leaf(beam, energy)
    angle = require_interval("`angle`", angle, 0.0, np.pi, _ANGLE)
    crossing = require_interval(
        "`crossing`", crossing, -1e-12, 1 + 1e-12, "must be between 0 and 1"
    )
    start = -crossing * beam.length
    leaves = [
        Leaf(FIRST, SECOND, (0.0, 0.0), sign * angle / 2, start) for sign in (1, -1)
    ]
    return assemble(beam, energy, leaves)


def cartwheel_pivot(
    beam: Beam,
    energy: AbstractEnergy,
    *,
    angle: NumberLike = np.pi / 2,
    hub: NumberLike = 0.0,
) -> SubMechanism:
    """Create a pivot of four leaves that meet at a hub: a cartwheel hinge.

    Two leaves connect body A to the hub, and two connect the hub to body B.

    Args:
        beam: A leaf, which is a spoke; it gives the length and the outline.
        energy: Energy of a leaf, such as `surrogate(beam, rotation=0.3)`.
        angle: Angle between the two leaves to the same body; rad.
        hub: Radius of the rigid hub; m.

    Returns:
        The pivot. Its leaves are "leaf 1" to "leaf 4", and its inner body is "hub".

    Raises:
        ValueError: The beam is curved, or an argument is out of its range.

    Source:
        Smith, Flexures: elements of elastic mechanisms, 2000, section 4.5.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3)
        >>> beam = Beam(steel, length=20e-3, thickness=0.5e-3, width=10e-3)
        >>> leaf = tj.flexures.leaf(steel, length=20e-3, thickness=0.5e-3, width=10e-3)
        >>> pivot = tj.flexures.cartwheel_pivot(beam, leaf)
        >>> tj.flexures.Condensed(pivot).tangent_stiffness()[0, 0].round(2)  # 4 E I / L
        Array(4.37, dtype=float64)
    """
    require_leaf(beam, energy)
    angle = require_interval("`angle`", angle, 0.0, np.pi, _ANGLE)
    radius = require_interval("`hub`", hub, -1e-12, np.inf, "must not be negative")
    name = "hub"
    leaves = [
        Leaf(FIRST, name, (0.0, 0.0), sign * angle / 2, -radius - beam.length)
        for sign in (1, -1)
    ]
    leaves += [
        Leaf(name, SECOND, (0.0, 0.0), sign * angle / 2, radius) for sign in (1, -1)
    ]
    size = 2 * radius + 2 * largest_thickness(beam)
    return assemble(beam, energy, leaves, [Body(name, outline=box(size, size))])


def butterfly_pivot(
    beam: Beam,
    energy: AbstractEnergy,
    *,
    radius: NumberLike,
    angle: NumberLike = np.pi / 6,
    opening: NumberLike = np.pi / 3,
) -> SubMechanism:
    """Create a pivot of eight leaves on lines through its center: a butterfly pivot.

    Two leaves connect body A to an inner body, and two connect this one to body B. Two
    such chains, above and below the center, are in parallel. The shifts of the centers
    of the two stages of a chain compensate each other.

    Args:
        beam: A leaf; it gives the length and the outline.
        energy: Energy of a leaf, such as `surrogate(beam, rotation=0.3)`.
        radius: Distance of the inner ends of the leaves from the center; m.
        angle: Angle between the two leaves of a stage; rad.
        opening: Angle between the middle lines of the two stages of a chain; rad.

    Returns:
        The pivot. Its leaves are "leaf 1" to "leaf 8". Its inner bodies are "upper" and
        "lower", at the outer ends of the leaves.

    Raises:
        ValueError: The beam is curved, or an argument is out of its range.

    Source:
        Henein, Spanoudakis, Droz, Myklebust and Onillon, Flexure pivot for aerospace
        mechanisms, Proc. 10th ESMATS, 2003.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3)
        >>> beam = Beam(steel, length=20e-3, thickness=0.5e-3, width=10e-3)
        >>> leaf = tj.flexures.leaf(steel, length=20e-3, thickness=0.5e-3, width=10e-3)
        >>> tj.flexures.butterfly_pivot(beam, leaf, radius=5e-3)
        SubMechanism of 4 bodies (A, B, upper, lower) and 8 hinges, from A to B
    """
    require_leaf(beam, energy)
    angle = require_interval("`angle`", angle, 0.0, np.pi, _ANGLE)
    opening = require_interval("`opening`", opening, 0.0, np.pi, _ANGLE)
    radius = require_positive("`radius`", radius)
    outer = radius + beam.length
    leaves, inner = [], []
    for side, name in ((1, "upper"), (-1, "lower")):
        for first, stage in ((FIRST, 1), (SECOND, -1)):
            middle = side * (np.pi / 2 + stage * opening / 2)
            leaves += [
                Leaf(first, name, (0.0, 0.0), middle + sign * angle / 2, radius)
                for sign in (1, -1)
            ]
        middle, half = side * np.pi / 2, (opening + angle) / 2 + 0.05
        ring = sector(outer, outer + beam.length / 5, middle - half, middle + half)
        inner.append(Body(name, outline=ring))
    return assemble(beam, energy, leaves, inner)
