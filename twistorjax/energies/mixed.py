"""Energy of flexures with one or two stiff directions.

The energy of such a flexure is hard to approximate as a function of its displacement: a
small axial displacement causes a large force, and the axial shortening by bending depends
on all coordinates. As a function of the forces in the stiff directions it is smooth for
any slenderness.
"""

from abc import abstractmethod
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._utils.host import as_float, concrete
from .._utils.types import CoefficientsLike, NumberLike, Scalar
from .._utils.validation import require_positive
from ..geometry.twistors import Displacement
from .base import AbstractEnergy, Rates, Stress
from .damping import ViscousDamping
from .dilation import multiply_fields
from .monomials import Powers, VARIABLES
from .polynomial import coefficients_error, require_coefficients, require_powers
from .potentials import (
    AbstractPotential,
    dot,
    force_ratios,
    force_step,
    maximum_over_forces,
    OneForcePotential,
    PotentialDerivatives,
    resisted_stretch_rates,
    sums,
    times,
    transposed,
    variable_units,
    Variables,
)
from .quadratic import CoordinateEnergy
from .strains import Coordinates, Strain, strain
from .stress_model import AbstractStressModel


class AbstractMixedEnergy(AbstractEnergy):
    """Energy of a flexure that is stiff in one or two directions, from a potential W.

    `W(c, f)` is a function of the coordinates `c` in the compliant directions and of the
    forces `f` in the stiff ones. The energy is the maximum of `f . s + W(c, f)` over f,
    where `s` are the displacements in the stiff directions, and the maximizing f are the
    forces.
    """

    length: eqx.AbstractVar[Scalar]  # Reference length; m

    @property
    def stiff(self) -> tuple[int, ...]:
        """The stiff directions: 0 for rotation, 1 for axial, and 2 for transverse."""
        return (1,)

    @property
    @abstractmethod
    def potential(self) -> AbstractPotential:
        """The potential W of the coordinates and forces, divided by `_units`."""

    @property
    @abstractmethod
    def reference_force(self) -> Scalar:
        """Reference force; N."""

    @abstractmethod
    def coordinates_at(self, displacement: Displacement) -> Strain:
        """Return rotation, axial, and transverse displacement; rad, m, m."""

    @property
    def _units(self) -> tuple[Scalar | float, ...]:
        """Reference values of coordinates and forces; see `variable_units`."""
        return variable_units(self.stiff, self.length, self.reference_force)

    def potential_variables(
        self, displacement: Displacement
    ) -> tuple[Variables, Variables]:
        """Return the compliant coordinates (-) and the stretches (J)."""
        return self._scaled(self.coordinates_at(displacement))

    def stored_energy(self, displacement: Displacement) -> Scalar:
        return maximum_over_forces(
            self.potential, *self.potential_variables(displacement)
        )

    def axial_force(self, displacement: Displacement) -> Scalar:
        """Compute the axial force at a displacement; N."""
        ratios = force_ratios(self.potential, *self.potential_variables(displacement))
        return self.reference_force * ratios[self.stiff.index(1)]

    def newton_model(self, stress: Stress) -> AbstractEnergy:
        return _NewtonModel(self, tuple(stress[k] / self._units[k] for k in self.stiff))

    def proportional_damping(self, time: Scalar) -> ViscousDamping:
        return ViscousDamping(time * self.tangent_stiffness(), "twist", resisted=True)

    def resisted_rates(self, displacement: Displacement, rates: Rates) -> Rates:
        """Return the rates of the compliant coordinates and of the elastic stretches.

        An elastic stretch is the displacement in a stiff direction without the part that
        belongs to the compliant coordinates. Its rate is multiplied by the square root of
        the ratio of the stiffness to that in the reference configuration. A damping
        proportional to the reference stiffness then acts like one proportional to the
        stiffness at this displacement, as in a solid with one damping time for all
        strains.

        Args:
            displacement: Displacement of frame b relative to frame a.
            rates: Rates of the twist; rad/s, m/s, m/s.

        Returns:
            The rates; rad/s, m/s, m/s.
        """
        at = self.potential_variables(displacement)
        stretch_rates = resisted_stretch_rates(self.potential, at, self._scaled(rates))
        resisted = list(rates)
        for k, rate in zip(self.stiff, stretch_rates, strict=True):
            resisted[k] = rate / self._units[k]
        rotation, axial, transverse = resisted
        return rotation, axial, transverse

    def _scaled(self, coordinates: Strain | Rates) -> tuple[Variables, Variables]:
        """Divide compliant coordinates by `_units`, and multiply the others by them."""
        units = self._units
        return (
            tuple(coordinates[k] / units[k] for k in range(3) if k not in self.stiff),
            tuple(coordinates[k] * units[k] for k in self.stiff),
        )


class AbstractPolynomialMixedEnergy(AbstractMixedEnergy, CoordinateEnergy):
    """A mixed energy whose potential is a polynomial of components of the twist."""

    coefficients: Float[Array, " terms"]
    length: Scalar
    force: Scalar
    powers: Powers = eqx.field(static=True)

    def _set(
        self,
        coefficients: CoefficientsLike,
        powers: Sequence[Sequence[int]],
        names: Sequence[str],
        length: NumberLike,
        force: NumberLike,
    ) -> None:
        """Check the fields that all these energies have, and set them."""
        self.powers = require_powers(powers, names)
        self.coefficients = as_float(coefficients)
        self.length = require_positive("`length`", length)
        self.force = require_positive("`force`", force)
        require_coefficients(self, self.coefficients, self.powers)

    @property
    def reference_force(self) -> Scalar:
        """Reference force; N."""
        return self.force

    @property
    def coordinates(self) -> Coordinates:
        """All coordinates are components of the twist."""
        return "twist"

    @property
    def is_unloaded(self) -> bool:
        return all(sum(row) != 1 for row in self.powers)

    def coordinates_at(self, displacement: Displacement) -> Strain:
        return strain(displacement, "twist")

    def validation_error(self) -> str | None:
        """Describe an invalid coefficient; None if all are valid."""
        if error := coefficients_error(self.coefficients, self.powers):
            return error
        values = concrete(self.coefficients)
        squares = ((0, 2, 0), (0, 0, 2))[-len(self.stiff) :]
        kind = "axial compliance"
        if len(squares) == 2:
            kind = "compliance in a stiff direction"
        for row in squares:
            if row not in self.powers or (
                values is not None and values[self.powers.index(row)] >= 0
            ):
                return (
                    f"the coefficient of the term with powers {row} is missing or not "
                    f"negative. It must be negative, so that the {kind} is positive."
                )
        return None

    def dilated(self, scale: Float[Array, "*batch"]) -> AbstractEnergy:
        """Return the energy if all dimensions of the hinge are multiplied."""
        return multiply_fields(self, scale, coefficients=[3], length=1, force=2)


class MixedEnergy(AbstractPolynomialMixedEnergy):
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

    flexure: bool = eqx.field(static=True, default=False)
    stress_model: AbstractStressModel | None = eqx.field(default=None, repr=False)

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
        self._set(coefficients, powers, VARIABLES["mixed"], length, force)

    @property
    def order(self) -> int:
        """Largest sum of the powers of rotation and transverse displacement in a term."""
        return max(row[0] + row[1] for row in self.powers)

    @property
    def potential(self) -> OneForcePotential:
        """The polynomial W."""
        return OneForcePotential(self.coefficients, self.powers)

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


class _NewtonModel(AbstractEnergy):
    """Replacement of a mixed energy in Newton's method, near predicted forces.

    The displacements and the forces in the stiff directions are independent unknowns, and
    the residual of their relation is eliminated to first order. With the energy itself, a
    transverse Newton step would stretch the flexure, because the axial shortening by
    bending is of second order. The large axial force of this stretch would slow down
    Newton's method.
    """

    energy: AbstractMixedEnergy
    forces: Variables  # Predicted forces, over their reference values

    def stored_energy(self, displacement: Displacement) -> Scalar:
        variables = self.energy.potential_variables(displacement)
        return _model_energy(self.energy.potential, self.forces, *variables)


@jax.custom_jvp
def _model_energy(
    potential: AbstractPotential,
    forces: Variables,
    compliant: Variables,
    stretches: Variables,
) -> Scalar:
    """Compute the energy (J) after one Newton step from predicted forces."""
    at = PotentialDerivatives.of(potential, compliant, forces)
    residual = sums(stretches, at.by_forces)
    half = dot(residual, force_step(at.by_forces_twice, residual)) / 2
    return dot(stretches, forces) + at.value + half


# Derivatives with respect to the potential and the predicted forces are not implemented:
# Newton's method calls these functions on a system without derivatives (`stop_gradient`
# in `solve.statics`).
@_model_energy.defjvp
def _(primals, tangents):
    by_compliant, forces = _model_gradient(*primals)
    _, _, compliant_rates, stretch_rates = tangents
    rate = dot(by_compliant, compliant_rates) + dot(forces, stretch_rates)
    return _model_energy(*primals), rate


@jax.custom_jvp
def _model_gradient(
    potential: AbstractPotential,
    forces: Variables,
    compliant: Variables,
    stretches: Variables,
) -> tuple[Variables, Variables]:
    """Compute the gradient of the model energy with respect to its last two arguments.

    The gradient is correct to first order in the residual, the stretches plus the
    derivatives of W with respect to the forces. In its derivative, terms of this order
    are neglected.
    """
    at = PotentialDerivatives.of(potential, compliant, forces)
    step = force_step(at.by_forces_twice, sums(stretches, at.by_forces))
    return sums(at.by_compliant, times(at.mixed, step)), sums(forces, step)


@_model_gradient.defjvp
def _(primals, tangents):
    potential, forces, compliant, _ = primals
    _, _, compliant_rates, stretch_rates = tangents
    at = PotentialDerivatives.of(potential, compliant, forces)
    elastic_rates = sums(stretch_rates, times(transposed(at.mixed), compliant_rates))
    step = force_step(at.by_forces_twice, elastic_rates)
    slopes = times(at.by_compliant_twice, compliant_rates)
    rates = sums(slopes, times(at.mixed, step)), step
    return _model_gradient(*primals), rates
