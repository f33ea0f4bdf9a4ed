"""Flexures that are divided into segments, each with a surrogate of its own."""

import math
from functools import partial
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import TypeAliasType

from .._utils.compilation import fast_compile
from .._utils.host import all_concrete, concrete
from .._utils.types import (
    Corners,
    NumberLike,
    Pose,
    PoseLike,
    Poses,
    Scalar,
    Wrench,
    Wrenches,
)
from .._utils.validation import (
    require_float64,
    require_instance,
    require_interval,
    require_pose,
    require_positive,
    require_text,
)
from ..energies.validity import WithValidityRange
from ..geometry import se2
from ..mechanism.body import Body
from ..mechanism.expansion import Expansion
from ..mechanism.hinge import Hinge
from .beam import arc_rotation, Beam, is_constant, is_uniform, load_units
from .beam_solution import (
    beam_under_load,
    end_section,
    pose_and_wrench,
    position_of,
    reference_ends,
)
from .samples import low_discrepancy_points
from .surrogate import surrogate


_LARGEST_FORCE = 5.0  # in one segment, in E I / l^2
_LARGEST_ROTATION = 1.2  # of one segment; rad
_MOST_SEGMENTS = 24
_LOADS = 1000  # for the error estimate


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
    """

    bodies: tuple[Body, ...]
    hinges: tuple[Hinge, ...]
    error: Wrench


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
    error: float = 1e-3,
) -> Chain:
    """Divide a flexure into segments with surrogates, for large loads and displacements.

    One surrogate is valid up to forces of about 5 E I / L^2, where a beam in compression
    buckles between its ends. Divided into n segments, the flexure is valid up to n^2
    times this force, in tension and in compression, and it buckles as the beam does.

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
        segments: Number of segments. By default it follows from the force and the
            rotation.
        error: Largest relative error of a component of the wrench of a segment. It cannot
            be checked if the beam is traced.

    Returns:
        The bodies and the hinges, which are added to those of a mechanism, and the error.
        If the material has a density, the bodies have the mass of the flexure, without
        the halves of the first and the last segment.

    Raises:
        ValueError: Double precision is disabled, the error is not reached, or an argument
            is out of its range.

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
    count = _count(relative_force, rotation) if segments == "auto" else segments
    if not isinstance(count, int) or not 1 <= count <= _MOST_SEGMENTS:
        raise ValueError(
            f"`segments` is {count!r}, but must be a whole number from 1 to "
            f'{_MOST_SEGMENTS}, or "auto".'
        )
    parts = [_segment(beam, count, k) for k in range(count)]
    largest = _segment_rotation(beam, count, rotation, relative_force, stress)
    energies = _energies(name, parts, largest, limit, error)
    # The errors are not differentiated, which saves compilation.
    errors = _errors(*jax.lax.stop_gradient((tuple(parts), energies, largest, limit)))
    worst = concrete(jnp.max(errors))
    if worst is not None and not worst <= error:
        raise ValueError(
            f"The flexure {name!r} in {count} segments has an error of {worst:.2g}, but "
            f"`error` is {error:g}. Divide it into more `segments`."
        )
    middles, ends, chords = _layout(tuple(parts), beam, pose)
    names = [f"{name} {k + 1}" for k in range(count)]
    sections = [first, *names[:-1], second]
    hinges = tuple(
        Hinge(
            names[k], sections[k], sections[k + 1], energies[k], middles[k],
            outline=beam_outline(parts[k]), expansion=_expansion(parts[k], chords[k]),
        )
        for k in range(count)
    )  # fmt: skip
    bodies = tuple(_body(names[k], ends[k], parts[k]) for k in range(count - 1))
    return Chain(bodies, hinges, errors)


def _count(relative_force: Scalar, rotation: Scalar) -> int:
    """Choose the number of segments for a force (in E I / L^2) and a rotation (rad)."""
    values = all_concrete([relative_force, rotation])
    if values is None:
        raise ValueError(
            '`segments` is "auto", but the beam, the `force`, or the `rotation` is '
            "traced. Give the number of segments."
        )
    by_force = math.ceil(math.sqrt(float(values[0]) / _LARGEST_FORCE) - 1e-9)
    by_rotation = math.ceil(float(values[1]) / _LARGEST_ROTATION - 1e-9)
    count = max(1, by_force, by_rotation)
    if count > _MOST_SEGMENTS:
        raise ValueError(
            f"A force of {float(values[0]):.4g} E I / L^2 needs {count} segments, but "
            f"the largest number is {_MOST_SEGMENTS}. Use a smaller `force`."
        )
    return count


def _segment(beam: Beam, count: int, k: int) -> Beam:
    """Return one of several segments of the same length."""
    middle = beam.length * ((k + 0.5) / count - 0.5)

    def shifted(function):
        if is_constant(function):
            return function
        return jax.tree_util.Partial(_shifted, function, middle)

    return eqx.tree_at(
        lambda beam: (beam.length, beam.profile, beam.curvature),
        beam,
        (
            beam.length / count,
            shifted(beam.profile),
            None if beam.curvature is None else shifted(beam.curvature),
        ),
        is_leaf=lambda leaf: leaf is None,
    )


def _shifted(function, shift: Scalar, position: Scalar) -> Scalar:
    """Evaluate a function of the position (m) at a shifted position."""
    return function(position + shift)


def _segment_rotation(
    beam: Beam,
    count: int,
    rotation: Scalar,
    relative_force: Scalar,
    stress: Scalar | None,
) -> Scalar:
    """Bound the rotation of a segment; rad.

    Along an elastica, the square of the curvature changes by at most 4 F / E I, and at
    some section the curvature is the rotation of the ends over the length.
    """
    largest = jnp.asarray(_LARGEST_ROTATION)
    if beam.curvature is None:
        bound = jnp.sqrt(rotation**2 + 4 * relative_force) / count
        largest = jnp.minimum(largest, bound)
    if stress is None:
        return largest
    return jnp.minimum(largest, arc_rotation(beam, stress) / count)


def _energies(
    name: str, parts: list[Beam], rotation: Scalar, force: Scalar, error: float
) -> list[WithValidityRange]:
    """Compute the surrogates of the segments."""
    count = len(parts)
    if is_uniform(parts[0]):
        parts = parts[:1]
    energies: list[WithValidityRange] = []
    for k, part in enumerate(parts):
        try:
            energies.append(surrogate(part, rotation=rotation, force=force, error=error))
        except ValueError as found:
            raise ValueError(
                f"Segment {k + 1} of the flexure {name!r}: {found} Or divide the flexure "
                "into more `segments`."
            ) from None
    return energies * (count // len(energies))


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
    middle = (len(parts) - 1) / 2
    unit = load_units(parts[len(parts) // 2])[0]

    def displace(wrench: Wrench, part: Beam) -> tuple[Wrench, tuple[Pose, Wrench]]:
        """Apply a wrench on the first end of a segment to the whole segment."""
        ends = reference_ends(part)
        scale = jnp.stack([jnp.ones(()), part.length, part.length])
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
        arm = (middle + 0.5) * parts[0].length
        load = jnp.stack([moment + arm * transverse, axial, transverse])
        return jax.lax.scan(displace, load, stacked)[1]

    points = jnp.asarray(low_discrepancy_points(_LOADS, start=0.25))
    poses, wrenches = jax.vmap(under_load)(points)
    inside = jnp.all(jnp.abs(poses[..., 0]) <= rotation, axis=1)
    found = [jax.vmap(energies[k].energy.wrench)(poses[:, k]) for k in range(len(parts))]
    change = jnp.where(inside[:, None, None], jnp.stack(found, axis=1) - wrenches, 0.0)
    exact = jnp.where(inside[:, None, None], wrenches, 0.0)
    return jnp.sqrt(jnp.sum(change**2, axis=(0, 1)) / jnp.sum(exact**2, axis=(0, 1)))


@jax.jit
def _layout(parts: tuple[Beam, ...], beam: Beam, at: Pose) -> tuple[list, list, list]:
    """Compute the poses of the middles of all segments, and of their second ends.

    The distances of the ends of each segment along its axis 1 are returned as well; m.
    """

    def in_meters(part: Beam) -> tuple[Pose, Pose]:
        scale = jnp.stack([jnp.ones(()), part.length, part.length])
        ends = reference_ends(part)
        return scale * ends.first, scale * ends.second

    end = se2.compose(at, in_meters(beam)[0])
    middles, ends, chords = [], [], []
    for part in parts:
        to_first, to_second = in_meters(part)
        middle = se2.compose(end, se2.inverse(to_first))
        end = se2.compose(middle, to_second)
        middles.append(middle)
        ends.append(end)
        chords.append(to_second[1] - to_first[1])
    return middles, ends, chords


def _body(name: str, pose: Pose, before: Beam) -> Body:
    """Create the body after a segment, with half the mass of it and of the next one."""
    density = before.material.density
    if density is None:
        return Body(name, pose)
    step = before.length
    thickness = before.profile(step / 2)
    mass = density * before.width * step * thickness
    return Body(
        name, pose, mass=mass, inertia=mass * (step**2 + thickness**2) / 12,
        expansion=before.material.expansion,
    )  # fmt: skip


@partial(jax.jit, static_argnames="points")
def beam_outline(part: Beam, points: int = 12) -> Corners:
    """Compute the outline of a segment in its frame, for drawing; m."""
    if part.curvature is None:
        positions = part.length * jnp.asarray(np.linspace(-0.5, 0.5, points))
        zero = jnp.zeros_like(positions)
        line = jnp.stack([zero, positions, zero], axis=1)
    else:
        line = beam_under_load(part, jnp.zeros(3), points).centerline
        parameters = jnp.asarray(np.linspace(-1.0, 1.0, points))
        positions = part.length * jax.vmap(position_of)(parameters)[0]
    half = jax.vmap(part.profile)(positions) / 2
    directions = jnp.stack([-jnp.sin(line[:, 0]), jnp.cos(line[:, 0])], axis=1)
    normal, axis = half[:, None] * directions, line[:, 1:]
    return jnp.concatenate([axis + normal, (axis - normal)[::-1]])


def _expansion(part: Beam, chord: Scalar) -> Expansion | None:
    """Return the thermal expansion of a segment; None if its material has none.

    Its ends have the distance `chord` (m) along axis 1, which is less than its length if
    it is curved.
    """
    if part.material.expansion is None:
        return None
    return Expansion(part.material, length=chord)
