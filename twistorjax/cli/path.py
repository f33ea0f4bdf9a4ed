"""`twistorjax path`: stable and unstable equilibria of a mechanism in a file."""

from typing import Annotated, Any

import typer

from .common import (
    by_name,
    JsonOption,
    load_mechanism,
    MechanismFile,
    PlotOption,
    prepare_jax,
    print_result,
    reporting_errors,
    SolveError,
    UsageError,
)
from .solve import DriveOption, inputs, LoadOption


def path(
    mechanism: MechanismFile,
    load: LoadOption = None,
    drive: DriveOption = None,
    over: Annotated[
        str | None,
        typer.Option(
            help="Coordinate of a body that is drawn: BODY:x, BODY:y, or BODY:angle. By "
            "default the translation that is largest."
        ),
    ] = None,
    as_json: JsonOption = False,
    plot: PlotOption = None,
) -> None:
    """Follow the equilibria of a mechanism while its loads grow, also the unstable ones.

    Loads and prescribed displacements are multiplied by a factor, which begins at 0 and
    ends at -1 or 1. Limit points, at which the mechanism snaps through, and branch
    points, at which it buckles, are listed.

    Example: twistorjax path switch.json --load shuttle:0,-20 --plot switch.png
    """
    if over is not None and plot is None:
        raise UsageError("--over needs --plot: it selects the coordinate of the figure.")
    prepare_jax()
    from ..plotting.path_plots import draw_path
    from ..solve.path import path as follow

    model = load_mechanism(mechanism)
    loads, drives = inputs(load, drive)
    failure = None
    with reporting_errors():
        try:
            found = follow(model, loads=loads, drives=drives)
        except RuntimeError as error:
            # What was found before the failure is shown.
            found = follow(model, loads=loads, drives=drives, throw=False)
            if len(found.load_factors) < 2:
                raise
            failure = error
    body, coordinate = _drawn(found, over)
    critical = [
        {
            "kind": point.kind,
            "load_factor": float(point.load_factor),
            "displacements": by_name(found.names, point.displacements),
        }
        for point in found.critical_points
    ]
    record = {
        "load_factors": found.load_factors.tolist(),
        "stable": found.stable.tolist(),
        "displacements": [by_name(found.names, at) for at in found.displacements],
        "critical_points": critical,
    }
    print_result(
        found, record, as_json, plot=plot,
        draw=lambda: draw_path(found, body, coordinate),
    )  # fmt: skip
    if failure is not None:
        raise SolveError(str(failure))


def _drawn(found: Any, over: str | None) -> tuple[str, Any]:
    """Return the body and the coordinate that are drawn."""
    import numpy as np

    from ..mechanism.mechanism import COORDINATES

    if over is None:
        largest = np.max(np.abs(found.displacements[..., 1:]), axis=0)
        row, column = np.unravel_index(np.argmax(largest), largest.shape)
        return found.names[row], COORDINATES[1 + column]
    body, _, coordinate = over.rpartition(":")
    if body not in found.names or coordinate not in COORDINATES:
        raise UsageError(
            f"--over is {over!r}, but must be BODY:x, BODY:y, or BODY:angle, with one of "
            f"the bodies {', '.join(found.names)}."
        )
    return body, coordinate
