"""Fits to the electrostatic energy of two water molecules (sections 7.2 to 7.4).

Each molecule is the TIP5P model, projected onto the plane of its atoms: one charge at
each hydrogen atom, and one charge at the common projection of both lone pairs. The oxygen
atom is at the origin and has no charge. One molecule is fixed. The other is 3 to
6 Angstrom away; its direction and its angle are uniformly distributed about zero.

Lengths are in Angstrom, charges in elementary charges e, and the Coulomb constant is 1.
Energies are therefore in e^2/Angstrom (14.4 eV), moments in e^2/Angstrom, and forces in
e^2/Angstrom^2. The dissertation states neither the constant nor the distances. Its errors
are training errors, and two statements of them contradict each other (0.00089 and
0.01266).
"""

import math
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.progress import announced
from ..energies.fitting.rational import fit_rational, RationalFit
from ..energies.fitting.trials import Errors, Trials
from ..energies.point_charges import PointCharges
from ..energies.polynomial import Polynomial
from ..plotting.figure_style import subplots
from ..plotting.fits import draw_distribution, draw_ranked


if TYPE_CHECKING:
    from matplotlib.figure import Figure


CHARGES = (0.241, 0.241, -0.482)  # both hydrogen atoms, and both lone pairs; e
SITES = ((0.5858823, 0.7569503), (0.5858823, -0.7569503), (-0.4041513, 0.0))  # Angstrom
NEAREST, FARTHEST = 3.0, 6.0  # distance of the oxygen atoms; Angstrom
HELD_OUT = 2000  # number of held-out trials, and of poses checked for singularities

_MEAN_SQUARE = 20.0  # of the distance, approximately; Angstrom^2
_UNIT = "e\N{SUPERSCRIPT TWO}/\N{LATIN CAPITAL LETTER A WITH RING ABOVE}"


def molecules() -> PointCharges:
    """Return the energy of two water molecules; e^2/Angstrom.

    Source:
        Section 7.2 of the dissertation, figure 7.5 and equation 7.19.

    Example:
        >>> energy = molecules()
        >>> energy(jnp.array([0.0, 3.0, 0.0]))  # two dipoles in a row attract each other
        Array(-0.014644..., dtype=float64)
    """
    return PointCharges(CHARGES, SITES, constant=1.0)


def poses(
    angle_range: float, points: int, seed: int | Sequence[int]
) -> Float[Array, "points 3"]:
    """Draw random poses of the second molecule relative to the first.

    Args:
        angle_range: Width of the interval about zero in which the angle and the direction
            of the second molecule are uniformly distributed; rad.
        points: Number of poses.
        seed: Seed of the random numbers.

    Returns:
        Angle (rad), x, and y (Angstrom) of each pose.

    Raises:
        ValueError: The range is not positive or exceeds one revolution, or there are no
            points.
    """
    if not 0 < angle_range <= 2 * math.pi:
        raise ValueError(
            f"`angle_range` is {angle_range!r}, but must be positive and at most "
            "2 pi; rad."
        )
    if points < 1:
        raise ValueError(f"`points` is {points!r}, but must be 1 or more.")
    uniform = np.random.default_rng(seed).random((3, points))
    angles, directions = (uniform[:2] - 0.5) * angle_range
    distances = NEAREST + (FARTHEST - NEAREST) * uniform[2]
    x, y = distances * np.cos(directions), distances * np.sin(directions)
    return jnp.asarray(np.stack([angles, x, y], axis=1))


def trials(
    angle_range: float = math.pi / 2, points: int = 500, seed: int | Sequence[int] = 0
) -> Trials:
    """Compute energies and wrenches of the second molecule at random poses.

    Args:
        angle_range: Range of the angle and of the direction; rad.
        points: Number of trials.
        seed: Seed of the random numbers.

    Returns:
        The trials, in the units of this module.

    Raises:
        ValueError: As for `poses`.

    Source:
        Section 7.3.1 of the dissertation.

    Example:
        >>> len(trials(points=10))
        10
    """
    sampled = poses(angle_range, points, seed)
    energies, wrenches = _exact(sampled)
    return Trials(poses=sampled, wrenches=wrenches, energies=energies)


def power_of_distance(order: int) -> Polynomial:
    """Return an even power of the ratio of the distance to 4.5 Angstrom.

    It is positive at all distances, so it is a denominator without zeros.

    Args:
        order: Order of the power; even.

    Returns:
        The power, a polynomial of the translation.

    Raises:
        ValueError: The order is odd or not positive.

    Example:
        >>> square = power_of_distance(2)
        >>> square(jnp.array([1.0, 2.0, 4.0]))  # (2^2 + 4^2) / 20
        Array(1., dtype=float64)
    """
    if order < 2 or order % 2:
        raise ValueError(
            f"`order` is {order!r}, but must be an even number from 2 on: only even "
            "powers of the distance are polynomials."
        )
    half = order // 2
    factor = (4 * NEAREST**2 / _MEAN_SQUARE) ** half
    coefficients = [math.comb(half, k) * factor for k in range(half + 1)]
    powers = [(0, 0, order - 2 * k, 2 * k) for k in range(half + 1)]
    return Polynomial(coefficients, powers, scale=NEAREST)


def fit_polynomial(data: Trials, order: int, **settings) -> RationalFit:
    """Fit a polynomial of the twistor to energies alone.

    Args:
        data: Trials of the molecules.
        order: Order of the polynomial.
        settings: Further arguments of `fit_rational`.

    Returns:
        The polynomial as a rational energy with the denominator 1, and its errors.

    Source:
        Equation 7.21 of the dissertation, which is equation 4.69.
    """
    settings = {"scale": 1.0, "denominator": "base", **settings}
    return fit_rational(Trials(data.poses, energies=data.energies), order, **settings)


def fit_unregularized(data: Trials, order: int, **settings) -> RationalFit:
    """Fit a rational function of the twistor to energies alone, without regularization.

    The constant term of the denominator is 1, and its other coefficients are free.
    Nothing keeps the denominator positive, so it changes sign between the trials.

    Args:
        data: Trials of the molecules.
        order: Order of numerator and denominator.
        settings: Further arguments of `fit_rational`.

    Returns:
        The rational energy and its errors.

    Source:
        Equations 7.22 to 7.25 of the dissertation.
    """
    settings = {"scale": 1.0, "ridge": 0.0, "normalize_columns": False, **settings}
    return fit_rational(Trials(data.poses, energies=data.energies), order, **settings)


def fit_regularized(data: Trials, order: int, **settings) -> RationalFit:
    """Fit a regularized rational function to energies and wrenches.

    The molecules are identical, and each is its own mirror image. The energy therefore
    contains only terms that do not change if the molecules are exchanged or mirrored. The
    denominator is the sum of a power of the distance, which has no zero, and of a
    polynomial in these terms. A ridge regularizes this polynomial, until the denominator
    is positive at the poses `regular_poses`.

    Args:
        data: Trials of the molecules.
        order: Order of numerator and denominator; even.
        settings: Further arguments of `fit_rational`, such as `denominator="base"` for
            the power of the distance alone.

    Returns:
        The rational energy and its errors.

    Raises:
        ValueError: As for `power_of_distance` and `fit_rational`.

    Example:
        >>> data = trials(points=200)
        >>> fit_regularized(data, order=4).training.largest_energy < 1e-3
        True
    """
    settings = {
        "symmetry": ("mirror", "exchange", "sign"),
        "base": power_of_distance(order),
        **settings,
    }
    return fit_rational(data, order, **settings)


FITS: dict[str, Callable[..., RationalFit]] = {
    "polynomial": fit_polynomial,
    "unregularized rational": fit_unregularized,
    "regularized rational": fit_regularized,
}


class Study(eqx.Module):
    """Three kinds of fits to trials of two water molecules, and their errors.

    Args:
        order: Order of numerators and denominators.
        angle_range: Range of the angle and of the direction of the second molecule; rad.
        trials: Trials to which energies are fitted, for each seed.
        held_out_trials: Trials that check the fits, for each seed.
        fits: Fits by name, as in `FITS`, for each seed.
    """

    order: int
    angle_range: float
    trials: tuple[Trials, ...]
    held_out_trials: tuple[Trials, ...]
    fits: dict[str, tuple[RationalFit, ...]]

    def training_error(self, name: str) -> np.ndarray:
        """Return the largest error of the energy at fitted trials, for each seed."""
        return np.array([fit.training.largest_energy for fit in self.fits[name]])

    def held_out_error(self, name: str) -> np.ndarray:
        """Return the largest error of the energy at held-out trials, for each seed."""
        return np.array([_held_out(fit).largest_energy for fit in self.fits[name]])

    def wrench_error(self, name: str) -> np.ndarray:
        """Return the relative error of the wrench at held-out trials, for each seed.

        It is the ratio of root mean squares, of the component for which it is largest.
        """
        return np.array([_held_out(fit).relative.max() for fit in self.fits[name]])

    def __repr__(self) -> str:
        seeds = len(self.trials)
        energies = np.concatenate([np.asarray(data.energies) for data in self.trials])
        title = (
            f"two water molecules, order {self.order}, "
            f"angle range {self.angle_range:.4g} rad: {len(self.trials[0])} fitted "
            f"trials, {len(self.held_out_trials[0])} held-out trials"
        )
        if seeds > 1:
            title += f"; medians of {seeds} seeds"
        rms = np.sqrt(np.mean(energies**2))
        lines = [
            title,
            f"largest error of the energy (e^2/Angstrom; rms of the energy: {rms:.2g}), "
            "relative rms error of the wrench",
        ]
        heads = ("unknowns", "rank", "training", "held out", "wrench", "singular")
        lines.append(f"{'':<24}" + "".join(f"{head:>11}" for head in heads))
        for name, fits in self.fits.items():
            cells = (
                f"{fits[0].terms}",
                f"{np.median([fit.rank for fit in fits]):.0f}",
                f"{np.median(self.training_error(name)):.2g}",
                f"{np.median(self.held_out_error(name)):.2g}",
                f"{np.median(self.wrench_error(name)):.2g}",
                f"{sum(fit.has_singularities for fit in fits)} of {seeds}",
            )
            lines.append(f"{name:<24}" + "".join(f"{cell:>11}" for cell in cells))
        return "\n".join(lines)


@announced("fits to the energy of water")
def study(
    order: int = 6,
    angle_range: float = math.pi / 2,
    points: int = 500,
    seeds: Sequence[int] = (0,),
) -> Study:
    """Fit the energy of two water molecules in three ways, and check each fit.

    Args:
        order: Order of numerators and denominators; even.
        angle_range: Range of the angle and of the direction of the second molecule; rad.
        points: Number of trials that are fitted.
        seeds: Seeds of the fitted trials, of the held-out trials, and of the poses that
            are checked for singularities.

    Returns:
        The fits and their errors.

    Raises:
        ValueError: As for `poses` and `power_of_distance`.

    Source:
        Section 7.4 of the dissertation, figures 7.8 to 7.29.

    Example:
        >>> result = study(order=4, points=200)
        >>> rational_error = result.held_out_error("regularized rational")
        >>> polynomial_error = result.held_out_error("polynomial")
        >>> bool(rational_error < polynomial_error / 5)
        True
    """
    power_of_distance(order)  # raises an error before the trials are computed
    fitted = tuple(trials(angle_range, points, (seed, 0)) for seed in seeds)
    held_out = tuple(trials(angle_range, HELD_OUT, (seed, 1)) for seed in seeds)
    fits: dict[str, list[RationalFit]] = {name: [] for name in FITS}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the result reports singularities
        for seed, data, check in zip(seeds, fitted, held_out, strict=True):
            regular_poses = poses(angle_range, HELD_OUT, (seed, 2))
            for name, fit in FITS.items():
                fits[name].append(
                    fit(data, order, regular_poses=regular_poses, held_out=check)
                )
    return Study(
        order=order,
        angle_range=angle_range,
        trials=fitted,
        held_out_trials=held_out,
        fits={name: tuple(of_seeds) for name, of_seeds in fits.items()},
    )


def plot(study: Study) -> "Figure":
    """Draw the exact and the fitted energies of the first seed, and their errors.

    Args:
        study: A study made by `study`.

    Returns:
        The figure: energies in the upper row, distributions of the errors in the lower
        row; fitted trials on the left, held-out trials on the right.

    Source:
        Figures 7.8, 7.11, 7.13, 7.14, and similar figures of the dissertation.
    """
    figure, axes = subplots(2, 2, size=(11, 8))
    axes[1, 1].sharex(axes[1, 0])
    axes[1, 1].sharey(axes[1, 0])
    fits = {name: study.fits[name][0] for name in reversed(FITS)}
    parts = (("fitted", study.trials[0]), ("held-out", study.held_out_trials[0]))
    for (upper, lower), (part, data) in zip(axes.T, parts, strict=True):
        exact = np.asarray(data.energies)
        fitted = {
            name: np.asarray(jax.jit(jax.vmap(fit.energy))(data.poses))
            for name, fit in fits.items()
        }
        draw_ranked(upper, exact, fitted, _UNIT)
        upper.set_title(f"{len(data)} {part} trials", fontsize="medium")
        errors = {name: energies - exact for name, energies in fitted.items()}
        draw_distribution(lower, errors, _UNIT)
    axes[1, 0].legend(fontsize="small", loc="lower left")
    figure.suptitle(
        f"two water molecules, order {study.order}, "
        f"angle range {study.angle_range:.4g} rad"
    )
    return figure


@jax.jit
def _exact(
    poses: Float[Array, "points 3"],
) -> tuple[Float[Array, " points"], Float[Array, "points 3"]]:
    """Compute the exact energies and wrenches at some poses, in the module's units."""
    energy = molecules()
    return jax.vmap(energy)(poses), jax.vmap(energy.wrench)(poses)


def _held_out(fit: RationalFit) -> Errors:
    """Return the errors of a fit at the held-out trials, which every study has."""
    assert fit.held_out is not None
    return fit.held_out
