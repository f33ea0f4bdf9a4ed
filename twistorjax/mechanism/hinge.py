"""Elastic connection of two bodies."""

from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import TypeAliasType

from .._utils.host import all_concrete, concrete
from .._utils.printing import Printed
from .._utils.types import Corners, CornersLike, Pose, PoseLike, Scalar
from .._utils.validation import (
    quote,
    require_corners,
    require_interval,
    require_pose,
    require_text,
)
from ..assembly.kinematics import misfit_numbers
from ..energies.base import AbstractEnergy, validation_error
from ..energies.damping import DampingLike, ViscousDamping
from ..geometry import se2
from .material import Expansion


# Displacement (angle, x, y) at which a hinge is not loaded, or that of its ports; rad, m
MisfitLike = TypeAliasType("MisfitLike", PoseLike | Literal["ports"])


class AbstractOutline(eqx.Module):
    """An outline of a hinge that is drawn by its own parts, as a `SubMechanism` is."""


# Corners of a polygon (m), or the parts that are drawn
OutlineLike = TypeAliasType("OutlineLike", CornersLike | AbstractOutline)


class Hinge(Printed):
    """An elastic connection of frame a on body A and frame b on body B.

    In the reference configuration both frames coincide. Give their pose in this
    configuration by `at`, or their poses on the two bodies by `ports`. The hinge is not
    loaded in this configuration unless it has a `misfit`.

    Args:
        name: Name of the hinge.
        first: Name of body A.
        second: Name of body B.
        energy: Elastic energy as a function of the displacement of frame b relative to
            frame a.
        at: Pose of both frames in the world, in the reference configuration; rad, m, m.
            Axis 1 of a leaf or a notch is parallel to its length and points from the
            first body to the second. If the first body is below the second, the angle is
            pi / 2.
        ports: Pose of frame a on body A, and pose of frame b on body B; rad, m, m.
        damping: A `ViscousDamping`; or a time (s), by which the stiffness matrix in the
            reference configuration is multiplied to obtain the damping matrix. By default
            the hinge has no damping.
        misfit: Displacement (angle, x, y) of frame b relative to frame a at which the
            hinge is not loaded, by default zero; or "ports", if the frames in `ports` do
            not coincide in the reference configuration, and the hinge is not loaded where
            they coincide. Preload and errors of assembly are misfits; rad, m, m.
        outline: Corners of a closed polygon in the frame of the hinge, for drawing; m.
            Or a `SubMechanism`, which is drawn with all of its parts.
        expansion: Thermal `Expansion` of the hinge, by default none.

    Raises:
        ValueError: Both or neither of `at` and `ports` are given, a hinge connects a body
            to itself, a shape is wrong, a value is not finite, two edges of the outline
            cross each other, or the damping time is negative.

    Source:
        A misfit is divided equally among the two frames. The energy is that of the
        displacement between frame a displaced by half the misfit, and frame b displaced
        by half its inverse.
    """

    name: str = eqx.field(static=True)
    first: str = eqx.field(static=True)
    second: str = eqx.field(static=True)
    energy: AbstractEnergy
    at: Pose | None
    ports: tuple[Pose, Pose] | None
    damping: ViscousDamping | Scalar | None
    misfit_of_ports: bool = eqx.field(static=True, repr=False)
    outline: Corners | AbstractOutline | None
    misfit: Pose | None = None
    expansion: Expansion | None = None

    def __init__(
        self,
        name: str,
        first: str,
        second: str,
        energy: AbstractEnergy,
        at: PoseLike | None = None,
        *,
        ports: Sequence[PoseLike] | None = None,
        damping: DampingLike | None = None,
        misfit: MisfitLike | None = None,
        outline: OutlineLike | None = None,
        expansion: Expansion | None = None,
    ):
        self.name = require_text("The name of a hinge", name)
        self.first = require_text(f"`first` of the hinge {name!r}", first)
        self.second = require_text(f"`second` of the hinge {name!r}", second)
        if not isinstance(energy, AbstractEnergy):
            raise ValueError(
                f"`energy` of the hinge {name!r} is a {type(energy).__name__}, but must "
                "be an energy: `Quadratic(stiffness)`, `leaf(...)`, `notch(...)`, or "
                "`surrogate(...)` of a beam or a sub-mechanism."
            )
        self.energy = energy
        if first == second:
            raise ValueError(f"The hinge {name!r} connects the body {first!r} to itself.")
        if (at is None) == (ports is None):
            raise ValueError(
                f"The hinge {name!r} needs either `at`, its pose in the world, or "
                "`ports`, its poses on both bodies, but "
                f"{'neither is' if at is None else 'both are'} given."
            )
        owner = f"of the hinge {name!r}"
        self.at = self.ports = None
        if at is not None:
            self.at = require_pose(f"`at` {owner}", at)
        if ports is not None:
            on_first, on_second = (
                require_pose(f"`ports[{k}]` {owner}", port)
                for k, port in enumerate(ports)
            )
            self.ports = on_first, on_second
        self.damping = _check_damping(f"`damping` {owner}", damping)
        self.misfit, self.misfit_of_ports = None, isinstance(misfit, str)
        if isinstance(misfit, str):
            if misfit != "ports" or ports is None:
                raise ValueError(
                    f"`misfit` {owner} is {quote(misfit)}, but must be a displacement "
                    '(angle, x, y), or "ports" if `ports` are given.'
                )
        elif misfit is not None:
            self.misfit = require_pose(f"`misfit` {owner}", misfit)
        self.outline = None
        if isinstance(outline, AbstractOutline):
            self.outline = outline
        elif outline is not None:
            self.outline = require_corners(f"`outline` {owner}", outline)
        self.expansion = expansion


def _check_damping(
    name: str, damping: DampingLike | None
) -> ViscousDamping | Scalar | None:
    """Check and return a damping, or the time of a proportional damping; s."""
    if damping is None or isinstance(damping, ViscousDamping):
        return damping
    requirement = "must be a `ViscousDamping`, or a time that is finite and not negative"
    # Zero is allowed, because a sweep over times may start there.
    smallest = -np.finfo(float).tiny
    return require_interval(name, damping, smallest, np.finfo(float).max, requirement)


def check_energy(hinge: Hinge) -> None:
    """Check the values of the energy of a hinge."""
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


def frame_and_misfit(
    hinge: Hinge, first: Pose, second: Pose
) -> tuple[Pose, Float[Array, "6"] | None]:
    """Compute the pose of both frames of a hinge in the reference configuration.

    `first` and `second` are the reference poses of bodies A and B. The second result is
    the array of numbers of the hinge's `Misfit`, if it has one; see `misfit_numbers`.
    """
    misfit = None if hinge.misfit is None else misfit_numbers(hinge.misfit)
    if hinge.ports is None:
        assert hinge.at is not None
        return hinge.at, misfit
    a, b = (
        se2.compose(body, port)
        for body, port in zip((first, second), hinge.ports, strict=True)
    )
    if hinge.misfit_of_ports:
        # The frames of the hinge are halfway between its ports.
        gap = se2.between(a, b)
        middle = se2.compose(a, se2.exp(se2.twist(gap) / 2))
        return middle, misfit_numbers(se2.inverse(gap))
    known = all_concrete([se2.between(a, b), a, b, *hinge.ports])
    if known is not None:
        gap, *poses = known
        length = 1e-12 + max(np.max(np.abs(pose[1:])) for pose in poses)
        too_large = np.abs(gap) > 1e-9 * np.array([1.0, length, length])
        if np.any(too_large):
            raise ValueError(
                f"The ports of the hinge {hinge.name!r} do not coincide in the reference "
                f"configuration. Relative to port a on {hinge.first!r}, port b on "
                f"{hinge.second!r} is rotated by {gap[0]:.6g} rad and displaced by "
                f"({gap[1]:.6g}, {gap[2]:.6g}) m. Move a port or a body, or give `at`. "
                'If the hinge is bent into place, give `misfit="ports"`.'
            )
    return a, misfit
