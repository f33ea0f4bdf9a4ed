"""Units of a path, its first point, and its direction there."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._compile.compilation import fast_compile
from ..._utils.pytrees import select
from ..._utils.types import Count, Flag, Poses, Scalar
from .arc_length import Metric, Node, solve_step
from .critical_points import null_vectors
from .system import PathSystem, PathTangent


_SMALL_PART = 1e-6  # of a direction, which may consist of rounding errors


def start_at(
    system: PathSystem, point: Float[Array, " n"], sign: Scalar
) -> tuple[Metric, Node, Flag]:
    """Choose the units at the first point, and find the direction of the path.

    In this direction, the load factor changes by `sign`. The last result is whether there
    is no direction because the stiffness is singular.
    """
    tangent = system.tangent(point)
    metric = metric_of(system, tangent, point)
    border = jnp.zeros_like(point).at[-1].set(sign)
    direction = solve_step(tangent, metric, border, jnp.zeros(())).tangent
    step = solve_step(tangent, metric, direction, jnp.zeros(()))
    node = Node(point, step.tangent, step.orientation)
    finite = jnp.all(jnp.isfinite(tangent.jacobian))
    finite &= jnp.all(jnp.isfinite(tangent.by_factor))
    return metric, node, finite & ~jnp.all(jnp.isfinite(step.tangent))


def start_on_branch(
    metric: Metric, start: Node, mode: Float[Array, " n"], at_branch: Flag
) -> Node:
    """Replace the direction of the path by the mode of a branch point.

    The orientation becomes zero, because it depends on rounding errors there.
    """
    length = metric.length(mode)
    unit_mode = mode / jnp.where(at_branch, length, 1.0)
    return select(at_branch, Node(start.point, unit_mode, jnp.zeros(())), start)


@fast_compile
def branch_mode(
    system: PathSystem,
    displacements: Poses,
    factor: Scalar,
    multiplicity: Count,
    direction: Poses,
) -> Poses:
    """Return the part of a direction (rad, m, m) without stiffness at a branch point.

    It is divided by the units, and zero if it is a rounding error.
    """
    point = first_point(system, displacements, factor)
    metric = metric_of(system, system.tangent(point), point)
    null = null_vectors(
        system, metric, point[None], jnp.ones(1, bool), multiplicity[None]
    )
    free = len(system.dofs.free)
    vectors = null.right[0, :free]
    wanted = direction.reshape(-1)[np.array(system.dofs.free, int)] / metric.units[:free]
    mode = vectors @ (vectors.T @ wanted)
    small = jnp.linalg.norm(mode) <= _SMALL_PART * jnp.linalg.norm(wanted)
    return system.mode_displacements(jnp.where(small, 0.0, mode))


def first_point(
    system: PathSystem, displacements: Poses, factor: Scalar
) -> Float[Array, " n"]:
    """Return the vector of a point of the path; see `PathSystem`."""
    equations = system.at(factor)
    free = displacements.reshape(-1)[equations.free]
    multipliers = equations.constraint_forces(displacements)
    return jnp.concatenate([free, multipliers, factor[None]])


def metric_of(
    system: PathSystem, tangent: PathTangent, point: Float[Array, " n"]
) -> Metric:
    """Choose the units of the unknowns at a point; that of the load factor is 1."""
    count = len(system.dofs.free)
    is_angle = np.array(system.dofs.free, int) % 3 == 0
    units = jnp.where(is_angle, 1.0, system.length())
    weights = jnp.asarray(np.arange(point.size) < count, float).at[-1].set(1.0)
    if system.constraints.size:
        stiffness = units[:, None] * tangent.jacobian[:count, :count] * units[None]
        rows = tangent.jacobian[count:, :count] * units[None]
        size = jnp.linalg.norm(rows, axis=1)
        forces = jnp.max(jnp.abs(stiffness)) / jnp.where(size > 0, size, 1.0)
        units = jnp.concatenate([units, jnp.where(forces > 0, forces, 1.0)])
    return Metric(jnp.concatenate([units, jnp.ones(1)]), weights)


class FirstPoint(NamedTuple):
    """First point of a path, and the direction in which the path begins."""

    displacements: Poses  # Displacements of the bodies; rad, m, m
    factor: Scalar  # Load factor
    # 1 or -1; the sign of the change of the load factor or, at a branch point, of the
    # mode
    direction: Scalar
    # Whether the point is a branch point, at which the path leaves in the direction of
    # the mode
    at_branch: Flag
    mode: Poses  # The mode of the branch point


def regular_point(displacements: Poses, factor: Scalar, direction: int = 1) -> FirstPoint:
    """Return a first point that is not a branch point."""
    return FirstPoint(
        displacements=displacements,
        factor=factor,
        direction=jnp.asarray(direction, float),
        at_branch=jnp.zeros((), bool),
        mode=jnp.zeros_like(displacements),
    )
