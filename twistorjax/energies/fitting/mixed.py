"""Fit of a `MixedEnergy` to trials.

The equations for the coefficients are linear if the axial forces are given. A first
solution uses the measured axial forces. Gauss-Newton steps then minimize the errors of
the predicted wrenches, whose axial forces follow from the measured displacements.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.polynomial.polynomial import polyder, polyval

from ..mixed import MixedEnergy
from ..monomials import Powers
from .least_squares import ConstrainedSolution, solve_constrained
from .mixed_equations import (
    mixed_equations,
    MixedTrials,
    twists_and_stresses,
    weighted_equations,
)
from .trials import Trials


_AXIAL = (1,)  # the stiff directions; see `AbstractMixedEnergy.stiff`
_AXIAL_STEPS = 6  # of Newton's method for the axial force; see `OneForcePotential`
_RELATIVE_TOLERANCE = 1e-9  # on the change of the predictions in a step


def fit_mixed(
    trials: Trials,
    powers: Powers,
    *,
    reference: str,
    ridge: float | None,
    scale: float | None,
    max_steps: int = 50,
) -> tuple[MixedEnergy, ConstrainedSolution, bool] | None:
    """Fit a mixed energy to trials.

    The flag is true if the iteration converged. There is no result if no energy was found
    with a positive axial compliance at all trials and in the reference configuration.
    The reference length `scale` (m) is by default the largest transverse displacement.
    """
    if trials.wrenches is None or trials.wrench_deviations is None:
        raise ValueError(
            "`trials` have energies but no wrenches. A fit in the coordinates 'mixed' "
            "needs the wrench of each trial, because the axial force is a component of "
            "it. Use 'twistor' or 'twist'."
        )
    if reference != "free":
        powers = tuple(row for row in powers if sum(row) > 1)
    data = _mixed_trials(trials)
    for name, values in (("displacement", data.twists), ("force", data.stresses)):
        if not np.any(values[:, 1]):
            raise ValueError(
                f"The axial {name} of all `trials` is zero, so they do not determine "
                "the axial compliance of a mixed energy. Add trials with axial forces, "
                "or use the coordinates 'twistor' or 'twist'."
            )
    measured = np.asarray(data.stresses[:, 1])
    length = scale or _largest_magnitude(np.asarray(data.twists[:, 2]))
    force = _largest_magnitude(measured)
    stiffness = None
    if reference == "stable":
        stiffness = _reference_stiffness(powers, length, force)

    def solve(
        axial_forces: np.ndarray, coefficients: np.ndarray | None
    ) -> ConstrainedSolution:
        """Solve with the weights of a previous solution."""
        with np.errstate(all="ignore"):  # implausible trials may overflow
            equations = mixed_equations(
                powers, _AXIAL, data.twists, axial_forces[:, None], length, force
            )
            weighted = weighted_equations(data, equations, coefficients)
            rows, targets = map(np.asarray, weighted)
        if trials.energies is not None:
            deviations = np.asarray(trials.energy_deviations)[:, None]
            potentials = np.asarray(trials.energies) - axial_forces * data.twists[:, 1]
            energy_rows = equations.energy / deviations
            rows = np.concatenate([rows, energy_rows[:, None]], axis=1)
            targets = np.concatenate([targets, potentials[:, None] / deviations], axis=1)
        return solve_constrained(rows, targets, ridge, stiffness=stiffness)

    def predict(coefficients: np.ndarray) -> _Prediction:
        return _predict(data, trials, powers, coefficients, length, force)

    solution = solve(measured, None)
    for _ in range(3):
        solution = solve(measured, solution.coefficients)
    best, solution, converged = _gauss_newton(
        solve, predict, solution, measured, max_steps
    )
    coefficients = dict(zip(powers, best.coefficients, strict=True))
    if not (np.isfinite(best.cost) and coefficients.get((0, 0, 2), 0.0) < 0):
        return None
    energy = MixedEnergy(best.coefficients, powers, length=length, force=force)
    solution = solution._replace(coefficients=best.coefficients, residuals=best.residuals)
    return energy, solution, converged


def mixed_residuals(
    energy: MixedEnergy, trials: Trials
) -> Float[np.ndarray, "trials values"]:
    """Compute the residuals of trials with wrenches, in standard deviations.

    A residual is the predicted minus the measured value; see `errors_of_residuals`. It is
    NaN at a trial without an axial force.
    """
    coefficients = np.asarray(energy.coefficients)
    length, force = float(energy.length), float(energy.force)
    data = _mixed_trials(trials)
    return _predict(data, trials, energy.powers, coefficients, length, force).residuals


def _mixed_trials(trials: Trials) -> MixedTrials:
    """Return trials with wrenches in the coordinates of a mixed energy, on the host."""
    arrays = trials.poses, trials.wrenches, trials.wrench_deviations
    return MixedTrials(*map(np.asarray, twists_and_stresses(*arrays)))


class _Prediction(NamedTuple):
    coefficients: np.ndarray  # Coefficients of the energy; J
    residuals: np.ndarray  # Predicted minus measured values in standard deviations
    axial_forces: np.ndarray  # Predicted axial forces; N

    @property
    def cost(self) -> float:
        """Sum of the squared residuals; infinite if a trial has no axial force."""
        cost = np.sum(self.residuals**2)
        return float(cost) if np.isfinite(cost) else np.inf


def _gauss_newton(
    solve: Callable[[np.ndarray, np.ndarray], ConstrainedSolution],
    predict: Callable[[np.ndarray], _Prediction],
    solution: ConstrainedSolution,
    measured: np.ndarray,
    max_steps: int,
) -> tuple[_Prediction, ConstrainedSolution, bool]:
    """Minimize the errors of the predictions, starting from a solution.

    A step is halved until the errors decrease.

    Args:
        solve: Solves the least-squares problem at given axial forces (N), with the
            weights of given coefficients (J).
        measured: Axial forces (N), which replace predictions that do not exist.

    Returns:
        The prediction with the smallest errors, the last solution, and whether the
        iteration converged.
    """
    best = predict(solution.coefficients)
    for _ in range(max_steps):
        is_known = np.isfinite(best.axial_forces)
        axial_forces = np.where(is_known, best.axial_forces, measured)
        solution = solve(axial_forces, best.coefficients)
        step = solution.coefficients - best.coefficients
        for fraction in 0.5 ** np.arange(11):
            trial = predict(best.coefficients + fraction * step)
            if trial.cost < best.cost or not np.isfinite(best.cost):
                break
        else:  # no step decreases the errors: rounding, or a changed ridge parameter
            return best, solution, True
        decrease = best.cost - trial.cost
        scale = trial.cost + trial.residuals.size * _RELATIVE_TOLERANCE**2
        best = trial
        if decrease <= _RELATIVE_TOLERANCE * scale:
            return best, solution, True
    return best, solution, False


def _predict(
    data: MixedTrials,
    trials: Trials,
    powers: Powers,
    coefficients: np.ndarray,
    length: float,
    force: float,
) -> _Prediction:
    """Predict the measurements, and evaluate their errors.

    The axial forces follow from the measured displacements by Newton's method.
    """
    exponents = np.array(powers)
    rotations, axial, transverse = data.twists.T
    bending = rotations[:, None] ** exponents[:, 0]
    bending = bending * (transverse[:, None] / length) ** exponents[:, 1]
    # For each trial, W is a polynomial of the axial force.
    of_force = exponents[:, 2:] == np.arange(exponents[:, 2].max() + 1)
    slope = polyder(((bending * coefficients) @ of_force).T)
    curvature = polyder(slope)
    ratios = np.zeros(len(axial))
    with np.errstate(all="ignore"):  # trials without an axial force become NaN
        for _ in range(_AXIAL_STEPS):
            inside = np.clip(ratios, -1.0, 1.0)
            residual = force * axial + polyval(inside, slope, tensor=False)
            ratios = inside - residual / polyval(inside, curvature, tensor=False)
        is_maximum = polyval(np.clip(ratios, -1.0, 1.0), curvature, tensor=False) < 0
        forces = np.where(is_maximum, force * ratios, np.nan)
        at = mixed_equations(powers, _AXIAL, data.twists, forces[:, None], length, force)
        moments, transverse_forces, _ = (at.conjugates @ coefficients).T
        stresses = np.stack([moments, forces, transverse_forces], axis=1)
        residuals = np.einsum("sij,sj->si", data.to_wrenches, stresses - data.stresses)
        if trials.energies is not None:
            energies = forces * axial + at.energy @ coefficients
            errors = energies - np.asarray(trials.energies)
            errors = errors / np.asarray(trials.energy_deviations)
            residuals = np.concatenate([residuals, errors[:, None]], axis=1)
    return _Prediction(coefficients, residuals, forces)


def _largest_magnitude(values: Float[np.ndarray, " trials"]) -> float:
    """Return the largest absolute value, or one if its square would underflow."""
    largest = float(np.max(np.abs(values)))
    return largest if largest > 1e-150 else 1.0


def _reference_stiffness(powers: Powers, length: float, force: float) -> np.ndarray:
    """Compute the matrix that is positive definite if the reference is stable.

    It holds the second derivatives of W with respect to rotation and transverse
    displacement, and minus that with respect to the axial force, which is the axial
    compliance. Length (m) and force (N) are the reference values of W. The last axis is
    that of the terms, each with a coefficient of one joule.
    """
    stiffness = np.zeros((3, 3, len(powers)))
    for row, entries, value in (
        ((2, 0, 0), [(0, 0)], 2.0),
        ((1, 1, 0), [(0, 2), (2, 0)], 1 / length),
        ((0, 2, 0), [(2, 2)], 2 / length / length),  # `length**2` may overflow.
        ((0, 0, 2), [(1, 1)], -2 / force / force),
    ):
        if row in powers:
            for entry in entries:
                stiffness[*entry, powers.index(row)] = value
    return stiffness
