"""Energies from measurements: linear least squares for the coefficients of polynomials.

Sections 3.6, 4.7 and 7.1 of the dissertation, in the three physical components of the
wrench instead of its four generalised forces, and with an account of what the trials do
and do not tell.
"""

import warnings
from collections.abc import Sequence
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._checks import need_float64, one_of
from .energy import Coordinates
from .leastsquares import solve, Solved
from .monomials import columns, monomials, Powers, resting, Symmetry, VARIABLES
from .polynomial import Polynomial
from .trials import compared, Errors, measured, Trials


class Fit(eqx.Module):
    """An energy fitted to trials, and how far it can be trusted.

    Args:
        energy: fitted to all of the trials.
        training: how far it is from them.
        expected: how far from fresh trials of the same kind: what each trial's error
            would be, were it left out of the fit. Infinite where the fit interpolates.
        held_out: how far from trials that were held back a fit to the others was, or
            nothing, where none were.
        equations: numbers that were measured, less those held back.
        terms: coefficients that were free.
        rank: how many of these the trials tell apart.
        condition: ratio of the largest singular value to the smallest that counts.
        ridge: weight that draws coefficients to zero, as a part of the largest singular
            value's square; chosen for the least expected error.
        covariance: of the coefficients; J^2.
        unseen: combinations of terms of which the trials tell nothing, in words.
        warning: what to beware of, or nothing.
    """

    energy: Polynomial
    training: Errors
    expected: Errors
    held_out: Errors | None
    equations: int
    terms: int
    rank: int
    condition: float
    ridge: float
    covariance: Float[np.ndarray, "terms terms"]
    unseen: tuple[str, ...]
    warning: str | None

    def __repr__(self) -> str:
        energy = self.energy
        lines = [
            f"{energy.coordinates} polynomial of order {energy.order}: {self.terms} free "
            f"coefficients from {self.equations} numbers, rank {self.rank}, condition "
            f"{self.condition:.1e}, ridge {self.ridge:.0e}",
            f"{'rms error':<22}  {'moment (N m)':>20}  {'force 1 (N)':>20}  "
            f"{'force 2 (N)':>20}",
        ]
        kinds = (
            ("training", self.training),
            ("expected of fresh ones", self.expected),
            ("held out", self.held_out),
        )
        for name, errors in kinds:
            if errors is not None:
                cells = [
                    f"{f'{size:.3g} ({100 * share:.2g} %)':>20}"
                    for size, share in zip(errors.wrench, errors.relative, strict=True)
                ]
                lines.append(f"{name:<22}  {'  '.join(cells)}")
        if self.unseen:
            lines.append(f"unseen: {'; '.join(self.unseen)}")
        if self.warning:
            lines.append(f"warning: {self.warning}")
        return "\n".join(lines)


def fit_energy(
    trials: Trials,
    order: int | None = None,
    *,
    coordinates: Coordinates = "twistor",
    symmetry: Literal["leaf"] | Sequence[Symmetry] = (),
    redundant: bool = False,
    rest: Literal["stable", "unstressed", "free"] = "stable",
    ridge: float | None = None,
    scale: float | None = None,
    hold_out: float = 0.0,
    seed: int = 0,
) -> Fit:
    """A polynomial energy from trials, and what it can be trusted with.

    Args:
        trials: measured, or computed by finite elements.
        order: of the polynomial, by default that of the least expected error.
        coordinates: "twistor" or "twist".
        symmetry: of the hinge, as for `monomials`: the more it has, the fewer trials are
            needed.
        redundant: with the powers of sigma above the first, as the dissertation has them.
        rest: what is required of the hinge at rest: that it bears no wrench there
            ("unstressed"), and has a positive stiffness besides ("stable"), or nothing.
        ridge: weight that draws coefficients to zero, as a part of the largest singular
            value's square; by default that of the least expected error.
        scale: the length in parts of which translations are raised to powers, by default
            the largest there is; m.
        hold_out: the part of the trials that are held back to check the fit to the
            others; the energy itself is fitted to all.
        seed: of the choice of these.

    Raises:
        ValueError: double precision is off; there are too few trials; a setting makes no
            sense.

    Source:
        Sections 4.7 and 7.1 of the dissertation. The expected error: Allen, The
        relationship between variable selection and data augmentation and a method for
        prediction, Technometrics 16, 1974.

    Example:
        >>> from twistorjax import Quadratic
        >>> poses = jax.random.normal(jax.random.key(0), (20, 3)) * 0.1
        >>> spring = Quadratic(jnp.diag(jnp.array([2.0, 30.0, 9.0])))
        >>> trials = Trials(poses, wrenches=jax.vmap(spring.wrench)(poses))
        >>> fit = fit_energy(trials, order=2, symmetry="leaf")
        >>> jnp.diag(fit.energy.tangent_stiffness())
        Array([ 2., 30.,  9.], dtype=float64)
    """
    need_float64(trials.poses)
    one_of("`rest`", rest, ("stable", "unstressed", "free"))
    if not 0 <= hold_out < 1:
        raise ValueError(
            f"`hold_out` is {hold_out!r}, but must be a part of the trials: from 0 to "
            "below 1."
        )
    if ridge is not None and not 0 <= ridge < np.inf:
        raise ValueError(f"`ridge` is {ridge!r}, but must be finite and not negative.")
    settings = _Settings(coordinates, rest, redundant, symmetry, ridge, scale)
    orders = (order,) if order is not None else range(2, 13)
    best = _best(trials, orders, settings)
    held_out = None
    if hold_out:
        count = max(1, round(hold_out * len(trials)))
        if count >= len(trials):
            raise ValueError(
                f"There are {len(trials)} trials: too few to hold {hold_out:g} of them "
                "back."
            )
        mixed = np.random.default_rng(seed).permutation(len(trials))
        back, others = trials[np.sort(mixed[:count])], trials[np.sort(mixed[count:])]
        held_out = _compared(_best(others, (best.order,), settings).energy, back)
    fit = best.told(trials, held_out)
    if fit.warning:
        warnings.warn(fit.warning, stacklevel=2)
    return fit


class _Settings(NamedTuple):
    coordinates: Coordinates
    rest: str
    redundant: bool
    symmetry: Literal["leaf"] | Sequence[Symmetry]
    ridge: float | None
    scale: float | None


class _Candidate(NamedTuple):
    order: int
    energy: Polynomial
    solved: Solved

    @property
    def interpolates(self) -> bool:
        solved = self.solved
        return solved.rank >= solved.residual.size and solved.ridge == 0

    def told(self, trials: Trials, held_out: Errors | None) -> Fit:
        solved = self.solved
        equations = solved.residual.size
        over = max(1, equations - solved.rank)
        variance = np.sum(solved.residual**2) / over
        warning = None
        if self.interpolates:
            warning = (
                f"the fit interpolates: {solved.free} coefficients for {equations} "
                "numbers. That it meets the trials says nothing of others. Take a lower "
                "order, more symmetry, or more trials."
            )
        names = VARIABLES[self.energy.coordinates]
        return Fit(
            energy=self.energy,
            training=_compared(self.energy, trials),
            expected=measured(trials, solved.left_out),
            held_out=held_out,
            equations=equations,
            terms=solved.free,
            rank=solved.rank,
            condition=solved.condition,
            ridge=solved.ridge,
            covariance=variance * solved.spread,
            unseen=tuple(
                _words(direction, self.energy.powers, names)
                for direction in solved.unseen.T[:5]
            ),
            warning=warning,
        )


def _best(trials: Trials, orders: Sequence[int], settings: _Settings) -> _Candidate:
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
        measured = 3 * (trials.wrenches is not None) + (trials.energies is not None)
        equations = measured * len(trials)
        if len(orders) > 1 and candidates:
            if len(powers) > 0.8 * equations:
                break
            if powers == candidates[-1].energy.powers:  # of even order alone
                continue
        candidates.append(_candidate(trials, order, powers, settings))
    scores = [np.mean(candidate.solved.left_out**2) for candidate in candidates]
    return candidates[int(np.nanargmin(np.where(np.isfinite(scores), scores, 1e300)))]


def _candidate(
    trials: Trials, order: int, powers: Powers, settings: _Settings
) -> _Candidate:
    lengths = np.linalg.norm(np.asarray(trials.poses[:, 1:]), axis=1)
    scale = settings.scale or float(lengths.max()) or 1.0
    rows, right = _equations(trials, powers, settings.coordinates, scale)
    conditions, values = np.zeros((0, len(powers))), np.zeros(0)
    slopes = np.zeros((3, 3, len(powers)))
    if settings.rest != "free":
        conditions, slopes = _at_rest(powers, settings.coordinates, scale)
        values = np.zeros(3)
    solved = solve(rows, right, conditions, values, settings.ridge)
    if settings.rest == "stable":
        stiffness = np.einsum("ijk,k->ij", slopes, solved.coefficients)
        mended = _positive(stiffness)
        if mended is not None:
            upper = np.triu_indices(3)
            conditions = np.concatenate([conditions, slopes[upper]])
            values = np.concatenate([values, mended[upper]])
            solved = solve(rows, right, conditions, values, settings.ridge)
    energy = Polynomial(solved.coefficients, powers, settings.coordinates, scale)
    return _Candidate(order, energy, solved)


def _positive(stiffness: np.ndarray) -> np.ndarray | None:
    """The nearest matrix without a negative eigenvalue, unless this has none."""
    size = np.sqrt(np.abs(np.diagonal(stiffness)))
    size = np.where(size > 0, size, 1.0)
    scaled = stiffness / np.outer(size, size)
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2)
    if values[0] > 0:
        return None
    values = np.maximum(values, 1e-6 * max(values[-1], 1e-300))
    return (vectors * values) @ vectors.T * np.outer(size, size)


def _equations(
    trials: Trials, powers: Powers, coordinates: Coordinates, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """What a unit of each coefficient adds to what was measured, and that; weighted.

    A block for each trial, a row in it for each number.
    """
    wrenches, energies = map(
        np.asarray, columns(trials.poses, jnp.asarray(scale), powers, coordinates)
    )
    rows, right = [], []
    if trials.wrenches is not None:
        deviations = np.asarray(trials.wrench_deviations)
        rows.append(wrenches / deviations[:, :, None])
        right.append(np.asarray(trials.wrenches) / deviations)
    if trials.energies is not None:
        deviations = np.asarray(trials.energy_deviations)[:, None]
        rows.append(((energies - resting(powers)) / deviations)[:, None])
        right.append(np.asarray(trials.energies)[:, None] / deviations)
    return np.concatenate(rows, axis=1), np.concatenate(right, axis=1)


def _at_rest(
    powers: Powers, coordinates: Coordinates, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """Wrench and stiffness at rest, by the coefficients."""

    def wrench(step: Array) -> Array:
        return columns(step[None], jnp.asarray(scale), powers, coordinates)[0][0]

    rest = jnp.zeros(3)
    slopes = jax.jacfwd(wrench)(rest)
    return np.asarray(wrench(rest)), np.moveaxis(np.asarray(slopes), 2, 1)


def _words(direction: np.ndarray, powers: Powers, names: Sequence[str]) -> str:
    """A combination of terms, the largest three."""
    share = direction / np.abs(direction).max()
    most = np.argsort(-np.abs(share), kind="stable")[:3]
    parts = []
    for term in most:
        if abs(share[term]) > 0.1:
            factors = [
                name if power == 1 else f"{name}^{power}"
                for name, power in zip(names, powers[term], strict=True)
                if power
            ]
            parts.append(f"{share[term]:+.2g} {' '.join(factors) or '1'}")
    return " ".join(parts) + (" ..." if np.sum(np.abs(share) > 0.1) > 3 else "")


def _compared(energy: Polynomial, trials: Trials) -> Errors:
    """How far an energy is from trials."""
    wrenches, energies = map(
        np.asarray,
        columns(trials.poses, energy.scale, energy.powers, energy.coordinates),
    )
    coefficients = np.asarray(energy.coefficients)
    above = energies - resting(energy.powers)
    return compared(trials, wrenches @ coefficients, above @ coefficients)
