"""What a fit to measurements tells: values, how sure they are, and what stays unknown."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._utils.validation import all_concrete
from ..solve.results import result_message, result_names, RESULTS
from .measurement import Measurement
from .objective import Problem
from .optimizer import beyond_rounding


# A combination known to no better than this relative change is not determined
_LOOSE = 1.0
# Correlations above it are told, and standard deviations of outliers
_ALIKE, _FAR = 0.999, 5.0
# Steps of a bounded unknown: exp(-12) of its first distance from the bound
_AT_BOUND = 12.0


class Identification(eqx.Module):
    """Unknowns found from measurements, and how far they can be trusted.

    Standard errors are those of the model's linear map at the estimates, for errors of
    the readings that are normal, independent, and as large as was told.

    Args:
        estimates: in the tree that the design takes.
        place: the steps by which they differ from the start; relative changes, where
            these are small.
        sensitivity: of the readings, in their standard deviations, to steps.
        residuals: of each test: what the model reads less what was read, in standard
            deviations.
        held_out: the same of measurements that took no part.
        loss: half the sum of the squares that were minimised.
        losses: of each restart, the one that was taken among them.
        steps: evaluations of the model.
        result: how it ended; `result_names` gives its name.
        problem: what was solved.
    """

    estimates: Any
    place: Float[Array, "*batch unknowns"]
    sensitivity: Float[Array, "*batch readings unknowns"]
    residuals: tuple[Float[Array, "*batch rows columns"], ...]
    held_out: tuple[Float[Array, "*batch rows columns"], ...]
    loss: Float[Array, "*batch"]
    losses: Float[Array, "*batch restarts"]
    steps: Int[Array, "*batch"]
    result: RESULTS
    problem: Problem

    @property
    def succeeded(self) -> Bool[Array, "*batch"]:
        """Whether the search has settled."""
        return self.result == RESULTS.successful

    @property
    def names(self) -> tuple[str, ...]:
        """Of the unknowns, in the order of `covariance`."""
        return self.problem.unknowns.names

    @property
    def units(self) -> tuple[str, ...]:
        """Of the unknowns."""
        return self.problem.unknowns.units

    @property
    def values(self) -> Float[Array, " unknowns"]:
        """The estimates in a row."""
        return self.problem.unknowns.flat(self.place)

    @property
    def relative_covariance(self) -> Float[Array, "unknowns unknowns"]:
        """Covariance of the steps; infinite where the readings tell nothing.

        Of a robust fit by the scatter of the readings that are not far off.
        """
        _, sizes, directions = jnp.linalg.svd(self.sensitivity, full_matrices=False)
        seen = beyond_rounding(sizes)
        over = jnp.where(seen, 1 / jnp.where(seen, sizes, 1.0), 0.0)
        spread = directions.T * over[None]
        covariance = spread @ spread.T
        if self.problem.robust is not None:
            covariance = self._bent_back(self.problem.robust) * covariance
        share = jnp.sum(jnp.where(seen[:, None], directions, 0.0) ** 2, axis=0)
        unseen = share < 1 - 1e-9
        diagonal = jnp.where(unseen, jnp.inf, jnp.diagonal(covariance))
        return jnp.where(jnp.eye(diagonal.size, dtype=bool), diagonal[None], covariance)

    def _bent_back(self, robust: float) -> Float[Array, ""]:
        """By how much a robust loss widens the covariance (Huber 1981, section 7.6)."""
        rows = jnp.concatenate([table.reshape(-1) for table in self.residuals])
        there = jnp.concatenate(
            [jnp.isfinite(part.values).reshape(-1) for part in self.problem.data]
        )
        count, unknowns = jnp.sum(jnp.where(there, 1.0, 0.0)), float(len(self.names))
        pull = jnp.clip(rows, -robust, robust)
        near = there & (jnp.abs(rows) <= robust)
        within = jnp.sum(jnp.where(near, 1.0, 0.0)) / count
        scatter = jnp.sum(pull**2) / jnp.maximum(count - unknowns, 1.0)
        small = 1 + unknowns / count * (1 - within) / within
        # no better than least squares where there are no outliers
        return jnp.maximum(small**2 * scatter / within**2, 1.0)

    @property
    def covariance(self) -> Float[Array, "unknowns unknowns"]:
        """Of the estimates, in their units; infinite where the readings tell nothing."""
        slopes = self.problem.unknowns.slopes(self.place)
        covariance = self.relative_covariance
        whole = covariance * slopes[:, None] * slopes[None]
        return jnp.where(jnp.isinf(covariance), jnp.inf, whole)

    @property
    def standard_errors(self) -> Any:
        """Of each estimate, in the tree that the design takes."""
        row = jnp.sqrt(jnp.diagonal(self.covariance))
        return self.problem.unknowns.like(row)

    @property
    def correlations(self) -> Float[Array, "unknowns unknowns"]:
        """Of the errors of the estimates."""
        covariance = self.relative_covariance
        size = jnp.sqrt(jnp.diagonal(covariance))
        alike = covariance / (size[:, None] * size[None])
        return jnp.where(jnp.eye(size.size, dtype=bool), 1.0, alike)

    def interval(self, level: float = 0.95) -> tuple[Any, Any]:
        """Between which the true values are; within the bounds of the unknowns.

        Args:
            level: how often such intervals hold the truth.

        Returns:
            The lower ends, and the upper ones, in the tree that the design takes.

        Raises:
            ValueError: the level is not between 0 and 1.
        """
        if not 0 < level < 1:
            raise ValueError(f"`level` is {level}, but must be between 0 and 1: 0.95.")
        deviations = jax.scipy.special.ndtri((1 + level) / 2)
        size = deviations * jnp.sqrt(jnp.diagonal(self.relative_covariance))
        unknowns = self.problem.unknowns
        low, high = (unknowns.flat(self.place + side) for side in (-size, size))
        return unknowns.like(low), unknowns.like(high)

    @property
    def mechanism(self) -> Any:
        """The design at the estimates."""
        return self.problem.design(self.estimates)

    @property
    def readings(self) -> int:
        """How many took part."""
        return _count(self.problem.data)

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Which combinations of unknowns the readings do not determine, in words."""
        if not bool(self.succeeded | (self.result == RESULTS.not_converged)):
            return ()
        sizes, directions = self._singular()
        words = []
        for size, direction in zip(sizes, directions, strict=True):
            if size <= 1e-15 * sizes.max(initial=0.0):
                words.append(f"{self._combined(direction)} changes no reading")
            elif 1 / size > _LOOSE:
                seen = 0.01 * size / np.abs(direction).max()
                words.append(
                    f"{self._combined(direction)} changes the readings by {seen:.1g} "
                    "standard deviations"
                )
        return tuple(words)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to beware of."""
        words = [f"not determined: {text}" for text in self.undetermined]
        ended = str(result_names(self.result))
        if ended != "successful":
            words.append(result_message(ended))
        sizes, _ = self._singular()
        rank = int(np.sum(beyond_rounding(jnp.asarray(sizes))))
        freedom = self.readings - rank
        rms = _rms(self.residuals, self.problem.data)
        if freedom <= 0:
            words.append(
                f"{_many(self.readings, 'reading')} for {_many(rank, 'unknown')}: any "
                "model with as many meets them, so that this one does says nothing for it"
            )
        else:
            size = rms if self.problem.robust is None else self._middle()
            scatter = size * np.sqrt(self.readings / freedom)
            if scatter > 1 + 4 / np.sqrt(2 * freedom):
                words.append(
                    f"residuals are {scatter:.3g} times as large as the deviations told: "
                    "the model is not the mechanism, or the sensors err more. The "
                    "standard errors are too small by as much, at least"
                )
        if self.problem.robust is not None and (far := self._outliers()):
            words.append(f"far off: {', '.join(far)}")
        close = np.triu(np.abs(np.asarray(self.correlations)), 1) > _ALIKE
        close &= not self.undetermined  # which says it already
        for row, column in np.argwhere(close & np.isfinite(close)):
            words.append(
                f"{self.names[row]} and {self.names[column]} are known in combination: "
                f"their errors have the correlation {self.correlations[row, column]:.6f}"
            )
        if self.held_out:
            fresh = _rms(self.held_out, self.problem.held_out)
            if fresh > 2 * max(rms, 1.0):
                words.append(
                    f"held-out readings are missed by {fresh:.3g} standard deviations, "
                    f"those of the fit by {rms:.3g}"
                )
        words += [f"{self.names[k]} runs into its bound" for k in self._at_bounds()]
        losses = np.asarray(self.losses)
        if losses.size > 1:
            met = np.sum(losses <= losses.min() * 1.001 + 1e-9)
            if met < losses.size:
                words.append(
                    f"{losses.size - met} of {losses.size} starts ended at a larger "
                    "residual than the best"
                )
        return tuple(words)

    def _per_step(self) -> Float[Array, " unknowns"]:
        """Steps that change each unknown by its own size."""
        unknowns = self.problem.unknowns
        slopes = jnp.abs(unknowns.slopes(self.place))
        return unknowns.sizes(self.place) / jnp.where(slopes > 0, slopes, 1.0)

    def _at_bounds(self) -> list[int]:
        bounded = self.problem.unknowns.bounded
        return [
            k
            for k, (name, near) in enumerate(
                zip(self.names, np.asarray(self.place), strict=True)
            )
            if name in bounded and abs(near) > _AT_BOUND
        ]

    def _middle(self) -> float:
        """The size of residuals by their median, which outliers do not move."""
        sizes = [
            np.abs(np.asarray(table))[np.isfinite(np.asarray(part.values))]
            for table, part in zip(self.residuals, self.problem.data, strict=True)
        ]
        return float(1.4826 * np.median(np.concatenate(sizes)))

    def _outliers(self) -> list[str]:
        """The readings that are furthest off, if they are, at most five."""
        told = [
            (abs(value), f"{part.test.columns[column]} in row {row} by {value:.3g}")
            for table, part in zip(self.residuals, self.problem.data, strict=True)
            for (row, column), value in np.ndenumerate(np.asarray(table))
            if abs(value) > _FAR
        ]
        return [text for _, text in sorted(told, reverse=True)[:5]]

    def _singular(self) -> tuple[np.ndarray, np.ndarray]:
        """Sizes of the sensitivity, all of them, and their combinations of unknowns."""
        # of what is at a bound, steps say nothing
        matrix = np.asarray(self.sensitivity) * np.asarray(self._per_step())[None]
        matrix = np.delete(matrix, self._at_bounds(), axis=1)
        count = matrix.shape[1]
        _, sizes, directions = np.linalg.svd(matrix, full_matrices=True)
        return np.pad(sizes, (0, count - sizes.size)), directions

    def _combined(self, direction: np.ndarray) -> str:
        """A combination of changes, in words: the largest a rise by one per cent."""
        share = direction / direction[np.argmax(np.abs(direction))]
        free = [name for k, name in enumerate(self.names) if k not in self._at_bounds()]
        parts = []
        for entry in np.argsort(-np.abs(share), kind="stable"):
            if abs(share[entry]) < 0.05:
                break
            parts.append(f"{free[entry]} by {share[entry]:+.2g} %")
        shown = parts if len(parts) <= 4 else [*parts[:4], f"{len(parts) - 4} more"]
        return f"to change {', '.join(shown)}" + (" together" if len(parts) > 1 else "")

    def __repr__(self) -> str:
        ended = result_names(self.result)
        leaves = [self.place, self.sensitivity, *self.residuals]
        if ended is None or ended.shape or all_concrete(leaves) is None:
            return eqx.tree_pformat(self)
        rms = _rms(self.residuals, self.problem.data)
        lines = [
            f"{ended}: {_many(len(self.names), 'unknown')} from "
            f"{_many(self.readings, 'reading')} in "
            f"{_many(int(self.steps), 'evaluation')}; residual {rms:.3g} standard "
            "deviations"
        ]
        if self.held_out:
            fresh = _rms(self.held_out, self.problem.held_out)
            lines[0] += f", {fresh:.3g} held out"
        wide = max(map(len, (*self.names, "unknown")))
        lines.append(f"{'unknown':<{wide}}  {'estimate':>15}  {'± standard error':>18}")
        size = np.sqrt(np.diagonal(np.asarray(self.covariance)))
        relative = np.sqrt(np.diagonal(np.asarray(self.relative_covariance)))
        relative = relative / np.asarray(self._per_step())
        rows = zip(
            self.names, np.asarray(self.values), size, relative, self.units, strict=True
        )
        for name, value, error, part, unit in rows:
            told = f"± {error:.2g} {unit}".rstrip()
            digits = 3
            if part > _LOOSE:
                told = f"{unit}  not determined".strip()
            elif error > 0 and value != 0:  # two of the error's
                digits = min(10, max(3, 2 - int(np.floor(np.log10(error / abs(value))))))
            lines.append(f"{name:<{wide}}  {value:>15.{digits}g}  {told}")
        lines += [f"warning: {text}" for text in self.warnings]
        return "\n".join(lines)


def _count(data: Sequence[Measurement]) -> int:
    """How many readings there are."""
    return int(sum(np.sum(np.isfinite(np.asarray(part.values))) for part in data))


def _rms(tables: Sequence[Array], data: Sequence[Measurement]) -> float:
    """Root mean square of residuals; they are zero where nothing was read."""
    squares = sum(float(np.sum(np.square(table))) for table in tables)
    return float(np.sqrt(squares / max(1, _count(data))))


def _many(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
