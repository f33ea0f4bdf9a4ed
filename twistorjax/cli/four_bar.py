"""`twistorjax four-bar`: simulate the four-bar linkages of chapter 5."""

import math
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer

from .common import (
    check_animation,
    check_finite,
    EnergyOption,
    JsonOption,
    PlotOption,
    prepare_jax,
    print_result,
    progress_bar,
    require_success,
    save_animation,
    save_figure,
    UsageError,
)


def four_bar(
    hinges: Annotated[
        Literal["identical", "leaves-and-notches"],
        typer.Option(
            help="Four identical leaves (section 5.2), or two leaves and two notches "
            "(section 5.3)."
        ),
    ] = "identical",
    coordinates: EnergyOption = "twistor",
    damping_time: Annotated[
        float | None,
        typer.Option(
            help="Ratio of damping to stiffness; s. [default: 1e-3, or 1e-4 with "
            "--release]",
            min=0.0,
            callback=check_finite,
        ),
    ] = None,
    times: Annotated[
        str | None,
        typer.Option(help="Times of the output, such as 0.045,0.09,0.135; s."),
    ] = None,
    release: Annotated[
        float | None,
        typer.Option(
            help="Release the linkage with this velocity of link 3 along x; m/s.",
            callback=check_finite,
        ),
    ] = None,
    as_json: JsonOption = False,
    plot: PlotOption = None,
    animate: Annotated[
        Path | None,
        typer.Option(
            help="Animate the motion in this .gif, .mp4, or .html file.",
            callback=check_animation,
        ),
    ] = None,
) -> None:
    """Simulate a flexural four-bar linkage that is driven by link 2, or released.

    A figure shows the linkage at up to ten of the times.

    Examples: twistorjax four-bar --hinges leaves-and-notches --plot panels.png

    twistorjax four-bar --release 10 --times 0.05,0.1 --json
    """
    output_times = _parse_times(times)
    prepare_jax()
    import equinox as eqx

    from ..examples import four_bar as example

    if release is None:
        default_times = list(example.FIGURE_TIMES)
        default_damping = example.DRIVEN_DAMPING
    else:
        default_times = [0.02 * k for k in range(10)]
        default_damping = example.RELEASED_DAMPING
    if output_times is None:
        output_times = default_times
    # Compiled as one program, which is faster than to compile many small operations.
    linkage = eqx.filter_jit(example.four_bar)(
        hinges,
        coordinates=coordinates,
        damping=default_damping if damping_time is None else damping_time,
    )

    def simulate(times: list[float]) -> Any:
        settings = {
            "tolerance": 1e-9,
            "throw": False,
            "progress_meter": progress_bar(),
        }
        if release is None:
            motion = example.driven_motion(linkage, times, **settings)
        else:
            motion = example.released_motion(linkage, times, release, **settings)
        require_success(motion)
        return motion

    # A simulation starts at zero, even if that time is not part of the output.
    first_row = 1 if output_times[0] > 0 else 0
    motion = simulate([0.0, *output_times] if first_row else output_times)
    if plot is not None:
        save_figure(plot, example.plot(linkage, motion))
    if animate is not None:
        end = output_times[-1]
        frames = simulate([end * k / 100 for k in range(101)])
        save_animation(animate, linkage, frames, slower=10)
    rows = slice(first_row, None)
    print_result(_table(motion, rows), _record(motion, rows), as_json)


def _parse_times(text: str | None) -> list[float] | None:
    """Convert the value of --times to a list of times; s."""
    if text is None:
        return None
    try:
        times = [float(part) for part in text.split(",")]
    except ValueError:
        raise UsageError(
            f"--times is {text!r}, but must be numbers separated by commas, such as "
            "0.045,0.09; s."
        ) from None
    if not all(math.isfinite(time) and time >= 0 for time in times):
        raise UsageError(f"--times is {text!r}, but must be finite and not negative; s.")
    if any(later <= earlier for earlier, later in pairwise(times)):
        raise UsageError(f"--times is {text!r}, but must increase; s.")
    if times == [0.0]:
        raise UsageError("--times is 0, the start of the motion. Add a later time.")
    return times


def _record(motion: Any, rows: slice) -> dict[str, Any]:
    """Return some rows of a motion, as the fields of the JSON output."""

    def by_link(values: Any) -> dict[str, list]:
        table = np.asarray(values)[rows]
        return {name: table[:, k].tolist() for k, name in enumerate(motion.names)}

    return {
        "times": np.asarray(motion.times)[rows].tolist(),
        "poses": by_link(motion.poses),
        "reactions": by_link(motion.reactions),
        "steps": int(motion.steps),
        "result": "successful",
    }


def _table(motion: Any, rows: slice) -> str:
    """Format some rows of a motion as a table."""
    # NumPy selects rows and columns without compilation.
    displacements = np.asarray(motion.displacements)[rows]
    reactions = np.asarray(motion.reactions)[rows]
    second, third, fourth = (motion.names.index(name) for name in "234")
    columns = {
        ("time", "s"): np.asarray(motion.times)[rows],
        ("angle of 2", "rad"): displacements[:, second, 0],
        ("angle of 3", "rad"): displacements[:, third, 0],
        ("angle of 4", "rad"): displacements[:, fourth, 0],
        ("x of 3", "m"): displacements[:, third, 1],
        ("y of 3", "m"): displacements[:, third, 2],
        ("moment on 2", "N m"): reactions[:, second, 0],
    }
    lines = [
        "  ".join(f"{name:>11}" for name, _ in columns),
        "  ".join(f"{unit:>11}" for _, unit in columns),
    ]
    for row in zip(*columns.values(), strict=True):
        lines.append("  ".join(f"{float(value):>11.6g}" for value in row))
    lines.append(f"{int(motion.steps)} steps")
    return "\n".join(lines)
