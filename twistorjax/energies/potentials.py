"""The potential W of a flexure, and its maximum over the forces in stiff directions.

W is a function of three variables: the coordinates in the compliant directions, and the
forces in the one or two stiff directions. A coordinate is divided by 1 rad or a length,
and a force by a reference moment or force, so that all variables are dimensionless. A
stretch is the displacement in a stiff direction times the reference force; J. The energy
is the maximum of `f . s + W(c, f)` over the forces f at the stretches s.
"""

import math
from abc import abstractmethod
from collections.abc import Sequence
from functools import partial, reduce
from itertools import product
from operator import add, mul
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._utils.pytrees import jvp_of_varied
from .._utils.types import Scalar
from .evaluation import Orders, PartialSums, polynomial_derivatives, split_terms
from .monomials import Powers


Variables = tuple[Scalar, ...]  # coordinates, forces, or stretches; or their rates
Rows = tuple[Variables, ...]  # of a matrix

# Orders of the first derivatives by the three variables
_FIRST_ORDERS = (1, 0, 0), (0, 1, 0), (0, 0, 1)
_STEPS = 6  # of Newton's method


def variable_units(
    stiff: tuple[int, ...], length: Scalar | float, force: Scalar | float
) -> tuple[Scalar | float, ...]:
    """Return the values by which coordinates and forces are divided.

    They are in the order rotation, axial, transverse. `stiff` lists the directions in
    which it is a moment or a force (N m, N), and not an angle or a length (rad, m).
    """
    coordinates = 1.0, length, length
    forces = force * length, force, force
    return tuple(forces[k] if k in stiff else coordinates[k] for k in range(3))


class AbstractPotential(eqx.Module):
    """The potential W of a flexure."""

    @property
    @abstractmethod
    def reference_curvature(self) -> Rows:
        """Second derivatives by the forces, in the reference configuration; J."""

    @abstractmethod
    def derivatives(
        self, orders: tuple[Orders, ...], compliant: Variables, forces: Variables
    ) -> Variables:
        """Evaluate partial derivatives of W; J.

        The orders (0, 0, 0) are those of W itself. The sum of the orders is at most two.
        """

    @abstractmethod
    def forces_at(self, compliant: Variables, stretches: Variables) -> Variables:
        """Find the forces at stretches by Newton's method.

        They are NaN if the stationary value is not a maximum. Their derivatives are those
        of `force_ratios`.

        `optimistix.root_find` takes five times as long to compile and twice as long to
        run (100,000 values and derivatives), so the small Newton iterations of this
        library are loops of fixed length.
        """


class AbstractPolynomialPotential(AbstractPotential):
    """A potential that is a polynomial, at least for forces up to their references."""

    coefficients: Float[Array, " terms"]  # Coefficients of the terms; J
    powers: Powers = eqx.field(static=True)  # Powers of the three variables in each term

    def reference_derivative(self, orders: Orders) -> Scalar:
        """Evaluate a partial derivative in the reference configuration; J."""
        if orders not in self.powers:
            return jnp.zeros_like(self.coefficients[0])
        factor = math.prod(map(math.factorial, orders))
        return factor * self.coefficients[self.powers.index(orders)]


class OneForcePotential(AbstractPolynomialPotential):
    """A polynomial potential of two coordinates and one force.

    Outside of the relative forces from minus one to one, it is a parabola of the force.
    """

    @property
    def reference_curvature(self) -> Rows:
        return ((self.reference_derivative((0, 0, 2)),),)

    def derivatives(
        self, orders: tuple[Orders, ...], compliant: Variables, forces: Variables
    ) -> Variables:
        variables = *compliant, *forces
        return polynomial_derivatives(
            self.powers, orders, self.coefficients, variables, (2,)
        )

    def forces_at(self, compliant: Variables, stretches: Variables) -> Variables:
        # The sum over the coordinates is a polynomial of the force alone.
        (stretch,) = stretches
        force_first = tuple((force, *others) for *others, force in self.powers)
        zero = jnp.zeros_like(stretch)
        terms = split_terms(force_first, self.coefficients)
        of_force = PartialSums(terms, (zero, *compliant)).over_last((0, 0))

        def slope_and_curvature(force: Scalar) -> tuple[Scalar, Scalar]:
            sums = PartialSums(of_force, (force,))
            return sums.over_last((1,)).get((), zero), sums.over_last((2,))[()]

        # Each iteration starts between minus one and one. The last one is exact outside
        # of this interval, because W is a parabola there.
        def newton_step(_, force: Scalar) -> Scalar:
            inside = jnp.clip(force, -1.0, 1.0)
            slope, curvature = slope_and_curvature(inside)
            return inside - (stretch + slope) / curvature

        force = jax.lax.fori_loop(0, _STEPS, newton_step, zero)
        _, curvature = slope_and_curvature(jnp.clip(force, -1.0, 1.0))
        return (jnp.where(curvature < 0, force, jnp.nan),)


class TwoForcePotential(AbstractPolynomialPotential):
    """A polynomial potential of one coordinate and two forces.

    In terms of third and higher order in the forces, a force beyond its reference value
    saturates. There W is nearly quadratic in the forces, so it has a maximum.
    """

    @property
    def reference_curvature(self) -> Rows:
        first, both, second = map(
            self.reference_derivative, ((0, 2, 0), (0, 1, 1), (0, 0, 2))
        )
        return (first, both), (both, second)

    def derivatives(
        self, orders: tuple[Orders, ...], compliant: Variables, forces: Variables
    ) -> Variables:
        # W is a polynomial of the coordinate, the forces, and the saturated forces.
        powers = tuple(
            (c, 0, 0, i, j) if i + j > 2 else (c, i, j, 0, 0) for c, i, j in self.powers
        )
        saturated, slopes, curvatures = zip(*map(_saturate, forces), strict=True)
        chain_rules = []
        for c, i, j in orders:
            rule: dict[Orders, Scalar | float] = {(c, i, j, 0, 0): 1.0}
            rule[c, 0, 0, i, j] = slopes[0] ** i * slopes[1] ** j
            if i == 2:
                rule[c, 0, 0, 1, 0] = curvatures[0]
            if j == 2:
                rule[c, 0, 0, 0, 1] = curvatures[1]
            chain_rules.append(rule)
        needed = tuple({row: None for rule in chain_rules for row in rule})
        variables = *compliant, *forces, *saturated
        values = polynomial_derivatives(powers, needed, self.coefficients, variables)
        value_of = dict(zip(needed, values, strict=True))
        return tuple(
            reduce(add, (factor * value_of[row] for row, factor in rule.items()))
            for rule in chain_rules
        )

    def forces_at(self, compliant: Variables, stretches: Variables) -> Variables:
        def newton_step(_, forces: Variables) -> Variables:
            at = PotentialDerivatives.of(self, compliant, forces)
            step = force_step(at.by_forces_twice, sums(stretches, at.by_forces))
            return sums(forces, step)

        zeros = tuple(map(jnp.zeros_like, stretches))
        forces = jax.lax.fori_loop(0, _STEPS, newton_step, zeros)
        _, ((first, both), (_, second)) = mixed_and_curvature(self, compliant, forces)
        is_maximum = (first < 0) & (first * second > both**2)
        return tuple(jnp.where(is_maximum, force, jnp.nan) for force in forces)


def _saturate(force: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Limit a relative force to the interval from -2 to 2, with two derivatives.

    The function is the identity from -1 to 1, and twice continuously differentiable.
    """
    inside = jnp.clip(force, -1.0, 1.0)
    excess = jnp.tanh(force - inside)
    slope = 1 - excess**2
    return inside + excess, slope, -2 * excess * slope


class PotentialDerivatives(NamedTuple):
    """W and its derivatives; J."""

    value: Scalar  # W
    by_compliant: Variables
    by_forces: Variables
    by_compliant_twice: Rows
    mixed: Rows  # by each coordinate (rows) and each force
    by_forces_twice: Rows

    @classmethod
    def of(
        cls, potential: AbstractPotential, compliant: Variables, forces: Variables
    ) -> "PotentialDerivatives":
        """Evaluate them together, so that they share their sums."""
        orders = tuple(row for row in product(range(3), repeat=3) if sum(row) <= 2)
        values = potential.derivatives(orders, compliant, forces)
        value_of = dict(zip(orders, values, strict=True))

        def twice(rows: tuple[Orders, ...], columns: tuple[Orders, ...]) -> Rows:
            return tuple(tuple(value_of[sums(i, j)] for j in columns) for i in rows)

        c, f = _FIRST_ORDERS[: len(compliant)], _FIRST_ORDERS[len(compliant) :]
        return cls(
            value=value_of[0, 0, 0],
            by_compliant=tuple(value_of[row] for row in c),
            by_forces=tuple(value_of[row] for row in f),
            by_compliant_twice=twice(c, c),
            mixed=twice(c, f),
            by_forces_twice=twice(f, f),
        )


def mixed_and_curvature(
    potential: AbstractPotential, compliant: Variables, forces: Variables
) -> tuple[Rows, Rows]:
    """Evaluate second derivatives by each coordinate and force, and by two forces; J."""
    count = len(forces)
    by_forces = _FIRST_ORDERS[-count:]
    orders = tuple(sums(i, j) for i in _FIRST_ORDERS for j in by_forces)
    values = potential.derivatives(orders, compliant, forces)
    rows = tuple(values[k : k + count] for k in range(0, len(values), count))
    return rows[:-count], rows[-count:]


def force_step(curvature: Rows, residual: Variables) -> Variables:
    """Return the change of the forces that eliminates a residual (J)."""
    if len(curvature) == 1:
        return (-residual[0] / curvature[0][0],)
    (first, both), (_, second) = curvature
    determinant = first * second - both**2
    return (
        (both * residual[1] - second * residual[0]) / determinant,
        (both * residual[0] - first * residual[1]) / determinant,
    )


def dot(first: Variables, second: Variables) -> Scalar:
    """Compute a scalar product."""
    return reduce(add, map(mul, first, second))


def sums(first: Sequence, second: Sequence) -> tuple:
    """Add two vectors."""
    return tuple(map(add, first, second))


def times(rows: Rows, vector: Variables) -> Variables:
    """Multiply a matrix by a vector."""
    return tuple(dot(row, vector) for row in rows)


def transposed(rows: Rows) -> Rows:
    """Transpose a matrix."""
    return tuple(zip(*rows, strict=True))


@jax.custom_jvp
def maximum_over_forces(
    potential: AbstractPotential, compliant: Variables, stretches: Variables
) -> Scalar:
    """Compute the stored energy, the maximum of `f . s + W` over the forces f; J."""
    forces = force_ratios(potential, compliant, stretches)
    return _energy_at_forces(forces, potential, compliant, stretches)


@partial(maximum_over_forces.defjvp, symbolic_zeros=True)
def _(primals, tangents):
    # At the maximum, the derivatives with respect to the forces are zero.
    at_forces = partial(_energy_at_forces, force_ratios(*primals))
    return jvp_of_varied(at_forces, primals, tangents)


def _energy_at_forces(
    forces: Variables,
    potential: AbstractPotential,
    compliant: Variables,
    stretches: Variables,
) -> Scalar:
    """Compute `f . s + W`; J."""
    (value,) = potential.derivatives(((0, 0, 0),), compliant, forces)
    return dot(stretches, forces) + value


@jax.custom_jvp
def force_ratios(
    potential: AbstractPotential, compliant: Variables, stretches: Variables
) -> Variables:
    """Compute the relative forces at stretches (J); see `AbstractPotential.forces_at`."""
    return potential.forces_at(compliant, stretches)


@partial(force_ratios.defjvp, symbolic_zeros=True)
def _(primals, tangents):
    forces = force_ratios(*primals)
    by_forces = _FIRST_ORDERS[-len(forces) :]

    def residual(
        potential: AbstractPotential, compliant: Variables, stretches: Variables
    ) -> Variables:
        return sums(stretches, potential.derivatives(by_forces, compliant, forces))

    _, residual_rates = jvp_of_varied(residual, primals, tangents)
    potential, compliant, _ = primals
    _, curvature = mixed_and_curvature(potential, compliant, forces)
    return forces, force_step(curvature, residual_rates)


def resisted_stretch_rates(
    potential: AbstractPotential,
    at: tuple[Variables, Variables],
    rates: tuple[Variables, Variables],
) -> Variables:
    """Return the elastic stretch rates, scaled by the stiffness; J/s.

    With the stiffness K and that of the reference configuration K0, both factorized as L
    L^T, the elastic rates are multiplied by `L0^-T L^T`. Their power with K0 is then that
    of the elastic rates with K. Stretches are in J.
    """
    compliant, stretches = at
    forces = force_ratios(potential, compliant, stretches)
    mixed, now = mixed_and_curvature(potential, compliant, forces)
    reference = potential.reference_curvature
    compliant_rates, stretch_rates = rates
    elastic = sums(stretch_rates, times(transposed(mixed), compliant_rates))
    # L^-T is the upper triangular factor U of the compliance U U^T.
    if len(elastic) == 1:
        return (jnp.sqrt(reference[0][0] / now[0][0]) * elastic[0],)
    (a, b, d), (a0, b0, d0) = _upper_factor(now), _upper_factor(reference)
    second = elastic[1] / d
    return a0 * (elastic[0] - b * second) / a + b0 * second, d0 * second


def _upper_factor(curvature: Rows) -> tuple[Scalar, Scalar, Scalar]:
    """Factorize the compliance, minus the second derivatives by two forces."""
    (first, both), (_, second) = curvature
    d = jnp.sqrt(-second)
    b = -both / d
    return jnp.sqrt(-first - b**2), b, d
