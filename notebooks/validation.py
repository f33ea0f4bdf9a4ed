"""Write the manual's page on validation from the reports of the tests.

A table of errors for each part, and the figures that tests record.

pytest --junitxml=fast.xml && pytest -m slow --junitxml=slow.xml
python notebooks/validation.py fast.xml slow.xml
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any
from xml.etree import ElementTree

import matplotlib as mpl
import matplotlib.pyplot as plt
import typer


FOLDER = Path(__file__).parent

HEAD = """# Validation

The tests compare results with references that share no code with the library:
closed forms, published numbers, and other programs. In some rows the
reference is another result of the library, such as the exact beam. The error
is the largest deviation of a result from its reference, divided by the
largest reference value. For rows with "rms, worst component", it is the root
mean square of the deviations, divided by that of the reference, for the
component of the wrench with the largest error. A test fails if its error
exceeds its limit.

In the figures, lines are results of the library, and points are references.
L and t are the length and the thickness of a leaf, E I is its bending
stiffness, and P is a force. `notebooks/validation.py` writes this page from
the numbers of the tests.

"""

TAIL = """The tests also check that wrenches as derivatives of the energy
agree to rounding with the closed forms that use the matrix Λ (equations 3.53
and 4.35 of the dissertation), that the algebra agrees with that of the
package `clifford`, and that all derivatives agree with finite differences.

## A bistable leaf of rubber

Two inclined leaves of silicone rubber are the bistable element of a published
chain, in which a mechanical signal travels without fading (Raney and others,
PNAS 113, 2016; data: Daraio-lab, Neel-Bistable, CC BY 4.0). Each leaf buckles
between its ends before it snaps, so a computation without branch switching
overestimates the snap force. [Notebook 15](../15-bistable-chain.ipynb) draws
the branches. The snap forces of the authors, by experiment, by corotational
beams, and by solid elements (neo-Hookean), and the force of the branch point
here, in N:

| angle | measured | beams | solid | here |
|---|---|---|---|---|
| 22.2° | 0.0607 | 0.0211 | 0.0174 | 0.0213 |
| 26.3° | 0.0692 | 0.0264 | 0.0276 | 0.0264 |
| 32.3° | 0.0921 | 0.0331 | 0.0332 | 0.0331 |
| 34.5° | 0.1049 | 0.0353 | 0.0342 | 0.0354 |

The measured forces are almost three times as large as those of all three
computations, which have Young's modulus 0.6 MPa. The authors explain it: with
an initial *shear* modulus of 0.6 MPa, that is three times the stiffness, the
results match the experiment.

## A parallelogram under large loads

101 load cases of a parallelogram were computed with 3-D solid finite elements
in an open comparison of models (haijunsu-osu, 2026). The figure shows the
medians of the errors of the axial displacement, the transverse displacement,
and the rotation, for this library and for three other models of that
comparison. The mesh error of the 3-D elements is about 1.0, 0.6, and 1.7 %.
`twistorjax parallelogram --cases FILE` prints the numbers, and
[notebook 10](../10-flexures.ipynb) draws the figure.

![Errors of four models](../pictures/parallelogram.png)
"""


def main(
    reports: Annotated[
        list[Path], typer.Argument(help="Reports of pytest --junitxml.")
    ],
    check: Annotated[
        bool, typer.Option("--check", help="Compare the rows; write nothing.")
    ] = False,
) -> None:
    """Write `manual/validation.md`, or check its rows."""
    recorded: dict[str, list[Any]] = {"validated": [], "pictured": []}
    for report in reports:
        for entry in ElementTree.parse(report).getroot().iter("property"):
            if entry.attrib["name"] in recorded:
                value = json.loads(entry.attrib["value"])
                recorded[entry.attrib["name"]].append(value)
    rows, figures = recorded["validated"], merge(recorded["pictured"])
    if not rows:
        raise typer.BadParameter(
            f"{reports[0]} has no property `validated`: run the tests with "
            "--junitxml."
        )
    sections: dict[str, list[str]] = {}
    for row in rows:
        line = f"| {row['what']} | {row['error']:.0e} | {row['oracle']} |"
        lines = sections.setdefault(row["part"], [])
        if line not in lines:
            lines.append(line)
    text = HEAD
    for section in sorted(sections):
        text += f"## {section}\n\n"
        text += "| quantity | error | reference |\n|---|---|---|\n"
        text += "\n".join(sorted(sections[section])) + "\n\n"
        for figure in figures:
            if figure["part"] == section:
                picture = f"../pictures/{figure['name']}.svg"
                text += f"![{figure['caption']}]({picture})\n\n"
                text += f"*{figure['caption']}*\n\n"
    page = FOLDER / "manual" / "validation.md"
    if not check:
        page.write_text(text + TAIL)
        for figure in figures:
            draw(figure)
    elif _quantities(page.read_text()) != _quantities(text + TAIL):
        raise SystemExit(
            "manual/validation.md has other rows than the tests: run "
            "`python notebooks/validation.py` with the new report."
        )


def merge(figures: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Unite the curves that several tests record for the same figure.

    Points with the same label become one curve.
    """
    merged: dict[str, dict[str, Any]] = {}
    for figure in sorted(figures, key=json.dumps):
        empty = figure | {"results": {}, "references": {}}
        known = merged.setdefault(figure["name"], empty)
        known["results"] |= figure["results"]
        for label, (x, y) in figure["references"].items():
            points = known["references"].setdefault(label, ([], []))
            points[0].extend(x)
            points[1].extend(y)
    return [merged[name] for name in sorted(merged)]


def draw(figure: dict[str, Any]) -> None:
    """Write a picture: results as lines, and references as points."""
    x_label, y_label = figure["axes"]
    _, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    for label, curve in figure["results"].items():
        style, order = ("--", 3) if "dashed" in label else ("-", 2)
        axes.plot(*curve, style, zorder=order, label=label)
    markers = zip("os^", figure["references"].items(), strict=False)
    for marker, (label, points) in markers:
        axes.plot(*points, f"k{marker}", mfc="none", ms=5, label=label)
    if "logarithmic" in y_label:
        axes.set_yscale("log")
    axes.set(xlabel=x_label, ylabel=y_label)
    save(axes, figure["name"])


def save(axes: plt.Axes, name: str) -> None:
    """Write a picture with a legend; the same numbers give the same bytes."""
    axes.grid(alpha=0.3)
    figure = axes.get_figure()
    figure.legend(loc="outside right upper", fontsize="small")
    with mpl.rc_context({"svg.hashsalt": "0", "svg.fonttype": "none"}):
        path = FOLDER / "pictures" / f"{name}.svg"
        figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def _quantities(text: str) -> list[str]:
    """Return the first columns of tables, and the figures; errors differ."""
    return [
        line.split("|")[1] if line.startswith("| ") else line
        for line in text.splitlines()
        if line.startswith(("| ", "!["))
    ]


if __name__ == "__main__":
    typer.run(main)
