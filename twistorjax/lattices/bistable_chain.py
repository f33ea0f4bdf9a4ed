"""A chain of bistable units, along which transitions between their states run."""

import numpy as np

from .._utils.host import as_float, on_host
from .._utils.types import NumberLike
from .._utils.validation import require_positive
from ..energies.base import AbstractEnergy
from ..energies.damping import DampingLike
from ..energies.polynomial import Polynomial
from ..mechanism.body import Body
from ..mechanism.hinge import Hinge
from .unit_cell import UnitCell


def bistable_chain(
    link: AbstractEnergy,
    *,
    pitch: NumberLike,
    distance: NumberLike,
    barrier: NumberLike,
    mass: NumberLike | None = None,
    damping: DampingLike | None = None,
) -> UnitCell:
    """Create a cell of a mass on a bistable spring, which a link joins to the next one.

    The spring is attached to the ground, and has two states along x without load. Its
    energy is `16 barrier (x / distance)^2 (1 - x / distance)^2`. It does not resist other
    displacements: fix "angle" and "y" of the masses, or add an energy that does.

    Args:
        link: Energy of the link between two masses; its axis 1 is the x direction.
        pitch: Distance between neighbors; m.
        distance: Displacement from one state to the other; m.
        barrier: Energy between the two states; J.
        mass: Mass of a unit, with the moment of inertia of a square plate as long as half
            the pitch; kg.
        damping: Damping of the bistable spring; see `Hinge`.

    Returns:
        The cell, which is repeated in one direction. Its bodies are "mass" and "ground",
        which must be fixed.

    Raises:
        ValueError: A value is not positive.

    Source:
        Raney et al., Stable propagation of mechanical signals in soft media using stored
        elastic energy, PNAS 113, 2016.

    Example:
        >>> import twistorjax as tj
        >>> link = tj.Quadratic(np.diag([1.0, 50.0, 50.0]))
        >>> cell = tj.lattices.bistable_chain(
        ...     link, pitch=20e-3, distance=5e-3, barrier=1e-3, mass=1e-3
        ... )
        >>> tj.lattices.repeat(cell, 10)
        Lattice of 20 bodies and 19 hinges
    """
    _, (pitch, distance, barrier) = on_host(
        require_positive("`pitch`", pitch),
        require_positive("`distance`", distance),
        require_positive("`barrier`", barrier),
    )
    inertia = None
    if mass is not None:
        mass = require_positive("`mass`", mass)
        inertia = mass * (pitch / 2) ** 2 / 6
    # The variables of the twistor are half the translations.
    powers = [(0, 0, 2, 0), (0, 0, 3, 0), (0, 0, 4, 0)]
    coefficients = as_float(16 * barrier * np.array([1.0, -2.0, 1.0]))
    spring = Polynomial(coefficients, powers, scale=as_float(distance / 2))
    half = pitch / 4
    square = as_float([(-half, -half), (half, -half), (half, half), (-half, half)])
    bodies = [
        Body("mass", mass=mass, inertia=inertia, outline=square),
        Body("ground"),
    ]
    hinges = [
        Hinge("spring", "ground", "mass", spring, at=(0, 0, 0), damping=damping),
        Hinge("link", "mass", "mass[1]", link, at=as_float([0.0, pitch / 2, 0.0])),
    ]
    return UnitCell(bodies, hinges, as_float([(pitch, 0.0)]))
