"""Labels on the axes of a drawing, placed so that they do not overlap.

This module imports matplotlib. Import it only inside the functions that need it.
"""

from typing import Any, cast, TYPE_CHECKING

import numpy as np
from matplotlib.artist import Artist
from matplotlib.patches import FancyArrowPatch
from matplotlib.path import Path
from matplotlib.patheffects import withStroke
from matplotlib.text import Annotation
from matplotlib.transforms import Transform


if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backend_bases import RendererBase


# Lengths in points.
_GAP = 6.0  # from an anchor to its label
_PADDING = np.array([3.0, 1.5])  # beside and above a label
_STEP, _RINGS, _ANGLES = 3.0, 40, 16  # candidate positions around the preferred one

# Costs of a candidate position; a distance of one point costs 1.
_OVERLAP, _OUTSIDE, _MARK, _EDGE = 1000.0, 500.0, 25.0, 8.0


class Labels(Artist):
    """All labels of a drawing, which are placed each time the axes are drawn.

    Only then are the extents of the texts relative to the mechanism known, because the
    layout of the figure and the limits of the axes may change after `draw` has returned.
    The labels are placed in the order in which they were added. Each takes the position
    with the lowest cost among fixed candidates, so that the result is reproducible. A
    position costs most if the label overlaps another text, less if it leaves the axes,
    and still less if it covers an arrow, a marked point, or an edge of a part.
    """

    def __init__(self) -> None:
        super().__init__()
        self.set_zorder(0)  # Labels must be placed before their texts are drawn.
        self.set_in_layout(False)
        self._labels: list[tuple[Annotation, np.ndarray]] = []

    @classmethod
    def of(cls, axes: "Axes") -> "Labels":
        """Return the labels of these axes, and create them if there are none."""
        for artist in axes.artists:
            if isinstance(artist, cls):
                return artist
        labels = cls()
        axes.add_artist(labels)
        return labels

    def add(
        self, text: str, anchor: np.ndarray, direction: np.ndarray, **style: Any
    ) -> None:
        """Add a label to an anchor, in data coordinates.

        The preferred direction from the anchor to the label is zero if the label may
        cover its anchor. The style has arguments of `matplotlib.axes.Axes.annotate`.
        """
        label = cast("Axes", self.axes).annotate(
            text, tuple(anchor), xytext=(0, 0), textcoords="offset points", ha="center",
            va="center", **style,
        )  # fmt: skip
        label.set_in_layout(False)  # Its position depends on the layout.
        # Names can be read on parts of their own color.
        label.set_path_effects([withStroke(linewidth=2.0, foreground="#ffffffc0")])
        self._labels.append((label, np.asarray(direction, float)))

    def draw(self, renderer: "RendererBase") -> None:
        """Place the labels. Matplotlib draws their texts afterwards."""
        axes = cast("Axes", self.axes)
        pixels = float(np.asarray(renderer.points_to_pixels(1.0)))
        # All lengths below are in points.
        frame = axes.get_window_extent(renderer).get_points() / pixels
        placed = [
            text.get_window_extent(renderer).get_points() / pixels
            for text in axes.texts
            if text.get_visible()
            and text.get_text()
            and not any(text is label for label, _ in self._labels)
        ]
        shown, marks, edges = [], [], []
        for label, direction in self._labels:
            anchor = axes.transData.transform(label.xy)
            drawn = label.axes is axes and label.get_visible()
            if drawn and axes.contains_point(tuple(anchor)):
                shown.append((label, direction, anchor / pixels))
                marks += [anchor[None] / pixels] if np.any(direction) else []
        for collection in axes.collections:
            for path in collection.get_paths():
                edges.append(_outline_points(path, collection.get_transform(), pixels))
        for patch in axes.patches:
            is_arrow = isinstance(patch, FancyArrowPatch)
            points = _outline_points(patch.get_path(), patch.get_transform(), pixels)
            (marks if is_arrow else edges).append(points)
        mark_counts = _Counts(np.concatenate([*marks, np.zeros((0, 2))]), frame)
        edge_counts = _Counts(np.concatenate([*edges, np.zeros((0, 2))]), frame)
        offsets = _candidate_offsets()
        for label, direction, anchor in shown:
            extent = label.get_window_extent(renderer)
            half_size = np.array([extent.width, extent.height]) / (2 * pixels) + _PADDING
            preferred = anchor + _offset_beside(direction, half_size)
            low = preferred + offsets - half_size
            high = low + 2 * half_size
            cost = np.linalg.norm(offsets, axis=1)
            for other_low, other_high in placed:
                cost += _OVERLAP * np.all((low < other_high) & (high > other_low), axis=1)
            cost += _OUTSIDE * np.any((low < frame[0]) | (high > frame[1]), axis=1)
            cost += _MARK * (mark_counts.inside(low, high) > 0)
            cost += _EDGE * (edge_counts.inside(low, high) > 0)
            best = np.argmin(cost)
            placed.append(np.stack([low[best], high[best]]))
            dx, dy = preferred + offsets[best] - anchor
            label.xyann = (dx, dy)
        self.stale = False


class _Counts:
    """Numbers of points in the cells of a grid, summed from the lower left corner.

    The sums give the number of points in any box at once, so that the time for a label
    does not depend on the number of points. The cells are one point wide, and all
    coordinates are in points. `frame` has two corners: lower left and upper right.
    """

    def __init__(self, points: np.ndarray, frame: np.ndarray) -> None:
        self._origin = frame[0]
        shape = np.ceil(frame[1] - frame[0]).astype(int) + 1
        cells = np.floor(points - frame[0]).astype(int)
        cells = cells[np.all((cells >= 0) & (cells < shape), axis=1)]
        counts = np.zeros(shape + 1, int)
        np.add.at(counts, tuple(cells.T + 1), 1)
        self._sums = counts.cumsum(axis=0).cumsum(axis=1)

    def inside(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Count the points in boxes with these corners; points."""
        limit = np.array(self._sums.shape) - 1
        left, bottom = np.clip(np.floor(low - self._origin).astype(int), 0, limit).T
        right, top = np.clip(np.ceil(high - self._origin).astype(int), 0, limit).T
        upper = self._sums[right, top] - self._sums[left, top]
        return upper - (self._sums[right, bottom] - self._sums[left, bottom])


def _candidate_offsets() -> np.ndarray:
    """Compute offsets from the preferred position, on circles around it; points."""
    radii = _STEP * np.arange(1, _RINGS + 1)
    angles = np.linspace(0, 2 * np.pi, _ANGLES, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rings = (radii[:, None, None] * circle).reshape(-1, 2)
    return np.concatenate([np.zeros((1, 2)), rings])


def _offset_beside(direction: np.ndarray, half_size: np.ndarray) -> np.ndarray:
    """Compute the offset (points) of the center of a label beside its anchor.

    If the direction is zero, the offset is zero. `half_size` is half the width and half
    the height of the label; points.
    """
    if not np.any(direction):
        return np.zeros(2)
    unit = direction / np.linalg.norm(direction)
    with np.errstate(divide="ignore"):
        return unit * (_GAP + np.min(half_size / np.abs(unit)))


def _outline_points(path: Path, transform: Transform, pixels: float) -> np.ndarray:
    """Compute positions on an outline in a drawing, about one point apart; points.

    `pixels` is the number of pixels in a point.
    """
    path = path.transformed(transform)
    points = [np.zeros((0, 2))]
    for corners in map(np.asarray, path.to_polygons(closed_only=False)):
        lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
        distance = np.concatenate([[0.0], np.cumsum(lengths)])
        # The number of points is limited, in case a user zooms far into the drawing.
        samples = np.arange(0.0, distance[-1], max(pixels, 1e-4 * distance[-1]))
        columns = [np.interp(samples, distance, corners[:, k]) for k in range(2)]
        points.append(np.stack(columns, axis=1) / pixels)
    return np.concatenate(points)
