"""`twistorjax identify`: identify three stiffnesses from a motion."""

import sys
from typing import Annotated, Any

import typer

from .common import (
    check_positive,
    JsonOption,
    LARGEST_SEED,
    prepare_jax,
    print_result,
    SolveError,
    UsageError,
)


def identify(
    seed: Annotated[
        int,
        typer.Option(
            help="Random seed of the camera's errors; -1 for no errors.",
            min=-1,
            max=LARGEST_SEED,
        ),
    ] = 0,
    angle_deviation: Annotated[
        float,
        typer.Option(
            help="Standard deviation of the camera's angles; rad.",
            callback=check_positive,
        ),
    ] = 1e-5,
    position_deviation: Annotated[
        float,
        typer.Option(
            help="Standard deviation of the camera's positions; m.",
            callback=check_positive,
        ),
    ] = 1e-6,
    as_json: JsonOption = False,
) -> None:
    """Identify three stiffnesses of hinge A of the four-bar linkage from its motion.

    Link 3 is released with 10 m/s. A camera measures the three moving links at 101 times
    within 0.05 s. The start values are 1.5, 0.6, and 0.5 times the true stiffnesses.

    Example: twistorjax identify --seed 3 --position-deviation 1e-5
    """
    prepare_jax()
    import jax

    from ..examples import identification as example

    key = None if seed == -1 else jax.random.key(seed)
    try:
        result = example.identify_hinge_a(
            key,
            angle_deviation=angle_deviation,
            position_deviation=position_deviation,
            progress=sys.stderr.isatty(),
        )
    except RuntimeError as error:
        raise SolveError(str(error)) from None
    except ValueError as error:  # the square of a deviation is zero or infinite
        raise UsageError(
            f"--angle-deviation or --position-deviation cannot be used: {error}"
        ) from None
    true = [f"{name} {example.LEAF[name]:g}" for name in result.names]
    text = f"{result}\ntrue values: {', '.join(true)}"
    print_result(text, _record(result, example.LEAF), as_json)


def _record(result: Any, true: dict[str, float]) -> dict[str, Any]:
    """Return the estimates and the true values, as the fields of the JSON output."""
    errors = result.standard_errors
    return {
        "estimates": {name: float(value) for name, value in result.estimates.items()},
        "standard_errors": {name: float(value) for name, value in errors.items()},
        "true": true,
        "units": dict(zip(result.names, result.units, strict=True)),
        "covariance": result.covariance.tolist(),
        "names": result.names,
        "evaluations": int(result.steps),
        "readings": result.reading_count,
        "not_determined": result.undetermined_directions,
        "warnings": result.warnings,
        "result": "successful",
    }
