"""Types of arrays: their entries, the order of the entries, and their units.

The rotation is always the first entry. Angles are real numbers and are never wrapped.
"""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from jaxtyping import Array, ArrayLike, Float


Scalar = Float[Array, ""]

Point = Float[Array, "2"]  # (x, y); m
Pose = Float[Array, "3"]  # (angle, x, y); rad, m, m
Twist = Float[Array, "3"]  # (rotation, along axis 1, along axis 2); rad, m, m
Twistor = Float[Array, "4"]  # (sigma, xi, x1, x2); -, -, m, m
Wrench = Float[Array, "3"]  # (moment, fx, fy); N m, N, N
Matrix = Float[Array, "3 3"]  # a linear map between twists and wrenches

Poses = Float[Array, "bodies 3"]  # a row (angle, x, y) for each body
# Poses as a user may write them, for example as nested lists.
PosesLike = Float[ArrayLike, "bodies 3"] | Sequence[Sequence[ArrayLike]]
Wrenches = Float[Array, "bodies 3"]  # a row (moment, fx, fy) for each body
Corners = Float[Array, "corners 2"]  # a closed polygon, in order; m


@runtime_checkable
class Displaced(Protocol):
    """A result with the displacements of bodies, such as an equilibrium or a motion."""

    @property
    def displacements(self) -> Float[Array, "*batch bodies 3"]:
        """Displacements of the bodies from `reference`; rad, m, m."""
        ...

    @property
    def reference(self) -> Poses:
        """Poses of the bodies in the reference configuration; rad, m, m."""
        ...
