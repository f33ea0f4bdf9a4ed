"""`twistorjax export`: a mechanism in files for other programs."""

import warnings
from pathlib import Path
from typing import Annotated, Any

import typer

from .common import in_json, need_folder, prepare_jax, UsageError


_CASES = ("stage", "four-bar", "mixed-four-bar")
_KINDS = (".json", ".dxf", ".svg", ".py")


def export(
    mechanism: Annotated[
        str,
        typer.Argument(
            help="stage, four-bar, mixed-four-bar, or a .json file of a model."
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            help="The file: .json a model, .dxf or .svg an outline to be cut, .py a "
            "script for EXUDYN."
        ),
    ],
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object instead of a line.")
    ] = False,
) -> None:
    """A mechanism as a model, as an outline, or as a script of another program.

    A model may be edited and exported again. Outlines need the extra "export"; a script
    has no loads and drives: write them into its GIVEN and LOADS.

    Examples: twistorjax export stage --out stage.dxf

    twistorjax export my.json --out my.svg
    """
    need_folder("--out", out)
    kind = out.suffix.lower()
    if kind not in _KINDS:
        raise UsageError(f"--out is {out}, but must end with {', '.join(_KINDS)}.")
    if mechanism not in _CASES and not mechanism.endswith(".json"):
        raise UsageError(
            f"The mechanism is {mechanism!r}, but must be {', '.join(_CASES)}, or a "
            ".json file."
        )
    prepare_jax()
    from ..io import exudyn_script, save_mechanism, save_outline

    made = _made(mechanism)
    try:
        if kind == ".json":
            save_mechanism(made, out)
        elif kind == ".py":
            out.write_text(exudyn_script(made), encoding="utf-8")
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of ezdxf's own dependencies
                save_outline(made, out)
    except (OSError, ImportError, ValueError) as error:
        raise UsageError(f"--out cannot be written: {error}") from None
    if as_json:
        record = {"out": str(out), "bodies": made.names, "hinges": made.hinge_names}
        print(in_json(record))
    else:
        print(f"{made!r}\nkept in {out}")


def _made(name: str) -> Any:
    from ..examples.four_bar import four_bar
    from ..examples.stage import microstage
    from ..io import load_mechanism

    if name == "stage":
        return microstage()
    if name in _CASES:
        return four_bar("mixed" if name.startswith("mixed") else "identical")
    try:
        return load_mechanism(name)
    except (OSError, ValueError) as error:
        raise UsageError(str(error)) from None
