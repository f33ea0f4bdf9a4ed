"""Rotating squares, which are joined at their corners."""

import numpy as np

from .._utils.host import as_float, on_host
from .._utils.types import NumberLike
from .._utils.validation import require_interval, require_positive
from ..energies.base import AbstractEnergy
from ..energies.contact import Stop
from ..energies.damping import DampingLike
from ..mechanism.body import Body
from ..mechanism.hinge import Hinge
from .unit_cell import UnitCell


# Position of each square in its cell, and the sign of its rotation
_SQUARES = {"a": (0, 0, 1), "b": (1, 0, -1), "c": (0, 1, -1), "d": (1, 1, 1)}
# The squares that joints connect along the first and along the second direction
_ALONG_X = (("a", "b"), ("b", "a[1, 0]"), ("c", "d"), ("d", "c[1, 0]"))
_ALONG_Y = (("a", "c"), ("c", "a[0, 1]"), ("b", "d"), ("d", "b[0, 1]"))


def rotating_squares(
    energy: AbstractEnergy,
    *,
    pitch: NumberLike,
    angle: NumberLike,
    mass: NumberLike | None = None,
    damping: DampingLike | None = None,
    stop_stiffness: NumberLike | None = None,
    stop_smoothing: NumberLike = 0.01,
) -> UnitCell:
    """Create a cell of four squares that are joined at their corners.

    The lattice contracts in both directions if every other square turns to the left and
    the others to the right: its Poisson's ratio is near -1 if the joints are compliant.

    Args:
        energy: Energy of a joint. Its axis 1 is the direction between the centers of the
            two squares.
        pitch: Distance between the centers of neighbors; m.
        angle: Angle between the diagonals of the squares and the directions of the
            lattice, with alternating sign, from 0 to pi / 4; rad.
        mass: Mass of a square; its moment of inertia is that of a uniform plate; kg.
        damping: Damping of a joint; see `Hinge`.
        stop_stiffness: Stiffness against the penetration of neighbors, which touch if
            their edges are parallel; by default they do not touch; N m/rad.
        stop_smoothing: Penetration over which this stiffness grows from zero; rad.

    Returns:
        The cell, which is repeated in two directions. Its squares are "a" and "b" below,
        and "c" and "d" above.

    Raises:
        ValueError: A value is out of its range.

    Source:
        Grima and Evans, Auxetic behavior from rotating squares, J. Materials Science
        Letters 19, 2000.

    Example:
        >>> import twistorjax as tj
        >>> joint = tj.Quadratic(np.diag([1.5e-3, 1.2e5, 1.2e3]))
        >>> cell = tj.lattices.rotating_squares(joint, pitch=15e-3, angle=0.4, mass=1e-3)
        >>> tj.lattices.repeat(cell, (5, 5))
        Lattice of 100 bodies and 180 hinges
    """
    pitch = require_positive("`pitch`", pitch)
    # Zero is allowed.
    requirement = "must be from 0 to pi / 4"
    angle = require_interval("`angle`", angle, -1e-12, np.pi / 4, requirement)
    inertia = None
    (_, (pitch,)), (xp, (turn,)) = on_host(pitch), on_host(angle)
    half = pitch / 2
    offset = half * xp.tan(turn)
    if mass is not None:
        mass = require_positive("`mass`", mass)
        inertia = mass * (half**2 + offset**2) / 3  # m side^2 / 6

    def square(name: str) -> Body:
        column, row, sign = _SQUARES[name]
        shift = sign * offset
        corners = [(half, shift), (-shift, half), (-half, -shift), (shift, -half)]
        pose = (0.0, column * pitch, row * pitch)
        return Body(name, as_float(pose), mass, inertia, outline=as_float(corners))

    energies: dict[int, AbstractEnergy] = {1: energy, -1: energy}
    if stop_stiffness is not None:
        # Neighbors turn in opposite directions.
        wide, narrow = 2 * (np.pi / 4 + turn), 2 * (np.pi / 4 - turn)
        settings = {"stiffness": stop_stiffness, "smoothing": stop_smoothing}
        for sign, negative, positive in ((1, narrow, wide), (-1, wide, narrow)):
            energies[sign] += Stop("-angle", gap=negative, **settings)
            energies[sign] += Stop("+angle", gap=positive, **settings)

    def joint(first: str, second: str, along_x: bool) -> Hinge:
        column, row, sign = _SQUARES[first]
        x, y = (half, sign * offset) if along_x else (-sign * offset, half)
        at = 0.0 if along_x else np.pi / 2, column * pitch + x, row * pitch + y
        name = f"{first}{second[0]}{'x' if along_x else 'y'}"
        return Hinge(name, first, second, energies[sign], as_float(at), damping=damping)

    hinges = [joint(*pair, along_x=True) for pair in _ALONG_X]
    hinges += [joint(*pair, along_x=False) for pair in _ALONG_Y]
    vectors = as_float([(2 * pitch, 0.0), (0.0, 2 * pitch)])
    return UnitCell([square(name) for name in _SQUARES], hinges, vectors)
