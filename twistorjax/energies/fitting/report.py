"""Result of the fit of an energy to trials."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..mixed import MixedEnergy
from ..monomials import FitCoordinates, Powers
from ..polynomial import Polynomial
from ..validity import WithValidityRange
from .trials import Errors, Trials


LARGEST_ERROR = 0.05  # relative error without a warning


class EnergyFit(eqx.Module):
    """Energy fitted to trials, with estimates of its error.

    Args:
        energy: Energy, fitted to all trials.
        training: Errors at the trials.
        expected: Expected errors at new trials of the same distribution: the
            leave-one-out errors, in which each trial is compared with the fit to those
            with other poses, to first order for a `MixedEnergy`. Infinite if the fit
            interpolates the trials.
        held_out: Errors at the held-out trials of a fit to the others, or `None` if no
            trials were held out.
        value_count: Number of measured values; those of trials with the same pose count
            once.
        terms: Number of free coefficients.
        rank: Number of coefficients, or combinations of them, that the trials determine.
        condition: Ratio of the largest singular value to the smallest significant one.
        ridge: Ridge parameter, relative to the square of the largest singular value.
        covariance: Covariance of the coefficients; J^2.
        undetermined: Descriptions of combinations of terms that the trials do not
            determine, at most five.
        warning: Warning about the fit, or `None`.
        rotation: Largest rotation of the trials; rad.
        force: Largest force of the trials, NaN without measured wrenches; N.
    """

    energy: Polynomial | MixedEnergy
    training: Errors
    expected: Errors
    held_out: Errors | None
    value_count: int
    terms: int
    rank: int
    condition: float
    ridge: float
    covariance: Float[np.ndarray, "terms terms"]
    undetermined: tuple[str, ...]
    warning: str | None
    rotation: float
    force: float

    @property
    def stiffness(self) -> Float[Array, "3 3"]:
        """Stiffness in the reference configuration; N m/rad, N/rad, N/m."""
        return reference_stiffness(self.energy)

    @property
    def with_validity_range(self) -> WithValidityRange:
        """The energy with the range of the trials and its expected relative error.

        Raises:
            ValueError: The trials have no wrenches, no rotations, or no forces, or the
                fit interpolates them.
        """
        if not np.all(np.isfinite(self.expected.relative)):
            raise ValueError(
                "This fit has no validity range, because its error at new trials is "
                "unknown. Fit to trials with wrenches, and to more measured values than "
                "coefficients."
            )
        if not (self.rotation > 0 and self.force > 0):
            raise ValueError(
                "This fit has no validity range, because all trials have the rotation "
                "zero or the force zero. Add trials with rotations and forces."
            )
        return WithValidityRange(
            self.energy, self.rotation, self.force, self.expected.relative
        )

    def __repr__(self) -> str:
        energy = self.energy
        lines = [
            f"{coordinates_of(energy)} polynomial of order {energy.order}: {self.terms} "
            f"free coefficients from {self.value_count} measured values, rank "
            f"{self.rank}, condition {self.condition:.1e}, ridge {self.ridge:.0e}",
            f"{'rms error':<24}  {'moment (N m)':>20}  {'force 1 (N)':>20}  "
            f"{'force 2 (N)':>20}",
        ]
        kinds = (
            ("training", self.training),
            ("expected (leave-one-out)", self.expected),
            ("held out", self.held_out),
        )
        for name, errors in kinds:
            if errors is not None:
                cells = [
                    f"{f'{error:.3g} ({100 * relative:.2g} %)':>20}"
                    for error, relative in zip(
                        errors.rms_wrench, errors.relative, strict=True
                    )
                ]
                lines.append(f"{name:<24}  {'  '.join(cells)}")
        stiffness = np.asarray(self.stiffness)
        k11, k22, k33 = np.diagonal(stiffness)
        values = ", ".join(f"{value:.4g}" for value in eigenvalues(stiffness))
        lines.append(
            f"stiffness in the reference configuration: {k11:.4g} N m/rad, "
            f"{k22:.4g} N/m, {k33:.4g} N/m; eigenvalues {values}"
        )
        if self.undetermined:
            lines.append(f"undetermined: {'; '.join(self.undetermined)}")
        if self.warning:
            lines.append(f"warning: {self.warning}")
        return "\n".join(lines)


def reference_stiffness(energy: Polynomial | MixedEnergy) -> Float[Array, "3 3"]:
    """Compute the stiffness in the reference configuration.

    Only terms up to the second order contribute to it. The others would make its program
    compile for seconds. They contribute if a linear term of a mixed energy causes an
    axial force in the reference configuration.
    """
    if isinstance(energy, MixedEnergy) and any(sum(row) == 1 for row in energy.powers):
        return energy.tangent_stiffness()
    kept = [k for k, row in enumerate(energy.powers) if sum(row[-3:]) <= 2]
    powers = tuple(energy.powers[k] for k in kept)
    coefficients = np.asarray(energy.coefficients)[kept]
    if isinstance(energy, Polynomial):
        energy = Polynomial(coefficients, powers, energy.coordinates, energy.scale)
    else:
        energy = MixedEnergy(
            coefficients, powers, length=energy.length, force=energy.force
        )
    return energy.tangent_stiffness()


def eigenvalues(stiffness: ArrayLike) -> np.ndarray:
    """Compute the eigenvalues of the symmetric part of a stiffness, in its SI units."""
    matrix = np.asarray(stiffness)
    return np.linalg.eigvalsh((matrix + matrix.T) / 2)


def coordinates_of(energy: Polynomial | MixedEnergy) -> FitCoordinates:
    """Return the coordinates of an energy, as `fit_energy` takes them."""
    return "mixed" if isinstance(energy, MixedEnergy) else energy.coordinates


def as_sentences(texts: Sequence[str]) -> str:
    """Join texts that start with a small letter; the first one keeps it."""
    return " ".join([*texts[:1], *(text[0].upper() + text[1:] for text in texts[1:])])


def largest_error(trials: Trials, errors: Errors) -> float:
    """Return the largest relative error of the components of the wrench, or the energy.

    It is infinite if the error is not known.
    """
    known = errors.relative[~np.isnan(errors.relative)]
    if trials.wrenches is None:
        size = np.sqrt(np.mean(np.asarray(trials.energies) ** 2))
        known = np.array([errors.rms_energy / size]) if size > 0 else known
    return float(np.max(known, initial=0.0))


def large_error_warning(error: float) -> str:
    """Return the warning about a large expected error, or one that is not known."""
    if not np.isfinite(error):
        return (
            "the error at new trials is not known, because single trials determine some "
            "coefficients. Use a lower order, more symmetry, or more trials."
        )
    return (
        f"the error at new trials is up to {100 * error:.3g} % of the rms value of a "
        f"component, more than {100 * LARGEST_ERROR:g} %. Use more trials, more "
        "symmetry, another order, or other coordinates."
    )


def interpolation_warning(terms: int, value_count: int) -> str:
    """Return the warning about a fit whose coefficients interpolate measured values."""
    return (
        f"the fit interpolates: {terms} coefficients for {value_count} measured values. "
        "Its errors at the trials say nothing about its errors elsewhere. Use a lower "
        "order, more symmetry, or more trials."
    )


def describe_direction(
    direction: np.ndarray, powers: Powers, names: Sequence[str]
) -> str:
    """Describe a linear combination by its three largest terms: "+1 xi^2 -0.5 x1 x2"."""
    relative = direction / np.abs(direction).max()
    largest = np.argsort(-np.abs(relative), kind="stable")[:3]
    parts = []
    for term in largest:
        if abs(relative[term]) > 0.1:
            factors = [
                name if power == 1 else f"{name}^{power}"
                for name, power in zip(names, powers[term], strict=True)
                if power
            ]
            parts.append(f"{relative[term]:+.2g} {' '.join(factors) or '1'}")
    return " ".join(parts) + (" ..." if np.sum(np.abs(relative) > 0.1) > 3 else "")
