"""`twistorjax truss`: snap-through of the truss of von Mises."""

from typing import Annotated

import typer

from .common import (
    check_positive,
    JsonOption,
    PlotOption,
    prepare_jax,
    print_result,
    reporting_errors,
    require_finite_results,
)


def truss(
    rise: Annotated[
        float,
        typer.Option(help="Height of the apex; m.", callback=check_positive),
    ] = 0.3,
    half_span: Annotated[
        float,
        typer.Option(help="Half of the span; m.", callback=check_positive),
    ] = 1.0,
    stiffness: Annotated[
        float,
        typer.Option(help="Axial stiffness of a bar; N/m.", callback=check_positive),
    ] = 1000.0,
    as_json: JsonOption = False,
    plot: PlotOption = None,
) -> None:
    """Compute the snap-through of two bars under a force on their apex.

    The path of stable and unstable equilibria is compared with the closed form.

    Example: twistorjax truss --rise 0.2 --plot truss.png
    """
    prepare_jax()
    from ..examples import truss as example

    with reporting_errors():
        found = example.study(rise, half_span, stiffness)
    record = found.record()
    require_finite_results(record)
    print_result(found, record, as_json, plot=plot, draw=lambda: example.plot(found))
