"""Optimization of a design within limits."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ..._utils.progress import announced
from ..._utils.types import NumbersLike
from .limits import Limit
from .optimum import Optimum
from .options import Options
from .searches import run_searches
from .setup import Setup
from .summary import summarize


@announced("optimization")
def optimize(
    study: Callable[[Any], Any],
    parameters: Any,
    *,
    minimize: str | None = None,
    maximize: str | None = None,
    limits: Mapping[str, Limit] | None = None,
    starts: Any = 1,
    seed: int = 0,
    standard_deviations: Mapping[str, NumbersLike] | None = None,
    coverage_factor: float = 3.0,
    units: Mapping[str, str] | None = None,
    tolerance: float = 1e-10,
    max_steps: int = 500,
    store: str | Path | None = None,
    resume: bool = False,
    progress: bool = False,
    throw: bool = True,
) -> Optimum:
    """Optimize a design within bounds of its parameters and limits of its outputs.

    The searches begin at several starts and run side by side: a single compiled program
    computes the outputs and their exact derivatives for the designs of all searches. Each
    search finds a local optimum by the SLSQP method of SciPy. The variables are divided
    by their start values, the objective by its gradient at the first start, and the
    limited outputs by their limits, so units have no effect. Where the gradient becomes
    small, the objective is scaled anew, and the search continues.

    With `standard_deviations`, the limits hold for the output plus or minus
    `coverage_factor` standard deviations, which follow to first order from the exact
    derivatives. The uncertain parameters are independent. Bounds hold for the nominal
    values of the variables.

    Args:
        study: Function of one design, as for `sweep`. It builds a mechanism, solves it
            with `throw=False`, and returns named outputs, preferably with the `result` of
            each solve.
        parameters: One design, as the study takes it. Each `Parameter` in it is a
            variable with a start value and bounds, which are included. The other numbers
            are constants. If there is no `Parameter`, all real numbers are variables.
        minimize: Name of the output that is minimized. Give this or `maximize`.
        maximize: Name of the output that is maximized.
        limits: Limits of outputs, by name.
        starts: Number of searches, of which the first begins at `parameters` and the
            others at random designs between the bounds. Or the designs at which the
            searches begin, as `sweep` takes them.
        seed: Seed of the random designs.
        standard_deviations: Standard deviation of each uncertain parameter, by name:
            variables or constants.
        coverage_factor: Number of standard deviations at which the limits must hold.
        units: Units of outputs without a unit of their own, by name.
        tolerance: Tolerance of the objective, relative to the norm of its gradient with
            respect to relative changes of the variables at the first start.
        max_steps: Largest number of steps of each search.
        store: Folder in zarr format in which the end of each search is saved;
            `tj.sweeps.open_sweep` reads it.
        resume: Whether an existing store is continued. Finished searches are not
            repeated.
        progress: Whether a progress bar is shown.
        throw: Whether a failure raises an error. If False, `result` holds the reason.

    Returns:
        The best local optimum, its active limits with their multipliers, and the ends of
        all searches.

    Raises:
        ImportError: A store is used and zarr or xarray is not installed.
        ValueError: Double precision is off; there is no variable, or not exactly one
            objective; the objective is not a scalar; a limit has no output; a variable
            without bounds has no random starts; or the store exists or belongs to another
            optimization.
        RuntimeError: No search ended at an optimum within all limits, or the study fails
            at all starts.

    Source:
        Kraft, A software package for sequential quadratic programming, DFVLR-FB 88-28,
        1988, for the method; Nocedal and Wright, Numerical Optimization, chapter 12, for
        the multipliers.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3)
        >>> def leaf_spring(design):
        ...     length, thickness, width = design["length"], design["thickness"], 10e-3
        ...     area_moment = width * thickness**3 / 12
        ...     stiffness = 3 * steel.modulus * area_moment / length**3
        ...     force = stiffness * 1e-3
        ...     stress = 6 * force * length / (width * thickness**2)
        ...     return {"stiffness": stiffness, "stress": stress}
        >>> optimum = tj.optimize(
        ...     leaf_spring,
        ...     {
        ...         "length": tj.Parameter(40e-3, "m", lower=20e-3, upper=60e-3),
        ...         "thickness": tj.Parameter(0.5e-3, "m", lower=0.2e-3, upper=1e-3),
        ...     },
        ...     maximize="stiffness",
        ...     limits={"stress": tj.Limit(upper=250e6)},
        ...     units={"stiffness": "N/m", "stress": "Pa"},
        ... )
        >>> print(optimum)
        stiffness maximized: ...
    """
    options = Options(
        minimize=minimize,
        maximize=maximize,
        limits=limits,
        starts=starts,
        seed=seed,
        standard_deviations=standard_deviations,
        coverage_factor=coverage_factor,
        units=units,
        tolerance=tolerance,
        max_steps=max_steps,
        store=store,
        resume=resume,
        progress=progress,
    )
    setup = Setup.create(study, parameters, options)
    vectors = options.start_vectors(setup.space)
    ((problem, ends),) = run_searches([setup], [vectors], options)
    optimum = summarize(setup, problem, vectors, ends)
    return optimum.succeeded_or_raise() if throw else optimum
