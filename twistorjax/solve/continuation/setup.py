"""Equations and first point of a path, from the arguments of a user."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from typing_extensions import TypeAliasType

from ..._utils.host import as_float, concrete
from ..._utils.types import Flag, NumberLike, PoseLike, Poses, Scalar
from ..._utils.validation import index_of, require_float64, require_pose
from ...mechanism.changes import (
    as_temperature,
    HingeChanges,
    Temperature,
    TemperatureInTime,
    with_arrays,
)
from ...mechanism.constraints import AbstractConstraint, gather_constraints
from ...mechanism.loads import Drive, Load, LoadSet, prescribed_dofs
from ...mechanism.mechanism import Mechanism
from ...mechanism.support import require_support
from ..equations.dofs import DofPartition
from ..equilibrium import equilibrium
from ..path_start import branch_mode
from ..statics.solution import StateLike
from .solution import CriticalPoint
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


class FirstPoint(NamedTuple):
    """First point of a path, and the direction in which the path begins.

    Args:
        displacements: Displacements of the bodies; rad, m, m.
        factor: Load factor.
        direction: 1 or -1; the sign of the change of the load factor or, at a branch
            point, of the mode.
        at_branch: Whether the point is a branch point, at which the path leaves in the
            direction of the mode.
        mode: The mode of the branch point.
    """

    displacements: Poses
    factor: Scalar
    direction: Scalar
    at_branch: Flag
    mode: Poses


def regular_point(displacements: Poses, factor: Scalar, direction: int = 1) -> FirstPoint:
    """Return a first point that is not a branch point."""
    return FirstPoint(
        displacements=displacements,
        factor=factor,
        direction=jnp.asarray(direction, float),
        at_branch=jnp.zeros((), bool),
        mode=jnp.zeros_like(displacements),
    )


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
    are measured from them.

    Raises:
        ValueError: An argument is invalid; see `path`.
        RuntimeError: There is no first equilibrium.
    """
    require_float64(mechanism.reference)
    constraint_set = gather_constraints(mechanism, constraints)
    changes = _changes(strokes, temperature)
    if not loads and not drives and changes is None:
        raise ValueError(
            "Nothing is multiplied by the load factor. Give `loads`, `drives`, "
            "`strokes`, or `temperature`."
        )
    prescribed, targets = prescribed_dofs(mechanism, drives)
    require_support(mechanism, constraint_set.bodies, prescribed)
    dofs = DofPartition.of(mechanism, prescribed)
    if isinstance(start, CriticalPoint):
        is_simple_limit = concrete(~start.is_branch & (start.multiplicity == 1))
        if is_simple_limit is not None and is_simple_limit:
            raise ValueError(
                "`start` is a limit point, but must be a branch point: no other path "
                "leaves at a limit point."
            )
        begin = dofs.fixed_part(start.displacements)
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
            begin = first_displacements(
                mechanism, drives, changes, constant_loads, constraints, start, time
            )
        first = regular_point(begin, jnp.zeros(()), direction)
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


def _changes(
    strokes: PathStrokes, temperature: PathTemperature | None
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
    mechanism: Mechanism,
    drives: Sequence[Drive],
    changes: HingeChanges | None,
    constant_loads: Sequence[Load],
    constraints: Sequence[AbstractConstraint],
    start: StateLike | None,
    time: NumberLike,
) -> Poses:
    """Compute the equilibrium at the load factor zero; rad, m, m."""
    if changes is not None:
        hinges = changes.state(mechanism, jnp.zeros(())).hinges(mechanism)
        mechanism = eqx.tree_at(lambda new: new.hinge_assembly, mechanism, hinges)
    deformed = mechanism.hinge_assembly.misfits is not None
    if start is None and not (deformed or constant_loads or constraints):
        return jnp.zeros_like(mechanism.reference)
    return equilibrium(
        mechanism,
        loads=constant_loads,
        drives=jax.tree.map(lambda value: 0.0 * value, drives),
        constraints=constraints,
        start=start,
        time=time,
    ).displacements
