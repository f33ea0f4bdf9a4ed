"""The micropositioning stage as it moves: section 6.4, figures 6.3 and 6.4."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..geometry import se2
from ..mechanism.loads import Drive
from ..mechanism.mechanism import Mechanism
from ..plotting.canvas import INK, ORANGE, subplots
from ..solve.dynamics import simulate
from ..solve.motion import Motion
from .stage import amplify, TRAVEL


if TYPE_CHECKING:
    from matplotlib.figure import Figure


RISE = 1e-3  # time constant of the input's filter; s
TIMES = np.linspace(0.0, 0.03, 301)  # long enough to settle; s


class Filtered(eqx.Module):
    """A travel that is taken up gradually, as a critically damped filter lets it.

    Args:
        travel: where it ends; m.
        rise: time constant of the filter; s.

    Source:
        Equations 6.21 to 6.23 of the dissertation, solved. Equation 6.23 lacks the
        travel: it pulls the input back to zero.
    """

    travel: ArrayLike
    rise: ArrayLike

    def __call__(self, time: Float[Array, ""]) -> list[Drive]:
        past = time / self.rise
        # 1 - (1 + past) exp(-past), without the loss of digits at the start
        return [Drive("6", x=self.travel * (-jnp.expm1(-past) - past * jnp.exp(-past)))]


class Transient(eqx.Module):
    """How a stage comes to where its input has moved it.

    Args:
        motion: of the stage.
        output: travel of body 4 along x; m.
        joint: travel of hinge a along x, on body 2 and on body 6; m.
        gain: travel of the output over that of the input, at the last time.
        static_gain: the same of the equilibrium.
    """

    motion: Motion
    output: Float[Array, " times"]
    joint: Float[Array, "2 times"]
    gain: Float[Array, ""]
    static_gain: Float[Array, ""]


def settle(
    stage: Mechanism,
    times: Float[ArrayLike, " times"] | Sequence[ArrayLike] = TIMES,
    *,
    travel: ArrayLike = TRAVEL,
    rise: ArrayLike | None = RISE,
    tolerance: ArrayLike = 1e-10,
    **settings,
) -> Transient:
    """Moves the input of a stage, and follows the output until it rests.

    Args:
        stage: a `microstage`; damped, so that it comes to rest.
        times: at which its motion is told; s.
        travel: of the input along x; m.
        rise: time constant by which the input is filtered; or nothing, for a step at the
            start, as section 6.2.3 has it; s.
        tolerance: for `simulate`, small because travels are.
        settings: more of them.

    Source:
        Section 6.4 of the dissertation.

    Example:
        >>> from twistorjax.examples.stage import microstage
        >>> settle(microstage(damping=1e-3)).gain
        Array(27.62804, dtype=float64)
    """
    start, drives = None, [Drive("6", x=travel)]
    if rise is not None:
        drives = Filtered(travel, rise)
    else:
        row = stage.index("6")
        start = stage.reference.at[row, 1].add(travel)
    motion = simulate(
        stage, times, drives=drives, start=start, tolerance=tolerance, **settings
    )
    output = motion.displacement("4")[:, 1]
    body_2, body_6 = _ports(stage, motion)
    return Transient(
        motion=motion,
        output=output,
        joint=jnp.stack([body_2, body_6]),
        gain=output[-1] / travel,
        static_gain=amplify(stage, travel).gain,
    )


def plot(transient: Transient) -> "Figure":
    """Draws the output's travel, and those of hinge a on both its bodies.

    Args:
        transient: of a stage.

    Source:
        Figures 6.3 and 6.4 of the dissertation.
    """
    times = 1e3 * np.asarray(transient.motion.times)
    figure, (above, below) = subplots(2, size=(6.5, 6.5), sharex=True)
    above.plot(times, 1e6 * np.asarray(transient.output), color=INK)
    above.set_ylabel("output, body 4 (\N{MICRO SIGN}m)")
    above.set_title(
        f"gain {float(transient.gain):.4f} at the end, "
        f"{float(transient.static_gain):.4f} at rest",
        fontsize="medium",
    )
    styles = (("body 2", ORANGE, "--"), ("body 6, the input", INK, "-"))
    for travel, (label, color, style) in zip(transient.joint, styles, strict=True):
        below.plot(
            times, 1e6 * np.asarray(travel), color=color, linestyle=style, label=label
        )
    apart = 1e9 * abs(float(transient.joint[1, -1] - transient.joint[0, -1]))
    below.set_ylabel("hinge a (\N{MICRO SIGN}m)")
    below.set_title(f"apart by {apart:.1f} nm at the end", fontsize="medium")
    below.set_xlabel("time (ms)")
    below.legend(frameon=False)
    return figure


def _ports(stage: Mechanism, motion: Motion) -> list[Array]:
    """How far both ports of hinge a have moved along x."""
    row = stage.hinge_names.index("a")
    arms = stage.hinge_assembly.arms[row]
    travels = []
    for body, arm in zip(stage.hinge_assembly.ends[row], arms, strict=True):
        angle, x, _ = motion.displacements[:, body].T
        travels.append(x + se2._swing(arm, jnp.cos(angle / 2), jnp.sin(angle / 2))[0])
    return travels
