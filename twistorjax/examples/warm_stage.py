"""The micropositioning stage at another temperature: the drift of its output.

The stage is one plate. If its frame, the guide of its input, and its actuator expand with
it, a uniform change of the temperature only scales the stage: nothing is loaded, and the
gain does not change. If the guide keeps its place, it loads the hinges.
"""

from typing import NamedTuple

from .._utils.types import NumberLike, Pose, Scalar
from .._utils.validation import require_finite
from ..mechanism.loads import Drive
from ..solve.equilibrium import equilibrium
from ..solve.statics.solution import Equilibrium
from .stage import microstage, TRAVEL, WEB


class Drift(NamedTuple):
    """Displacement of the output of a warm stage.

    Args:
        output: Displacement of body 4 (angle, x, y) without an input; rad, m, m.
        gain: Gain at the new temperature.
        equilibrium: Equilibrium without an input.
    """

    output: Pose
    gain: Scalar
    equilibrium: Equilibrium


def thermal_drift(
    change: NumberLike,
    *,
    web: NumberLike = WEB,
    travel: NumberLike = TRAVEL,
    guide_expands: bool = True,
) -> Drift:
    """Compute how the output of the stage drifts if the temperature changes.

    Args:
        change: Change of the temperature of the whole plate; K.
        web: Smallest thickness of the necks; m.
        travel: Input displacement, from which the gain is computed; m.
        guide_expands: Whether the guide and the actuator of the input expand with the
            plate, or keep their place.

    Returns:
        The drift.

    Raises:
        ValueError: A value is not finite, or the web is outside the range of the formula.

    Example:
        >>> drift = thermal_drift(1.0)
        >>> drift.output[2]  # 23.6e-6 / K * 1 K * 24 mm
        Array(5.664e-07, dtype=float64)
        >>> drift.gain
        Array(27.628..., dtype=float64)
    """
    change = require_finite("`change`", change)
    stage = microstage(web, guided=False)
    warm = stage.at_temperature(change)
    input_body = stage.index("6")
    expansion = stage.expansions[input_body]
    assert expansion is not None
    _, x, y = stage.reference[input_body]
    strain = expansion * change if guide_expands else 0.0

    def solve(travel: NumberLike) -> Equilibrium:
        drive = Drive("6", angle=0.0, x=strain * x + travel, y=strain * y)
        return equilibrium(warm, drives=[drive])

    start, moved = solve(0.0), solve(travel)
    output = start.displacement("4")
    return Drift(output, (moved.displacement("4")[1] - output[1]) / travel, start)
