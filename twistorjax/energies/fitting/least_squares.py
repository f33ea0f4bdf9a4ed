"""Linear least squares under conditions, with what it says of its own error."""

from typing import NamedTuple

import numpy as np


RIDGES = (0.0, *10.0 ** np.arange(-15.0, -3.0))
_BEYOND = 1e-13  # singular values below this part of the largest are rounding


class Solved(NamedTuple):
    """Least squares under conditions, by the singular values of what is left free."""

    coefficients: np.ndarray
    residual: np.ndarray
    left_out: np.ndarray  # residual of each trial in a fit to all others
    rank: int
    free: int
    condition: float
    ridge: float
    spread: np.ndarray  # of the coefficients, for errors of one
    unseen: np.ndarray  # directions, in columns


def solve(
    rows: np.ndarray,
    right: np.ndarray,
    conditions: np.ndarray,
    values: np.ndarray,
    ridge: float | None,
) -> Solved:
    """The coefficients that meet equations best, and some conditions exactly.

    Args:
        rows: a block for each trial: what a unit of each coefficient adds to each number.
        right: the numbers, in standard deviations.
        conditions: what a unit of each coefficient adds to what must be exact.
        values: that this must be.
        ridge: weight that draws coefficients to zero, as a part of the largest singular
            value's square; by default that of the least error of left-out trials.
    """
    trials, each, terms = rows.shape
    matrix, target = rows.reshape(-1, terms), right.reshape(-1)
    # Conditions first: what they leave free is spanned by `free`
    size = _sizes(matrix)
    matrix, conditions = matrix / size, conditions / size
    start, free = np.zeros(terms), np.eye(terms)
    if len(conditions):
        u, s, v = np.linalg.svd(conditions)
        kept = int(np.sum(s > 1e-12 * s[0])) if s[0] > 0 else 0
        start = v[:kept].T @ ((u[:, :kept].T @ values) / s[:kept])
        free = v[kept:].T
    target = target - matrix @ start
    u, s, v = np.linalg.svd(matrix @ free, full_matrices=False)
    largest = s[0] if s.size else 1.0  # none, where the conditions leave nothing free
    seen = s > _BEYOND * largest
    rank = int(np.sum(seen))
    within = u.T @ target

    def filtered(ridge: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        squares = np.where(seen, s, 1.0) ** 2
        gains = np.where(seen, squares / (squares + ridge * largest**2), 0.0)
        residual = target - u @ (gains * within)
        blocks = u.reshape(trials, each, u.shape[1])
        hat = (blocks * gains) @ np.swapaxes(blocks, 1, 2)
        with np.errstate(all="ignore"):
            gap = np.eye(each) - hat
            sure = np.linalg.det(gap) > 1e-9**each
            gap[~sure] = np.eye(each)
            left_out = np.linalg.solve(gap, residual.reshape(trials, each, 1))[..., 0]
        left_out[~sure] = np.inf
        return gains, residual.reshape(trials, each), left_out

    choices = RIDGES if ridge is None else (ridge,)
    tried = [filtered(choice) for choice in choices]
    scores = [np.mean(left_out**2) for _, _, left_out in tried]
    best = int(np.argmin(scores)) if np.any(np.isfinite(scores)) else 0
    gains, residual, left_out = tried[best]
    inverse = np.where(seen, gains / np.where(seen, s, 1.0), 0.0)
    coefficients = (start + free @ (v.T @ (inverse * within))) / size
    shape = (free @ v.T) * inverse / size[:, None]
    return Solved(
        coefficients=coefficients,
        residual=residual,
        left_out=left_out,
        rank=rank,
        free=free.shape[1],
        condition=float(largest / s[seen][-1]) if rank else np.inf,
        ridge=float(choices[best]),
        spread=shape @ shape.T,
        unseen=_unseen(free, v, seen) / size[:, None],
    )


def least(
    rows: np.ndarray, right: np.ndarray, even: bool = True
) -> tuple[np.ndarray, int, float]:
    """The coefficients that meet equations best, and of such the smallest.

    Args:
        rows: what a unit of each coefficient adds to each number.
        right: the numbers.
        even: whether coefficients are measured by what they add, or as they stand.

    Returns:
        The coefficients; how many of them the equations tell apart; and the ratio of the
        largest singular value to the smallest that counts.

    Example:
        >>> least(np.array([[1.0, 0.0], [0.0, 2.0]]), np.array([3.0, 8.0]))
        (array([3., 4.]), 2, 1.0)
    """
    size = _sizes(rows) if even else np.ones(rows.shape[1])
    coefficients, _, rank, s = np.linalg.lstsq(rows / size, right, rcond=_BEYOND)
    condition = float(s[0] / s[rank - 1]) if rank else np.inf
    return coefficients / size, int(rank), condition


def _sizes(matrix: np.ndarray) -> np.ndarray:
    """The length of each column, by which all come to count alike; one, where it is 0."""
    size = np.linalg.norm(matrix, axis=0)
    return np.where(size > 0, size, 1.0)


def _unseen(free: np.ndarray, v: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """What the rows see nothing of, among what the conditions leave free."""
    whole = np.linalg.svd(v[seen], full_matrices=True)[2] if np.any(seen) else None
    if whole is None:
        return free
    return free @ whole[int(np.sum(seen)) :].T
