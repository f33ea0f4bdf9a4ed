"""Energy of flexures that are compliant in one direction and stiff in the other two."""

from collections.abc import Sequence
from typing import Literal

import equinox as eqx

from .._utils.types import CoefficientsLike, NumberLike
from .._utils.validation import require_choice
from .mixed import AbstractPolynomialMixedEnergy
from .potentials import TwoForcePotential


Freedom = Literal["rotation", "transverse"]

FREEDOM_VARIABLES = {"rotation": ("tau", "n", "n2"), "transverse": ("t2", "m", "n")}
STIFF: dict[Freedom, tuple[int, int]] = {"rotation": (1, 2), "transverse": (0, 1)}


class OneFreedomEnergy(AbstractPolynomialMixedEnergy):
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
        self._set(coefficients, powers, FREEDOM_VARIABLES[self.freedom], length, force)

    @property
    def stiff(self) -> tuple[int, ...]:
        return STIFF[self.freedom]

    @property
    def potential(self) -> TwoForcePotential:
        """The polynomial W."""
        return TwoForcePotential(self.coefficients, self.powers)
