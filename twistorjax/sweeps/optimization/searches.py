"""Searches of one or several optimizations side by side, and their store.

The searches share the calls of one program. Each search runs in a thread of its own and
waits there for the outputs of its next design. As soon as all running searches wait, one
call evaluates their designs.
"""

import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..._utils.progress import progress_bar
from ..._utils.validation import quote
from ...designs.design_space import DesignSpace
from ...designs.designs import Designs
from ...results.tables import Column
from ..dataset import Layout
from ..outputs import StudyOutput
from ..stores.identity import open_store, sweep_identity
from ..sweep import require_packages, rows_of_part
from .local_search import search, SearchEnd
from .optimum import Optimum, summarize
from .problem import Evaluate, Evaluation, Problem


# Largest number of searches that run at the same time, each in a thread of its own.
_MOST_SEARCHES = 64


@dataclass(frozen=True)
class SearchOptions:
    """Options of the searches, as `optimize` takes them."""

    starts: Any
    seed: int
    tolerance: float
    max_steps: int
    store: str | Path | None
    resume: bool
    part: tuple[int, int] | None
    progress: bool

    def __post_init__(self) -> None:
        if not 0 < self.tolerance < 1:
            raise ValueError(
                f"`tolerance` is {self.tolerance}, but must be between 0 and 1."
            )
        if self.max_steps < 1:
            raise ValueError(f"`max_steps` is {self.max_steps}, but must be at least 1.")
        if self.resume and self.store is None:
            raise ValueError(
                "`resume` is True, but there is no `store`. Specify its path."
            )
        rows_of_part(self.part, self.store)
        if isinstance(self.starts, int | float | np.number):
            if int(self.starts) != self.starts or self.starts < 1:
                raise ValueError(
                    f"`starts` is {quote(self.starts)}, but must be an integer of at "
                    "least 1, or designs."
                )
        elif isinstance(self.starts, str) or (
            isinstance(self.starts, list | tuple)
            and any(isinstance(start, Mapping) for start in self.starts)
        ):
            raise ValueError(
                f"`starts` is {quote(self.starts)}, but must be a number, or a mapping "
                "from names of parameters to arrays with one value for each start."
            )

    @property
    def continues(self) -> bool:
        """Whether an existing store is continued, as every part does."""
        return self.resume or self.part is not None

    def start_vectors(self, space: DesignSpace) -> Float[np.ndarray, "starts numbers"]:
        if not isinstance(self.starts, int | float | np.number):
            vectors = space.vectors(self.starts)
            return np.where(space.is_variable, vectors, space.start)
        vectors, others = space.start[None], int(self.starts) - 1
        if not others:
            return vectors
        return np.concatenate([vectors, space.sampled(others, self.seed)])


def run_searches(problems: Sequence[Problem], options: SearchOptions) -> list[Optimum]:
    """Find the optima of several problems, which share one program."""
    starts = [each.evaluate(options.start_vectors(each.space)) for each in problems]
    problems = [
        problem.scaled(next((each for each in firsts if each.succeeded), firsts[0]))
        for problem, firsts in zip(problems, starts, strict=True)
    ]
    tasks = [
        (problem, start)
        for problem, firsts in zip(problems, starts, strict=True)
        for start in firsts
    ]
    rows = np.arange(len(tasks)).reshape(len(problems), -1)
    of_part = rows_of_part(options.part, options.store)
    if of_part.start >= rows.shape[1]:
        raise ValueError(
            f"`part` is {options.part}, but there are only {rows.shape[1]} searches."
        )
    own = rows[:, of_part].ravel().tolist()
    ends: dict[int, SearchEnd] = {}
    store = None
    if options.store is not None:
        vectors = np.stack([start.vector for _, start in tasks])
        store = SearchStore(problems, vectors, options)
        ends = store.finished()
    searches = {
        row: partial(
            search, *tasks[row],
            tolerance=options.tolerance, max_steps=options.max_steps,
        )
        for row in own
        if row not in ends
    }  # fmt: skip

    done = len(own) - len(searches)
    with progress_bar(len(own), "search", options.progress, initial=done) as bar:

        def finished(row: int, end: SearchEnd) -> None:
            ends[row] = end
            if store is not None:
                store.write(row, end)
            bar.update()

        _run_side_by_side(searches, problems[0].evaluate, finished)
    known = [[row for row in of_problem if row in ends] for of_problem in rows.tolist()]
    return [
        summarize(problem, [tasks[row][1] for row in found], [ends[row] for row in found])
        for problem, found in zip(problems, known, strict=True)
    ]


class _Request(NamedTuple):
    """Request of a search for the outputs of designs."""

    vectors: Float[np.ndarray, "designs numbers"]
    replies: "SimpleQueue[list[Evaluation] | None]"  # None cancels the search.


def _run_side_by_side(
    searches: Mapping[int, Callable[[Evaluate], SearchEnd]],
    evaluate: Evaluate,
    finished: Callable[[int, SearchEnd], None],
) -> None:
    """Run searches, and call `finished` with the key and the end of each of them.

    `evaluate` is called in this thread, for the designs of all searches that wait.
    """
    messages: SimpleQueue[_Request | tuple[int, Future[SearchEnd]]] = SimpleQueue()
    pending, running = deque(searches.items()), 0
    waiting: list[_Request] = []

    def run(row: int, run_search: Callable[[Evaluate], SearchEnd]) -> None:
        replies: SimpleQueue[list[Evaluation] | None] = SimpleQueue()
        end: Future[SearchEnd] = Future()

        def evaluate_together(vectors: np.ndarray) -> list[Evaluation]:
            messages.put(_Request(vectors, replies))
            if (evaluations := replies.get()) is None:
                raise CancelledError
            return evaluations

        try:
            end.set_result(run_search(evaluate_together))
        except BaseException as error:
            end.set_exception(error)
        messages.put((row, end))

    try:
        while pending or running:
            while pending and running < _MOST_SEARCHES:
                threading.Thread(target=run, args=pending.popleft(), daemon=True).start()
                running += 1
            if len(waiting) == running:
                vectors = np.concatenate([each.vectors for each in waiting])
                evaluations = iter(evaluate(vectors))
                for request in waiting:
                    request.replies.put([next(evaluations) for _ in request.vectors])
                waiting.clear()
            message = messages.get()
            if isinstance(message, _Request):
                waiting.append(message)
            else:
                running -= 1
                row, end = message
                finished(row, end.result())
    finally:
        # Searches run here only after an error, which cancels them.
        for request in waiting:
            request.replies.put(None)
        while running:
            message = messages.get()
            if isinstance(message, _Request):
                message.replies.put(None)
            else:
                running -= 1


class SearchStore:
    """Folder in which the end of each search is saved as soon as it is known.

    It is also a store of a sweep over the starts.
    """

    def __init__(
        self,
        problems: Sequence[Problem],
        starts: Float[np.ndarray, "searches numbers"],
        options: SearchOptions,
    ):
        assert options.store is not None
        path = Path(options.store)
        require_packages(path)
        if path.exists() and not options.continues:
            raise ValueError(
                f"`store` is {str(path)!r}, which already exists. Continue it with "
                "`resume=True`, or use another path."
            )
        problem, space = problems[0], problems[0].space
        arrays = space.program_input(starts)
        designs = Designs(dict(zip(space.structure.names, arrays, strict=True)))
        self._layout = Layout(designs, _study_output(SearchEnd(starts[0], 0, 0)), {})
        self._layout.check_storable()
        settings = {
            "objective": problem.objective_name,
            "sign": problem.sign,
            "limits": [
                {
                    name: [
                        None if side is None else side.tolist() for side in limit.sides
                    ]
                    for name, limit in each.limits.items()
                }
                for each in problems
            ],
            "coverage_factor": problem.margins.coverage_factor,
            "lower": space.lower.tolist(),
            "upper": space.upper.tolist(),
            "scales": space.scales.tolist(),
            "tolerance": options.tolerance,
            "max_steps": options.max_steps,
        }
        identity = sweep_identity(problem.study, designs, problem.program, None, settings)
        identity["chunk_size"] = 1  # Each search is saved alone.
        self._store = open_store(path, self._layout, identity, options.continues)

    def finished(self) -> dict[int, SearchEnd]:
        """Return the ends of the finished searches, by the index of their start."""
        available = self._store.intact_chunks()
        ends, results, counts = (
            self._store.read(name, available) for name in ("end", "result", "evaluations")
        )
        return {
            int(row): SearchEnd(ends[row], int(results[row]), int(counts[row]))
            for row in np.flatnonzero(available)
        }

    def write(self, row: int, end: SearchEnd) -> None:
        """Save the end of the search from a start."""
        self._store.write(row, self._layout.values(_study_output(end)))


def _study_output(end: SearchEnd) -> StudyOutput:
    """Return the end of a search in the form of the outputs of one design."""
    result, succeeded = jax.device_put(
        (np.array([end.result], np.int32), np.array([end.result == 0]))
    )
    columns = {
        "end": Column(end.vector[None], ("number",)),
        "evaluations": Column(np.array([end.evaluations], np.int32)),
    }
    return StudyOutput(columns, result=result, succeeded=succeeded)
