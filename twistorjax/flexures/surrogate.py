"""Polynomial surrogates of geometrically exact beams."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array, Float

from .._utils.compilation import fast_compile
from .._utils.host import all_concrete, concrete
from .._utils.types import Matrix, NumberLike, Pose, Scalar, Wrench
from .._utils.validation import (
    require_float64,
    require_instance,
    require_interval,
    require_positive,
)
from ..energies.fitting.mixed_equations import (
    mixed_equations,
    twists_and_stresses,
    weighted_equations,
)
from ..energies.mixed import MixedEnergy
from ..energies.monomials import monomials, Powers, Symmetry
from ..energies.validity import WithValidityRange
from .beam import Beam, load_units, uniform
from .beam_solution import end_section, pose_and_wrench, reference_ends


_ORDERS = (4, 6, 8, 10)
_SAMPLES = 800  # for the fit; half as many more are for the error estimate


def surrogate(
    beam: Beam,
    *,
    rotation: NumberLike,
    force: NumberLike | None = None,
    error: float = 1e-3,
    order: int | None = None,
) -> WithValidityRange:
    """Approximate the energy of a beam by a polynomial over a range of displacements.

    The energy is a `MixedEnergy`, which needs as few terms for a very slender leaf as for
    a thick one. In the reference configuration it has the stiffness of the beam. Its
    derivatives with respect to the dimensions of the beam have about the same relative
    error as its wrench. To compute surrogates of many beams, use `jax.jit` and
    `jax.lax.map`, and give `order`.

    Args:
        beam: A beam of any thickness profile.
        rotation: Largest rotation, in both directions; rad.
        force: Largest magnitude of the force, in any direction; N. The default is
            5 E I / L^2, for a leaf with the length L. Above about 10 E I / L^2, a beam in
            compression buckles between its ends, which a polynomial cannot represent.
        error: Largest relative error of a component of the wrench: the rms error divided
            by the rms value, on samples that are not used in the fit. If the beam is
            traced, the error cannot be checked, and is only returned.
        order: Order of the polynomial in the rotation and the transverse displacement: 4,
            6, 8 or 10. The default is the lowest order with an accepted error, or 6 if
            the beam is traced.

    Returns:
        The energy with its validity range. Its field `error` has the relative errors of
        the moment, the axial force and the transverse force. They are computed on
        separate samples, which are uniformly distributed over rotations and forces.

    Raises:
        ValueError: Double precision is disabled, the error is not reached, the beam
            buckles within the range, or an argument is out of its range.

    Source:
        The polynomial energies of section 4.7 of the dissertation, in the form of
        `MixedEnergy`, and fitted to a beam instead of measurements.

    Example:
        >>> import twistorjax as tj
        >>> polymer = tj.Material(modulus=3.45e9, poisson=0.3)
        >>> beam = Beam(polymer, length=10e-3, thickness=1e-3, width=5e-3)
        >>> energy = surrogate(beam, rotation=0.8)
        >>> load = jnp.array([0.05, 0.0, 2.0])  # N m, N, N
        >>> exact = tj.flexures.beam_under_load(beam, load)
        >>> energy.wrench(exact.pose)[2].round(2), exact.wrench[2].round(2)
        (Array(1.88, dtype=float64), Array(1.88, dtype=float64))
    """
    require_instance("beam", beam, Beam)
    require_float64(beam.length)
    rotation = require_interval(
        "`rotation`", rotation, 0.0, 2 * np.pi, "must be positive and at most 2 pi"
    )
    if not error > 0:
        raise ValueError(f"`error` is {error!r}, but must be positive.")
    if order is not None and order not in _ORDERS:
        raise ValueError(f"`order` is {order!r}, but must be one of {_ORDERS}.")
    if force is not None:
        force = require_positive("`force`", force)
    symmetry = _symmetry(beam)
    middle = beam.profile(jnp.zeros(()))
    samples = _sample(beam, rotation, force)
    if all_concrete([middle, rotation, *jax.tree.leaves(samples)]) is None:
        return _fit(_powers(order or 6, symmetry), beam.length, rotation, samples)
    limits = (
        f"a rotation of {float(rotation):.4g} rad and a force of "
        f"{float(samples.force):.4g} N"
    )
    if not float(jnp.max(samples.rotation_error)) < 1e-6:
        raise ValueError(
            f"The beam cannot be computed everywhere up to {limits}: from "
            f"{float(samples.least_failed_force):.3g} N on, no equilibrium is found at "
            "some rotations. A beam in compression buckles between its ends at about "
            "10 E I / L^2. Use a smaller `rotation` or `force`."
        )
    errors = {}
    for tried in _ORDERS if order is None else (order,):
        energy = _fit(_powers(tried, symmetry), beam.length, rotation, samples)
        errors[tried] = float(jnp.max(energy.error))
        if errors[tried] <= error:
            return energy
    listed = ", ".join(
        f"{worst:.2g} with order {tried}" for tried, worst in errors.items()
    )
    raise ValueError(
        f"The `error` of {error:g} is not reached up to {limits}; it is {listed}. Use a "
        "smaller range, or accept a larger `error`."
    )


class _Samples(NamedTuple):
    """Displacements of a beam and their wrenches.

    Args:
        poses: Poses of frame b relative to frame a; rad, m, m.
        wrenches: Wrenches that body B exerts on the beam, in frame b; N m, N, N.
        rotation_error: Magnitude of computed minus prescribed rotation; rad.
        least_failed_force: Smallest force at which the prescribed rotation was not
            reached, infinite if there is none; N.
        force: Largest force; N.
        stiffness: Stiffness of the beam in the reference configuration; N m/rad, N/rad,
            N/m.
    """

    poses: Float[Array, "samples 3"]
    wrenches: Float[Array, "samples 3"]
    rotation_error: Float[Array, " samples"]
    least_failed_force: Scalar
    force: Scalar
    stiffness: Matrix


@fast_compile
def _sample(beam: Beam, rotation: Scalar, force: Scalar | None) -> _Samples:
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
    limit = 5 * stiffness[0, 0] / beam.length if force is None else force
    # The samples are constants for differentiation; only their poses and wrenches at
    # given loads depend on the beam.
    constant_beam, constant_ends, largest_rotation, largest_force, compliance = (
        lax.stop_gradient(
            (beam, ends, rotation, limit / units[1], units[0] / stiffness[0, 0])
        )
    )

    def angle(moment: Scalar, force: Float[Array, "2"]) -> Scalar:
        load = jnp.concatenate([moment[None], force])
        end = end_section(constant_beam, load, constant_ends)
        return end.angle - constant_ends.second[0]

    def find_load(point: Float[Array, "3"]) -> tuple[Wrench, Scalar]:
        """Find the load of a point in the unit cube, and the error of its rotation."""
        target = largest_rotation * (2 * point[0] - 1)
        direction_angle = 2 * np.pi * point[2]
        direction = jnp.stack([jnp.cos(direction_angle), jnp.sin(direction_angle)])
        force = largest_force * jnp.sqrt(point[1]) * direction

        def newton_step(_, moment: Scalar) -> Scalar:
            one = jnp.ones_like(moment)
            value, slope = jax.jvp(lambda m: angle(m, force), (moment,), (one,))
            # A larger step could lead to a solution with another number of windings.
            residual = jnp.clip(target - value, -1.0, 1.0)
            return moment + residual / jnp.maximum(slope, 0.03 * compliance)

        moment = lax.fori_loop(0, 10, newton_step, target / compliance)
        rotation_error = jnp.abs(angle(moment, force) - target)
        return jnp.concatenate([moment[None], force]), rotation_error

    for_fit = low_discrepancy_points(_SAMPLES)
    for_error = low_discrepancy_points(_SAMPLES // 2, start=0.5)
    points = jnp.asarray(np.concatenate([for_fit, for_error]))
    loads, errors = jax.vmap(find_load)(points)
    poses, wrenches = jax.vmap(displace)(lax.stop_gradient(loads))
    errors = jnp.where(jnp.isfinite(errors), errors, jnp.inf)
    forces = units[1] * jnp.linalg.norm(loads[:, 1:], axis=1)
    least_failed_force = jnp.min(jnp.where(errors < 1e-6, jnp.inf, forces))
    return _Samples(poses, wrenches, errors, least_failed_force, limit, stiffness)


def low_discrepancy_points(count: int, start: float = 0.0) -> np.ndarray:
    """Return uniformly distributed points of the unit cube, one in each row.

    The points are multiples of powers of the generalized golden ratio, modulo 1. Another
    `start` shifts all points.
    """
    golden = 1.2207440846057596  # the root of x^4 = x + 1
    steps = golden ** -np.arange(1.0, 4.0)
    return (start + np.arange(1, count + 1)[:, None] * steps) % 1


def _symmetry(beam: Beam) -> tuple[Symmetry, ...]:
    """Return the symmetries that a beam is known to have."""
    along = [beam.profile] if beam.curvature is None else [beam.profile, beam.curvature]
    ends_equal = all(
        getattr(function, "func", None) is uniform or _is_even(function, beam.length)
        for function in along
    )
    if beam.curvature is None:
        return ("mirror", "ends") if ends_equal else ("mirror",)
    return ("arch",) if ends_equal else ()


def _is_even(function: Callable[[Scalar], Scalar], length: Scalar) -> bool:
    """Decide whether a function of the position is even; false if it is traced."""
    positions = jnp.asarray(np.linspace(-0.5, 0.5, 101)) * length
    values = concrete(jax.vmap(function)(positions))
    return values is not None and np.allclose(values, values[::-1], rtol=1e-9, atol=0)


def _powers(order: int, symmetry: tuple[Symmetry, ...]) -> Powers:
    """List the powers of the terms of a beam with some symmetries.

    The constant and the linear terms are left out, because the reference configuration
    has no energy, no displacement, and no load.
    """
    powers = monomials(order, "mixed", symmetry=symmetry)
    return tuple(row for row in powers if sum(row) > 1)


@partial(fast_compile, optimize=False)  # runs for 4 ms
def _fit(
    powers: Powers, length: Scalar, rotation: Scalar, samples: _Samples
) -> WithValidityRange:
    """Fit an energy, and estimate its error on the samples that are not fitted."""
    coefficients = _fit_coefficients(powers, length, samples)
    energy = MixedEnergy(coefficients, powers, length=length, force=samples.force)
    wrenches = jax.vmap(energy.wrench)(samples.poses[_SAMPLES:])
    exact = samples.wrenches[_SAMPLES:]
    square = jnp.mean((wrenches - exact) ** 2, axis=0)
    error = jnp.sqrt(square / jnp.mean(exact**2, axis=0))
    return WithValidityRange(energy, rotation, samples.force, error)


def _fit_coefficients(
    powers: Powers, length: Scalar, samples: _Samples
) -> Float[Array, " terms"]:
    """Fit the coefficients (J) that do not follow from the stiffness.

    All components of the wrench have the same relative weight.
    """
    poses, wrenches = samples.poses[:_SAMPLES], samples.wrenches[:_SAMPLES]
    rms = jnp.sqrt(jnp.mean(wrenches**2, axis=0))
    deviations = jnp.broadcast_to(rms, wrenches.shape)
    twists, stresses, to_wrenches = twists_and_stresses(poses, wrenches, deviations)
    equations = mixed_equations(
        powers, twists, stresses, to_wrenches, stresses[:, 1], length, samples.force
    )
    quadratic = _quadratic_coefficients(length, samples)
    zero = jnp.zeros(())
    start = jnp.stack([quadratic.get(row, zero) for row in powers])
    free = np.array([k for k, row in enumerate(powers) if row not in quadratic])

    def solve(coefficients: Float[Array, " terms"] | None) -> Float[Array, " terms"]:
        """Solve with the weights of a previous solution."""
        rows, targets = weighted_equations(equations, coefficients)
        rows, targets = rows.reshape(-1, len(powers)), targets.reshape(-1)
        found = _least_squares(rows[:, free], targets - rows @ start)
        return start.at[free].set(found)

    coefficients = solve(None)
    for _ in range(3):
        coefficients = solve(coefficients)
    return coefficients


def _quadratic_coefficients(
    length: Scalar, samples: _Samples
) -> dict[tuple[int, ...], Scalar]:
    """Return the coefficients that follow from the stiffness, and are not fitted; J."""
    (k00, k01, k02), (_, k11, k12), (_, _, k22) = samples.stiffness
    force = samples.force
    # The axial displacement is replaced by the axial force.
    return {
        (2, 0, 0): (k00 - k01**2 / k11) / 2,
        (1, 1, 0): (k02 - k01 * k12 / k11) * length,
        (0, 2, 0): (k22 - k12**2 / k11) * length**2 / 2,
        (1, 0, 1): force * k01 / k11,
        (0, 1, 1): force * length * k12 / k11,
        (0, 0, 2): -(force**2) / (2 * k11),
    }


def _least_squares(
    rows: Float[Array, "equations terms"], targets: Float[Array, " equations"]
) -> Float[Array, " terms"]:
    """Solve linear least squares by normal equations of columns of unit norm.

    Normal equations are easy to differentiate.
    """
    norms = jnp.sqrt(jnp.sum(rows**2, axis=0))
    scaled = rows / norms[None]
    factor = cho_factor(scaled.T @ scaled)
    return cho_solve(factor, scaled.T @ targets) / norms
