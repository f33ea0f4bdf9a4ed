"""Fit of rational energies to trials, for energies with singularities.

Section 7.3 of the dissertation. Here a ridge keeps the denominator positive, and the
result reports the range of the denominator.
"""

from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike, Float
from typing_extensions import TypeAliasType

from ..._utils.validation import require_array, require_choice, require_float64, warn
from ..monomials import monomials, Symmetries
from ..polynomial import Polynomial, Rational
from ..strains import Coordinates
from .rational_equations import (
    add_to_base,
    evaluate_terms,
    largest_base_term,
    rational_equations,
    require_base,
    solve_rational,
)
from .report import interpolation_warning
from .trials import Errors, errors_of_predictions, Trials


class RationalFit(eqx.Module):
    """Rational energy fitted to trials, with estimates of its error.

    Args:
        energy: The energy.
        training: Errors at the trials of the fit.
        held_out: Errors at other trials, or `None` if there are none.
        value_count: Number of measured values.
        terms: Number of free coefficients in numerator and denominator.
        rank: Number of coefficients, or combinations of them, that the trials and the
            ridge determine.
        condition: Ratio of the largest singular value to the smallest significant one.
        ridge: Ridge parameter that was used.
        smallest_ratio: Smallest ratio of the denominator to its base at all given poses,
            including those of the held-out trials.
        largest_ratio: Largest of these ratios.
    """

    energy: Rational
    training: Errors
    held_out: Errors | None
    value_count: int
    terms: int
    rank: int
    condition: float
    ridge: float
    smallest_ratio: float
    largest_ratio: float

    @property
    def has_singularities(self) -> bool:
        """Whether the denominator changes its sign between the given poses."""
        return self.smallest_ratio * self.largest_ratio <= 0

    @property
    def warning(self) -> str | None:
        """Warning about the fit, or `None`."""
        texts = []
        if self.ridge == 0 and self.rank >= self.value_count:
            texts.append(interpolation_warning(self.terms, self.value_count))
        if self.has_singularities:
            texts.append(
                "the denominator changes sign, so the energy has singularities between "
                "the given poses. Use a larger `ridge`, or `denominator='base'`."
            )
        return " ".join(texts) or None

    def __repr__(self) -> str:
        columns = ("error", "energy, rms", "largest", "moment, rms", "force 1", "force 2")
        lines = [
            f"rational energy: {self.terms} free coefficients from {self.value_count} "
            f"measured values, rank {self.rank}, condition {self.condition:.1e}, ridge "
            f"{self.ridge:.0e}",
            f"denominator over its base: {self.smallest_ratio:.3g} to "
            f"{self.largest_ratio:.3g}",
            "  ".join(f"{column:>14}" for column in columns),
        ]
        for name, errors in (("training", self.training), ("held out", self.held_out)):
            if errors is not None:
                values = (errors.rms_energy, errors.largest_energy, *errors.rms_wrench)
                cells = [f"{name:>14}", *(f"{value:>14.3g}" for value in values)]
                lines.append("  ".join(cells))
        if self.warning:
            lines.append(f"warning: {self.warning}")
        return "\n".join(lines)


# A row (angle, x, y) for each pose; rad, m, m
RegularPoses = TypeAliasType(
    "RegularPoses", Float[ArrayLike, "poses 3"] | Sequence[Sequence[ArrayLike]]
)


def fit_rational(
    trials: Trials,
    order: int,
    *,
    coordinates: Coordinates = "twistor",
    symmetry: Symmetries = (),
    denominator: Literal["free", "base"] = "free",
    base: Polynomial | None = None,
    scale: float | None = None,
    ridge: float = 1e-4,
    regular_poses: RegularPoses | None = None,
    normalize_columns: bool = True,
    held_out: Trials | None = None,
) -> RationalFit:
    """Fit a quotient of two polynomials to energies and, if measured, wrenches.

    The numerator minus the product of measured energy and denominator must vanish, and so
    must its derivatives along displacements that are fixed to body B. These equations are
    linear in the coefficients of both polynomials. Each equation is divided by the base
    of the denominator. Energies are absolute values; they are not counted from the
    reference configuration, because the energy may be singular there.

    With `denominator="free"` the denominator is the sum of its base and of a polynomial
    with the terms of the numerator. This has the smallest error. The ridge is increased
    until the denominator exceeds a tenth of its base at all trials and at all
    `regular_poses`. The energy has no singularity at these poses, but it may have
    singularities between them.

    With `denominator="base"` the denominator is the base. There is no singularity where
    the base is not zero. For example, a power of the distance `x1^2 + x2^2` has a zero in
    the reference configuration only. Use it for an energy that is evaluated outside of
    the trials. It needs a higher order for the same error.

    Args:
        trials: Trials with energies.
        order: Order of both polynomials.
        coordinates: "twistor" or "twist".
        symmetry: Symmetries of the hinge; see `monomials`.
        denominator: "free" or "base".
        base: Base of the denominator, by default the constant one. It is dimensionless
            and must be positive at all poses. A suitable base grows with the distance
            from the singularities; for charges it is a power of their distance.
        scale: Length by which the translations are divided, by default that of the base,
            or else the largest translation; m.
        ridge: Weight of the free part of the denominator. Each of the `regular_poses`
            adds the residual `ridge * (free part / base)`. These residuals are multiplied
            by `sqrt(trials / poses)`, so that the numbers of trials and poses do not
            matter. With zero, the denominator may vanish.
        regular_poses: Poses at which the energy must not be singular, by default those of
            the trials. The energy need not be known there; rad, m, m.
        normalize_columns: If the trials do not determine all coefficients, the solution
            with the smallest norm is used. If True, the coefficients in this norm are
            multiplied by the norm of their columns in the matrix of the least-squares
            problem. The dissertation uses False.
        held_out: Other trials, to check the fit.

    Returns:
        The energy with its errors.

    Raises:
        ValueError: Double precision is disabled; there are no energies; the base is not
            positive at a pose, or has other coordinates; an argument is out of its
            limits.

    Source:
        Equations 7.22 to 7.25 of the dissertation. There sigma has all powers, so that
        numerator and denominator may vanish together, because `sigma^2 + xi^2 = 1`. Here
        sigma has the power one at most. If the base consists of the terms of the
        numerator, the coefficient of its largest term is not free.

    Example:
        >>> import jax.numpy as jnp
        >>> from twistorjax.energies import PointCharges
        >>> pair = PointCharges([1.0], [[0.0, 0.0]], [1.0], [[1.0, 0.0]], constant=1.0)
        >>> poses = jnp.array([[0.0, x, 0.0] for x in (1.0, 1.2, 1.5, 1.8)])
        >>> trials = Trials(poses, energies=[pair(pose) for pose in poses])
        >>> fit = fit_rational(trials, order=1, coordinates="twist", ridge=0.0)
        >>> fit.energy(jnp.array([0.0, 4.0, 0.0]))  # 1 / (4 + 1)
        Array(0.2, dtype=float64)
    """
    require_float64(trials.poses)
    require_choice("`denominator`", denominator, ("free", "base"))
    if trials.energies is None:
        raise ValueError(
            "`trials` have wrenches but no energies. A rational energy is fitted to "
            "energies, and optionally to wrenches: give both, or use `fit_energy`."
        )
    if not 0 <= ridge < np.inf:
        raise ValueError(f"`ridge` is {ridge!r}, but must be finite and not negative.")
    if scale is not None and not 0 < scale < np.inf:
        raise ValueError(f"`scale` is {scale!r}, but must be positive and finite; m.")
    regular = trials.poses
    if regular_poses is not None:
        row = "have a row (angle, x, y) for each pose"
        regular = require_array("`regular_poses`", regular_poses, (None, 3), row)
    powers = monomials(order, coordinates, symmetry=symmetry)
    base = require_base(trials, base, coordinates, scale)
    poses = [trials.poses, regular]
    if held_out is not None:
        poses.append(held_out.poses)
    at_trials, at_regular, *at_held_out = evaluate_terms(poses, powers, base)
    free = np.full(len(powers), denominator == "free")
    if set(base.powers) <= set(powers):
        # If the whole base were free, zero over zero would solve all equations.
        free[largest_base_term(base, powers, at_trials)] = False
    rows, targets = rational_equations(trials, at_trials, free)
    solution = solve_rational(
        rows, targets, free, at_trials, at_regular, ridge, normalize_columns
    )
    parts = solution.numerator, solution.denominator
    errors = None
    if held_out is not None:
        errors = errors_of_predictions(held_out, *at_held_out[0].quotient(*parts))
    ratios = [
        terms.ratio(solution.denominator)
        for terms in (at_trials, at_regular, *at_held_out)
    ]
    fit = RationalFit(
        energy=Rational(
            Polynomial(solution.numerator, powers, coordinates, base.scale),
            add_to_base(base, solution.denominator, powers),
        ),
        training=errors_of_predictions(trials, *at_trials.quotient(*parts)),
        held_out=errors,
        value_count=len(rows),
        terms=rows.shape[1],
        rank=solution.rank,
        condition=solution.condition,
        ridge=solution.ridge,
        smallest_ratio=float(min(map(np.min, ratios))),
        largest_ratio=float(max(map(np.max, ratios))),
    )
    if fit.warning:
        warn(fit.warning)
    return fit
