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
) -> None:
    """The displacement gain of the micropositioning stage (chapter 6).

    Examples: twistorjax stage --web 0.3e-3 --plot stage.png

    twistorjax stage --input 2e-6 --json
    """
    for option, value in (("--input", travel), ("--web", web)):
        if not (math.isfinite(value) and value > 0):
            raise Refused(f"{option} is {value:g}, but must be positive and finite; m.")
    if energy not in ("twistor", "twist"):
        raise Refused(f"--energy is {energy!r}, but must be 'twistor' or 'twist'.")
    if plot is not None and not plot.resolve().parent.is_dir():
        raise Refused(f"--plot is {plot}, but there is no folder {plot.parent}.")
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


def _save(path: Path, picture) -> None:
    try:
        import matplotlib
    except ImportError:
        raise Refused(
            '--plot needs matplotlib: pip install "twistorjax[show]".'
        ) from None
    matplotlib.use("agg")
    axes = picture()
    try:
        axes.figure.savefig(path, dpi=160)
    except (OSError, ValueError) as error:
        raise Refused(f"--plot cannot be written: {error}") from None


if __name__ == "__main__":
    main()
