"""`twistorjax stage`: the gain of the micropositioning stage, and how it is reached."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from .common import (
    finished,
    in_json,
    meter,
    need,
    need_energy,
    need_picture,
    prepare_jax,
    save,
    SolveError,
    UsageError,
)


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
    need("--input", travel, "m")
    need("--web", web, "m")
    need("--damping-time", damping_time, "s")
    coordinates = need_energy(energy)
    need_picture("--plot", plot)
    if step and not transient:
        raise UsageError(
            "--step tells how the input moves in time: give --transient, too."
        )
    if transient:
        _transient(travel, web, coordinates, as_json, plot, step, damping_time)
        return
    prepare_jax()
    import numpy as np

    from ..examples import stage as case
    from ..solve.results import result_names, RESULTS

    answer, slope = case.amplify_by_web(web, travel, coordinates=coordinates)
    moved = answer.equilibrium
    ended = str(result_names(moved.result))
    if ended == "not_finite":
        try:
            case.microstage(web)  # tells what is wrong with the web
        except ValueError as error:
            raise UsageError(f"--web cannot be used, holes being 3 mm: {error}") from None
    if ended != "successful":
        reached = f"(fraction {float(moved.fraction):.4g})"
        raise SolveError(f"--input {travel:g}: {RESULTS[moved.result]} {reached}")
    values = {
        "gain": float(answer.gain),
        "output_m": float(answer.output),
        "input_force_N": float(answer.input_force),
        "compression_a_m": float(answer.compression),
        "strain_energy_J": float(moved.energy),
        "dgain_dweb_per_m": float(slope),
    }
    if plot is not None:
        save(plot, lambda: case.plot(case.microstage(web), answer))
    if as_json:
        poses = np.asarray(moved.reference) + np.asarray(moved.displacements)
        named = dict(zip(moved.names, poses.tolist(), strict=True))
        print(in_json({**values, "poses": named, "result": ended}))
    else:
        print(_table(values, web, travel))
        if plot is not None:
            print(f"drawn to {plot}")


def _table(values: dict[str, float], web: float, travel: float) -> str:
    from ..examples import stage as case

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


def _transient(
    travel: float,
    web: float,
    coordinates: Literal["twistor", "twist"],
    as_json: bool,
    plot: Path | None,
    step: bool,
    damping_time: float,
) -> None:
    prepare_jax()
    from ..examples import stage, stage_motion as case

    try:
        design = stage.microstage(web, coordinates=coordinates, damping=damping_time)
    except ValueError as error:
        raise UsageError(f"--web cannot be used, holes being 3 mm: {error}") from None
    try:
        settled = case.settle(
            design,
            travel=travel,
            rise=None if step else case.RISE,
            throw=False,
            progress_meter=meter(),
        )
    except RuntimeError as error:  # of the equilibrium with which its end is compared
        raise SolveError(f"--input {travel:g}: {error}") from None
    motion = finished(settled.motion)
    if plot is not None:
        save(plot, lambda: case.plot(settled))
    gain, static = float(settled.gain), float(settled.static_gain)
    apart = float(settled.joint[1, -1] - settled.joint[0, -1])
    if as_json:
        print(
            in_json(
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
