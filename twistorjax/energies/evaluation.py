"""Values and derivatives of polynomials of a displacement's coordinates.

`evaluate_polynomial` evaluates a polynomial for an energy. `term_wrenches` evaluates each
term on its own at many poses; these values are the matrix of the
least-squares problem of a fit.
"""

import math
from functools import lru_cache, partial, reduce
from operator import mul

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from .._utils.pytrees import is_zero
from .._utils.types import Scalar
from ..geometry import se2
from ..geometry.twistors import Displacement
from .monomials import Powers
from .strains import Coordinates, translation_scale


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


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def evaluate_polynomial(
    powers: Powers,
    derivatives: tuple[int, ...],
    coefficients: Float[Array, " terms"],
    variables: tuple[Scalar, ...],
) -> Scalar:
    """Evaluate a polynomial or one of its partial derivatives.

    The value is in the unit of the coefficients. `derivatives` is the order of the
    derivative with respect to each variable. Horner's scheme is written out in scalars.
    XLA fuses a batch of them into one loop, which is a hundred times as fast as a lookup
    of powers in a table. Each derivative is again evaluated by this function.
    """
    return _horner(powers, derivatives, coefficients, variables)


@partial(evaluate_polynomial.defjvp, symbolic_zeros=True)
def _(powers, derivatives, primals, tangents):
    coefficients, variables = primals
    coefficient_rates, variable_rates = tangents
    value = evaluate_polynomial(powers, derivatives, coefficients, variables)
    total = jnp.zeros_like(value)
    if not is_zero(coefficient_rates):
        total = evaluate_polynomial(powers, derivatives, coefficient_rates, variables)
    for k, rate in enumerate(variable_rates):
        higher = tuple(count + (k == index) for index, count in enumerate(derivatives))
        if not is_zero(rate) and _differentiated_terms(powers, higher):
            slope = evaluate_polynomial(powers, higher, coefficients, variables)
            total = total + rate * slope
    return value, total


@lru_cache
def _differentiated_terms(
    powers: Powers, derivatives: tuple[int, ...]
) -> tuple[tuple[int, float, tuple[int, ...]], ...]:
    """List index, factor, and powers of the terms of a partial derivative."""
    return tuple(
        (
            term,
            float(math.prod(map(math.perm, row, derivatives))),
            tuple(power - count for power, count in zip(row, derivatives, strict=True)),
        )
        for term, row in enumerate(powers)
        if all(power >= count for power, count in zip(row, derivatives, strict=True))
    )


@partial(jax.jit, static_argnums=(0, 1))  # traced once for each derivative
def _horner(powers, derivatives, coefficients, variables):
    """Evaluate a partial derivative of a polynomial; see `evaluate_polynomial`."""
    remaining = _differentiated_terms(powers, derivatives)
    if not remaining:
        return jnp.zeros_like(variables[0])
    terms, factors, rows = zip(*remaining, strict=True)
    scaled = coefficients[np.array(terms)] * np.array(factors)
    values = [lax.index_in_dim(scaled, k, keepdims=False) for k in range(len(terms))]
    known_powers = {}

    def power_of(variable: int, power: int) -> Scalar:
        if power == 1:
            return variables[variable]
        if (variable, power) not in known_powers:
            half = power // 2
            known_powers[variable, power] = lax.mul(
                power_of(variable, half), power_of(variable, power - half)
            )
        return known_powers[variable, power]

    def nested(terms: list[tuple[tuple[int, ...], Scalar]], variable: int) -> Scalar:
        if variable == len(variables):
            return terms[0][1]
        groups: dict[int, list] = {}
        for row, value in terms:
            groups.setdefault(row[variable], []).append((row, value))
        total, last = None, 0
        for power in sorted(groups, reverse=True):
            inner = nested(groups[power], variable + 1)
            if total is None:
                total = inner
            else:
                total = lax.add(lax.mul(total, power_of(variable, last - power)), inner)
            last = power
        assert total is not None
        return total if last == 0 else lax.mul(total, power_of(variable, last))

    return nested(list(zip(rows, values, strict=True)), 0)


@partial(jax.jit, static_argnums=(2, 3))
def term_wrenches(
    poses: Float[Array, "trials 3"],
    scale: Scalar,
    powers: Powers,
    coordinates: Coordinates,
) -> tuple[Float[Array, "trials 3 terms"], Float[Array, "trials terms"]]:
    """Compute the wrench and the energy of each term of a polynomial at many poses.

    Args:
        poses: Poses of frame b relative to frame a; rad, m, m.
        scale: Length by which the translations are divided; m.
        powers: Powers of each term.
        coordinates: "twist" or "twistor".

    Returns:
        The wrenches about frame b in its axes (N m, N, N), and the energies (J), for
        coefficients of 1 J.
    """
    exponents = np.array(powers).reshape(len(powers), -1)

    def variables(pose: Array) -> Array:
        displacement = Displacement.from_pose(pose)
        return jnp.stack(polynomial_variables(displacement, coordinates, scale))

    values, slopes = jax.vmap(
        lambda pose: (variables(pose), jax.jacfwd(variables)(pose))
    )(poses)
    tables = [
        power_derivatives(values[:, k], exponents[:, k])
        for k in range(exponents.shape[1])
    ]
    factors = [power for power, *_ in tables]
    energies = reduce(mul, factors)
    gradients = jnp.zeros((len(poses), 3, len(powers)))
    for k, (_, derivative, _) in enumerate(tables):
        partial_derivative = reduce(mul, [*factors[:k], derivative, *factors[k + 1 :]])
        gradients = gradients + slopes[:, k, :, None] * partial_derivative[:, None]
    rotate_terms = jax.vmap(jax.vmap(se2.rotate, (None, 1), 1))
    forces = rotate_terms(-poses[:, 0], gradients[:, 1:])
    return jnp.concatenate([gradients[:, :1], forces], axis=1), energies


def power_derivatives(
    values: Float[Array, " trials"], exponents: np.ndarray
) -> list[Array]:
    """Compute powers of a variable, and the first two derivatives of these powers.

    Each of the three arrays has a row for each value and a column for each exponent.
    """
    rows = [jnp.ones_like(values)]
    for _ in range(exponents.max(initial=0)):
        rows.append(rows[-1] * values)
    table = jnp.stack(rows, axis=1)
    factors = np.ones(exponents.shape), exponents * 1.0, exponents * (exponents - 1.0)
    return [
        jnp.asarray(factor)[None] * table[:, np.maximum(exponents - derivative, 0)]
        for derivative, factor in enumerate(factors)
    ]
