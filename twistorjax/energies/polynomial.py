"""Energies that are polynomials, or quotients of them, of a displacement's coordinates.

Sections 3.6 and 4.7 of the dissertation. A polynomial of the twistor is one from every
frame, for twistors seen from other frames are linear in one another.
"""

import operator
from collections.abc import Sequence
from functools import partial
from typing import get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from .._utils.types import Pose, Scalar
from .._utils.validation import concrete, require_choice, require_positive, shorten
from ..geometry import se2, twistors
from ..geometry.twistors import Displacement
from .base import AbstractEnergy, any_beyond, CoordinateEnergy, place_in_ranges
from .monomials import (
    expanded,
    monomials,
    Powers,
    reduction,
    summed,
    VARIABLES,
    variables,
)
from .strains import Coordinates


LARGEST_POWER = 1000  # far above those of any fit


class _OfMonomials(CoordinateEnergy):
    """What is made of sums of monomials, by one row of coefficients or several."""

    coefficients: eqx.AbstractVar[Float[Array, "*sums terms"]]
    scale: eqx.AbstractVar[Scalar]
    powers: eqx.AbstractVar[Powers]
    coordinates: eqx.AbstractVar[Coordinates]

    def validation_error(self) -> str | None:
        """Which coefficient is not finite, in words, or nothing."""
        return coefficients_error(self.coefficients, self.powers)

    def _sum(
        self, displacement: Displacement, coefficients: Float[Array, " terms"]
    ) -> Scalar:
        at = variables(displacement, self.coordinates, self.scale)
        return summed(self.powers, (0,) * len(at), coefficients, at)


class Polynomial(_OfMonomials):
    """A polynomial of the twist, or of the twistor.

    Args:
        coefficients: of its terms; J.
        powers: of each term's variables, of (tau, t1, t2) or (sigma, xi, x1, x2), as
            `monomials` gives them, or only those that there are.
        coordinates: which of the two.
        scale: the length by which translations are divided before they are raised to
            their powers; m. One metre, unless told, as in the dissertation.

    Raises:
        ValueError: numbers of coefficients, powers or variables do not fit; a power is
            negative or stands twice; a value is not finite.

    Source:
        Equations 3.67 and 4.69 of the dissertation.

    Example:
        >>> bend = Polynomial([0.5, 0.1], [(2, 0, 0), (4, 0, 0)], "twist")
        >>> bend(jnp.array([2.0, 0.0, 0.0]))
        Array(3.6, dtype=float64)
    """

    coefficients: Float[Array, " terms"]
    scale: Scalar
    powers: Powers = eqx.field(static=True)
    coordinates: Coordinates = eqx.field(static=True)

    def __init__(
        self,
        coefficients: Float[ArrayLike, " terms"] | Sequence[ArrayLike],
        powers: Sequence[Sequence[int]],
        coordinates: Coordinates = "twistor",
        scale: ArrayLike = 1.0,
    ):
        self.coordinates = require_choice(
            "`coordinates`", coordinates, get_args(Coordinates)
        )
        self.powers = rows_of_powers(powers, VARIABLES[coordinates])
        self.coefficients = jnp.asarray(coefficients, float)
        self.scale = require_positive("`scale`", scale)
        need_fitting(self, self.coefficients, self.powers)

    @property
    def order(self) -> int:
        """The largest sum of powers in a term."""
        return max(map(sum, self.powers), default=0)

    def stored_energy(self, displacement: Displacement) -> Scalar:
        return self._sum(displacement, self.coefficients)

    def seen_from(self, first: Pose, second: Pose | None = None) -> "Polynomial":
        """The same energy as a polynomial of the displacement between other frames.

        Args:
            first: the other frame on body A, seen from frame a; rad, m, m.
            second: the other frame on body B, seen from frame b, by default the same, so
                that both still coincide when the hinge is unstressed. For energies of the
                twist it must be.

        Returns:
            A polynomial of all monomials of its order.

        Source:
            Equations 3.69 and 4.70 of the dissertation.

        Example:
            >>> spring = Polynomial([100.0], [(0, 0, 0, 2)])
            >>> aside = spring.seen_from(jnp.array([0.0, 0.5, 0.0]))
            >>> aside(jnp.array([0.1, 0.0, 0.0]))  # 100 (0.5 sin 0.05)^2
            Array(0.0624479, dtype=float64)
        """
        if self.coordinates == "twist":
            if second is not None:
                raise ValueError(
                    "`second` is given for an energy of the twist, but only for those of "
                    "the twistor may the two frames be changed by themselves."
                )
            matrix = se2.adjoint(first)
            scales = jnp.stack([jnp.ones(()), self.scale, self.scale])
        else:
            second = first if second is None else second
            there = twistors.twistor(first)
            back = twistors.conjugate(twistors.twistor(second))

            def before(twistor):
                return twistors.product(twistors.product(back, twistor), there)

            matrix = jax.jacfwd(before)(jnp.zeros(4))
            one = jnp.ones(())
            scales = jnp.stack([one, one, self.scale, self.scale])
        matrix = matrix * scales[None] / scales[:, None]
        order = self.order
        wide = expanded(self.powers, matrix) if self.powers else jnp.zeros((0, 1))
        coefficients = self.coefficients @ wide
        powers = monomials(order, self.coordinates, redundant=True)
        if self.coordinates == "twistor":
            coefficients = coefficients @ reduction(order)
            powers = monomials(order)
        return Polynomial(coefficients, powers, self.coordinates, self.scale)


class Rational(AbstractEnergy):
    """A polynomial over another.

    Args:
        numerator: J.
        denominator: without unit: a `Polynomial`, whose zeros are poles, or `SumOfSquares`,
            which has none.

    Source:
        Equation 7.22 of the dissertation.

    Example:
        >>> far = Polynomial([1.0], [(0, 0, 2)], "twist")
        >>> Rational(far, SumOfSquares([[1.0]], [(0, 0, 1)], "twist"))(jnp.array([0, 0, 3.0]))
        Array(0.9, dtype=float64)
    """

    numerator: AbstractEnergy
    denominator: AbstractEnergy

    def validation_error(self) -> str | None:
        """What is wrong with the first part at fault, or nothing."""
        return self.numerator.validation_error() or self.denominator.validation_error()

    def stored_energy(self, displacement: Displacement) -> Scalar:
        return self.numerator.stored_energy(
            displacement
        ) / self.denominator.stored_energy(displacement)

    def stretch(self, displacement: Displacement) -> Scalar:
        return self.numerator.stretch(displacement)

    def out_of_range(self, displacement: Displacement) -> Bool[Array, ""] | None:
        """Whether one of its parts is not known there."""
        return any_beyond((self.numerator, self.denominator), displacement)

    def range_message(self, displacement: Displacement) -> str:
        """How far it is displaced, and how far that part is known, in words."""
        return place_in_ranges((self.numerator, self.denominator), displacement)


class SumOfSquares(_OfMonomials):
    """One and a sum of squares of polynomials: a denominator that cannot vanish.

    Args:
        coefficients: a row for each polynomial.
        powers: of their terms, as for `Polynomial`.
        coordinates: of which they are polynomials.
        scale: the length by which translations are divided; m.

    Raises:
        ValueError: as for `Polynomial`.
    """

    coefficients: Float[Array, "squares terms"]
    scale: Scalar
    powers: Powers = eqx.field(static=True)
    coordinates: Coordinates = eqx.field(static=True)

    def __init__(
        self,
        coefficients: Float[ArrayLike, "squares terms"] | Sequence[Sequence[ArrayLike]],
        powers: Sequence[Sequence[int]],
        coordinates: Coordinates = "twistor",
        scale: ArrayLike = 1.0,
    ):
        self.coordinates = require_choice(
            "`coordinates`", coordinates, get_args(Coordinates)
        )
        self.powers = rows_of_powers(powers, VARIABLES[coordinates])
        self.coefficients = jnp.asarray(coefficients, float)
        self.scale = require_positive("`scale`", scale)
        need_fitting(self, self.coefficients, self.powers, dimensions=2)

    def stored_energy(self, displacement: Displacement) -> Scalar:
        sums = jax.vmap(partial(self._sum, displacement))(self.coefficients)
        return 1.0 + jnp.sum(sums**2)


def rows_of_powers(powers: Sequence[Sequence[int]], names: Sequence[str]) -> Powers:
    """Check the powers of each term.

    Args:
        powers: A row for each term.
        names: Names of the variables, of which a row has the powers.

    Returns:
        The rows, as tuples of whole numbers.

    Raises:
        ValueError: A row has another length, a power is no whole number or lies outside
            of 0 to 1000, or a row is there twice.
    """
    rows = tuple(_row_of_powers(place, row, names) for place, row in enumerate(powers))
    if len(set(rows)) < len(rows):
        twice = next(row for row in rows if rows.count(row) > 1)
        raise ValueError(f"`powers` has {twice} more than once.")
    return rows


def _row_of_powers(
    place: int, row: Sequence[int], names: Sequence[str]
) -> tuple[int, ...]:
    try:
        whole = tuple(operator.index(power) for power in row)
    except TypeError:
        whole = ()  # a number that is not whole is not rounded
    fine = all(0 <= power <= LARGEST_POWER for power in whole)
    if len(whole) != len(names) or not fine:
        raise ValueError(
            f"`powers[{place}]` is {shorten(str(row))}, but must be {len(names)} whole "
            f"numbers from 0 to {LARGEST_POWER}, the powers of ({', '.join(names)})."
        )
    return whole


def coefficients_error(
    coefficients: Float[Array, "*sums terms"], powers: Powers
) -> str | None:
    """Which coefficient is not finite, in words, or nothing."""
    seen = concrete(coefficients)
    if seen is None or np.all(np.isfinite(seen)):
        return None
    term = powers[int(np.argwhere(~np.isfinite(seen))[0][-1])]
    return f"the coefficient of the term of powers {term} is not finite."


def need_fitting(
    energy: AbstractEnergy,
    coefficients: Float[Array, "*sums terms"],
    powers: Powers,
    dimensions: int = 1,
) -> None:
    """Refuses coefficients that do not fit their powers, or have a fault."""
    shape = coefficients.shape
    if len(shape) != dimensions or shape[-1] != len(powers):
        raise ValueError(
            f"`coefficients` has shape {shape}, but there are {len(powers)} `powers`: a "
            "coefficient is needed for each"
            + ("." if dimensions == 1 else ", in every row.")
        )
    if fault := energy.validation_error():
        raise ValueError(f"A `{type(energy).__name__}` energy cannot be made: {fault}")
