"""One elastic coupling between two bodies."""

from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import ArrayLike, Float

from .._utils.types import Corners, Pose, Scalar
from .._utils.validation import (
    all_concrete,
    concrete,
    require_corners,
    require_interval,
    require_row,
    require_text,
)
from ..energies.base import AbstractEnergy, validation_error
from ..energies.damping import ViscousDamping
from ..geometry import se2


class Hinge(eqx.Module):
    """An elastic coupling between a frame on one body and a frame on another.

    Give the place of the hinge either once, as it stands in the world when nothing is
    loaded, or as the two frames in which it grips its bodies.

    Args:
        name: by which answers call it.
        first: name of body A, on which frame a sits.
        second: name of body B, on which frame b sits.
        energy: what it stores at a displacement of b against a.
        at: both frames at rest, in the world; rad, m, m. Axis 1 of a leaf or a notch
            lies along it and leads from the first body to the second: from base to table
            upwards its angle is pi / 2.
        ports: frame a in the frame of body A, and b in that of B; rad, m, m.
        damping: what it dissipates as it moves: a `ViscousDamping`, or the time by which its
            stiffness at rest is multiplied to give one; by default nothing; s.
        outline: a closed polygon in the frame of the hinge, for drawing; m.

    Raises:
        ValueError: both or neither of `at` and `ports` are given; a hinge joins a body
            to itself; a shape is wrong or a value not finite; the damping time is
            negative.
    """

    name: str = eqx.field(static=True)
    first: str = eqx.field(static=True)
    second: str = eqx.field(static=True)
    energy: AbstractEnergy
    at: Pose | None
    ports: tuple[Pose, Pose] | None
    damping: ViscousDamping | Scalar | None
    outline: Corners | None

    def __init__(
        self,
        name: str,
        first: str,
        second: str,
        energy: AbstractEnergy,
        at: Float[ArrayLike, "3"] | Sequence[ArrayLike] | None = None,
        *,
        ports: Sequence[Float[ArrayLike, "3"] | Sequence[ArrayLike]] | None = None,
        damping: ViscousDamping | ArrayLike | None = None,
        outline: Float[ArrayLike, "corners 2"] | None = None,
    ):
        self.name = require_text("The name of a hinge", name)
        self.first = require_text(f"`first` of the hinge {name!r}", first)
        self.second = require_text(f"`second` of the hinge {name!r}", second)
        if not isinstance(energy, AbstractEnergy):
            raise ValueError(
                f"`energy` of the hinge {name!r} is a {type(energy).__name__}, but must "
                "be an energy: `Quadratic(stiffness)`, `leaf(...)`, `notch(...)`."
            )
        self.energy = energy
        if first == second:
            raise ValueError(f"The hinge {name!r} joins the body {first!r} to itself.")
        if (at is None) == (ports is None):
            raise ValueError(
                f"The hinge {name!r} needs either `at`, its frame in the world at rest, "
                "or `ports`, its frames in both bodies: "
                + ("neither is given." if at is None else "both are given.")
            )
        place = f"of the hinge {name!r}"
        self.at = (
            None if at is None else require_row(f"`at` {place}", at, "(angle, x, y)")
        )
        if ports is None:
            self.ports = None
        else:
            in_first, in_second = (
                require_row(f"`ports[{k}]` {place}", port, "(angle, x, y)")
                for k, port in enumerate(ports)
            )
            self.ports = in_first, in_second
        self.damping = _damping(f"`damping` {place}", damping)
        self.outline = (
            None if outline is None else require_corners(f"`outline` {place}", outline)
        )


def _damping(
    name: str, given: ViscousDamping | ArrayLike | None
) -> ViscousDamping | Scalar | None:
    if given is None or isinstance(given, ViscousDamping):
        return given
    needed = "must be a `ViscousDamping`, or a time that is finite and not negative"
    # from zero on: a sweep over times starts there
    return require_interval(
        name, given, -np.finfo(float).tiny, np.finfo(float).max, needed
    )


def check_energy(hinge: Hinge) -> None:
    """Refuse an energy whose values cannot be used.

    Raises:
        ValueError: A value is not finite, or the energy reports a fault.
    """
    if error := validation_error(hinge.energy):
        raise ValueError(
            f"The energy of the hinge {hinge.name!r} cannot be used: {error}"
        )
    for leaf in jax.tree.leaves(hinge.energy):
        values = concrete(leaf)
        if values is not None and not np.all(np.isfinite(values)):
            raise ValueError(
                f"The energy of the hinge {hinge.name!r} has a value that is not finite: "
                f"{values.tolist()}."
            )


def frame_of(hinge: Hinge, first: Pose, second: Pose) -> Pose:
    """Find the frame of a hinge at rest, in the world; rad, m, m.

    Args:
        hinge: The hinge.
        first: Pose of body A at rest; rad, m, m.
        second: Pose of body B at rest; rad, m, m.

    Raises:
        ValueError: Its two ports do not coincide.
    """
    if hinge.ports is None:
        assert hinge.at is not None
        return hinge.at
    a, b = (
        se2.compose(body, port)
        for body, port in zip((first, second), hinge.ports, strict=True)
    )
    seen = all_concrete([se2.between(a, b), a, b, *hinge.ports])
    if seen is not None:
        gap, *places = seen
        scale = 1e-12 + max(np.max(np.abs(place[1:])) for place in places)
        apart = np.abs(gap) > 1e-9 * np.array([1.0, scale, scale])
        if np.any(apart):
            raise ValueError(
                f"The ports of the hinge {hinge.name!r} do not coincide at rest: seen "
                f"from port a on {hinge.first!r}, port b on {hinge.second!r} is turned "
                f"by {gap[0]:.6g} rad and shifted by ({gap[1]:.6g}, {gap[2]:.6g}) m. A "
                "hinge is unstressed at rest: move a port or a body, or give `at`."
            )
    return a
