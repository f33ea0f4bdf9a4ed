"""Tests in which natural frequencies of a mechanism are measured."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.host import concrete
from ..._utils.types import NumbersLike, Poses, Table, TableDeviationsLike, TableLike
from ..._utils.validation import require_deviations
from ...mechanism.loads import Load
from ...mechanism.mechanism import Mechanism
from ...results.solutions import PoseSolution
from ...solve.statics.solution import StateLike
from ...solve.vibrations import vibrations
from .measurement import AbstractTest, Measurement


class VibrationTest(AbstractTest):
    """Measurement of the lowest natural frequencies of a mechanism.

    Args:
        count: Number of natural frequencies, in ascending order from the lowest one.
        standard_deviation: Standard deviation of the readings, or one for each frequency;
            Hz.
        prescribed: Coordinates with prescribed displacements, which do not vibrate; see
            `vibrations`.
        about: Poses, or an equilibrium, about which the mechanism vibrates, by default
            the reference poses; rad, m, m.
        loads: Loads that act in this equilibrium.

    Raises:
        ValueError: `count` is smaller than 1; a standard deviation is not positive, or
            the number of standard deviations is wrong.

    Example:
        >>> VibrationTest(count=3, standard_deviation=0.5)
        VibrationTest of 3 frequencies
    """

    count: int = eqx.field(static=True)
    standard_deviation: Float[Array, " count"]
    prescribed: Any = eqx.field(static=True)
    about: Poses | None
    loads: tuple[Load, ...]

    def __init__(
        self,
        count: int,
        standard_deviation: NumbersLike,
        *,
        prescribed: Sequence[str] | Mapping[str, Sequence[str]] = (),
        about: StateLike | None = None,
        loads: Sequence[Load] = (),
    ):
        if count < 1:
            raise ValueError(f"`count` is {count}, but must be at least 1.")
        self.count = count
        self.standard_deviation = require_deviations(
            "`standard_deviation`", standard_deviation, (count,)
        )
        self.prescribed = (
            tuple((body, tuple(names)) for body, names in prescribed.items())
            if isinstance(prescribed, Mapping)
            else tuple(prescribed)
        )
        if isinstance(about, PoseSolution):
            about = about.poses
        self.about = None if about is None else jnp.asarray(about, float)
        self.loads = tuple(loads)

    def measurement(
        self,
        values: TableLike,
        standard_deviations: TableDeviationsLike | None = None,
    ) -> Measurement:
        """Combine the test with measured frequencies; see `AbstractTest.measurement`.

        The values are a column of frequencies in ascending order; Hz.

        Raises:
            ValueError: Also if a frequency is negative or smaller than the one before.
        """
        data = super().measurement(values, standard_deviations)
        frequencies = concrete(data.values)
        if frequencies is not None:
            require_ascending(frequencies[:, 0], lambda row: f"`values[{row}]`")
        return data

    @property
    def columns(self) -> tuple[str, ...]:
        """Name of the only column."""
        return ("frequency",)

    @property
    def units(self) -> tuple[str, ...]:
        """SI unit of the only column."""
        return ("Hz",)

    @property
    def standard_deviations(self) -> Table:
        """Standard deviation of each frequency; Hz."""
        return self.standard_deviation[:, None]

    def predict(
        self, mechanism: Mechanism, *, forward: bool = True, throw: bool = True
    ) -> Table:
        del forward
        prescribed: Any = self.prescribed
        if prescribed and isinstance(prescribed[0], tuple):
            prescribed = dict(prescribed)
        frequencies = vibrations(
            mechanism, prescribed, about=self.about, loads=self.loads, throw=throw
        ).frequencies
        if len(frequencies) < self.count:
            raise ValueError(
                f"`count` is {self.count}, but the mechanism has only "
                f"{len(frequencies)} natural frequencies."
            )
        return frequencies[: self.count, None]

    def __repr__(self) -> str:
        return f"VibrationTest of {self.count} frequencies"


def require_ascending(frequencies: np.ndarray, row_name: Callable[[int], str]) -> None:
    """Check that frequencies are ascending and not negative; missing ones are NaN."""
    previous = 0.0
    for row, frequency in enumerate(np.asarray(frequencies).tolist()):
        if frequency < 0:
            raise ValueError(
                f"{row_name(row)}: the frequency is {frequency:g} Hz, but must not be "
                "negative."
            )
        if frequency < previous:
            raise ValueError(
                f"{row_name(row)}: the frequency is {frequency:g} Hz and follows one of "
                f"{previous:g} Hz, but frequencies must be in ascending order."
            )
        previous = previous if np.isnan(frequency) else frequency
