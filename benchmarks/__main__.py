"""Prints the table, and keeps it as JSON where asked: `python -m benchmarks --help`."""

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
    chains,
    command,
    identification,
    leaves,
    motion,
    peers,
    peers_chains,
    peers_identification,
    peers_motion,
    statics,
    sweeps,
)
from .measure import Row


PACKAGES = ("jax", "jaxlib", "equinox", "diffrax", "numpy", "exudyn")


def main(
    out: Annotated[
        Path | None,
        typer.Option(help="Keep the table here, by kinds of machines: .md, and .json."),
    ] = None,
) -> None:
    """Times twistorjax beside its peers, in one run."""
    jax.config.update("jax_enable_x64", True)
    table = Table("what", "measured", "", "asked", "met")
    rows: list[Row] = []

    def keep(row: Row) -> None:
        rows.append(row)
        table.add_row(*cells(row))

    parts = (
        statics, peers, chains, peers_chains, leaves, motion, peers_motion,
        identification, peers_identification, sweeps, command,
    )  # fmt: skip
    for part in parts:
        for row in part.run():
            keep(row)
    for part in (motion, identification):
        for row in part.beside(rows):
            keep(row)
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
        f"medians on {machine}; {datetime.date.today()}; "
        f"{', '.join(f'{name} {version}' for name, version in versions.items())}"
    )
    Console(width=110).print(table)
    if out is not None:
        record = {
            "caption": str(table.caption),
            "date": str(datetime.date.today()),
            "versions": versions,
            "rows": [asdict(row) for row in rows],
        }
        keep_for(machine, record, out)


def cells(row: Row) -> tuple[str, ...]:
    """A row as it is printed."""
    value = f"{row.value:,.0f}" if row.value >= 1000 else f"{row.value:.4g}"
    met = {None: "", True: "yes", False: "NO"}[row.met]
    return row.what, value, row.unit, row.asked, met


def keep_for(machine: str, record: dict[str, Any], out: Path) -> None:
    """Puts what one kind of machine gave in the place of what it gave before."""
    beside = out.with_suffix(".json")
    told = json.loads(beside.read_text()) if beside.exists() else {}
    told[machine] = record
    beside.write_text(json.dumps(told, indent=1) + "\n")
    parts = ["# Benchmarks"]
    for name, each in told.items():
        lines = ["| what | measured | | asked | met |", "|---|---:|---|---|---|"]
        lines += [f"| {' | '.join(cells(Row(**row)))} |" for row in each["rows"]]
        parts += [f"## {name}", each["caption"], "\n".join(lines)]
    out.with_suffix(".md").write_text("\n\n".join(parts) + "\n")


if __name__ == "__main__":
    typer.run(main)
