"""Extrapolation of the stages of a collocation method from the step before."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.types import Scalar
from ...assembly.forces import product
from .schemes import Scheme
from .system import MotionSystem, State


class StepHistory(NamedTuple):
    """Results of one step from which the stages of the next one are extrapolated.

    Polynomials are given by their coefficients, lowest power first. Their variable is the
    time since the start of the step, divided by its length.

    Args:
        last_acceleration: Accelerations at the end of the step; rad/s^2, m/s^2.
        last_stretches: Mid-frame translations of the hinges at the end of the step; m.
        accelerations: Polynomial of the accelerations; rad/s^2, m/s^2.
        stretches: Polynomial of the mid-frame translations; m.
        multipliers: Polynomial of the constraint forces; N m, N.
        step: Length of the step; s.
    """

    last_acceleration: Float[Array, " free"]
    last_stretches: Float[Array, " stretches"]
    accelerations: Float[Array, "degrees free"]
    stretches: Float[Array, "degrees stretches"]
    multipliers: Float[Array, "degrees entries"]
    step: Scalar

    @classmethod
    def constant(
        cls, scheme: Scheme, time: Any, state: State, system: MotionSystem
    ) -> "StepHistory":
        """Return the history for the first step, with constant polynomials."""
        now = system.instant(time, state.position, state.rate)
        displacements, _ = system.expand(time, state.position, state.rate)
        stretches = system.hinges(time).stretches(displacements).reshape(-1)

        def constant(value: Array) -> Float[Array, "degrees values"]:
            degrees = len(scheme.history_to_coefficients)
            return jnp.zeros((degrees, value.size)).at[0].set(value)

        return cls(
            last_acceleration=now.acceleration,
            last_stretches=stretches,
            accelerations=constant(now.acceleration),
            stretches=constant(stretches),
            multipliers=constant(now.multipliers)[: scheme.stages],
            step=jnp.ones_like(time),
        )

    def extrapolate(self, scheme: Scheme, step: Scalar) -> tuple[Array, Array, Array]:
        """Extrapolate to the stages of the next step, of length `step`; s.

        Returns:
            Accelerations (rad/s^2, m/s^2), mid-frame translations (m), and constraint
            forces (N m, N), with a row for each stage.
        """
        times = 1 + jnp.asarray(scheme.nodes) * step / self.step
        degrees = np.arange(len(scheme.history_to_coefficients), dtype=float)
        powers = times[:, None] ** degrees[None]
        return (
            product(powers, self.accelerations),
            product(powers, self.stretches),
            product(powers[:, : scheme.stages], self.multipliers),
        )

    def next(
        self,
        scheme: Scheme,
        accelerations: Float[Array, "stages free"],
        stretches: Float[Array, "stages stretches"],
        multipliers: Float[Array, "stages entries"],
        step: Scalar,
    ) -> "StepHistory":
        """Return the history of the next step, from the values at its stages."""
        values = accelerations, stretches
        if scheme.stiffly_accurate:
            values = (
                jnp.concatenate([self.last_acceleration[None], accelerations]),
                jnp.concatenate([self.last_stretches[None], stretches]),
            )
        to_coefficients = jnp.asarray(scheme.history_to_coefficients)
        return StepHistory(
            last_acceleration=accelerations[-1],
            last_stretches=stretches[-1],
            accelerations=to_coefficients @ values[0],
            stretches=to_coefficients @ values[1],
            multipliers=jnp.asarray(scheme.to_coefficients) @ multipliers,
            step=step,
        )
