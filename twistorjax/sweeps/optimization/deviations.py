"""Derivatives of the standard deviations of outputs.

The standard deviation of an output contains its first derivatives, so that its
derivatives contain second ones. They are differences of the exact first derivatives, with
an error of about 1e-8. Exact second derivatives would need a program whose compilation
takes five times as long, and some solvers have first derivatives only.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from ...designs.design_space import DesignSpace
from .problem import Evaluation


# Step of the differences, as a part of the scale of a number
_STEP = 1e-4


def neighbors(
    space: DesignSpace, vector: Float[np.ndarray, " numbers"], rows: Int[np.ndarray, " k"]
) -> Float[np.ndarray, "designs numbers"]:
    """Return the designs whose outputs determine the derivatives of standard deviations.

    Args:
        space: Numbers of the design.
        vector: The design.
        rows: Rows of the numbers with respect to which to differentiate.

    Returns:
        Two designs for each number. Both are on the same side if there is a bound on the
        other side.
    """
    designs = []
    for row in rows:
        step = _STEP * space.scales[row]
        changes = np.array([step, -step])
        if vector[row] + step > space.upper[row]:
            changes = np.array([-step, -2 * step])
        elif vector[row] - step < space.lower[row]:
            changes = np.array([step, 2 * step])
        pair = np.repeat(vector[None], 2, axis=0)
        pair[:, row] += changes
        designs.append(pair)
    return np.concatenate(designs)


def with_deviation_jacobian(
    evaluation: Evaluation, around: Sequence[Evaluation], rows: Int[np.ndarray, " k"]
) -> Evaluation:
    """Add the derivatives of the standard deviations to an evaluation.

    Args:
        evaluation: Evaluation of a design.
        around: Evaluations of its `neighbors`.
        rows: Rows of the numbers with respect to which to differentiate.

    Returns:
        The evaluation; it has not succeeded if the study fails for a neighbor.
    """
    center = evaluation.deviations
    jacobian = np.zeros_like(evaluation.jacobian)
    for row, first, second in zip(rows, around[::2], around[1::2], strict=True):
        steps = np.array(
            [each.vector[row] - evaluation.vector[row] for each in (first, second)]
        )
        # derivative at zero of the parabola through the three values
        slopes = [(each.deviations - center) / step
                  for each, step in zip((first, second), steps, strict=True)]  # fmt: skip
        weights = steps[::-1] * np.array([1.0, -1.0]) / (steps[1] - steps[0])
        jacobian[:, row] = weights[0] * slopes[0] + weights[1] * slopes[1]
    failed = next((each for each in around if not each.succeeded), evaluation)
    return evaluation._replace(
        deviation_jacobian=jacobian, succeeded=failed.succeeded, result=failed.result
    )
