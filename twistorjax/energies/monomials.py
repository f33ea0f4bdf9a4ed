"""The monomials of a displacement's coordinates, and changes of their variables.

`monomials` lists the powers of all monomials up to an order. `substitution_matrix` and
`sigma_reduction` rewrite a polynomial in other variables.
"""

import math
from collections.abc import Sequence
from functools import lru_cache, partial
from itertools import product
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import TypeAliasType

from .._utils.validation import require_choice
from .strains import Coordinates


Powers = tuple[tuple[int, ...], ...]  # a row for each term, an entry for each variable
Symmetry = Literal["leaf", "mirror", "ends", "arch", "exchange", "sign"]
Symmetries = TypeAliasType("Symmetries", Symmetry | Sequence[Symmetry])  # one or several
FitCoordinates = TypeAliasType("FitCoordinates", Coordinates | Literal["mixed"])

VARIABLES = {
    "twist": ("tau", "t1", "t2"),
    "twistor": ("sigma", "xi", "x1", "x2"),
    "mixed": ("tau", "t2", "n"),
}

# The variables whose sign changes under the symmetry operation; m and n2 are those of a
# `OneFreedomEnergy`
_ODD_VARIABLES = {
    "mirror": {"xi", "x2", "tau", "t2", "m", "n2"},
    "ends": {"xi", "tau", "m"},
    "arch": {"x2", "t2", "n2"},
    "exchange": {"xi", "x1", "x2", "tau", "t1", "t2", "n"},
    "sign": {"sigma", "xi", "x1", "x2"},
}


def monomials(
    order: int,
    coordinates: FitCoordinates = "twistor",
    *,
    symmetry: Symmetries = (),
    redundant: bool = False,
) -> Powers:
    """List the powers of all monomials up to an order, in the dissertation's sequence.

    Args:
        order: Largest sum of powers in a monomial.
        coordinates: "twist" for the variables (tau, t1, t2), "twistor" for (sigma, xi,
            x1, x2), or "mixed" for the variables (tau, t2, n) of a `MixedEnergy`. In a
            mixed energy the order limits the powers of tau and t2 only; the largest
            power of n is `order // 2 + 1`.
        symmetry: One or several symmetries of the hinge. With each of them the energy
            does not change if the signs of some coordinates change. Only the monomials
            that have all given symmetries are kept:

            * "mirror": The hinge equals its mirror image about axis 1. The signs of the
              rotation and of the displacement along axis 2 change: those of tau and t2,
              or of xi and x2.
            * "ends": The hinge does not change if it is rotated by pi, which interchanges
              its two ends and reverses its axes. Only the sign of the rotation changes:
              that of tau, or of xi.
            * "arch": The hinge equals its mirror image about axis 2, as an arch with
              equal ends does; the image interchanges its ends. Only the sign of the
              displacement along axis 2 changes: that of t2, or of x2.
            * "exchange": The energy of a pose equals that of the inverse pose: the two
              bodies are interchanged, but the axes are not reversed. The signs of all
              coordinates except sigma change.
            * "sign": The energy has the same value after a rotation of 2 pi. This applies
              to the twistor only: the signs of all its coordinates change.

            "leaf" stands for "mirror" and "ends", and for the twistor also for "sign". It
            describes a straight hinge with equal sides and equal ends.
        redundant: Keep the powers of sigma above the first, as the dissertation does.
            They are redundant, because `sigma^2 = 1 - xi^2`.

    Returns:
        A row of powers for each monomial.

    Raises:
        ValueError: The order is negative; the coordinates or a symmetry are unknown.

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
        raise ValueError(
            f"`order` is {order!r}, but must be a whole number, zero or positive."
        )
    given: Sequence[str] = (symmetry,) if isinstance(symmetry, str) else symmetry
    leaf = ("mirror", "ends", *(("sign",) if coordinates == "twistor" else ()))
    kinds: list[str] = []
    for kind in given:
        require_choice("`symmetry`", kind, ("leaf", *_ODD_VARIABLES))
        if kind == "sign" and coordinates != "twistor":
            raise ValueError(
                "`symmetry` has 'sign', which is a symmetry of the twistor only. Remove "
                f"it for the coordinates {coordinates!r}."
            )
        kinds.extend(leaf if kind == "leaf" else (kind,))
    largest_powers = [order] * len(names)
    if coordinates == "twistor" and not redundant:
        largest_powers[0] = min(order, 1)
    limited = slice(None)
    if coordinates == "mixed":
        largest_powers[2], limited = order // 2 + 1, slice(2)
    # The power of the last variable varies most slowly.
    rows = product(*(range(largest + 1) for largest in reversed(largest_powers)))
    powers = (tuple(reversed(row)) for row in rows)
    limited_powers = [row for row in powers if sum(row[limited]) <= order]
    return symmetric_terms(limited_powers, names, kinds)


def symmetric_terms(
    powers: Sequence[tuple[int, ...]], names: Sequence[str], symmetries: Sequence[str]
) -> Powers:
    """Select the monomials of named variables that have all symmetries."""
    odd = [[name in _ODD_VARIABLES[kind] for name in names] for kind in symmetries]
    return tuple(
        row for row in powers if all(np.dot(row, parity) % 2 == 0 for parity in odd)
    )


@partial(jax.jit, static_argnums=0)
def substitution_matrix(
    powers: Powers, matrix: Float[Array, "n n"]
) -> Float[Array, "terms monomials"]:
    """Substitute the old variables of terms, which are `matrix @ new_variables`.

    The columns are the monomials of the new variables, in the order of `monomials(...,
    redundant=True)`.
    """
    size, order = len(powers[0]), max(map(sum, powers))
    all_rows = _all_monomials(size, order)
    degrees = [
        [row for row in all_rows if sum(row) == degree] for degree in range(order + 1)
    ]
    index_in_degree = {row: k for degree in degrees for k, row in enumerate(degree)}

    def divide(row: tuple[int, ...], variable: int) -> tuple[int, ...]:
        return tuple(power - (k == variable) for k, power in enumerate(row))

    # A monomial of degree d is one of its variables times a monomial of degree d - 1.
    blocks = [jnp.ones((1, 1))]
    for degree in degrees[1:]:
        first = [next(k for k, power in enumerate(row) if power) for row in degree]
        pairs = zip(degree, first, strict=True)
        parents = np.array([index_in_degree[divide(row, k)] for row, k in pairs])
        previous = jnp.pad(blocks[-1], ((0, 0), (0, 1)))[parents]
        block = jnp.zeros((len(degree), len(degree)))
        for variable in range(size):
            source = [
                index_in_degree[divide(row, variable)]
                if row[variable]
                else previous.shape[1] - 1  # the column of zeros
                for row in degree
            ]
            factors = matrix[np.array(first), variable]
            block = block + factors[:, None] * previous[:, np.array(source)]
        blocks.append(block)
    column_of = {row: k for k, row in enumerate(all_rows)}
    result = jnp.zeros((len(powers), len(column_of)))
    for degree, block in zip(degrees, blocks, strict=True):
        terms = np.array(
            [k for k, row in enumerate(powers) if sum(row) == sum(degree[0])]
        )
        if terms.size:
            rows = np.array([index_in_degree[powers[k]] for k in terms])
            columns = np.array([column_of[row] for row in degree])
            result = result.at[terms[:, None], columns[None]].set(block[rows])
    return result


def _all_monomials(size: int, order: int) -> Powers:
    """List the powers of all monomials of three or four variables."""
    return monomials(order, "twist" if size == 3 else "twistor", redundant=True)


@lru_cache
def sigma_reduction(order: int) -> np.ndarray:
    """Replace `sigma^2` by `1 - xi^2` in all monomials of the twistor up to an order.

    Returns:
        The coefficients of each monomial of `monomials(order, redundant=True)`, in rows,
        in those of `monomials(order)`, in columns.
    """
    all_rows, reduced_rows = monomials(order, redundant=True), monomials(order)
    column_of = {row: k for k, row in enumerate(reduced_rows)}
    matrix = np.zeros((len(all_rows), len(reduced_rows)))
    for k, (sigma, xi, x1, x2) in enumerate(all_rows):
        pairs, rest = divmod(sigma, 2)
        for count in range(pairs + 1):  # the binomial series of (1 - xi^2)^pairs
            weight = math.comb(pairs, count) * (-1) ** count
            matrix[k, column_of[rest, xi + 2 * count, x1, x2]] += weight
    return matrix


def reference_values(powers: Powers) -> np.ndarray:
    """Evaluate the monomials in the reference configuration.

    The value is one for the constant and for powers of sigma alone, otherwise zero.
    """
    return np.array([not any(row[-3:]) for row in powers], float)
