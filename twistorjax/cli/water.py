"""`twistorjax water`: the energy of two water molecules, of sections 7.2 to 7.4."""

import math
from pathlib import Path
from typing import Annotated

import typer

from .common import in_json, need_picture, need_seed, prepare_jax, save, UsageError


def water(
    order: Annotated[
        int, typer.Option(help="Of numerators and denominators: even, 2 to 12.")
    ] = 6,
    span: Annotated[
        float,
        typer.Option("--range", help="Of the angle and of the direction; rad."),
    ] = 1.5708,
    points: Annotated[int, typer.Option(help="Trials that are fitted.")] = 500,
    seed: Annotated[int, typer.Option(help="Of the choice of trials.")] = 0,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object instead of a table.")
    ] = False,
    plot: Annotated[
        Path | None, typer.Option(help="Draw energies and errors into this file.")
    ] = None,
) -> None:
    """Fits to the energy of two water molecules, checked by trials they have not seen.

    A polynomial and a quotient of two, as in chapter 7, and a quotient kept from poles.

    Examples: twistorjax water --plot water.png

    twistorjax water --order 8 --range 6.2832 --json
    """
    if not 2 <= order <= 12 or order % 2:
        raise UsageError(f"--order is {order}, but must be even, from 2 to 12.")
    if not 0 < span <= 6.2832:
        raise UsageError(
            f"--range is {span:g}, but must be above 0, and at most a turn, 6.2832; rad."
        )
    if not 2 <= points <= 20000:
        raise UsageError(f"--points is {points}, but must lie between 2 and 20000.")
    need_seed("--seed", seed)
    need_picture("--plot", plot)
    prepare_jax()
    from ..examples import water as case

    study = case.study(order, min(span, 2 * math.pi), points, [seed])
    if plot is not None:
        save(plot, lambda: case.plot(study))
    print(_json(study) if as_json else study)
    if plot is not None and not as_json:
        print(f"drawn to {plot}")


def _json(study) -> str:
    def of(name: str) -> dict:
        (fit,) = study.fits[name]
        return {
            "terms": fit.terms,
            "rank": fit.rank,
            "ridge": fit.ridge,
            "largest_error_training": study.training(name).item(),
            "largest_error_held_out": study.held_out(name).item(),
            "relative_error_of_wrench_held_out": study.wrenches(name).item(),
            "denominator_over_base": [fit.lowest, fit.highest],
            "has_poles": fit.has_poles,
        }

    return in_json(
        {
            "order": study.order,
            "range_rad": study.span,
            "fitted": len(study.trials[0]),
            "held_out": len(study.fresh[0]),
            "unit_of_energy": "e^2/Angstrom",
            "fits": {name: of(name) for name in study.fits},
        }
    )
