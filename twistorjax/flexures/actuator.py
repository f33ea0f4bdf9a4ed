"""Piezoelectric actuators."""

from .._utils.host import as_float, on_host
from .._utils.types import NumberLike
from .._utils.validation import require_length, require_positive, warn_if_long
from ..energies.quadratic import Quadratic


_LONGEST_STROKE = 0.05  # of a stack, which must be given in meters; m


def piezo_stack(
    *,
    free_stroke: NumberLike,
    blocking_force: NumberLike,
    length: NumberLike,
    width: NumberLike,
) -> Quadratic:
    """Create the energy of a piezoelectric stack between two bodies.

    Its frame is at the middle of the stack, with axis 1 along the stack. The stack is a
    straight, slender beam of constant square cross-section. Its axial stiffness is the
    blocking force divided by the free stroke, so the axial force at a stroke x between
    two bodies at a distance that is u longer is `blocking_force (x - u) / free_stroke`.
    Apply a stroke by `Mechanism.with_strokes({"name": (0, x, 0)})`, with x from 0 to the
    free stroke. Hysteresis, creep, and dynamics of the material are neglected.

    Args:
        free_stroke: Elongation without force at the largest voltage; m.
        blocking_force: Force at the largest voltage if the stack cannot become longer; N.
        length: Length of the stack; m.
        width: Side of its square cross-section; m.

    Returns:
        The energy.

    Raises:
        ValueError: A value is not positive.

    Example:
        >>> stack = piezo_stack(
        ...     free_stroke=15e-6, blocking_force=800.0, length=18e-3, width=5e-3
        ... )
        >>> stack.stiffness[1, 1]
        Array(53333333.33..., dtype=float64)
    """
    stroke = require_positive("`free_stroke`", free_stroke)
    force = require_positive("`blocking_force`", blocking_force)
    length = require_length("`length`", length)
    width = require_length("`width`", width)
    warn_if_long("`free_stroke`", stroke, _LONGEST_STROKE, "a stack")
    xp, (stroke, force, length, width) = on_host(stroke, force, length, width)
    axial = force / stroke
    bending = axial * width**2 / 12  # E I / L
    return Quadratic(
        as_float(xp.diag(xp.stack([bending, axial, 12 * bending / length**2])))
    )
