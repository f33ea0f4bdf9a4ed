"""Check that hinges are at the bodies that they connect."""

from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from .._utils.host import all_concrete, concrete
from .._utils.validation import warn
from ..energies.base import AbstractEnergy, AbstractWrapper
from ..energies.quadratic import Quadratic
from ..energies.stress_model import stress_model
from .body import Body
from .copies import PartCopies
from .hinge import AbstractOutline, Hinge


# Distances of an end of a flexure from the outline of its body, relative to the length:
# above the first, both ends are reported if they would meet their bodies farther along
# the axis; up to the second, an end is on this body; above the third, it is reported
_SHORT, _NEAR, _FAR = 0.05, 0.1, 0.25
# Distance from the origin of a body without an outline, relative to the length, above
# which a position seems to be in millimeters
_FARTHEST = 300


def warn_if_misplaced(
    hinges: Sequence[PartCopies[Hinge]],
    bodies: Sequence[PartCopies[Body]],
    ends: Sequence[tuple[int, int]],
    frames: Float[Array, "hinges 3"],
) -> None:
    """Warn of flexures that do not connect their bodies where these are.

    Axis 1 of a flexure points from its first body, on which its start is, to its second
    one. The direction matters if tension and compression differ. If a body has no
    outline, only large distances from its origin are found. Flexures of unknown length,
    and copies, are not checked.
    """
    known = concrete(frames)
    if known is None:
        return
    rows = [(copies, k) for copies in bodies for k in range(len(copies))]
    start = 0
    for copies in hinges:
        hinge, of_bodies, frame = copies.part, ends[start], known[start]
        start += len(copies)
        length = _length(hinge) if len(copies) == 1 else None
        if not length:  # unknown, or an outline without an extent along axis 1
            continue
        pair = [rows[body][0][rows[body][1]] for body in of_bodies]
        has_outlines = all(body.outline is not None for body in pair)
        fault = (_fault_of_ends if has_outlines else _fault_of_center)(
            hinge, pair, frame, length
        )
        if fault is not None:
            warn(fault)


def _fault_of_center(
    hinge: Hinge, bodies: Sequence[Body], frame: Float[np.ndarray, "3"], length: float
) -> str | None:
    """Describe a flexure that is far from the origins of its bodies for its length."""
    poses = all_concrete([body.pose for body in bodies])
    if poses is None:
        return None
    distance = max(np.linalg.norm((frame - pose)[1:]) for pose in poses)
    if distance <= _FARTHEST * length:
        return None
    return (
        f"The hinge {hinge.name!r}, of length {length:.4g} m, is {distance:.4g} m away "
        "from the origin of one of its bodies. Positions are in meters: 50 mm is 50e-3."
    )


def _fault_of_ends(
    hinge: Hinge, bodies: Sequence[Body], frame: Float[np.ndarray, "3"], length: float
) -> str | None:
    """Describe a flexure whose ends are far from the outlines of its bodies."""
    axis = np.array([np.cos(frame[0]), np.sin(frame[0])])

    def tips() -> Float[np.ndarray, "2 2"]:
        return frame[1:] + np.outer([-length / 2, length / 2], axis)

    if max(_gaps(bodies, tips())) > _SHORT * length:
        length = _contour_length(hinge) or length
    gaps = _gaps(bodies, tips())
    farther = tips() + np.outer([-gaps[0], gaps[1]], axis)
    if min(gaps) > _SHORT * length and max(_gaps(bodies, farther)) < 1e-6 * length:
        return (
            f"The hinge {hinge.name!r}, of length {length:.4g} m, is {sum(gaps):.4g} m "
            f"shorter than the distance of the outlines of its bodies, {hinge.first!r} "
            f"and {hinge.second!r}, along its axis. Check its length, and the outlines."
        )
    if max(gaps) <= _NEAR * length:
        return None
    if max(_gaps(bodies[::-1], tips())) <= _NEAR * length:
        if _is_symmetric(hinge.energy):
            return None
        return (
            f"The start of the hinge {hinge.name!r} is on its second body, "
            f"{hinge.second!r}, and its end on its first one, {hinge.first!r}. Exchange "
            "`first` and `second`, or turn the hinge by pi: axis 1 points from the first "
            "body to the second."
        )
    if max(gaps) <= _FAR * length:
        return None
    return (
        f"The start of the hinge {hinge.name!r}, of length {length:.4g} m, is "
        f"{gaps[0]:.4g} m away from the outline of its first body, {hinge.first!r}, and "
        f"its end {gaps[1]:.4g} m from that of its second, {hinge.second!r}. Check the "
        "pose `at` (angle, x, y) of its middle, whose axis 1 points from the first body "
        "to the second, and the outlines."
    )


def _gaps(bodies: Sequence[Body], tips: Float[np.ndarray, "2 2"]) -> list[float]:
    """Return the distances of two bodies from the start and the end of a hinge; m."""
    return [_distance(body, tip) for body, tip in zip(bodies, tips, strict=True)]


def _is_symmetric(energy: AbstractEnergy) -> bool:
    """Decide whether both bodies of a hinge may be exchanged, as in a quadratic form."""
    while isinstance(energy, AbstractWrapper):
        energy = energy.energy
    return isinstance(energy, Quadratic)


def _contour_length(hinge: Hinge) -> float | None:
    """Return the length of the contour of a flexure that has no outline; m.

    That of a leaf of the same stiffness, `flexure_length`, is shorter.
    """
    model = stress_model(hinge.energy)
    if hinge.outline is not None or model is None:
        return None
    if all_concrete(jax.tree.leaves(eqx.filter(model, eqx.is_array))) is None:
        return None
    outline = model.outline()
    is_curve = outline is None or isinstance(outline, AbstractOutline)
    return None if is_curve else float(np.ptp(np.asarray(outline)[:, 0]))


def _length(hinge: Hinge) -> float | None:
    """Return the length of a flexure along axis 1, if it is known; m."""
    if isinstance(hinge.outline, AbstractOutline):
        return None
    if hinge.outline is not None:
        corners = concrete(hinge.outline)
        return None if corners is None else float(np.ptp(corners[:, 0]))
    if hinge.expansion is not None:
        length = concrete(hinge.expansion.length)
        return None if length is None else float(length)
    length = hinge.energy.flexure_length
    known = None if length is None else concrete(length)
    return None if known is None else float(known)


def _distance(body: Body, point: Float[np.ndarray, "2"]) -> float:
    """Return the distance of a point in the world from the outline of a body; m.

    It is zero inside the outline, and for outlines that are traced.
    """
    known = all_concrete([body.pose, body.outline])
    if known is None:
        return 0.0
    (angle, *origin), corners = known
    cos, sin = np.cos(angle), np.sin(angle)
    local = np.array([[cos, sin], [-sin, cos]]) @ (point - np.array(origin))
    starts, edges = corners, np.roll(corners, -1, axis=0) - corners
    arms = local - starts
    lengths = np.maximum(np.sum(edges**2, axis=1), np.finfo(float).tiny)
    shares = np.clip(np.sum(arms * edges, axis=1) / lengths, 0, 1)
    distance = np.min(np.linalg.norm(arms - shares[:, None] * edges, axis=1))
    # The point is inside if a ray along x crosses an odd number of edges.
    crosses = (arms[:, 1] >= 0) != (arms[:, 1] >= edges[:, 1])
    slopes = np.where(crosses, edges[:, 1], 1.0)
    right = arms[:, 0] < arms[:, 1] * edges[:, 0] / slopes
    return 0.0 if np.sum(crosses & right) % 2 else float(distance)
