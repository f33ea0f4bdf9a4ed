"""Elastic and viscous forces of one hinge in motion, and their derivatives."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._compile.batching import computed_once
from .._utils.types import Scalar
from ..energies.base import AbstractEnergy
from ..energies.damping import ViscousDamping
from ..energies.natural_curvature import NaturallyCurved
from ..energies.strains import half_square, strain
from ..geometry.twistors import Displacement
from ..linalg.products import as_array, product
from .forces import (
    as_matrix,
    displacement_at,
    dot,
    energy_gradient,
    gradient_and_hessian,
    hinge_coordinates,
    on_bodies,
)
from .kinematics import Axis, End, HingeKinematics, Six, Three, Two


@jax.jit
def forces_in_motion(
    energy: AbstractEnergy,
    damping: ViscousDamping | None,
    first: End,
    second: End,
    axis: Axis,
    rates: tuple[Three, Three],
    translation: Two | None = None,
) -> tuple[Six, Two, Two]:
    """Compute elastic and viscous forces, the dissipated power, and that of the stroke.

    Args:
        axis: Axis of the hinge in the reference configuration, its misfit, and the rate
            of this misfit.
        rates: Rates of (angle, x, y) of both bodies; rad/s, m/s, m/s.
        translation: Mid-frame translation for which the forces are computed; by default
            that of the displacement. A solver may predict it, as Newton's method predicts
            the generalized stress; m.

    Returns:
        The forces (N m, N); the translation of the displacement minus the given one (m);
        and the powers (W).
    """
    kinematics = HingeKinematics.of(first, second, axis)
    angle = kinematics.middle.displacement.angle
    kinematics = computed_once(kinematics, angle)
    at, excess = _with_translation(kinematics.middle.displacement, translation)
    total = elastic = energy_gradient(energy, at)
    dissipated = by_stroke = jnp.zeros_like(elastic[0])
    if damping is not None:
        hinge_rates = kinematics.with_drift(kinematics.rates(*rates))
        viscous = _viscous_forces(energy, damping, at, hinge_coordinates(at), hinge_rates)
        dissipated = dot(viscous, hinge_rates)
        total = _sum(total, viscous)
    if kinematics.middle.drift is not None:
        by_stroke = dot(total, kinematics.middle.drift)
        if isinstance(energy, NaturallyCurved) and axis.misfit_rate is not None:
            # The drift contains the rate of the turn, which is not one of a coordinate.
            by_turn = energy.slope_by_turn(at) + elastic[0]
            by_stroke = by_stroke + by_turn * axis.misfit_rate.turn
    forces = on_bodies(kinematics, computed_once(total, angle))
    return forces, excess, (dissipated, by_stroke)


class HingeMotionTangent(NamedTuple):
    """Derivatives of the forces of a hinge on its four displacements.

    They are those of `HingeKinematics`. `FOUR_INDEX_AND_SIGN` relates them to the six of
    the bodies.
    """

    # Derivatives with respect to the displacements, on which the translation depends as
    # well; not symmetric if a damped hinge moves, because the viscous forces depend on
    # its rotation
    stiffness: Float[Array, "4 4"]
    damping: Float[
        Array, "4 4"
    ]  # Derivatives with respect to the rates of the displacements
    # Derivatives of the mid-frame translation
    translation_by_displacement: Float[Array, "2 4"]
    # Derivatives of the forces with respect to the mid-frame translation
    force_by_translation: Float[Array, "2 4"]


@jax.jit
def tangent_in_motion(
    energy: AbstractEnergy,
    damping: ViscousDamping | None,
    first: End,
    second: End,
    axis: Axis,
    rates: tuple[Three, Three],
    translation: Two | None = None,
) -> HingeMotionTangent:
    """Compute the derivatives of `forces_in_motion`, for the same arguments.

    It uses arrays, which halve the time of its compilation with every motion. `tangent`
    uses scalars, because they reduce its run time in large batches by a fifth.
    """
    kinematics = HingeKinematics.of(first, second, axis)
    at, _ = _with_translation(kinematics.middle.displacement, translation)
    columns = as_array(kinematics.columns())
    total, hessian_times = gradient_and_hessian(energy, at)
    hessian = as_matrix(hessian_times)
    if damping is None:
        products, damping_matrix = product(columns, hessian), jnp.zeros((4, 4))
    else:
        constant_misfit = kinematics.rates(*rates)
        viscous, derivative = jax.linearize(
            lambda coordinates, rates: _viscous_forces(
                energy, damping, at, coordinates, rates, at
            ),
            hinge_coordinates(at),
            kinematics.with_drift(constant_misfit),
        )
        unit_coordinates, unit_rates = jnp.split(jnp.eye(6), 2, axis=1)
        by_both = jax.vmap(derivative)(tuple(unit_coordinates.T), tuple(unit_rates.T))
        by_both = jnp.stack(by_both, axis=1)
        hessian = hessian + by_both[:3]
        mean = (rates[0][0] + rates[1][0]) / 2
        rate_columns = as_array(kinematics.rate_columns(constant_misfit, mean))
        products = product(columns, hessian) + product(rate_columns, by_both[3:])
        damping_matrix = product(columns, product(columns, by_both[3:]).T)
        total = _sum(total, viscous)
    geometric = as_array(kinematics.geometric_stiffness(total))
    return HingeMotionTangent(
        stiffness=product(columns, products.T) + geometric,
        damping=damping_matrix,
        translation_by_displacement=columns[:, 1:].T,
        force_by_translation=product(hessian[1:], columns.T),
    )


def _with_translation(
    at: Displacement, translation: Two | None
) -> tuple[Displacement, Two]:
    """Replace the translation of a displacement, and return the difference; m."""
    if translation is None:
        zero = jnp.zeros_like(at.x1)
        return at, (zero, zero)
    y1, y2 = translation
    replaced = Displacement(at.angle, at.sigma, at.xi, y1 / 2, y2 / 2)
    return replaced, (2 * at.x1 - y1, 2 * at.x2 - y2)


def _viscous_forces(
    energy: AbstractEnergy,
    damping: ViscousDamping,
    at: Displacement,
    coordinates: Three,
    rates: Three,
    resisted_at: Displacement | None = None,
) -> Three:
    """Compute the viscous forces on the coordinates of the hinge; N m, N, N.

    Args:
        coordinates: Coordinates of the hinge, with respect to which the result is
            differentiated; rad, m, m.
        rates: Rates of the coordinates; rad/s, m/s, m/s.
        resisted_at: Displacement at which the rates are computed that the energy resists;
            by default that of the coordinates. A tangent may take the constant `at`: the
            solver converges as fast and compiles in half the time.
    """

    def half_power(rates: Three) -> Scalar:
        def measure(angle: Scalar, y1: Scalar, y2: Scalar) -> Three:
            return strain(displacement_at(at, (angle, y1, y2)), damping.coordinates)

        _, strain_rates = jax.jvp(measure, coordinates, rates)
        if damping.resisted:
            point = resisted_at
            if point is None:
                point = displacement_at(at, coordinates)
            strain_rates = energy.resisted_rates(point, strain_rates)
        return half_square(damping.damping, strain_rates)

    return jax.grad(half_power)(rates)


def _sum(first: Three, second: Three) -> Three:
    """Compute the sum of two vectors."""
    return first[0] + second[0], first[1] + second[1], first[2] + second[2]
