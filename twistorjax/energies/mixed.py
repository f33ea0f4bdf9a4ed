"""Energies of flexures that are soft across their axis and stiff along it.

What such a flexure stores is hard to write by its translations, for a little along the
axis takes large forces, and by how much bending draws its ends together depends on all.
By the force along the axis it is easy: all is smooth, however slender the flexure is.
"""

import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .._utils.types import Scalar
from .._utils.validation import concrete, require_positive
from ..geometry.twistors import Displacement
from .base import AbstractEnergy, CoordinateEnergy
from .damping import ViscousDamping
from .monomials import Powers, summed, VARIABLES
from .polynomial import coefficients_error, need_fitting, rows_of_powers
from .strains import Coordinates, strain


Parts = tuple[Scalar, ...]  # what the powers of the tension from 0 on are multiplied by
_GIVE = (0, 0, 2)  # the powers of the term that gives along the axis at rest


class MixedEnergy(CoordinateEnergy):
    """The energy of a flexure, by a polynomial of turn, translation across, and tension.

    The tension `n` is the force along axis 1 that belongs to the twist `(tau, t1, t2)`:
    it is where `n t1 + W(tau, t2, n)` is largest, and that is the energy. So `-dW/dn` is
    how much longer the flexure is along its axis: of `W = B - n S - n^2 / (2 k)` the
    energy is `B + k (t1 - S)^2 / 2`, of a leaf with the axial stiffness k, of which
    bending takes the length -S. Polynomials that would need hundreds of terms of a
    slender leaf's three translations, and fail altogether of a very slender one's, have
    some dozens here.

    Args:
        coefficients: of the terms of W; J.
        powers: of each term, those of `tau`, `t2 / length` and `n / force`.
        length: m.
        force: up to this tension, and down to its negative, is W the polynomial; beyond,
            it goes on as the parabola that fits it there, so that any translation has its
            tension; N.

    Raises:
        ValueError: numbers of coefficients and powers do not fit; a power is negative or
            stands twice; a value is not finite, or a dimension not positive.

    Source:
        Awtar and Sen, A generalized constraint model for two-dimensional beam flexures,
        J. Mech. Des. 132, 2010, have W to the second power of turn and translation. That
        W is a complementary energy in one of three directions: Reissner, On a variational
        theorem in elasticity, J. Math. Phys. 29, 1950.

    Example:
        >>> powers = [(0, 2, 0), (0, 2, 1), (0, 0, 2)]
        >>> guided = MixedEnergy([6.0, 0.6, -5e-4], powers, length=1.0, force=1.0)
        >>> guided.wrench(jnp.array([0.0, 0.0, 0.1]))[1:]  # k 3/5 t2^2 of tension
        Array([6.  , 1.92], dtype=float64)
    """

    coefficients: Float[Array, " terms"]
    length: Scalar
    force: Scalar
    powers: Powers = eqx.field(static=True)

    def __init__(
        self,
        coefficients: Float[ArrayLike, " terms"] | Sequence[ArrayLike],
        powers: Sequence[Sequence[int]],
        *,
        length: ArrayLike,
        force: ArrayLike,
    ):
        self.powers = rows_of_powers(powers, VARIABLES["tension"])
        self.coefficients = jnp.asarray(coefficients, float)
        self.length = require_positive("`length`", length)
        self.force = require_positive("`force`", force)
        need_fitting(self, self.coefficients, self.powers)

    @property
    def order(self) -> int:
        """The largest sum of powers of turn and translation in a term."""
        return max(row[0] + row[1] for row in self.powers)

    def validation_error(self) -> str | None:
        """Which coefficient is not finite, or that there is no give along the axis."""
        if fault := coefficients_error(self.coefficients, self.powers):
            return fault
        seen = concrete(self.coefficients)
        if _GIVE not in self.powers or (
            seen is not None and seen[self.powers.index(_GIVE)] >= 0
        ):
            return (
                "the term of powers (0, 0, 2), which says how much it gives along its "
                "axis, is missing or not negative."
            )
        return None

    def stored_energy(self, displacement: Displacement) -> Scalar:
        turn, along, across = strain(displacement, "twist")
        return _largest(self.parts(turn, across), self.force * along)

    @property
    def coordinates(self) -> Coordinates:
        """Turn and translation across are those of the twist."""
        return "twist"

    def newton_model(self, tension: Scalar) -> "AbstractEnergy":
        return _Foreseen(self, tension / self.force)

    def proportional_damping(self, time: Scalar) -> ViscousDamping:
        return ViscousDamping(time * self.tangent_stiffness(), "twist", resisted=True)

    def resisted_rates(
        self, displacement: Displacement, rates: tuple[Scalar, Scalar, Scalar]
    ) -> tuple[Scalar, Scalar, Scalar]:
        """The rates of a solid whose every strain is damped by the same time.

        Along the axis that of the tension, as the translation that it would be at rest.
        """
        turn, along, across = strain(displacement, "twist")
        tension = _tension(self.parts(turn, across), self.force * along)
        (_, lean), bend = _leaning(self, tension, turn, across)
        at_rest = 2 * self.coefficients[self.powers.index(_GIVE)]
        rate = rates[1] + (lean[0] * rates[0] + lean[1] * rates[2]) / self.force
        return rates[0], rate * jnp.sqrt(at_rest / bend), rates[2]

    def parts(self, turn: Scalar, across: Scalar) -> Parts:
        """What multiplies each power of the tension, from 0 on; J."""
        at = turn, across / self.length
        parts = []
        for power in range(1 + max(row[2] for row in self.powers)):
            places = [k for k, row in enumerate(self.powers) if row[2] == power]
            kept = tuple(self.powers[k][:2] for k in places)
            mine = self.coefficients[np.array(places, int)]
            parts.append(summed(kept, (0, 0), mine, at))
        return tuple(parts)


def _mixed(parts: Parts, tension: Scalar, times: int = 0) -> Scalar:
    """W, differentiated so many times by the tension, in parts of the force."""
    within = jnp.clip(tension, -1.0, 1.0)
    over = tension - within

    def derivative(times: int) -> Scalar:
        total = jnp.zeros_like(within)
        for power in reversed(range(times, len(parts))):
            total = total * within + math.perm(power, times) * parts[power]
        return total

    if times == 2:
        return derivative(2)
    if times == 1:
        return derivative(1) + over * derivative(2)
    return derivative(0) + over * (derivative(1) + over * derivative(2) / 2)


@jax.custom_jvp
def _largest(parts: Parts, pull: Scalar) -> Scalar:
    """The largest value of the tension times the pull, and W."""
    tension = _tension(parts, pull)
    return pull * tension + _mixed(parts, tension)


@_largest.defjvp
def _(primals, tangents):
    # at its largest it does not change with the tension
    parts, pull = primals
    of_parts, of_pull = tangents
    tension = _tension(parts, pull)
    value = pull * tension + _mixed(parts, tension)
    return value, tension * of_pull + _mixed(of_parts, tension)


@jax.custom_jvp
def _tension(parts: Parts, pull: Scalar) -> Scalar:
    """The tension in parts of the force, by Newton's method; NaN where there is none.

    Each step starts within the force, and the last finds what lies beyond: there W is a
    parabola.
    """

    def nearer(_, tension: Scalar) -> Scalar:
        within = jnp.clip(tension, -1.0, 1.0)
        gap = pull + _mixed(parts, within, 1)
        return within - gap / _mixed(parts, within, 2)

    tension = jax.lax.fori_loop(0, 6, nearer, jnp.zeros_like(pull))
    return jnp.where(_mixed(parts, tension, 2) < 0, tension, jnp.nan)


@_tension.defjvp
def _(primals, tangents):
    parts, pull = primals
    of_parts, of_pull = tangents
    tension = _tension(parts, pull)
    rate = of_pull + _mixed(of_parts, tension, 1)
    return tension, -rate / _mixed(parts, tension, 2)


class _Foreseen(AbstractEnergy):
    """A slender flexure near a tension, for Newton's method alone.

    Translations and tension are taken for unknowns of their own, and what lacks between
    them is made up to first order. So a step across, which leaves the flexure too short
    by far, does not stiffen it as if it bore the tension of that.
    """

    energy: MixedEnergy
    tension: Scalar

    def stored_energy(self, displacement: Displacement) -> Scalar:
        turn, along, across = strain(displacement, "twist")
        pull = self.energy.force * along
        return _near(self.energy, self.tension, turn, pull, across)

    def stretch(self, displacement: Displacement) -> Scalar:
        return self.energy.stretch(displacement)


def _partial(energy: MixedEnergy, tension: Scalar, times: int):
    """W by turn and translation across, differentiated so often by the tension."""
    return lambda turn, across: _mixed(energy.parts(turn, across), tension, times)


@jax.custom_jvp
def _near(
    energy: MixedEnergy, tension: Scalar, turn: Scalar, pull: Scalar, across: Scalar
) -> Scalar:
    value, slope, bend = (_partial(energy, tension, k)(turn, across) for k in range(3))
    return pull * tension + value - (pull + slope) ** 2 / (2 * bend)


@_near.defjvp
def _(primals, tangents):
    by_turn, by_pull, by_across = _slopes_near(*primals)
    of_turn, of_pull, of_across = tangents[2:]
    rate = by_turn * of_turn + by_pull * of_pull + by_across * of_across
    return _near(*primals), rate


@jax.custom_jvp
def _slopes_near(
    energy: MixedEnergy, tension: Scalar, turn: Scalar, pull: Scalar, across: Scalar
) -> tuple[Scalar, Scalar, Scalar]:
    (slope, lean), bend = _leaning(energy, tension, turn, across)
    by_turn, by_across = jax.grad(_partial(energy, tension, 0), (0, 1))(turn, across)
    more = -(pull + slope) / bend
    return by_turn + more * lean[0], tension + more, by_across + more * lean[1]


@_slopes_near.defjvp
def _(primals, tangents):
    energy, tension, turn, _, across = primals
    of_turn, of_pull, of_across = tangents[2:]
    (_, lean), bend = _leaning(energy, tension, turn, across)
    curve = jax.grad(_partial(energy, tension, 0), (0, 1))
    _, (turning, crossing) = jax.jvp(curve, (turn, across), (of_turn, of_across))
    more = -(of_pull + lean[0] * of_turn + lean[1] * of_across) / bend
    rates = turning + more * lean[0], more, crossing + more * lean[1]
    return _slopes_near(*primals), rates


def _leaning(energy: MixedEnergy, tension: Scalar, turn: Scalar, across: Scalar):
    """The slope of W by the tension, how that leans, and the second derivative."""
    slope = jax.value_and_grad(_partial(energy, tension, 1), (0, 1))(turn, across)
    return slope, _partial(energy, tension, 2)(turn, across)
