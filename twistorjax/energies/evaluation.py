"""Values and derivatives of polynomials of a displacement's coordinates.

`polynomial_derivatives` evaluates a polynomial for an energy. `term_wrenches` evaluates
each term on its own at many poses; these values are the matrix of the least-squares
problem of a fit.
"""

import math
from functools import partial, reduce
from operator import mul
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from .._utils.host import on_host, padded_size
from .._utils.pytrees import is_zero
from .._utils.types import Scalar
from ..geometry.twistors import Displacement
from .monomials import Powers
from .strains import Coordinates, translation_scale


AnyArray = Array | np.ndarray  # of JAX or of NumPy
Coefficients = Float[Array, " terms"]
Orders = tuple[int, ...]  # of a partial derivative, with respect to each variable


def polynomial_variables(
    displacement: Displacement, coordinates: Coordinates, scale: Scalar
) -> tuple[Scalar, ...]:
    """Compute the variables of a polynomial energy, in the order of `VARIABLES`.

    Translations are divided by the length `scale` (m). The other variables are tau (rad),
    or sigma and xi.
    """
    if coordinates == "twist":
        ratio = 2 * translation_scale(displacement, "twist") / scale
        return displacement.angle, ratio * displacement.x1, ratio * displacement.x2
    x1, x2 = displacement.x1 / scale, displacement.x2 / scale
    return displacement.sigma, displacement.xi, x1, x2


def evaluate_polynomial(
    powers: Powers, coefficients: Coefficients, variables: tuple[Scalar, ...]
) -> Scalar:
    """Evaluate a polynomial; the value is in the unit of the coefficients."""
    value = (0,) * len(variables)
    return polynomial_derivatives(powers, (value,), coefficients, variables)[0]


@partial(jax.custom_jvp, nondiff_argnums=(0, 1, 4))
def polynomial_derivatives(
    powers: Powers,
    orders: tuple[Orders, ...],
    coefficients: Coefficients,
    variables: tuple[Scalar, ...],
    continued: tuple[int, ...] = (),
) -> tuple[Scalar, ...]:
    """Evaluate several partial derivatives of a polynomial.

    They share the sums over the last variables. JAX differentiates this function by
    further partial derivatives, which share these sums, too. Outside of the interval from
    -1 to 1, the powers of the variables with the indices `continued` are continued by
    their second-order Taylor polynomials.
    """
    return _evaluate(powers, orders, coefficients, variables, continued)


@partial(polynomial_derivatives.defjvp, symbolic_zeros=True)
def _(powers, orders, continued, primals, tangents):
    _, variables = primals
    coefficient_rates, variable_rates = tangents
    rates = {k: rate for k, rate in enumerate(variable_rates) if not is_zero(rate)}
    raised = [_raised(row, k) for row in orders for k in rates]
    needed = tuple(dict.fromkeys([*orders, *raised]))
    values = polynomial_derivatives(powers, needed, *primals, continued)
    value_of = dict(zip(needed, values, strict=True))
    slopes = [jnp.zeros_like(value) for value in values[: len(orders)]]
    if not is_zero(coefficient_rates):
        slopes = polynomial_derivatives(
            powers, orders, coefficient_rates, variables, continued
        )
    for k, rate in rates.items():
        slopes = [
            slope + rate * value_of[_raised(row, k)]
            for slope, row in zip(slopes, orders, strict=True)
        ]
    return tuple(value_of[row] for row in orders), tuple(slopes)


def _raised(orders: Orders, variable: int) -> Orders:
    """Raise the order of the derivative with respect to one variable by one."""
    return tuple(order + (k == variable) for k, order in enumerate(orders))


@partial(jax.jit, static_argnums=(0, 1, 4))  # traced once for all uses
def _evaluate(powers, orders, coefficients, variables, continued):
    """Evaluate partial derivatives of a polynomial; see `polynomial_derivatives`."""
    sums = PartialSums(split_terms(powers, coefficients), variables, continued)
    zero = jnp.zeros_like(variables[0])
    return tuple(sums.over_last(row).get((), zero) for row in orders)


def split_terms(
    powers: Powers, coefficients: Coefficients
) -> dict[tuple[int, ...], Scalar]:
    """Return the coefficient for each combination of powers."""
    return dict(zip(powers, jnp.unstack(coefficients), strict=True))


class PartialSums:
    """Sums of the terms of a polynomial, or of its derivatives, over the last variables.

    They are written out in scalars. XLA fuses a batch of them into one loop, which is a
    hundred times as fast as a lookup of powers in a table. `terms` has the coefficient
    for each combination of powers; for `continued`, see `polynomial_derivatives`.
    """

    def __init__(
        self,
        terms: dict[tuple[int, ...], Scalar],
        variables: tuple[Scalar, ...],
        continued: tuple[int, ...] = (),
    ):
        self._sums: dict[Orders, dict[tuple[int, ...], Scalar]] = {(): terms}
        self._powers = [
            _PowersOf(variable, k in continued) for k, variable in enumerate(variables)
        ]

    def over_last(self, orders: Orders) -> dict[tuple[int, ...], Scalar]:
        """Return the sums over as many of the last variables as there are `orders`.

        These are the orders of the derivative. The sums are those of all terms that have
        the same powers of the other variables.
        """
        if orders not in self._sums:
            sums: dict[tuple[int, ...], Scalar] = {}
            powers = self._powers[-len(orders)]
            for (*others, power), value in self.over_last(orders[1:]).items():
                if power >= orders[0]:
                    term = powers.multiply(value, power, orders[0])
                    key = tuple(others)
                    sums[key] = lax.add(sums[key], term) if key in sums else term
            self._sums[orders] = sums
        return self._sums[orders]


class _PowersOf:
    """Powers of one variable, and their derivatives; see `polynomial_derivatives`."""

    def __init__(self, variable: Scalar, continued: bool):
        self._inside, self._outside = variable, None
        if continued:
            self._inside = jnp.clip(variable, -1.0, 1.0)
            self._outside = variable - self._inside
        self._powers = {1: self._inside}
        self._derivatives: dict[tuple[int, int], Scalar] = {}

    def multiply(self, value: Scalar, power: int, order: int) -> Scalar:
        """Multiply a value by a derivative of a power."""
        if (power, order) in ((0, 0), (1, 1)):
            return value
        if (power, order) not in self._derivatives:
            self._derivatives[power, order] = self._derivative(power, order)
        return lax.mul(value, self._derivatives[power, order])

    def _derivative(self, power: int, order: int) -> Scalar:
        total = self._derivative_inside(power, order)
        if self._outside is None:
            return total
        if order > 2:
            return jnp.where(self._outside == 0, total, 0.0)
        for more in range(1, 1 + min(power, 2) - order):
            slope = self._derivative_inside(power, order + more)
            total = total + self._outside**more / math.factorial(more) * slope
        return total

    def _derivative_inside(self, power: int, order: int) -> Scalar:
        """Compute a derivative of a power in the interval."""
        factor = float(math.perm(power, order))
        if power == order:
            return jnp.full_like(self._inside, factor)
        value = self._power(power - order)
        return value if factor == 1.0 else factor * value

    def _power(self, power: int) -> Scalar:
        """Compute a power from smaller ones."""
        if power not in self._powers:
            half = power // 2
            product = lax.mul(self._power(half), self._power(power - half))
            self._powers[power] = product
        return self._powers[power]


def term_wrenches(
    poses: Float[AnyArray, "trials 3"],
    scale: Scalar | float,
    powers: Powers,
    coordinates: Coordinates,
) -> tuple[Float[np.ndarray, "trials 3 terms"], Float[np.ndarray, "trials terms"]]:
    """Compute the wrench and the energy of each term of a polynomial at many poses.

    JAX differentiates the variables, in a program that does not depend on the powers. A
    program for each order would compile for longer than the whole fit takes. The
    coefficients are 1 J. Translations are divided by the length `scale` (m). The wrenches
    are about frame b in its axes (N m, N, N).
    """
    poses = np.asarray(poses)
    values, slopes, _ = _variables_at(poses, scale, coordinates)
    tables = _power_tables(values, powers)
    energies = reduce(mul, [power for power, *_ in tables])
    gradients = np.zeros((len(poses), 3, len(powers)))
    for k in range(len(tables)):
        by_variable = partial_derivative(tables, (k,))
        gradients += slopes[:, k, :, None] * by_variable[:, None]
    c, s = np.cos(poses[:, :1]), np.sin(poses[:, :1])
    moment, force_x, force_y = np.moveaxis(gradients, 1, 0)
    wrenches = moment, c * force_x + s * force_y, c * force_y - s * force_x
    return np.stack(wrenches, axis=1), energies


def term_stiffnesses(
    scale: Scalar | float, powers: Powers, coordinates: Coordinates
) -> Float[np.ndarray, "3 3 terms"]:
    """Compute the second derivatives of each term of a polynomial in the reference.

    They are derivatives with respect to the pose (N m/rad, N/rad, N/m), for coefficients
    of 1 J. Translations are divided by the length `scale` (m).
    """
    values, slopes, curvatures = _variables_at(np.zeros((1, 3)), scale, coordinates)
    tables = _power_tables(values, powers)
    stiffnesses = np.zeros((3, 3, len(powers)))
    for k in range(len(tables)):
        stiffnesses += curvatures[0, k, :, :, None] * partial_derivative(tables, (k,))
        for other in range(len(tables)):
            product = np.outer(slopes[0, k], slopes[0, other])
            stiffnesses += product[..., None] * partial_derivative(tables, (k, other))
    return stiffnesses


def _variables_at(
    poses: Float[np.ndarray, "trials 3"], scale: Scalar | float, coordinates: Coordinates
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evaluate the variables of a polynomial and their first two derivatives by the pose.

    The first axis is that of the poses, the second one that of the variables.
    """
    padded = np.zeros((padded_size(len(poses), 256), 3))
    padded[: len(poses)] = poses
    found = _variables_and_derivatives(padded, np.asarray(scale, float), coordinates)
    values, slopes, curvatures = (np.asarray(array)[: len(poses)] for array in found)
    return values, slopes, curvatures


@partial(jax.jit, static_argnums=2)
def _variables_and_derivatives(
    poses: Float[Array, "trials 3"], scale: Scalar, coordinates: Coordinates
) -> tuple[Array, Array, Array]:
    """Differentiate the variables of a polynomial by the pose; see `_variables_at`."""

    def variables(pose: Any) -> Array:
        displacement = Displacement.from_pose(pose)
        return jnp.stack(polynomial_variables(displacement, coordinates, scale))

    slopes = jax.jacfwd(variables)
    return (
        jax.vmap(variables)(poses),
        jax.vmap(slopes)(poses),
        jax.vmap(jax.jacfwd(slopes))(poses),
    )


def _power_tables(
    values: Float[np.ndarray, "trials variables"], powers: Powers
) -> list[list[Any]]:
    """Compute the powers of each variable and their first two derivatives."""
    exponents = np.array(powers).reshape(len(powers), -1)
    return [
        power_derivatives(values[:, k], exponents[:, k])
        for k in range(exponents.shape[1])
    ]


def partial_derivative(
    tables: list[list[Any]], variables: tuple[int, ...]
) -> Float[AnyArray, "trials terms"]:
    """Differentiate each term once with respect to each of some variables."""
    return reduce(mul, [table[variables.count(k)] for k, table in enumerate(tables)])


def power_derivatives(
    values: Float[AnyArray, " trials"], exponents: np.ndarray
) -> list[Any]:
    """Compute powers of a variable, and the first two derivatives of these powers.

    Each of the three arrays has a row for each value and a column for each exponent.
    """
    xp, (values,) = on_host(values)
    rows = [xp.ones_like(values)]
    for _ in range(exponents.max(initial=0)):
        rows.append(rows[-1] * values)
    table = xp.stack(rows, axis=1)
    factors = np.ones(exponents.shape), exponents * 1.0, exponents * (exponents - 1.0)
    return [
        factor[None] * table[:, np.maximum(exponents - derivative, 0)]
        for derivative, factor in enumerate(factors)
    ]
