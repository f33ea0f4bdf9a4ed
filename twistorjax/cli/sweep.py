"""`twistorjax sweep`: sweep the dimensions of the stage or of the linkage."""

import math
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, no_type_check

import typer

from .common import (
    check_folder,
    JsonOption,
    PlotOption,
    prepare_jax,
    print_result,
    SolveError,
    UsageError,
)


sweep = typer.Typer()


@sweep.callback(invoke_without_command=True)
@no_type_check  # Typer passes a context of another class than the one it exports
def overview(context: typer.Context) -> None:
    """Sweep the dimensions of a mechanism over ranges such as 0.2e-3:0.4e-3:1000.

    Example: twistorjax sweep stage --web 0.2e-3:0.4e-3:1000 --plot gain.png
    """
    if context.invoked_subcommand is None:
        print(context.get_help())


_LARGEST_COUNT = 10_000_000  # designs in a sweep

_OutOption = Annotated[
    Path | None,
    typer.Option(help="Save the results to this folder (zarr).", callback=check_folder),
]
_ResumeOption = Annotated[
    bool, typer.Option("--resume", help="Resume the sweep that --out contains.")
]
_PartOption = Annotated[
    str | None,
    typer.Option(
        help="Compute the k-th of n parts of the sweep that --out is shared by, k/n: a "
        "job of a cluster. Parts may run at the same time and be repeated.",
        metavar="K/N",
    ),
]
_DevicesOption = Annotated[
    int,
    typer.Option(
        help="Number of CPU cores that share the designs. With 1, JAX uses an "
        "accelerator if there is one; more than 1 selects the CPU.",
        min=1,
    ),
]
_ChunkOption = Annotated[
    int | None, typer.Option(help="Number of designs that are solved at once.", min=1)
]


@sweep.command(short_help="Gain of the micropositioning stage.")
def stage(
    web: Annotated[
        str,
        typer.Option(
            help="Web, the smallest thickness of the necks: one value, or "
            "first:last:count; m."
        ),
    ] = "0.2e-3:0.4e-3:1000",
    hole: Annotated[
        str,
        typer.Option(help="Diameter of the holes: one value, or first:last:count; m."),
    ] = "3e-3",
    out: _OutOption = None,
    resume: _ResumeOption = False,
    part: _PartOption = None,
    devices: _DevicesOption = 1,
    chunk: _ChunkOption = None,
    as_json: JsonOption = False,
    plot: PlotOption = None,
) -> None:
    """Compute the gain of the micropositioning stage and its exact derivatives.

    Example: twistorjax sweep stage --web 0.2e-3:0.4e-3:10000 --out stage.zarr
    """
    ranges = _parse_ranges({"web": web, "hole": hole}, plot)
    table = _run("stage_gain", ranges, ("gain",), out, resume, part, devices, chunk)
    _report(table, ranges, ("gain",), out, as_json, plot)


@sweep.command("four-bar", short_help="Motion of the driven four-bar linkage.")
def four_bar(
    length: Annotated[
        str,
        typer.Option(help="Length of the leaves: one value, or first:last:count; m."),
    ] = "12e-3:16e-3:20",
    thickness: Annotated[
        str,
        typer.Option(help="Thickness of the leaves: one value, or first:last:count; m."),
    ] = "0.8e-3:1.2e-3:20",
    out: _OutOption = None,
    resume: _ResumeOption = False,
    part: _PartOption = None,
    devices: _DevicesOption = 1,
    chunk: _ChunkOption = None,
    as_json: JsonOption = False,
    plot: PlotOption = None,
) -> None:
    """Compute travel, moment, and frequency of the driven four-bar linkage.

    The four leaves are identical. The outputs are the largest displacement of link 3
    along x, the largest moment on link 2, and the lowest natural frequency.

    Example: twistorjax sweep four-bar --length 12e-3:16e-3:50 --thickness 1e-3
    """
    ranges = _parse_ranges({"length": length, "thickness": thickness}, plot)
    table = _run("driven_linkage", ranges, (), out, resume, part, devices, chunk)
    _report(table, ranges, ("travel", "moment", "frequency"), out, as_json, plot)


# Values of each parameter, by name; m
_Ranges = Mapping[str, list[float]]


def _parse_ranges(options: Mapping[str, str], plot: Path | None) -> _Ranges:
    """Convert the options of the parameters to numbers, and check how many there are."""
    ranges = {name: _parse_range(f"--{name}", text) for name, text in options.items()}
    count = math.prod(len(values) for values in ranges.values())
    if count > _LARGEST_COUNT:
        raise UsageError(
            f"The ranges have {count:,} designs, but may have at most {_LARGEST_COUNT:,}."
        )
    if plot is not None and count == 1:
        names = " or ".join(f"--{name}" for name in ranges)
        raise UsageError(f"--plot needs a range first:last:count for {names}.")
    return ranges


def _run(
    study: str,
    ranges: _Ranges,
    derivatives: Sequence[str],
    out: Path | None,
    resume: bool,
    part: str | None,
    devices: int,
    chunk: int | None,
) -> Any:
    """Run a sweep, and return its dataset.

    The study is the name of a function in `twistorjax.examples.sweep_studies`.
    `derivatives` are the outputs that are differentiated with respect to the
    parameters.
    """
    if resume and out is None:
        raise UsageError("--resume needs --out, the folder of the sweep to resume.")
    if part is not None and out is None:
        raise UsageError("--part needs --out, the folder that all parts share.")
    pair = None if part is None else _parse_part(part)
    # `process_cpu_count` exists from Python 3.13 on.
    count_cores = getattr(os, "process_cpu_count", os.cpu_count)
    cores = count_cores() or 1
    if devices > cores:
        raise UsageError(f"--devices is {devices}, but there are {cores} CPU cores.")
    prepare_jax(accelerator=True, cpu_cores=devices)
    import jax

    from ..examples import sweep_studies
    from ..sweeps import Grid, sweep as run_sweep

    mesh = jax.make_mesh((devices,), ("designs",)) if devices > 1 else None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # `_report` prints the failures
            return run_sweep(
                getattr(sweep_studies, study),
                Grid(ranges),
                derivatives=derivatives,
                units=dict.fromkeys(ranges, "m"),
                chunk_size=chunk,
                mesh=mesh,
                store=out,
                resume=resume,
                part=pair,
                progress=sys.stderr.isatty(),
            )
    except ImportError as error:
        raise UsageError(str(error)) from None
    except ValueError as error:
        raise UsageError(_with_option_names(str(error))) from None
    except OSError as error:
        message = str(error) if error.filename else error.strerror or str(error)
        raise SolveError(_with_option_names(message)) from None


def _parse_part(text: str) -> tuple[int, int]:
    """Convert the value of --part to two integers."""
    try:
        k, n = map(int, text.split("/"))
    except ValueError:
        k, n = 0, 0
    if not 1 <= k <= n:
        raise UsageError(
            f"--part is {text}, but must be k/n, the k-th of n parts, such as 3/64."
        )
    return k, n


def _with_option_names(message: str) -> str:
    """Replace the arguments of `twistorjax.sweep` in a message by options."""
    return message.replace("`store`", "--out").replace("`resume=True`", "--resume")


def _report(
    table: Any,
    ranges: _Ranges,
    outputs: Sequence[str],
    out: Path | None,
    as_json: bool,
    plot: Path | None,
) -> None:
    """Print minimum, mean, and maximum of the outputs, and draw the outputs."""
    from ..results.codes import result_message
    from ..sweeps.dataset import NOT_COMPUTED
    from ..sweeps.sweep import failures

    derivatives = [f"{output}_by_{name}" for output in outputs for name in ranges]
    names = [*outputs, *(name for name in derivatives if name in table)]
    summary = {name: _summary(table[name]) for name in names}
    count, failed = table["succeeded"].size, failures(table)
    missing = int((table["result"] == NOT_COMPUTED).sum())
    record = {
        "designs": count,
        "missing": missing,
        "failed": sum(failed.values()),
        "failures": failed,
        "outputs": summary,
    }
    text = _text(count, missing, failed, summary)

    def draw() -> Any:
        from ..plotting.charts import draw_sweep

        constant = [name for name, values in ranges.items() if len(values) == 1]
        return draw_sweep(table.squeeze(constant), outputs)

    print_result(text, record, as_json, out=out, plot=plot, draw=draw)
    if sum(failed.values()) == count:
        raise SolveError(f"All designs failed. {result_message(next(iter(failed)))}")


def _summary(values: Any) -> dict[str, Any]:
    """Return minimum, mean, maximum, and unit of an output, ignoring failed designs."""
    numbers = {
        "minimum": float(values.min()),
        "mean": float(values.mean()),
        "maximum": float(values.max()),
    }
    summary: dict[str, Any] = {
        name: number if math.isfinite(number) else None
        for name, number in numbers.items()
    }
    summary["unit"] = values.attrs.get("units", "")
    return summary


def _text(
    count: int,
    missing: int,
    failed: Mapping[str, int],
    summary: Mapping[str, Mapping[str, Any]],
) -> str:
    """Format the number of designs, the failures by result name, and all summaries."""
    from ..results.codes import result_message

    lines = [f"{count:,} designs"]
    if missing:
        lines = [f"{count - missing:,} of {count:,} designs; others are of other parts"]
    for name, number in failed.items():
        lines.append(f"{number:,} failed, {name}: {result_message(name)}")
    lines.append(f"{'':<22}{'minimum':>12}  {'mean':>12}  {'maximum':>12}")
    for name, row in summary.items():
        cells = []
        for statistic in ("minimum", "mean", "maximum"):
            value = row[statistic]
            text = "none" if value is None else f"{value:.6g}"
            cells.append(f"{text:>12}")
        unit = "" if row["unit"] == "1" else f" {row['unit']}"
        lines.append(f"{name:<22}{'  '.join(cells)}{unit}")
    return "\n".join(lines)


def _parse_range(option: str, text: str) -> list[float]:
    """Convert the value of an option to one number or to equally spaced numbers."""
    parts = text.split(":")
    try:
        limits = [float(part) for part in parts[:2]]
        count = int(parts[2]) if len(parts) == 3 else 1
    except ValueError:
        limits, count = [], 0
    single = len(parts) == 1 and count == 1
    several = len(parts) == 3 and count >= 2
    positive = all(math.isfinite(limit) and limit > 0 for limit in limits)
    if not (single or several) or not positive:
        raise UsageError(
            f"{option} is {text}, but must be a positive number, or first:last:count "
            "with a count of at least 2, such as 0.2e-3:0.4e-3:1000."
        )
    if single:
        return limits
    if count > _LARGEST_COUNT:
        raise UsageError(
            f"{option} is {text}, but the count may be at most {_LARGEST_COUNT:,}."
        )
    first, last = limits
    return [first + (last - first) * k / (count - 1) for k in range(count)]
