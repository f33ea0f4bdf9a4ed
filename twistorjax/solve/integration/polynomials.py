"""Polynomials of a step: extrapolation into the next step, and dense output."""

from typing import Any, NamedTuple

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.types import Scalar
from ...linalg.products import product
from .schemes import Scheme
from .system import MotionSystem, State


class StepHistory(NamedTuple):
    """Results of one step from which the stages of the next one are extrapolated.

    Polynomials are given by their coefficients, lowest power first. Their variable is the
    time since the start of the step, divided by its length.
    """

    # Accelerations at the end of the step; rad/s^2, m/s^2
    last_acceleration: Float[Array, " free"]
    # Mid-frame translations of the hinges at the end of the step; m
    last_translations: Float[Array, " translations"]
    # Polynomial of the accelerations; rad/s^2, m/s^2
    accelerations: Float[Array, "degrees free"]
    # Polynomial of the mid-frame translations; m
    translations: Float[Array, "degrees translations"]
    # Polynomial of the constraint forces; N m, N
    multipliers: Float[Array, "degrees entries"]
    step: Scalar  # Length of the step; s

    @classmethod
    def constant(
        cls, scheme: Scheme, time: Any, state: State, system: MotionSystem
    ) -> "StepHistory":
        """Return the history for the first step, with constant polynomials."""
        now = system.instant(time, state.position, state.rate)
        displacements, _ = system.expand(time, state.position, state.rate)
        translations = system.hinges(time).translations(displacements).reshape(-1)

        def constant(value: Array) -> Float[Array, "degrees values"]:
            degrees = len(scheme.history_to_coefficients)
            return jnp.zeros((degrees, value.size)).at[0].set(value)

        return cls(
            last_acceleration=now.acceleration,
            last_translations=translations,
            accelerations=constant(now.acceleration),
            translations=constant(translations),
            multipliers=constant(now.multipliers)[: scheme.stages],
            step=jnp.ones_like(time),
        )

    def extrapolate(self, scheme: Scheme, step: Scalar) -> tuple[Array, Array, Array]:
        """Extrapolate to the stages of the next step, of length `step`; s.

        There are rows of accelerations (rad/s^2, m/s^2), mid-frame translations (m), and
        constraint forces (N m, N).
        """
        times = 1 + jnp.asarray(scheme.nodes) * step / self.step
        degrees = np.arange(len(scheme.history_to_coefficients), dtype=float)
        powers = times[:, None] ** degrees[None]
        return (
            product(powers, self.accelerations),
            product(powers, self.translations),
            product(powers[:, : scheme.stages], self.multipliers),
        )

    def next(
        self,
        scheme: Scheme,
        accelerations: Float[Array, "stages free"],
        translations: Float[Array, "stages translations"],
        multipliers: Float[Array, "stages entries"],
        step: Scalar,
    ) -> "StepHistory":
        """Return the history of the next step, from the values at its stages."""
        values = accelerations, translations
        if scheme.stiffly_accurate:
            values = (
                jnp.concatenate([self.last_acceleration[None], accelerations]),
                jnp.concatenate([self.last_translations[None], translations]),
            )
        to_coefficients = jnp.asarray(scheme.history_to_coefficients)
        return StepHistory(
            last_acceleration=accelerations[-1],
            last_translations=translations[-1],
            accelerations=to_coefficients @ values[0],
            translations=to_coefficients @ values[1],
            multipliers=jnp.asarray(scheme.to_coefficients) @ multipliers,
            step=step,
        )


class DenseOutput(dfx.AbstractLocalInterpolation):
    """Interpolation of a motion between the start and the end of a step.

    The accelerations are the polynomial of the collocation method. Rates and
    displacements are its integrals.
    """

    t0: Scalar  # Time at the start of the step; s
    t1: Scalar  # Time at the end of the step; s
    y0: State  # State at the start
    y1: State  # State at the end
    # Coefficients of the polynomial of the accelerations, lowest power first; rad/s^2,
    # m/s^2
    accelerations: Float[Array, "degrees free"]
    # Coefficients of the polynomials of the dissipated power and of the powers of loads
    # and prescribed motions; W
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
