"""Linear least squares with equality constraints and an estimate of the error."""

from typing import NamedTuple

import numpy as np


_RIDGES = (0.0, *10.0 ** np.arange(-15.0, -3.0))
_RELATIVE_RANK_TOLERANCE = 1e-13  # smaller singular values are rounding errors


class ConstrainedSolution(NamedTuple):
    """Solution of a linear least-squares problem with equality constraints."""

    coefficients: np.ndarray
    # Fitted minus measured values, a row for each trial, in standard deviations
    residuals: np.ndarray
    # Residuals of each trial for the fit to all other trials
    leave_one_out_residuals: np.ndarray
    rank: int  # Number of coefficients, or combinations of them, that are determined
    free: int  # Number of coefficients that the constraints leave free
    # Ratio of the largest singular value to the smallest significant one
    condition: float
    ridge: float  # Ridge parameter, relative to the square of the largest singular value
    # Covariance of the coefficients for measurements of unit variance
    covariance: np.ndarray
    # Directions of coefficients that the trials do not determine, in columns
    undetermined: np.ndarray
    # Whether the stiffness was not positive definite without a constraint
    stiffness_replaced: bool = False


def solve_constrained(
    rows: np.ndarray,
    targets: np.ndarray,
    ridge: float | None,
    *,
    constraints: np.ndarray | None = None,
    stiffness: np.ndarray | None = None,
) -> ConstrainedSolution:
    """Solve a linear least-squares problem, optionally for a positive definite stiffness.

    If the stiffness matrix of the solution is not positive definite, the problem is
    solved again with the nearest positive definite matrix as a constraint.

    Args:
        rows: A block of rows for each trial and a column for each coefficient.
        targets: Measured values, a row for each trial, in standard deviations.
        ridge: Ridge parameter, relative to the square of the largest singular value. By
            default the one with the smallest leave-one-out error.
        constraints: Linear combinations of the coefficients that must vanish.
        stiffness: Contribution of each coefficient to the stiffness matrix, in the last
            axis. By default the stiffness matrix may have any eigenvalues.
    """
    if constraints is None:
        constraints = np.zeros((0, rows.shape[2]))
    values = np.zeros(len(constraints))
    solution = _solve(rows, targets, constraints, values, ridge)
    if stiffness is None:
        return solution
    rounding = np.zeros(3)
    if solution.rank < solution.free:  # the stiffness may be zero up to rounding errors
        diagonal = np.abs(np.diagonal(stiffness))
        rounding = 1e-9 * np.sum(diagonal, axis=0) * np.max(np.abs(solution.coefficients))
    matrix = _nearest_positive_definite(
        np.einsum("ijk,k->ij", stiffness, solution.coefficients), rounding
    )
    if matrix is None:
        return solution
    upper = np.triu_indices(3)
    constraints = np.concatenate([constraints, stiffness[upper]])
    values = np.concatenate([values, matrix[upper]])
    solution = _solve(rows, targets, constraints, values, ridge)
    return solution._replace(stiffness_replaced=True)


def _solve(
    rows: np.ndarray,
    targets: np.ndarray,
    constraints: np.ndarray,
    values: np.ndarray,
    ridge: float | None,
) -> ConstrainedSolution:
    """Solve a least-squares problem so that `constraints @ coefficients` is `values`."""
    trials, block_size, terms = rows.shape
    matrix, target = rows.reshape(-1, terms), targets.reshape(-1)
    if not (np.all(np.isfinite(matrix)) and np.all(np.isfinite(target))):
        raise ValueError(
            "The equations of the fit are not finite, because values of the `trials` are "
            "too large. Check their units."
        )
    norms = _column_norms(matrix)
    matrix, constraints = matrix / norms, constraints / norms
    particular, null_space = np.zeros(terms), np.eye(terms)
    if len(constraints):
        u, s, v = np.linalg.svd(constraints)
        count = int(np.sum(s > 1e-12 * s[0])) if s[0] > 0 else 0
        particular = v[:count].T @ ((u[:, :count].T @ values) / s[:count])
        null_space = v[count:].T
    target = target - matrix @ particular
    u, s, v = np.linalg.svd(matrix @ null_space, full_matrices=False)
    largest = s[0] if s.size else 1.0  # empty if the constraints fix all coefficients
    significant = s > _RELATIVE_RANK_TOLERANCE * largest
    rank = int(np.sum(significant))
    projected = u.T @ target

    def residuals_for(ridge: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return filter factors, residuals and leave-one-out residuals for a ridge."""
        squares = np.where(significant, s, 1.0) ** 2
        filters = np.where(significant, squares / (squares + ridge * largest**2), 0.0)
        residuals = u @ (filters * projected) - target
        blocks = u.reshape(trials, block_size, u.shape[1])
        leverage = (blocks * filters) @ np.swapaxes(blocks, 1, 2)
        with np.errstate(all="ignore"):
            complement = np.eye(block_size) - leverage
            regular = np.linalg.det(complement) > 1e-9**block_size
            complement[~regular] = np.eye(block_size)
            leave_one_out = np.linalg.solve(
                complement, residuals.reshape(trials, block_size, 1)
            )[..., 0]
        leave_one_out[~regular] = np.inf
        return filters, residuals.reshape(trials, block_size), leave_one_out

    ridges = _RIDGES if ridge is None else (ridge,)
    results = [residuals_for(candidate) for candidate in ridges]
    scores = [np.mean(leave_one_out**2) for _, _, leave_one_out in results]
    best = int(np.argmin(scores)) if np.any(np.isfinite(scores)) else 0
    filters, residuals, leave_one_out = results[best]
    inverse = np.where(significant, filters / np.where(significant, s, 1.0), 0.0)
    coefficients = (particular + null_space @ (v.T @ (inverse * projected))) / norms
    root = (null_space @ v.T) * inverse / norms[:, None]
    undetermined = _undetermined_directions(null_space, v, significant)
    return ConstrainedSolution(
        coefficients=coefficients,
        residuals=residuals,
        leave_one_out_residuals=leave_one_out,
        rank=rank,
        free=null_space.shape[1],
        condition=float(largest / s[significant][-1]) if rank else np.inf,
        ridge=float(ridges[best]),
        covariance=root @ root.T,
        undetermined=undetermined / norms[:, None],
    )


def solve_minimum_norm(
    rows: np.ndarray, targets: np.ndarray, normalize: bool = True
) -> tuple[np.ndarray, int, float]:
    """Solve a linear least-squares problem; the solution has the smallest norm.

    If `normalize` is true, each column is divided by its norm, so that the norm of the
    coefficients does not depend on their units. The other results are the rank of the
    matrix, and the ratio of its largest singular value to the smallest significant one.

    Example:
        >>> rows = np.array([[1.0, 0.0], [0.0, 2.0]])
        >>> targets = np.array([3.0, 8.0])
        >>> coefficients, rank, condition = solve_minimum_norm(rows, targets)
        >>> print(coefficients, rank, condition)
        [3. 4.] 2 1.0
    """
    norms = _column_norms(rows) if normalize else np.ones(rows.shape[1])
    coefficients, _, rank, s = np.linalg.lstsq(
        rows / norms, targets, rcond=_RELATIVE_RANK_TOLERANCE
    )
    condition = float(s[0] / s[rank - 1]) if rank else np.inf
    return coefficients / norms, int(rank), condition


def _column_norms(matrix: np.ndarray) -> np.ndarray:
    """Return the norm of each column, or one for a column of zeros."""
    norms = np.linalg.norm(matrix, axis=0)
    return np.where(norms > 0, norms, 1.0)


def _undetermined_directions(
    null_space: np.ndarray, v: np.ndarray, significant: np.ndarray
) -> np.ndarray:
    """Find directions that neither the constraints nor the trials determine.

    They are the columns of the result. `null_space` is a basis of the null space of the
    constraints, in columns. The rows of `v` are the right singular vectors in this basis.
    """
    if not np.any(significant):
        return null_space
    if np.sum(significant) == null_space.shape[1]:
        return null_space[:, :0]
    basis = np.linalg.svd(v[significant], full_matrices=True)[2]
    return null_space @ basis[int(np.sum(significant)) :].T


def _nearest_positive_definite(
    matrix: np.ndarray, rounding: np.ndarray
) -> np.ndarray | None:
    """Replace the eigenvalues of a symmetric matrix that are not positive.

    The matrix is scaled by its diagonal first, because its entries have different units.
    The result is `None` if the matrix is positive definite, or if negative eigenvalues
    are much smaller than the `rounding` errors of the diagonal.
    """
    scale = np.sqrt(np.maximum(np.abs(np.diagonal(matrix)), rounding))
    scale = np.where(scale > 0, scale, 1.0)
    units = np.outer(scale, scale)
    scaled = matrix / units
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2)
    if values[0] > (-1e-6 if np.any(rounding) else 0.0):
        return None
    values = np.maximum(values, 1e-6 * max(values[-1], 1e-300))
    return (vectors * values) @ vectors.T * units
