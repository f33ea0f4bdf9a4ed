"""Elastic forces of one hinge on its two bodies, and their derivatives.

JAX differentiates the energy with respect to the three coordinates of the hinge. The
derivatives of these coordinates with respect to the six displacements of the bodies are
written out here, because with JAX a sweep of stages would take twice the time to compile
and 1.5 to 2 times the time to run.

In all functions, `first` and `second` are the ends of the hinge on bodies A and B, and
`axis` is its axis in the reference configuration, with its misfit.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import Flag, Scalar
from ..energies.base import AbstractEnergy
from ..geometry.twistors import Displacement, half_angle_cos_sin
from ..linalg.products import as_array, product
from .kinematics import Axis, combine, End, Four, HingeKinematics, Six, Three


@jax.jit
def energy_and_forces(
    energy: AbstractEnergy, first: End, second: End, axis: Axis
) -> tuple[Scalar, Six]:
    """Compute the energy (J), and its derivatives by the six displacements; N m, N."""
    kinematics = HingeKinematics.of(first, second, axis)
    value, gradient = energy_and_gradient(energy, kinematics.middle.displacement)
    return value, on_bodies(kinematics, gradient)


@jax.jit
def forces_and_stress(
    energy: AbstractEnergy, first: End, second: End, axis: Axis
) -> tuple[Six, Three]:
    """Differentiate the energy with respect to displacements, and to its coordinates.

    The second result is the generalized stress, the derivative with respect to the
    coordinates in which the energy is nearly quadratic: the angle, and the mid-frame
    translation times `AbstractEnergy.translation_scale`. Both are in N m, N, N.
    """
    kinematics = HingeKinematics.of(first, second, axis)
    at = kinematics.middle.displacement
    gradient = energy_gradient(energy, at)
    scale, growth, _ = _translation_scale(energy, at)
    return on_bodies(kinematics, gradient), _stress(at, gradient, scale, growth)


class HingeTangent(NamedTuple):
    """Forces of a hinge, and their derivatives by its four displacements.

    They are those of `HingeKinematics`: rotation of A, rotation of B, and translation of
    B relative to A along x and along y. A translation of A is the opposite
    one of B, so the ten entries determine the stiffness of the six displacements; see
    `FOUR_INDEX_AND_SIGN`.
    """

    forces: Four  # Derivatives of the energy by them; N m, N m, N, N
    # Upper triangle of the second derivatives, row by row; N m/rad, N/rad, N/m
    stiffness: tuple[Scalar, ...]
    stress: Three  # Generalized stress; N m, N, N
    # Derivatives of the stress with respect to each coordinate of the hinge
    stress_rates: tuple[Three, Three, Three]
    # Derivatives of these coordinates by the four displacements
    kinematics: HingeKinematics
    work: Scalar  # Sum of the absolute values of force times coordinate; J


@jax.jit
def tangent(
    energy: AbstractEnergy,
    first: End,
    second: End,
    axis: Axis,
    predicted: Three | None = None,
) -> HingeTangent:
    """Compute the forces on the four displacements, their derivatives, and the stress.

    If a generalized stress (N m, N, N) is `predicted`, it determines the geometric
    stiffness, and all derivatives are those of the `newton_model` of the energy. Newton's
    method then takes as few steps for stiff hinges as for compliant ones (mixed
    integration point Newton; Magisano, Leonetti and Garcea, Int. J. Num. Meth. Eng. 109,
    2017).
    """
    kinematics = HingeKinematics.of(first, second, axis)
    at = kinematics.middle.displacement
    model = energy if predicted is None else energy.newton_model(predicted)
    gradient, hessian_times = gradient_and_hessian(model, at)
    one, zero = jnp.ones_like(gradient[0]), jnp.zeros_like(gradient[0])
    (h00, h01, h02), (_, h11, h12), (_, _, h22) = (
        hessian_times(one, zero, zero),
        hessian_times(zero, one, zero),
        hessian_times(zero, zero, one),
    )
    _, y1, y2 = hinge_coordinates(at)
    work = jnp.abs(gradient[0] * at.angle)
    work = work + jnp.abs(gradient[1] * y1) + jnp.abs(gradient[2] * y2)
    # The coordinates of the stress are nonlinear functions of those of the hinge; see
    # `forces_and_stress`.
    scale, growth, growth_rate = _translation_scale(energy, at)
    stress = _stress(at, gradient, scale, growth)
    _, s1, s2 = stress
    # The derivatives of the stress by the coordinates of the hinge
    rates_1 = (h01 - growth * s1) / scale, h11 / scale, h12 / scale
    rates_2 = (h02 - growth * s2) / scale, h12 / scale, h22 / scale
    moment = h00 - growth_rate * (y1 * s1 + y2 * s2), h01 - growth * s1, h02 - growth * s2
    rates_0 = tuple(
        direct - growth * (y1 * rate_1 + y2 * rate_2)
        for direct, rate_1, rate_2 in zip(moment, rates_1, rates_2, strict=True)
    )
    by_angle, by_y1, by_y2 = zip(rates_0, rates_1, rates_2, strict=True)
    geometric_forces = gradient
    if predicted is not None:
        # Their second derivatives are multiplied by the predicted stress.
        b0, b1, b2 = predicted
        h00 = h00 + growth_rate * (y1 * (b1 - s1) + y2 * (b2 - s2))
        h01, h02 = h01 + growth * (b1 - s1), h02 + growth * (b2 - s2)
        geometric_forces = b0 + growth * (y1 * b1 + y2 * b2), scale * b1, scale * b2
    hessian = (h00, h01, h02), (h01, h11, h12), (h02, h12, h22)
    columns = kinematics.columns()
    products = [combine(hessian, column) for column in columns]
    geometric = kinematics.geometric_stiffness(geometric_forces)
    return HingeTangent(
        forces=of_four(columns, gradient),
        stiffness=tuple(
            dot(columns[row], products[column]) + geometric[row][column]
            for row, column in zip(*UPPER_TRIANGLE, strict=True)
        ),
        stress=stress,
        stress_rates=(by_angle, by_y1, by_y2),
        kinematics=kinematics,
        work=work,
    )


def predicted_stress(hinge: HingeTangent, first: Three, second: Three) -> Three:
    """Predict the stress after small displacements of both bodies; rad, m, m."""
    s0, s1, s2 = combine(hinge.stress_rates, hinge.kinematics.rates(first, second))
    return hinge.stress[0] + s0, hinge.stress[1] + s1, hinge.stress[2] + s2


# Rows and columns of the entries of a symmetric matrix of four displacements.
UPPER_TRIANGLE = np.triu_indices(4)

# The one of the four displacements that belongs to each of the six (angle, x, y of A and
# of B), and its sign.
FOUR_INDEX_AND_SIGN = (
    np.array([0, 2, 3, 1, 2, 3]),
    np.array([1.0, -1.0, -1.0, 1.0, 1.0, 1.0]),
)


class Factored(NamedTuple):
    """Stiffness of a hinge in factors, `rows.T diag(weights) rows + remainder`."""

    rows: Float[Array, "3 6"]  # Three linear combinations of the six displacements
    weights: Float[Array, "3"]  # Stiffness against each of them; N m/rad, N/m
    # Geometric stiffness, and the part of the stiffness that is not positive semidefinite
    remainder: Float[Array, "6 6"]


@jax.jit
def factored(energy: AbstractEnergy, first: End, second: End, axis: Axis) -> Factored:
    """Compute the stiffness of the `tangent` in factors with accurate small entries."""
    kinematics = HingeKinematics.of(first, second, axis)
    gradient, hessian_times = gradient_and_hessian(energy, kinematics.middle.displacement)
    hessian = as_matrix(hessian_times)
    (a, b, c), (_, d, e), (_, _, f) = hessian
    # Gaussian elimination, as long as the stiffness is positive. The remaining matrix is
    # not eliminated, because it could lose digits.
    one = (a >= 0) & (b * b <= a * d) & (c * c <= a * f)
    ba, ca = _ratio(b, a, one), _ratio(c, a, one)
    d, e, f = d - b * ba, e - c * ba, f - c * ca
    two = one & (d >= 0) & (e * e <= d * f)
    eb = _ratio(e, d, two)
    weights = [(one, a), (two, d), (two, f - e * eb)]
    weights = jnp.stack([jnp.where(done, value, 0.0) for done, value in weights])
    left = [(one, a), (one, b), (one, c), (two, d), (two, e), (two, f)]
    a, b, c, d, e, f = (jnp.where(done, 0.0, value) for done, value in left)
    left = as_array(((a, b, c), (b, d, e), (c, e, f)))
    row1, row2, row3 = as_array(kinematics.columns()).T
    rows = jnp.stack([row1 + ba * row2 + ca * row3, row2 + eb * row3, row3])
    geometric = as_array(kinematics.geometric_stiffness(gradient))
    remainder = product(product(rows.T, left), rows) + geometric
    four = jnp.asarray(FOUR_FROM_SIX_MATRIX)
    remainder = product(product(four.T, remainder), four)
    return Factored(product(rows, four), weights, remainder)


@jax.jit
def rows_and_stiffness(
    energy: AbstractEnergy, first: End, second: End, axis: Axis
) -> tuple[Float[Array, "3 6"], Float[Array, "3 3"]]:
    """Compute the derivatives of the coordinates, and the stiffness against them.

    The derivatives are those with respect to the six displacements; the stiffness is in
    N m/rad, N/rad, N/m.
    """
    kinematics = HingeKinematics.of(first, second, axis)
    _, hessian_times = gradient_and_hessian(energy, kinematics.middle.displacement)
    rows = product(as_array(kinematics.columns()).T, jnp.asarray(FOUR_FROM_SIX_MATRIX))
    return rows, as_matrix(hessian_times)


def _ratio(numerator: Scalar, denominator: Scalar, valid: Flag) -> Scalar:
    """Divide; zero if the ratio is not valid or the denominator is zero."""
    valid = valid & (denominator != 0)
    return jnp.where(valid, numerator / jnp.where(valid, denominator, 1.0), 0.0)


# The matrix that multiplies the six displacements to give the four.
FOUR_FROM_SIX_MATRIX = np.eye(4)[:, FOUR_INDEX_AND_SIGN[0]] * FOUR_INDEX_AND_SIGN[1]


def as_matrix(times: Callable[..., Three]) -> Float[Array, "3 3"]:
    """Convert a function that multiplies a 3 by 3 matrix by a vector to the matrix."""
    return jnp.stack(jax.vmap(times)(*jnp.eye(3)), axis=1)


def energy_and_gradient(energy: AbstractEnergy, at: Displacement) -> tuple[Scalar, Three]:
    """Compute an energy, and its derivatives by the coordinates of the hinge.

    The units are J, and N m, N, N. Their operations are shared.
    """
    value_and_gradient = jax.value_and_grad(_energy_function(energy, at), (0, 1, 2))
    return value_and_gradient(*hinge_coordinates(at))


def energy_gradient(energy: AbstractEnergy, at: Displacement) -> Three:
    """Differentiate an energy with respect to the coordinates of the hinge; N m, N, N."""
    return energy_and_gradient(energy, at)[1]


def gradient_and_hessian(
    energy: AbstractEnergy, at: Displacement
) -> tuple[Three, Callable[..., Three]]:
    """Differentiate an energy twice with respect to the coordinates of the hinge.

    Returns:
        The derivatives; N m, N, N. A function that multiplies the second derivatives by a
        vector.
    """
    gradient = jax.grad(_energy_function(energy, at), (0, 1, 2))
    return jax.linearize(gradient, *hinge_coordinates(at))


def _energy_function(energy: AbstractEnergy, at: Displacement) -> Callable[..., Scalar]:
    """Return the energy as a function of the three coordinates of the hinge."""

    def stored_energy(angle: Scalar, y1: Scalar, y2: Scalar) -> Scalar:
        return energy.stored_energy(displacement_at(at, (angle, y1, y2)))

    return stored_energy


def _stress(at: Displacement, gradient: Three, scale: Scalar, growth: Scalar) -> Three:
    """Compute the generalized stress from the derivatives of the energy; N m, N, N.

    `growth` is the derivative of the translation scale by the angle; 1/rad.
    """
    _, y1, y2 = hinge_coordinates(at)
    s1, s2 = gradient[1] / scale, gradient[2] / scale
    return gradient[0] - growth * (y1 * s1 + y2 * s2), s1, s2


def _translation_scale(
    energy: AbstractEnergy, at: Displacement
) -> tuple[Scalar, Scalar, Scalar]:
    """Compute the translation scale, and its first and second derivative.

    The derivatives are those with respect to the rotation of the hinge; rad.
    """

    def scale(angle: Scalar) -> Scalar:
        _, y1, y2 = hinge_coordinates(at)
        displacement = displacement_at(at, (angle, y1, y2))
        return energy.translation_scale(displacement)

    def scale_and_growth(angle: Scalar) -> tuple[Scalar, Scalar]:
        return jax.jvp(scale, (angle,), (jnp.ones_like(angle),))

    (value, growth), (_, growth_rate) = jax.jvp(
        scale_and_growth, (at.angle,), (jnp.ones_like(at.angle),)
    )
    return value, growth, growth_rate


def hinge_coordinates(at: Displacement) -> Three:
    """Return the angle and the mid-frame translation of a displacement; rad, m, m."""
    return at.angle, 2 * at.x1, 2 * at.x2


def displacement_at(at: Displacement, coordinates: Three) -> Displacement:
    """Return the displacement `at` as a function of its coordinates; rad, m, m.

    Its sine and cosine are not computed again.
    """
    angle, y1, y2 = coordinates
    cos, sin = half_angle_cos_sin(angle, at.sigma, at.xi)
    return Displacement(angle, cos, sin, y1 / 2, y2 / 2)


def on_bodies(kinematics: HingeKinematics, gradient: Three) -> Six:
    """Convert forces on the coordinates to forces on the displacements; N m, N, N."""
    on_a, on_b, x, y = of_four(kinematics.columns(), gradient)
    return on_a, -x, -y, on_b, x, y


def of_four(columns: tuple[Three, Three, Three, Three], gradient: Three) -> Four:
    """Convert derivatives by the coordinates to those by the four displacements.

    `columns` are the derivatives of the coordinates by the four displacements.
    """
    a, b, x, y = (dot(column, gradient) for column in columns)
    return a, b, x, y


def dot(first: Three, second: Three) -> Scalar:
    """Compute the scalar product of two vectors."""
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]
