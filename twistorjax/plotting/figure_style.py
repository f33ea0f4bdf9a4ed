"""New figures of matplotlib, and the colors and units of all plots."""

from typing import Any, TYPE_CHECKING

from .._utils.validation import require_package


if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Colors that color-blind readers can distinguish: Okabe and Ito, Color Universal Design,
# 2008.
BLUE, ORANGE, GREEN, RED = "#0072b2", "#e08214", "#009e73", "#d55e00"
DARK_BLUE, BROWN, GRAY, BLACK = "#1b4965", "#8c3b00", "#8a8a8a", "#202020"
# Fill colors of the parts of a mechanism that have an outline; see `Shape.kind`.
FILLS = {"body": "#b8cfe3", "fixed": "#d5d5d5", "hinge": ORANGE}

_PREFIXES = (
    (1e12, "p"), (1e9, "n"), (1e6, "\N{MICRO SIGN}"), (1e3, "m"), (1.0, ""), (1e-3, "k"),
    (1e-6, "M"), (1e-9, "G"),
)  # fmt: skip
_UNITS_WITH_PREFIX = ("m", "N", "N m", "J", "s", "Hz", "Pa", "rad")
_LARGE_ANGLE = 1e-2  # from which angles are in rad


def subplots(
    rows: int = 1, columns: int = 1, *, size: tuple[float | int, float | int], **settings
) -> tuple["Figure", Any]:
    """Create a figure of a size (inches), with a layout in which axes do not overlap.

    The further settings and the axes are those of `matplotlib.pyplot.subplots`.

    Example:
        >>> figure, axes = subplots(size=(5, 5))
    """
    plt = require_package("matplotlib.pyplot", "Figures", "show")
    return plt.subplots(rows, columns, figsize=size, layout="constrained", **settings)


def new_axes(size: tuple[float | int, float | int]) -> "Axes":
    """Create a figure of this width and height (inches), and return its axes."""
    return subplots(size=size)[1]


def prefixed_unit(unit: str, largest: float) -> tuple[float, str]:
    """Choose the SI prefix with which the largest number is between 1 and 1000.

    The numbers are multiplied by the factor, which is 1 if no prefix fits, if the unit
    takes none, or for angles of 0.01 rad and more.

    Example:
        >>> prefixed_unit("m", 0.03)
        (1000.0, 'mm')
        >>> prefixed_unit("rad", 0.3)
        (1.0, 'rad')
    """
    is_large_angle = unit == "rad" and largest >= _LARGE_ANGLE
    if unit not in _UNITS_WITH_PREFIX or is_large_angle:
        return 1.0, unit
    fitting = [pair for pair in _PREFIXES if 1 <= largest * pair[0] < 1000]
    factor, prefix = fitting[0] if fitting else (1.0, "")
    return factor, prefix + unit


def length_unit(size: float) -> tuple[float, str]:
    """Choose the unit of the axes of a drawing, and the number of units in a meter.

    The unit is the millimeter for a mechanism of 1 mm to 10 m, and that of
    `prefixed_unit` otherwise.
    """
    return (1e3, "mm") if 1e-3 <= size < 10 else prefixed_unit("m", size)
