"""Searches of one or several optimizations, side by side."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from ..._utils.progress import progress_bar
from .local_search import search, SearchEnd
from .options import Options
from .problem import Problem
from .search_store import SearchStore
from .setup import Setup
from .side_by_side import Evaluate, run_side_by_side


# Largest number of searches that run at the same time, each in a thread of its own.
_MOST_SEARCHES = 64


def run_searches(
    setups: Sequence[Setup],
    starts: Sequence[Float[np.ndarray, "starts numbers"]],
    options: Options,
) -> list[tuple[Problem, list[SearchEnd]]]:
    """Run the searches of several optimizations, which share one program.

    Args:
        setups: Setup of each optimization.
        starts: Numbers of the design at each start of each optimization.
        options: Options of the searches.

    Returns:
        The scaled problem and the ends of the searches of each optimization.
    """
    setup = setups[0]
    tasks: list[Callable[[Evaluate], SearchEnd]] = []
    problems = []
    for each, vectors in zip(setups, starts, strict=True):
        firsts = each.evaluate(vectors)
        scale_from = next((first for first in firsts if first.succeeded), firsts[0])
        problem = each.problem().scaled(scale_from)
        problems.append(problem)
        tasks += [
            partial(
                search, problem, first,
                tolerance=options.tolerance, max_steps=options.max_steps,
            )
            for first in firsts
        ]  # fmt: skip
    ends: dict[int, SearchEnd] = {}
    store = None
    if options.store is not None:
        store = SearchStore(
            options.store, options.resume, setup, np.concatenate(starts),
            _settings(setups, options),
        )  # fmt: skip
        ends = store.finished()
    open_tasks = [row for row in range(len(tasks)) if row not in ends]

    with progress_bar(len(tasks), "search", options.progress, initial=len(ends)) as bar:

        def finished(index: int, end: SearchEnd) -> None:
            row = open_tasks[index]
            ends[row] = end
            if store is not None:
                store.write(row, end)
            bar.update()

        run_side_by_side(
            [tasks[row] for row in open_tasks],
            setup.evaluate,
            _MOST_SEARCHES,
            finished,
        )
    everything = iter(ends[row] for row in range(len(tasks)))
    return [
        (problem, [next(everything) for _ in vectors])
        for problem, vectors in zip(problems, starts, strict=True)
    ]


def _settings(setups: Sequence[Setup], options: Options) -> dict[str, Any]:
    """Entries by which optimizations are distinguished."""
    setup = setups[0]
    return {
        "objective": setup.objective,
        "sign": setup.sign,
        "limits": [
            {
                name: [None if side is None else side.tolist() for side in limit.sides]
                for name, limit in each.limits.items()
            }
            for each in setups
        ],
        "coverage_factor": float(setup.coverage_factor),
        "lower": setup.space.lower.tolist(),
        "upper": setup.space.upper.tolist(),
        "scales": setup.space.scales.tolist(),
        "tolerance": options.tolerance,
        "max_steps": options.max_steps,
    }
