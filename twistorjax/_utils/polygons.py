"""Closed polygons: edges that cross each other, area, and centroid."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int


# Distances that count as zero, over the largest coordinate
_CONTACT = 1e-12
# Distance from an edge at which the winding number is computed, over the same
_BESIDE = 1e-9

Points = Float[np.ndarray, "_ 2"]
Pairs = Int[np.ndarray, "_ 2"]


def area_and_centroid(xp: Any, corners: Any) -> tuple[Any, Any]:
    """Compute the area (positive if counterclockwise) and the centroid of a polygon.

    They follow from Green's theorem for triangles from the mean of the corners, so that
    no digits are lost if the polygon is far from the origin. `xp` is the module of the
    array: numpy or jax.numpy. The centroid is the mean corner if there is no area.
    """
    middle = xp.mean(corners, axis=0)
    start = corners - middle[None]
    end = xp.roll(start, -1, axis=0)
    cross = start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]
    area = xp.sum(cross) / 2
    moment = xp.sum((start + end) * cross[:, None], axis=0)
    return area, middle + moment / (6 * xp.where(area == 0, np.inf, area))


def crossing_edges(corners: Points) -> tuple[int, int] | None:
    """Find two edges of a closed polygon that cross, by the corners at which they start.

    Corners may be repeated, edges may touch or cover each other, and the order of the
    corners may be clockwise or counterclockwise, as long as no part of the plane is
    encircled twice, or once in each direction.
    """
    size = np.max(np.abs(corners), initial=np.finfo(float).tiny)
    scaled = corners / size
    following = np.roll(scaled, -1, axis=0)
    kept = np.flatnonzero(np.max(np.abs(following - scaled), axis=1) > _CONTACT)
    if len(kept) < 3:
        return None
    starts, ends = scaled[kept], scaled[np.roll(kept, -1)]
    first, second = _near_pairs(starts, ends).T
    # Distances of the ends of each edge from the line of the other one
    distances = _distances(
        np.stack([starts[first], starts[first], starts[second], starts[second]]),
        np.stack([ends[first], ends[first], ends[second], ends[second]]),
        np.stack([starts[second], ends[second], starts[first], ends[first]]),
    )
    apart = np.abs(distances) > _CONTACT
    sides = np.sign(distances)
    opposite = (sides[0] != sides[1]) & (sides[2] != sides[3])
    crossing = np.flatnonzero(np.all(apart, axis=0) & opposite)
    if crossing.size:
        pair = np.array([first[crossing[0]], second[crossing[0]]])
    else:
        neighbors = (second - first == 1) | (second - first == len(kept) - 1)
        touching = ~neighbors & ~np.all(apart, axis=0)
        pair = _wound_twice(starts, ends, np.stack([first, second], axis=1)[touching])
    return None if pair is None else (int(kept[pair[0]]), int(kept[pair[1]]))


def _near_pairs(starts: Points, ends: Points) -> Pairs:
    """List the pairs of edges whose boxes overlap, the lower index first."""
    low = np.minimum(starts, ends) - _CONTACT
    high = np.maximum(starts, ends) + _CONTACT
    order = np.argsort(low[:, 0], kind="stable")
    # The edges after each one, in this order, that begin before it ends
    last = np.searchsorted(low[order, 0], high[order, 0], side="right")
    counts = last - np.arange(len(order)) - 1
    left = np.repeat(np.arange(len(order)), counts)
    steps = np.arange(len(left)) - np.repeat(np.cumsum(counts) - counts, counts)
    pairs = np.sort(np.stack([order[left], order[left + 1 + steps]], axis=1), axis=1)
    first, second = pairs.T
    overlap = (low[first, 1] <= high[second, 1]) & (low[second, 1] <= high[first, 1])
    pairs = pairs[overlap]
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def _distances(
    starts: Float[np.ndarray, "*n 2"],
    ends: Float[np.ndarray, "*n 2"],
    points: Float[np.ndarray, "*n 2"],
) -> Float[np.ndarray, "*n"]:
    """Compute the signed distances of points from lines, positive on the left."""
    along, arm = ends - starts, points - starts
    cross = along[..., 0] * arm[..., 1] - along[..., 1] * arm[..., 0]
    return cross / np.hypot(along[..., 0], along[..., 1])


def _wound_twice(
    starts: Points, ends: Points, pairs: Pairs
) -> Int[np.ndarray, "2"] | None:
    """Find two edges that touch, and beside which the polygon crosses itself.

    The winding numbers on both sides of all edges must be 0 and 1, or 0 and -1.
    """
    if not len(pairs):
        return None
    edges = np.unique(pairs)
    samples, owners = [], []
    for edge in edges:
        others = np.concatenate(
            [pairs[pairs[:, 0] == edge, 1], pairs[pairs[:, 1] == edge, 0]]
        )
        along = ends[edge] - starts[edge]
        points = np.concatenate([starts[others], ends[others]]) - starts[edge]
        shares = np.clip(points @ along / (along @ along), 0.0, 1.0)
        shares = np.unique(np.concatenate([[0.0, 1.0], shares]))
        length = np.hypot(*along)
        long = np.diff(shares) * length > 4 * _BESIDE
        middles = ((shares[1:] + shares[:-1]) / 2)[long, None] * along + starts[edge]
        normal = np.array([-along[1], along[0]]) / length
        samples += [middles + _BESIDE * normal, middles - _BESIDE * normal]
        owners += [edge] * (2 * len(middles))
    numbers = _winding_numbers(starts, ends, np.concatenate(samples))
    sign = 1 if np.sum(starts[:, 0] * ends[:, 1] - starts[:, 1] * ends[:, 0]) > 0 else -1
    wrong = np.flatnonzero((numbers != 0) & (numbers != sign))
    if not wrong.size:
        return None
    edge = owners[wrong[0]]
    return pairs[np.any(pairs == edge, axis=1)][0]


def _winding_numbers(
    starts: Points, ends: Points, points: Points
) -> Int[np.ndarray, " _"]:
    """Compute the winding numbers of a polygon about points that are not on it."""
    y = points[:, None, 1]
    upward = (starts[:, 1] <= y) & (ends[:, 1] > y)
    downward = (starts[:, 1] > y) & (ends[:, 1] <= y)
    along, arm = ends - starts, points[:, None] - starts
    left = along[:, 0] * arm[..., 1] - along[:, 1] * arm[..., 0]
    return np.sum(upward & (left > 0), axis=1) - np.sum(downward & (left < 0), axis=1)
