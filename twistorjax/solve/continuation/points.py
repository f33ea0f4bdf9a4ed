"""Points of a path as displacements, reactions, energies, and stability."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..._utils.pytrees import jvp_of_varied, with_derivative
from ..._utils.types import Count
from ...assembly.stress import largest_stresses, rows_with_stress
from ...linalg.constraints import null_space
from ...linalg.elimination import solve
from ...linalg.factors import determinant_sign
from .arc_length import Metric
from .system import PathSystem, PathTangent


class PointValues(NamedTuple):
    """Quantities at one point of a path, or with one more axis at many points."""

    load_factor: Float[Array, "..."]
    # Displacement of each body from its reference pose; rad, m, m
    displacements: Float[Array, "... bodies 3"]
    # Reactions on fixed and prescribed degrees of freedom; N m, N, N
    reactions: Float[Array, "... bodies 3"]
    constraint_forces: Float[Array, "... entries"]  # Constraint forces; N m, N
    energy: Float[Array, "..."]  # Energy stored in the hinges; J
    # Largest stress in each hinge, if a strength is known; Pa
    stresses: Float[Array, "... hinges"] | None
    range_shares: Float[Array, "... hinges"] | None  # As those of an `Equilibrium`


def point_values(system: PathSystem, points: Float[Array, "points n"]) -> PointValues:
    """Compute the quantities at points of a path."""

    def one(point: Float[Array, " n"]) -> PointValues:
        equations, displacements, multipliers = system.split(point)
        reactions, energy = equations.reactions_and_energy(displacements, multipliers)
        hinges = equations.hinges
        stressed = rows_with_stress(hinges, "static")
        return PointValues(
            point[-1],
            displacements,
            reactions,
            multipliers,
            energy,
            largest_stresses(hinges, displacements) if stressed else None,
            hinges.range_shares(displacements),
        )

    return jax.vmap(one)(points)


def negative_eigenvalues(
    system: PathSystem, metric: Metric, points: Float[Array, "points n"]
) -> Int[Array, " points"]:
    """Count the negative eigenvalues of the stiffness at points of a path.

    With follower loads, the stiffness is not symmetric, and the number is that of the
    factor -1 in the sign of its determinant: 0 or 1.
    """

    def one(point: Float[Array, " n"]) -> Count:
        return jnp.sum(stability_values(system, metric, system.tangent(point)) < 0)

    # Two batches of LAPACK calls at the same time can cause a deadlock (jaxlib 0.10).
    return jax.lax.map(one, points)


def allowed_stiffness(
    system: PathSystem, metric: Metric, tangent: PathTangent
) -> tuple[Float[Array, "allowed allowed"], Float[Array, "free allowed"]]:
    """Return the stiffness for displacements that the constraints allow; J.

    The second result is an orthonormal basis of these displacements, in the units of the
    metric.
    """
    free = len(system.dofs.free)
    units, jacobian = metric.units[:free], tangent.jacobian
    matrix = units[:, None] * jacobian[:free, :free] * units[None]
    if not system.constraints.size:
        return matrix, jnp.eye(free)
    _, basis = null_space(jacobian[free:, :free] * units[None])
    return basis.T @ matrix @ basis, basis


def stability_values(
    system: PathSystem, metric: Metric, tangent: PathTangent
) -> Float[Array, " values"]:
    """Compute functions of a point that change their signs where the stability changes.

    They are the eigenvalues of the stiffness for displacements that the constraints
    allow, in increasing order, which are continuous along a path. With follower loads, it
    is the smallest singular value of this stiffness with the sign of its determinant.
    """
    matrix, _ = allowed_stiffness(system, metric, tangent)
    if not matrix.size:
        return jnp.ones(1)
    if system.symmetric:
        return jnp.linalg.eigvalsh(matrix)
    sign = determinant_sign(*jax.scipy.linalg.lu_factor(matrix))
    return sign * jnp.linalg.svd(matrix, compute_uv=False)[-1:]


def count_of_values(system: PathSystem) -> int:
    """Return the number of stability values."""
    allowed = len(system.dofs.free) - system.constraints.size
    return max(allowed, 1) if system.symmetric else 1


def differentiable_points(
    system: PathSystem,
    points: Float[Array, "points n"],
    normals: Float[Array, "points n"],
    conditions: Float[Array, " points"] | None = None,
) -> Float[Array, "points n"]:
    """Return points of a path with derivatives with respect to the system.

    Each point is on a surface: a function of the point is zero there, `normals` has its
    gradient, and `conditions` its value, of which only the derivative with respect to the
    system and its loads is used. By default, the surfaces do not move.
    """
    if conditions is None:
        conditions = jnp.zeros(len(points))

    def one(point: Array, normal: Array, condition: Array) -> Array:
        return with_derivative(_point_change, point, system, normal, condition)

    return jax.vmap(one)(points, normals, conditions)


def _point_change(point: Array, arguments: Sequence[Any], tangents: Any) -> Array:
    """Differentiate the equations of a point; see `differentiable_points`."""
    system, normal, condition = arguments
    normal = jax.lax.stop_gradient(normal)
    found = jnp.all(jnp.isfinite(point))
    at = jnp.where(found, point, 0.0)

    def equations(system: PathSystem, condition: Array) -> Array:
        return jnp.append(system.residual(at), condition)

    _, rate = jvp_of_varied(equations, (system, condition), (tangents[0], tangents[2]))
    tangent = system.tangent(at)
    rows = jnp.concatenate([tangent.jacobian, tangent.by_factor[:, None]], axis=1)
    matrix = jnp.concatenate([rows, normal[None]])
    matrix = jnp.where(found, matrix, jnp.eye(len(matrix)))
    return jnp.where(found, -solve(matrix, rate), 0.0)
