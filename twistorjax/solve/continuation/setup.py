"""Equations and first point of a path, from the arguments of a user."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from typing_extensions import TypeAliasType

from ..._utils.host import as_float, concrete
from ..._utils.types import NumberLike, NumbersLike, PoseLike, Poses, Scalar
from ..._utils.validation import index_of, require_pose
from ...mechanism.changes import (
    as_temperature,
    HingeChanges,
    TemperatureInTime,
    with_arrays,
)
from ...mechanism.constraints import AbstractConstraint, require_rigid_joints
from ...mechanism.loads import Drive, Load, LoadSet
from ...mechanism.mechanism import Mechanism
from ...mechanism.misfits import Temperature
from ..equations.problem import Problem
from ..statics.errors import finish_equilibrium
from ..statics.solution import StateLike
from ..statics.solver import solve
from .diagnosis import describe_critical_point
from .solution import CriticalPoint
from .start import branch_mode, FirstPoint, regular_point
from .system import PathSystem


# Strokes by hinges, or a function of the load factor that returns them
PathStrokes = TypeAliasType(
    "PathStrokes", Mapping[str, PoseLike] | Callable[[Scalar], Mapping[str, PoseLike]]
)

# A change of the temperature, or a function of the load factor that returns it; K
PathTemperature = TypeAliasType(
    "PathTemperature", NumberLike | Temperature | TemperatureInTime
)

StartLike = TypeAliasType("StartLike", StateLike | CriticalPoint)


def assemble_path(
    mechanism: Mechanism,
    loads: Sequence[Load],
    drives: Sequence[Drive],
    strokes: PathStrokes,
    temperature: PathTemperature | None,
    constant_loads: Sequence[Load],
    constraints: Sequence[AbstractConstraint],
    start: StartLike | None,
    direction: int | Mapping[str, PoseLike],
    time: NumberLike,
    begin: Poses | None = None,
) -> tuple[PathSystem, FirstPoint]:
    """Check the arguments of `path`, and assemble the equations and the first point.

    If the first displacements (rad, m, m) are given by `begin`, those that are prescribed
    are measured from them. A `RuntimeError` is raised if there is no first equilibrium.
    """
    changes = changes_by_factor(strokes, temperature)
    if not loads and not drives and changes is None:
        raise ValueError(
            "Nothing is multiplied by the load factor. Give `loads`, `drives`, "
            "`strokes`, or `temperature`."
        )
    problem = Problem.of(mechanism, loads, drives, constraints, time)
    if temperature is not None:
        require_rigid_joints(mechanism, constraints)
    if isinstance(start, CriticalPoint):
        is_simple_limit = concrete(~start.is_branch & (start.multiplicity == 1))
        if is_simple_limit is not None and is_simple_limit:
            raise ValueError(
                "`start` is a limit point, but must be a branch point: no other path "
                "leaves at a limit point."
            )
        begin = jnp.zeros_like(mechanism.reference)
        first = FirstPoint(
            displacements=start.displacements,
            factor=as_float(start.load_factor),
            direction=jnp.asarray(
                1 if isinstance(direction, Mapping) else direction, float
            ),
            at_branch=jnp.ones((), bool),
            mode=start.mode,
        )
    else:
        if isinstance(direction, Mapping):
            raise ValueError(
                "`direction` has displacements, but `start` is no branch point: give 1 "
                "to begin with increasing load factors, or -1 with decreasing ones."
            )
        if begin is None:
            begin = first_displacements(problem, constant_loads, start, changes)
        first = regular_point(begin, jnp.zeros(()), direction)
    unscaled = LoadSet.of(mechanism, constant_loads)
    system = PathSystem.of(problem, unscaled, begin, changes)
    if isinstance(start, CriticalPoint) and isinstance(direction, Mapping):
        mode = branch_mode(
            system, first.displacements, first.factor, jnp.asarray(start.multiplicity),
            _named_displacements(mechanism, direction),
        )  # fmt: skip
        size = concrete(jnp.sum(mode**2))
        if size is not None and not size > 0:
            raise ValueError(
                f"`direction` names {', '.join(map(repr, direction))}, but the branch "
                "point has no mode in which they move in this direction."
            )
        first = first._replace(mode=mode)
    return system, first


def _named_displacements(
    mechanism: Mechanism, displacements: Mapping[str, PoseLike]
) -> Poses:
    """Arrange displacements that are given by the names of bodies; rad, m, m."""
    rows = jnp.zeros_like(mechanism.reference)
    for body, displacement in displacements.items():
        row = index_of("`direction`", "body", body, mechanism.names)
        rows = rows.at[row].set(require_pose(f"`direction` of {body!r}", displacement))
    return rows


def changes_by_factor(
    strokes: PathStrokes, temperature: PathTemperature | None = None
) -> HingeChanges | None:
    """Gather strokes and temperatures as functions of the load factor."""
    of_strokes = of_temperature = None
    if callable(strokes):
        of_strokes = strokes
    elif not isinstance(strokes, Mapping) or strokes:
        of_strokes = eqx.Partial(_multiplied, with_arrays(strokes))
    if callable(temperature):
        of_temperature = temperature
    elif temperature is not None:
        of_temperature = eqx.Partial(_multiplied, as_temperature(temperature))
    if of_strokes is None and of_temperature is None:
        return None
    return HingeChanges(of_strokes, of_temperature).traced()


def _multiplied(values: Any, factor: Scalar) -> Any:
    """Multiply strokes or temperatures by the load factor."""
    return jax.tree.map(lambda value: factor * jnp.asarray(value, float), values)


def first_displacements(
    problem: Problem,
    constant_loads: Sequence[Load],
    start: StateLike | None,
    changes: HingeChanges | None = None,
) -> Poses:
    """Compute the equilibrium at the load factor zero; rad, m, m.

    The problem is that at the load factor 1.
    """
    mechanism = problem.mechanism
    if changes is not None:
        hinges = mechanism.hinges_in(changes.state(mechanism, jnp.zeros(())))
        mechanism = mechanism.with_hinges(hinges)
    deformed = mechanism.hinge_assembly.misfits is not None
    if start is None and not (deformed or constant_loads or problem.constraints.size):
        return jnp.zeros_like(mechanism.reference)
    problem = problem._replace(
        mechanism=mechanism,
        loads=LoadSet.of(mechanism, constant_loads),
        targets=tuple(0.0 * target for target in problem.targets),
    )
    solution = solve(problem, start)
    describe = partial(describe_critical_point, problem, start, solution)
    return finish_equilibrium(solution, True, problem, describe).displacements


def check_settings(
    direction: int | Mapping[str, PoseLike],
    load_factors: NumbersLike,
    max_points: int,
    max_critical: int = 1,
) -> None:
    """Check the settings of a path."""
    if not isinstance(direction, Mapping) and direction not in (1, -1):
        raise ValueError(f"`direction` is {direction!r}, but must be 1 or -1.")
    limits = concrete(load_factors)
    if limits is not None and limits.shape != (2,):
        raise ValueError(
            f"`load_factors` has the shape {limits.shape}, but must be two load factors, "
            "between which the path is followed. Its points are chosen by the solver."
        )
    if limits is not None and not limits[0] < limits[1]:
        raise ValueError(
            f"`load_factors` is {load_factors!r}, but the first one must be smaller than "
            "the second one."
        )
    if max_points < 3 or max_critical < 1:
        raise ValueError(
            f"`max_points` is {max_points!r} and `max_critical` is {max_critical!r}, but "
            "`max_points` must be at least 3, and `max_critical` at least 1."
        )
