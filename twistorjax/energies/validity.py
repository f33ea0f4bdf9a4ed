"""Energies that say how far, and how well, they are known."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from .._utils.types import Scalar
from .._utils.validation import all_concrete, require_positive, require_row
from ..geometry.twistors import Displacement
from .base import AbstractEnergy, Wrapped


class WithValidityRange(Wrapped):
    """An energy with the range in which it holds, and its error there.

    Solves that end beyond the range are refused, and so are poses there.

    Args:
        energy: that holds there.
        turn: the largest, either way; rad.
        force: the largest, in any direction; N.
        error: in the wrench, by component, root mean square over that of the wrenches:
            on samples that the energy was not made from.

    Raises:
        ValueError: the energy is none; turn or force is not positive, or the error has
            not three entries.

    Example:
        >>> from twistorjax import Quadratic
        >>> leaf = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0])))
        >>> sure = WithValidityRange(leaf, turn=0.1, force=5.0, error=[1e-3, 1e-3, 1e-3])
        >>> sure.wrench(jnp.array([0.2, 0.0, 0.0]))
        Traceback (most recent call last):
            ...
        ValueError: Beyond the range of the energy: it is turned by 0.2 rad and bears 0 N,
        but is known up to 0.1 rad and 5 N.
    """

    energy: AbstractEnergy
    turn: Scalar
    force: Scalar
    error: Float[Array, "3"]

    def __init__(
        self,
        energy: AbstractEnergy,
        turn: ArrayLike,
        force: ArrayLike,
        error: Float[ArrayLike, "3"] | Sequence[ArrayLike],
    ):
        if not isinstance(energy, AbstractEnergy):
            raise ValueError(f"`energy` is a {type(energy).__name__}, but must be one.")
        self.energy = energy
        self.turn = require_positive("`turn`", turn)
        self.force = require_positive("`force`", force)
        self.error = require_row(
            "`error`", error, "one for each of (moment, force 1, force 2)"
        )

    def out_of_range(self, displacement: Displacement) -> Bool[Array, ""]:
        """Whether the turn or the force is larger than those of the range."""
        # at its very end there is rounding, and the error of the force itself
        slack = 1 + 1e-9
        sure = jnp.abs(displacement.angle) <= slack * self.turn
        most = (slack + 3 * jnp.max(self.error)) * self.force
        return ~(sure & (self._borne(displacement) <= most))

    def parallel_terms(self) -> tuple[AbstractEnergy, ...]:
        terms = self.energy.parallel_terms()
        return (self,) if len(terms) == 1 else (*terms, _Range(self))

    def _borne(self, at: Displacement) -> Scalar:
        """The size of the force; N."""

        def stored_energy(y1: Scalar, y2: Scalar) -> Scalar:
            moved = Displacement(at.angle, at.sigma, at.xi, y1 / 2, y2 / 2)
            return self.energy.stored_energy(moved)

        along, across = jax.grad(stored_energy, (0, 1))(2 * at.x1, 2 * at.x2)
        return jnp.sqrt(along**2 + across**2)

    def range_message(self, displacement: Displacement) -> str:
        """How far it is displaced, and how far it is known, in words."""
        seen = all_concrete(
            [displacement.angle, self._borne(displacement), self.turn, self.force]
        )
        if seen is None:
            return "it is turned further, or bears more, than it was made for"
        turn, force, most_turn, most_force = map(float, seen)
        return (
            f"it is turned by {turn:.4g} rad and bears {force:.4g} N, but is known up to "
            f"{most_turn:.4g} rad and {most_force:.4g} N"
        )

    def __repr__(self) -> str:
        seen = all_concrete([self.turn, self.force, self.error])
        if seen is None or seen[0].shape:
            return eqx.tree_pformat(self)
        turn, force, (moment, axial, transverse) = seen
        terms = getattr(self.energy, "powers", None)
        size = "" if terms is None else f" of {len(terms)} terms"
        return (
            f"{type(self.energy).__name__} energy{size}, known up to {float(turn):.4g} "
            f"rad and {float(force):.4g} N; rms error {100 * moment:.2g} % in moment, "
            f"{100 * axial:.2g} % in axial, {100 * transverse:.2g} % in transverse force"
        )


class _Range(AbstractEnergy):
    """The range of an energy that is a sum, beside its terms: it stores nothing."""

    energy: WithValidityRange

    def stored_energy(self, displacement: Displacement) -> Scalar:
        return jnp.zeros_like(displacement.angle)

    def out_of_range(self, displacement: Displacement) -> Bool[Array, ""]:
        return self.energy.out_of_range(displacement)
