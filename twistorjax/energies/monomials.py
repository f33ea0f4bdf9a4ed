"""Monomials of a displacement's coordinates: which there are, their sums and changes."""

import math
from collections.abc import Sequence
from functools import lru_cache, partial, reduce
from itertools import product
from operator import mul
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from .._utils.types import Scalar
from .._utils.validation import require_choice
from ..geometry import se2
from ..geometry.twistors import Displacement
from .strains import Coordinates, stretch


Powers = tuple[tuple[int, ...], ...]
Symmetry = Literal["leaf", "mirror", "ends", "exchange", "sign"]

VARIABLES = {
    "twist": ("tau", "t1", "t2"),
    "twistor": ("sigma", "xi", "x1", "x2"),
    "tension": ("tau", "t2", "n"),
}

# Which variables change sign together
_PARITY = {
    "mirror": {"xi", "x2", "tau", "t2"},
    "ends": {"xi", "tau"},
    "exchange": {"xi", "x1", "x2", "tau", "t1", "t2", "n"},
    "sign": {"sigma", "xi", "x1", "x2"},
}
LEAF = ("mirror", "ends")


def monomials(
    order: int,
    coordinates: Coordinates | Literal["tension"] = "twistor",
    *,
    symmetry: Symmetry | Sequence[Symmetry] = (),
    redundant: bool = False,
) -> Powers:
    """The powers of all monomials up to an order, in the dissertation's sequence.

    Args:
        order: the largest sum of powers in one.
        coordinates: "twist" for powers of (tau, t1, t2), "twistor" for those of
            (sigma, xi, x1, x2); "tension" for those of a `MixedEnergy` energy, (tau, t2, n):
            the order is that in the first two, and n goes to half of it and one more.
        symmetry: one or several; keeps only what is the same for a hinge

            * "mirror": and its mirror image across axis 1;
            * "ends": seen from either end, turned by half a turn;
            * "exchange": with its two bodies exchanged, frames and all;
            * "sign": and a full turn more. Of the twistor alone.

            "leaf" for the first two, and the last where it applies: a straight hinge of
            one outline on both sides, alike at both ends.
        redundant: keeps the powers of sigma above the first, too, as the dissertation
            does: they add nothing, for sigma^2 = 1 - xi^2.

    Raises:
        ValueError: the order is negative; the coordinates or a symmetry are unknown.

    Source:
        Equations 3.67 and 4.69 of the dissertation, and its listing `idx4`.

    Example:
        >>> monomials(2, "twist")[:4]
        ((0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0))
        >>> [len(monomials(order)) for order in (2, 4, 6, 8)]
        [14, 55, 140, 285]
    """
    require_choice("`coordinates`", coordinates, tuple(VARIABLES))
    names = VARIABLES[coordinates]
    if not isinstance(order, int) or order < 0:
        raise ValueError(f"`order` is {order!r}, but must be a whole number from 0 on.")
    given: Sequence[str] = (symmetry,) if isinstance(symmetry, str) else symmetry
    leaf = (*LEAF, "sign") if coordinates == "twistor" else LEAF
    kinds: list[str] = []
    for kind in given:
        require_choice("`symmetry`", kind, ("leaf", *_PARITY))
        if kind == "sign" and coordinates != "twistor":
            raise ValueError("`symmetry` has 'sign', which is one of the twistor alone.")
        kinds.extend(leaf if kind == "leaf" else (kind,))
    odd = [[name in _PARITY[kind] for name in names] for kind in kinds]
    tops = [order] * len(names)
    if coordinates == "twistor" and not redundant:
        tops[0] = min(order, 1)
    counted = slice(None)
    if coordinates == "tension":
        tops[2], counted = order // 2 + 1, slice(2)
    # the last power varies slowest
    rows = product(*(range(top + 1) for top in reversed(tops)))
    powers = (tuple(reversed(row)) for row in rows)

    def even(row: tuple[int, ...]) -> bool:
        return all(np.dot(row, parity) % 2 == 0 for parity in odd)

    return tuple(row for row in powers if sum(row[counted]) <= order and even(row))


def variables(
    displacement: Displacement, coordinates: Coordinates, scale: Scalar
) -> tuple[Scalar, ...]:
    """The coordinates of a displacement, translations in parts of the scale."""
    if coordinates == "twist":
        longer = 2 * stretch(displacement, "twist") / scale
        return displacement.angle, longer * displacement.x1, longer * displacement.x2
    x1, x2 = displacement.x1 / scale, displacement.x2 / scale
    return displacement.sigma, displacement.xi, x1, x2


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def summed(
    powers: Powers,
    times: tuple[int, ...],
    coefficients: Float[Array, " terms"],
    variables: tuple[Scalar, ...],
) -> Scalar:
    """A polynomial, differentiated so many times by each of its variables.

    Written out as Horner's scheme: a batch is one fused loop, a hundred times as fast as
    one that gathers powers from a table; and each derivative is such a polynomial again.
    """
    return _horner(powers, times, coefficients, variables)


@summed.defjvp
def _(powers, times, primals, tangents):
    coefficients, variables = primals
    of_coefficients, of_variables = tangents
    rate = summed(powers, times, of_coefficients, variables)
    for k, speed in enumerate(of_variables):
        more = tuple(count + (k == place) for place, count in enumerate(times))
        if _left(powers, more):
            rate = rate + speed * summed(powers, more, coefficients, variables)
    return summed(powers, times, coefficients, variables), rate


@lru_cache
def _left(
    powers: Powers, times: tuple[int, ...]
) -> tuple[tuple[int, float, tuple[int, ...]], ...]:
    """What differentiation leaves: which term, its factor, and its powers."""
    return tuple(
        (
            term,
            float(math.prod(map(math.perm, row, times))),
            tuple(power - count for power, count in zip(row, times, strict=True)),
        )
        for term, row in enumerate(powers)
        if all(power >= count for power, count in zip(row, times, strict=True))
    )


@partial(jax.jit, static_argnums=(0, 1))  # traced once, however often it is used
def _horner(powers, times, coefficients, variables):
    left = _left(powers, times)
    if not left:
        return jnp.zeros_like(variables[0])
    terms, factors, kept = zip(*left, strict=True)
    chosen = coefficients[np.array(terms)] * np.array(factors)
    values = [lax.index_in_dim(chosen, k, keepdims=False) for k in range(len(terms))]
    known_powers = {}

    def raised(variable: int, power: int) -> Scalar:
        if power == 1:
            return variables[variable]
        if (variable, power) not in known_powers:
            half = power // 2
            known_powers[variable, power] = lax.mul(
                raised(variable, half), raised(variable, power - half)
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
                total = lax.add(lax.mul(total, raised(variable, last - power)), inner)
            last = power
        assert total is not None
        return total if last == 0 else lax.mul(total, raised(variable, last))

    return nested(list(zip(kept, values, strict=True)), 0)


@partial(jax.jit, static_argnums=0)
def expanded(
    powers: Powers, matrix: Float[Array, "n n"]
) -> Float[Array, "terms monomials"]:
    """Each term as a polynomial of other variables, in which its own are linear."""
    size, order = len(powers[0]), max(map(sum, powers))
    degrees = [
        [row for row in _all(size, order) if sum(row) == degree]
        for degree in range(order + 1)
    ]
    place = {row: k for degree in degrees for k, row in enumerate(degree)}

    def less(row: tuple[int, ...], variable: int) -> tuple[int, ...]:
        return tuple(p - (k == variable) for k, p in enumerate(row))

    blocks = [jnp.ones((1, 1))]
    for degree in degrees[1:]:
        first = [next(k for k, power in enumerate(row) if power) for row in degree]
        parents = np.array(
            [place[less(row, k)] for row, k in zip(degree, first, strict=True)]
        )
        before = jnp.pad(blocks[-1], ((0, 0), (0, 1)))[parents]
        block = jnp.zeros((len(degree), len(degree)))
        for variable in range(size):
            source = [
                place[less(row, variable)] if row[variable] else before.shape[1] - 1
                for row in degree
            ]
            factors = matrix[np.array(first), variable]
            block = block + factors[:, None] * before[:, np.array(source)]
        blocks.append(block)
    columns = {row: k for k, row in enumerate(_all(size, order))}
    answer = jnp.zeros((len(powers), len(columns)))
    for degree, block in zip(degrees, blocks, strict=True):
        mine = np.array([k for k, row in enumerate(powers) if sum(row) == sum(degree[0])])
        if mine.size:
            rows = np.array([place[powers[k]] for k in mine])
            where = np.array([columns[row] for row in degree])
            answer = answer.at[mine[:, None], where[None]].set(block[rows])
    return answer


def _all(size: int, order: int) -> Powers:
    return monomials(order, "twist" if size == 3 else "twistor", redundant=True)


@lru_cache
def reduction(order: int) -> np.ndarray:
    """From all monomials of the twistor to those of sigma once at most."""
    wide, narrow = monomials(order, redundant=True), monomials(order)
    place = {row: k for k, row in enumerate(narrow)}
    matrix = np.zeros((len(wide), len(narrow)))
    for k, (sigma, xi, x1, x2) in enumerate(wide):
        pairs, left = divmod(sigma, 2)
        for share in range(pairs + 1):  # (1 - xi^2)^pairs
            weight = math.comb(pairs, share) * (-1) ** share
            matrix[k, place[left, xi + 2 * share, x1, x2]] += weight
    return matrix


@partial(jax.jit, static_argnums=(2, 3))
def columns(
    poses: Float[Array, "trials 3"],
    scale: Scalar,
    powers: Powers,
    coordinates: Coordinates,
) -> tuple[Float[Array, "trials 3 terms"], Float[Array, "trials terms"]]:
    """The wrench and the energy of each term of a polynomial, at each of many poses."""
    exponents = np.array(powers).reshape(len(powers), -1)

    def values(pose: Array) -> Array:
        return jnp.stack(variables(Displacement.of(pose), coordinates, scale))

    at, slopes = jax.vmap(lambda pose: (values(pose), jax.jacfwd(values)(pose)))(poses)
    tables = [raised(at[:, k], exponents[:, k]) for k in range(exponents.shape[1])]
    parts = [table for table, *_ in tables]
    energies = reduce(mul, parts)
    by_pose = jnp.zeros((len(poses), 3, len(powers)))
    for k, (_, once, _) in enumerate(tables):
        grown = reduce(mul, [*parts[:k], once, *parts[k + 1 :]])
        by_pose = by_pose + slopes[:, k, :, None] * grown[:, None]
    turned = jax.vmap(jax.vmap(se2._turn, (None, 1), 1))(-poses[:, 0], by_pose[:, 1:])
    return jnp.concatenate([by_pose[:, :1], turned], axis=1), energies


def resting(powers: Powers) -> np.ndarray:
    """The value of each monomial at rest, where sigma is one, and all else is zero."""
    return np.array([not any(row[-3:]) for row in powers], float)


def raised(values: Float[Array, " trials"], exponents: np.ndarray) -> list[Array]:
    """Powers of the values, and their first two derivatives."""
    rows = [jnp.ones_like(values)]
    for _ in range(exponents.max(initial=0)):
        rows.append(rows[-1] * values)
    table = jnp.stack(rows, axis=1)
    factors = np.ones(exponents.shape), exponents * 1.0, exponents * (exponents - 1.0)
    return [
        jnp.asarray(factor)[None] * table[:, np.maximum(exponents - times, 0)]
        for times, factor in enumerate(factors)
    ]
