"""Polynomial and rational energies (sections 3.6 and 4.7 of the dissertation).

A polynomial of the twistor remains a polynomial if the frames of the hinge are changed,
because the twistors of different frames are linear functions of each other.
"""

import operator
from collections.abc import Sequence
from functools import partial
from typing import Any, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from typing_extensions import TypeAliasType

from .._utils.host import as_float, concrete
from .._utils.types import CoefficientsLike, NumberLike, Pose, Scalar
from .._utils.validation import require_choice, require_positive, shorten
from ..geometry import se2, twistors
from ..geometry.twistors import Displacement
from .base import AbstractEnergy, validation_error
from .evaluation import evaluate_polynomial, polynomial_variables
from .monomials import monomials, Powers, sigma_reduction, substitution_matrix, VARIABLES
from .quadratic import CoordinateEnergy
from .strains import Coordinates


LARGEST_POWER = 1000


class _MonomialEnergy(CoordinateEnergy):
    """Base class of energies with one or several rows of coefficients of monomials."""

    coefficients: eqx.AbstractVar[Float[Array, "*sums terms"]]
    scale: eqx.AbstractVar[Scalar]
    powers: eqx.AbstractVar[Powers]
    coordinates: eqx.AbstractVar[Coordinates]

    def _set(
        self,
        coefficients: ArrayLike | Sequence[Any],
        powers: Sequence[Sequence[int]],
        coordinates: Coordinates,
        scale: NumberLike,
        *,
        dimensions: int,
    ) -> None:
        """Check the arguments of a subclass and set its fields; see `Polynomial`."""
        self.coordinates = require_choice(
            "`coordinates`", coordinates, get_args(Coordinates)
        )
        self.powers = require_powers(powers, VARIABLES[coordinates])
        self.coefficients = as_float(coefficients)
        self.scale = require_positive("`scale`", scale)
        require_coefficients(self, self.coefficients, self.powers, dimensions)

    @property
    def is_unloaded(self) -> bool:
        # A linear term of sigma has no slope at its largest value.
        return self.coefficients.ndim == 1 and all(
            sum(row[-3:]) != 1 for row in self.powers
        )

    def validation_error(self) -> str | None:
        """Describe the first coefficient that is not finite; None if all are finite."""
        return coefficients_error(self.coefficients, self.powers)

    def _evaluate(
        self, displacement: Displacement, coefficients: Float[Array, " terms"]
    ) -> Scalar:
        """Evaluate the polynomial with these coefficients, in their unit."""
        values = polynomial_variables(displacement, self.coordinates, self.scale)
        return evaluate_polynomial(self.powers, coefficients, values)


class Polynomial(_MonomialEnergy):
    """Energy that is a polynomial of the twist or of the twistor.

    Args:
        coefficients: Coefficients of the terms; J.
        powers: Powers of (tau, t1, t2) or of (sigma, xi, x1, x2) in each term; see
            `monomials`. Not all terms have to be given.
        coordinates: "twistor" or "twist".
        scale: Length by which the translations are divided before they are raised to
            their powers, by default one meter, as in the dissertation; m.

    Raises:
        ValueError: The numbers of coefficients, powers, or variables do not match; a row
            of powers is invalid or given twice; a value is not finite.

    Source:
        Equations 3.67 and 4.69 of the dissertation.

    Example:
        >>> pivot = Polynomial([0.5, 0.1], [(2, 0, 0), (4, 0, 0)], coordinates="twist")
        >>> pivot(jnp.array([2.0, 0.0, 0.0]))  # 0.5 angle^2 + 0.1 angle^4
        Array(3.6, dtype=float64)
    """

    coefficients: Float[Array, " terms"]
    scale: Scalar
    powers: Powers = eqx.field(static=True)
    coordinates: Coordinates = eqx.field(static=True)

    def __init__(
        self,
        coefficients: CoefficientsLike,
        powers: Sequence[Sequence[int]],
        coordinates: Coordinates = "twistor",
        scale: NumberLike = 1.0,
    ):
        self._set(coefficients, powers, coordinates, scale, dimensions=1)

    @property
    def order(self) -> int:
        """Largest sum of powers in a term."""
        return max(map(sum, self.powers), default=0)

    def stored_energy(self, displacement: Displacement) -> Scalar:
        return self._evaluate(displacement, self.coefficients)

    def change_frames(self, frame_a: Pose, frame_b: Pose | None = None) -> "Polynomial":
        """Write the same energy as a polynomial of the displacement of other frames.

        Args:
            frame_a: New frame on body A, relative to frame a; rad, m, m.
            frame_b: New frame on body B, relative to frame b; rad, m, m. By default
                equal to `frame_a`, so that the new frames coincide in the reference
                configuration, too. Energies of the twist require this default.

        Returns:
            A polynomial with all monomials of its order.

        Raises:
            ValueError: `frame_b` is given for an energy of the twist.

        Source:
            Equations 3.69 and 4.70 of the dissertation.

        Example:
            >>> spring = Polynomial([100.0], [(0, 0, 0, 2)])  # 100 x2^2
            >>> lever = jnp.array([0.0, 0.5, 0.0])  # rad, m, m
            >>> moved_spring = spring.change_frames(lever)
            >>> moved_spring(jnp.array([0.1, 0.0, 0.0]))  # 100 (0.5 sin 0.05)^2
            Array(0.0624479, dtype=float64)
        """
        if self.coordinates == "twist":
            if frame_b is not None:
                raise ValueError(
                    "`frame_b` is given for an energy of the twist, but only energies of "
                    "the twistor allow different changes of the two frames. Leave it out."
                )
            matrix = se2.adjoint(frame_a)
            scales = jnp.stack([jnp.ones(()), self.scale, self.scale])
        else:
            frame_b = frame_a if frame_b is None else frame_b
            first = twistors.twistor(frame_a)
            second = twistors.conjugate(twistors.twistor(frame_b))

            def old_twistor(new_twistor):
                return twistors.product(twistors.product(second, new_twistor), first)

            matrix = jax.jacfwd(old_twistor)(jnp.zeros(4))
            one = jnp.ones(())
            scales = jnp.stack([one, one, self.scale, self.scale])
        matrix = matrix * scales[None] / scales[:, None]
        order = self.order
        substitution = jnp.zeros((0, 1))
        if self.powers:
            substitution = substitution_matrix(self.powers, matrix)
        coefficients = self.coefficients @ substitution
        powers = monomials(order, self.coordinates, redundant=True)
        if self.coordinates == "twistor":
            coefficients = coefficients @ sigma_reduction(order)
            powers = monomials(order)
        return Polynomial(coefficients, powers, self.coordinates, self.scale)


class Rational(AbstractEnergy):
    """Energy that is a quotient of two polynomials.

    Args:
        numerator: Numerator; J.
        denominator: Dimensionless denominator. The energy is singular at the zeros of a
            `Polynomial`; a `SumOfSquares` has no zeros.

    Source:
        Equation 7.22 of the dissertation.

    Example:
        >>> numerator = Polynomial([1.0], [(0, 0, 2)], "twist")  # t2^2
        >>> denominator = SumOfSquares([[1.0]], [(0, 0, 1)], "twist")  # 1 + t2^2
        >>> energy = Rational(numerator, denominator)
        >>> energy(jnp.array([0.0, 0.0, 3.0]))
        Array(0.9, dtype=float64)
    """

    numerator: AbstractEnergy
    denominator: AbstractEnergy

    def stored_energy(self, displacement: Displacement) -> Scalar:
        return self.numerator.stored_energy(
            displacement
        ) / self.denominator.stored_energy(displacement)

    def translation_scale(self, displacement: Displacement) -> Scalar:
        """Return the translation scale of the numerator."""
        return self.numerator.translation_scale(displacement)


# A row of coefficients for each square
SquaresLike = TypeAliasType(
    "SquaresLike", Float[ArrayLike, "squares terms"] | Sequence[Sequence[ArrayLike]]
)


class SumOfSquares(_MonomialEnergy):
    """Denominator without zeros: one plus a sum of squares of polynomials.

    Args:
        coefficients: Dimensionless coefficients, a row for each polynomial.
        powers: Powers of each term; see `Polynomial`.
        coordinates: "twistor" or "twist".
        scale: Length by which the translations are divided; m.

    Raises:
        ValueError: The numbers of coefficients, powers, or variables do not match; a row
            of powers is invalid or given twice; a value is not finite.
    """

    coefficients: Float[Array, "squares terms"]
    scale: Scalar
    powers: Powers = eqx.field(static=True)
    coordinates: Coordinates = eqx.field(static=True)

    def __init__(
        self,
        coefficients: SquaresLike,
        powers: Sequence[Sequence[int]],
        coordinates: Coordinates = "twistor",
        scale: NumberLike = 1.0,
    ):
        self._set(coefficients, powers, coordinates, scale, dimensions=2)

    def stored_energy(self, displacement: Displacement) -> Scalar:
        """Evaluate the denominator, which is dimensionless."""
        values = jax.vmap(partial(self._evaluate, displacement))(self.coefficients)
        return 1.0 + jnp.sum(values**2)


def require_powers(powers: Sequence[Sequence[int]], names: Sequence[str]) -> Powers:
    """Check the powers of each term and return them as tuples of integers.

    Each row must have one power for each of the `names` of the variables.
    """
    rows = tuple(_require_row(index, row, names) for index, row in enumerate(powers))
    if len(set(rows)) < len(rows):
        repeated = next(row for row in rows if rows.count(row) > 1)
        raise ValueError(f"`powers` has {repeated} more than once.")
    return rows


def _require_row(index: int, row: Sequence[int], names: Sequence[str]) -> tuple[int, ...]:
    """Check one row of powers and return it as a tuple of integers."""
    try:
        integers = tuple(operator.index(power) for power in row)
    except TypeError:
        integers = ()  # Numbers with a fraction are not rounded.
    in_limits = all(0 <= power <= LARGEST_POWER for power in integers)
    if len(integers) != len(names) or not in_limits:
        raise ValueError(
            f"`powers[{index}]` is {shorten(str(row))}, but must be {len(names)} whole "
            f"numbers from 0 to {LARGEST_POWER}, the powers of ({', '.join(names)})."
        )
    return integers


def coefficients_error(
    coefficients: Float[Array, "*sums terms"], powers: Powers
) -> str | None:
    """Describe the first coefficient that is not finite; None if all are finite."""
    values = concrete(coefficients)
    if values is None or np.all(np.isfinite(values)):
        return None
    term = powers[int(np.argwhere(~np.isfinite(values))[0][-1])]
    return f"the coefficient of the term with powers {term} is not finite."


def require_coefficients(
    energy: AbstractEnergy,
    coefficients: Float[Array, "*sums terms"],
    powers: Powers,
    dimensions: int = 1,
) -> None:
    """Check that there is a valid coefficient for each term of an energy.

    `dimensions` is the number of dimensions that the array of coefficients must have. All
    fields of the energy must be set.
    """
    shape = coefficients.shape
    if len(shape) != dimensions or shape[-1] != len(powers):
        raise ValueError(
            f"`coefficients` has shape {shape}, but there are {len(powers)} `powers`: a "
            "coefficient is needed for each"
            + ("." if dimensions == 1 else ", in every row.")
        )
    if error := validation_error(energy):
        raise ValueError(f"A `{type(energy).__name__}` energy cannot be created: {error}")
