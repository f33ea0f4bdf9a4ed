"""`twistorjax identify`: stiffnesses found from a motion."""

import sys
from typing import Annotated

import typer

from .common import in_json, need, need_seed, prepare_jax, SolveError, UsageError


def identify(
    seed: Annotated[
        int, typer.Option(help="Of the random errors of the camera; -1 for none.")
    ] = 0,
    angle: Annotated[
        float, typer.Option(help="Standard deviation of the camera's angles; rad.")
    ] = 1e-5,
    travel: Annotated[
        float, typer.Option(help="Standard deviation of its travels; m.")
    ] = 1e-6,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object instead of a table.")
    ] = False,
) -> None:
    """Three stiffnesses of hinge A of the four-bar linkage, from its motion.

    Link 3 is let go with 10 m/s, and a camera takes 101 pictures of the three links in
    0.05 s. The fit starts at 1.5, 0.6 and 0.5 times the true stiffnesses.

    Example: twistorjax identify --seed 3 --travel 1e-5
    """
    need("--angle", angle, "rad")
    need("--travel", travel, "m")
    if seed < -1:
        raise UsageError(
            f"--seed is {seed}, but must be 0 or larger, or -1 for no errors."
        )
    need_seed("--seed", seed, lowest=-1)
    prepare_jax()
    import jax

    from ..examples import identification as case

    key = None if seed == -1 else jax.random.key(seed)
    try:
        found = case.hinge_a(
            key, angle=angle, travel=travel, progress=sys.stderr.isatty()
        )
    except RuntimeError as error:
        raise SolveError(str(error)) from None
    except ValueError as error:  # deviations whose squares are no numbers
        raise UsageError(f"--angle or --travel cannot be used: {error}") from None
    if not as_json:
        print(found)
        print("true: " + ", ".join(f"{name} {case.LEAF[name]:g}" for name in found.names))
        return
    print(
        in_json(
            {
                "estimates": {k: float(v) for k, v in found.estimates.items()},
                "standard_errors": {
                    k: float(v) for k, v in found.standard_errors.items()
                },
                "true": case.LEAF,
                "units": dict(zip(found.names, found.units, strict=True)),
                "covariance": found.covariance.tolist(),
                "names": found.names,
                "evaluations": int(found.steps),
                "readings": found.readings,
                "not_determined": found.undetermined,
                "warnings": found.warnings,
                "result": "successful",
            }
        )
    )
