"""Mechanisms that vibrate, and what is read: their frequencies."""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from .._types import Poses, PosesLike
from ..boundary import Load
from ..mechanism import Mechanism
from ..solve.statics import Equilibrium
from ..solve.vibrations import vibrations
from .measured import AbstractTest, so_many_deviations


class VibrationTest(AbstractTest):
    """The natural frequencies of a mechanism, the slowest first.

    Args:
        count: how many are read; Hz.
        deviation: standard deviation of a reading, or one for each; Hz.
        driven: coordinates that are held in this test, as for `vibrations`.
        about: poses about which it vibrates, by default rest; rad, m, m.
        loads: that hold it there.

    Example:
        >>> VibrationTest(3, 0.5)
        VibrationTest of 3 frequencies
    """

    count: int = eqx.field(static=True)
    deviation: Float[Array, " count"]
    driven: Any = eqx.field(static=True)
    about: Poses | None
    loads: tuple[Load, ...]

    def __init__(
        self,
        count: int,
        deviation: ArrayLike | Sequence[ArrayLike],
        *,
        driven: Sequence[str] | Mapping[str, Sequence[str]] = (),
        about: PosesLike | Equilibrium | None = None,
        loads: Sequence[Load] = (),
    ):
        if count < 1:
            raise ValueError(f"`count` is {count}, but must be at least 1.")
        self.count = count
        self.deviation = so_many_deviations(deviation, count)
        self.driven = (
            tuple((body, tuple(which)) for body, which in driven.items())
            if isinstance(driven, Mapping)
            else tuple(driven)
        )
        if isinstance(about, Equilibrium):
            about = about.poses
        self.about = None if about is None else jnp.asarray(about, float)
        self.loads = tuple(loads)

    @property
    def columns(self) -> tuple[str, ...]:
        """The one column."""
        return ("frequency",)

    @property
    def units(self) -> tuple[str, ...]:
        """Of the one column."""
        return ("Hz",)

    @property
    def deviations(self) -> Float[Array, "rows columns"]:
        """One for each frequency."""
        return self.deviation[:, None]

    def read(
        self, mechanism: Mechanism, *, forward: bool = True, throw: bool = True
    ) -> Float[Array, "rows columns"]:
        del forward
        driven: Any = self.driven
        if driven and isinstance(driven[0], tuple):
            driven = dict(driven)
        found = vibrations(
            mechanism, driven, about=self.about, loads=self.loads, throw=throw
        )
        if len(found.frequencies) < self.count:
            raise ValueError(
                f"`count` is {self.count}, but the mechanism has only "
                f"{len(found.frequencies)} vibrations."
            )
        return found.frequencies[: self.count, None]

    def __repr__(self) -> str:
        return f"VibrationTest of {self.count} frequencies"
