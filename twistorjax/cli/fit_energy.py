"""`twistorjax fit-energy`: fit the energy of a hinge to measured trials."""

import warnings
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from .common import (
    check_folder,
    JsonOption,
    prepare_jax,
    print_result,
    SeedOption,
    UsageError,
    writing,
)


def fit_energy(
    trials: Annotated[
        Path,
        typer.Argument(
            help="File of comma-separated values.", exists=True, dir_okay=False
        ),
    ],
    order: Annotated[
        int | None,
        typer.Option(
            help="Order of the polynomial. [default: the one with the least expected "
            "error]",
            min=1,
            max=20,
        ),
    ] = None,
    coordinates: Annotated[
        Literal["twistor", "twist", "mixed"],
        typer.Option(help="Coordinates of the polynomial; use mixed for flexures."),
    ] = "twistor",
    symmetry: Annotated[
        str | None,
        typer.Option(
            help="Symmetry of the hinge: leaf, or some of mirror,ends,exchange,sign "
            "separated by commas."
        ),
    ] = None,
    hold_out: Annotated[
        float,
        typer.Option(
            help="Fraction of the trials that is held out to check the fit.",
            min=0.0,
            max=1.0,
        ),
    ] = 0.0,
    seed: SeedOption = 0,
    out: Annotated[
        Path | None,
        typer.Option(help="Save the energy to this JSON file.", callback=check_folder),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Fit a polynomial energy to displacements of a hinge and the wrenches they require.

    The first line of the file names the columns: angle_rad, px_m, py_m, moment_Nm, fx_N,
    fy_N; optionally energy_J and standard deviations (such as sd_fx_N).

    Example: twistorjax fit-energy trials.csv --coordinates mixed --symmetry leaf
    """
    prepare_jax()
    from ..energies.fitting.polynomial import fit_energy as fit
    from ..energies.fitting.trials import read_trials
    from ..io.energies import save_energy

    symmetries: Any = symmetry or ()
    if symmetries and symmetries != "leaf":
        symmetries = [part.strip() for part in symmetries.split(",")]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the result reports the warning
            result = fit(
                read_trials(trials),
                order,
                coordinates=coordinates,
                symmetry=symmetries,
                hold_out=hold_out,
                seed=seed,
            )
    except (ValueError, OSError) as error:
        raise UsageError(str(error)) from None
    if out is not None:
        with writing("--out"):
            save_energy(result.energy, out)
    print_result(result, _record(result), as_json, out=out)


def _record(result: Any) -> dict[str, Any]:
    """Return the fields of the JSON output."""
    errors = {
        "training": result.training,
        "expected": result.expected,
        "held_out": result.held_out,
    }
    relative = {
        name: None if error is None else error.relative.tolist()
        for name, error in errors.items()
    }
    return {
        "order": result.energy.order,
        "terms": result.terms,
        "value_count": result.value_count,
        "rank": result.rank,
        "condition": result.condition,
        "relative_error": relative,
        "not_determined": result.undetermined,
        "warning": result.warning,
    }
