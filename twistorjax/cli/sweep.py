"""`twistorjax sweep`: the stage and the linkage over ranges of their dimensions."""

import json
import math
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from .common import need_folder, need_picture, prepare_jax, save, SolveError, UsageError


sweep = typer.Typer()


@sweep.callback(invoke_without_command=True)
def overview(context: typer.Context) -> None:
    """Answers over ranges of dimensions, such as 0.2e-3:0.4e-3:1000.

    Example: twistorjax sweep stage --web 0.2e-3:0.4e-3:1000 --plot gain.png
    """
    if context.invoked_subcommand is None:
        print(context.get_help())


_MOST = 10_000_000

_Out = Annotated[
    Path | None, typer.Option(help="Keep them in this folder, chunk by chunk (zarr).")
]
_Resume = Annotated[
    bool, typer.Option("--resume", help="Go on with that folder, from what it has.")
]
_Devices = Annotated[
    int, typer.Option(help="Share the designs among so many cores of this machine.")
]
_Chunk = Annotated[int | None, typer.Option(help="Designs that are taken at once.")]
_Json = Annotated[
    bool, typer.Option("--json", help="Print one JSON object instead of a table.")
]
_Plot = Annotated[Path | None, typer.Option(help="Draw the answers into this file.")]


@sweep.command()
def stage(
    web: Annotated[
        str, typer.Option(help="Thickness of the necks: lowest:highest:count; m.")
    ] = "0.2e-3:0.4e-3:1000",
    hole: Annotated[
        str, typer.Option(help="Diameter of the holes, likewise; m.")
    ] = "3e-3",
    out: _Out = None,
    resume: _Resume = False,
    devices: _Devices = 1,
    chunk: _Chunk = None,
    as_json: _Json = False,
    plot: _Plot = None,
) -> None:
    """The gain of the micropositioning stage, with its exact derivatives.

    Example: twistorjax sweep stage --web 0.2e-3:0.4e-3:10000 --out stage.zarr
    """
    ranges = {"web": _range("--web", web), "hole": _range("--hole", hole)}
    asked = _Asked(ranges, out, resume, devices, chunk, as_json, plot)
    _tell(asked, _swept(asked, "stage_gain", ("gain",)), ("gain",))


@sweep.command("four-bar")
def four_bar(
    length: Annotated[
        str, typer.Option(help="Length of the leaves: lowest:highest:count; m.")
    ] = "12e-3:16e-3:20",
    thickness: Annotated[
        str, typer.Option(help="Thickness of the leaves, likewise; m.")
    ] = "0.8e-3:1.2e-3:20",
    out: _Out = None,
    resume: _Resume = False,
    devices: _Devices = 1,
    chunk: _Chunk = None,
    as_json: _Json = False,
    plot: _Plot = None,
) -> None:
    """The driven four-bar linkage of like leaves: its travel, moment and frequency.

    Example: twistorjax sweep four-bar --length 12e-3:16e-3:50 --thickness 1e-3
    """
    ranges = {
        "length": _range("--length", length),
        "thickness": _range("--thickness", thickness),
    }
    asked = _Asked(ranges, out, resume, devices, chunk, as_json, plot)
    answers = ("travel", "moment", "frequency")
    _tell(asked, _swept(asked, "driven_linkage", ()), answers)


class _Asked(NamedTuple):
    """What both commands are asked for."""

    ranges: Mapping[str, list[float]]
    out: Path | None
    resume: bool
    devices: int
    chunk: int | None
    as_json: bool
    plot: Path | None

    @property
    def alone(self) -> list[str]:
        """What has one value alone."""
        return [axis for axis, row in self.ranges.items() if len(row) == 1]


def _swept(asked: _Asked, study: str, derivatives: Sequence[str]) -> Any:
    """The table of a study, called by its name."""
    need_folder("--out", asked.out)
    if (count := math.prod(map(len, asked.ranges.values()))) > _MOST:
        raise UsageError(f"These are {count:,} designs, but may be at most {_MOST:,}.")
    need_picture("--plot", asked.plot)
    if asked.plot is not None and len(asked.alone) == len(asked.ranges):
        options = " or ".join(f"--{axis}" for axis in asked.ranges)
        raise UsageError(f"--plot draws answers over a range: give one to {options}.")
    if asked.resume and asked.out is None:
        raise UsageError("--resume goes on with the folder of --out: give that, too.")
    if asked.devices < 1 or (asked.chunk is not None and asked.chunk < 1):
        raise UsageError("--devices and --chunk must be at least 1.")
    if asked.devices > (cores := len(os.sched_getaffinity(0))):
        raise UsageError(f"--devices is {asked.devices}, but there are {cores} cores.")
    prepare_jax(asked.devices)
    import jax

    from ..examples import sweep_studies
    from ..sweeps import Grid, sweep as over

    mesh = None
    if asked.devices > 1:
        mesh = jax.make_mesh((asked.devices,), ("designs",))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # counted in what is told
            return over(
                getattr(sweep_studies, study),
                Grid(asked.ranges),
                derivatives=derivatives,
                units=dict.fromkeys(asked.ranges, "m"),
                chunk=asked.chunk,
                mesh=mesh,
                store=asked.out,
                resume=asked.resume,
                progress=sys.stderr.isatty(),
            )
    except ImportError as error:
        raise UsageError(str(error)) from None
    except ValueError as error:
        raise UsageError(_as_options(str(error))) from None
    except OSError as error:
        text = str(error) if error.filename else error.strerror or str(error)
        raise SolveError(_as_options(text)) from None


def _as_options(message: str) -> str:
    """A message of the library, with options in place of arguments."""
    return message.replace("`store`", "--out").replace("`resume=True`", "--resume")


def _tell(asked: _Asked, table: Any, answers: Sequence[str]) -> None:
    """Prints what is lowest, mean and highest, and draws it."""
    if asked.plot is not None:
        from ..plotting.charts import chart

        save(asked.plot, lambda: chart(table.squeeze(asked.alone), answers))
    told = {}
    slopes = [f"{answer}_by_{axis}" for answer in answers for axis in asked.ranges]
    for name in (*answers, *(slope for slope in slopes if slope in table)):
        values = table[name]
        told[name] = {
            "lowest": _number(values.min()),
            "mean": _number(values.mean()),
            "highest": _number(values.max()),
            "unit": values.attrs.get("units", ""),
        }
    from ..solve.results import result_message
    from ..sweeps.sweep import failures

    count, failed = table["succeeded"].size, failures(table)
    if asked.as_json:
        none = sum(failed.values())
        record = {"designs": count, "failed": none, "why": failed, "answers": told}
        print(json.dumps(record))
    else:
        _print(asked, count, failed, told)
    if sum(failed.values()) == count:
        raise SolveError(f"No design has an answer. {result_message(next(iter(failed)))}")


def _print(
    asked: _Asked, count: int, failed: Mapping[str, int], told: Mapping[str, Any]
) -> None:
    """A table, and how many designs have no answer, and why."""
    from ..solve.results import result_message

    print(f"{count:,} designs")
    for name, number in failed.items():
        print(f"{number:,} without an answer, {name}: {result_message(name)}")
    print(f"{'':<22}{'lowest':>12}  {'mean':>12}  {'highest':>12}")
    for name, row in told.items():
        cells = (row["lowest"], row["mean"], row["highest"])
        texts = ("none" if cell is None else f"{cell:.6g}" for cell in cells)
        numbers = "  ".join(f"{text:>12}" for text in texts)
        unit = "" if row["unit"] == "1" else f" {row['unit']}"
        print(f"{name:<22}{numbers}{unit}")
    if asked.out is not None:
        print(f"kept in {asked.out}")
    if asked.plot is not None:
        print(f"drawn to {asked.plot}")


def _number(value: Any) -> float | None:
    number = float(value)
    return number if math.isfinite(number) else None


def _range(option: str, given: str) -> list[float]:
    """The values of a range, or the one that is given."""
    parts = given.split(":")
    try:
        numbers = [float(part) for part in parts[:2]]
        count = int(parts[2]) if len(parts) == 3 else 1
    except ValueError:
        numbers, count = [], 0
    fine = len(parts) in (1, 3) and all(math.isfinite(n) and n > 0 for n in numbers)
    if not fine or count < 1 or (len(parts) == 3 and count < 2):
        raise UsageError(
            f"{option} is {given}, but must be a positive number, or two and how many "
            "from the one to the other: 0.2e-3:0.4e-3:1000."
        )
    if len(parts) == 1:
        return numbers
    if count > _MOST:
        raise UsageError(f"{option} is {given}, but may have at most {_MOST:,} values.")
    low, high = numbers
    return [low + (high - low) * k / (count - 1) for k in range(count)]
