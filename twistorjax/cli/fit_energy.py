"""`twistorjax fit-energy`: fit the energy of a hinge to measured trials."""

import warnings
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from .common import (
    check_folder,
    JsonOption,
    LARGEST_SEED,
    prepare_jax,
    to_json,
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
    seed: Annotated[
        int,
        typer.Option(
            help="Random seed of the choice of held-out trials.", min=0, max=LARGEST_SEED
        ),
    ] = 0,
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
        try:
            save_energy(result.energy, out)
        except (OSError, ValueError) as error:
            raise UsageError(f"--out cannot be written: {error}") from None
    if as_json:
        print(_json(result))
        return
    print(result)
    if out is not None:
        print(f"saved to {out}")


def _json(result: Any) -> str:
    """Format the result of a fit as JSON."""
    errors = {
        "training": result.training,
        "expected": result.expected,
        "held_out": result.held_out,
    }
    relative = {
        name: None if error is None else error.relative.tolist()
        for name, error in errors.items()
    }
    return to_json(
        {
            "order": result.energy.order,
            "terms": result.terms,
            "equations": result.equations,
            "rank": result.rank,
            "condition": result.condition,
            "relative_error": relative,
            "not_determined": result.undetermined,
            "warning": result.warning,
        }
    )
