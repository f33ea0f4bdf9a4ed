"""The kagome lattice of triangles, which are joined at their corners."""

import numpy as np

from .._utils.host import as_float, on_host
from .._utils.types import NumberLike
from .._utils.validation import require_positive
from ..energies.base import AbstractEnergy
from ..energies.damping import DampingLike
from ..mechanism.body import Body
from ..mechanism.hinge import Hinge
from .unit_cell import UnitCell


_HEIGHT = np.sqrt(3) / 2  # of an equilateral triangle, over its side
# Centers of both triangles over their side
_UP, _DOWN = np.array([0.5, _HEIGHT / 3]), np.array([0.5, 5 / 3 * _HEIGHT])


def kagome(
    energy: AbstractEnergy,
    *,
    side: NumberLike,
    mass: NumberLike | None = None,
    damping: DampingLike | None = None,
) -> UnitCell:
    """Create a cell of two equilateral triangles that are joined at their corners.

    With joints that only resist translations, the lattice has as many freedoms as
    constraints, and motions that cost no energy.

    Args:
        energy: Energy of a joint. Its axis 1 is the direction between the centers of the
            two triangles.
        side: Side of a triangle; m.
        mass: Mass of a triangle; its moment of inertia is that of a uniform plate; kg.
        damping: Damping of a joint; see `Hinge`.

    Returns:
        The cell, which is repeated in two directions, of which the second is inclined by
        60 degrees. Its triangles are "up" and, above it, "down".

    Raises:
        ValueError: A value is not positive.

    Source:
        Sun, Souslov, Mao and Lubensky, Surface phonons, elastic response, and conformal
        invariance in twisted kagome lattices, PNAS 109, 2012.

    Example:
        >>> import twistorjax as tj
        >>> joint = tj.Quadratic(np.diag([1.5e-3, 1.2e5, 1.2e3]))
        >>> cell = tj.lattices.kagome(joint, side=15e-3, mass=1e-3)
        >>> tj.lattices.repeat(cell, (4, 3))
        Lattice of 24 bodies and 26 hinges
    """
    _, (side,) = on_host(require_positive("`side`", side))
    inertia = None
    if mass is not None:
        mass = require_positive("`mass`", mass)
        inertia = mass * side**2 / 12
    shape = np.array([[-0.5, -_HEIGHT / 3], [0.5, -_HEIGHT / 3], [0.0, 2 / 3 * _HEIGHT]])
    bodies = [
        Body(
            name,
            as_float(side * np.array([0.0, *center])),
            mass,
            inertia,
            outline=as_float(sign * side * shape),
        )
        for name, center, sign in (("up", _UP, 1), ("down", _DOWN, -1))
    ]
    # Corners of the triangle "down", and the triangle "up" that each of them touches
    corners = (
        ("bottom", (0.5, _HEIGHT), "up"),
        ("left", (0.0, 2 * _HEIGHT), "up[-1, 1]"),
        ("right", (1.0, 2 * _HEIGHT), "up[0, 1]"),
    )
    hinges = []
    for name, corner, other in corners:
        x, y = np.array(corner) - _DOWN
        at = as_float([np.arctan2(y, x), side * corner[0], side * corner[1]])
        hinges.append(Hinge(name, "down", other, energy, at, damping=damping))
    vectors = as_float(side * np.array([[2.0, 0.0], [1.0, 2 * _HEIGHT]]))
    return UnitCell(bodies, hinges, vectors)
