"""Displacements and wrenches of flexures, to which surrogates are fitted."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..._compile.compilation import fast_compile
from ..._utils.types import Count, Flag, Matrix, Pose, Scalar, Wrench
from ..beams.beam import Beam, load_units
from ..beams.under_load import end_section, pose_and_wrench, reference_ends


SAMPLES = 800  # for the fit; half as many more are for the error estimate
_STEPS = 10  # of Newton's method
# Smallest range of forces, in E I / L^2. In smaller ones, rounding errors of the
# displacements along a beam that is bent are those of large forces.
_LEAST_FORCE = 0.02
# Error of the rotations after which one more step of Newton's method is exact; rad
_CORRECTED = 1e-8


class Samples(NamedTuple):
    """Displacements of a beam and their wrenches."""

    poses: Float[Array, "samples 3"]  # Poses of frame b relative to frame a; rad, m, m
    # Wrenches that body B exerts on the beam, in frame b; N m, N, N
    wrenches: Float[Array, "samples 3"]
    # Magnitude of computed minus prescribed rotation; rad
    rotation_error: Float[Array, " samples"]
    # Smallest force at which the prescribed rotation was not reached, infinite if there
    # is none; N
    least_failed_force: Scalar
    force: Scalar  # Largest force; N
    # Stiffness of the beam in the reference configuration; N m/rad, N/rad, N/m
    stiffness: Matrix


class _Search(NamedTuple):
    """State of the search for the moments that cause the rotations of the samples."""

    moments: Float[Array, " samples"]  # Over their unit
    error: Scalar  # Largest error of a rotation before the last step; rad
    steps: Count


@fast_compile
def sample_beam(beam: Beam, rotation: Scalar, force: Scalar | None) -> Samples:
    """Compute a beam at rotations and forces that are uniformly distributed.

    Rotation (rad) and force (N) are the largest ones. The samples for the fit are
    followed by those for the error estimate.
    """
    units, ends = load_units(beam), reference_ends(beam)

    def displace(load: Wrench) -> tuple[Pose, Wrench]:
        end = end_section(beam, load, ends)
        return pose_and_wrench(beam, load * units, end, ends)

    stiffness = jnp.linalg.inv(
        jax.jacfwd(lambda load: displace(load)[0])(jnp.zeros(3)) / units[None]
    )
    unit = stiffness[0, 0] / beam.length
    limit = 5 * unit if force is None else jnp.maximum(force, _LEAST_FORCE * unit)
    # The samples are constants for differentiation; only their poses and wrenches at
    # given loads depend on the beam.
    constant_beam, constant_ends, largest_rotation, largest_force, compliance = (
        lax.stop_gradient(
            (beam, ends, rotation, limit / units[1], units[0] / stiffness[0, 0])
        )
    )

    for_fit = low_discrepancy_points(SAMPLES)
    for_error = low_discrepancy_points(SAMPLES // 2, start=0.5)
    points = jnp.asarray(np.concatenate([for_fit, for_error]))
    targets = largest_rotation * (2 * points[:, 0] - 1)
    directions = 2 * np.pi * points[:, 2]
    directions = jnp.stack([jnp.cos(directions), jnp.sin(directions)], axis=1)
    forces = (largest_force * jnp.sqrt(points[:, 1]))[:, None] * directions

    def rotation_at(moment: Scalar, force: Float[Array, "2"]) -> Scalar:
        load = jnp.concatenate([moment[None], force])
        end = end_section(constant_beam, load, constant_ends)
        return end.angle - constant_ends.second[0]

    def correct(state: _Search) -> _Search:
        """Correct all moments by a step of Newton's method."""
        moments, _, steps = state
        ones = jnp.ones_like(moments)
        rotations, slopes = jax.jvp(
            lambda moments: jax.vmap(rotation_at)(moments, forces), (moments,), (ones,)
        )
        # A larger step could lead to a solution with another number of windings.
        changes = jnp.clip(targets - rotations, -1.0, 1.0)
        moments = moments + changes / jnp.maximum(slopes, 0.03 * compliance)
        return _Search(moments, jnp.max(jnp.abs(changes)), steps + 1)

    def unfinished(state: _Search) -> Flag:
        return ~(state.error <= _CORRECTED) & (state.steps < _STEPS)

    start = _Search(targets / compliance, jnp.array(jnp.inf), jnp.zeros((), int))
    moments = lax.while_loop(unfinished, correct, start).moments
    loads = jnp.concatenate([moments[:, None], forces], axis=1)
    poses, wrenches = jax.vmap(displace)(lax.stop_gradient(loads))
    errors = jnp.abs(lax.stop_gradient(poses[:, 0]) - targets)
    errors = jnp.where(jnp.isfinite(errors), errors, jnp.inf)
    forces = units[1] * jnp.linalg.norm(loads[:, 1:], axis=1)
    least_failed_force = jnp.min(jnp.where(errors < 1e-6, jnp.inf, forces))
    return Samples(poses, wrenches, errors, least_failed_force, limit, stiffness)


def low_discrepancy_points(count: int, start: float = 0.0) -> np.ndarray:
    """Return uniformly distributed points of the unit cube, one in each row.

    The points are multiples of powers of the generalized golden ratio, modulo 1. Another
    `start` shifts all points.
    """
    golden = 1.2207440846057596  # the root of x^4 = x + 1
    steps = golden ** -np.arange(1.0, 4.0)
    return (start + np.arange(1, count + 1)[:, None] * steps) % 1
