"""Where pictures are drawn: figures of matplotlib, if it is there, and their units."""

from typing import Any, TYPE_CHECKING

from .._utils.validation import require_package


if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# safe for colour-blind eyes: Okabe and Ito, Color Universal Design, 2008
BLUE, ORANGE, GREEN, RED = "#0072b2", "#e08214", "#009e73", "#d55e00"
INK, GRAY = "#1b4965", "#8a8a8a"
# of the parts of a mechanism
FILLS = {"body": "#b8cfe3", "held": "#d5d5d5", "neck": ORANGE}

_PREFIXES = (
    (1e12, "p"), (1e9, "n"), (1e6, "\N{MICRO SIGN}"), (1e3, "m"), (1.0, ""), (1e-3, "k"),
    (1e-6, "M"), (1e-9, "G"),
)  # fmt: skip
_PREFIXED = ("m", "N", "N m", "J", "s", "Hz", "Pa")


def subplots(
    rows: int = 1, columns: int = 1, *, size: tuple[float | int, float | int], **settings
) -> tuple["Figure", Any]:
    """A new figure and its axes, laid out so that nothing overlaps.

    Args:
        rows: of axes.
        columns: of axes.
        size: of the figure; inches.
        settings: for matplotlib's `subplots`.

    Raises:
        ImportError: matplotlib is not installed; the text says how to.

    Example:
        >>> figure, axes = subplots(size=(5, 5))
    """
    plt = require_package("matplotlib.pyplot", "Pictures", "show")
    return plt.subplots(rows, columns, figsize=size, layout="constrained", **settings)


def new_axes(size: tuple[float | int, float | int]) -> "Axes":
    """The axes of a new figure of that size; inches."""
    return subplots(size=size)[1]


def readable(unit: str, largest: float) -> tuple[float, str]:
    """By what numbers are multiplied, and their unit then, so that they are handy.

    Args:
        unit: of the numbers, an SI unit without a prefix.
        largest: of them.

    Example:
        >>> readable("m", 0.03)
        (1000.0, 'mm')
        >>> readable("rad", 1e-3)
        (1.0, 'rad')
    """
    if unit not in _PREFIXED:
        return 1.0, unit
    fitting = [pair for pair in _PREFIXES if 1 <= largest * pair[0] < 1000]
    factor, prefix = fitting[0] if fitting else (1.0, "")
    return factor, prefix + unit


def lengths(size: float) -> tuple[float, str]:
    """The same for lengths of a picture: millimetres, unless it is large or tiny."""
    return (1e3, "mm") if 1e-3 <= size < 10 else readable("m", size)
