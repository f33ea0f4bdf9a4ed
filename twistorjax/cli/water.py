"""`twistorjax water`: fits to the energy of two water molecules (sections 7.2 to 7.4)."""

import math
from typing import Annotated, Any

import typer

from .common import (
    check_positive,
    JsonOption,
    PlotOption,
    prepare_jax,
    print_result,
    SeedOption,
    UsageError,
)


def water(
    order: Annotated[
        int,
        typer.Option(
            help="Order of numerators and denominators; an even number.", min=2, max=12
        ),
    ] = 6,
    angle_range: Annotated[
        float,
        typer.Option(
            "--range",
            help="Range of the angle and of the direction of the second molecule; rad.",
            max=6.2832,
            callback=check_positive,
        ),
    ] = 1.5708,
    points: Annotated[
        int, typer.Option(help="Number of trials that are fitted.", min=2, max=20000)
    ] = 500,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
    plot: PlotOption = None,
) -> None:
    """Fit the energy of two water molecules, and check the fits by held-out trials.

    The command fits a polynomial and a rational function as in chapter 7, and a rational
    function that is regularized to avoid singularities. The figure of --plot shows the
    energies and the errors of the fits.

    Examples: twistorjax water --plot water.png

    twistorjax water --order 8 --range 6.2832 --json
    """
    if order % 2:
        raise UsageError(f"--order is {order}, but must be an even number.")
    prepare_jax()
    from ..examples import water as example

    study = example.study(order, min(angle_range, 2 * math.pi), points, [seed])
    record = _record(study)
    print_result(study, record, as_json, plot=plot, draw=lambda: example.plot(study))


def _record(study: Any) -> dict[str, Any]:
    """Return the fits of a study with one seed, as the fields of the JSON output."""

    def fit_record(name: str) -> dict[str, Any]:
        (fit,) = study.fits[name]
        return {
            "terms": fit.terms,
            "rank": fit.rank,
            "ridge": fit.ridge,
            "largest_error_training": study.training_error(name).item(),
            "largest_error_held_out": study.held_out_error(name).item(),
            "relative_error_of_wrench_held_out": study.wrench_error(name).item(),
            "denominator_over_base": [fit.smallest_ratio, fit.largest_ratio],
            "has_singularities": fit.has_singularities,
        }

    return {
        "order": study.order,
        "range_rad": study.angle_range,
        "fitted": len(study.trials[0]),
        "held_out": len(study.held_out_trials[0]),
        "unit_of_energy": "e^2/Angstrom",
        "fits": {name: fit_record(name) for name in study.fits},
    }
