"""Command that runs all benchmarks and prints a table: `python -m benchmarks --help`."""

import datetime
import importlib.metadata
import json
import os
import platform
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import jax
import typer
from rich.console import Console
from rich.table import Table

from . import (
    analyses,
    chains,
    condensed,
    first_calls,
    identification,
    lattices,
    leaves,
    motion,
    paths,
    peers,
    peers_chains,
    peers_identification,
    peers_motion,
    peers_out_of_plane,
    statics,
    sweeps,
)
from .measure import Row


MODULES = {
    module.__name__.rpartition(".")[2]: module
    for module in (
        statics, peers, chains, peers_chains, leaves, condensed, peers_out_of_plane,
        motion, peers_motion, lattices, paths, identification, peers_identification,
        sweeps, first_calls, analyses,
    )
}  # fmt: skip
PACKAGES = ("jax", "jaxlib", "equinox", "diffrax", "numpy", "exudyn")
HEADINGS = ("benchmark", "result", "unit", "goal", "reached")


def main(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MODULES]...",
            help=f"Modules to run: {', '.join(MODULES)}. The default is all.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Also save the table as .md and .json files of this name. Results of "
            "other machines in these files are kept."
        ),
    ] = None,
    page: Annotated[
        Path | None,
        typer.Option(
            "--table",
            help="Also write the page of the manual with the times of `analyses`.",
        ),
    ] = None,
) -> None:
    """Measure the times and errors of twistorjax and of other programs, in one run."""
    # The sweeps run in a process of their own, which needs memory of the accelerator.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    table = Table(*HEADINGS)
    rows: list[Row] = []

    def add(row: Row) -> None:
        rows.append(row)
        table.add_row(*format_row(row))

    if unknown := sorted(set(names or ()) - set(MODULES)):
        raise typer.BadParameter(f"There is no module {', '.join(unknown)}.")
    modules = [MODULES[name] for name in names or MODULES]
    if page is not None and analyses not in modules:
        raise typer.BadParameter("`--table` needs the module `analyses`.")
    for module in modules:
        for row in module.run():
            add(row)
    for module in (motion, sweeps, identification):
        if module in modules:
            for row in module.ratios(rows):
                add(row)
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    machine = (
        f"{os.cpu_count()} cores, {platform.machine()}, {jax.devices()[0].device_kind}"
    )
    table.caption = (
        f"measured on {machine}; {datetime.date.today()}; "
        f"{', '.join(f'{name} {version}' for name, version in versions.items())}"
    )
    Console(width=110).print(table)
    if page is not None:
        page.write_text(analyses.to_markdown(rows, str(table.caption)), "utf-8")
    if out is not None:
        record = {
            "caption": str(table.caption),
            "date": str(datetime.date.today()),
            "versions": versions,
            "rows": [asdict(row) for row in rows],
        }
        save(machine, record, out)


def format_row(row: Row) -> tuple[str, ...]:
    """Format the cells of a row of the table."""
    value = f"{row.value:,.0f}" if row.value >= 1000 else f"{row.value:.4g}"
    reached = {None: "", True: "yes", False: "NO"}[row.reached]
    return row.benchmark, value, row.unit, row.goal, reached


def save(machine: str, record: dict[str, Any], out: Path) -> None:
    """Save the results of a machine. Its earlier results in the files are replaced."""
    file = out.with_suffix(".json")
    records = json.loads(file.read_text("utf-8")) if file.exists() else {}
    records[machine] = record
    file.write_text(json.dumps(records, indent=1, ensure_ascii=False) + "\n", "utf-8")
    out.with_suffix(".md").write_text(to_markdown(records), "utf-8")


def to_markdown(records: dict[str, Any]) -> str:
    """Format the results of all machines as Markdown tables."""
    parts = ["# Benchmarks"]
    for machine, record in records.items():
        lines = [f"| {' | '.join(HEADINGS)} |", "|---|---:|---|---|---|"]
        lines += [f"| {' | '.join(format_row(Row(**row)))} |" for row in record["rows"]]
        parts += [f"## {machine}", record["caption"], "\n".join(lines)]
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    typer.run(main)
