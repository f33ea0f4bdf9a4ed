"""Energies from measurements: linear least squares for the coefficients of polynomials.

Sections 3.6, 4.7 and 7.1 of the dissertation, in the three physical components of the
wrench instead of its four generalised forces, and with an account of what the trials do
and do not tell.
"""

import warnings
from collections.abc import Sequence
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.validation import require_choice, require_float64
from ..mixed import MixedEnergy
from ..monomials import columns, monomials, Powers, resting, Symmetry, VARIABLES
from ..polynomial import Polynomial
from ..strains import Coordinates
from . import mixed
from .least_squares import solve, Solved
from .report import EnergyFit, in_words, interpolation, variables_of
from .trials import compared, Errors, measured, Trials


def fit_energy(
    trials: Trials,
    order: int | None = None,
    *,
    coordinates: Coordinates | Literal["tension"] = "twistor",
    symmetry: Symmetry | Sequence[Symmetry] = (),
    redundant: bool = False,
    reference: Literal["stable", "unstressed", "free"] = "stable",
    ridge: float | None = None,
    scale: float | None = None,
    hold_out: float = 0.0,
    seed: int = 0,
) -> EnergyFit:
    """A polynomial energy from trials, and what it can be trusted with.

    Args:
        trials: measured, or computed by finite elements.
        order: of the polynomial, by default that of the least expected error.
        coordinates: "twistor" or "twist"; or "tension", for a `MixedEnergy` energy of turn,
            translation across and tension: for flexures, which are stiff along axis 1, it
            is by far the best.
        symmetry: of the hinge, as for `monomials`: the more it has, the fewer trials are
            needed.
        redundant: with the powers of sigma above the first, as the dissertation has them.
        reference: what is required of the hinge at rest: that it bears no wrench there
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
    require_float64(trials.poses)
    for values in jax.tree.leaves(trials):
        if np.max(np.abs(values)) > 1e100:  # its powers would not be numbers
            raise ValueError(
                f"`trials` have a value of {np.max(np.abs(values)):g}, but a fit needs "
                "values of at most 1e100."
            )
    require_choice("`reference`", reference, ("stable", "unstressed", "free"))
    if not 0 <= hold_out < 1:
        raise ValueError(
            f"`hold_out` is {hold_out!r}, but must be a part of the trials: from 0 to "
            "below 1."
        )
    if ridge is not None and not 0 <= ridge < np.inf:
        raise ValueError(f"`ridge` is {ridge!r}, but must be finite and not negative.")
    settings = _Settings(coordinates, reference, redundant, symmetry, ridge, scale)
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
        drawn = np.random.default_rng(seed).permutation(len(trials))
        back, others = trials[np.sort(drawn[:count])], trials[np.sort(drawn[count:])]
        held_out = _compared(_best(others, (best.order,), settings).energy, back)
    fit = best.told(trials, held_out)
    if np.any(np.isnan(fit.training.wrench)) and trials.wrenches is not None:
        raise ValueError(
            "These trials are not those of a flexure that gives along axis 1 as it is "
            "pulled: no tension belongs to some of them in the energy that fits best. "
            "Take the coordinates 'twistor' or 'twist', or another order."
        )
    if fit.warning:
        warnings.warn(fit.warning, stacklevel=2)
    return fit


class _Settings(NamedTuple):
    coordinates: Coordinates | Literal["tension"]
    reference: str
    redundant: bool
    symmetry: Symmetry | Sequence[Symmetry]
    ridge: float | None
    scale: float | None


class _Candidate(NamedTuple):
    order: int
    energy: Polynomial | MixedEnergy
    solved: Solved

    @property
    def interpolates(self) -> bool:
        solved = self.solved
        return solved.rank >= solved.residual.size and solved.ridge == 0

    def told(self, trials: Trials, held_out: Errors | None) -> EnergyFit:
        solved = self.solved
        equations = solved.residual.size
        over = max(1, equations - solved.rank)
        variance = np.sum(solved.residual**2) / over
        warning = None
        if self.interpolates:
            warning = interpolation(solved.free, equations)
        names = VARIABLES[variables_of(self.energy)]
        forces = np.full((1, 2), np.nan)
        if trials.wrenches is not None:
            forces = np.asarray(trials.wrenches[:, 1:])
        return EnergyFit(
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
                in_words(direction, self.energy.powers, names)
                for direction in solved.unseen.T[:5]
            ),
            warning=warning,
            turn=float(np.abs(trials.poses[:, 0]).max()),
            force=float(np.linalg.norm(forces, axis=1).max()),
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
        each = 3 * (trials.wrenches is not None) + (trials.energies is not None)
        equations = each * len(trials)
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
    if settings.coordinates == "tension":
        return _by_tension(trials, order, powers, settings)
    scale = settings.scale or trials.reach
    rows, right = _equations(trials, powers, settings.coordinates, scale)
    conditions, slopes = np.zeros((0, len(powers))), np.zeros((3, 3, len(powers)))
    if settings.reference != "free":
        conditions, slopes = _at_rest(powers, settings.coordinates, scale)
    solved = _solved(rows, right, conditions, slopes, settings)
    energy = Polynomial(solved.coefficients, powers, settings.coordinates, scale)
    return _Candidate(order, energy, solved)


def _by_tension(
    trials: Trials, order: int, powers: Powers, settings: _Settings
) -> _Candidate:
    """By turn, translation across and tension.

    Linear but for what an error of the length is as one of the wrench: that follows from
    a first fit, and from another.
    """
    if trials.wrenches is None:
        raise ValueError(
            "`trials` have energies alone, but a fit by tension needs the wrench of "
            "each: the tension is a part of it. Take 'twistor' or 'twist'."
        )
    if settings.reference != "free":
        powers = tuple(row for row in powers if sum(row) > 1)
    twists, turning = map(np.asarray, jax.vmap(mixed.by_twist)(trials.poses))
    wrenches = np.asarray(trials.wrenches)
    pulls = np.einsum("sij,sj->si", turning, wrenches)
    tensions = pulls[:, 1]
    length = settings.scale or _largest(twists[:, 2])
    force = _largest(tensions)
    adds = mixed.terms(powers, jnp.asarray(twists), jnp.asarray(tensions), length, force)
    adds = jax.tree.map(np.asarray, adds)
    back = np.linalg.inv(turning) / np.asarray(trials.wrench_deviations)[:, :, None]
    at_rest = _curvature_at_rest(powers, length, force)

    def fitted(give: np.ndarray, leaning: Sequence[np.ndarray]) -> Solved:
        # the error of the tension at a pose, and through it those of the others
        rows = np.stack([adds.moment, -adds.length / give[:, None], adds.shear], axis=1)
        right = np.stack([pulls[:, 0], -twists[:, 1] / give, pulls[:, 2]], axis=1)
        for place, lean in zip((0, 2), leaning, strict=True):
            rows[:, place] += lean[:, None] * rows[:, 1]
            right[:, place] += lean * right[:, 1]
        rows, right = back @ rows, np.einsum("sij,sj->si", back, right)
        if trials.energies is not None:
            deviations = np.asarray(trials.energy_deviations)[:, None]
            above = np.asarray(trials.energies) - tensions * twists[:, 1]
            rows = np.concatenate([rows, (adds.energy / deviations)[:, None]], axis=1)
            right = np.concatenate([right, above[:, None] / deviations], axis=1)
        none = np.zeros((0, len(powers)))
        return _solved(rows, right, none, at_rest, settings)

    first = np.std(twists[:, 1]) / (np.sqrt(np.mean(tensions**2)) or 1.0) or 1.0
    still = np.zeros(len(trials))
    solved = fitted(still + first, (still, still))
    for _ in range(3):
        give = adds.give @ solved.coefficients
        give = np.maximum(give, 1e-3 * np.median(np.abs(give)))
        solved = fitted(give, [lean @ solved.coefficients for lean in adds.leaning])
    energy = MixedEnergy(solved.coefficients, powers, length=length, force=force)
    return _Candidate(order, energy, solved)


def _largest(values: np.ndarray) -> float:
    """The largest absolute value; one, where its square is too small for a number."""
    largest = float(np.abs(values).max())
    return largest if largest > 1e-150 else 1.0


def _curvature_at_rest(powers: Powers, length: float, force: float) -> np.ndarray:
    """What must be positive definite of W at rest, by the coefficients.

    Its second derivatives by turn and translation across, and less that by tension.
    """
    curvature = np.zeros((3, 3, len(powers)))
    for row, places, value in (
        ((2, 0, 0), [(0, 0)], 2.0),
        ((1, 1, 0), [(0, 2), (2, 0)], 1 / length),
        ((0, 2, 0), [(2, 2)], 2 / length**2),
        ((0, 0, 2), [(1, 1)], -2 / force**2),
    ):
        if row in powers:
            for place in places:
                curvature[*place, powers.index(row)] = value
    return curvature


def _solved(
    rows: np.ndarray,
    right: np.ndarray,
    conditions: np.ndarray,
    curvature: np.ndarray,
    settings: _Settings,
) -> Solved:
    """The coefficients, the curvature at rest positive definite where that is asked.

    Args:
        rows: what a unit of each coefficient adds to each number, a block for each trial.
        right: the numbers.
        conditions: what a unit of each adds to what must vanish.
        curvature: what it adds to the stiffness at rest, or what stands for it.
        settings: of the fit.
    """
    values = np.zeros(len(conditions))
    solved = solve(rows, right, conditions, values, settings.ridge)
    if settings.reference != "stable":
        return solved
    mended = _positive(np.einsum("ijk,k->ij", curvature, solved.coefficients))
    if mended is None:
        return solved
    upper = np.triu_indices(3)
    conditions = np.concatenate([conditions, curvature[upper]])
    values = np.concatenate([values, mended[upper]])
    return solve(rows, right, conditions, values, settings.ridge)


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

    reference = jnp.zeros(3)
    slopes = jax.jacfwd(wrench)(reference)
    return np.asarray(wrench(reference)), np.moveaxis(np.asarray(slopes), 2, 1)


def _compared(energy: Polynomial | MixedEnergy, trials: Trials) -> Errors:
    """How far an energy is from trials."""
    if isinstance(energy, MixedEnergy):
        wrenches, energies = map(np.asarray, _of_slender(energy, trials.poses))
        return compared(trials, wrenches, energies)
    wrenches, energies = map(
        np.asarray,
        columns(trials.poses, energy.scale, energy.powers, energy.coordinates),
    )
    coefficients = np.asarray(energy.coefficients)
    above = energies - resting(energy.powers)
    return compared(trials, wrenches @ coefficients, above @ coefficients)


@jax.jit
def _of_slender(
    energy: MixedEnergy, poses: Float[Array, "trials 3"]
) -> tuple[Float[Array, "trials 3"], Float[Array, " trials"]]:
    return jax.vmap(energy.wrench)(poses), jax.vmap(energy)(poses)
