"""`twistorjax modes`: the vibrations of a mechanism in a file."""

from pathlib import Path
from typing import Annotated

import typer

from .common import (
    by_name,
    check_animation,
    JsonOption,
    load_mechanism,
    MechanismFile,
    prepare_jax,
    print_result,
    reporting_errors,
    save_animation,
    UsageError,
)


def modes(
    mechanism: MechanismFile,
    as_json: JsonOption = False,
    animate: Annotated[
        Path | None,
        typer.Option(
            help="Write an animation of the mode to this file: .gif, .mp4, or .html.",
            callback=check_animation,
        ),
    ] = None,
    mode: Annotated[
        int, typer.Option(help="The mode that is animated, from 1.", min=1)
    ] = 1,
) -> None:
    """Compute the natural frequencies of a mechanism in its plane.

    The table says if there are lower ones out of the plane, unless its bodies have no
    `tilt_inertia`, or a hinge was not created from dimensions.

    Example: twistorjax modes guide.json --animate mode.gif
    """
    if mode != 1 and animate is None:
        raise UsageError("--mode needs --animate: it selects the mode of the animation.")
    prepare_jax()
    from ..solve.vibrations import vibrations

    model = load_mechanism(mechanism)
    with reporting_errors():
        found = vibrations(model)
    count = len(found.frequencies)
    if animate is not None and mode > count:
        raise UsageError(f"--mode is {mode}, but there are only {count} modes.")
    record = {
        "frequencies_Hz": found.frequencies.tolist(),
        "shapes": [by_name(found.names, shape) for shape in found.shapes],
    }
    print_result(found, record, as_json)
    if animate is not None:
        save_animation(animate, model, found, mode=mode - 1)
        if not as_json:
            print(f"animation saved to {animate}")
