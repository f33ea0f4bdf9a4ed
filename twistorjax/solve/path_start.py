"""Units of an equilibrium path, and its direction at the first point."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import Flag, Scalar
from .continuation import Metric, Node, select, solve_step
from .path_system import PathSystem, PathTangent


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
    node = Node(point, step.tangent, step.orientation, step.log_determinant)
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
    zero = jnp.zeros(())
    return select(at_branch, Node(start.point, unit_mode, zero, zero), start)


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
