"""`twistorjax fit-energy`: fit the energy of a hinge to measured trials."""

import sys
import warnings
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from .common import (
    check_folder,
    JsonOption,
    prepare_jax,
    print_result,
    reporting_errors,
    SeedOption,
    SolveError,
    UsageError,
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
        typer.Option(
            help="Save the energy to this JSON file, with the range of rotations and "
            "forces of the trials as its validity range.",
            callback=check_folder,
        ),
    ] = None,
    without_range: Annotated[
        bool, typer.Option(help="Save the energy without a validity range.")
    ] = False,
    accept: Annotated[
        bool,
        typer.Option(help="Save an energy in spite of a warning, with exit code 0."),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Fit a polynomial energy to displacements of a hinge and the wrenches they require.

    The first line of the file names the columns with their units: angle_rad, px_m, py_m,
    moment_Nm, fx_N, fy_N, or other units such as angle_deg, px_mm, moment_Nmm; optionally
    energy_J and standard deviations (such as sd_fx_N).

    An expected error above 5 % of a component, and units or signs that seem to be wrong,
    cause a warning. The energy is then not saved, and the exit code is 1, unless --accept
    is given.

    Example: twistorjax fit-energy trials.csv --coordinates mixed --symmetry leaf
    """
    if without_range and out is None:
        raise UsageError("--without-range needs --out, the file of the energy.")
    prepare_jax()
    from ..energies.fitting.polynomial import fit_energy as fit
    from ..energies.fitting.trials import read_trials
    from ..io import save_energy

    symmetries: Any = symmetry or ()
    if symmetries and symmetries != "leaf":
        symmetries = [part.strip() for part in symmetries.split(",")]
    with reporting_errors(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the result reports the warning
        result = fit(
            read_trials(trials),
            order,
            coordinates=coordinates,
            symmetry=symmetries,
            hold_out=hold_out,
            seed=seed,
            progress=sys.stderr.isatty(),
        )
    if result.warning and not accept:
        print_result(result, _record(result), as_json)
        raise SolveError(
            f"{result.warning} The energy is not saved. Use --accept to accept the fit."
        )
    if out is not None:
        with reporting_errors("--out cannot be written: "):
            energy = result.energy if without_range else result.with_validity_range
            save_energy(energy, out)
    print_result(result, _record(result), as_json, out=out)


def _record(result: Any) -> dict[str, Any]:
    """Return the fields of the JSON output."""
    import numpy as np

    from ..energies.fitting.report import eigenvalues

    errors = {
        "training": result.training,
        "expected": result.expected,
        "held_out": result.held_out,
    }
    relative = {
        name: None if error is None else error.relative.tolist()
        for name, error in errors.items()
    }
    stiffness = np.asarray(result.stiffness)
    return {
        "order": result.energy.order,
        "terms": result.terms,
        "value_count": result.value_count,
        "rank": result.rank,
        "condition": result.condition,
        "relative_error": relative,
        "stiffness": stiffness.tolist(),
        "stiffness_eigenvalues": eigenvalues(stiffness).tolist(),
        "not_determined": result.undetermined,
        "warning": result.warning,
    }
