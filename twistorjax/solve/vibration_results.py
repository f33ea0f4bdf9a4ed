"""Natural frequencies and mode shapes, in the plane and out of it."""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..mechanism.mechanism import COORDINATES
from ..results.codes import RESULTS, Solution
from ..results.tables import Column, Columns, columns, Tabular
from .equations.out_of_plane import COORDINATES as OUT_OF_PLANE


class AbstractSource(eqx.Module):
    """A mechanism and the equilibrium about which it vibrates."""

    @abstractmethod
    def lowest_out_of_plane(self) -> float | None:
        """Return the lowest natural frequency out of the plane (Hz), if it is known."""


class Vibrations(Solution, Tabular):
    """Natural frequencies and mode shapes of a mechanism.

    If the equilibrium is unstable with respect to a mode, the frequency of this mode is
    NaN.

    Args:
        frequencies: Natural frequencies in ascending order; Hz.
        shapes: Mass-normalized mode shapes; rad/(kg^0.5 m), 1/kg^0.5, 1/kg^0.5.
        result: `RESULTS.successful` or the reason of the failure; `result_names` returns
            its name.
        names: Names of the bodies.
        source: What vibrates, which knows its modes out of the plane; None if JAX traces
            it.
    """

    frequencies: Float[Array, "*batch modes"]
    shapes: Float[Array, "*batch modes bodies 3"]
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)
    source: AbstractSource | None = None
    _plural: ClassVar[str] = "sets of vibrations"
    _coordinates: ClassVar[tuple[str, ...]] = COORDINATES
    _where: ClassVar[str] = "in the plane"

    def columns(self) -> Columns:
        axes = ("mode", "body")
        entries = [(f"shape_{name}", "") for name in self._coordinates]
        return {
            "frequency": Column(self.frequencies, ("mode",), "Hz"),
            **columns(self.shapes, axes, *entries, body=self.names),
        }

    def _summary(self, names: np.ndarray) -> str:
        title = f"{names}: {self.frequencies.size} vibrations {self._where}"
        lines = [title, "frequency (Hz)  largest translations"]
        translations = [name in ("x", "y", "z") for name in self._coordinates]
        for frequency, shape in zip(self.frequencies[:20], self.shapes, strict=False):
            travel = np.linalg.norm(np.asarray(shape)[:, translations], axis=1)
            largest = [body for body in np.argsort(-travel)[:3] if travel[body] > 0]
            moving = ", ".join(self.names[body] for body in largest) or "rotations only"
            lines.append(f"{float(frequency):>14.6g}  {moving}")
        if self.source is None:
            return "\n".join(lines)
        lowest = self.source.lowest_out_of_plane()
        if lowest is None:
            lines.append(
                "Those out of the plane are unknown; `out_of_plane(mechanism)` says why."
            )
        elif lowest < float(self.frequencies[-1]):
            lines.append(
                f"It vibrates out of the plane from {lowest:.6g} Hz on: "
                "`out_of_plane(mechanism).vibrations()`."
            )
        return "\n".join(lines)


class OutOfPlaneVibrations(Vibrations):
    """Natural frequencies and mode shapes out of the plane.

    Args:
        frequencies: Natural frequencies in ascending order; Hz.
        shapes: Mass-normalized mode shapes: z and the rotations about x and y of each
            body; 1/kg^0.5, rad/(kg^0.5 m), rad/(kg^0.5 m).
        result: `RESULTS.successful` or the reason of the failure; `result_names` returns
            its name.
        names: Names of the bodies.
        poses: Poses of the bodies in the plane; rad, m, m.
    """

    poses: Float[Array, "*batch bodies 3"] = eqx.field(kw_only=True)
    _coordinates: ClassVar[tuple[str, ...]] = OUT_OF_PLANE
    _where: ClassVar[str] = "out of the plane"
