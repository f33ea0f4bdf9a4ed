"""`twistorjax solve`: the equilibrium of a mechanism in a file."""

from typing import Annotated, Any

import typer

from .common import (
    by_name,
    check_positive,
    JsonOption,
    load_mechanism,
    MechanismFile,
    PlotOption,
    prepare_jax,
    print_result,
    reporting_errors,
    UsageError,
)


LoadOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Force (N) on a body at its origin, and a moment (N m): BODY:FX,FY or "
        "BODY:FX,FY,MOMENT. It may be repeated."
    ),
]
DriveOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Prescribed displacement of a body (rad, m, m): BODY:x=1e-3 or "
        "BODY:angle=0,y=1e-3. It may be repeated."
    ),
]


def solve(
    mechanism: MechanismFile,
    load: LoadOption = None,
    drive: DriveOption = None,
    as_json: JsonOption = False,
    plot: PlotOption = None,
    magnify: Annotated[
        float,
        typer.Option(
            help="Factor on the displacements that are drawn.", callback=check_positive
        ),
    ] = 1.0,
) -> None:
    """Compute the equilibrium of a mechanism under loads and prescribed displacements.

    Example: twistorjax solve guide.json --load table:5,0 --plot guide.png --magnify 10
    """
    if magnify != 1.0 and plot is None:
        raise UsageError("--magnify needs --plot: it enlarges the drawn displacements.")
    prepare_jax()
    from ..solve.equilibrium import equilibrium

    model = load_mechanism(mechanism)
    loads, drives = inputs(load, drive)
    with reporting_errors():
        solution = equilibrium(model, loads=loads, drives=drives)
    record: dict[str, Any] = {
        "displacements": by_name(solution.names, solution.displacements),
        "reactions": by_name(solution.names, solution.reactions),
        "energy_J": float(solution.energy),
    }
    if solution.stresses is not None:
        largest = solution.stresses.largest
        record["stresses_Pa"] = by_name(solution.stresses.names, largest)
    print_result(
        solution, record, as_json, plot=plot,
        draw=lambda: draw_solution(model, solution, loads, magnify),
    )  # fmt: skip


def draw_solution(
    mechanism: Any, solution: Any, loads: list, magnify: float = 1.0
) -> Any:
    """Draw an equilibrium with its loads, colored by the stress if it is known."""
    from ..plotting.drawing import draw

    color = None if solution.stresses is None else "stress"
    return draw(mechanism, solution, magnify=magnify, loads=loads, color=color)


def inputs(load: list[str] | None, drive: list[str] | None) -> tuple[list, list]:
    """Return the loads and the drives that the options describe."""
    with reporting_errors("--load: "):
        loads = [_load(text) for text in load or ()]
    with reporting_errors("--drive: "):
        drives = [_drive(text) for text in drive or ()]
    return loads, drives


def _load(text: str) -> Any:
    """Read BODY:FX,FY or BODY:FX,FY,MOMENT."""
    from ..mechanism.loads import Load

    body, _, values = text.rpartition(":")
    numbers = [_number(text, value) for value in values.split(",")]
    if not body or len(numbers) not in (2, 3):
        raise UsageError(
            f"--load is {text!r}, but must be BODY:FX,FY or BODY:FX,FY,MOMENT, such as "
            "table:5,0."
        )
    return Load(body, force=numbers[:2], moment=numbers[2] if numbers[2:] else 0.0)


def _drive(text: str) -> Any:
    """Read BODY:COORDINATE=VALUE,COORDINATE=VALUE."""
    from ..mechanism.loads import Drive
    from ..mechanism.mechanism import COORDINATES

    body, _, values = text.rpartition(":")
    pairs = [value.partition("=") for value in values.split(",")]
    names = [name for name, _, _ in pairs]
    known = set(names) <= set(COORDINATES) and len(set(names)) == len(names)
    if not body or not known:
        raise UsageError(
            f"--drive is {text!r}, but must be BODY:x=1e-3, with each of angle (rad), x, "
            "and y (m) at most once."
        )
    return Drive(body, **{name: _number(text, value) for name, _, value in pairs})


def _number(text: str, value: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise UsageError(f"{text!r} has {value!r} where a number is needed.") from None
