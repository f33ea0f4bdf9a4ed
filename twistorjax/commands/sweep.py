"""`twistorjax sweep`: the stage and the linkage over ranges of their dimensions."""

import json
import math
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from .common import need_folder, prepare_jax, Refused, save


sweep = typer.Typer(
    help="Answers over ranges of dimensions, such as 0.2e-3:0.4e-3:1000.",
    no_args_is_help=True,
)

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
    _run(
        "stage_gain",
        ranges,
        ("gain",),
        ("gain",),
        out,
        resume,
        devices,
        chunk,
        as_json,
        plot,
    )


@sweep.command("four-bar")
def four_bar(
    length: Annotated[
        str, typer.Option(help="Length of the leaves: lowest:highest:count; m.")
    ] = "8e-3:12e-3:20",
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

    Example: twistorjax sweep four-bar --length 8e-3:12e-3:50 --thickness 1e-3
    """
    ranges = {
        "length": _range("--length", length),
        "thickness": _range("--thickness", thickness),
    }
    answers = ("travel", "moment", "frequency")
    _run(
        "driven_linkage", ranges, answers, (), out, resume, devices, chunk, as_json, plot
    )


def _run(
    name: str,
    ranges: Mapping[str, list[float]],
    answers: Sequence[str],
    derivatives: Sequence[str],
    out: Path | None,
    resume: bool,
    devices: int,
    chunk: int | None,
    as_json: bool,
    plot: Path | None,
) -> None:
    need_folder("--out", out)
    need_folder("--plot", plot)
    if resume and out is None:
        raise Refused("--resume goes on with the folder of --out: give that, too.")
    if devices < 1 or (chunk is not None and chunk < 1):
        raise Refused("--devices and --chunk must be at least 1.")
    prepare_jax(devices)
    import jax

    try:
        import xarray
        import zarr
    except ImportError:
        raise Refused(
            'sweeps need zarr and xarray: pip install "twistorjax[data]".'
        ) from None
    del xarray, zarr
    from ..cases import designs
    from ..sweeps import Grid, sweep as over

    study: Callable[[Any], Any] = getattr(designs, name)
    grid = Grid(ranges)
    start = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # counted below
            table = over(
                study,
                grid,
                derivatives=derivatives,
                units=dict.fromkeys(ranges, "m"),
                chunk=chunk,
                mesh=jax.make_mesh((devices,), ("designs",)) if devices > 1 else None,
                store=out,
                resume=resume,
                progress=sys.stderr.isatty(),
            )
    except ValueError as error:
        text = str(error).replace("`store`", "--out").replace("`resume=True`", "--resume")
        raise Refused(text) from None
    seconds = time.perf_counter() - start
    if plot is not None:
        from ..show.charts import chart

        flat = table.squeeze([axis for axis, row in ranges.items() if len(row) == 1])
        save(plot, lambda: chart(flat, answers))
    count, fine = table["succeeded"].size, int(table["succeeded"].sum())
    told = {}
    slopes = [f"{answer}_by_{axis}" for answer in derivatives for axis in ranges]
    for answer in (*answers, *slopes):
        values = table[answer]
        told[answer] = {
            "lowest": _number(values.min()),
            "mean": _number(values.mean()),
            "highest": _number(values.max()),
            "unit": values.attrs.get("units", ""),
        }
    if as_json:
        summary = {"designs": count, "failed": count - fine, "seconds": seconds}
        print(json.dumps({**summary, "answers": told}))
        return
    failed = f", {count - fine:,} without an answer" if fine < count else ""
    print(f"{count:,} designs in {seconds:.1f} s{failed}")
    print(f"{'':<22}{'lowest':>12}  {'mean':>12}  {'highest':>12}")
    for answer, row in told.items():
        cells = (row["lowest"], row["mean"], row["highest"])
        numbers = "  ".join(
            "none".rjust(12) if c is None else f"{c:>12.6g}" for c in cells
        )
        unit = "" if row["unit"] == "1" else f" {row['unit']}"
        print(f"{answer:<22}{numbers}{unit}")
    if out is not None:
        print(f"kept in {out}")
    if plot is not None:
        print(f"drawn to {plot}")


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
        raise Refused(
            f"{option} is {given}, but must be a positive number, or two and how many "
            "from the one to the other: 0.2e-3:0.4e-3:1000."
        )
    if len(parts) == 1:
        return numbers
    low, high = numbers
    return [low + (high - low) * k / (count - 1) for k in range(count)]
