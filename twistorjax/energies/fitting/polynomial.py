"""Fit of polynomial and mixed energies to trials, by linear least squares.

Sections 3.6, 4.7 and 7.1 of the dissertation. Here the equations are those of the three
components of the wrench, instead of the dissertation's four generalized forces.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import jax
import numpy as np
from jaxtyping import Int

from ..._utils.progress import announced, progress_bar
from ..._utils.validation import require_choice, require_float64, warn
from ..evaluation import term_stiffnesses, term_wrenches
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
from .mixed import fit_mixed, mixed_residuals
from .plausibility import better_conversion, implausible_values, reversed_wrenches
from .report import (
    as_sentences,
    coordinates_of,
    describe_direction,
    eigenvalues,
    EnergyFit,
    interpolation_warning,
    large_error_warning,
    LARGEST_ERROR,
    largest_error,
    reference_stiffness,
)
from .trials import Errors, errors_of_predictions, errors_of_residuals, Trials


_FEWEST_TRIALS = 12  # with which energies of order 2 are compared


@announced("fit of an energy")
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
    progress: bool = False,
) -> EnergyFit:
    """Fit the energy of a hinge to trials, and estimate its error at new trials.

    A warning is raised, and is in the result, if the expected error or the error at the
    held-out trials exceeds 5 % of the rms value of a component, or if the units of the
    trials are implausible: a rotation of more than a turn, or a translation of more than
    a meter. If the error exceeds 5 %, the warning names other units and signs of the
    trials with which a fit is at least five times as accurate, if there are any. A factor
    by which all wrenches are wrong cannot be recognized.

    Trials with the same pose count as one trial with their average, so that the expected
    error of repeated trials is that at other poses.

    Args:
        trials: Measured or computed trials.
        order: Order of the polynomial, by default the order from 2 to 12 with the
            smallest expected error. The search ends after two higher orders with a larger
            error, or if the number of terms exceeds 0.8 times the number of measured
            values.
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
        hold_out: Fraction of the poses whose trials are held out. A fit to the others is
            checked with them; the returned energy is fitted to all trials.
        seed: Seed of the random choice of the held-out trials.
        progress: Whether to show a progress bar.

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
        >>> import jax.numpy as jnp
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
    averages, rows = trials.averages()
    best = _best_candidate(averages, orders, settings, progress)
    held_out = None
    if hold_out:
        count = max(1, round(hold_out * len(averages)))
        if count >= len(averages):
            raise ValueError(
                f"There are only {len(averages)} trials with different poses, too few to "
                f"hold out a fraction of {hold_out:g}. Use a smaller `hold_out` or more "
                "trials."
            )
        shuffled = np.random.default_rng(seed).permutation(len(averages))
        others = averages[np.sort(shuffled[count:])]
        energy = _best_candidate(others, (best.order,), settings).energy
        held_out = _errors(energy, trials[np.isin(rows, shuffled[:count])])
    fit = best.report(trials, averages, rows, held_out, settings)
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
    max_steps: int = 50  # of the iteration of a mixed fit


class _Candidate(NamedTuple):
    order: int
    energy: Polynomial | MixedEnergy
    solution: ConstrainedSolution
    converged: bool = True

    @property
    def score(self) -> float:
        """Expected rms error in standard deviations; infinite if it is not known."""
        score = float(np.sqrt(np.mean(self.solution.leave_one_out_residuals**2)))
        return score if np.isfinite(score) else np.inf

    @property
    def interpolates(self) -> bool:
        solution = self.solution
        return solution.rank >= solution.residuals.size and solution.ridge == 0

    def report(
        self,
        trials: Trials,
        averages: Trials,
        rows: Int[np.ndarray, " trials"],
        held_out: Errors | None,
        settings: _Settings,
    ) -> EnergyFit:
        """Return the result of `fit_energy`.

        This is a fit to the averages of trials with the same pose; each trial has the row
        of its average.
        """
        solution = self.solution
        value_count = solution.residuals.size
        degrees_of_freedom = max(1, value_count - solution.rank)
        variance = np.sum(solution.residuals**2) / degrees_of_freedom
        names = VARIABLES[coordinates_of(self.energy)]
        forces = np.full((1, 2), np.nan)
        if trials.wrenches is not None:
            forces = np.asarray(trials.wrenches[:, 1:])
        left_out = averages.predictions(solution.leave_one_out_residuals)
        expected = errors_of_predictions(trials, *(values[rows] for values in left_out))
        errors = [expected] if held_out is None else [expected, held_out]
        texts = _warnings(averages, self, errors, settings)
        return EnergyFit(
            energy=self.energy,
            training=_errors(self.energy, trials),
            expected=expected,
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
            warning=as_sentences(texts) or None,
            rotation=float(np.abs(trials.poses[:, 0]).max()),
            force=float(np.linalg.norm(forces, axis=1).max()),
        )


def _warnings(
    trials: Trials, best: _Candidate, errors: Sequence[Errors], settings: _Settings
) -> list[str]:
    """Describe the reasons for which an energy may be worthless, in sentences.

    The errors are the expected ones, and those at the held-out trials.
    """
    solution, reference, texts = best.solution, settings.reference, []
    largest = max(largest_error(trials, each) for each in errors)
    if best.interpolates:
        texts.append(interpolation_warning(solution.free, solution.residuals.size))
    elif not best.converged:
        texts.append(
            "the iteration of the mixed fit did not converge, so its error is not the "
            "smallest possible one. Use another order or more trials."
        )
    if largest > LARGEST_ERROR and not best.interpolates:
        texts.append(large_error_warning(largest))
    if reference != "stable" and np.all(
        eigenvalues(reference_stiffness(best.energy)) < 0
    ):
        texts.append(
            "all eigenvalues of the stiffness in the reference configuration are "
            "negative: is the sign of the wrenches reversed?"
        )
    if solution.stiffness_replaced:
        texts.append(
            "the stiffness in the reference configuration that fits best is not positive "
            "definite, so it was replaced. Use `reference='unstressed'` if the hinge is "
            "unstable in this configuration."
        )
    texts += implausible_values(trials)
    if trials.wrenches is None or best.interpolates or largest <= LARGEST_ERROR:
        return texts
    if reference == "stable" and (text := reversed_wrenches(trials)):
        return [*texts, text]
    error = best.score
    if len(trials) >= _FEWEST_TRIALS:
        error = min(error, _quick_error(trials, 4, settings))
    if text := _better_conversion(trials, error, settings):
        texts.append(text)
    elif error < best.score / 5 and not isinstance(best.energy, MixedEnergy):
        texts.append("the coordinates 'mixed' are much more accurate for these trials.")
    return texts


def _better_conversion(trials: Trials, error: float, settings: _Settings) -> str | None:
    """Find other units and signs of the trials; see `better_conversion`."""
    if len(trials) < _FEWEST_TRIALS:
        return None
    return better_conversion(
        trials, error, lambda trials, order: _quick_error(trials, order, settings)
    )


def _quick_error(trials: Trials, order: int, settings: _Settings) -> float:
    """Estimate the expected error of an energy of low order; see `_Candidate.score`.

    The order is reduced if there are few trials.
    """
    errors = [np.inf]
    for coordinates in ("twistor", "mixed"):
        quick = settings._replace(
            coordinates=coordinates, redundant=False, ridge=None, scale=None, max_steps=5
        )
        few = order
        try:
            while few > 2 and len(_powers(few, quick)) > 0.8 * 3 * len(trials):
                few -= 1
            with np.errstate(all="ignore"):
                candidate = _candidate(trials, few, _powers(few, quick), quick)
        except ValueError:
            # The trials have no axial forces, the equations overflow, or the symmetry is
            # not one of these coordinates.
            continue
        if candidate is not None:
            errors.append(candidate.score)
    return min(errors)


def _best_candidate(
    trials: Trials,
    orders: Sequence[int],
    settings: _Settings,
    progress: bool = False,
) -> _Candidate:
    """Fit energies of several orders and return that with the smallest expected error.

    The orders ascend. Those with more than 0.8 coefficients for each measured value are
    left out. The search ends after two orders with a larger error. The low orders may
    have no valid energy, so it ends after four of them if none was found.
    """
    values_per_trial = 3 * (trials.wrenches is not None) + (trials.energies is not None)
    best, previous, worse = None, None, 0
    with progress_bar(len(orders), "order", progress) as bar:
        for order in orders:
            powers = _powers(order, settings)
            too_many = len(powers) > 0.8 * values_per_trial * len(trials)
            if previous is not None and (too_many or worse >= (2 if best else 4)):
                break
            bar.update()
            if powers == previous:  # a symmetry may exclude all new terms of an odd order
                continue
            previous = powers
            candidate = _candidate(trials, order, powers, settings)
            if candidate is not None and (best is None or candidate.score < best.score):
                best, worse = candidate, 0
            else:
                worse += 1
    if best is not None:
        return best
    texts = [
        "No mixed energy was found whose axial compliance is positive at all `trials` "
        "and in the reference configuration. Use another order, more trials, or the "
        "coordinates 'twistor' or 'twist'.",
        *implausible_values(trials),
    ]
    size = np.asarray(trials.wrenches) / np.asarray(trials.wrench_deviations)
    error = float(np.sqrt(np.mean(size**2)))  # of the energy zero
    text = reversed_wrenches(trials) or _better_conversion(trials, error, settings)
    raise ValueError(as_sentences([*texts, text] if text else texts))


def _powers(order: int, settings: _Settings) -> Powers:
    """List the terms of an order, without the constant."""
    rows = monomials(
        order,
        settings.coordinates,
        symmetry=settings.symmetry,
        redundant=settings.redundant,
    )
    return tuple(row for row in rows if any(row))


def _candidate(
    trials: Trials, order: int, powers: Powers, settings: _Settings
) -> _Candidate | None:
    """Fit an energy with given powers; `None` if there is no valid mixed energy."""
    coordinates, reference = settings.coordinates, settings.reference
    ridge, scale = settings.ridge, settings.scale
    if coordinates == "mixed":
        found = fit_mixed(
            trials,
            powers,
            reference=reference,
            ridge=ridge,
            scale=scale,
            max_steps=settings.max_steps,
        )
        return None if found is None else _Candidate(order, *found)
    scale = scale or trials.largest_translation
    rows, targets = _equations(trials, powers, coordinates, scale)
    wrench = stiffness = None
    if reference != "free":
        wrench = term_wrenches(np.zeros((1, 3)), scale, powers, coordinates)[0][0]
    if reference == "stable":
        stiffness = term_stiffnesses(scale, powers, coordinates)
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
    wrenches, energies = term_wrenches(trials.poses, scale, powers, coordinates)
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


def _errors(energy: Polynomial | MixedEnergy, trials: Trials) -> Errors:
    if isinstance(energy, MixedEnergy):
        return errors_of_residuals(trials, mixed_residuals(energy, trials))
    wrenches, energies = term_wrenches(
        trials.poses, energy.scale, energy.powers, energy.coordinates
    )
    coefficients = np.asarray(energy.coefficients)
    energies = energies - reference_values(energy.powers)
    return errors_of_predictions(trials, wrenches @ coefficients, energies @ coefficients)
