"""`twistorjax fit`: an energy from measurements."""

import math
import warnings
from pathlib import Path
from typing import Annotated, Any

import typer

from .common import in_json, need_choice, need_folder, need_seed, prepare_jax, UsageError


def fit(
    trials: Annotated[Path, typer.Argument(help="A file of separated values.")],
    order: Annotated[
        int | None,
        typer.Option(help="Of the polynomial. [default: that of the least error]"),
    ] = None,
    coordinates: Annotated[
        str,
        typer.Option(help="Of the polynomial: twistor, twist, or for flexures tension."),
    ] = "twistor",
    symmetry: Annotated[
        str | None,
        typer.Option(help="leaf, or some of mirror,ends,exchange,sign with commas."),
    ] = None,
    hold_out: Annotated[
        float, typer.Option(help="The part of the trials held back, to check the fit.")
    ] = 0.0,
    seed: Annotated[int, typer.Option(help="Of the choice of these.")] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Keep the energy in this file, as JSON.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object instead of a table.")
    ] = False,
) -> None:
    """A polynomial energy from displacements of a hinge and the wrenches they took.

    The first line of the file names its columns: angle_rad, px_m, py_m, moment_Nm, fx_N,
    fy_N; energy_J and standard deviations (sd_fx_N) where there are any.

    Example: twistorjax fit trials.csv --coordinates tension --symmetry leaf
    """
    kind = need_choice("--coordinates", coordinates, ("twistor", "twist", "tension"))
    if order is not None and not 1 <= order <= 20:
        raise UsageError(f"--order is {order}, but must lie between 1 and 20.")
    if not (math.isfinite(hold_out) and 0 <= hold_out < 1):
        raise UsageError(f"--hold-out is {hold_out:g}, but must be from 0 to below 1.")
    need_seed("--seed", seed)
    need_folder("--out", out)
    prepare_jax()
    from ..energies.fitting.polynomial import fit_energy
    from ..energies.fitting.trials import read_trials
    from ..io.energies import save_energy

    kinds: Any = symmetry or ()
    if kinds and kinds != "leaf":
        kinds = [part.strip() for part in kinds.split(",")]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # told by the answer
            answer = fit_energy(
                read_trials(trials),
                order,
                coordinates=kind,
                symmetry=kinds,
                hold_out=hold_out,
                seed=seed,
            )
    except (ValueError, OSError) as error:
        raise UsageError(str(error)) from None
    if out is not None:
        try:
            save_energy(answer.energy, out)
        except (OSError, ValueError) as error:
            raise UsageError(f"--out cannot be written: {error}") from None
    if not as_json:
        print(answer)
        if out is not None:
            print(f"kept in {out}")
        return
    kinds_of_error = (
        ("training", answer.training),
        ("expected", answer.expected),
        ("held_out", answer.held_out),
    )
    told = {
        name: None if errors is None else errors.relative.tolist()
        for name, errors in kinds_of_error
    }
    print(
        in_json(
            {
                "order": answer.energy.order,
                "terms": answer.terms,
                "equations": answer.equations,
                "rank": answer.rank,
                "condition": answer.condition,
                "relative_error": told,
                "unseen": answer.unseen,
                "warning": answer.warning,
            }
        )
    )
