"""The commands of `twistorjax`, and how their errors are reported."""

import contextlib
import io
import os
import sys
import warnings
from typing import Annotated, no_type_check

import typer

from .._utils.validation import shorten
from .common import ClickException, is_out_of_memory
from .export import export
from .fit_energy import fit_energy
from .four_bar import four_bar
from .four_bar_models import four_bar_models
from .identify import identify
from .modes import modes
from .new import new
from .parallelogram import parallelogram
from .path import path
from .random_data import random_data
from .report import report
from .solve import solve
from .stage import stage
from .sweep import sweep
from .truss import truss
from .water import water


app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


_SHORT_HELP = {
    new: "Files to begin with.",
    solve: "Equilibrium of a mechanism in a file.",
    path: "Stable and unstable equilibria of a mechanism in a file.",
    report: "A page about a mechanism in a file.",
    modes: "Natural frequencies of a mechanism in a file.",
    stage: "Gain of the micropositioning stage.",
    four_bar: "Motion of the four-bar linkages.",
    four_bar_models: "Hinge models of the four-bar linkages.",
    parallelogram: "Parallelogram flexure under large loads.",
    truss: "Snap-through of the truss of von Mises.",
    fit_energy: "Fit the energy of a hinge to trials.",
    identify: "Identify stiffnesses from a motion.",
    random_data: "Overfitting study on random wrenches.",
    water: "Fits to the energy of water molecules.",
    export: "Export a mechanism to other programs.",
}
for command, short_help in _SHORT_HELP.items():
    app.command(command.__name__.replace("_", "-"), short_help=short_help)(command)
app.add_typer(sweep, name="sweep", short_help="Sweep the dimensions of a mechanism.")


@app.callback(invoke_without_command=True)
@no_type_check  # Typer passes a context of another class than the one it exports
def overview(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.")
    ] = False,
) -> None:
    """Differentiable mechanics of planar compliant mechanisms.

    Example: twistorjax stage
    """
    if version:
        from importlib.metadata import version as installed_version

        print(f"twistorjax {installed_version('twistorjax')}")
    elif context.invoked_subcommand is None:
        print(context.get_help())


_INTERRUPTED = 130  # the exit code that shells report after Ctrl+C
_MESSAGE_LENGTH = 1000  # largest length of a message; characters
_OUT_OF_MEMORY = "There is not enough memory. Use fewer designs, points, or times."


def main() -> None:
    """Run the command line program.

    The exit code is 0 on success; 1 if a solve failed, the memory is not sufficient, or
    the output or a store cannot be written; 2 if an argument is invalid, or a file that
    it names cannot be read or written; and 130 if the program was interrupted. Every
    error and every warning is reported as one line on stderr.
    """
    _prepare_streams()
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_: _write(f"warning: {message}")
        code = _run()
    try:
        sys.stdout.flush()
    except OSError as error:
        code = _report_os_error(error)
    if code == _INTERRUPTED:
        os._exit(code)  # Python would end while XLA still compiles, and crash.
    sys.exit(code)


def _run() -> int:
    """Run the command that `sys.argv` names, and return its exit code."""
    try:
        return typer.main.get_command(app).main(standalone_mode=False) or 0
    except ClickException as error:
        return _report(error.format_message(), error.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        return _INTERRUPTED
    except MemoryError:
        return _report(_OUT_OF_MEMORY, 1)
    except OSError as error:
        return _report_os_error(error)
    except RuntimeError as error:
        if not is_out_of_memory(error):
            raise
        return _report(_OUT_OF_MEMORY, 1)


def _prepare_streams() -> None:
    """Make stdout and stderr accept all characters, and replace closed streams."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _report_os_error(error: OSError) -> int:
    """Report that a file or stdout cannot be read or written; return the exit code.

    A broken pipe is not reported: a reader such as `head` may stop early.
    """
    try:
        sys.stdout.flush()
    except OSError:  # Python would try to write the rest of the buffer again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if isinstance(error, BrokenPipeError):
        return 1
    return _report(str(error), 1)


def _report(message: str, code: int) -> int:
    """Write a message as one line on stderr, and return the exit code."""
    _write(message)
    return code


def _write(message: str) -> None:
    """Write a message as one line on stderr."""
    line = shorten(" ".join(message.split()), _MESSAGE_LENGTH)
    with contextlib.suppress(OSError):
        sys.stderr.write(f"twistorjax: {line}\n")


if __name__ == "__main__":
    main()
