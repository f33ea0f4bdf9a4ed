"""`twistorjax random-data`: overfitting study on random wrenches (section 7.1)."""

from pathlib import Path
from typing import Annotated

import typer

from .common import check_figure, JsonOption, prepare_jax, save_figure, to_json


def random_data(
    as_json: JsonOption = False,
    plot: Annotated[
        Path | None,
        typer.Option(
            help="Draw given, fitted, and predicted wrenches to this file.",
            callback=check_figure,
        ),
    ] = None,
) -> None:
    """Fit a polynomial energy to the 17 random trials of section 7.1.

    Each trial is also held out once, and predicted by a fit to the other trials.

    Example: twistorjax random-data --plot random.png
    """
    prepare_jax()
    from ..examples import random_data as example

    study = example.study()
    if plot is not None:
        save_figure(plot, example.plot(study))
    if not as_json:
        print(study)
        if plot is not None:
            print(f"figure saved to {plot}")
        return
    fit = study.fit
    print(
        to_json(
            {
                "order": fit.energy.order,
                "trials": len(study.trials),
                "equations": fit.equations,
                "terms": fit.terms,
                "rank": fit.rank,
                "condition": fit.condition,
                "largest_error_training": fit.training.largest.tolist(),
                "largest_error_held_out": study.held_out.largest.tolist(),
                "relative_error_held_out": study.held_out.relative.tolist(),
                "warning": fit.warning,
            }
        )
    )
