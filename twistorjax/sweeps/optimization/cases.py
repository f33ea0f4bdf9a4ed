"""Several optimizations side by side, which differ in limits or constants."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..._utils.progress import announced
from ..._utils.types import NumbersLike
from ..._utils.validation import quote
from .limits import Limit
from .optimum import Optimum
from .options import Options
from .searches import run_searches
from .setup import Setup
from .summary import summarize


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
    chosen = Options(**{"throw": False, **options})
    values = {name: np.asarray(array, float) for name, array in cases.items()}
    shapes = [array.shape for array in values.values()]
    if not shapes or len({*shapes}) > 1 or len(shapes[0]) != 1 or not shapes[0][0]:
        raise ValueError(
            f"`cases` has values of the shapes {shapes}, but needs one number for each "
            "case, and at least one case."
        )
    count = shapes[0][0]
    common = Setup.create(study, parameters, chosen)
    setups, starts = [], []
    for case in range(count):
        setup = _with_values(common, {name: a[case] for name, a in values.items()})
        vectors = chosen.start_vectors(common.space)
        constant = ~setup.space.is_variable
        vectors[:, constant] = setup.space.start[constant]
        setups.append(setup)
        starts.append(vectors)
    found = run_searches(setups, starts, chosen)
    optima = tuple(
        summarize(setup, problem, vectors, ends)
        for setup, vectors, (problem, ends) in zip(setups, starts, found, strict=True)
    )
    return tuple(o.succeeded_or_raise() for o in optima) if chosen.throw else optima


def _with_values(setup: Setup, values: Mapping[str, Any]) -> Setup:
    """Replace limits and constants of an optimization by other values."""
    limits, start = dict(setup.limits), setup.space.start.copy()
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
            for row, number in enumerate(setup.space.names)
            if number == name and not setup.space.is_variable[row]
        ]
        if not rows:
            raise ValueError(
                f"`cases` has {quote(name)}, but must name a limited output or a "
                "constant number among the parameters."
            )
        start[rows[0]] = value
    return setup._replace(limits=limits, space=setup.space._replace(start=start))
