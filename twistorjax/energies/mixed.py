"""Energy of flexures that are compliant in two directions and stiff along their axis.

The energy of such a flexure is hard to approximate as a function of its displacement: a
small axial displacement causes a large force, and the axial shortening by bending depends
on all coordinates. As a function of the axial force it is smooth for any slenderness.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._utils.host import as_float, concrete
from .._utils.types import CoefficientsLike, NumberLike, Scalar
from .._utils.validation import require_positive
from ..geometry.twistors import Displacement
from .base import AbstractEnergy
from .damping import ViscousDamping
from .dilation import multiply_fields
from .monomials import Powers, VARIABLES
from .polynomial import coefficients_error, require_coefficients, require_powers
from .potentials import (
    AbstractPotential,
    AXIAL_COMPLIANCE,
    axial_force_ratio,
    Bending,
    maximum_over_force,
    PolynomialPotential,
)
from .quadratic import CoordinateEnergy
from .strains import Coordinates, strain
from .stress_model import AbstractStressModel


class AbstractMixedEnergy(AbstractEnergy):
    """Energy of a flexure that is stiff along its axis, from a potential W.

    `W(tau, t2, n)` is a function of the rotation `tau`, the transverse displacement `t2`
    and the axial force `n`. The energy of the displacement `(tau, t1, t2)` is the maximum
    of `n t1 + W(tau, t2, n)` over `n`, and the maximizing `n` is the axial force.
    """

    length: eqx.AbstractVar[Scalar]  # by which `t2` is divided; m

    @property
    @abstractmethod
    def potential(self) -> AbstractPotential:
        """The potential W of `tau`, `t2 / length` and `n / reference_force`."""

    @property
    @abstractmethod
    def reference_force(self) -> Scalar:
        """Force by which the axial force is divided; N."""

    @abstractmethod
    def potential_variables(self, displacement: Displacement) -> tuple[Bending, Scalar]:
        """Return `(tau, t2 / length)` of a displacement, and `t1 reference_force`; J."""

    def stored_energy(self, displacement: Displacement) -> Scalar:
        return maximum_over_force(self.potential, *self.potential_variables(displacement))

    def axial_force(self, displacement: Displacement) -> Scalar:
        """Compute the axial force at a displacement; N."""
        variables = self.potential_variables(displacement)
        return self.reference_force * axial_force_ratio(self.potential, *variables)

    def newton_model(self, stress: tuple[Scalar, Scalar, Scalar]) -> "AbstractEnergy":
        return _NewtonModel(self, stress[1] / self.reference_force)

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
        potential = self.potential
        bending, axial = self.potential_variables(displacement)
        by_rotation, by_transverse, curvature = potential.derivatives(
            ((1, 0, 1), (0, 1, 1), (0, 0, 2)),
            bending,
            axial_force_ratio(potential, bending, axial),
        )
        transverse_rate = rates[2] / self.length
        bending_rate = by_rotation * rates[0] + by_transverse * transverse_rate
        rate = rates[1] + bending_rate / self.reference_force
        growth = jnp.sqrt(potential.reference_curvature / curvature)
        return rates[0], rate * growth, rates[2]


class MixedEnergy(AbstractMixedEnergy, CoordinateEnergy):
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
        flexure: Whether this is `quartic_leaf`, whose reference force is E I / length^2.
            The solvers then warn of displacements and axial forces at which its force or
            moment errs by more than 5 %.
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
    flexure: bool = eqx.field(static=True, default=False)
    stress_model: AbstractStressModel | None = None

    def __init__(
        self,
        coefficients: CoefficientsLike,
        powers: Sequence[Sequence[int]],
        *,
        length: NumberLike,
        force: NumberLike,
        flexure: bool = False,
        stress_model: AbstractStressModel | None = None,
    ):
        self.flexure = flexure
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
    def potential(self) -> PolynomialPotential:
        """The polynomial W."""
        return PolynomialPotential(self.coefficients, self.powers)

    @property
    def reference_force(self) -> Scalar:
        """Reference force; N."""
        return self.force

    @property
    def coordinates(self) -> Coordinates:
        """Rotation and displacements are components of the twist."""
        return "twist"

    def potential_variables(self, displacement: Displacement) -> tuple[Bending, Scalar]:
        rotation, axial, transverse = strain(displacement, "twist")
        return (rotation, transverse / self.length), self.force * axial

    def validation_error(self) -> str | None:
        """Describe an invalid coefficient; None if all are valid."""
        if error := coefficients_error(self.coefficients, self.powers):
            return error
        values = concrete(self.coefficients)
        if AXIAL_COMPLIANCE not in self.powers or (
            values is not None and values[self.powers.index(AXIAL_COMPLIANCE)] >= 0
        ):
            return (
                "the coefficient of the term with powers (0, 0, 2) is missing or not "
                "negative. It must be negative, so that the axial compliance is positive."
            )
        return None

    def range_share(self, displacement: Displacement) -> Scalar | None:
        """Compute the share of a displacement in that at which it errs by 5 %.

        Without axial force, its forces and moments were compared with the elastica. The
        transverse stiffness `12 + 6/5 p` at a relative axial force p was compared with
        that of a beam-column, from which it differs by 5 % at -8.17 and 84.3.
        """
        if not self.flexure:
            return None
        (rotation, transverse), _ = self.potential_variables(displacement)
        bending = jnp.sqrt((rotation / 0.6) ** 2 + (transverse / 0.22) ** 2)
        ratio = self.axial_force(displacement) / self.force
        return jnp.maximum(bending, jnp.maximum(ratio / 84.3, -ratio / 8.17))

    def dilated(self, scale: Float[Array, "*batch"]) -> "MixedEnergy":
        """Return the energy if all dimensions of the hinge are multiplied."""
        return multiply_fields(self, scale, coefficients=[3], length=1, force=2)


class _NewtonModel(AbstractEnergy):
    """Replacement of a mixed energy in Newton's method, near a predicted axial force.

    The axial displacement and the axial force are independent unknowns, and the residual
    of their relation is eliminated to first order. With the energy itself, a transverse
    Newton step would stretch the flexure, because the axial shortening by bending is of
    second order. The large axial force of this stretch would slow down Newton's method.
    """

    energy: AbstractMixedEnergy
    # Predicted axial force divided by the reference force, `n / force`
    force_ratio: Scalar

    def stored_energy(self, displacement: Displacement) -> Scalar:
        energy = self.energy
        bending, axial = energy.potential_variables(displacement)
        return _model_energy(energy.potential, self.force_ratio, axial, *bending)


@jax.custom_jvp
def _model_energy(
    potential: AbstractPotential,
    force_ratio: Scalar,
    axial: Scalar,
    rotation: Scalar,
    transverse: Scalar,
) -> Scalar:
    """Compute the energy (J) after one Newton step from a predicted axial force.

    The last three arguments are the axial displacement times the reference force (J), the
    rotation (rad), and the relative transverse displacement.
    """
    at = _PotentialAt.of(potential, (rotation, transverse), force_ratio)
    residual = axial + at.by_force
    return axial * force_ratio + at.value - residual**2 / (2 * at.by_force_twice)


# Derivatives with respect to the potential and the predicted force are not implemented:
# Newton's method calls these functions on a system without derivatives (`stop_gradient`
# in `solve.statics`).
@_model_energy.defjvp
def _(primals, tangents):
    by_axial, by_rotation, by_transverse = _model_gradient(*primals)
    axial, rotation, transverse = tangents[2:]
    rate = by_axial * axial + by_rotation * rotation + by_transverse * transverse
    return _model_energy(*primals), rate


@jax.custom_jvp
def _model_gradient(
    potential: AbstractPotential,
    force_ratio: Scalar,
    axial: Scalar,
    rotation: Scalar,
    transverse: Scalar,
) -> tuple[Scalar, Scalar, Scalar]:
    """Compute the gradient of the model energy with respect to its last three arguments.

    The gradient is correct to first order in the residual, `axial` plus the derivative of
    W with respect to the force. In its derivative, terms of this order are neglected.
    """
    at = _PotentialAt.of(potential, (rotation, transverse), force_ratio)
    return at.corrected_gradient(force_ratio, axial)


@_model_gradient.defjvp
def _(primals, tangents):
    potential, force_ratio, axial, rotation, transverse = primals
    axial_rate, rotation_rate, transverse_rate = tangents[2:]
    at = _PotentialAt.of(potential, (rotation, transverse), force_ratio)
    residual_rate = axial_rate + (
        at.mixed[0] * rotation_rate + at.mixed[1] * transverse_rate
    )
    force_rate = -residual_rate / at.by_force_twice
    h11, h12, h22 = at.by_bending_twice
    moment_rate = h11 * rotation_rate + h12 * transverse_rate
    shear_rate = h12 * rotation_rate + h22 * transverse_rate
    rates = (
        force_rate,
        moment_rate + force_rate * at.mixed[0],
        shear_rate + force_rate * at.mixed[1],
    )
    return at.corrected_gradient(force_ratio, axial), rates


class _PotentialAt(NamedTuple):
    """W and its derivatives by bending and by the relative axial force; J."""

    value: Scalar  # W
    by_force: Scalar  # Derivative by the force
    by_force_twice: Scalar  # Second derivative by the force
    # Derivatives by the rotation and the transverse displacement
    by_bending: tuple[Scalar, Scalar]
    mixed: tuple[Scalar, Scalar]  # Derivatives by each of these two and the force
    # Second derivatives by these two: 11, 12, 22
    by_bending_twice: tuple[Scalar, Scalar, Scalar]

    @classmethod
    def of(
        cls,
        potential: AbstractPotential,
        bending: Bending,
        force_ratio: Scalar,
    ) -> "_PotentialAt":
        """Evaluate them together, so that they share their sums."""
        orders = (
            (0, 0, 0), (0, 0, 1), (0, 0, 2), (1, 0, 0), (0, 1, 0),
            (1, 0, 1), (0, 1, 1), (2, 0, 0), (1, 1, 0), (0, 2, 0),
        )  # fmt: skip
        value, by_force, by_force_twice, *others = potential.derivatives(
            orders, bending, force_ratio
        )
        r, t, rn, tn, rr, rt, tt = others
        return cls(value, by_force, by_force_twice, (r, t), (rn, tn), (rr, rt, tt))

    def corrected_gradient(
        self, force_ratio: Scalar, axial: Scalar
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Correct the gradient to first order in the residual; see `_model_gradient`."""
        correction = -(axial + self.by_force) / self.by_force_twice
        by_rotation, by_transverse = self.by_bending
        return (
            force_ratio + correction,
            by_rotation + correction * self.mixed[0],
            by_transverse + correction * self.mixed[1],
        )
