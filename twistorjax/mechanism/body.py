"""The rigid bodies of a mechanism."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import ArrayLike, Float

from .._utils.types import Corners, Pose, Scalar
from .._utils.validation import (
    concrete,
    require_corners as need_corners,
    require_kind,
    require_positive,
    require_row,
    require_text,
)
from ..flexures.material import Material


class Body(eqx.Module):
    """A rigid body, known by its name.

    Args:
        name: by which hinges, loads and answers call it.
        pose: where its frame stands when nothing is loaded; rad, m, m. Motion needs the
            frame at the centre of mass; for statics alone it may be anywhere.
        mass: needed for motion alone; kg.
        inertia: about the frame's origin, needed for motion alone; kg m2.
        outline: a closed polygon in the body's frame, for drawing; m.

    Raises:
        ValueError: a mass or inertia is not positive; a value is not finite; a shape is
            wrong.
    """

    name: str = eqx.field(static=True)
    pose: Pose
    mass: Scalar | None
    inertia: Scalar | None
    outline: Corners | None

    def __init__(
        self,
        name: str,
        pose: Float[ArrayLike, "3"] | Sequence[ArrayLike] = (0.0, 0.0, 0.0),
        mass: ArrayLike | None = None,
        inertia: ArrayLike | None = None,
        outline: Float[ArrayLike, "corners 2"] | None = None,
    ):
        self.name = require_text("The name of a body", name)
        self.pose = require_row(f"`pose` of the body {name!r}", pose, "(angle, x, y)")
        self.mass, self.inertia = (
            None
            if value is None
            else require_positive(f"`{what}` of the body {name!r}", value)
            for what, value in (("mass", mass), ("inertia", inertia))
        )
        self.outline = None
        if outline is not None:
            self.outline = need_corners(f"`outline` of the body {name!r}", outline)


def plate(
    name: str,
    corners: Float[ArrayLike, "corners 2"] | Sequence[Sequence[ArrayLike]],
    *,
    width: ArrayLike,
    of: Material,
) -> Body:
    """A body cut from a plate: mass, inertia and frame follow from its outline.

    Args:
        name: of the body.
        corners: of its outline, in order, where they are when nothing is loaded; m.
        width: out of the plane: thickness of the plate; m.
        of: the material, with its density.

    Returns:
        A body whose frame, parallel to the world's, sits at the centre of mass.

    Raises:
        ValueError: the outline encloses no area, or the material has no density.

    Example:
        >>> steel = Material(modulus=210e9, poisson=0.3, density=7.8e3)
        >>> square = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]]
        >>> bar = plate("bar", square, width=0.01, of=steel)
        >>> bar.pose, bar.mass
        (Array([0.  , 0.05, 0.05], dtype=float64), Array(0.78, dtype=float64))
    """
    require_kind("of", [of], Material)
    if of.density is None:
        raise ValueError(
            f"The plate {name!r} needs the `density` of its material to have a mass: "
            "give one to `Material`."
        )
    points = jnp.asarray(corners, float)
    if points.ndim != 2 or points.shape[0] < 3 or points.shape[1] != 2:
        raise ValueError(
            f"`corners` of the plate {name!r} has shape {points.shape}, but must have a "
            "row (x, y) for each of three corners or more."
        )
    # Green's theorem on triangles from the mean corner, which keeps the digits of an
    # outline far from the origin
    middle = jnp.mean(points, axis=0)
    start = points - middle[None]
    end = jnp.roll(start, -1, axis=0)
    cross = start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]
    area = jnp.sum(cross) / 2
    seen = concrete(area)
    if seen is not None and not abs(seen) > 0:
        raise ValueError(f"`corners` of the plate {name!r} enclose no area.")
    center = jnp.sum((start + end) * cross[:, None], axis=0) / (6 * area)
    squares = jnp.sum(start**2 + start * end + end**2, axis=1)
    per_area = jnp.sum(squares * cross) / (12 * area) - jnp.sum(center**2)
    mass = of.density * width * jnp.abs(area)
    return Body(
        name,
        pose=jnp.concatenate([jnp.zeros(1), middle + center]),
        mass=mass,
        inertia=mass * per_area,
        outline=start - center[None],
    )
