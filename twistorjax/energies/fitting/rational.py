"""Quotients of polynomials from measurements, for energies with poles beyond the trials.

Section 7.3 of the dissertation, with a denominator that is kept from vanishing, and an
account of what the quotient says of other trials than those it was fitted to.
"""

import warnings
from collections.abc import Sequence
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..._utils.validation import require_choice, require_float64
from ..monomials import columns, monomials, Powers, Symmetry, VARIABLES
from ..polynomial import Polynomial, Rational
from ..strains import Coordinates
from .least_squares import least
from .report import interpolation
from .trials import compared, Errors, Trials


_LOWEST = 0.1  # of the denominator over its base, between whose poses no pole is foreseen


class RationalFit(eqx.Module):
    """A quotient fitted to trials, and how far it can be trusted.

    Args:
        energy: the quotient.
        training: how far it is from the trials that it was fitted to.
        held_out: how far from other trials, or nothing, where none were given.
        equations: numbers that were measured.
        terms: coefficients that were free, of numerator and denominator.
        rank: how many of these the trials and the ridge tell apart.
        condition: ratio of the largest singular value to the smallest that counts.
        ridge: weight that drew the denominator to its base.
        lowest: the least of the denominator over its base at all poses that were given,
            those of the held out trials too.
        highest: the largest.
    """

    energy: Rational
    training: Errors
    held_out: Errors | None
    equations: int
    terms: int
    rank: int
    condition: float
    ridge: float
    lowest: float
    highest: float

    @property
    def has_poles(self) -> bool:
        """Whether the denominator changes sign between the poses that were given."""
        return self.lowest * self.highest <= 0

    @property
    def warning(self) -> str | None:
        """What to beware of, or nothing."""
        cautions = []
        if self.ridge == 0 and self.rank >= self.equations:
            cautions.append(interpolation(self.terms, self.equations))
        if self.has_poles:
            cautions.append(
                "the denominator changes sign: there are poles between the trials. Take "
                "a ridge, or `denominator='base'`."
            )
        return " ".join(cautions) or None

    def __repr__(self) -> str:
        lines = [
            f"quotient of {self.terms} free coefficients from {self.equations} numbers, "
            f"rank {self.rank}, condition {self.condition:.1e}, ridge {self.ridge:.0e}",
            f"denominator over its base: {self.lowest:.3g} to {self.highest:.3g}",
            "  ".join(
                f"{head:>14}"
                for head in (
                    *("error", "energy, rms", "largest", "moment, rms"),
                    *("force 1", "force 2"),
                )
            ),
        ]
        for name, errors in (("training", self.training), ("held out", self.held_out)):
            if errors is not None:
                numbers = (errors.energy, errors.largest_energy, *errors.wrench)
                cells = [f"{name:>14}", *(f"{number:>14.3g}" for number in numbers)]
                lines.append("  ".join(cells))
        if self.warning:
            lines.append(f"warning: {self.warning}")
        return "\n".join(lines)


def fit_rational(
    trials: Trials,
    order: int,
    *,
    coordinates: Coordinates = "twistor",
    symmetry: Symmetry | Sequence[Symmetry] = (),
    denominator: Literal["free", "base"] = "free",
    base: Polynomial | None = None,
    scale: float | None = None,
    ridge: float = 1e-4,
    clear_of: Float[ArrayLike, "poses 3"] | Sequence[Sequence[ArrayLike]] | None = None,
    even: bool = True,
    held_out: Trials | None = None,
) -> RationalFit:
    """A quotient of two polynomials from energies, and from wrenches where there are any.

    The numerator less the measured energy times the denominator is to vanish, and its
    change with displacements fixed to body B: linear equations for the coefficients of
    both, each divided by the base of the denominator. Energies count as they stand, not
    above one at rest, where a quotient may have a pole.

    Which denominator? A "free" one, a base and a polynomial of the same terms as the
    numerator's, fits best. A ridge draws it to its base, ever more strongly until it is
    above a tenth of it at all trials and at the poses `clear_of`: then there is no pole
    at any of these, though that proves nothing of poses between. "base" alone has no pole
    wherever the base has no zero, as a power of the distance, `x1^2 + x2^2`, has none but
    at rest: take that where the energy is used beyond what was sampled, or where a pole
    would do harm. It takes a higher order for the same error.

    Args:
        trials: with energies.
        order: of both polynomials.
        coordinates: "twistor" or "twist".
        symmetry: of the energy, as for `monomials`.
        denominator: "free", or the "base" alone.
        base: of the denominator, without unit, positive at all poses; by default one. It
            should grow as the poles ask: for charges, as a power of their distance.
        scale: the length in parts of which translations are raised to powers, by default
            that of the base, or else the largest there is; m.
        ridge: weight of the free part of the denominator over the base at each pose of
            `clear_of`, against one standard deviation at each trial, however many there
            are of either. Zero leaves the denominator to the trials, and lets it vanish.
        clear_of: poses where there must be no pole, whether or not the energy is known
            there, by default those of the trials; rad, m, m.
        even: whether coefficients are measured by what their terms add at the trials, or
            as they stand, as in the dissertation: of those that meet the trials alike,
            the smallest are taken.
        held_out: trials that the fit does not see, to check it.

    Raises:
        ValueError: double precision is off; there are no energies; the base is not
            positive at a pose, or not one of these coordinates; a setting makes no sense.

    Source:
        Equations 7.22 to 7.25 of the dissertation. It raises sigma to all powers: then
        numerator and denominator may vanish together, for sigma^2 + xi^2 = 1. Here it
        stands once at most, and of a base that is made of the same terms the largest is
        not free.

    Example:
        >>> from twistorjax.energies import PointCharges
        >>> pair = PointCharges([1.0], [[0.0, 0.0]], [1.0], [[1.0, 0.0]], constant=1.0)
        >>> near = jnp.array([[0.0, x, 0.0] for x in (1.0, 1.2, 1.5, 1.8)])
        >>> trials = Trials(near, energies=[pair(pose) for pose in near])
        >>> fit = fit_rational(trials, 1, coordinates="twist", ridge=0.0)
        >>> fit.energy(jnp.array([0.0, 4.0, 0.0]))  # 1 / (4 + 1)
        Array(0.2, dtype=float64)
    """
    require_float64(trials.poses)
    require_choice("`denominator`", denominator, ("free", "base"))
    if trials.energies is None:
        raise ValueError(
            "`trials` have wrenches alone, but a quotient is fitted to energies, and to "
            "wrenches besides: give both, or take `fit_energy`."
        )
    if not 0 <= ridge < np.inf:
        raise ValueError(f"`ridge` is {ridge!r}, but must be finite and not negative.")
    if scale is not None and not 0 < scale < np.inf:
        raise ValueError(f"`scale` is {scale!r}, but must be positive and finite; m.")
    clear = trials.poses if clear_of is None else jnp.asarray(clear_of, float)
    if clear.ndim != 2 or clear.shape[1] != 3 or not np.all(np.isfinite(clear)):
        raise ValueError(
            f"`clear_of` has shape {clear.shape}, but must have a row (angle, x, y), all "
            "finite, for each pose."
        )
    powers = monomials(order, coordinates, symmetry=symmetry)
    base = _base(trials, base, coordinates, scale)
    places = [trials.poses, clear]
    if held_out is not None:
        places.append(held_out.poses)
    at_trials, at_clear, *at_others = _terms(places, powers, base)
    free = np.full(len(powers), denominator == "free")
    if set(base.powers) <= set(powers):
        # were all of the base free, nothing over nothing would meet every equation
        free[_largest(base, powers, at_trials)] = False
    rows, right = _equations(trials, at_trials, free)
    solved = _solved(rows, right, free, [at_trials, at_clear], ridge, even)
    parts = solved.above, solved.below
    errors = None
    if held_out is not None:
        errors = compared(held_out, *at_others[0].quotient(*parts))
    ratios = [terms.ratio(parts[1]) for terms in (at_trials, at_clear, *at_others)]
    fit = RationalFit(
        energy=Rational(
            Polynomial(parts[0], powers, coordinates, base.scale),
            _joined(base, parts[1], powers),
        ),
        training=compared(trials, *at_trials.quotient(*parts)),
        held_out=errors,
        equations=len(rows),
        terms=rows.shape[1],
        rank=solved.rank,
        condition=solved.condition,
        ridge=solved.ridge,
        lowest=float(min(map(np.min, ratios))),
        highest=float(max(map(np.max, ratios))),
    )
    if fit.warning:
        warnings.warn(fit.warning, stacklevel=2)
    return fit


class _Solved(NamedTuple):
    """The numerator, what is added to the base of the denominator, and how they came."""

    above: np.ndarray
    below: np.ndarray
    rank: int
    condition: float
    ridge: float


def _solved(
    rows: np.ndarray,
    right: np.ndarray,
    free: np.ndarray,
    kept: "list[_Terms]",
    ridge: float,
    even: bool,
) -> _Solved:
    """The coefficients, by the least ridge that keeps the denominator up.

    Args:
        rows: what a unit of each coefficient adds to each number.
        right: the numbers.
        free: which terms the denominator may add to its base.
        kept: at the trials, and where else there must be no pole.
        ridge: the first that is tried; zero is the last, too.
        even: as for `least`.
    """
    terms = len(free)
    trials, clear = kept
    drawn = (clear.energies / clear.base[:, None])[:, free]
    drawn = np.pad(drawn, ((0, 0), (terms, 0)))
    drawn *= np.sqrt(len(trials.base) / len(clear.base))
    if not np.any(free):
        ridge = 0.0
    while True:
        fixed = ridge * drawn if ridge else drawn[:0]
        equations = np.concatenate([rows, fixed])
        numbers = np.concatenate([right, np.zeros(len(fixed))])
        coefficients, rank, condition = least(equations, numbers, even)
        below = np.zeros(terms)
        below[free] = coefficients[terms:]
        lowest = min(np.min(some.ratio(below)) for some in kept)
        if ridge == 0 or not lowest <= _LOWEST:
            return _Solved(coefficients[:terms], below, rank, condition, float(ridge))
        ridge *= 3.0


class _Terms(NamedTuple):
    """Terms, and the base of the denominator, at many poses: wrenches and values."""

    wrenches: Float[np.ndarray, "poses 3 terms"]
    energies: Float[np.ndarray, "poses terms"]
    base_wrenches: Float[np.ndarray, "poses 3"]
    base: Float[np.ndarray, " poses"]

    def ratio(self, below: np.ndarray) -> np.ndarray:
        """The denominator over its base."""
        return 1 + self.energies @ below / self.base

    def quotient(
        self, above: np.ndarray, below: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The wrench and the energy of a quotient."""
        with np.errstate(all="ignore"):  # at a pole
            denominator = self.base + self.energies @ below
            energies = self.energies @ above / denominator
            slope = self.base_wrenches + self.wrenches @ below
            gap = self.wrenches @ above - energies[:, None] * slope
            return gap / denominator[:, None], energies


def _terms(places: list[Array], powers: Powers, base: Polynomial) -> list[_Terms]:
    poses = jnp.concatenate(places)

    def at(powers: Powers) -> tuple[np.ndarray, np.ndarray]:
        wrenches, values = columns(poses, base.scale, powers, base.coordinates)
        return np.asarray(wrenches), np.asarray(values)

    weights = np.asarray(base.coefficients)
    slopes, heights = (values @ weights for values in at(base.powers))
    if not np.all(heights > 0):
        row = int(np.argmin(heights))
        raise ValueError(
            f"`base` is {heights[row]:g} at the pose {np.asarray(poses[row])}, but must "
            "be positive at all trials and poses: take another, or leave this pose out."
        )
    ends = np.cumsum([len(some) for some in places])[:-1]
    split = (np.split(values, ends) for values in (*at(powers), slopes, heights))
    return [_Terms(*parts) for parts in zip(*split, strict=True)]


def _base(
    trials: Trials,
    given: Polynomial | None,
    coordinates: Coordinates,
    scale: float | None,
) -> Polynomial:
    """The base of the denominator, of translations in parts of the scale."""
    if given is None:
        one = (0,) * len(VARIABLES[coordinates])
        return Polynomial([1.0], [one], coordinates, scale or trials.reach)
    if given.coordinates != coordinates:
        raise ValueError(
            f"`base` is a polynomial of the {given.coordinates}, but must be one of the "
            f"{coordinates}, as `coordinates` are."
        )
    if coordinates == "twistor" and any(row[0] > 1 for row in given.powers):
        raise ValueError("`base` has sigma^2: write it as 1 - xi^2.")
    if scale is None:
        return given
    longer = np.array(
        [(scale / float(given.scale)) ** sum(row[-2:]) for row in given.powers]
    )
    coefficients = np.asarray(given.coefficients) * longer
    return Polynomial(coefficients, given.powers, coordinates, scale)


def _largest(base: Polynomial, powers: Powers, at_trials: _Terms) -> int:
    """Which of the terms is the largest of the base, over the trials."""
    places = [powers.index(row) for row in base.powers]
    parts = at_trials.energies[:, places] * np.asarray(base.coefficients)
    return places[int(np.argmax(np.sum((parts / at_trials.base[:, None]) ** 2, axis=0)))]


def _equations(
    trials: Trials, terms: _Terms, free: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What a unit of each coefficient adds to what must equal what; weighted.

    The numerator less the energy times the free part of the denominator equals the energy
    times the base; and so do their changes.
    """
    energies = np.asarray(trials.energies)[:, None]
    weights = 1 / (terms.base[:, None] * np.asarray(trials.energy_deviations)[:, None])
    parts = [terms.energies, -(energies * terms.energies)[:, free]]
    rows = [weights * np.concatenate(parts, axis=1)]
    right = [weights[:, 0] * energies[:, 0] * terms.base]
    if trials.wrenches is not None:
        wrenches = np.asarray(trials.wrenches)
        weights = 1 / (terms.base[:, None] * np.asarray(trials.wrench_deviations))
        changes = wrenches[:, :, None] * terms.energies[:, None]
        changes = changes + energies[:, None] * terms.wrenches
        parts = [terms.wrenches, -changes[:, :, free]]
        block = weights[:, :, None] * np.concatenate(parts, axis=2)
        rows.append(block.reshape(-1, block.shape[2]))
        of_base = wrenches * terms.base[:, None] + energies * terms.base_wrenches
        right.append((weights * of_base).reshape(-1))
    return np.concatenate(rows), np.concatenate(right)


def _joined(base: Polynomial, below: np.ndarray, powers: Powers) -> Polynomial:
    """The base and the free part of the denominator, as one polynomial."""
    coefficients = dict(zip(base.powers, np.asarray(base.coefficients), strict=True))
    for row, coefficient in zip(powers, below, strict=True):
        if coefficient:
            coefficients[row] = coefficients.get(row, 0.0) + coefficient
    values = np.array(list(coefficients.values()))
    return Polynomial(values, tuple(coefficients), base.coordinates, base.scale)
