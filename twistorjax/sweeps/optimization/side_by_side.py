"""Several optimizations of SciPy side by side, which share calls of one program.

Each optimization runs in a thread of its own and waits there for the values of its next
design. As soon as all running optimizations wait, one call evaluates their designs.
"""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from queue import SimpleQueue
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

from .problem import Evaluation


Outcome = TypeVar("Outcome")
Evaluate = Callable[[Float[np.ndarray, "designs numbers"]], list[Evaluation]]


class _Cancelled(BaseException):
    """Ends the thread of an optimization that is not needed any more."""


class _Request(NamedTuple):
    """Request of a task: the designs whose outputs it needs."""

    vectors: Float[np.ndarray, "designs numbers"]
    reply: "SimpleQueue[list[Evaluation] | None]"


class _Outcome(NamedTuple, Generic[Outcome]):
    """End of a task: what it returned, or the error that it raised."""

    task: int
    value: Outcome | None
    error: BaseException | None


def run_side_by_side(
    tasks: Sequence[Callable[[Evaluate], Outcome]],
    evaluate: Evaluate,
    size: int,
    finished: Callable[[int, Outcome], None],
) -> None:
    """Run optimizations, at most a given number of them at the same time.

    Args:
        tasks: Functions that run one optimization each. They take a function that
            evaluates designs.
        evaluate: Function that evaluates the designs of all tasks.
        size: Largest number of optimizations that run at the same time.
        finished: Function that is called with the index and the value of each
            optimization as soon as it has ended.
    """
    messages: SimpleQueue[_Request | _Outcome[Outcome]] = SimpleQueue()
    waiting: list[_Request] = []
    pending = deque(enumerate(tasks))
    running = 0
    cancelled = threading.Event()

    def run(index: int, task: Callable[[Evaluate], Outcome]) -> None:
        reply: SimpleQueue[list[Evaluation] | None] = SimpleQueue()

        def evaluate_together(
            vectors: Float[np.ndarray, "designs numbers"],
        ) -> list[Evaluation]:
            if cancelled.is_set():
                raise _Cancelled
            messages.put(_Request(vectors, reply))
            evaluations = reply.get()
            if evaluations is None:
                raise _Cancelled
            return evaluations

        value: Any = None
        error: BaseException | None = None
        try:
            value = task(evaluate_together)
        except BaseException as raised:
            error = raised
        messages.put(_Outcome(index, value, error))

    try:
        while pending or running:
            while pending and running < size:
                threading.Thread(target=run, args=pending.popleft(), daemon=True).start()
                running += 1
            message = messages.get()
            if isinstance(message, _Request):
                waiting.append(message)
            else:
                running -= 1
                if message.error is not None:
                    raise message.error
                finished(message.task, message.value)  # pyright: ignore
            if waiting and len(waiting) == running and not (pending and running < size):
                _answer(waiting, evaluate)
                waiting.clear()
    finally:
        cancelled.set()
        for request in waiting:
            request.reply.put(None)
        while running:
            message = messages.get()
            if isinstance(message, _Request):
                message.reply.put(None)
            else:
                running -= 1


def _answer(requests: Sequence[_Request], evaluate: Evaluate) -> None:
    """Evaluate the designs of all requests together, and send the replies."""
    evaluations = iter(evaluate(np.concatenate([each.vectors for each in requests])))
    for request in requests:
        request.reply.put([next(evaluations) for _ in request.vectors])
