"""Energy of flexures that are compliant in one direction and stiff in the other two."""

from collections.abc import Sequence
from functools import partial
from typing import Literal

import equinox as eqx
import jax
from jaxtyping import Array, Float

from .._utils.host import as_float, concrete
from .._utils.types import CoefficientsLike, NumberLike, Scalar
from .._utils.validation import require_choice, require_positive
from ..geometry.twistors import Displacement
from .base import AbstractEnergy
from .damping import ViscousDamping
from .dilation import multiply_fields
from .evaluation import Coefficients
from .monomials import Powers
from .polynomial import coefficients_error, require_coefficients, require_powers
from .potentials import (
    ForceRatios,
    maximum_over_forces,
    potential_derivatives,
    resisted_stretch_rates,
)
from .quadratic import CoordinateEnergy
from .strains import Coordinates, strain


Freedom = Literal["rotation", "transverse"]

FREEDOM_VARIABLES = {"rotation": ("tau", "n", "n2"), "transverse": ("t2", "m", "n")}
_SQUARES = (0, 2, 0), (0, 0, 2)  # powers of the reference compliances


class OneFreedomEnergy(CoordinateEnergy):
    """Energy of a flexure with one compliant direction, as a polynomial of two forces.

    A flexure pivot is compliant in rotation and stiff in both translations. A
    parallelogram of leaves is compliant in the transverse displacement, and stiff in
    rotation and axial displacement. `W` is a polynomial of the compliant coordinate `c`
    and the forces `f1`, `f2` in the two stiff directions. The energy at the displacements
    `s1`, `s2` in these directions is the maximum of `f1 s1 + f2 s2 + W(c, f1, f2)` over
    both forces, so that `s = -dW/df`. A few dozen terms are sufficient for any ratio of
    the stiffnesses. `MixedEnergy` is the same for one stiff direction.

    Args:
        coefficients: Coefficients of the terms of W; J.
        powers: Powers of the three variables in each term. They are `tau`, `n / force`,
            `n2 / force` for the freedom "rotation", with the axial force n and the
            transverse force n2; and `t2 / length`, `m / (force length)`, `n / force` for
            the freedom "transverse", with the moment m.
        freedom: The compliant direction, "rotation" or "transverse".
        length: Reference length; m.
        force: Reference force; N. In terms of third and higher order in the forces, a
            force above this one saturates, so that there are forces for all
            displacements.

    Raises:
        ValueError: The numbers of coefficients and powers do not match; a row of powers
            is invalid or given twice; a value is not finite; a reference value is not
            positive; a compliance is not positive; the freedom is unknown.

    Source:
        W is a complementary energy in two of three directions: Reissner, On a variational
        theorem in elasticity, J. Math. Phys. 29, 1950.

    Example:
        >>> import jax.numpy as jnp
        >>> powers = [(2, 0, 0), (2, 1, 0), (0, 2, 0), (0, 0, 2)]
        >>> pivot = OneFreedomEnergy(
        ...     [1.0, 0.1, -0.01, -0.01],
        ...     powers,
        ...     freedom="rotation",
        ...     length=1.0,
        ...     force=1.0,
        ... )
        >>> pivot.wrench(jnp.array([0.2, 0.01, 0.0])).round(3)
        Array([ 0.428,  0.691, -0.12 ], dtype=float64)
    """

    coefficients: Float[Array, " terms"]
    length: Scalar
    force: Scalar
    powers: Powers = eqx.field(static=True)
    freedom: Freedom = eqx.field(static=True)

    def __init__(
        self,
        coefficients: CoefficientsLike,
        powers: Sequence[Sequence[int]],
        *,
        freedom: Freedom,
        length: NumberLike,
        force: NumberLike,
    ):
        self.freedom = require_choice("`freedom`", freedom, tuple(FREEDOM_VARIABLES))
        self.powers = require_powers(powers, FREEDOM_VARIABLES[self.freedom])
        self.coefficients = as_float(coefficients)
        self.length = require_positive("`length`", length)
        self.force = require_positive("`force`", force)
        require_coefficients(self, self.coefficients, self.powers)

    @property
    def coordinates(self) -> Coordinates:
        """All coordinates are components of the twist."""
        return "twist"

    def validation_error(self) -> str | None:
        """Describe an invalid coefficient; None if all are valid."""
        if error := coefficients_error(self.coefficients, self.powers):
            return error
        values = concrete(self.coefficients)
        for row in _SQUARES:
            if row not in self.powers or (
                values is not None and values[self.powers.index(row)] >= 0
            ):
                return (
                    f"the coefficient of the term with powers {row} is missing or not "
                    "negative. It must be negative, so that the compliance in a stiff "
                    "direction is positive."
                )
        return None

    def stored_energy(self, displacement: Displacement) -> Scalar:
        compliant, stretches = self._variables(displacement)
        return maximum_over_forces(self.powers, self.coefficients, compliant, stretches)

    def dilated(self, scale: Float[Array, "*batch"]) -> "OneFreedomEnergy":
        """Return the energy if all dimensions of the hinge are multiplied."""
        return multiply_fields(self, scale, coefficients=[3], length=1, force=2)

    def newton_model(self, stress: tuple[Scalar, Scalar, Scalar]) -> "AbstractEnergy":
        return _NewtonModel(self, self.force_ratios(stress))

    def force_ratios(self, stress: tuple[Scalar, Scalar, Scalar]) -> ForceRatios:
        """Divide the forces in the stiff directions by their reference values.

        Args:
            stress: Moment, axial force, transverse force; N m, N, N.

        Returns:
            The two forces, in the order of the powers.
        """
        moment, axial, transverse = stress
        if self.freedom == "rotation":
            return axial / self.force, transverse / self.force
        return moment / (self.force * self.length), axial / self.force

    def proportional_damping(self, time: Scalar) -> ViscousDamping:
        return ViscousDamping(time * self.tangent_stiffness(), "twist", resisted=True)

    def resisted_rates(
        self, displacement: Displacement, rates: tuple[Scalar, Scalar, Scalar]
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Return the rates of the compliant coordinate and of the two stretches.

        A stretch is the displacement in a stiff direction without the part that belongs
        to the compliant coordinate. The rates are multiplied by the square root of the
        ratio of the stiffness to that in the reference configuration, as in a solid with
        one damping time for all strains.

        Args:
            displacement: Displacement of frame b relative to frame a.
            rates: Rates of the twist; rad/s, m/s, m/s.

        Returns:
            The rates; rad/s, m/s, m/s.
        """
        compliant, stretches = self._variables(displacement)
        rate, stretch_rates = self._scaled(rates)
        stretch_1, stretch_2 = resisted_stretch_rates(
            self.powers, self.coefficients, compliant, stretches, rate, stretch_rates
        )
        return self._unscaled(rate, (stretch_1, stretch_2))

    def _variables(
        self, displacement: Displacement
    ) -> tuple[Scalar, tuple[Scalar, Scalar]]:
        """Return the compliant variable (-), and stiff displacements times forces; J."""
        return self._scaled(strain(displacement, "twist"))

    def _scaled(
        self, twist: tuple[Scalar, Scalar, Scalar]
    ) -> tuple[Scalar, tuple[Scalar, Scalar]]:
        """Scale a twist or its rate (rad, m, m)."""
        rotation, axial, transverse = twist
        if self.freedom == "rotation":
            return rotation, (self.force * axial, self.force * transverse)
        moment = self.force * self.length
        return transverse / self.length, (moment * rotation, self.force * axial)

    def _unscaled(
        self, compliant: Scalar, stretches: tuple[Scalar, Scalar]
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Return the twist or its rate (rad, m, m) of scaled coordinates."""
        first, second = stretches
        if self.freedom == "rotation":
            return compliant, first / self.force, second / self.force
        rotation = first / (self.force * self.length)
        return rotation, second / self.force, compliant * self.length


class _NewtonModel(AbstractEnergy):
    """Replacement of the energy in Newton's method, near predicted forces.

    The forces are independent unknowns, and the residual of their relation to the
    displacements is eliminated to first order. With the energy itself, a step in the
    compliant direction would stretch the flexure in the stiff directions.
    """

    energy: OneFreedomEnergy
    # Predicted forces in the stiff directions, over their reference values
    forces: ForceRatios

    def stored_energy(self, displacement: Displacement) -> Scalar:
        energy = self.energy
        compliant, stretches = energy._variables(displacement)
        return _model_energy(
            energy.powers, energy.coefficients, self.forces, compliant, *stretches
        )

    def translation_scale(self, displacement: Displacement) -> Scalar:
        return self.energy.translation_scale(displacement)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _model_energy(
    powers: Powers,
    coefficients: Coefficients,
    forces: ForceRatios,
    compliant: Scalar,
    stretch_1: Scalar,
    stretch_2: Scalar,
) -> Scalar:
    """Compute the energy (J) after one Newton step from predicted forces."""
    at = potential_derivatives(powers, coefficients, compliant, forces)
    residual = stretch_1 + at.by_forces[0], stretch_2 + at.by_forces[1]
    step = at.force_step(residual)
    work = forces[0] * stretch_1 + forces[1] * stretch_2
    half = (residual[0] * step[0] + residual[1] * step[1]) / 2
    return work + at.value + half


# Derivatives with respect to the energy and the predicted forces are not implemented:
# Newton's method calls these functions on a system without derivatives.
@_model_energy.defjvp
def _(powers, primals, tangents):
    by_compliant, by_1, by_2 = _model_gradient(powers, *primals)
    rate, rate_1, rate_2 = tangents[2:]
    total = by_compliant * rate + by_1 * rate_1 + by_2 * rate_2
    return _model_energy(powers, *primals), total


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _model_gradient(
    powers: Powers,
    coefficients: Coefficients,
    forces: ForceRatios,
    compliant: Scalar,
    stretch_1: Scalar,
    stretch_2: Scalar,
) -> tuple[Scalar, Scalar, Scalar]:
    """Compute the gradient of the model energy with respect to its last three arguments.

    It is correct to first order in the residual. In its derivative, terms of this order
    are neglected.
    """
    at = potential_derivatives(powers, coefficients, compliant, forces)
    step = at.force_step((stretch_1 + at.by_forces[0], stretch_2 + at.by_forces[1]))
    coupled = step[0] * at.mixed[0] + step[1] * at.mixed[1]
    return at.by_compliant + coupled, forces[0] + step[0], forces[1] + step[1]


@_model_gradient.defjvp
def _(powers, primals, tangents):
    coefficients, forces, compliant, _, _ = primals
    rate, rate_1, rate_2 = tangents[2:]
    at = potential_derivatives(powers, coefficients, compliant, forces)
    step = at.force_step((rate_1 + at.mixed[0] * rate, rate_2 + at.mixed[1] * rate))
    coupled = step[0] * at.mixed[0] + step[1] * at.mixed[1]
    rates = at.curvature * rate + coupled, step[0], step[1]
    return _model_gradient(powers, *primals), rates
