"""Which further test would tell most about what is still uncertain."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.validation import require_kind
from .compilation import fast_compile
from .measurement import AbstractTest, mapped
from .report import Identification


class Candidate(NamedTuple):
    """What a test, or one of its sensors alone, would add.

    Args:
        name: of the test, and of the sensor.
        gain: how many nats it tells: the volume of the uncertainty shrinks by exp(gain).
        errors: standard errors of the unknowns with it, as relative changes.
    """

    name: str
    gain: float
    errors: Float[np.ndarray, " unknowns"]


class ExperimentRanking(eqx.Module):
    """Candidates for a further test, the one that tells most first.

    Args:
        candidates: whole tests, and each of their sensors alone.
        picked: names of whole tests, each chosen for what it adds to those before it.
        names: of the unknowns.
        before: standard errors of the unknowns without any, as relative changes.
        after: with all that are picked.
    """

    candidates: tuple[Candidate, ...]
    picked: tuple[str, ...]
    names: tuple[str, ...]
    before: Float[np.ndarray, " unknowns"]
    after: Float[np.ndarray, " unknowns"]

    def __repr__(self) -> str:
        def cells(values: np.ndarray) -> str:
            return "  ".join(f"{f'{100 * value:.3g} %':>{wide}}" for value in values)

        wide = max(10, *map(len, self.names))
        first = max(map(len, (candidate.name for candidate in self.candidates)))
        best = "the best" if len(self.picked) == 1 else f"the {len(self.picked)} best"
        first = max(first, len("standard error with"))
        head = "  ".join(f"{name:>{wide}}" for name in self.names)
        lines = [f"{'standard error with':<{first}}  {'gain (nats)':>11}  {head}"]
        lines.append(f"{'what there is':<{first}}  {'':>11}  {cells(self.before)}")
        for name, gain, errors in self.candidates:
            lines.append(f"{name:<{first}}  {gain:>11.3g}  {cells(errors)}")
        lines.append(f"{best:<{first}}  {'':>11}  {cells(self.after)}")
        lines.append(f"best, one after another: {', '.join(self.picked)}")
        return "\n".join(lines)


def rank_experiments(
    found: Identification,
    candidates: Mapping[str, AbstractTest] | Sequence[AbstractTest],
    *,
    picks: int = 1,
    prior: float = 1.0,
) -> ExperimentRanking:
    """Which further test reduces the uncertainty of a fit most.

    Each is rehearsed at the estimates, and told by how much it would shrink the volume of
    the region in which the unknowns are (D-optimality). Tests of one kind, which differ
    in their loads, times or deviations alone, are rehearsed side by side.

    Args:
        found: what is known so far.
        candidates: tests that could be done, with the sensors that would read them, by
            names or in a sequence.
        picks: how many are to be done: they are chosen one after another.
        prior: relative change within which each unknown is taken to be known without any
            measurement, so that what is not determined has a finite volume.

    Returns:
        The candidates, with what each would leave of the standard errors.

    Raises:
        ValueError: there is no candidate; the numbers make no sense.

    Source:
        Atkinson and Donev, Optimum Experimental Designs, chapters 9 and 10.

    Example:
        >>> from twistorjax import Body, Hinge, Load, Mechanism, Quadratic
        >>> from twistorjax.identification import identify, BodySensor, StaticTest, Parameter
        >>> def spring(k):
        ...     energy = Quadratic(jnp.diag(jnp.stack([k["turn"], k["along"], 10.0])))
        ...     hinge = Hinge("spring", "wall", "block", energy, at=(0, 0, 0))
        ...     return Mechanism([Body("wall"), Body("block")], [hinge], fixed=["wall"])
        >>> start = {"along": Parameter(80.0, above=0), "turn": Parameter(1.0, above=0)}
        >>> def pushed(load, quantity):
        ...     gauge = BodySensor("block", quantity, 1e-4)
        ...     return StaticTest([[Load("block", load)]], [gauge])
        >>> along, turn = pushed((0, 5, 0), "x"), pushed((0.1, 0, 0), "angle")
        >>> found = identify(spring, start, [along.measured([[0.05]])])
        >>> rank_experiments(found, {"along": along, "turn": turn}).picked
        ('turn',)
    """
    if isinstance(candidates, AbstractTest):
        raise ValueError("`candidates` is one test: put it in a list, [...].")
    if not isinstance(candidates, Mapping):
        require_kind("candidates", candidates, AbstractTest)
        candidates = {f"{test!r}": test for test in candidates}
    if not candidates or not 1 <= picks <= len(candidates) or not prior > 0:
        raise ValueError(
            f"There are {len(candidates)} candidates, `picks` is {picks} and `prior` "
            f"{prior}, but there must be one or more, as many as are picked, and the "
            "prior must be positive."
        )
    tests = list(candidates.values())
    problem, place = found.problem, found.place

    def sensed(test: AbstractTest) -> Float[Array, "columns unknowns unknowns"]:
        """The information of each column."""

        def read(place: Array) -> Array:
            mechanism = problem.design(problem.unknowns.at(place))
            return test.read(mechanism, throw=False) / test.deviations

        slopes = jax.vmap(
            lambda direction: jax.jvp(read, (place,), (direction,))[1], out_axes=2
        )(jnp.eye(place.size))
        return jnp.einsum("rcu,rcv->cuv", slopes, slopes)

    told = [np.asarray(each) for each in fast_compile(mapped)(sensed, tests)]
    known = np.asarray(found.sensitivity)
    known = known.T @ known + np.eye(place.size) / prior**2
    listed = []
    for name, test, columns in zip(candidates, tests, told, strict=True):
        listed.append(_judged(name, known, columns.sum(axis=0)))
        if len(columns) > 1:
            listed += [
                _judged(f"{name}, {sensor} alone", known, information)
                for sensor, information in zip(test.columns, columns, strict=True)
            ]
    picked = _picked(dict(zip(candidates, told, strict=True)), known, picks)
    chosen = [list(candidates).index(name) for name in picked]
    return ExperimentRanking(
        candidates=tuple(sorted(listed, key=lambda candidate: -candidate.gain)),
        picked=picked,
        names=found.names,
        before=_errors(known),
        after=_errors(known + sum(told[place].sum(axis=0) for place in chosen)),
    )


def _errors(information: np.ndarray) -> np.ndarray:
    return np.sqrt(np.diagonal(np.linalg.inv(information)))


def _gain(known: np.ndarray, more: np.ndarray) -> float:
    """Half the logarithm of how the determinant of the information grows."""
    gain = (np.linalg.slogdet(known + more)[1] - np.linalg.slogdet(known)[1]) / 2
    return float(gain)


def _judged(name: str, known: np.ndarray, more: np.ndarray) -> Candidate:
    return Candidate(name, _gain(known, more), _errors(known + more))


def _picked(
    told: Mapping[str, np.ndarray], known: np.ndarray, picks: int
) -> tuple[str, ...]:
    left, chosen = dict(told), []
    for _ in range(picks):
        best = max(left, key=lambda name: _gain(known, left[name].sum(axis=0)))
        known = known + left.pop(best).sum(axis=0)
        chosen.append(best)
    return tuple(chosen)
