"""Refinement of the branch points of an equilibrium path."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.types import Count, Flag, Scalar
from ...linalg.elimination import solve
from .arc_length import Metric
from .critical_points import (
    bordered_inverse,
    Criticals,
    scaled_jacobian,
    singular_vectors,
)
from .system import PathSystem


_ROUNDS = 2  # In the second one, the null vectors are those of the branch point.
_REFINEMENTS = 15  # Newton steps to a branch point, at most
_CORRECTIONS = 5  # of the equilibrium in each of them
_STEP = 1e-5  # of finite differences for them, in the units of the metric
_NEGLIGIBLE = 1e-10  # change of the coordinates after which no further step is taken
_CONVERGED = 1e-7  # largest last change of a point that is accepted
_LARGEST_REFINEMENT = 0.3  # in the units of the metric


class _Refinement(NamedTuple):
    """State of Newton's method for one branch point."""

    coordinates: Float[Array, "2"]  # Coordinates of the point; see `_branch_residual`
    last_change: Scalar  # Largest part of the last change of the coordinates
    point: Float[Array, " n"]  # The point before this change, divided by the units
    steps: Count


def refine_branch_points(
    system: PathSystem, metric: Metric, criticals: Criticals
) -> Criticals:
    """Solve the equations of the branch points; see `_branch_residual`.

    The path of a mechanism that is nearly symmetric does not quite go through a branch
    point: near it, the path turns into one of the branches. The solution is a point at
    which a small force would make both paths cross. Multiple points stay as they are.
    """
    rows = jnp.arange(len(criticals.points))
    is_branch = criticals.is_branch & (criticals.multiplicities == 1)

    def refine(state: tuple[Array, Count]) -> tuple[Array, Count]:
        points, last = state
        row = jnp.argmax(is_branch & (rows > last))
        # Not to one of the other critical points
        steps = (criticals.points - points[row][None]) / metric.units[None]
        distances = jnp.sqrt(steps**2 @ metric.weights)
        others = (rows != row) & (rows < criticals.number)
        nearest = jnp.min(jnp.where(others, distances, jnp.inf))
        largest = jnp.minimum(_LARGEST_REFINEMENT, nearest / 2)
        improved = partial(improve_point, largest)
        point = jax.lax.fori_loop(0, _ROUNDS, improved, points[row])
        return points.at[row].set(point), row

    def improve_point(largest: Scalar, _, point: Array) -> Array:
        start = point / metric.units
        borders = singular_vectors(metric, system.tangent(point))
        equations = partial(_branch_residual, system, metric, borders)

        # Exact derivatives of these conditions would take 40 s to compile
        # (`benchmarks.analyses`).
        def improve(state: _Refinement) -> _Refinement:
            coordinates = state.coordinates
            offsets = _STEP * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
            values, found = jax.lax.map(
                lambda offset: equations(start, coordinates + offset),
                jnp.asarray(offsets),
            )
            slopes = (values[1::2] - values[2::2]).T / (2 * _STEP)
            change = -solve(slopes, values[0])
            size = jnp.max(jnp.abs(change))
            return _Refinement(coordinates + change, size, found[0], state.steps + 1)

        def unfinished(state: _Refinement) -> Flag:
            return (state.steps < _REFINEMENTS) & (state.last_change >= _NEGLIGIBLE)

        nothing = _Refinement(jnp.zeros(2), jnp.array(jnp.inf), start, jnp.zeros((), int))
        last = jax.lax.while_loop(unfinished, improve, nothing)
        near = metric.length(last.point - start) < largest
        converged = last.last_change < _CONVERGED
        return jnp.where(near & converged, metric.units * last.point, point)

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
    coordinates: Float[Array, "2"],
) -> tuple[Float[Array, "2"], Float[Array, " n"]]:
    """Evaluate the two conditions of a branch point at a point near it.

    The coordinates are the displacement along the right null vector, and the change of
    the load factor. The other displacements are in equilibrium (Lyapunov-Schmidt
    reduction). The stiffness is singular at a branch point, and the load does no work in
    its null vector. The second result is the point, divided by the units.
    """
    row_units, factor = metric.units[:-1], start[-1] + coordinates[1]
    left, right = borders

    def correct(_, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        _, free, _ = state
        point = jnp.concatenate([free, factor[None]])
        tangent = system.tangent(metric.units * point)
        inverse, singular, null = bordered_inverse(
            scaled_jacobian(metric, tangent), left[:, None], right[:, None]
        )
        rate = jnp.sum(null[0] * row_units * tangent.by_factor)
        missing = coordinates[0] - jnp.sum(right * (free - start[:-1]))
        forces = jnp.concatenate([-row_units * tangent.residual, missing[None]])
        corrected = free + (inverse @ forces)[:-1]
        return jnp.stack([singular[0, 0], rate]), corrected, point

    nothing = jnp.zeros(2), start[:-1], start
    values, _, point = jax.lax.fori_loop(0, _CORRECTIONS, correct, nothing)
    return values, point
