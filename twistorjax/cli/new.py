"""`twistorjax new`: files to begin with."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from .common import check_folder, reporting_errors, UsageError


_STARTERS = Path(__file__).with_name("starters")


def new(
    mechanism: Annotated[
        Literal["folded-guide"], typer.Argument(help="The mechanism to begin with.")
    ],
    out: Annotated[
        Path, typer.Option(help="The folder of the files.", callback=check_folder)
    ] = Path(),
) -> None:
    """Write a commented script and a .json file of a mechanism, to be changed.

    The script computes displacements, stresses, vibrations, and stiffness, and draws a
    figure. The other commands read the .json file.

    Example: twistorjax new folded-guide
    """
    texts = {
        out / f"{mechanism}{suffix}": (_STARTERS / f"{mechanism}{source}").read_text()
        for suffix, source in ((".py", ".txt"), (".json", ".json"))
    }
    for path in texts:
        if path.exists():
            raise UsageError(
                f"{path} exists. Remove it, or give another folder as --out."
            )
    with reporting_errors("--out cannot be written: "):
        out.mkdir(exist_ok=True)
        for path, text in texts.items():
            path.write_text(text, encoding="utf-8")
    script, model = texts
    print(f"saved to {script} and {model}")
    print(f"next: python {script}, or twistorjax report {model} --load table:2,0")
