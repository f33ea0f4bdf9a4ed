"""Rigid bodies of a mechanism."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from .._utils.host import as_float, concrete, on_host
from .._utils.polygons import area_and_centroid
from .._utils.printing import Printed
from .._utils.types import (
    Corners,
    CornersLike,
    InertiaLike,
    NumberLike,
    Pose,
    PoseLike,
    Scalar,
)
from .._utils.validation import (
    require_array,
    require_corners,
    require_finite,
    require_length,
    require_pose,
    require_positive,
    require_text,
    warn,
    warn_if_long,
)
from .material import Material


class Body(Printed):
    """A rigid body with a name.

    Args:
        name: Name of the body.
        pose: Pose of its frame in the world, in the reference configuration; rad, m, m.
            For motion, the origin of the frame must be the center of mass. For statics,
            the frame may be anywhere.
        mass: Mass; needed for motion and vibrations only; kg.
        inertia: Moment of inertia about the origin of the frame; needed for motion and
            vibrations only; kg m^2.
        outline: Corners of a closed polygon in the frame of the body, for drawings and
            for cutting, in order, clockwise or counterclockwise; m.
        expansion: Coefficient of thermal expansion, by default zero; 1/K. At a change of
            temperature the body expands about the origin of its frame.
        tilt_inertia: Inertia matrix against rotations about axes x and y of the frame,
            about its origin; needed for vibrations out of the plane only; kg m^2. The
            product of inertia is negative in it: [[Jxx, -Jxy], [-Jxy, Jyy]].

    Raises:
        ValueError: A mass or a moment of inertia is not positive, a matrix is not
            positive definite, a value is not finite, a shape is wrong, or two edges of
            the outline cross each other.
    """

    name: str = eqx.field(static=True)
    pose: Pose
    mass: Scalar | None
    inertia: Scalar | None
    outline: Corners | None
    expansion: Scalar | None = None
    tilt_inertia: Float[Array, "2 2"] | None = None

    def __init__(
        self,
        name: str,
        pose: PoseLike = (0.0, 0.0, 0.0),
        mass: NumberLike | None = None,
        inertia: NumberLike | None = None,
        outline: CornersLike | None = None,
        expansion: NumberLike | None = None,
        tilt_inertia: InertiaLike | None = None,
    ):
        self.name = require_text("The name of a body", name)
        owner = f"of the body {name!r}"
        self.pose = require_pose(f"`pose` {owner}", pose)
        self.mass, self.inertia = (
            None if value is None else require_positive(f"`{argument}` {owner}", value)
            for argument, value in (("mass", mass), ("inertia", inertia))
        )
        self.outline = None
        if outline is not None:
            self.outline = require_corners(f"`outline` {owner}", outline)
        self.expansion = None
        if expansion is not None:
            self.expansion = require_finite(f"`expansion` {owner}", expansion)
        self.tilt_inertia = None
        if tilt_inertia is not None:
            self.tilt_inertia = _require_inertia(owner, tilt_inertia)
        _warn_of_inertia(self)


# Size of a body from which it seems to be in millimeters; m
_LARGEST = 15.0
# Distance from the center of mass to the centroid of the outline, relative to the largest
# distance of its corners from the origin, above which it is reported
_OFF_CENTER = 0.25
# Squares of radii of gyration that are possible, relative to that of the farthest corner
_GYRATION = 1e-4, 4.0


def _warn_of_inertia(body: Body) -> None:
    """Warn of an outline, a mass, and a moment of inertia that contradict each other."""
    corners = None if body.outline is None else concrete(body.outline)
    if corners is None:
        return
    owner = f"of the body {body.name!r}"
    size = np.max(np.ptp(corners, axis=0))
    warn_if_long(f"The size of the outline {owner}", size, _LARGEST, "a body")
    mass = None if body.mass is None else concrete(body.mass)
    if mass is None or mass.shape:
        return
    farthest = np.max(np.linalg.norm(corners, axis=1))
    offset = np.linalg.norm(area_and_centroid(np, corners)[1])
    if offset > _OFF_CENTER * farthest:
        warn(
            f"The mass {owner} is at the origin of its frame, {offset:.4g} m away from "
            "the centroid of its outline. Move the origin and the outline, or use "
            "`tj.plate`, if the mass is distributed as the outline."
        )
    inertia = None if body.inertia is None else concrete(body.inertia)
    if inertia is None or inertia.shape:
        return
    ratio = float(inertia) / (float(mass) * farthest**2)
    if not _GYRATION[0] <= ratio <= _GYRATION[1]:
        warn(
            f"`inertia` {owner} is {float(inertia):g} kg m^2, but that of {mass:g} kg "
            f"within its outline is between {_GYRATION[0] * mass * farthest**2:.2g} and "
            f"{mass * farthest**2:.2g} kg m^2. 1 kg mm^2 is 1e-6 kg m^2."
        )


def _require_inertia(owner: str, given: InertiaLike) -> Float[Array, "2 2"]:
    """Check an inertia matrix; kg m^2."""
    matrix = require_array(
        f"`tilt_inertia` {owner}", given, (2, 2), "be a matrix with two rows"
    )
    known = concrete(matrix)
    if known is None:
        return matrix
    skew = np.max(np.abs(known - known.T))
    if skew > 1e-5 * np.max(np.abs(known)) or np.any(np.linalg.eigvalsh(known) <= 0):
        raise ValueError(
            f"`tilt_inertia` {owner} is {known.tolist()}, but must be symmetric and "
            "positive definite: [[Jxx, -Jxy], [-Jxy, Jyy]], in kg m^2."
        )
    return matrix


def plate(
    name: str,
    corners: CornersLike,
    *,
    width: NumberLike,
    material: Material,
) -> Body:
    """Create a body that is cut from a plate.

    Mass, moments of inertia, and center of mass follow from the outline.

    Args:
        name: Name of the body.
        corners: Corners of the outline in the world, in order, clockwise or
            counterclockwise, in the reference configuration; m.
        width: Thickness of the plate, perpendicular to the plane of motion; m.
        material: Material of the plate, with its density.

    Returns:
        The body. The origin of its frame is the center of mass, and its axes are parallel
        to those of the world.

    Raises:
        ValueError: The outline encloses no area, two of its edges cross each other, or
            the material has no density.

    Example:
        >>> steel = Material(modulus=210e9, poisson=0.3, density=7.8e3)
        >>> square = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]]
        >>> bar = plate("bar", square, width=0.01, material=steel)
        >>> bar.pose, bar.mass
        (Array([0.  , 0.05, 0.05], dtype=float64), Array(0.78, dtype=float64))
    """
    require_text("The name of a plate", name)
    if not isinstance(material, Material):
        raise ValueError(
            f"`material` of the plate {name!r} is a {type(material).__name__}, but must "
            "be a Material."
        )
    if material.density is None:
        raise ValueError(
            f"The plate {name!r} needs the `density` of its material to have a mass: "
            "give one to `Material`."
        )
    points = require_corners(f"`corners` of the plate {name!r}", corners)
    require_length(f"`width` of the plate {name!r}", width, material.modulus)
    xp, (points, density, width) = on_host(points, material.density, width)
    area, center = area_and_centroid(xp, points)
    known_area = concrete(area)
    if known_area is not None and not abs(known_area) > 0:
        raise ValueError(f"`corners` of the plate {name!r} enclose no area.")
    # Second moments about the centroid, by Green's theorem
    start = points - center[None]
    end = xp.roll(start, -1, axis=0)
    cross = start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]
    squares = xp.sum(start**2 + start * end + end**2, axis=1)
    gyration_squared = xp.sum(squares * cross) / (12 * area)
    mass = density * width * xp.abs(area)
    weights = (cross / (12 * area))[:, None]
    mixed = start + end
    moments = (mixed * weights).T @ mixed + (start * weights).T @ start
    second = (moments + (end * weights).T @ end) / 2
    through_thickness = (gyration_squared + width**2 / 12) * np.eye(2)
    return Body(
        name,
        pose=as_float(xp.concatenate([np.zeros(1), center])),
        mass=mass,
        inertia=mass * gyration_squared,
        outline=as_float(start),
        tilt_inertia=as_float(mass * (through_thickness - second)),
    )
