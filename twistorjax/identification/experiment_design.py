"""Optimal design of experiments: ranking of further tests by their information."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._compile.compilation import fast_compile
from .._utils.progress import announced
from .._utils.validation import require_kind
from .experiments.measurement import AbstractTest, map_in_groups
from .report import Identification, undetermined_changes


class Candidate(NamedTuple):
    """Effect of one further test, or of one of its sensors, on the uncertainty.

    Args:
        name: Name of the test, and of the sensor.
        information_gain: Expected information gain in nats. The volume of the confidence
            region is divided by exp(information_gain).
        standard_errors: Standard errors of the parameters after the test, as relative
            changes.
    """

    name: str
    information_gain: float
    standard_errors: Float[np.ndarray, " parameters"]


class ExperimentRanking(eqx.Module):
    """Ranking of further tests.

    Args:
        candidates: Tests, and the single sensors of each test, in descending order of
            their information gain.
        selected: Names of the selected tests, in the order of their selection.
        names: Names of the parameters.
        standard_errors_before: Standard errors of the parameters without a further test,
            as relative changes.
        standard_errors_after: Standard errors of the parameters after all selected tests,
            as relative changes.
        standard_errors_range: Smallest and largest standard errors after all selected
            tests, if the true values lie one prior standard deviation away from the
            estimates along a direction that the measurements so far do not determine.
        undetermined_directions: Descriptions of these directions.
    """

    candidates: tuple[Candidate, ...]
    selected: tuple[str, ...]
    names: tuple[str, ...]
    standard_errors_before: Float[np.ndarray, " parameters"]
    standard_errors_after: Float[np.ndarray, " parameters"]
    standard_errors_range: Float[np.ndarray, "2 parameters"]
    undetermined_directions: tuple[str, ...]

    def __repr__(self) -> str:
        width = max(10, *map(len, self.names))

        def cells(values: np.ndarray) -> str:
            return "  ".join(f"{f'{100 * value:.3g} %':>{width}}" for value in values)

        title, before, after = "standard error after", "no further test", "selected tests"
        titles = title, before, after, *(candidate.name for candidate in self.candidates)
        first = max(map(len, titles))
        head = "  ".join(f"{name:>{width}}" for name in self.names)
        lines = [
            f"{title:<{first}}  {'information (nats)':>18}  {head}",
            f"{before:<{first}}  {'':>18}  {cells(self.standard_errors_before)}",
        ]
        for name, gain, errors in self.candidates:
            lines.append(f"{name:<{first}}  {gain:>18.3g}  {cells(errors)}")
        lines += [
            f"{after:<{first}}  {'':>18}  {cells(self.standard_errors_after)}",
            f"selected: {', '.join(self.selected)}",
        ]
        if self.undetermined_directions:
            smallest, largest = 100 * self.standard_errors_range
            ranges = ", ".join(
                f"{low:.2g} to {high:.2g} % ({name})"
                for name, low, high in zip(self.names, smallest, largest, strict=True)
            )
            lines.append(
                "warning: the measurements so far do not determine all estimates, near "
                "which the predictions hold. At one prior standard deviation from them, "
                f"the standard errors after the selected tests are {ranges}. Rank again "
                "after the first test"
            )
        return "\n".join(lines)


@announced("ranking of experiments")
def rank_experiments(
    identification: Identification,
    candidates: Mapping[str, AbstractTest] | Sequence[AbstractTest],
    *,
    count: int = 1,
    prior_standard_deviation: float = 1.0,
) -> ExperimentRanking:
    """Rank further tests by how much they reduce the uncertainty of the parameters.

    Each test is simulated at the estimates. Its information gain is half the increase of
    the logarithm of the determinant of the Fisher information matrix (D-optimality). If
    the measurements so far leave a direction undetermined, the estimates along it are
    those of the start, and may be far from the true values. The result then has a
    warning, with the standard errors at other points along this direction.

    Args:
        identification: Result of the measurements so far.
        candidates: Possible further tests, as a mapping from names or as a sequence.
        count: Number of tests to select. They are selected one after another: each one
            has the largest information gain in addition to those before.
        prior_standard_deviation: Prior standard deviation of the normalized parameters,
            as a relative change. It makes the determinant of the information positive
            if the measurements so far leave a direction undetermined.

    Returns:
        The tests in descending order of their information gain, and those selected.

    Raises:
        ValueError: There is no candidate; `count` or `prior_standard_deviation` is out of
            its range.

    Source:
        Atkinson and Donev, Optimum Experimental Designs, chapters 9 and 10.

    Example:
        >>> from twistorjax import Body, Hinge, Load, Mechanism, Quadratic
        >>> from twistorjax.identification import BodySensor, identify, Parameter
        >>> from twistorjax.identification import StaticTest
        >>> def spring(k):
        ...     stiffness = jnp.diag(jnp.stack([k["rotation"], k["along"], 10.0]))
        ...     energy = Quadratic(stiffness)
        ...     hinge = Hinge("spring", "wall", "block", energy, at=(0.0, 0.0, 0.0))
        ...     return Mechanism([Body("wall"), Body("block")], [hinge], fixed=["wall"])
        >>> push = Load("block", force=(5.0, 0.0))  # N
        >>> twist = Load("block", moment=0.1)  # N m
        >>> pushed = StaticTest([[push]], [BodySensor("block", "x", 1e-4)])
        >>> twisted = StaticTest([[twist]], [BodySensor("block", "angle", 1e-4)])
        >>> start = {"along": Parameter(80.0), "rotation": Parameter(1.0)}
        >>> result = identify(spring, start, [pushed.measurement([[0.05]])])
        >>> rank_experiments(result, {"push again": pushed, "twist": twisted}).selected
        ('twist',)
    """
    if not isinstance(candidates, Mapping):
        tests = require_kind("candidates", candidates, AbstractTest)
        candidates = {f"{test!r}": test for test in tests}
    if not candidates:
        raise ValueError("`candidates` is empty, but must have at least one test.")
    if not 1 <= count <= len(candidates):
        raise ValueError(
            f"`count` is {count}, but must be between 1 and the number of candidates, "
            f"{len(candidates)}."
        )
    if not prior_standard_deviation > 0:
        raise ValueError(
            f"`prior_standard_deviation` is {prior_standard_deviation}, but must be "
            "positive."
        )
    problem, normalized = identification.problem, identification.normalized

    tests = list(candidates.values())

    @partial(fast_compile, optimize=False)
    def information_at(normalized: Array, tests: list[AbstractTest]) -> list[Array]:
        """Fisher information matrix of each column of readings of each test."""

        def information_of(test: AbstractTest) -> Float[Array, "columns params params"]:
            def predict(normalized: Array) -> Array:
                mechanism = problem.mechanism(normalized)
                return test.predict(mechanism, throw=False) / test.standard_deviations

            jacobian = jax.jacfwd(predict)(normalized)
            return jnp.einsum("rcu,rcv->cuv", jacobian, jacobian)

        return map_in_groups(information_of, tests)

    def total_information(normalized: Array) -> dict[str, np.ndarray]:
        return {
            name: np.asarray(columns).sum(axis=0)
            for name, columns in zip(
                candidates, information_at(normalized, tests), strict=True
            )
        }

    per_column = [np.asarray(each) for each in information_at(normalized, tests)]
    per_test = {
        name: columns.sum(axis=0)
        for name, columns in zip(candidates, per_column, strict=True)
    }
    jacobian = np.asarray(identification.jacobian)
    prior = np.eye(normalized.size) / prior_standard_deviation**2
    information = jacobian.T @ jacobian + prior
    added = []
    for (name, test), columns in zip(candidates.items(), per_column, strict=True):
        added.append((name, per_test[name]))
        if len(columns) > 1:
            sensors = (f"{name}, {sensor} alone" for sensor in test.columns)
            added += zip(sensors, columns, strict=True)
    ranked = [
        Candidate(name, _gain(information, more), _standard_errors(information + more))
        for name, more in added
    ]
    selected = _select(per_test, information, count)
    after = [_standard_errors(information + sum(per_test[name] for name in selected))]
    for direction in undetermined_changes(identification):
        for side in (prior_standard_deviation, -prior_standard_deviation):
            others = total_information(normalized + side * direction)
            added_there = sum(others[name] for name in selected)
            if np.all(np.isfinite(added_there)):
                after.append(_standard_errors(information + added_there))
    return ExperimentRanking(
        candidates=tuple(sorted(ranked, key=lambda each: -each.information_gain)),
        selected=selected,
        names=identification.names,
        standard_errors_before=_standard_errors(information),
        standard_errors_after=after[0],
        standard_errors_range=np.stack([np.min(after, axis=0), np.max(after, axis=0)]),
        undetermined_directions=identification.undetermined_directions,
    )


def _standard_errors(information: np.ndarray) -> np.ndarray:
    """Standard errors that follow from an information matrix."""
    return np.sqrt(np.diagonal(np.linalg.inv(information)))


def _gain(information: np.ndarray, added: np.ndarray) -> float:
    """Information gain in nats: half the increase of the log-determinant."""
    before, after = information, information + added
    return float((np.linalg.slogdet(after)[1] - np.linalg.slogdet(before)[1]) / 2)


def _select(
    candidates: Mapping[str, np.ndarray], information: np.ndarray, count: int
) -> tuple[str, ...]:
    """Select tests one after another by their information gain, and return their names.

    The information matrix so far, and those of the candidates, are with respect to the
    normalized parameters.
    """
    remaining, selected = dict(candidates), []
    for _ in range(count):
        best = max(remaining, key=lambda name: _gain(information, remaining[name]))
        information = information + remaining.pop(best)
        selected.append(best)
    return tuple(selected)
