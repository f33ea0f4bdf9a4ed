"""Equilibrium path of a mechanism, with its stable and unstable equilibria."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from typing_extensions import TypeAliasType

from .._utils.host import as_float, concrete, is_traced, padded_size, take_rows
from .._utils.types import NumberLike, NumbersLike, PoseLike, Poses, Scalar
from .._utils.validation import require_float64, require_positive
from ..mechanism.constraints import AbstractConstraint, gather_constraints
from ..mechanism.hinge_changes import (
    as_temperature,
    HingeChanges,
    Temperature,
    TemperatureInTime,
)
from ..mechanism.loads import Drive, Load, LoadSet, prescribed_dofs
from ..mechanism.mechanism import Mechanism
from ..mechanism.support import require_support
from .dofs import DofPartition
from .path_program import evaluate_path, first_rows, run_path, solve_path, Until
from .path_results import CriticalPoint, Path
from .path_system import PathSystem
from .results import result_message, succeeded_or_raise
from .statics import equilibrium, StateLike


# Strokes by hinges, or a function of the load factor that returns them
PathStrokes = TypeAliasType(
    "PathStrokes", Mapping[str, PoseLike] | Callable[[Scalar], Mapping[str, PoseLike]]
)
# A change of the temperature, or a function of the load factor that returns it; K
PathTemperature = TypeAliasType(
    "PathTemperature", NumberLike | Temperature | TemperatureInTime
)
StartLike = TypeAliasType("StartLike", StateLike | CriticalPoint)


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
    direction: int = 1,
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
        start: Equilibrium or poses near the first equilibrium, at the load factor zero;
            or a branch point of another path of the same loads, from which the path
            follows the other branch; by default the equilibrium without the multiplied
            loads that is connected to the reference configuration.
        direction: 1 to begin with increasing load factors, -1 with decreasing ones. At a
            branch point, 1 to begin in the direction of its mode, -1 in the opposite one.
        load_factors: Interval of the load factor. The last point is at one of its ends.
        until: Function of a `PathPoint`. The path ends where its sign changes.
        largest_step: Largest distance of successive points: rotations (rad), translations
            over the characteristic length of the mechanism, and load factors.
        max_points: Largest number of points.
        max_critical: Largest number of critical points that are located.
        time: Time at which time-dependent constraints are evaluated; s.
        throw: Whether a failure raises an error. If False, the path up to the failure is
            returned, and `result` is the reason.

    Returns:
        The path.

    Raises:
        ValueError: Double precision is disabled, a name is unknown, a degree of freedom
            is prescribed twice, nothing is multiplied by the load factor, or a setting is
            invalid.
        RuntimeError: There is no first equilibrium, a hinge leaves the validity range of
            its energy, or the path cannot be continued.

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
    require_float64(mechanism.reference)
    constraint_set = gather_constraints(mechanism, constraints)
    require_support(mechanism, constraint_set.bodies)
    _check_settings(direction, load_factors, max_points, max_critical)
    step = require_positive("`largest_step`", largest_step)
    changes = _changes(strokes, temperature)
    if not loads and not drives and changes is None:
        raise ValueError(
            "Nothing is multiplied by the load factor. Give `loads`, `drives`, "
            "`strokes`, or `temperature`."
        )
    prescribed, targets = prescribed_dofs(mechanism, drives)
    dofs = DofPartition.of(mechanism, prescribed)
    first_factor = jnp.zeros(())
    if isinstance(start, CriticalPoint):
        displacements, first_factor = start.displacements, start.load_factor
        begin = dofs.fixed_part(displacements)
    else:
        displacements = begin = _first_displacements(
            mechanism, changes, constant_loads, constraints, start, time
        )
    system = PathSystem(
        mechanism=mechanism,
        loads=LoadSet.of(mechanism, loads),
        constant_loads=LoadSet.of(mechanism, constant_loads),
        constraints=constraint_set,
        changes=changes,
        start=begin,
        targets=jnp.array(targets, float),
        time=as_float(time),
        dofs=dofs,
    )
    branch = start if isinstance(start, CriticalPoint) else None
    limits = as_float(load_factors)
    arguments = system, displacements, first_factor, branch, limits, step
    numbers = direction, until, max_points, max_critical
    if is_traced(arguments):
        return solve_path(*arguments, *numbers)
    run = run_path(*arguments, *numbers)
    count = int(run.trace.number)
    rows = min(padded_size(count, 16), max_points)
    found = _first_points(evaluate_path(system, first_rows(run, rows)), count)
    return _checked(found) if throw else found


def _check_settings(
    direction: int, load_factors: NumbersLike, max_points: int, max_critical: int
) -> None:
    """Check the settings of a path.

    Raises:
        ValueError: A setting is invalid.
    """
    if direction not in (1, -1):
        raise ValueError(f"`direction` is {direction!r}, but must be 1 or -1.")
    limits = concrete(load_factors)
    if limits is not None and (limits.shape != (2,) or not limits[0] < limits[1]):
        raise ValueError(
            f"`load_factors` is {load_factors!r}, but must be a smaller and a larger "
            "load factor, between which the path is followed."
        )
    if max_points < 3 or max_critical < 1:
        raise ValueError(
            f"`max_points` is {max_points!r} and `max_critical` is {max_critical!r}, but "
            "`max_points` must be at least 3, and `max_critical` at least 1."
        )


def _changes(
    strokes: PathStrokes, temperature: PathTemperature | None
) -> HingeChanges | None:
    """Gather strokes and temperatures as functions of the load factor."""
    of_strokes = of_temperature = None
    if callable(strokes):
        of_strokes = strokes
    elif not isinstance(strokes, Mapping) or strokes:
        of_strokes = eqx.Partial(_multiplied, strokes)
    if callable(temperature):
        of_temperature = temperature
    elif temperature is not None:
        of_temperature = eqx.Partial(_multiplied, as_temperature(temperature))
    if of_strokes is None and of_temperature is None:
        return None
    return HingeChanges(of_strokes, of_temperature)


def _multiplied(values: Any, factor: Scalar) -> Any:
    """Multiply strokes or temperatures by the load factor."""
    return jax.tree.map(lambda value: factor * jnp.asarray(value, float), values)


def _first_displacements(
    mechanism: Mechanism,
    changes: HingeChanges | None,
    constant_loads: Sequence[Load],
    constraints: Sequence[AbstractConstraint],
    start: StateLike | None,
    time: NumberLike,
) -> Poses:
    """Compute the equilibrium at the load factor zero; rad, m, m."""
    if start is not None:
        start = mechanism.displacements(start, "start", single=True)
    if changes is not None:
        hinges = changes.state(mechanism, jnp.zeros(())).hinges(mechanism)
        mechanism = eqx.tree_at(lambda new: new.hinge_assembly, mechanism, hinges)
    deformed = mechanism.hinge_assembly.misfits is not None
    if start is None and not (deformed or constant_loads or constraints):
        return jnp.zeros_like(mechanism.reference)
    return equilibrium(
        mechanism, loads=constant_loads, constraints=constraints, start=start, time=time
    ).displacements


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
    )
    of_criticals = ("load_factors", "displacements", "energies", "modes", "is_branch")

    def first(source: Any, names: Sequence[str], rows: int) -> dict[str, Any]:
        return {name: take_rows(getattr(source, name), slice(rows)) for name in names}

    points = replace(points, **first(points, of_criticals, int(points.count)))
    return replace(found, critical_points=points, **first(found, names, count))


def _checked(found: Path) -> Path:
    """Return the path, and raise an error if it ended by a failure."""

    def error(item: str, batch_index: tuple[int, ...]) -> Exception:
        del batch_index
        return RuntimeError(
            f"{result_message(item)} ({len(found.load_factors)} points up to the load "
            f"factor {float(found.load_factors[-1]):.6g} were found; "
            "`path(..., throw=False)` returns them.)"
        )

    return succeeded_or_raise(found, error)
