"""Options, checks, and output that the commands share."""

import contextlib
import gc
import json
import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from .._utils.validation import shorten


LARGEST_SEED = 2**63 - 1

# The base class of all errors of typer: ClickException, UsageError, BadParameter.
# Depending on its version, typer imports click or contains a copy of it.
ClickException: Any = typer.BadParameter.__mro__[2]


class UsageError(ClickException):
    """Invalid input. The message is one line."""

    exit_code = 2


class SolveError(ClickException):
    """A solve that failed. The message is one line."""

    exit_code = 1


def prepare_jax(*, accelerator: bool = False, cpu_cores: int = 1) -> None:
    """Select the platform, double precision, and a cache of compiled programs.

    The platform is the CPU without `accelerator`, unless the environment variable
    `JAX_PLATFORMS` names another one: a single mechanism is too small to benefit from an
    accelerator. It is also the CPU if JAX uses several `cpu_cores` as separate devices.
    """
    import jax

    from .._compile.configuration import configure

    # With the default thresholds, imports and loaded programs take a tenth more time.
    gc.set_threshold(200_000, 20, 20)
    # JAX is imported with this package, so setting the environment variable is too late.
    any_platform = accelerator or "JAX_PLATFORMS" in os.environ
    if cpu_cores > 1 or not any_platform:
        jax.config.update("jax_platforms", "cpu")
    if cpu_cores > 1:
        jax.config.update("jax_num_cpu_devices", cpu_cores)
    configure()


def check_positive(value: float) -> float:
    """Return an option's value if it is positive and finite."""
    if not (math.isfinite(value) and value > 0):
        raise typer.BadParameter(f"{value:g} is not positive and finite.")
    return value


def check_finite(value: float | None) -> float | None:
    """Return an option's value if it is finite or not given."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value:g} is not finite.")
    return value


def check_folder(path: Path | None) -> Path | None:
    """Return the path of an output file if its folder exists or no path is given."""
    # Unlike pathlib, os.path raises no error for a name that is too long or a loop.
    if path is not None and not os.path.isdir(os.path.dirname(os.path.abspath(path))):
        folder = shorten(str(path.parent), 200)
        raise typer.BadParameter(f"there is no folder {folder}.")
    return path


def check_figure(path: Path | None) -> Path | None:
    """Return the path of a figure if it can be written or is not given."""
    if path is None:
        return None
    check_folder(path)
    _require_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    _check_suffix(path, list(FigureCanvasAgg.get_supported_filetypes()))
    return path


def check_page(path: Path) -> Path:
    """Return the path of a page with figures if it can be written."""
    check_folder(path)
    _require_matplotlib()
    _check_suffix(path, ["html"])
    return path


def check_animation(path: Path | None) -> Path | None:
    """Return the path of an animation if it can be written or is not given."""
    if path is None:
        return None
    check_folder(path)
    _require_matplotlib()
    _check_suffix(path, ["gif", "mp4", "html"])
    if path.suffix.lower() == ".mp4":
        from matplotlib.animation import writers

        if not writers.is_available("ffmpeg"):
            raise typer.BadParameter(
                f"{path} needs ffmpeg. Install it, or write a .gif file."
            )
    return path


JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON object instead of a table.")
]
EnergyOption = Annotated[
    Literal["twistor", "twist"],
    typer.Option("--energy", help="Coordinates of the quadratic hinge energies."),
]
SeedOption = Annotated[
    int, typer.Option(help="Seed of the random numbers.", min=0, max=LARGEST_SEED)
]
MechanismFile = Annotated[
    str, typer.Argument(help="The .json file of a mechanism; see the manual page Files.")
]
PlotOption = Annotated[
    Path | None,
    typer.Option(help="Draw the results to this file.", callback=check_figure),
]


@contextlib.contextmanager
def reporting_errors(context: str = "") -> Iterator[None]:
    """Convert errors in this block to a `UsageError`, or to a `SolveError` of a solver.

    Their messages start with the context.
    """
    try:
        yield
    except (ImportError, OSError, ValueError) as error:
        raise UsageError(f"{context}{error}") from None
    except RuntimeError as error:
        is_fault = isinstance(error, NotImplementedError | RecursionError)
        if is_fault or is_out_of_memory(error):
            raise
        raise SolveError(f"{context}{error}") from None


def is_out_of_memory(error: RuntimeError) -> bool:
    """Return whether JAX has no memory for an array, for which it has its own error."""
    return "RESOURCE_EXHAUSTED" in str(error)


def save_figure(path: Path, drawn: Any) -> None:
    """Write a figure, or the figure of some axes, to the file that --plot names."""
    with reporting_errors("--plot cannot be written: "):
        getattr(drawn, "figure", drawn).savefig(path, dpi=160)


def save_animation(path: Path, mechanism: Any, motion: Any, **options: Any) -> None:
    """Write an animation to the file that --animate names."""
    from ..plotting.animation import animate

    animation = animate(mechanism, motion, **options)
    with reporting_errors("--animate cannot be written: "):
        if path.suffix.lower() == ".html":
            path.write_text(animation.to_jshtml(), encoding="utf-8")
        else:
            writer = "pillow" if path.suffix.lower() == ".gif" else "ffmpeg"
            animation.save(path, writer=writer, dpi=100)


def load_mechanism(path: str) -> Any:
    """Read the mechanism of a .json file."""
    from ..io import load_mechanism

    with reporting_errors():
        return load_mechanism(path)


def by_name(names: Sequence[str], values: Any) -> dict[str, Any]:
    """Return the rows of an array by their names, as a part of a JSON record."""
    return dict(zip(names, values.tolist(), strict=True))


def print_result(
    text: Any,
    record: Any,
    as_json: bool,
    *,
    out: Path | None = None,
    plot: Path | None = None,
    draw: Callable[[], Any] = lambda: None,
) -> None:
    """Print a result as a text or as a JSON record, and save what `draw` draws.

    The text is followed by the paths of the files to which the result and its figure were
    saved, if there are any.
    """
    if plot is not None:
        save_figure(plot, draw())
    if as_json:
        print(to_json(record))
        return
    print(text)
    if out is not None:
        print(f"saved to {out}")
    if plot is not None:
        print(f"figure saved to {plot}")


def to_json(record: Any) -> str:
    """Format a record as JSON. JSON has no NaN and no infinity; they become null."""

    def without_nan(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: without_nan(part) for key, part in value.items()}
        if isinstance(value, list | tuple):
            return [without_nan(part) for part in value]
        if isinstance(value, float) and not math.isfinite(value):
            return None
        return value

    return json.dumps(without_nan(record), allow_nan=False)


def require_finite_results(record: Mapping[str, Any]) -> None:
    """Raise a `SolveError` if a number of a result is not finite."""
    wrong = [
        name
        for name, value in record.items()
        if isinstance(value, float) and not math.isfinite(value)
    ]
    if wrong:
        raise SolveError(
            f"The results {', '.join(wrong)} are not finite. A number of the options is "
            "too large or too small."
        )


def progress_bar() -> Any:
    """Return a progress bar for `simulate`, or None if stderr is not a terminal."""
    from ..solve.integration.diffrax_interface import ProgressBar

    return ProgressBar() if sys.stderr.isatty() else None


def require_success(motion: Any) -> None:
    """Raise a `SolveError` if a simulation stopped before its last time."""
    from ..results.codes import result_names, RESULTS

    if str(result_names(motion.result)) != "successful":
        raise SolveError(
            f"{RESULTS[motion.result]} The simulation stopped at "
            f"t = {float(motion.reached):.6g} s."
        )


def _require_matplotlib() -> None:
    """Import matplotlib and select a backend that needs no display."""
    try:
        import matplotlib
    except ImportError:
        raise typer.BadParameter(
            'drawing needs matplotlib: pip install "twistorjax[show]".'
        ) from None
    matplotlib.use("agg")


def _check_suffix(path: Path, formats: list[str]) -> None:
    if path.suffix[1:].lower() not in formats:
        suffixes = ", ".join(f".{name}" for name in formats)
        raise typer.BadParameter(f"{path} must end with one of {suffixes}.")
