"""What a fit to trials tells: the energy, and how far it can be trusted."""

from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..mixed import MixedEnergy
from ..monomials import Powers
from ..polynomial import Polynomial
from ..strains import Coordinates
from ..validity import WithValidityRange
from .trials import Errors


class EnergyFit(eqx.Module):
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
        turn: the largest of the trials; rad.
        force: the largest of the trials; N. NaN where none was measured.
    """

    energy: Polynomial | MixedEnergy
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
    turn: float
    force: float

    @property
    def with_validity_range(self) -> WithValidityRange:
        """The energy as a hinge that is refused beyond the trials, with its error.

        Raises:
            ValueError: the trials have no wrenches, or the fit interpolates them.
        """
        if not np.all(np.isfinite(self.expected.relative)):
            raise ValueError(
                "This fit cannot be certified: it foretells nothing of wrenches at other "
                "trials. It needs some with wrenches, and more of them than it has "
                "coefficients."
            )
        return WithValidityRange(
            self.energy, self.turn, self.force, self.expected.relative
        )

    def __repr__(self) -> str:
        energy = self.energy
        lines = [
            f"{variables_of(energy)} polynomial of order {energy.order}: {self.terms} "
            f"free coefficients from {self.equations} numbers, rank {self.rank}, "
            f"condition {self.condition:.1e}, ridge {self.ridge:.0e}",
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


def variables_of(energy: Polynomial | MixedEnergy) -> Coordinates | Literal["tension"]:
    """The variables of which it is a polynomial."""
    return "tension" if isinstance(energy, MixedEnergy) else energy.coordinates


def interpolation(terms: int, equations: int) -> str:
    """What to beware of where there are coefficients for all numbers."""
    return (
        f"the fit interpolates: {terms} coefficients for {equations} numbers. That it "
        "meets the trials says nothing of others. Take a lower order, more symmetry, or "
        "more trials."
    )


def in_words(direction: np.ndarray, powers: Powers, names: Sequence[str]) -> str:
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
