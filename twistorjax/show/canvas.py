"""Where pictures are drawn: figures of matplotlib, if it is there."""

from typing import Any, TYPE_CHECKING

from .._checks import package


if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
    plt = package("matplotlib.pyplot", "Pictures", "show")
    return plt.subplots(rows, columns, figsize=size, layout="constrained", **settings)


def new_axes(size: tuple[float | int, float | int]) -> "Axes":
    """The axes of a new figure of that size; inches."""
    return subplots(size=size)[1]
