"""Where pictures are drawn: figures of matplotlib, if it is there."""

from typing import Any, TYPE_CHECKING


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
    try:
        from matplotlib import pyplot as plt
    except ImportError as error:
        raise ImportError(
            'Pictures need matplotlib: install it with `pip install "twistorjax[show]"`.'
        ) from error
    return plt.subplots(rows, columns, figsize=size, layout="constrained", **settings)


def new_axes(size: tuple[float | int, float | int]) -> "Axes":
    """The axes of a new figure of that size; inches."""
    return subplots(size=size)[1]
