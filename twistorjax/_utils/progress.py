"""One line on the terminal about work that takes longer than two seconds.

A thread writes the line, because the work does not return to Python while XLA compiles or
a program runs. The line disappears when the work ends.
"""

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import wraps
from inspect import signature
from typing import Any, ParamSpec, TypeVar

import jax

from .host import is_traced
from .validation import quote


Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

_DELAY = 2.0  # after which the line appears; s
_PERIOD = 0.2  # between two looks at the work; s
_COMPILED = "/jax/core/compile/backend_compile_duration"


class _Line:
    """The line, and what it is about.

    Args:
        text: What the work is; None without work.
        begin: Time at which the work began; s.
        compiling: Whether a function is being traced or compiled.
        hidden: Whether something else is on the line, such as a progress bar.
        enabled: Whether the line may appear; None to decide by the terminal.
    """

    def __init__(self) -> None:
        self.text: str | None = None
        self.begin = 0.0
        self.compiling = self.hidden = False
        self.enabled: bool | None = None
        self._lock, self._work = threading.Lock(), threading.Event()
        self._shown = ""
        self._thread: threading.Thread | None = None

    def is_enabled(self) -> bool:
        """Decide whether the line may appear."""
        if self.enabled is not None:
            return self.enabled
        return sys.stderr.isatty() or _in_notebook()

    def start(self, text: str) -> None:
        """Begin to watch some work."""
        if self._thread is None:
            jax.monitoring.register_event_duration_secs_listener(self._after_compilation)
            self._thread = threading.Thread(target=self._watch, daemon=True)
            self._thread.start()
        self.text, self.begin = text, time.monotonic()
        self.compiling = self.hidden = False
        self._work.set()

    def stop(self) -> None:
        """Erase the line."""
        self._work.clear()
        self.text = None
        self.show("")

    def hide(self) -> None:
        """Leave the line to something else, until this work ends."""
        self.hidden = True
        self.show("")

    def show(self, text: str) -> None:
        """Replace the text on the terminal."""
        with self._lock:
            if text != self._shown:
                sys.stderr.write("\r" + text + " " * (len(self._shown) - len(text)))
                sys.stderr.write("" if text else "\r")
                sys.stderr.flush()
                self._shown = text

    def _watch(self) -> None:
        """Show the line while there is work."""
        while self._work.wait():
            time.sleep(_PERIOD)
            text, seconds = self.text, time.monotonic() - self.begin
            if text is None or self.hidden or seconds < _DELAY:
                continue
            doing = "compiling " if self.compiling else ""
            self.show(f"{doing}{text} ({seconds:.0f} s)")
            if self.text is not text:  # The work has ended in the meantime.
                self.show("")

    def _after_compilation(
        self, event: str, duration_secs: float, **more: str | int
    ) -> None:
        del duration_secs, more
        if event == _COMPILED:
            self.compiling = False


_line = _Line()


def set_enabled(enabled: bool | None) -> None:
    """Let the line appear, or not; by default only on a terminal and in a notebook."""
    _line.enabled = enabled


@contextlib.contextmanager
def activity(text: str) -> Iterator[None]:
    """Show what is done, if it takes longer than two seconds and is not part of more."""
    if _line.text is not None or not _line.is_enabled():
        yield
        return
    _line.start(text)
    try:
        yield
    finally:
        _line.stop()


def compiling() -> None:
    """Say that a function is traced now, and compiled next."""
    _line.compiling = True


def progress_bar(total: int, unit: str, wanted: bool, **settings: Any) -> Any:
    """Create a progress bar of tqdm, which replaces the line of an `activity`.

    It appears at once and stays if it is `wanted`, and otherwise after two seconds where
    such a line may appear. `settings` are those of tqdm.
    """
    from tqdm import tqdm

    class Bar(tqdm):
        def display(self, *arguments: Any, **more: Any) -> Any:
            _line.hide()
            return super().display(*arguments, **more)

    settings = {"delay": 0.0 if wanted else _DELAY, "leave": wanted, **settings}
    disable = not (wanted or _line.is_enabled())
    return Bar(total=total, unit=unit, disable=disable, **settings)


def announced(
    name: str,
) -> Callable[[Callable[Parameters, Result]], Callable[Parameters, Result]]:
    """Show the name of an analysis and the size of its mechanism, if it takes long.

    Inside of other functions of JAX, nothing is shown. If the first argument is called
    `mechanism`, it must be one.
    """

    def decorate(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
        needs_mechanism = next(iter(signature(function).parameters)) == "mechanism"

        @wraps(function)
        def call(*arguments: Parameters.args, **options: Parameters.kwargs) -> Result:
            if needs_mechanism and arguments and not _is_mechanism(arguments[0]):
                raise ValueError(
                    f"`mechanism` is {quote(arguments[0])}, but must be a Mechanism."
                )
            if _line.text is not None or not _line.is_enabled():
                return function(*arguments, **options)
            if is_traced((arguments, options)):
                return function(*arguments, **options)
            with activity(name + _size(arguments[0] if arguments else None)):
                return function(*arguments, **options)

        return call

    return decorate


def _is_mechanism(value: Any) -> bool:
    """Decide whether an argument has bodies and hinges, as a `Mechanism` does."""
    lists = (getattr(value, name, None) for name in ("names", "hinge_names"))
    return all(isinstance(names, tuple) for names in lists)


def _size(mechanism: Any) -> str:
    """Return a text such as ": 3 bodies, 2 hinges" about a mechanism."""
    if not _is_mechanism(mechanism):
        return ""
    return f": {len(mechanism.names)} bodies, {len(mechanism.hinge_names)} hinges"


def _in_notebook() -> bool:
    """Decide whether this process is the kernel of a notebook."""
    return "ipykernel" in sys.modules and "IPython" in sys.modules
