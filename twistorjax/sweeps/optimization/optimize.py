"""Optimization of a design within limits, also for several cases."""

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..._utils.progress import announced
from ..._utils.types import NumbersLike
from ..._utils.validation import compilation_error, quote, require_float64
from ...designs.design_space import DesignSpace
from ..executor import find_program
from .limits import Limit
from .optimum import Optimum
from .problem import Margins, Problem
from .searches import run_searches, SearchOptions


# Number of designs that one call of the program evaluates if there are several searches.
# It is the same for all of them, so that they share the program. On a processor, the time
# for each design is the same with 8 designs as with 64.
_CPU_DESIGNS, _ACCELERATOR_DESIGNS = 8, 256


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
    part: tuple[int, int] | None = None,
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
        part: The k-th of n parts of the searches, as `(k, n)`, for the jobs of a cluster
            that share a `store`, as for `sweep`. The optimum is the best one of all
            searches that are finished.
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
            optimization; or there is no such part.
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
    search_options = SearchOptions(
        starts=starts,
        seed=seed,
        tolerance=tolerance,
        max_steps=max_steps,
        store=store,
        resume=resume,
        part=part,
        progress=progress,
    )
    problem = _create_problem(
        study,
        parameters,
        minimize=minimize,
        maximize=maximize,
        limits=limits,
        standard_deviations=standard_deviations,
        coverage_factor=coverage_factor,
        units=units,
        alone=np.ndim(starts) == 0 and starts == 1,
    )
    (optimum,) = run_searches([problem], search_options)
    return optimum.succeeded_or_raise() if throw else optimum


@announced("optimization")
def optimize_cases(
    study: Callable[[Any], Any],
    parameters: Any,
    cases: Mapping[str, NumbersLike],
    **options: Any,
) -> tuple[Optimum, ...]:
    """Optimize a design for several values of a limit or of a constant.

    All searches of all cases run side by side in one compiled program. With several
    values of a limit, the optima are points of a Pareto front.

    Args:
        study: Function of one design, as for `optimize`.
        parameters: One design, as for `optimize`.
        cases: Values by name, one for each case: of a limited output, whose lower or
            upper limit they replace, or of a constant among the parameters.
        options: Further arguments of `optimize`. `throw` is False by default: a case
            without an optimum has a `result` with the reason.

    Returns:
        The optimum of each case.

    Raises:
        ValueError: The cases are empty or have different lengths; a name is neither that
            of a limited output nor of a constant number; the limit has two sides; or
            `optimize` would raise an error.
        RuntimeError: `throw` is True and a case has no optimum.

    Example:
        >>> import twistorjax as tj
        >>> def plate(design):
        ...     return {
        ...         "mass": design["thickness"] * design["width"],
        ...         "stiffness": design["width"] * design["thickness"] ** 3,
        ...     }
        >>> start = {
        ...     "thickness": tj.Parameter(1.0, lower=0.5, upper=2.0),
        ...     "width": tj.Parameter(1.0, lower=0.5, upper=2.0),
        ... }
        >>> front = tj.sweeps.optimize_cases(
        ...     plate,
        ...     start,
        ...     {"stiffness": [1.0, 2.0, 4.0]},
        ...     minimize="mass",
        ...     limits={"stiffness": tj.Limit(lower=1.0)},
        ... )
        >>> [round(optimum.objective, 3) for optimum in front]
        [0.63, 0.794, 1.0]
    """
    options = {"throw": False, **options}
    # The options that are left out have the defaults of `optimize`.
    call = inspect.signature(optimize).bind(study, parameters, **options)
    call.apply_defaults()
    arguments = call.arguments
    throw = arguments.pop("throw")
    search_options = SearchOptions(
        **{field.name: arguments.pop(field.name) for field in fields(SearchOptions)}
    )
    values = {name: np.asarray(array, float) for name, array in cases.items()}
    shapes = [array.shape for array in values.values()]
    if not shapes or len({*shapes}) > 1 or len(shapes[0]) != 1 or not shapes[0][0]:
        raise ValueError(
            f"`cases` has values of the shapes {shapes}, but needs one number for each "
            "case, and at least one case."
        )
    common = _create_problem(**arguments, alone=False)
    problems = [
        _with_values(common, dict(zip(values, case, strict=True)))
        for case in zip(*values.values(), strict=True)
    ]
    optima = tuple(run_searches(problems, search_options))
    return tuple(each.succeeded_or_raise() for each in optima) if throw else optima


def _create_problem(
    study: Callable[[Any], Any],
    parameters: Any,
    *,
    minimize: str | None,
    maximize: str | None,
    limits: Mapping[str, Limit] | None,
    standard_deviations: Mapping[str, NumbersLike] | None,
    coverage_factor: float,
    units: Mapping[str, str] | None,
    alone: bool,
) -> Problem:
    """Check the arguments of `optimize`, and trace the program of the study.

    A search that is `alone` evaluates one design at a time.
    """
    require_float64(jnp.zeros(()))
    objective = minimize if maximize is None else maximize
    if objective is None or None not in (minimize, maximize):
        raise ValueError(
            f"`minimize` is {quote(minimize)} and `maximize` is {quote(maximize)}. Give "
            "one of them: the name of an output."
        )
    mappings = {
        "limits": limits, "standard_deviations": standard_deviations, "units": units
    }  # fmt: skip
    for name, given in mappings.items():
        if given is not None and not isinstance(given, Mapping):
            raise ValueError(
                f"`{name}` is {quote(given)}, but must be a mapping from names to values."
            )
    limits, standard_deviations, units = (dict(each or {}) for each in mappings.values())
    for name, limit in limits.items():
        if not isinstance(limit, Limit):
            raise ValueError(
                f"`limits[{quote(name)}]` is {quote(limit)}, but must be a `Limit`: "
                "`tj.Limit(upper=...)`."
            )
        if standard_deviations and np.any(limit.lower == limit.upper):
            raise ValueError(
                f"`limits` prescribes {quote(name)}, which is uncertain because of "
                "`standard_deviations`. Give two different limits."
            )
    if not coverage_factor > 0:
        raise ValueError(f"`coverage_factor` is {coverage_factor}, but must be positive.")
    if not callable(study):
        raise ValueError(f"`study` is {study!r}, but must be a function of one design.")
    space = DesignSpace.from_tree(parameters, standard_deviations)
    on_cpu = jax.default_backend() == "cpu"
    size = 1 if alone else _CPU_DESIGNS if on_cpu else _ACCELERATOR_DESIGNS
    names = tuple(dict.fromkeys([objective, *limits]))
    try:
        program = find_program(study, space.structure, names, size, math.inf, None, True)
    except jax.errors.JAXTypeError as error:
        raise compilation_error("study", "about the design", error) from error
    except ValueError as error:
        message = str(error)
        where = "`limits` names"
        if f"names {quote(objective)}" in message:
            where = f"`{'minimize' if maximize is None else 'maximize'}` is"
        message = message.replace("`derivatives` names", where)
        raise ValueError(message) from error
    outputs = program.output.columns
    if unknown := [name for name in units if name not in outputs]:
        raise ValueError(
            f"`units` names {quote(unknown[0])}, which is not an output of the study."
        )
    columns = {}
    for name in names:
        column = outputs[name]
        if np.issubdtype(column.values.dtype, np.complexfloating):
            raise ValueError(
                f"The output {quote(name)} is complex, but an objective and a limited "
                "output must be real. Return its magnitude, `jnp.abs(...)`, or its real "
                "part."
            )
        unit = column.unit or units.get(name, "")
        columns[name] = replace(column, unit=unit)
    if shape := columns[objective].values.shape[1:]:
        raise ValueError(
            f"The objective {quote(objective)} has shape {shape}, but must be a scalar."
        )
    return Problem(
        study=study,
        program=program,
        space=space,
        objective_name=objective,
        sign=1.0 if maximize is None else -1.0,
        columns=columns,
        limits=limits,
        margins=Margins.of(limits, columns, float(coverage_factor)),
        standard_deviations=standard_deviations,
    )


def _with_values(problem: Problem, values: Mapping[str, float]) -> Problem:
    """Replace limits and constants of an optimization by other values."""
    space, limits = problem.space, dict(problem.limits)
    start = space.start.copy()
    for name, value in values.items():
        if name in limits:
            limit = limits[name]
            if limit.lower is not None and limit.upper is not None:
                raise ValueError(
                    f"`cases` has {quote(name)}, whose limit has two sides. Give "
                    "`limits` with one side of it."
                )
            side = "lower" if limit.upper is None else "upper"
            limits[name] = Limit(**{side: value})
            continue
        rows = [
            row
            for row, number in enumerate(space.names)
            if number == name and not space.is_variable[row]
        ]
        if not rows:
            raise ValueError(
                f"`cases` has {quote(name)}, but must name a limited output or a "
                "constant number among the parameters."
            )
        start[rows[0]] = value
    return problem._replace(
        space=space._replace(start=start),
        limits=limits,
        margins=Margins.of(limits, problem.columns, problem.margins.coverage_factor),
    )
