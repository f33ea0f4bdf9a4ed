"""`twistorjax four-bar`: the linkages of chapter 5 in motion."""

import math
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import typer

from .common import (
    finished,
    in_json,
    meter,
    need_choice,
    need_energy,
    need_picture,
    prepare_jax,
    save,
    UsageError,
)


def four_bar(
    hinges: Annotated[
        str, typer.Option(help="identical (section 5.2) or mixed (section 5.3).")
    ] = "identical",
    energy: Annotated[
        str, typer.Option(help="Coordinates of the hinges' energy: twistor or twist.")
    ] = "twistor",
    damping_time: Annotated[
        float | None,
        typer.Option(help="Damping over stiffness; s. [default: 1e-3; released 1e-4]"),
    ] = None,
    times: Annotated[
        str | None,
        typer.Option(help="When to tell the motion, as 0.045,0.09,0.135; s."),
    ] = None,
    release: Annotated[
        float | None,
        typer.Option(help="Let it go with this speed of link 3 along x; m/s."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object instead of a table.")
    ] = False,
    plot: Annotated[
        Path | None, typer.Option(help="Draw it at (ten of) these times into this file.")
    ] = None,
    animate: Annotated[
        Path | None, typer.Option(help="Draw it moving: a .gif, .mp4 or .html file.")
    ] = None,
) -> None:
    """The flexural four-bar linkages of chapter 5: driven by link 2, or let go.

    Examples: twistorjax four-bar --hinges mixed --plot panels.png

    twistorjax four-bar --release 10 --times 0.05,0.1 --json
    """
    kind = need_choice("--hinges", hinges, ("identical", "mixed"))
    coordinates = need_energy(energy)
    if damping_time is not None and not (
        math.isfinite(damping_time) and damping_time >= 0
    ):
        raise UsageError(
            f"--damping-time is {damping_time:g}, but must be zero or positive; s."
        )
    if release is not None and not math.isfinite(release):
        raise UsageError(f"--release is {release:g}, but must be finite; m/s.")
    need_picture("--plot", plot)
    need_picture("--animate", animate, film=True)
    asked = _times(times)
    prepare_jax()
    import equinox as eqx

    from ..examples import four_bar as case

    if asked is None:
        asked = list(case.PANELS)
        if release is not None:
            asked = [0.02 * k for k in range(10)]
    damping = damping_time
    if damping is None:
        damping = case.DRIVEN_DAMPING if release is None else case.RELEASED_DAMPING
    # as one program, not as a hundred small ones to compile
    linkage = eqx.filter_jit(case.four_bar)(
        kind, coordinates=coordinates, damping=damping
    )

    def move(instants: list[float]):
        settings = {"tolerance": 1e-9, "throw": False, "progress_meter": meter()}
        if release is None:
            motion = case.drive(linkage, instants, **settings)
        else:
            motion = case.release(linkage, instants, release, **settings)
        return finished(motion)

    # a motion begins at zero, whether or not that time was asked for
    added = asked[0] > 0
    motion = move([0.0, *asked] if added else asked)
    if plot is not None:
        save(plot, lambda: case.plot(linkage, motion))
    if animate is not None:
        end = asked[-1]
        _film(animate, linkage, move([end * k / 100 for k in range(101)]))
    rows = slice(1 if added else 0, None)
    print(_motion_json(motion, rows) if as_json else _motion_table(motion, rows))


def _times(given: str | None) -> list[float] | None:
    if given is None:
        return None
    try:
        values = [float(part) for part in given.split(",")]
    except ValueError:
        raise UsageError(
            f"--times is {given!r}, but must be numbers between commas: 0.045,0.09; s."
        ) from None
    if not all(math.isfinite(value) and value >= 0 for value in values):
        raise UsageError(f"--times is {given!r}, but must be finite and not negative; s.")
    if any(late <= early for early, late in pairwise(values)):
        raise UsageError(f"--times is {given!r}, but must increase; s.")
    if values == [0.0]:
        raise UsageError("--times is 0, when nothing has moved: give a later one, too.")
    return values


def _motion_json(motion, rows: slice) -> str:
    def by_link(values) -> dict[str, list]:
        return {name: values[rows, row].tolist() for row, name in enumerate(motion.names)}

    return in_json(
        {
            "times": motion.times[rows].tolist(),
            "poses": by_link(motion.poses),
            "reactions": by_link(motion.reactions),
            "steps": int(motion.steps),
            "result": "successful",
        }
    )


def _motion_table(motion, rows: slice) -> str:
    heads = ("time (s)", "angle of 2", "angle of 3", "angle of 4", "x of 3", "y of 3")
    lines = ["  ".join(f"{head:>11}" for head in (*heads, "moment on 2"))]
    lines.append("  ".join(f"{unit:>11}" for unit in ("", *3 * ["rad"], "m", "m", "N m")))
    angles = [motion.displacement(link)[rows, 0] for link in "234"]
    columns = (
        motion.times[rows],
        *angles,
        *motion.displacement("3")[rows, 1:].T,
        motion.reaction("2")[rows, 0],
    )
    for row in zip(*columns, strict=True):
        lines.append("  ".join(f"{float(value):>11.6g}" for value in row))
    return "\n".join([*lines, f"{int(motion.steps)} steps"])


def _film(path: Path, mechanism, motion) -> None:
    from ..plotting.animation import animate

    film = animate(mechanism, motion, slower=10)
    try:
        kind = path.suffix.lower()
        if kind == ".html":
            path.write_text(film.to_jshtml(), encoding="utf-8")
        else:
            writer = "pillow" if kind == ".gif" else "ffmpeg"
            film.save(path, writer=writer, dpi=100)
    except (OSError, ValueError) as error:
        raise UsageError(f"--animate cannot be written: {error}") from None
