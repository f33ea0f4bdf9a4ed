"""Flexures that are divided into segments, each with a surrogate of its own."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int
from typing_extensions import TypeAliasType

from ..._compile.compilation import fast_compile
from ..._utils.host import all_concrete, as_float, concrete, is_traced
from ..._utils.progress import announced
from ..._utils.types import (
    Corners,
    NumberLike,
    Pose,
    PoseLike,
    Poses,
    Scalar,
    Wrench,
    Wrenches,
)
from ..._utils.validation import (
    require_float64,
    require_instance,
    require_interval,
    require_pose,
    require_positive,
    require_text,
)
from ...energies.validity import WithValidityRange
from ...geometry import se2
from ...mechanism.body import Body
from ...mechanism.hinge import Hinge
from ...mechanism.material import Expansion
from ..beams.beam import (
    arc_rotation,
    Beam,
    breaks_of,
    is_uniform,
    load_units,
    pose_units,
    Uniform,
)
from ..beams.stress_models import BeamStress
from ..beams.under_load import (
    beam_under_load,
    end_section,
    ends_and_centroid,
    pose_and_wrench,
    position_of,
    reference_ends,
)
from ..leaf import leaf_outline
from ..surrogates.samples import low_discrepancy_points
from ..surrogates.surrogate import surrogate


_LARGEST_FORCE = 5.0  # in one segment, in E I / l^2
_LARGEST_ROTATION = 1.2  # of one segment; rad
_MOST_SEGMENTS = 24
# Segments for an error of 0.3 % in the natural frequencies of a uniform leaf whose ends
# are clamped, pinned, guided, or free: a number for each mode, and two more.
_SEGMENTS_PER_MODE = 2.4
_END_LENGTH = np.sqrt(0.5)  # of a segment, over that of an inner one; see `_masses`
_LOADS = 1000  # for the error estimate

# Outlines and masses of beams that are not straight or not of uniform thickness
_POINTS = 2**11 + 1  # of the integrals; corners are selected from them
_CHORD_ERROR = 5e-5  # relative to the smallest thickness
_LARGEST_TURN = 0.05  # between two chords; rad. Denser ones are recognized as arcs.
_TRACED_CORNERS = 97  # on each side of a beam whose dimensions are not known


# Number of segments
SegmentsLike = TypeAliasType("SegmentsLike", int | Literal["auto"])


class Chain(NamedTuple):
    """A flexure as bodies and hinges of a mechanism.

    Args:
        bodies: The bodies between the segments, in order.
        hinges: The segments, in order.
        error: Relative error of (moment, axial force, transverse force) of the segments:
            the rms error divided by the rms value, under loads of the whole flexure that
            are not used in the fit.
        end_masses: Masses at the two ends of the flexure, which belong to bodies A and B;
            None without a density; kg.
    """

    bodies: tuple[Body, ...]
    hinges: tuple[Hinge, ...]
    error: Wrench
    end_masses: tuple[Scalar, Scalar] | None = None


@announced("chain")
def chain(
    name: str,
    beam: Beam,
    first: str,
    second: str,
    at: PoseLike,
    *,
    rotation: NumberLike = 1.0,
    force: NumberLike | None = None,
    stress: NumberLike | None = None,
    segments: SegmentsLike = "auto",
    modes: int = 0,
    error: float = 1e-3,
) -> Chain:
    """Divide a flexure into segments with surrogates, for large loads and displacements.

    One surrogate is valid up to forces of about 5 E I / L^2, where a beam in compression
    buckles between its ends. Divided into n segments, the flexure is valid up to n^2
    times this force, in tension and in compression, and it buckles as the beam does.

    If the material has a density, the bodies between the segments have the mass of the
    flexure, and the rotary inertia of its cross-section. What is left are `end_masses` at
    the ends of the flexure. Add such a mass to that of body A or B if this body can move.
    By default the number of segments is that for statics, and too small for frequencies.
    If `modes` or `segments` are given, their errors decrease with the fourth power of the
    number of segments, because the segments at the ends are shorter than the others by
    the factor 0.707; with its second power if the thickness is not constant.

    Args:
        name: Name of the flexure. The segments are "name 1", "name 2", and so on, and the
            body after each segment has the name of this segment.
        beam: A beam of any profile and curvature.
        first: Name of body A, to which the first end of the beam is fixed.
        second: Name of body B, to which its second end is fixed.
        at: Pose of the middle of the undeformed beam in the world, with axis 1 along the
            beam, in the reference configuration; rad, m, m.
        rotation: Largest rotation of body B relative to body A, in both directions; rad.
        force: Largest magnitude of the force, in any direction; N. The default is 25
            E I / L^2.
        stress: Allowable stress in bending, which limits the rotation of the segments;
            Pa. By default there is no limit.
        segments: Number of segments. By default it follows from the force, the rotation,
            and the `modes`.
        modes: Number of natural frequencies of bending between the ends of the flexure
            that shall have an error of at most 0.3 %, for a constant thickness. They need
            2.4 segments for each mode, and two more.
        error: Largest relative error of a component of the wrench of a segment. It cannot
            be checked if the beam is traced.

    Returns:
        The bodies and the hinges, which are added to those of a mechanism, the error, and
        the masses at the ends.

    Raises:
        ValueError: Double precision is disabled, the error is not reached, or an argument
            is out of its range.

    Source:
        Lumped masses with the exact static stiffness have errors of the fourth order:
        Leckie and Lindberg, The effect of lumped parameters on beam frequencies,
        Aeronautical Quarterly 14, 1963. The masses at the ends are those of a
        trapezoidal rule with corrections by the formula of Euler and Maclaurin.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3)
        >>> leaf = Beam(steel, length=0.1, thickness=0.5e-3, width=10e-3)
        >>> flexure = chain("leaf", leaf, "wall", "stage", at=(0.0, 0.05, 0.0))
        >>> bodies = [tj.Body("wall"), tj.Body("stage", (0.0, 0.1, 0.0))]
        >>> mechanism = tj.Mechanism(
        ...     [*bodies, *flexure.bodies], flexure.hinges, fixed=["wall"]
        ... )
        >>> weight = tj.Load("stage", force=(0.0, -2.0))
        >>> tj.equilibrium(mechanism, loads=[weight]).displacement("stage")[2]
        Array(-0.02799..., dtype=float64)
    """
    require_instance("beam", beam, Beam)
    require_float64(beam.length)
    require_text("The name of a flexure", name)
    pose = require_pose(f"`at` of the flexure {name!r}", at)
    requirement = "must be positive and at most 2 pi"
    rotation = require_interval("`rotation`", rotation, 0.0, 2 * np.pi, requirement)
    unit = beam.rotational_stiffness / beam.length
    limit = 25 * unit if force is None else require_positive("`force`", force)
    if stress is not None:
        stress = require_positive("`stress`", stress)
    relative_force = limit / unit
    if not isinstance(modes, int) or modes < 0:
        raise ValueError(
            f"`modes` is {modes!r}, but must be a whole number, zero or more."
        )
    density, count = beam.material.density, segments
    if modes and density is None:
        raise ValueError(
            "`modes` is given, but the material has no `density`: "
            "`Material(..., density=7850.0)`."
        )
    if segments == "auto":
        count = _count(relative_force, rotation, modes)
    if not isinstance(count, int) or not 1 <= count <= _MOST_SEGMENTS:
        raise ValueError(
            f"`segments` is {count!r}, but must be a whole number from 1 to "
            f'{_MOST_SEGMENTS}, or "auto".'
        )
    corrected = density is not None and (modes > 0 or segments != "auto")
    shares = _lengths(count, corrected)
    parts = [_segment(beam, shares, k) for k in range(count)]
    longest = float(np.max(shares))
    largest = _segment_rotation(beam, longest, rotation, relative_force, stress)
    energies = _energies(name, parts, shares, largest, limit, error)
    # The errors are not differentiated, which saves compilation.
    errors = _errors(*jax.lax.stop_gradient((tuple(parts), energies, largest, limit)))
    worst = concrete(jnp.max(errors))
    if worst is not None and not worst <= error:
        raise ValueError(
            f"The flexure {name!r} in {count} segments has an error of {worst:.2g}, but "
            f"`error` is {error:g}. Divide it into more `segments`."
        )
    middles, ends = _layout(tuple(parts), beam, pose)
    names = [f"{name} {k + 1}" for k in range(count)]
    sections = [first, *names[:-1], second]
    hinges = tuple(
        Hinge(
            names[k], sections[k], sections[k + 1], energies[k], middles[k],
            outline=beam_outline(parts[k]), expansion=beam_expansion(parts[k]),
        )
        for k in range(count)
    )  # fmt: skip
    if density is None:
        bodies = [_body(names[k], ends[k], beam, None) for k in range(count - 1)]
        return Chain(tuple(bodies), hinges, errors)
    masses = _masses(parts, density, corrected)
    bodies = [_body(names[k], ends[k], beam, masses[k + 1]) for k in range(count - 1)]
    return Chain(tuple(bodies), hinges, errors, (masses[0, 0], masses[-1, 0]))


def _count(relative_force: Scalar, rotation: Scalar, modes: int) -> int:
    """Choose the number of segments for a force (in E I / L^2), a rotation, and modes."""
    values = all_concrete(jax.lax.stop_gradient([relative_force, rotation]))
    if values is None:
        raise ValueError(
            '`segments` is "auto", but the beam, the `force`, or the `rotation` is '
            "traced. Give the number of segments."
        )
    force, angle = map(float, values)
    by_modes = math.ceil(_SEGMENTS_PER_MODE * modes + 2) if modes else 1
    if by_modes > _MOST_SEGMENTS:
        raise ValueError(
            f"`modes` is {modes}, which needs {by_modes} segments, but the largest "
            f"number is {_MOST_SEGMENTS}. Use fewer modes."
        )
    shortest = max(math.sqrt(force / _LARGEST_FORCE), angle / _LARGEST_ROTATION)
    # For modes, the segments at both ends are shorter than the others; see `_lengths`.
    missing = 2 * (1 - _END_LENGTH) if modes else 0.0
    count = max(by_modes, math.ceil(shortest * (1 - 1e-9) + missing))
    if count > _MOST_SEGMENTS:
        raise ValueError(
            f"A force of {force:.4g} E I / L^2 needs {count} segments, but the largest "
            f"number is {_MOST_SEGMENTS}. Use a smaller `force`."
        )
    return count


def _lengths(count: int, corrected: bool) -> np.ndarray:
    """Return the length of each segment over that of the flexure; see `_masses`."""
    lengths = np.ones(count)
    if corrected:
        lengths[[0, -1]] = _END_LENGTH
    return lengths / np.sum(lengths)


def _masses(
    parts: list[Beam], density: Scalar, corrected: bool
) -> Float[Array, "nodes 2"]:
    """Compute the mass (kg) and the rotary inertia (kg m^2) of each end of a segment.

    They are those of a motion that is linear between the ends, so that the sum and the
    center are those of the flexure. If they are `corrected`, a third of the mass at the
    ends of the flexure is moved to the next places: with the shorter first and last
    segments, the error is of the fourth order if the thickness is constant. For two
    segments, this is Simpson's rule.
    """
    share = (np.arange(_POINTS) + 0.5) / _POINTS  # from the first end of a segment
    weights = jnp.asarray(np.stack([1 - share, share]) / _POINTS)

    def of_ends(part: Beam) -> Float[Array, "2 2"]:
        thickness = jax.vmap(part.profile)(part.length * (share - 0.5))
        mass = density * part.width * part.length * thickness
        return weights @ jnp.stack([mass, mass * thickness**2 / 12], axis=-1)

    nodes = jnp.zeros((len(parts) + 1, 2))
    for k, part in enumerate(parts):
        nodes = nodes.at[k : k + 2].add(of_ends(part))
    if corrected and len(parts) > 1:
        for end, following in ((0, 1), (-1, -2)):
            moved = nodes[end] / 3
            nodes = nodes.at[following].add(moved).at[end].add(-moved)
    return nodes


def _segment(beam: Beam, shares: np.ndarray, k: int) -> Beam:
    """Return one of several segments with these shares in the length."""
    middle = beam.length * float(np.sum(shares[:k]) + shares[k] / 2 - 0.5)

    def shifted(function):
        return function if isinstance(function, Uniform) else _Shifted(function, middle)

    return eqx.tree_at(
        lambda beam: (beam.length, beam.profile, beam.curvature),
        beam,
        (
            beam.length * float(shares[k]),
            shifted(beam.profile),
            None if beam.curvature is None else shifted(beam.curvature),
        ),
        is_leaf=lambda leaf: leaf is None,
    )


class _Shifted(eqx.Module):
    """A function of the position (m), with another origin of the position."""

    function: Callable[[Scalar], Scalar]
    shift: Scalar

    def __call__(self, position: Scalar) -> Scalar:
        return self.function(position + self.shift)

    @property
    def breaks(self) -> Float[Array, "4"] | None:
        breaks = breaks_of(self.function)
        return None if breaks is None else breaks - self.shift


def _segment_rotation(
    beam: Beam,
    share: float,
    rotation: Scalar,
    relative_force: Scalar,
    stress: Scalar | None,
) -> Scalar:
    """Bound the rotation of a segment with this share in the length; rad.

    Along an elastica, the square of the curvature changes by at most 4 F / E I, and at
    some section the curvature is the rotation of the ends over the length.
    """
    largest = jnp.asarray(_LARGEST_ROTATION)
    if beam.curvature is None:
        bound = jnp.sqrt(rotation**2 + 4 * relative_force) * share
        largest = jnp.minimum(largest, bound)
    if stress is None:
        return largest
    return jnp.minimum(largest, arc_rotation(beam, stress) * share)


def _energies(
    name: str,
    parts: list[Beam],
    shares: np.ndarray,
    rotation: Scalar,
    force: Scalar,
    error: float,
) -> list[WithValidityRange]:
    """Compute the surrogates of the segments.

    Segments of a uniform flexure with the same share in its length have the same one.
    """
    same = is_uniform(parts[0])
    of_share: dict[float, WithValidityRange] = {}
    energies: list[WithValidityRange] = []
    for k, part in enumerate(parts):
        if same and shares[k] in of_share:
            energies.append(of_share[shares[k]])
            continue
        try:
            energy = surrogate(part, rotation=rotation, force=force, error=error)
        except ValueError as found:
            raise ValueError(
                f"Segment {k + 1} of the flexure {name!r}: {found} Or divide the flexure "
                "into more `segments`."
            ) from None
        energies.append(energy)
        of_share[shares[k]] = energy
    return [_continued(energy, k, len(parts)) for k, energy in enumerate(energies)]


def _continued(energy: WithValidityRange, segment: int, count: int) -> WithValidityRange:
    """State at which ends of a segment others continue the flexure."""
    model = energy.stress_model
    assert isinstance(model, BeamStress)
    continues = as_float(np.array([segment > 0, segment < count - 1], float))
    return replace(energy, stress_model=replace(model, continues=continues))


@fast_compile
def _errors(
    parts: tuple[Beam, ...],
    energies: list[WithValidityRange],
    rotation: Scalar,
    force: Scalar,
) -> Wrench:
    """Compare the segments with exact beams, under loads of the whole flexure.

    Loads under which a segment rotates further than `rotation` (rad) are left out.
    """
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *parts)
    length = sum(part.length for part in parts)
    unit = load_units(parts[len(parts) // 2])[0]

    def displace(wrench: Wrench, part: Beam) -> tuple[Wrench, tuple[Pose, Wrench]]:
        """Apply a wrench on the first end of a segment to the whole segment."""
        ends = reference_ends(part)
        scale = pose_units(part)
        load = se2.transform_wrench(scale * ends.first, wrench)
        end = end_section(part, load / load_units(part), ends)
        pose, on_second = pose_and_wrench(part, load, end, ends)
        to_second = se2.inverse(scale * ends.second)
        return se2.transform_wrench(to_second, on_second), (pose, on_second)

    def under_load(point: Float[Array, "3"]) -> tuple[Poses, Wrenches]:
        direction = 2 * np.pi * point[2]
        magnitude = force * jnp.sqrt(point[1])
        axial, transverse = magnitude * jnp.cos(direction), magnitude * jnp.sin(direction)
        # The moment in the middle of the undeformed flexure is within the range.
        moment = unit * rotation * (2 * point[0] - 1)
        load = jnp.stack([moment + length / 2 * transverse, axial, transverse])
        return jax.lax.scan(displace, load, stacked)[1]

    points = jnp.asarray(low_discrepancy_points(_LOADS, start=0.25))
    poses, wrenches = jax.vmap(under_load)(points)
    inside = jnp.all(jnp.abs(poses[..., 0]) <= rotation, axis=1)
    found = [jax.vmap(energies[k].energy.wrench)(poses[:, k]) for k in range(len(parts))]
    change = jnp.where(inside[:, None, None], jnp.stack(found, axis=1) - wrenches, 0.0)
    exact = jnp.where(inside[:, None, None], wrenches, 0.0)
    return jnp.sqrt(jnp.sum(change**2, axis=(0, 1)) / jnp.sum(exact**2, axis=(0, 1)))


@jax.jit
def _layout(parts: tuple[Beam, ...], beam: Beam, at: Pose) -> tuple[list, list]:
    """Compute the poses of the middles of all segments, and of their second ends."""

    def in_meters(part: Beam) -> tuple[Pose, Pose]:
        scale, ends = pose_units(part), reference_ends(part)
        return scale * ends.first, scale * ends.second

    end = se2.compose(at, in_meters(beam)[0])
    middles, ends = [], []
    for part in parts:
        to_first, to_second = in_meters(part)
        middle = se2.compose(end, se2.inverse(to_first))
        end = se2.compose(middle, to_second)
        middles.append(middle)
        ends.append(end)
    return middles, ends


def _body(name: str, pose: Pose, beam: Beam, masses: Float[Array, "2"] | None) -> Body:
    """Create the body between two segments, from its mass and its rotary inertia."""
    mass = inertia = tilt_inertia = None
    if masses is not None:
        mass, inertia = masses
        along = mass * beam.width**2 / 12
        tilt_inertia = jnp.diag(jnp.stack([inertia + along, along]))
    expansion = beam.material.expansion
    return Body(name, pose, mass, inertia, expansion=expansion, tilt_inertia=tilt_inertia)


def beam_outline(part: Beam) -> Corners:
    """Compute the outline of a beam in its frame; m.

    The distance of the edges from the outline is below 1e-4 of the smallest thickness,
    and the thinnest place is a corner, unless the beam is traced.
    """
    if is_uniform(part) and part.curvature is None:
        thickness = part.profile(jnp.zeros(()))
        return leaf_outline(length=part.length, thickness=thickness, points=12)
    parameters = np.linspace(-1.0, 1.0, _POINTS)
    sides = _sides(part, parameters)
    if is_traced(sides):
        rows = np.linspace(0, len(sides) - 1, _TRACED_CORNERS).astype(int)
        return jnp.concatenate([sides[rows, 0], sides[rows[::-1], 1]])
    known = np.asarray(sides)
    if part.curvature is None:
        for _ in range(2):
            parameters = _denser(parameters, known)
            known = np.asarray(_sides(part, parameters))
    rows = _corner_rows(known)
    return as_float(np.concatenate([known[rows, 0], known[rows[::-1], 1]]))


@jax.jit
def _sides(
    part: Beam, parameters: Float[ArrayLike, " points"]
) -> Float[Array, "points 2 2"]:
    """Compute points on both sides of a beam in its frame, at increasing parameters; m.

    The parameters are those of `position_of`; for a curved beam they have equal steps.
    """
    positions = part.length * jax.vmap(position_of)(jnp.asarray(parameters))[0]
    if part.curvature is None:
        zero = jnp.zeros_like(positions)
        line = jnp.stack([zero, positions, zero], axis=1)
    else:
        line = beam_under_load(part, jnp.zeros(3), _POINTS).centerline
    half = jax.vmap(part.profile)(positions) / 2
    directions = jnp.stack([-jnp.sin(line[:, 0]), jnp.cos(line[:, 0])], axis=1)
    normal, axis = half[:, None] * directions, line[:, 1:]
    return jnp.stack([axis + normal, axis - normal], axis=1)


def _denser(
    parameters: Float[np.ndarray, " points"], sides: Float[np.ndarray, "points 2 2"]
) -> Float[np.ndarray, " points"]:
    """Return as many parameters that are denser where the sides (m) are curved more."""
    bends = np.linalg.norm(np.diff(sides, 2, axis=0), axis=-1)
    share = np.pad(np.sqrt(np.max(bends, axis=1)), 1, "edge")
    share = share / max(np.sum(share), np.finfo(float).tiny) + 0.1 / len(share)
    total = np.cumsum(share)
    denser = np.interp(np.linspace(total[0], total[-1], len(total)), total, parameters)
    thickness = np.hypot(*(sides[:, 0] - sides[:, 1]).T)
    thinnest = parameters[np.argmin(thickness)]
    denser[np.argmin(np.abs(denser - thinnest))] = thinnest
    return denser


def _corner_rows(
    sides: Float[np.ndarray, "points 2 2"],
) -> Int[np.ndarray, " corners"]:
    """Select those of many points on both sides of a beam (m) that become corners.

    Their number is rounded up, so that few programs are compiled for beams of different
    dimensions.
    """
    thickness = np.hypot(*(sides[:, 0] - sides[:, 1]).T)
    largest_distance = _CHORD_ERROR * np.min(thickness)
    steps = np.diff(sides, axis=0)
    before, after = steps[:-1], steps[1:]
    cross = before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]
    turn = np.abs(np.arctan2(cross, np.sum(before * after, axis=-1)))
    turned = np.cumsum(np.pad(np.max(turn, axis=1), (1, 1)))
    rows = np.arange(len(sides))
    corners = np.unique([*np.linspace(0, rows[-1], 25).astype(int), np.argmin(thickness)])
    while True:
        interval = np.minimum(np.searchsorted(corners, rows, "right"), len(corners) - 1)
        start, end = sides[corners[interval - 1]], sides[corners[interval]]
        chord, arm = end - start, sides - start
        cross = chord[..., 0] * arm[..., 1] - chord[..., 1] * arm[..., 0]
        distance = np.max(np.abs(cross) / np.linalg.norm(chord, axis=-1), axis=1)
        largest = np.maximum.reduceat(distance, corners[:-1])
        long = (largest > largest_distance) | (np.diff(turned[corners]) > _LARGEST_TURN)
        long &= np.diff(corners) > 1
        if not np.any(long):
            return _padded(corners)
        middles = (corners[:-1] + corners[1:]) // 2
        corners = np.unique(np.concatenate([corners, middles[long]]))


def _padded(corners: Int[np.ndarray, " corners"]) -> Int[np.ndarray, " more"]:
    """Divide the longest chords until their number is 24 times a power of two."""
    chords = 24
    while chords < len(corners) - 1:
        chords *= 2
    while (missing := chords + 1 - len(corners)) > 0:
        longest = np.argsort(-np.diff(corners), kind="stable")[:missing]
        middles = (corners[longest] + corners[longest + 1]) // 2
        corners = np.sort(np.concatenate([corners, middles]))
    return corners


def beam_expansion(beam: Beam) -> Expansion | None:
    """Compute the thermal expansion of a hinge that is a beam.

    Args:
        beam: The beam, straight or curved.

    Returns:
        The expansion; None if the material has no coefficient of expansion.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(210e9, poisson=0.3, expansion=12e-6)
        >>> arc = Beam(steel, length=0.1, thickness=1e-3, width=0.01, curvature=10.0)
        >>> beam_expansion(arc).ends
        Array([[-0.0479...,  0.0122...],
               [ 0.0479...,  0.0122...]], dtype=float64)
    """
    if beam.material.expansion is None:
        return None
    if beam.curvature is None:
        return Expansion(beam.material, length=beam.length)
    ends, centroid = ends_and_centroid(beam)
    return Expansion(beam.material, ends=ends, arc_length=beam.length, centroid=centroid)
