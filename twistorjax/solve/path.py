"""Equilibrium path of a mechanism, with its stable and unstable equilibria."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from .._compile.traced_function import traced
from .._utils.host import all_concrete, as_float, is_traced, padded_size, take_rows
from .._utils.progress import announced
from .._utils.pytrees import stop_gradient
from .._utils.types import NumberLike, NumbersLike, PoseLike
from .._utils.validation import require_positive, warn
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Drive, Load
from ..mechanism.mechanism import Mechanism
from ..results.codes import finish
from .continuation.diagnosis import path_message
from .continuation.program import (
    evaluate_path,
    first_rows,
    run_refined,
    solve_path,
    Until,
)
from .continuation.setup import (
    assemble_path,
    check_settings,
    PathStrokes,
    PathTemperature,
    StartLike,
)
from .continuation.solution import Path, PathPoint
from .continuation.start import FirstPoint
from .equations.state import warn_outside_linear_range


@announced("path")
def path(
    mechanism: Mechanism,
    *,
    loads: Sequence[Load] = (),
    drives: Sequence[Drive] = (),
    strokes: PathStrokes = MappingProxyType({}),
    temperature: PathTemperature | None = None,
    constant_loads: Sequence[Load] = (),
    constraints: Sequence[AbstractConstraint] = (),
    start: StartLike | None = None,
    direction: int | Mapping[str, PoseLike] = 1,
    load_factors: NumbersLike = (-1.0, 1.0),
    until: Until | None = None,
    largest_step: float = 0.1,
    max_points: int = 500,
    max_critical: int = 10,
    time: NumberLike = 0.0,
    throw: bool = True,
) -> Path:
    """Follow the equilibria of a mechanism while its loads are multiplied by a factor.

    `equilibrium` finds stable equilibria only. A path continues through limit points, at
    which a mechanism snaps through, and through unstable equilibria. It begins at the
    load factor zero and ends where the load factor leaves an interval. Limit points and
    branch points are located, and have derivatives. The steps become shorter where the
    path is curved. Mechanisms of many bodies are solved with dense matrices.

    Args:
        mechanism: The mechanism. Its misfits are constant.
        loads: Loads that are multiplied by the load factor. Their magnitude should be
            that of the expected loads.
        drives: Prescribed displacements that are multiplied by the load factor.
        strokes: Strokes of actuators that are multiplied by the load factor, or a smooth
            function of it; see `Mechanism.with_strokes`; rad, m, m.
        temperature: Change of the temperature that is multiplied by the load factor, or a
            smooth function of it; see `Mechanism.at_temperature`; K.
        constant_loads: Loads that are not multiplied, such as weights.
        constraints: Pins, sliders, and other constraints between the bodies.
        start: Equilibrium or poses from which the first equilibrium is computed, a stable
            one at the load factor zero; or a branch point or a multiple limit point of
            another path of the same loads, from which the path follows another branch; by
            default the equilibrium without the multiplied loads that is connected to the
            reference configuration.
        direction: 1 to begin with increasing load factors, -1 with decreasing ones. At a
            branch point, 1 to begin in the direction of its mode, -1 in the opposite one;
            or displacements of bodies by their names, of which the part without stiffness
            is the direction. Several branches leave a multiple branch point; rad, m, m.
        load_factors: Interval of the load factor, which contains that of the first point.
            The last point is at one of its ends, unless the path ends for another reason.
        until: Function of a `PathPoint`. The path ends where its sign changes. It is
            traced in each call, with the values that its variables have at this time.
        largest_step: Largest distance of successive points: rotations (rad), translations
            over the characteristic length of the mechanism, and load factors.
        max_points: Largest number of points.
        max_critical: Largest number of critical points that are located. If there are
            more, a warning says so.
        time: Time at which time-dependent constraints are evaluated; s.
        throw: Whether a failure raises an error. If False, the path up to the failure is
            returned, and `result` is the reason.

    Returns:
        The path.

    Raises:
        ValueError: Double precision is disabled, a name is unknown, a degree of freedom
            is prescribed twice, nothing is multiplied by the load factor, `start` is a
            simple limit point, the stiffness resists `direction`, or a setting is
            invalid.
        TypeError: `until` returns a truth value or an array.
        RuntimeError: There is no first equilibrium, a hinge leaves the validity range of
            its energy, a critical point is not found, `until` returns NaN, or the path
            cannot be continued.

    Source:
        Keller, Numerical solution of bifurcation and nonlinear eigenvalue problems, in
        Applications of Bifurcation Theory, 1977.

    Example:
        >>> import numpy as np
        >>> import twistorjax as tj
        >>> length, angle = np.hypot(1.0, 0.3), np.arctan2(0.3, 1.0)
        >>> bar = tj.energies.AxialSpring(1000.0, length=length)
        >>> bodies = [tj.Body("wall"), tj.Body("apex", pose=(0.0, 0.0, 0.3))]
        >>> left = tj.Hinge("left", "wall", "apex", bar, at=(angle, -0.5, 0.15))
        >>> right = tj.Hinge("right", "apex", "wall", bar, at=(-angle, 0.5, 0.15))
        >>> fixed = {"wall": ["angle", "x", "y"], "apex": ["angle"]}
        >>> truss = tj.Mechanism(bodies, [left, right], fixed=fixed)
        >>> snap = tj.path(truss, loads=[tj.Load("apex", force=(0.0, -20.0))])
        >>> [point.kind for point in snap.critical_points]
        ['limit', 'limit']
        >>> snap.critical_points.load_factors  # the truss snaps at 9.95 N
        Array([ 0.4975, -0.4975], dtype=float64)
    """
    check_settings(direction, load_factors, max_points, max_critical)
    step = require_positive("`largest_step`", largest_step)
    system, first = assemble_path(
        mechanism, loads, drives, strokes, temperature, constant_loads, constraints,
        start, direction, time,
    )  # fmt: skip
    _require_inside(first, load_factors)
    if until is not None:
        start_point = PathPoint(
            load_factor=first.factor,
            displacements=first.displacements,
            reference=mechanism.reference,
            energy=first.factor,
            names=mechanism.names,
        )
        until = traced(until, start_point)
    limits = as_float(load_factors)
    arguments = system, first, limits, step, until
    # Outside of programs, their numbers are known also if JAX differentiates.
    constants = stop_gradient(arguments)
    if is_traced(constants):
        return solve_path(*arguments, max_points, max_critical)
    run = run_refined(*constants, max_points=max_points, max_critical=max_critical)
    count = int(run.trace.number)
    rows = min(padded_size(count, 64), len(run.trace.points))
    found = evaluate_path(system, limits, until, first_rows(run, rows))
    found = _first_points(found, count)
    if throw:
        warn_outside_linear_range(mechanism, found.range_shares)
        _warn_of_more_critical_points(found, max_critical)

    def error(item: str, batch_index: tuple[int, ...]) -> Exception:
        del batch_index
        failure = RuntimeError(path_message(item, constants[0], run))
        if count > 1:
            failure.add_note(
                f"{count} points up to the load factor "
                f"{float(run.trace.points[count - 1, -1]):.6g} were found; `path(..., "
                "throw=False)` returns them."
            )
        return failure

    return finish(found, throw, error)


def _require_inside(first: FirstPoint, load_factors: NumbersLike) -> None:
    """Check that a path begins in the interval of its load factors."""
    known = all_concrete([first.factor, load_factors])
    if known is None:
        return
    factor, (lower, upper) = known
    if not lower <= factor <= upper:
        raise ValueError(
            f"`load_factors` is ({lower:g}, {upper:g}), but must contain the load factor "
            f"{factor:.6g}, at which the path begins."
        )


def _first_points(found: Path, count: int) -> Path:
    """Return a path without the rows that are not used."""
    points = found.critical_points
    names = (
        "load_factors",
        "displacements",
        "reactions",
        "constraint_forces",
        "energies",
        "negative_eigenvalues",
        *(() if found.range_shares is None else ("range_shares",)),
    )
    of_criticals = (
        "load_factors",
        "displacements",
        "energies",
        "reactions",
        "modes",
        "is_branch",
        "multiplicities",
        "rows",
    )

    def first(source: Any, names: Sequence[str], rows: int) -> dict[str, Any]:
        return {name: take_rows(getattr(source, name), slice(rows)) for name in names}

    points = replace(points, **first(points, of_criticals, int(points.count)))
    stresses = found.stresses
    if stresses is not None:
        stresses = replace(stresses, **first(stresses, ("largest",), count))
    return replace(
        found, critical_points=points, stresses=stresses, **first(found, names, count)
    )


def _warn_of_more_critical_points(found: Path, max_critical: int) -> None:
    """Warn if the stability changes more often than critical points are located."""
    points = found.critical_points
    changes = np.sum(np.abs(np.diff(np.asarray(found.negative_eigenvalues))))
    if len(points) == max_critical and changes > np.sum(
        np.asarray(points.multiplicities)
    ):
        warn(
            f"`max_critical` is {max_critical}, but the stability changes again behind "
            "the last critical point that was located. Increase `max_critical`."
        )
