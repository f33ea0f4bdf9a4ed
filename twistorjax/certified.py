"""Energies that say how far, and how well, they are known."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from ._checks import known, positive, row
from ._types import Scalar
from .clifford import Displacement
from .energy import AbstractEnergy


class Certified(AbstractEnergy):
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
        >>> sure = Certified(leaf, turn=0.1, force=5.0, error=[1e-3, 1e-3, 1e-3])
        >>> sure.wrench(jnp.array([0.2, 0.0, 0.0]))
        Traceback (most recent call last):
            ...
        ValueError: The pose [0.2, 0.0, 0.0] is beyond the range of the energy: a turn of
        0.1 rad and a force of 5 N.
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
        error: Float[ArrayLike, "3"],
    ):
        if not isinstance(energy, AbstractEnergy):
            raise ValueError(f"`energy` is a {type(energy).__name__}, but must be one.")
        self.energy = energy
        self.turn = positive("`turn`", turn)
        self.force = positive("`force`", force)
        self.error = row("`error`", error, "one for each of (moment, force 1, force 2)")

    def fault(self) -> str | None:
        """What is wrong with the energy, in words, or nothing."""
        return self.energy.fault()

    def stored(self, displacement: Displacement) -> Scalar:
        return self.energy.stored(displacement)

    def stretch(self, displacement: Displacement) -> Scalar:
        return self.energy.stretch(displacement)

    def foreseen(self, tension: Scalar) -> AbstractEnergy:
        return self.energy.foreseen(tension)

    def beyond(self, displacement: Displacement) -> Bool[Array, ""]:
        """Whether the turn or the force is larger than those of the range."""
        at = displacement

        def stored(y1: Scalar, y2: Scalar) -> Scalar:
            moved = Displacement(at.angle, at.sigma, at.xi, y1 / 2, y2 / 2)
            return self.energy.stored(moved)

        along, across = jax.grad(stored, (0, 1))(2 * at.x1, 2 * at.x2)
        slack = 1 + 1e-9  # of rounding, at the very end of the range
        within = (jnp.abs(at.angle) <= slack * self.turn) & (
            along**2 + across**2 <= (slack * self.force) ** 2
        )
        return ~within

    def range(self) -> str:
        """How far it is known, in words."""
        turn, force = known(self.turn), known(self.force)
        if turn is None or force is None:
            return "the turn and the force that it was made for"
        return f"a turn of {np.max(turn):.4g} rad and a force of {np.max(force):.4g} N"
