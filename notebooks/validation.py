"""Writes the manual's report from what the tests found.

pytest --junitxml=found.xml && python notebooks/validation.py found.xml
"""

import json
from pathlib import Path
from typing import Annotated
from xml.etree import ElementTree

import typer


HEAD = """# Validation

What the tests find, beside an oracle that shares no code with the library: a closed
form, a published number, another program. The error is the largest of a row's numbers,
over the largest of them, unless it says otherwise; a test fails where it exceeds its
limit. Written by `notebooks/validation.py` from the tests' own numbers.

"""

TAIL = """Besides, wrenches as derivatives of the energy, and the closed forms with the Λ
matrix (equations 3.53 and 4.35 of the dissertation), agree to rounding at random poses;
the algebra agrees with the package `clifford`; derivatives of every kind agree with
differences of another solve. `pytest` runs it all.
"""


def main(
    found: Annotated[Path, typer.Argument(help="What pytest wrote by --junitxml.")],
    check: Annotated[
        bool, typer.Option("--check", help="Whether its rows are those of the report.")
    ] = False,
) -> None:
    """Writes `manual/validation.md`, or looks whether it has a row for each number."""
    root = ElementTree.parse(found).getroot()
    rows = [
        json.loads(kept.attrib["value"])
        for kept in root.iter("property")
        if kept.attrib["name"] == "validated"
    ]
    if not rows:
        raise typer.BadParameter(f"{found} has no property `validated`: run all tests.")
    parts: dict[str, list[str]] = {}
    for row in rows:
        line = f"| {row['what']} | {row['error']:.0e} | {row['oracle']} |"
        lines = parts.setdefault(row["part"], [])
        if line not in lines:
            lines.append(line)
    text = HEAD
    for part in sorted(parts):
        text += f"## {part}\n\n| what | error | oracle |\n|---|---|---|\n"
        text += "\n".join(sorted(parts[part])) + "\n\n"
    report = Path(__file__).parent / "manual" / "validation.md"
    if not check:
        report.write_text(text + TAIL)
    elif _names(report.read_text()) != _names(text):
        raise SystemExit("The report has other rows than the tests tell: write it again.")


def _names(text: str) -> list[str]:
    """What was validated: errors by rounding differ from machine to machine."""
    return [line.split("|")[1] for line in text.splitlines() if line.startswith("| ")]


if __name__ == "__main__":
    typer.run(main)
