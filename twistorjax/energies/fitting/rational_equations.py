"""Equations of the fit of a rational energy, and their solution.

A fit sets up the equations at the trials with `rational_equations` and solves them with
`solve_rational`.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from ..evaluation import term_wrenches
from ..monomials import Powers, VARIABLES
from ..polynomial import Polynomial
from ..strains import Coordinates
from .least_squares import solve_minimum_norm
from .trials import Trials


_SMALLEST_RATIO = 0.1  # of denominator to base; the ridge grows until this is exceeded


def require_base(
    trials: Trials,
    base: Polynomial | None,
    coordinates: Coordinates,
    scale: float | None,
) -> Polynomial:
    """Check the base of the denominator, and rewrite it for another scale.

    The arguments are those of `fit_rational`. By default the scale is that of the base.
    """
    if base is None:
        constant = (0,) * len(VARIABLES[coordinates])
        scale = scale or trials.largest_translation
        return Polynomial([1.0], [constant], coordinates, scale)
    if base.coordinates != coordinates:
        raise ValueError(
            f"`base` is a polynomial of the {base.coordinates}, but must be one of the "
            f"{coordinates}, like `coordinates`."
        )
    if coordinates == "twistor" and any(row[0] > 1 for row in base.powers):
        raise ValueError(
            "`base` has a power of sigma above the first: write sigma^2 as 1 - xi^2."
        )
    if scale is None:
        return base
    factors = np.array(
        [(scale / float(base.scale)) ** sum(row[-2:]) for row in base.powers]
    )
    coefficients = np.asarray(base.coefficients) * factors
    return Polynomial(coefficients, base.powers, coordinates, scale)


class RationalTerms(NamedTuple):
    """Terms and base of the denominator at many poses: values and wrenches."""

    # Wrench of each term, for a coefficient of one
    wrenches: Float[np.ndarray, "poses 3 terms"]
    energies: Float[np.ndarray, "poses terms"]
    base_wrenches: Float[np.ndarray, "poses 3"]
    base: Float[np.ndarray, " poses"]

    def ratio(self, denominator: np.ndarray) -> np.ndarray:
        """Return the ratio of base plus polynomial to base, from its coefficients."""
        return 1 + self.energies @ denominator / self.base

    def quotient(
        self, numerator: np.ndarray, denominator: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the wrenches (N m, N, N) and the energies (J) of the rational energy.

        `numerator` holds its coefficients (J). `denominator` holds those of the
        polynomial that is added to the base.
        """
        with np.errstate(all="ignore"):  # division by zero at a singularity
            total = self.base + self.energies @ denominator
            energies = self.energies @ numerator / total
            slope = self.base_wrenches + self.wrenches @ denominator
            difference = self.wrenches @ numerator - energies[:, None] * slope
            return difference / total[:, None], energies


def evaluate_terms(
    poses: list[Array], powers: Powers, base: Polynomial
) -> list[RationalTerms]:
    """Evaluate the terms and the base, which must be positive, at sets of poses."""
    all_poses = np.concatenate(poses)

    def evaluate(powers: Powers) -> tuple[np.ndarray, np.ndarray]:
        return term_wrenches(all_poses, base.scale, powers, base.coordinates)

    coefficients = np.asarray(base.coefficients)
    base_wrenches, base_values = (
        values @ coefficients for values in evaluate(base.powers)
    )
    if not np.all(base_values > 0):
        row = int(np.argmin(base_values))
        raise ValueError(
            f"`base` is {base_values[row]:g} at the pose {all_poses[row]}, "
            "but must be positive at all trials and poses. Use another base, or leave "
            "this pose out."
        )
    ends = np.cumsum([len(part) for part in poses])[:-1]
    arrays = (*evaluate(powers), base_wrenches, base_values)
    split = (np.split(values, ends) for values in arrays)
    return [RationalTerms(*parts) for parts in zip(*split, strict=True)]


def largest_base_term(base: Polynomial, powers: Powers, at_trials: RationalTerms) -> int:
    """Return the index in `powers` of the base's term that is largest at the trials."""
    indices = [powers.index(row) for row in base.powers]
    values = at_trials.energies[:, indices] * np.asarray(base.coefficients)
    squares = np.sum((values / at_trials.base[:, None]) ** 2, axis=0)
    return indices[int(np.argmax(squares))]


def rational_equations(
    trials: Trials, terms: RationalTerms, free: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Set up the linear equations for the coefficients, in standard deviations.

    The numerator minus the measured energy times the free part of the denominator equals
    the measured energy times the base. The derivatives of both sides are equal, too.
    """
    energies = np.asarray(trials.energies)[:, None]
    weights = 1 / (terms.base[:, None] * np.asarray(trials.energy_deviations)[:, None])
    parts = [terms.energies, -(energies * terms.energies)[:, free]]
    rows = [weights * np.concatenate(parts, axis=1)]
    targets = [weights[:, 0] * energies[:, 0] * terms.base]
    if trials.wrenches is not None:
        wrenches = np.asarray(trials.wrenches)
        weights = 1 / (terms.base[:, None] * np.asarray(trials.wrench_deviations))
        derivatives = wrenches[:, :, None] * terms.energies[:, None]
        derivatives = derivatives + energies[:, None] * terms.wrenches
        parts = [terms.wrenches, -derivatives[:, :, free]]
        block = weights[:, :, None] * np.concatenate(parts, axis=2)
        rows.append(block.reshape(-1, block.shape[2]))
        base_derivative = wrenches * terms.base[:, None] + energies * terms.base_wrenches
        targets.append((weights * base_derivative).reshape(-1))
    return np.concatenate(rows), np.concatenate(targets)


class RationalSolution(NamedTuple):
    """Solution of the least-squares problem."""

    numerator: np.ndarray  # Coefficients of the numerator; J
    denominator: np.ndarray  # Coefficients of the polynomial that is added to the base
    rank: int  # Rank of the matrix of the problem
    condition: float  # Ratio of its largest to its smallest significant singular value
    ridge: float  # Ridge parameter that was used


def solve_rational(
    rows: np.ndarray,
    targets: np.ndarray,
    free: np.ndarray,
    at_trials: RationalTerms,
    at_regular: RationalTerms,
    ridge: float,
    normalize_columns: bool,
) -> RationalSolution:
    """Solve the equations with the smallest ridge that keeps the denominator positive.

    The ridge parameter is tripled until the denominator is positive at the trials and at
    the poses at which the energy must not be singular; if it is zero, it remains zero.
    Targets are in standard deviations.
    """
    terms = len(free)
    penalty = (at_regular.energies / at_regular.base[:, None])[:, free]
    penalty = np.pad(penalty, ((0, 0), (terms, 0)))
    penalty *= np.sqrt(len(at_trials.base) / len(at_regular.base))
    if not np.any(free):
        ridge = 0.0
    while True:
        ridge_rows = ridge * penalty if ridge else penalty[:0]
        all_rows = np.concatenate([rows, ridge_rows])
        all_targets = np.concatenate([targets, np.zeros(len(ridge_rows))])
        coefficients, rank, condition = solve_minimum_norm(
            all_rows, all_targets, normalize_columns
        )
        denominator = np.zeros(terms)
        denominator[free] = coefficients[terms:]
        ratios = (at_trials.ratio(denominator), at_regular.ratio(denominator))
        smallest_ratio = min(map(np.min, ratios))
        # with this order of the comparison, NaN ends the loop
        if ridge == 0 or not smallest_ratio <= _SMALLEST_RATIO:
            return RationalSolution(
                coefficients[:terms], denominator, rank, condition, float(ridge)
            )
        ridge *= 3.0


def add_to_base(base: Polynomial, denominator: np.ndarray, powers: Powers) -> Polynomial:
    """Return the sum of the base and of a polynomial with these coefficients."""
    coefficients = dict(zip(base.powers, np.asarray(base.coefficients), strict=True))
    for row, coefficient in zip(powers, denominator, strict=True):
        if coefficient:
            coefficients[row] = coefficients.get(row, 0.0) + coefficient
    values = np.array(list(coefficients.values()))
    return Polynomial(values, tuple(coefficients), base.coordinates, base.scale)
