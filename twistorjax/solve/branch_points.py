"""Refinement of the branch points of an equilibrium path."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import Count
from .continuation import Metric
from .critical_points import (
    bordered_inverse,
    Criticals,
    scaled_jacobian,
    singular_vectors,
)
from .path_system import PathSystem
from .small_matrices import solve


_REFINEMENTS = 4  # Newton steps to a branch point
_CORRECTIONS = 5  # of the equilibrium in each of them
_STEP = 1e-5  # of finite differences for them, in the units of the metric
_CONVERGED = 1e-7  # largest last step
_LARGEST_REFINEMENT = 0.05  # in the units of the metric


def refine_branch_points(
    system: PathSystem, metric: Metric, criticals: Criticals
) -> Criticals:
    """Solve the equations of the branch points; see `_branch_residual`.

    The path of a mechanism that is nearly symmetric does not quite go through a branch
    point: near it, the path turns into one of the branches. The solution is a point at
    which a small force would make both paths cross.
    """
    is_branch, rows = criticals.is_branch, jnp.arange(len(criticals.points))

    def refine(state: tuple[Array, Count]) -> tuple[Array, Count]:
        points, last = state
        row = jnp.argmax(is_branch & (rows > last))
        start = points[row] / metric.units
        equations = partial(
            _branch_residual,
            system,
            metric,
            singular_vectors(system, metric, points[row]),
        )

        # Exact derivatives of these conditions would take 40 s to compile.
        def improve(_, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            place, _, _ = state
            offsets = _STEP * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
            values, found = jax.lax.map(
                lambda offset: equations(start, place + offset), jnp.asarray(offsets)
            )
            slopes = (values[1::2] - values[2::2]).T / (2 * _STEP)
            change = -solve(slopes, values[0])
            return place + change, change, found[0]

        nothing = jnp.zeros(2), jnp.zeros(2), start
        _, change, refined = jax.lax.fori_loop(0, _REFINEMENTS, improve, nothing)
        near = metric.length(refined - start) < _LARGEST_REFINEMENT
        converged = jnp.max(jnp.abs(change)) < _CONVERGED
        point = jnp.where(near & converged, metric.units * refined, points[row])
        return points.at[row].set(point), row

    points, _ = jax.lax.while_loop(
        lambda state: jnp.any(is_branch & (rows > state[1])),
        refine,
        (criticals.points, -jnp.ones((), int)),
    )
    return criticals._replace(points=points)


def _branch_residual(
    system: PathSystem,
    metric: Metric,
    borders: tuple[Array, Array],
    start: Float[Array, " n"],
    place: Float[Array, "2"],
) -> tuple[Float[Array, "2"], Float[Array, " n"]]:
    """Evaluate the two conditions of a branch point at a place near it.

    The place is the displacement along the right null vector, and the change of the load
    factor. The other displacements are in equilibrium (Lyapunov-Schmidt reduction). The
    stiffness is singular at a branch point, and the load does no work in its null vector.

    Returns:
        The conditions, and the point at this place, divided by the units.
    """
    row_units, factor = metric.units[:-1], start[-1] + place[1]
    left, right = borders

    def correct(_, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        _, free, _ = state
        point = jnp.concatenate([free, factor[None]])
        tangent = system.tangent(metric.units * point)
        inverse, singular, null = bordered_inverse(
            scaled_jacobian(metric, tangent), left, right
        )
        rate = jnp.sum(null * row_units * tangent.by_factor)
        missing = place[0] - jnp.sum(right * (free - start[:-1]))
        forces = jnp.concatenate([-row_units * tangent.residual, missing[None]])
        corrected = free + (inverse @ forces)[:-1]
        return jnp.stack([singular, rate]), corrected, point

    nothing = jnp.zeros(2), start[:-1], start
    values, _, point = jax.lax.fori_loop(0, _CORRECTIONS, correct, nothing)
    return values, point
