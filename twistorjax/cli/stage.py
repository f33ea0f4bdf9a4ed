"""`twistorjax stage`: the gain of the micropositioning stage, static or over time."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from .common import (
    check_finite,
    check_positive,
    EnergyOption,
    JsonOption,
    PlotOption,
    prepare_jax,
    print_result,
    progress_bar,
    reporting_errors,
    require_finite_results,
    require_success,
    SolveError,
    UsageError,
)


# Context of the error for a web that the formula of the notches does not allow
_UNUSABLE_WEB = "--web cannot be used with holes of 3 mm: "
_DAMPING_TIME = 1e-3  # ratio of damping to stiffness by default; s


def stage(
    travel: Annotated[
        float,
        typer.Option("--input", help="Input displacement; m.", callback=check_positive),
    ] = 1.35e-6,
    web: Annotated[
        float,
        typer.Option(
            help="Web, the smallest thickness of the necks of the notch hinges; m.",
            callback=check_positive,
        ),
    ] = 0.25e-3,
    coordinates: EnergyOption = "twistor",
    as_json: JsonOption = False,
    plot: PlotOption = None,
    temperature: Annotated[
        float | None,
        typer.Option(
            help="Also print the drift of the output if the stage is warmer by this; K.",
            callback=check_finite,
        ),
    ] = None,
    transient: Annotated[
        bool,
        typer.Option(
            "--transient", help="Simulate the motion until the vibration has decayed."
        ),
    ] = False,
    step: Annotated[
        bool,
        typer.Option("--step", help="With --transient: a step input without a filter."),
    ] = False,
    damping_time: Annotated[
        float,
        typer.Option(
            help="With --transient: ratio of damping to stiffness; s.",
            callback=check_positive,
        ),
    ] = _DAMPING_TIME,
) -> None:
    """Compute the displacement gain of the micropositioning stage (chapter 6).

    Examples: twistorjax stage --web 0.3e-3 --plot stage.png

    twistorjax stage --input 2e-6 --json

    twistorjax stage --temperature 1.0

    twistorjax stage --transient --plot transient.png
    """
    if step and not transient:
        raise UsageError("--step needs --transient: it selects the input of a motion.")
    if damping_time != _DAMPING_TIME and not transient:
        raise UsageError("--damping-time needs --transient, a motion.")
    if transient and temperature is not None:
        raise UsageError("--temperature is for the static gain, without --transient.")
    if transient:
        _transient(travel, web, coordinates, as_json, plot, step, damping_time)
    else:
        _static(travel, web, coordinates, temperature, as_json, plot)


def _static(
    travel: float,
    web: float,
    coordinates: Literal["twistor", "twist"],
    temperature: float | None,
    as_json: bool,
    plot: Path | None,
) -> None:
    """Print the static gain; the arguments are the options of `stage`."""
    prepare_jax()
    import numpy as np

    from ..examples import stage as example
    from ..results.codes import result_names, RESULTS

    result, slope = example.amplification_and_slope(web, travel, coordinates=coordinates)
    deformed = result.equilibrium
    name = str(result_names(deformed.result))
    if name == "not_finite":
        with reporting_errors(_UNUSABLE_WEB):
            example.microstage(web)  # raises the error that explains the NaN
    if name != "successful":
        reached = f"(fraction {float(deformed.fraction):.4g})"
        raise SolveError(f"--input {travel:g}: {RESULTS[deformed.result]} {reached}")
    values = {
        "gain": float(result.gain),
        "output_m": float(result.output),
        "input_force_N": float(result.input_force),
        "elongation_a_m": float(result.elongation),
        "strain_energy_J": float(deformed.energy),
        "dgain_dweb_per_m": float(slope),
    }
    require_finite_results(values)
    poses = np.asarray(deformed.reference) + np.asarray(deformed.displacements)
    by_body = dict(zip(deformed.names, poses.tolist(), strict=True))
    record = {**values, "poses": by_body, "result": name}
    text = _table(values, web, travel)
    if temperature is not None:
        drift, lines = _drift(temperature, web, travel)
        record, text = {**record, "drift": drift}, f"{text}\n{lines}"

    def draw() -> Any:
        return example.plot(example.microstage(web), result)

    print_result(text, record, as_json, plot=plot, draw=draw)


def _drift(temperature: float, web: float, travel: float) -> tuple[dict[str, Any], str]:
    """Compute the drift at another temperature (K), as fields and as text."""
    from ..examples.warm_stage import thermal_drift

    fields, lines = {}, [f"at {temperature:+g} K"]
    for expands, key, words in (
        (True, "guide_expands", "guide of the input expands"),
        (False, "guide_keeps_its_place", "guide keeps its place"),
    ):
        with reporting_errors(f"--temperature {temperature:g}: "):
            drift = thermal_drift(
                temperature, web=web, travel=travel, guide_expands=expands
            )
        angle, x, y = (float(value) for value in drift.output)
        fields[key] = {
            "output_angle_rad": angle,
            "output_x_m": x,
            "output_y_m": y,
            "gain": float(drift.gain),
        }
        lines.append(
            f"{words:<28}output {x / 1e-9:.2f} nm along x, {y / 1e-9:.2f} nm along y, "
            f"gain {float(drift.gain):.6f}"
        )
    return fields, "\n".join(lines)


def _table(values: dict[str, float], web: float, travel: float) -> str:
    """Format the static results as a table; web and travel are in m."""
    from ..examples import stage as example

    micro, nano = 1e-6, 1e-9
    gain_note = f"rigid levers {example.RIGID_GAIN:.4f}"
    elongation_note = ""
    if web == example.WEB:  # only this device was measured
        low, high = example.MEASURED_GAIN
        gain_note = (
            f"measured {low} to {high} (1978); "
            f"dissertation {example.DISSERTATION_GAIN}; {gain_note}"
        )
        elongation_note = "input 1.35 um: measured 50 nm; dissertation about 150 nm"
    slope = values["dgain_dweb_per_m"]
    rows = [
        ("gain", f"{values['gain']:.6f}", gain_note),
        ("output", f"{values['output_m'] / micro:.4f} um", "displacement of body 4"),
        ("input force", f"{values['input_force_N']:.4f} N", ""),
        ("elongation of a", f"{values['elongation_a_m'] / nano:.2f} nm", elongation_note),
        ("strain energy", f"{values['strain_energy_J'] / micro:.4f} uJ", ""),
        (
            "d(gain)/d(web)",
            f"{slope:.4f} /m",
            f"change of the gain if the web is 25 um larger: {25 * micro * slope:+.2f}",
        ),
    ]
    width = max(len(value) for _, value, _ in rows)
    lines = [
        f"micropositioning stage, web {web / 1e-3:g} mm, input {travel / micro:g} um"
    ]
    for name, value, note in rows:
        lines.append(f"{name:<18}{value:>{width}}   {note}".rstrip())
    return "\n".join(lines)


def _transient(
    travel: float,
    web: float,
    coordinates: Literal["twistor", "twist"],
    as_json: bool,
    plot: Path | None,
    step: bool,
    damping_time: float,
) -> None:
    """Print the transient response; the arguments are the options of `stage`."""
    prepare_jax()
    from ..examples import stage, stage_motion as example

    with reporting_errors(_UNUSABLE_WEB):
        mechanism = stage.microstage(web, coordinates=coordinates, damping=damping_time)
    # An error here: there is no equilibrium at the end of the motion.
    with reporting_errors(f"--input {travel:g}: "):
        response = example.transient_response(
            mechanism,
            travel=travel,
            filter_time=None if step else example.FILTER_TIME,
            throw=False,
            progress_meter=progress_bar(),
        )
    motion, record = response.motion, _transient_record(response)
    require_success(motion)
    require_finite_results(record)
    kind = "step"
    if not step:
        kind = f"filtered with a time constant of {example.FILTER_TIME / 1e-3:g} ms"
    end = float(motion.times[-1]) / 1e-3
    text = (
        f"micropositioning stage, input {travel / 1e-6:g} um, {kind}\n"
        f"gain after {end:g} ms   {float(response.gain):.8f}\n"
        f"static gain        {float(response.static_gain):.8f}\n"
        f"elongation of a    {float(response.elongation) / 1e-9:.2f} nm\n"
        f"steps              {int(motion.steps)}"
    )
    print_result(text, record, as_json, plot=plot, draw=lambda: example.plot(response))


def _transient_record(response: Any) -> dict[str, Any]:
    """Return a transient response, as the fields of the JSON output."""
    on_body_2, on_body_6 = response.hinge_a
    return {
        "gain": float(response.gain),
        "static_gain": float(response.static_gain),
        "elongation_a_m": float(response.elongation),
        "times": response.motion.times.tolist(),
        "output_m": response.output.tolist(),
        "hinge_a_on_2_m": on_body_2.tolist(),
        "hinge_a_on_6_m": on_body_6.tolist(),
        "steps": int(response.motion.steps),
        "result": "successful",
    }
