"""Two water molecules and the energy of their charges: sections 7.2 to 7.4.

Each is the TIP5P model seen from above its plane: a charge at each hydrogen, and one
where both lone pairs meet in projection; the oxygen, at the origin, bears none. One
molecule is still, the other lies 3 to 6 Angstrom away, in some direction and turned by
some angle, both even over a range about zero.

Lengths are in Angstrom, charges in those of the electron, and Coulomb's constant is one:
energies are in e^2/Angstrom, which is 14.4 eV, wrenches in e^2/Angstrom and
e^2/Angstrom^2. The text gives neither the constant nor the distances; its errors are
those at the trials it fitted, and contradict one another (0.00089 and 0.01266).
"""

import math
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..energies.fitting.rational import fit_rational, RationalFit
from ..energies.fitting.trials import Errors, Trials
from ..energies.point_charges import PointCharges
from ..energies.polynomial import Polynomial
from ..plotting.canvas import subplots
from ..plotting.fits import draw_distribution, draw_ranked


if TYPE_CHECKING:
    from matplotlib.figure import Figure


CHARGES = (0.241, 0.241, -0.482)  # of both hydrogens, and of both lone pairs; e
SITES = ((0.5858823, 0.7569503), (0.5858823, -0.7569503), (-0.4041513, 0.0))  # Angstrom
NEAREST, FARTHEST = 3.0, 6.0  # from origin to origin; Angstrom
FRESH = 2000  # trials to check a fit, and as many poses to keep its poles from

_SQUARE = 20.0  # about the mean of r^2; Angstrom^2
_UNIT = "e\N{SUPERSCRIPT TWO}/\N{LATIN CAPITAL LETTER A WITH RING ABOVE}"


def molecules() -> PointCharges:
    """The energy of two water molecules; e^2/Angstrom.

    Source:
        Section 7.2 of the dissertation, figure 7.5 and equation 7.19.

    Example:
        >>> molecules()(jnp.array([0.0, 3.0, 0.0]))  # dipoles in a row attract
        Array(-0.014644..., dtype=float64)
    """
    return PointCharges(CHARGES, SITES, constant=1.0)


def poses(
    span: float, points: int, seed: int | Sequence[int]
) -> Float[Array, "points 3"]:
    """Where the second molecule may be seen from the first; rad, Angstrom, Angstrom.

    Args:
        span: of its angle, and of the direction in which it lies: from minus to plus half
            of it, evenly; rad.
        points: how many.
        seed: of the choice.

    Raises:
        ValueError: the span is not within a turn; there are no points.
    """
    if not 0 < span <= 2 * math.pi:
        raise ValueError(
            f"`span` is {span!r}, but must be above 0, and at most a turn; rad."
        )
    if points < 1:
        raise ValueError(f"`points` is {points!r}, but must be 1 or more.")
    uniform = np.random.default_rng(seed).random((3, points))
    angles, directions = (uniform[:2] - 0.5) * span
    distances = NEAREST + (FARTHEST - NEAREST) * uniform[2]
    x, y = distances * np.cos(directions), distances * np.sin(directions)
    return jnp.asarray(np.stack([angles, x, y], axis=1))


def trials(
    span: float = math.pi / 2, points: int = 500, seed: int | Sequence[int] = 0
) -> Trials:
    """Energies and wrenches of the second molecule at random poses.

    Args:
        span: of its angle and of its direction; rad.
        points: how many.
        seed: of their choice.

    Raises:
        ValueError: as for `poses`.

    Source:
        Section 7.3.1 of the dissertation.

    Example:
        >>> len(trials(points=10))
        10
    """
    where = poses(span, points, seed)
    energies, wrenches = _exact(where)
    return Trials(where, wrenches, energies)


def power_of_distance(order: int) -> Polynomial:
    """The distance to some even power, by that of 4.5 Angstrom: what has no zero.

    Args:
        order: of the power.

    Raises:
        ValueError: the order is odd, or not positive.

    Example:
        >>> power_of_distance(2)(jnp.array([1.0, 2.0, 4.0]))  # (2^2 + 4^2) / 20
        Array(1., dtype=float64)
    """
    if order < 2 or order % 2:
        raise ValueError(
            f"`order` is {order!r}, but must be even, from 2 on: even powers of the "
            "distance alone are polynomials."
        )
    half = order // 2
    return Polynomial(
        [
            math.comb(half, k) * (4 * NEAREST**2 / _SQUARE) ** half
            for k in range(half + 1)
        ],
        [(0, 0, order - 2 * k, 2 * k) for k in range(half + 1)],
        scale=NEAREST,
    )


def fit_polynomial(of: Trials, order: int, **settings) -> RationalFit:
    """A polynomial of the twistor, fitted to energies alone.

    Args:
        of: trials of the molecules.
        order: of the polynomial.
        settings: for `fit_rational`.

    Source:
        Equation 7.21 of the dissertation, which is 4.69.
    """
    settings = {"scale": 1.0, "denominator": "base", **settings}
    return fit_rational(Trials(of.poses, energies=of.energies), order, **settings)


def fit_plain(of: Trials, order: int, **settings) -> RationalFit:
    """A quotient of two polynomials of the twistor, fitted to energies alone.

    Its denominator has a constant of one, and is free else. It is left to the trials,
    between which it changes sign.

    Args:
        of: trials of the molecules.
        order: of both polynomials.
        settings: for `fit_rational`.

    Source:
        Equations 7.22 to 7.25 of the dissertation.
    """
    settings = {"scale": 1.0, "ridge": 0.0, "even": False, **settings}
    return fit_rational(Trials(of.poses, energies=of.energies), order, **settings)


def fit_quotient(of: Trials, order: int, **settings) -> RationalFit:
    """A quotient by what is known of the molecules, fitted to energies and wrenches.

    They are alike, and each is its own mirror image: so of the terms only those are
    left that do not change when the molecules are exchanged, or mirrored. The denominator
    is a power of their distance, which has no zero, and some of these terms; it is drawn
    to the former until it has no zero at the poses `clear_of`.

    Args:
        of: trials of the molecules.
        order: of both polynomials; even.
        settings: for `fit_rational`: `denominator="base"`, say, for the power alone.

    Raises:
        ValueError: as for `power_of_distance` and `fit_rational`.

    Example:
        >>> fit_quotient(trials(points=200), 4).training.largest_energy < 1e-3
        True
    """
    known = {
        "symmetry": ("mirror", "exchange", "sign"),
        "base": power_of_distance(order),
    }
    return fit_rational(of, order, **{**known, **settings})


FITS = {
    "polynomial": fit_polynomial,
    "plain quotient": fit_plain,
    "kept from poles": fit_quotient,
}


class Study(eqx.Module):
    """Fits to trials of two water molecules, and what they say of fresh ones.

    Args:
        order: of numerators and denominators.
        span: of the angle of the second molecule, and of its direction; rad.
        trials: those fitted, by seed.
        fresh: trials that no fit has seen, by seed.
        fits: by name, those of `FITS`, and by seed.
    """

    order: int
    span: float
    trials: tuple[Trials, ...]
    fresh: tuple[Trials, ...]
    fits: dict[str, tuple[RationalFit, ...]]

    def training(self, name: str) -> np.ndarray:
        """The largest error of the energy at the trials fitted, by seed."""
        return np.array([fit.training.largest_energy for fit in self.fits[name]])

    def held_out(self, name: str) -> np.ndarray:
        """The largest error of the energy at fresh trials, by seed."""
        return np.array([_errors(fit).largest_energy for fit in self.fits[name]])

    def wrenches(self, name: str) -> np.ndarray:
        """The error of the wrench at fresh trials as a part of it, by seed.

        Root mean squares; that component which is met worst.
        """
        return np.array([_errors(fit).relative.max() for fit in self.fits[name]])

    def __repr__(self) -> str:
        seeds = len(self.trials)
        energies = np.concatenate([np.asarray(some.energies) for some in self.trials])
        heads = ("unknowns", "rank", "training", "held out", "wrench", "with poles")
        lines = [
            f"two water molecules, order {self.order}, angles over {self.span:.4g} rad: "
            f"{len(self.trials[0])} trials fitted, {len(self.fresh[0])} held out"
            + (f"; medians over {seeds} seeds" if seeds > 1 else ""),
            "largest error of the energy (e^2/Angstrom; the energy's rms is "
            f"{np.sqrt(np.mean(energies**2)):.2g}), rms error of the wrench (as a part)",
            f"{'':<16}" + "".join(f"{head:>11}" for head in heads),
        ]
        for name, fits in self.fits.items():
            cells = (
                str(fits[0].terms),
                f"{np.median([fit.rank for fit in fits]):.0f}",
                *(
                    f"{np.median(errors(name)):.2g}"
                    for errors in (self.training, self.held_out, self.wrenches)
                ),
                f"{sum(fit.has_poles for fit in fits)} of {seeds}",
            )
            lines.append(f"{name:<16}" + "".join(f"{cell:>11}" for cell in cells))
        return "\n".join(lines)


def study(
    order: int = 6,
    span: float = math.pi / 2,
    points: int = 500,
    seeds: Sequence[int] = (0,),
) -> Study:
    """Fits the energy of two water molecules in three ways, and checks each.

    Args:
        order: of numerators and denominators; even.
        span: of the angle of the second molecule, and of its direction; rad.
        points: trials to fit.
        seeds: of the choice of trials, of fresh ones and of poses without energies where
            there must be no pole.

    Raises:
        ValueError: as for `poses` and `power_of_distance`.

    Source:
        Section 7.4 of the dissertation, figures 7.8 to 7.29.

    Example:
        >>> found = study(order=4, points=200)
        >>> bool(found.held_out("kept from poles") < found.held_out("polynomial") / 5)
        True
    """
    power_of_distance(order)  # refuses an order before any work is done
    fitted = tuple(trials(span, points, (seed, 0)) for seed in seeds)
    fresh = tuple(trials(span, FRESH, (seed, 1)) for seed in seeds)
    fits: dict[str, list[RationalFit]] = {name: [] for name in FITS}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # told by the answer
        for seed, some, others in zip(seeds, fitted, fresh, strict=True):
            clear = {"clear_of": poses(span, FRESH, (seed, 2)), "held_out": others}
            for name, fit in FITS.items():
                fits[name].append(fit(some, order, **clear))
    of_all = {name: tuple(of_one) for name, of_one in fits.items()}
    return Study(order, span, fitted, fresh, of_all)


def plot(study: Study) -> "Figure":
    """Draws the energies of the first seed as they are and as they are fitted.

    Args:
        study: of the molecules.

    Source:
        Figures 7.8, 7.11, 7.13, 7.14 and their like of the dissertation.
    """
    figure, axes = subplots(2, 2, size=(11, 8))
    axes[1, 1].sharex(axes[1, 0])
    axes[1, 1].sharey(axes[1, 0])
    parts = (("fitted", study.trials[0]), ("held out", study.fresh[0]))
    shown = {name: study.fits[name][0] for name in reversed(FITS)}
    for (above, below), (name, some) in zip(axes.T, parts, strict=True):
        given = np.asarray(some.energies)
        values = {
            kind: np.asarray(jax.jit(jax.vmap(fit.energy))(some.poses))
            for kind, fit in shown.items()
        }
        draw_ranked(above, given, values, _UNIT)
        above.set_title(f"{len(some)} trials {name}", fontsize="medium")
        gaps = {kind: found - given for kind, found in values.items()}
        draw_distribution(below, gaps, _UNIT)
    axes[1, 0].legend(fontsize="small", loc="lower left")
    figure.suptitle(
        f"two water molecules, order {study.order}, angles over {study.span:.4g} rad"
    )
    return figure


@jax.jit
def _exact(
    poses: Float[Array, "points 3"],
) -> tuple[Float[Array, " points"], Float[Array, "points 3"]]:
    energy = molecules()
    return jax.vmap(energy)(poses), jax.vmap(energy.wrench)(poses)


def _errors(fit: RationalFit) -> Errors:
    assert fit.held_out is not None  # of every study
    return fit.held_out
