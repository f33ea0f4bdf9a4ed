"""Motion within a step of a collocation method."""

from typing import Any

import diffrax as dfx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._utils.types import Scalar
from .integration.system import State


class DenseOutput(dfx.AbstractLocalInterpolation):
    """Interpolation of a motion between the start and the end of a step.

    The accelerations are the polynomial of the collocation method. Rates and
    displacements are its integrals.

    Args:
        t0: Time at the start of the step; s.
        t1: Time at the end of the step; s.
        y0: State at the start.
        y1: State at the end.
        accelerations: Coefficients of the polynomial of the accelerations, lowest power
            first; rad/s^2, m/s^2.
        powers: Coefficients of the polynomials of the dissipated power and of the powers
            of loads and prescribed motions; W.
    """

    t0: Scalar
    t1: Scalar
    y0: State
    y1: State
    accelerations: Float[Array, "degrees free"]
    powers: Float[Array, "degrees works"]

    def evaluate(self, t0, t1=None, left=True) -> State:
        if t1 is not None:
            start, end = self.evaluate(t0, left=left), self.evaluate(t1, left=left)
            return jax.tree.map(jnp.subtract, end, start)
        length = self.t1 - self.t0
        fraction = (t0 - self.t0) / jnp.where(length > 0, length, 1.0)
        inside, end = self._integrate(fraction), self._integrate(jnp.ones_like(fraction))
        # The end of the step was projected onto the constraints. A cubic term adds the
        # difference between the projected end and that of the polynomial.
        return jax.tree.map(
            lambda inside, end, projected: inside + fraction**3 * (projected - end),
            inside,
            end,
            self.y1,
        )

    def _integrate(self, fraction: Any) -> State:
        """Integrate the polynomials from the start over a fraction of the step."""
        length = self.t1 - self.t0
        degrees = jnp.arange(1, 1 + len(self.accelerations), dtype=fraction.dtype)
        once = length * fraction**degrees / degrees
        twice = length * fraction * once / (degrees + 1)
        return State(
            position=self.y0.position
            + length * fraction * self.y0.rate
            + twice @ self.accelerations,
            rate=self.y0.rate + once @ self.accelerations,
            work=self.y0.work + once @ self.powers,
        )
