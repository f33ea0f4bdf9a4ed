"""`twistorjax random-data`: random wrenches met by a polynomial, of section 7.1."""

from pathlib import Path
from typing import Annotated

import typer

from .common import in_json, need_picture, prepare_jax, save


def random_data(
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object instead of a table.")
    ] = False,
    plot: Annotated[
        Path | None, typer.Option(help="Draw given and fitted wrenches into this file.")
    ] = None,
) -> None:
    """A polynomial through the 17 random trials of section 7.1, and what it foretells.

    Each trial is also held back once, and foretold by a fit to the others.

    Example: twistorjax random-data --plot random.png
    """
    need_picture("--plot", plot)
    prepare_jax()
    from ..examples import random_data as case

    study = case.study()
    if plot is not None:
        save(plot, lambda: case.plot(study))
    if not as_json:
        print(study)
        if plot is not None:
            print(f"drawn to {plot}")
        return
    fit = study.fit
    print(
        in_json(
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
