"""How a solve ended, and what all answers share."""

from collections import Counter
from collections.abc import Callable
from typing import Protocol, runtime_checkable, TypeVar

import diffrax as dfx
import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Inexact

from .._utils.validation import concrete
from .tables import Columns, columns, Tabular


class RESULTS(dfx.RESULTS):  # pyright: ignore[reportGeneralTypeIssues]
    """Why a solve stopped. The text is empty where it succeeded.

    For equilibria one of `successful`, `not_finite`, `unstable`, `no_equilibrium`,
    `steps_used_up` and `out_of_range`; for motions `successful`, `event_occurred`,
    `max_steps_reached`, `not_finite`, `out_of_range`, `step_too_long`, and what is wrong
    with their start; for fits `successful`, `not_converged` and
    `no_solution_at_start`. `RESULTS[item]` is its text. Extends the results of diffrax, so
    that one enumeration serves both.
    """

    successful = ""
    not_finite = (
        "A value of the mechanism, its loads or its drives is not finite: a NaN came in, "
        "or a dimension of a hinge lies outside the range of its formula."
    )
    unstable = (
        "Some body can move without storing energy, or even gives some away, so nothing "
        "picks out where it rests. Hold it with `fixed`, drive it, add a hinge, or "
        "stiffen one: the mechanism's `stiffness` there is singular or has a negative "
        "eigenvalue."
    )
    no_equilibrium = (
        "No equilibrium was found that continues the one at rest up to the full loads "
        "and drives. `fraction` tells how much of them was reached: there the mechanism "
        "may buckle or snap, or a hinge be displaced beyond what its energy allows. Take "
        "smaller loads, drive the motion instead of loading it, or, where a symmetric "
        "mechanism may give way to either side, choose one by a small load."
    )
    steps_used_up = (
        "The largest number of Newton steps was reached. `fraction` tells how much of "
        "the loads and drives was; raise `max_steps`, or start nearer with `start`."
    )
    out_of_range = (
        "A hinge is displaced beyond the range in which its energy is known: it is "
        "turned further, or bears a larger force, than it was made for. Make it for a "
        "wider range, or load the mechanism less."
    )

    step_too_long = (
        "The steps of constant length are too long for this motion: the solves of one "
        "did not settle. Give a shorter `step`, or none, so that steps are chosen."
    )
    times_not_increasing = (
        "The times do not increase. Give at least two, each later than the one before."
    )
    drive_jumps = (
        "At the first time a driven coordinate is not where its body starts: it would "
        "have to jump. Let the drive begin at the start, or start where it begins."
    )
    damping_gives_energy = (
        "The damping of a hinge has a negative eigenvalue, so it would give energy to "
        "the mechanism instead of taking it. Every eigenvalue must be zero or positive."
    )
    inconsistent_constraints = (
        "The constraints repeat or contradict one another, or the start violates them."
    )

    not_converged = (
        "The estimates have not settled within the evaluations allowed. Raise "
        "`max_steps`, start nearer, try `restarts`, or leave out what the readings do "
        "not determine."
    )
    no_solution_at_start = (
        "At the values from which the fit starts a test has no answer. Start from values "
        "at which every solve succeeds."
    )


def result_names(result: RESULTS) -> np.ndarray | None:
    """The names of results, in the shape of their batch, or nothing while traced."""
    index = concrete(result._value)
    return None if index is None else np.array(_NAMED[index], object)


def count_results(noun: str, ended: np.ndarray) -> str:
    """How many answers of a batch ended how, in a line."""
    counts = Counter(map(str, ended.ravel()))
    told = ", ".join(f"{count:,} {name}" for name, count in counts.items())
    return f"{ended.size:,} {noun}, of shape {ended.shape}: {told}"


@runtime_checkable
class HasResult(Protocol):
    """An answer that says how it ended."""

    @property
    def result(self) -> RESULTS: ...

    @property
    def succeeded(self) -> Bool[Array, "*batch"]: ...


Answer = TypeVar("Answer", bound=HasResult)


def raise_failed(
    answer: Answer, failure: Callable[[str, tuple[int, ...]], Exception]
) -> Answer:
    """The answer, if it succeeded; otherwise the failure of its first lane is raised.

    Args:
        answer: of a solve, or of a batch of them.
        failure: what to raise, from the name of the outcome and the lane of the batch.
    """
    ended = result_names(answer.result)
    if ended is None:
        return answer.result.error_if(answer, ~answer.succeeded)
    failed = ~np.asarray(answer.succeeded)
    if np.any(failed):
        batch_index = tuple(map(int, np.unravel_index(np.argmax(failed), failed.shape)))
        raise failure(np.asarray(ended)[batch_index], batch_index)
    return answer


def result_message(item: str) -> str:
    """What an outcome means, by its name."""
    return RESULTS[getattr(RESULTS, item)]


# of the outcomes, by their numbers
RESULT_NAMES = tuple(
    sorted(RESULTS._name_to_item, key=lambda name: int(getattr(RESULTS, name)._value))
)
_NAMED = np.array(RESULT_NAMES, object)


class BodySolution(Tabular):
    """What an answer tells of each body, called by its name."""

    displacements: eqx.AbstractVar[Inexact[Array, "..."]]
    reactions: eqx.AbstractVar[Inexact[Array, "..."]]
    result: eqx.AbstractVar[RESULTS]
    names: eqx.AbstractVar[tuple[str, ...]]

    @property
    def succeeded(self) -> Bool[Array, "*batch"]:
        """Whether this is an answer."""
        done = self.result == RESULTS.successful
        return done | (self.result == RESULTS.event_occurred)

    def displacement(self, body: str) -> Inexact[Array, "*batch 3"]:
        """How far a body has moved from rest; rad, m, m."""
        return self.displacements[..., self._row(body), :]

    def reaction(self, body: str) -> Inexact[Array, "*batch 3"]:
        """What a body's held and driven coordinates receive from outside; N m, N, N.

        About the body's origin, in world axes.
        """
        return self.reactions[..., self._row(body), :]

    def _by_body(self, poses: Inexact[Array, "*batch bodies 3"], *before: str) -> Columns:
        """Columns of where the bodies are, and of what holds them."""
        rows, names = (*before, "body"), {"body": self.names}
        places = ("angle", "rad"), ("x", "m"), ("y", "m")
        wrenches = ("moment", "N m"), ("force_x", "N"), ("force_y", "N")
        return {
            **columns(poses, rows, *places, **names),
            **columns(self.reactions, rows, *wrenches, **names),
        }

    def _row(self, body: str) -> int:
        if body not in self.names:
            raise ValueError(
                f"`body` is {body!r}, but the bodies are "
                f"{', '.join(map(repr, self.names))}."
            )
        return self.names.index(body)


class PoseSolution(BodySolution):
    """What an answer tells that says where each body is."""

    reference: eqx.AbstractVar[Float[Array, "..."]]

    @property
    def poses(self) -> Float[Array, "*batch bodies 3"]:
        """Where the bodies are; rad, m, m."""
        more = self.displacements.ndim - self.reference.ndim
        shape = (*self.reference.shape[:-2], *more * (1,), *self.reference.shape[-2:])
        return self.reference.reshape(shape) + self.displacements

    def pose(self, body: str) -> Float[Array, "*batch 3"]:
        """Where a body is; rad, m, m."""
        return self.poses[..., self._row(body), :]

    def _listed(self, title: str, head: str, rows: np.ndarray) -> str:
        """A line for each body, of so many that they fit on a screen."""
        wide = max(map(len, (*self.names, head)))
        lines = [f"{head:<{wide}}  {'angle (rad)':>13}  {'x (m)':>13}  {'y (m)':>13}"]
        for name, values in zip(self.names, rows, strict=True):
            cells = "  ".join(f"{value:>13.6g}" for value in values)
            lines.append(f"{name:<{wide}}  {cells}")
        if len(lines) > 21:
            lines[11:-1] = [f"... {len(lines) - 12} more"]
        return "\n".join([title, *lines])
