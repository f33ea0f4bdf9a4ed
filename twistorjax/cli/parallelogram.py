"""`twistorjax parallelogram`: a parallelogram flexure under large loads."""

from pathlib import Path
from typing import Annotated

import typer

from .common import (
    check_positive,
    JsonOption,
    PlotOption,
    prepare_jax,
    print_result,
    reporting_errors,
    SolveError,
)


def parallelogram(
    cases: Annotated[
        Path | None, typer.Option(help="File with load cases; by default 18 cases.")
    ] = None,
    bending_factor: Annotated[
        float,
        typer.Option(
            help="Factor of the bending stiffness of the leaves, which are plates.",
            callback=check_positive,
        ),
    ] = 1.04,
    as_json: JsonOption = False,
    plot: PlotOption = None,
) -> None:
    """Compute a parallelogram flexure under large transverse and axial loads.

    The first line of the file of --cases names the columns: transverse_EI_L2,
    axial_EI_L2, moment_EI_L; optionally ux_L, uy_L, phi_rad, with which the results are
    compared.

    Examples: twistorjax parallelogram --plot parallelogram.png

    twistorjax parallelogram --cases cases.csv --bending-factor 1.0 --json
    """
    prepare_jax()
    from ..examples import parallelogram as example
    from ..results.codes import result_message

    with reporting_errors():
        loads = example.default_cases() if cases is None else example.read_cases(cases)
        study = example.study(loads, bending_factor)
    ux, uy, phi = study.displacements.T.tolist()
    record = {"ux_L": ux, "uy_L": uy, "phi_rad": phi, "result": study.names.tolist()}
    print_result(study, record, as_json, plot=plot, draw=lambda: example.plot(study))
    failed = [name for name in record["result"] if name != "successful"]
    if len(failed) == len(ux):
        raise SolveError(f"All load cases failed. {result_message(failed[0])}")
