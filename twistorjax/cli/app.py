"""The command line: `twistorjax --help`."""

import contextlib
import io
import os
import sys
from typing import Annotated, Any

import typer

from .._utils.validation import shorten
from .common import SolveError, UsageError
from .export import export
from .fit import fit
from .four_bar import four_bar
from .identify import identify
from .random_data import random_data
from .stage import stage
from .sweep import sweep
from .water import water


app = typer.Typer(
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


_ABOUT = {
    stage: "The gain of the micropositioning stage.",
    four_bar: "The four-bar linkages, driven or let go.",
    fit: "An energy of a hinge, from measurements.",
    identify: "Three stiffnesses, from a motion.",
    random_data: "Random wrenches, and what fits to them foretell.",
    water: "The energy of two water molecules.",
    export: "A mechanism in files for other programs.",
}
for command, about in _ABOUT.items():
    app.command(command.__name__.replace("_", "-"), short_help=about)(command)
app.add_typer(sweep, name="sweep", short_help="Answers over ranges of dimensions.")


@app.callback(invoke_without_command=True)
def overview(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.")
    ] = False,
) -> None:
    """Differentiable mechanics of planar flexure mechanisms.

    Example: twistorjax stage
    """
    if version:
        from importlib.metadata import version as installed

        print(f"twistorjax {installed('twistorjax')}")
    elif context.invoked_subcommand is None:
        print(context.get_help())


_INTERRUPTED = 130  # as shells report a process that was interrupted from the keyboard
_LONGEST = 1000  # characters of a message


def main() -> None:
    """Run the command line.

    The exit code is 0 on success, 1 on failure, 2 on wrong input and 130 if interrupted.
    A failure or wrong input is reported as one line on stderr.
    """
    _prepare_streams()
    code = _run()
    try:
        sys.stdout.flush()
    except OSError as error:
        code = _failed_write(error)
    sys.exit(code)


def _run() -> int:
    """Run the command of `sys.argv`; its exit code."""
    try:
        return typer.main.get_command(app).main(standalone_mode=False) or 0
    except UsageError as error:
        return _complain(str(error), 2)
    except SolveError as error:
        return _complain(str(error), 1)
    except _UsageError as error:
        return _complain(error.format_message(), 2)
    except (KeyboardInterrupt, typer.Abort):
        return _INTERRUPTED
    except MemoryError:
        return _complain(_NO_MEMORY, 1)
    except OSError as error:
        return _failed_write(error)
    except RuntimeError as error:
        # JAX reports by its own type that an array does not fit into the memory
        if "RESOURCE_EXHAUSTED" not in str(error):
            raise
        return _complain(_NO_MEMORY, 1)


_NO_MEMORY = "There is not enough memory: ask for fewer designs, points or times."
# typer has its own copy of click, or imports click, depending on its version
_UsageError: Any = next(
    kind for kind in typer.BadParameter.__mro__ if kind.__name__ == "ClickException"
)


def _prepare_streams() -> None:
    """Let output be written whatever characters it has, also where a stream is closed."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _failed_write(error: OSError) -> int:
    """The exit code after a file or the output could not be read or written.

    A reader that stops early, such as `head`, is not reported.
    """
    try:
        sys.stdout.flush()
    except OSError:  # what is still in the buffer would fail again at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if isinstance(error, BrokenPipeError):
        return 1
    return _complain(str(error), 1)


def _complain(message: str, code: int) -> int:
    """Write a message as one line on stderr; the exit code."""
    words = shorten(" ".join(message.split()), _LONGEST)
    with contextlib.suppress(OSError):
        sys.stderr.write(f"twistorjax: {words}\n")
    return code


if __name__ == "__main__":
    main()
