"""The command line: `twistorjax --help`."""

import json
import math
import os
import sys
from pathlib import Path
from typing import Annotated

import typer


app = typer.Typer(
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


@app.callback(invoke_without_command=True)
def overview(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.")
    ] = False,
) -> None:
    """Differentiable mechanics of planar flexure mechanisms.

    Example: twistorjax stage
    """
    if version:
        from importlib.metadata import version as installed

        print(f"twistorjax {installed('twistorjax')}")
    elif context.invoked_subcommand is None:
        print(context.get_help())


@app.command()
def stage(
    travel: Annotated[
        float, typer.Option("--input", help="Travel of the input; m.")
    ] = 1.35e-6,
    web: Annotated[
        float, typer.Option(help="Thickness of the necks of the notch hinges; m.")
    ] = 0.25e-3,
    energy: Annotated[
        str, typer.Option(help="Coordinates of the hinges' energy: twistor or twist.")
    ] = "twistor",
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object instead of a table.")
    ] = False,
    plot: Annotated[
        Path | None, typer.Option(help="Draw the deformed stage into this file.")
    ] = None,
    transient: Annotated[
        bool,
        typer.Option("--transient", help="Follow it in time until it rests instead."),
    ] = False,
    step: Annotated[
        bool,
        typer.Option("--step", help="With --transient: the input steps, unfiltered."),
    ] = False,
    damping_time: Annotated[
        float, typer.Option(help="With --transient: damping over stiffness; s.")
    ] = 1e-3,
) -> None:
    """The displacement gain of the micropositioning stage (chapter 6).

    Examples: twistorjax stage --web 0.3e-3 --plot stage.png

    twistorjax stage --input 2e-6 --json

    twistorjax stage --transient --plot transient.png
    """
    _need("--input", travel, "m")
    _need("--web", web, "m")
    _need("--damping-time", damping_time, "s")
    _need_energy(energy)
    _need_folder("--plot", plot)
    if step and not transient:
        raise Refused("--step tells how the input moves in time: give --transient, too.")
    if transient:
        _stage_transient(travel, web, energy, as_json, plot, step, damping_time)
        return
    _prepare_jax()
    import numpy as np

    from .cases import stage as case
    from .solve.results import outcomes, RESULTS

    answer, slope = case.amplify_by_web(web, travel, coordinates=energy)
    moved = answer.equilibrium
    ended = str(outcomes(moved.result))
    if ended == "not_finite":
        try:
            case.microstage(web)  # tells what is wrong with the web
        except ValueError as error:
            raise Refused(f"--web cannot be used, holes being 3 mm: {error}") from None
    if ended != "successful":
        reached = f"(fraction {float(moved.fraction):.4g})"
        raise Failed(f"--input {travel:g}: {RESULTS[moved.result]} {reached}")
    values = {
        "gain": float(answer.gain),
        "output_m": float(answer.output),
        "input_force_N": float(answer.input_force),
        "compression_a_m": float(answer.compression),
        "strain_energy_J": float(moved.energy),
        "dgain_dweb_per_m": float(slope),
    }
    if plot is not None:
        _save(plot, lambda: case.plot(case.microstage(web), answer))
    if as_json:
        poses = np.asarray(moved.rest) + np.asarray(moved.displacements)
        named = dict(zip(moved.names, poses.tolist(), strict=True))
        print(json.dumps({**values, "poses": named, "result": ended}))
    else:
        print(_table(values, web, travel))
        if plot is not None:
            print(f"drawn to {plot}")


@app.command("four-bar")
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
    if hinges not in ("identical", "mixed"):
        raise Refused(f"--hinges is {hinges!r}, but must be 'identical' or 'mixed'.")
    _need_energy(energy)
    if damping_time is not None and not (math.isfinite(damping_time) and damping_time >= 0):
        raise Refused(
            f"--damping-time is {damping_time:g}, but must be zero or positive; s."
        )
    if release is not None and not math.isfinite(release):
        raise Refused(f"--release is {release:g}, but must be finite; m/s.")
    for option, path in (("--plot", plot), ("--animate", animate)):
        _need_folder(option, path)
    if animate is not None and animate.suffix not in (".gif", ".mp4", ".html"):
        raise Refused(f"--animate is {animate}, but must end in .gif, .mp4 or .html.")
    asked = _times(times)
    _prepare_jax()
    from .cases import four_bar as case

    if asked is None:
        asked = list(case.PANELS)
        if release is not None:
            asked = [0.02 * k for k in range(10)]
    damping = damping_time
    if damping is None:
        damping = case.DRIVEN_DAMPING if release is None else case.RELEASED_DAMPING
    linkage = case.four_bar(hinges, coordinates=energy, damping=damping)

    def move(instants: list[float]):
        settings = {"tolerance": 1e-9, "throw": False, "progress_meter": _meter()}
        if release is None:
            motion = case.drive(linkage, instants, **settings)
        else:
            motion = case.release(linkage, instants, release, **settings)
        return _finished(motion)

    # a motion begins at zero, whether or not that time was asked for
    added = asked[0] > 0
    motion = move([0.0, *asked] if added else asked)
    if plot is not None:
        _save(plot, lambda: case.plot(linkage, motion))
    if animate is not None:
        end = asked[-1]
        _film(animate, linkage, move([end * k / 100 for k in range(101)]))
    rows = slice(1 if added else 0, None)
    print(_motion_json(motion, rows) if as_json else _motion_table(motion, rows))


class Refused(Exception):
    """Input that cannot be used, told in one line."""


class Failed(Exception):
    """A solve that found no answer, told in one line."""


def main() -> None:
    """Runs the command line; exits with 0, with 1 on failure, with 2 on bad input."""
    command = typer.main.get_command(app)
    try:
        code = command.main(standalone_mode=False)
    except Refused as error:
        code = _complain(str(error), 2)
    except Failed as error:
        code = _complain(str(error), 1)
    except Exception as error:
        # typer carries its own copy of click, so its errors are known by what they can do
        message = getattr(error, "format_message", None)
        if message is None:
            raise
        code = _complain(message(), 2)
    sys.exit(code or 0)


def _complain(message: str, code: int) -> int:
    sys.stderr.write(f"twistorjax: {' '.join(message.split())}\n")
    return code


def _prepare_jax() -> None:
    """Double precision, and compiled programs kept for the next call."""
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    # what diffrax would check from within a program has been checked before; and a
    # program that calls back cannot be kept
    os.environ.setdefault("EQX_ON_ERROR", "off")
    import jax
    import platformdirs

    jax.config.update("jax_enable_x64", True)
    cache = platformdirs.user_cache_path("twistorjax")
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def _table(values: dict[str, float], web: float, travel: float) -> str:
    from .cases import stage as case

    low, high = case.MEASURED_GAIN
    gain = values["gain"]
    slope = values["dgain_dweb_per_m"]
    micro = 1e-6
    told = compressed = ""
    if web == case.WEB:  # the device that was measured
        told = f"measured {low} to {high} (1978); dissertation {case.DISSERTATION_GAIN}; "
        compressed = "for 1.35 um: measured 50 nm; dissertation about 150 nm"
    rows = [
        ("gain", f"{gain:.6f}", f"{told}rigid levers {case.RIGID_GAIN:.4f}"),
        ("output", f"{values['output_m'] / micro:.4f} um", "travel of body 4"),
        ("input force", f"{values['input_force_N']:.4f} N", ""),
        (
            "compression of a",
            f"{values['compression_a_m'] / 1e-9:.2f} nm",
            compressed,
        ),
        ("strain energy", f"{values['strain_energy_J'] / micro:.4f} uJ", ""),
        (
            "d(gain)/d(web)",
            f"{slope:.4f} /m",
            f"webs 25 um thicker: {25 * micro * slope:+.2f}",
        ),
    ]
    wide = max(len(row[1]) for row in rows)
    lines = [f"{name:<18}{value:>{wide}}   {note}".rstrip() for name, value, note in rows]
    title = f"micropositioning stage, webs {web / 1e-3:g} mm, input {travel / micro:g} um"
    return "\n".join([title, *lines])


def _stage_transient(
    travel: float,
    web: float,
    energy: str,
    as_json: bool,
    plot: Path | None,
    step: bool,
    damping_time: float,
) -> None:
    _prepare_jax()
    from .cases import stage, transient as case

    try:
        design = stage.microstage(web, coordinates=energy, damping=damping_time)
    except ValueError as error:
        raise Refused(f"--web cannot be used, holes being 3 mm: {error}") from None
    settled = case.settle(
        design,
        travel=travel,
        rise=None if step else case.RISE,
        throw=False,
        progress_meter=_meter(),
    )
    motion = _finished(settled.motion)
    if plot is not None:
        _save(plot, lambda: case.plot(settled))
    gain, static = float(settled.gain), float(settled.static_gain)
    apart = float(settled.joint[1, -1] - settled.joint[0, -1])
    if as_json:
        print(
            json.dumps(
                {
                    "gain": gain,
                    "static_gain": static,
                    "compression_a_m": apart,
                    "times": motion.times.tolist(),
                    "output_m": settled.output.tolist(),
                    "hinge_a_on_2_m": settled.joint[0].tolist(),
                    "hinge_a_on_6_m": settled.joint[1].tolist(),
                    "steps": int(motion.steps),
                    "result": "successful",
                }
            )
        )
        return
    how = "stepped" if step else f"filtered by {case.RISE / 1e-3:g} ms"
    print(
        f"micropositioning stage, input {travel / 1e-6:g} um, {how}\n"
        f"gain after {float(motion.times[-1]) / 1e-3:g} ms  {gain:.8f}\n"
        f"gain at rest       {static:.8f}\n"
        f"hinge a, apart     {apart / 1e-9:.2f} nm\n"
        f"steps              {int(motion.steps)}"
    )


def _times(given: str | None) -> list[float] | None:
    if given is None:
        return None
    try:
        values = [float(part) for part in given.split(",")]
    except ValueError:
        raise Refused(
            f"--times is {given!r}, but must be numbers between commas: 0.045,0.09; s."
        ) from None
    if not all(math.isfinite(value) and value >= 0 for value in values):
        raise Refused(f"--times is {given!r}, but must be finite and not negative; s.")
    if any(late <= early for early, late in zip(values, values[1:], strict=False)):
        raise Refused(f"--times is {given!r}, but must increase; s.")
    if values == [0.0]:
        raise Refused("--times is 0, when nothing has moved: give a later one, too.")
    return values


def _need(option: str, value: float, unit: str) -> None:
    if not (math.isfinite(value) and value > 0):
        raise Refused(f"{option} is {value:g}, but must be positive and finite; {unit}.")


def _need_energy(energy: str) -> None:
    if energy not in ("twistor", "twist"):
        raise Refused(f"--energy is {energy!r}, but must be 'twistor' or 'twist'.")


def _need_folder(option: str, path: Path | None) -> None:
    if path is not None and not path.resolve().parent.is_dir():
        raise Refused(f"{option} is {path}, but there is no folder {path.parent}.")


def _meter():
    """A progress bar, where somebody looks."""
    from .show.progress import ProgressBar

    return ProgressBar() if sys.stderr.isatty() else None


def _finished(motion):
    """The motion, if it reached its end."""
    from .solve.results import outcomes, RESULTS

    ended = str(outcomes(motion.result))
    if ended != "successful":
        text = RESULTS[motion.result]
        raise Failed(f"{text} It went to t = {float(motion.reached):.6g} s.")
    return motion


def _motion_json(motion, rows: slice) -> str:
    def by_link(values) -> dict[str, list]:
        return {
            name: values[rows, row].tolist() for row, name in enumerate(motion.names)
        }

    return json.dumps(
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


def _matplotlib(option: str) -> None:
    try:
        import matplotlib
    except ImportError:
        raise Refused(
            f'{option} needs matplotlib: pip install "twistorjax[show]".'
        ) from None
    matplotlib.use("agg")


def _save(path: Path, picture) -> None:
    _matplotlib("--plot")
    drawn = picture()
    try:
        getattr(drawn, "figure", drawn).savefig(path, dpi=160)
    except (OSError, ValueError) as error:
        raise Refused(f"--plot cannot be written: {error}") from None


def _film(path: Path, mechanism, motion) -> None:
    _matplotlib("--animate")
    from .show.animation import animate

    film = animate(mechanism, motion, slower=10)
    try:
        if path.suffix == ".html":
            path.write_text(film.to_jshtml(), encoding="utf-8")
        else:
            film.save(path, dpi=100)
    except (OSError, ValueError) as error:
        raise Refused(f"--animate cannot be written: {error}") from None


if __name__ == "__main__":
    main()
