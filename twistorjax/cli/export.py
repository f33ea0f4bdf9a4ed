"""`twistorjax export`: write a mechanism to a file for other programs."""

import warnings
from pathlib import Path
from typing import Annotated, Any

import typer

from .common import (
    check_folder,
    JsonOption,
    load_mechanism,
    prepare_jax,
    print_result,
    reporting_errors,
    UsageError,
)


_EXAMPLES = ("stage", "four-bar", "four-bar-leaves-and-notches")
_SUFFIXES = (".json", ".dxf", ".svg", ".py")


def export(
    mechanism: Annotated[
        str,
        typer.Argument(
            help="stage, four-bar, four-bar-leaves-and-notches, or the .json file of a "
            "model."
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            help="Output file: .json for a model, .dxf or .svg for an outline, .py for "
            "an EXUDYN script.",
            callback=check_folder,
        ),
    ],
    as_json: JsonOption = False,
) -> None:
    """Export a mechanism as a model, as an outline, or as a script for EXUDYN.

    A model may be edited and exported again. Outlines need the extra "export". A script
    has no loads and no prescribed displacements; write them into its LOADS and
    PRESCRIBED.

    Examples: twistorjax export stage --out stage.dxf

    twistorjax export my.json --out my.svg
    """
    suffix = out.suffix.lower()
    if suffix not in _SUFFIXES:
        raise UsageError(
            f"--out is {out}, but must end with one of {', '.join(_SUFFIXES)}."
        )
    if mechanism not in _EXAMPLES and not mechanism.endswith(".json"):
        raise UsageError(
            f"The mechanism is {mechanism!r}, but must be {', '.join(_EXAMPLES)}, or a "
            ".json file."
        )
    prepare_jax()
    from ..io import exudyn_script, save_mechanism, save_outline

    model = _load(mechanism)
    with reporting_errors("--out cannot be written: "):
        if suffix == ".json":
            save_mechanism(model, out)
        elif suffix == ".py":
            out.write_text(exudyn_script(model), encoding="utf-8")
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # from the dependencies of ezdxf
                save_outline(model, out)
    record = {"out": str(out), "bodies": model.names, "hinges": model.hinge_names}
    print_result(model, record, as_json, out=out)


def _load(name: str) -> Any:
    """Return the mechanism of an example, or of the model in a .json file."""
    from ..examples.four_bar import four_bar
    from ..examples.stage import microstage

    if name == "stage":
        return microstage()
    if name == "four-bar":
        return four_bar("identical")
    if name == "four-bar-leaves-and-notches":
        return four_bar("leaves-and-notches")
    return load_mechanism(name)
