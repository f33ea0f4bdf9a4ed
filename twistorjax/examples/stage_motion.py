"""Transient response of the micropositioning stage (section 6.4, figures 6.3 and 6.4).

Start reading in `transient_response`.
"""

from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import NumberLike, Scalar, Times, TimesLike
from ..geometry import se2
from ..mechanism.loads import Drive
from ..mechanism.mechanism import Mechanism
from ..plotting.figure_style import DARK_BLUE, ORANGE, subplots
from ..solve.integration.solution import Motion
from ..solve.simulate import simulate
from .stage import amplification, TRAVEL


if TYPE_CHECKING:
    from matplotlib.figure import Figure


FILTER_TIME = 1e-3  # time constant of the input filter; s
TIMES = np.linspace(0.0, 0.03, 301)  # until the vibration has decayed; s


class FilteredInput(eqx.Module):
    """An input displacement that follows a critically damped filter.

    Args:
        travel: Final displacement of the input along x; m.
        filter_time: Time constant of the filter; s.

    Source:
        Equations 6.21 to 6.23 of the dissertation, solved. Equation 6.23 lacks the final
        displacement, so it would return the input to zero.
    """

    travel: NumberLike
    filter_time: NumberLike

    def __call__(self, time: Scalar) -> list[Drive]:
        ratio = time / self.filter_time
        # 1 - (1 + ratio) exp(-ratio), without loss of digits at the start
        return [
            Drive("6", x=self.travel * (-jnp.expm1(-ratio) - ratio * jnp.exp(-ratio)))
        ]


class TransientResponse(eqx.Module):
    """Motion of a stage after a displacement of its input.

    Args:
        motion: Motion of the stage.
        output: Displacement of the output, body 4, along x; m.
        hinge_a: Displacements of hinge a along x, on body 2 and on body 6; m.
        gain: Ratio of output to input displacement at the last time.
        static_gain: The same ratio in equilibrium.
    """

    motion: Motion
    output: Times
    hinge_a: Float[Array, "2 times"]
    gain: Scalar
    static_gain: Scalar

    @property
    def elongation(self) -> Scalar:
        """Elongation of the neck of hinge a at the last time, positive in tension; m."""
        return self.hinge_a[1, -1] - self.hinge_a[0, -1]


def transient_response(
    stage: Mechanism,
    times: TimesLike = TIMES,
    *,
    travel: NumberLike = TRAVEL,
    filter_time: NumberLike | None = FILTER_TIME,
    tolerance: NumberLike = 1e-10,
    **settings,
) -> TransientResponse:
    """Simulate a stage whose input is displaced, until the vibration has decayed.

    Args:
        stage: A stage made by `microstage`, with damping.
        times: Times at which the motion is returned; s.
        travel: Final displacement of the input along x; m.
        filter_time: Time constant of the filtered input displacement. If None, the input
            makes a step at the first time, as in section 6.2.3; s.
        tolerance: Tolerance of `simulate`. It is small because the displacements are.
        settings: Further arguments of `simulate`.

    Returns:
        The motion and the gain. If the simulation failed and `throw=False` is given, the
        values after the failure are NaN.

    Raises:
        RuntimeError: There is no equilibrium with this input displacement, or the
            simulation failed.

    Source:
        Section 6.4 of the dissertation.

    Example:
        >>> from twistorjax.examples.stage import microstage
        >>> stage = microstage(damping=1e-3)
        >>> transient_response(stage).gain
        Array(27.62804, dtype=float64)
    """
    if filter_time is None:
        input_row = stage.index("6")
        start = stage.reference.at[input_row, 1].add(travel)
        drives = [Drive("6", x=travel)]
    else:
        start = None
        drives = FilteredInput(travel, filter_time)
    motion = simulate(
        stage, times, drives=drives, start=start, tolerance=tolerance, **settings
    )
    output = motion.displacement("4")[:, 1]
    return TransientResponse(
        motion=motion,
        output=output,
        hinge_a=_hinge_a(stage, motion),
        gain=output[-1] / travel,
        static_gain=amplification(stage, travel).gain,
    )


def plot(response: TransientResponse) -> "Figure":
    """Draw the displacement of the output, and those of hinge a on both of its bodies.

    Args:
        response: Transient response of a stage.

    Returns:
        A figure with a panel for the output and a panel for hinge a.

    Source:
        Figures 6.3 and 6.4 of the dissertation.
    """
    times = 1e3 * np.asarray(response.motion.times)
    figure, (upper, lower) = subplots(2, size=(6.5, 6.5), sharex=True)
    upper.plot(times, 1e6 * np.asarray(response.output), color=DARK_BLUE)
    upper.set_ylabel("output, body 4 (\N{MICRO SIGN}m)")
    upper.set_title(
        f"gain {float(response.gain):.4f} at the end, "
        f"{float(response.static_gain):.4f} in equilibrium",
        fontsize="medium",
    )
    on_body_2, on_body_6 = 1e6 * np.asarray(response.hinge_a)
    lower.plot(times, on_body_2, color=ORANGE, linestyle="--", label="body 2")
    lower.plot(
        times, on_body_6, color=DARK_BLUE, linestyle="-", label="body 6, the input"
    )
    elongation = 1e9 * abs(float(response.elongation))
    lower.set_ylabel("hinge a (\N{MICRO SIGN}m)")
    lower.set_title(f"difference {elongation:.1f} nm at the end", fontsize="medium")
    lower.set_xlabel("time (ms)")
    lower.legend(frameon=False)
    return figure


def _hinge_a(stage: Mechanism, motion: Motion) -> Float[Array, "2 times"]:
    """Compute the displacements along x of both frames of hinge a; m."""
    row = stage.hinge_names.index("a")
    arms = stage.hinge_assembly.arms[row]
    displacements = []
    for body, arm in zip(stage.hinge_assembly.ends[row], arms, strict=True):
        angle, x, _ = motion.displacements[:, body].T
        cos_half, sin_half = jnp.cos(angle / 2), jnp.sin(angle / 2)
        displacements.append(x + se2.rotation_displacement(arm, cos_half, sin_half)[0])
    return jnp.stack(displacements)
