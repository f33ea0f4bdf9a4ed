"""Mechanisms that vibrate, and what is read: their frequencies."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .._utils.types import Poses, PosesLike
from .._utils.validation import concrete
from ..mechanism.loads import Load
from ..mechanism.mechanism import Mechanism
from ..solve.statics import Equilibrium
from ..solve.vibrations import vibrations
from .measurement import AbstractTest, Measurement, so_many_deviations


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

    def measured(
        self,
        values: Float[ArrayLike, "rows columns"] | Sequence[Sequence[ArrayLike]],
        deviations: Float[ArrayLike, "*rows columns"] | None = None,
    ) -> Measurement:
        """The test with the frequencies that were measured.

        Args:
            values: A row of one frequency for each vibration, the slowest first; NaN
                where nothing was read; Hz.
            deviations: Standard deviations of the frequencies, by default those of the
                test; Hz.

        Raises:
            ValueError: As for any test; or a frequency is negative, or lower than one
                before it.
        """
        data = super().measured(values, deviations)
        seen = concrete(data.values)
        if seen is not None:
            need_ascending(seen[:, 0], lambda row: f"`values[{row}]`")
        return data

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


def need_ascending(frequencies: np.ndarray, place: Callable[[int], str]) -> None:
    """Refuse measured frequencies that are negative or not in order, the slowest first.

    Args:
        frequencies: Frequencies; NaN where nothing was read; Hz.
        place: Name of a row, for messages.

    Raises:
        ValueError: A frequency is negative, or lower than one before it.
    """
    last = 0.0
    for row, frequency in enumerate(np.asarray(frequencies).tolist()):
        if frequency < 0:
            raise ValueError(
                f"{place(row)}: the frequency is {frequency:g} Hz, but must not be "
                "negative."
            )
        if frequency < last:
            raise ValueError(
                f"{place(row)}: the frequency is {frequency:g} Hz and follows one of "
                f"{last:g} Hz, but frequencies must ascend, the slowest first."
            )
        last = last if np.isnan(frequency) else frequency
