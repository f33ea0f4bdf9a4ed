"""Energy of flexures that are compliant in two directions and stiff along their axis.

The energy of such a flexure is hard to approximate as a function of its displacement: a
small axial displacement causes a large force, and the axial shortening by bending depends
on all coordinates. As a function of the axial force it is smooth for any slenderness.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.host import as_float, concrete
from .._utils.types import CoefficientsLike, NumberLike, Scalar
from .._utils.validation import require_positive
from ..geometry.twistors import Displacement
from .base import AbstractEnergy
from .damping import ViscousDamping
from .dilation import dilated_potential
from .evaluation import evaluate_polynomial
from .mixed_potential import (
    axial_force_ratio,
    ForceSeries,
    maximum_over_force,
    mixed_potential,
)
from .monomials import Powers, VARIABLES
from .polynomial import coefficients_error, require_coefficients, require_powers
from .quadratic import CoordinateEnergy
from .strains import Coordinates, strain
from .stress_model import AbstractStressModel


_AXIAL_COMPLIANCE = (0, 0, 2)  # powers of the term of the axial reference compliance


class MixedEnergy(CoordinateEnergy):
    """Energy of a flexure, from a polynomial of rotation, displacement and axial force.

    `W(tau, t2, n)` is a polynomial of the rotation `tau`, the transverse displacement
    `t2` and the axial force `n`. The energy of the twist `(tau, t1, t2)` is the maximum
    of `n t1 + W(tau, t2, n)` over `n`, and the maximizing `n` is the axial force. At the
    maximum `t1 = -dW/dn`. For `W = B - n S - n^2 / (2 k)` the energy is
    `B + k (t1 - S)^2 / 2`. This is the energy of a leaf with the bending energy B, the
    axial stiffness k and the axial displacement S due to bending.

    A few dozen terms are sufficient for any slenderness. A polynomial of the three
    displacements of a slender leaf requires hundreds of terms, and it does not converge
    for a very slender leaf.

    Args:
        coefficients: Coefficients of the terms of W; J.
        powers: Powers of `tau`, `t2 / length` and `n / force` in each term.
        length: Reference length, by which the transverse displacement is divided; m.
        force: Reference force, by which the axial force is divided; N. W is the
            polynomial for axial forces between `-force` and `force`. Outside of this
            interval W is continued by its second-order Taylor polynomial in `n`, so that
            there is an axial force for every axial displacement.
        stress_model: Stress in a flexure whose dimensions are known, such as that of
            `quartic_leaf`.

    Raises:
        ValueError: The numbers of coefficients and powers do not match; a row of powers
            is invalid or given twice; a value is not finite; a reference value is not
            positive; the axial compliance is not positive.

    Source:
        Awtar and Sen, A generalized constraint model for two-dimensional beam flexures,
        J. Mech. Des. 132, 2010, give W to the second power of rotation and displacement.
        W is a complementary energy in one of three directions: Reissner, On a variational
        theorem in elasticity, J. Math. Phys. 29, 1950.

    Example:
        >>> powers = [(0, 2, 0), (0, 2, 1), (0, 0, 2)]
        >>> guided = MixedEnergy([6.0, 0.6, -5e-4], powers, length=1.0, force=1.0)
        >>> guided.wrench(jnp.array([0.0, 0.0, 0.1]))[1:]  # axial force: k 3/5 t2^2
        Array([6.  , 1.92], dtype=float64)
    """

    coefficients: Float[Array, " terms"]
    length: Scalar
    force: Scalar
    powers: Powers = eqx.field(static=True)
    stress_model: AbstractStressModel | None

    def __init__(
        self,
        coefficients: CoefficientsLike,
        powers: Sequence[Sequence[int]],
        *,
        length: NumberLike,
        force: NumberLike,
        stress_model: AbstractStressModel | None = None,
    ):
        self.stress_model = stress_model
        self.powers = require_powers(powers, VARIABLES["mixed"])
        self.coefficients = as_float(coefficients)
        self.length = require_positive("`length`", length)
        self.force = require_positive("`force`", force)
        require_coefficients(self, self.coefficients, self.powers)

    @property
    def order(self) -> int:
        """Largest sum of the powers of rotation and transverse displacement in a term."""
        return max(row[0] + row[1] for row in self.powers)

    @property
    def coordinates(self) -> Coordinates:
        """Rotation and transverse displacement are components of the twist."""
        return "twist"

    def validation_error(self) -> str | None:
        """Describe an invalid coefficient; None if all are valid."""
        if error := coefficients_error(self.coefficients, self.powers):
            return error
        values = concrete(self.coefficients)
        if _AXIAL_COMPLIANCE not in self.powers or (
            values is not None and values[self.powers.index(_AXIAL_COMPLIANCE)] >= 0
        ):
            return (
                "the coefficient of the term with powers (0, 0, 2) is missing or not "
                "negative. It must be negative, so that the axial compliance is positive."
            )
        return None

    def stored_energy(self, displacement: Displacement) -> Scalar:
        rotation, axial, transverse = strain(displacement, "twist")
        series = self.force_series(rotation, transverse)
        return maximum_over_force(series, self.force * axial)

    def dilated(self, scale: Float[Array, "*batch"]) -> "MixedEnergy":
        """Return the energy if all dimensions of the hinge are multiplied."""
        return dilated_potential(self, scale)

    def newton_model(self, stress: tuple[Scalar, Scalar, Scalar]) -> "AbstractEnergy":
        return _NewtonModel(self, stress[1] / self.force)

    def proportional_damping(self, time: Scalar) -> ViscousDamping:
        return ViscousDamping(time * self.tangent_stiffness(), "twist", resisted=True)

    def resisted_rates(
        self, displacement: Displacement, rates: tuple[Scalar, Scalar, Scalar]
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Return the rates of rotation, axial stretch, and transverse displacement.

        The axial stretch is the axial displacement without the part due to bending. Its
        rate is multiplied by `sqrt(k / k0)`, where k is the axial stiffness at this
        displacement and k0 that in the reference configuration. A damping proportional to
        k0 then acts like one proportional to k, as in a solid with one damping time for
        all strains.

        Args:
            displacement: Displacement of frame b relative to frame a.
            rates: Rates of the twist; rad/s, m/s, m/s.

        Returns:
            The rates; rad/s, m/s, m/s.
        """
        rotation, axial, transverse = strain(displacement, "twist")
        series = self.force_series(rotation, transverse)
        force_ratio = axial_force_ratio(series, self.force * axial)
        potential = _Potential(self, force_ratio, rotation, transverse)
        curvature = potential.derivative(0, 0, 2)
        reference = 2 * self.coefficients[self.powers.index(_AXIAL_COMPLIANCE)]
        by_rotation, by_transverse = potential.gradient(1)
        bending_rate = by_rotation * rates[0] + by_transverse * rates[2]
        rate = rates[1] + bending_rate / self.force
        return rates[0], rate * jnp.sqrt(reference / curvature), rates[2]

    def force_series(
        self,
        rotation: Scalar,
        transverse: Scalar,
        derivatives: tuple[int, int] = (0, 0),
    ) -> ForceSeries:
        """Write W, or a derivative, as a polynomial of the relative axial force.

        Args:
            rotation: Rotation; rad.
            transverse: Transverse displacement; m.
            derivatives: Orders of the derivative with respect to the rotation and to the
                transverse displacement over `length`.

        Returns:
            The coefficients of the powers of `n / force`, from the power zero on; J.
        """
        variables = rotation, transverse / self.length
        series = []
        for power in range(1 + max(row[2] for row in self.powers)):
            terms = [k for k, row in enumerate(self.powers) if row[2] == power]
            powers = tuple(self.powers[k][:2] for k in terms)
            coefficients = self.coefficients[np.array(terms, int)]
            series.append(
                evaluate_polynomial(powers, derivatives, coefficients, variables)
            )
        return tuple(series)


class _NewtonModel(AbstractEnergy):
    """Replacement of a mixed energy in Newton's method, near a predicted axial force.

    The axial displacement and the axial force are independent unknowns, and the residual
    of their relation is eliminated to first order. With the energy itself, a transverse
    Newton step would stretch the flexure, because the axial shortening by bending is of
    second order. The large axial force of this stretch would slow down Newton's method.

    Args:
        energy: The mixed energy.
        force_ratio: Predicted axial force divided by the reference force, `n / force`.
    """

    energy: MixedEnergy
    force_ratio: Scalar

    def stored_energy(self, displacement: Displacement) -> Scalar:
        rotation, axial, transverse = strain(displacement, "twist")
        scaled_axial = self.energy.force * axial
        return _model_energy(
            self.energy, self.force_ratio, rotation, scaled_axial, transverse
        )

    def translation_scale(self, displacement: Displacement) -> Scalar:
        return self.energy.translation_scale(displacement)


class _Potential:
    """Derivatives of W at a rotation (rad), transverse displacement (m), and axial force.

    They are written out, because nested derivatives by JAX would take twice the time to
    trace.
    """

    def __init__(
        self,
        energy: MixedEnergy,
        force_ratio: Scalar,
        rotation: Scalar,
        transverse: Scalar,
    ):
        self._energy, self._force_ratio = energy, force_ratio
        self._at = rotation, transverse
        self._series: dict[tuple[int, int], ForceSeries] = {}

    def derivative(self, rotation: int, transverse: int, force: int) -> Scalar:
        """Return a derivative of the given orders; J/rad^i/m^j.

        The last order is that with respect to the relative axial force.
        """
        orders = rotation, transverse
        if orders not in self._series:
            self._series[orders] = self._energy.force_series(*self._at, orders)
        value = mixed_potential(self._series[orders], self._force_ratio, force)
        return value / self._energy.length**transverse if transverse else value

    def gradient(self, force: int) -> tuple[Scalar, Scalar]:
        """Return the gradient by rotation and displacement of a derivative by force."""
        return self.derivative(1, 0, force), self.derivative(0, 1, force)


@jax.custom_jvp
def _model_energy(
    energy: MixedEnergy,
    force_ratio: Scalar,
    rotation: Scalar,
    axial: Scalar,
    transverse: Scalar,
) -> Scalar:
    """Compute the energy (J) after one Newton step from a predicted axial force.

    The last three arguments are the rotation (rad), the axial displacement times the
    reference force (J), and the transverse displacement (m).
    """
    potential = _Potential(energy, force_ratio, rotation, transverse)
    value, slope, curvature = (potential.derivative(0, 0, k) for k in range(3))
    return axial * force_ratio + value - (axial + slope) ** 2 / (2 * curvature)


# Derivatives with respect to the energy and the predicted force are not implemented:
# Newton's method calls these functions on a system without derivatives (`stop_gradient`
# in `solve.statics`).
@_model_energy.defjvp
def _(primals, tangents):
    by_rotation, by_axial, by_transverse = _model_gradient(*primals)
    rotation_rate, axial_rate, transverse_rate = tangents[2:]
    rate = (
        by_rotation * rotation_rate
        + by_axial * axial_rate
        + by_transverse * transverse_rate
    )
    return _model_energy(*primals), rate


@jax.custom_jvp
def _model_gradient(
    energy: MixedEnergy,
    force_ratio: Scalar,
    rotation: Scalar,
    axial: Scalar,
    transverse: Scalar,
) -> tuple[Scalar, Scalar, Scalar]:
    """Compute the gradient of the model energy with respect to its last three arguments.

    The gradient (J/rad, -, N) is correct to first order in the residual
    `axial + dW/d(force_ratio)`. In its derivative, terms of this order are neglected.
    """
    potential = _Potential(energy, force_ratio, rotation, transverse)
    return _corrected_gradient(potential, force_ratio, axial)


def _corrected_gradient(
    potential: _Potential, force_ratio: Scalar, axial: Scalar
) -> tuple[Scalar, Scalar, Scalar]:
    """Correct the gradient to first order in the residual; see `_model_gradient`."""
    residual = axial + potential.derivative(0, 0, 1)
    correction = -residual / potential.derivative(0, 0, 2)
    by_rotation, by_transverse = potential.gradient(0)
    slope_by_rotation, slope_by_transverse = potential.gradient(1)
    return (
        by_rotation + correction * slope_by_rotation,
        force_ratio + correction,
        by_transverse + correction * slope_by_transverse,
    )


@_model_gradient.defjvp
def _(primals, tangents):
    energy, force_ratio, rotation, axial, transverse = primals
    rotation_rate, axial_rate, transverse_rate = tangents[2:]
    potential = _Potential(energy, force_ratio, rotation, transverse)
    by_rotation, by_transverse = potential.gradient(1)
    residual_rate = (
        axial_rate + by_rotation * rotation_rate + by_transverse * transverse_rate
    )
    force_rate = -residual_rate / potential.derivative(0, 0, 2)
    mixed = potential.derivative(1, 1, 0)
    moment_rate = potential.derivative(2, 0, 0) * rotation_rate + mixed * transverse_rate
    shear_rate = mixed * rotation_rate + potential.derivative(0, 2, 0) * transverse_rate
    rates = (
        moment_rate + force_rate * by_rotation,
        force_rate,
        shear_rate + force_rate * by_transverse,
    )
    return _corrected_gradient(potential, force_ratio, axial), rates
