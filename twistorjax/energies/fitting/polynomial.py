"""Fit of polynomial and mixed energies to trials, by linear least squares.

Sections 3.6, 4.7 and 7.1 of the dissertation. Here the equations are those of the three
components of the wrench, instead of the dissertation's four generalized forces.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._utils.validation import require_choice, require_float64, warn
from ..evaluation import term_wrenches
from ..mixed import MixedEnergy
from ..monomials import (
    FitCoordinates,
    monomials,
    Powers,
    reference_values,
    Symmetries,
    VARIABLES,
)
from ..polynomial import Polynomial
from ..strains import Coordinates
from .least_squares import ConstrainedSolution, solve_constrained
from .mixed import fit_mixed, mixed_predictions
from .report import (
    coordinates_of,
    describe_direction,
    EnergyFit,
    interpolation_warning,
)
from .trials import Errors, errors_of_predictions, errors_of_residuals, Trials


def fit_energy(
    trials: Trials,
    order: int | None = None,
    *,
    coordinates: FitCoordinates = "twistor",
    symmetry: Symmetries = (),
    redundant: bool = False,
    reference: Literal["stable", "unstressed", "free"] = "stable",
    ridge: float | None = None,
    scale: float | None = None,
    hold_out: float = 0.0,
    seed: int = 0,
) -> EnergyFit:
    """Fit the energy of a hinge to trials, and estimate its error at new trials.

    Args:
        trials: Measured or computed trials.
        order: Order of the polynomial, by default the order from 2 to 12 with the
            smallest expected error. Orders above 2 are tried as long as the number of
            terms is at most 0.8 times the number of measured values.
        coordinates: "twistor" or "twist" for a `Polynomial`, or "mixed" for a
            `MixedEnergy`. A mixed energy is by far the most accurate for flexures, which
            are stiff along axis 1.
        symmetry: Symmetries of the hinge; see `monomials`. A fit with more symmetry needs
            fewer trials.
        redundant: Use the powers of sigma above the first, like the dissertation; see
            `monomials`.
        reference: Condition in the reference configuration. "unstressed": the wrench is
            zero; "stable": the wrench is zero and the stiffness is positive definite;
            "free": no condition.
        ridge: Ridge parameter, relative to the square of the largest singular value. By
            default the one with the smallest expected error.
        scale: Length by which the translations are divided; m. By default it is the
            largest translation of the trials, or with "mixed" the largest transverse
            displacement.
        hold_out: Fraction of the trials that are held out. A fit to the others is checked
            with them; the returned energy is fitted to all trials.
        seed: Seed of the random choice of the held-out trials.

    Returns:
        The energy with its errors.

    Raises:
        ValueError: Double precision is disabled; there are too few trials; the trials do
            not have the wrenches, or the axial compliance, that a mixed energy needs; an
            argument is out of its limits.

    Source:
        Sections 4.7 and 7.1 of the dissertation. The expected error is that of Allen, The
        relationship between variable selection and data augmentation and a method for
        prediction, Technometrics 16, 1974.

    Example:
        >>> from twistorjax import Quadratic
        >>> spring = Quadratic(jnp.diag(jnp.array([2.0, 30.0, 9.0])))
        >>> poses = 0.1 * jax.random.normal(jax.random.key(0), (20, 3))
        >>> trials = Trials(poses, wrenches=jax.vmap(spring.wrench)(poses))
        >>> fit = fit_energy(trials, order=2, symmetry="leaf")
        >>> jnp.diag(fit.energy.tangent_stiffness())
        Array([ 2., 30.,  9.], dtype=float64)
    """
    require_float64(trials.poses)
    for values in jax.tree.leaves(trials):
        if np.max(np.abs(values)) > 1e100:  # powers of such values overflow
            raise ValueError(
                f"`trials` have a value of {np.max(np.abs(values)):g}, but a fit needs "
                "values of at most 1e100."
            )
    if order is not None and (type(order) is not int or order < 2):
        raise ValueError(
            f"`order` is {order!r}, but must be a whole number, 2 or larger, because the "
            "terms of order 2 are those of a constant stiffness."
        )
    require_choice("`reference`", reference, ("stable", "unstressed", "free"))
    if not 0 <= hold_out < 1:
        raise ValueError(
            f"`hold_out` is {hold_out!r}, but must be a fraction of the trials: at least "
            "0 and less than 1."
        )
    if ridge is not None and not 0 <= ridge < np.inf:
        raise ValueError(f"`ridge` is {ridge!r}, but must be finite and not negative.")
    settings = _Settings(coordinates, reference, redundant, symmetry, ridge, scale)
    orders = (order,) if order is not None else range(2, 13)
    best = _best_candidate(trials, orders, settings)
    held_out = None
    if hold_out:
        count = max(1, round(hold_out * len(trials)))
        if count >= len(trials):
            raise ValueError(
                f"There are only {len(trials)} trials, too few to hold out a fraction of "
                f"{hold_out:g}. Use a smaller `hold_out` or more trials."
            )
        shuffled = np.random.default_rng(seed).permutation(len(trials))
        others = trials[np.sort(shuffled[count:])]
        energy = _best_candidate(others, (best.order,), settings).energy
        held_out = _errors(energy, trials[np.sort(shuffled[:count])])
    fit = best.report(trials, held_out)
    if fit.warning:
        warn(fit.warning)
    return fit


class _Settings(NamedTuple):
    """Arguments of `fit_energy` that are the same for all orders."""

    coordinates: FitCoordinates
    reference: str
    redundant: bool
    symmetry: Symmetries
    ridge: float | None
    scale: float | None


class _Candidate(NamedTuple):
    """Fit of one order."""

    order: int
    energy: Polynomial | MixedEnergy
    solution: ConstrainedSolution
    converged: bool = True

    @property
    def interpolates(self) -> bool:
        solution = self.solution
        return solution.rank >= solution.residuals.size and solution.ridge == 0

    def report(self, trials: Trials, held_out: Errors | None) -> EnergyFit:
        """Return the result of `fit_energy`; `held_out` has the errors of its check."""
        solution = self.solution
        value_count = solution.residuals.size
        degrees_of_freedom = max(1, value_count - solution.rank)
        variance = np.sum(solution.residuals**2) / degrees_of_freedom
        warning = None
        if self.interpolates:
            warning = interpolation_warning(solution.free, value_count)
        elif not self.converged:
            warning = (
                "The iteration of the mixed fit did not converge, so its error is not "
                "the smallest possible one. Use another order or more trials."
            )
        names = VARIABLES[coordinates_of(self.energy)]
        forces = np.full((1, 2), np.nan)
        if trials.wrenches is not None:
            forces = np.asarray(trials.wrenches[:, 1:])
        return EnergyFit(
            energy=self.energy,
            training=_errors(self.energy, trials),
            expected=errors_of_residuals(trials, solution.leave_one_out_residuals),
            held_out=held_out,
            value_count=value_count,
            terms=solution.free,
            rank=solution.rank,
            condition=solution.condition,
            ridge=solution.ridge,
            covariance=variance * solution.covariance,
            undetermined=tuple(
                describe_direction(direction, self.energy.powers, names)
                for direction in solution.undetermined.T[:5]
            ),
            warning=warning,
            rotation=float(np.abs(trials.poses[:, 0]).max()),
            force=float(np.linalg.norm(forces, axis=1).max()),
        )


def _best_candidate(
    trials: Trials, orders: Sequence[int], settings: _Settings
) -> _Candidate:
    """Fit energies of several orders and return that with the smallest expected error.

    The orders ascend. Those with more than 0.8 coefficients for each measured value are
    left out.
    """
    values_per_trial = 3 * (trials.wrenches is not None) + (trials.energies is not None)
    value_count = values_per_trial * len(trials)
    candidates = []
    for order in orders:
        powers = tuple(
            row
            for row in monomials(
                order,
                settings.coordinates,
                symmetry=settings.symmetry,
                redundant=settings.redundant,
            )
            if any(row)
        )
        if len(orders) > 1 and candidates:
            if len(powers) > 0.8 * value_count:
                break
            # a symmetry may exclude all new terms of an odd order
            if powers == candidates[-1].energy.powers:
                continue
        candidate = _candidate(trials, order, powers, settings)
        if candidate is not None:
            candidates.append(candidate)
    if not candidates:
        raise ValueError(
            "No mixed energy was found whose axial compliance is positive at all "
            "`trials`. Use another order, more trials, or the coordinates 'twistor' or "
            "'twist'."
        )
    scores = [
        np.mean(candidate.solution.leave_one_out_residuals**2) for candidate in candidates
    ]
    return candidates[int(np.nanargmin(np.where(np.isfinite(scores), scores, 1e300)))]


def _candidate(
    trials: Trials, order: int, powers: Powers, settings: _Settings
) -> _Candidate | None:
    """Fit an energy with given powers; `None` if there is no valid mixed energy."""
    coordinates, reference = settings.coordinates, settings.reference
    ridge, scale = settings.ridge, settings.scale
    if coordinates == "mixed":
        found = fit_mixed(trials, powers, reference=reference, ridge=ridge, scale=scale)
        return None if found is None else _Candidate(order, *found)
    scale = scale or trials.largest_translation
    rows, targets = _equations(trials, powers, coordinates, scale)
    wrench = stiffness = None
    if reference != "free":
        wrench, stiffness = _reference_terms(powers, coordinates, scale)
    if reference == "unstressed":
        stiffness = None
    solution = solve_constrained(
        rows, targets, ridge, constraints=wrench, stiffness=stiffness
    )
    energy = Polynomial(solution.coefficients, powers, coordinates, scale)
    return _Candidate(order, energy, solution)


def _equations(
    trials: Trials, powers: Powers, coordinates: Coordinates, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """Set up the linear equations for the coefficients of a polynomial.

    The matrix of the least-squares problem and the measured values are in standard
    deviations. They have a block for each trial, with a row for each measured value.
    """
    wrenches, energies = map(
        np.asarray, term_wrenches(trials.poses, jnp.asarray(scale), powers, coordinates)
    )
    rows, targets = [], []
    if trials.wrenches is not None:
        deviations = np.asarray(trials.wrench_deviations)
        rows.append(wrenches / deviations[:, :, None])
        targets.append(np.asarray(trials.wrenches) / deviations)
    if trials.energies is not None:
        deviations = np.asarray(trials.energy_deviations)[:, None]
        rows.append(((energies - reference_values(powers)) / deviations)[:, None])
        targets.append(np.asarray(trials.energies)[:, None] / deviations)
    return np.concatenate(rows, axis=1), np.concatenate(targets, axis=1)


def _reference_terms(
    powers: Powers, coordinates: Coordinates, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the wrench and the stiffness of each term in the reference configuration.

    Terms have coefficients of one joule and are in the last axis. The wrenches are in
    N m, N, N; the stiffnesses are in N m/rad, N/rad, N/m.
    """

    def wrench(pose: Array) -> Array:
        return term_wrenches(pose[None], jnp.asarray(scale), powers, coordinates)[0][0]

    pose = jnp.zeros(3)
    stiffness = jax.jacfwd(wrench)(pose)
    return np.asarray(wrench(pose)), np.moveaxis(np.asarray(stiffness), 2, 1)


def _errors(energy: Polynomial | MixedEnergy, trials: Trials) -> Errors:
    """Compute the errors of an energy at trials."""
    if isinstance(energy, MixedEnergy):
        wrenches, energies, _ = map(
            np.asarray,
            mixed_predictions(
                energy.powers,
                energy.coefficients,
                energy.length,
                energy.force,
                trials.poses,
            ),
        )
        return errors_of_predictions(trials, wrenches, energies)
    wrenches, energies = map(
        np.asarray,
        term_wrenches(trials.poses, energy.scale, energy.powers, energy.coordinates),
    )
    coefficients = np.asarray(energy.coefficients)
    energies = energies - reference_values(energy.powers)
    return errors_of_predictions(trials, wrenches @ coefficients, energies @ coefficients)
