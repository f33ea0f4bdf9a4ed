"""What each array holds: its entries, their order, their units.

Rotation comes first everywhere, angles are real numbers and never wrapped.
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
Matrix = Float[
    Array, "3 3"
]  # maps twists to twists, to wrenches, or wrenches to wrenches

Poses = Float[Array, "bodies 3"]  # a row (angle, x, y) for each body
# the same, as a caller may write them
PosesLike = Float[ArrayLike, "bodies 3"] | Sequence[Sequence[ArrayLike]]
Wrenches = Float[Array, "bodies 3"]  # a row (moment, fx, fy) for each body
Corners = Float[Array, "corners 2"]  # a closed polygon, in order; m


@runtime_checkable
class Displaced(Protocol):
    """An answer that says how far bodies have moved: an equilibrium or a motion."""

    @property
    def displacements(self) -> Float[Array, "*batch bodies 3"]:
        """From the poses `reference`; rad, m, m."""
        ...

    @property
    def reference(self) -> Poses:
        """The poses from which displacements count; rad, m, m."""
        ...
