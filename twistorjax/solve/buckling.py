"""Linearized buckling of a mechanism about an equilibrium."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.compilation import fast_compile
from .._utils.host import as_float
from .._utils.types import BatchFlag, Flag, NumberLike, Scalar
from .._utils.validation import require_float64
from ..mechanism.constraints import AbstractConstraint, gather_constraints
from ..mechanism.loads import Drive, Load, LoadSet, prescribed_dofs
from ..mechanism.mechanism import Mechanism
from .dofs import DofPartition
from .path_start import metric_of
from .path_system import PathSystem
from .results import (
    count_results,
    result_message,
    result_names,
    RESULTS,
    succeeded_or_raise,
)
from .static_errors import describe_free_motions
from .static_results import state_in_range, StateLike
from .tables import Column, Columns, columns, Tabular


# Of the largest diagonal entry of a matrix; a smaller pivot may be a rounding error.
_SINGULAR = 10 * np.finfo(float).eps
# A mode whose geometric stiffness is below this share of the largest one does not buckle.
_NO_GEOMETRIC_STIFFNESS = 1e-9


class Buckling(Tabular):
    """Linearized buckling loads and modes.

    Args:
        load_factors: Factors of the loads at which the mechanism buckles, in the order of
            their magnitudes. The last ones are infinite if fewer modes buckle. A negative
            factor is one for loads in the opposite direction.
        shapes: Displacements of the bodies in each mode: rotations (rad) and translations
            (m). The rotations, and the translations over the characteristic length of the
            mechanism, have unit norm.
        result: `RESULTS.successful` or the reason of the failure; `result_names` returns
            its name.
        names: Names of the bodies.
    """

    load_factors: Float[Array, "*batch modes"]
    shapes: Float[Array, "*batch modes bodies 3"]
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)

    @property
    def succeeded(self) -> BatchFlag:
        """Whether the equilibrium about which the mechanism is linearized is stable."""
        return self.result == RESULTS.successful

    def columns(self) -> Columns:
        entries = ("shape_angle", "rad"), ("shape_x", "m"), ("shape_y", "m")
        return {
            "load_factor": Column(self.load_factors, ("mode",), "1"),
            **columns(self.shapes, ("mode", "body"), *entries, body=self.names),
        }

    def __repr__(self) -> str:
        names = result_names(self.result)
        if names is None:
            return eqx.tree_pformat(self)
        if names.shape:
            return count_results("buckling analyses", names)
        lines = [f"{names}: {self.load_factors.size} modes", "load factor  largest part"]
        for factor, shape in zip(self.load_factors, self.shapes, strict=True):
            size = np.abs(np.asarray(shape))
            if np.isfinite(factor):
                body = self.names[int(np.argmax(np.linalg.norm(size[:, 1:], axis=1)))]
                lines.append(f"{float(factor):>11.6g}  {body}")
        return "\n".join(lines)


def buckling(
    mechanism: Mechanism,
    *,
    loads: Sequence[Load] = (),
    drives: Sequence[Drive] = (),
    about: StateLike | None = None,
    constant_loads: Sequence[Load] = (),
    constraints: Sequence[AbstractConstraint] = (),
    modes: int = 6,
    time: NumberLike = 0.0,
    throw: bool = True,
) -> Buckling:
    """Compute the factors of the loads at which a mechanism buckles, by linearization.

    The tangent stiffness is assumed to change in proportion to the load factor, as it
    does at the equilibrium. The error of the factors is of the order of the strains and
    rotations before buckling: a slender column of surrogates that is shortened by 0.1 %
    buckles within about 0.1 % of the factor. `path` locates limit points and branch
    points without this assumption.

    Args:
        mechanism: The mechanism.
        loads: Loads that are multiplied by the load factor, but no follower loads.
        drives: Prescribed displacements that are multiplied by the load factor, and added
            to those of the equilibrium.
        about: Equilibrium, or its poses, at the load factor zero; by default the
            reference configuration; rad, m, m.
        constant_loads: Loads at this equilibrium, which are not multiplied.
        constraints: Pins, sliders, and other constraints between the bodies.
        modes: Largest number of modes.
        time: Time at which time-dependent constraints are evaluated; s.
        throw: Whether a failure raises an error; otherwise it is reported by `result`.

    Returns:
        Load factors and modes. Both have derivatives up to the third order, unless two
        load factors are equal.

    Raises:
        ValueError: Double precision is disabled, a name is unknown, nothing is multiplied
            by the load factor, or a load is a follower load.
        RuntimeError: The equilibrium is not stable, or a value is not finite.

    Source:
        Bathe, Finite Element Procedures, 1996, section 6.8.2.

    Example:
        >>> import twistorjax as tj
        >>> spring = tj.Quadratic(jnp.diag(jnp.array([2.0, 1e9, 1e9])))
        >>> bodies = [tj.Body("base"), tj.Body("link", pose=(0.0, 0.0, 0.5))]
        >>> hinge = tj.Hinge("hinge", "base", "link", spring, at=(0.0, 0.0, 0.0))
        >>> link = tj.Mechanism(bodies, [hinge], fixed=["base"])
        >>> load = tj.Load("link", force=(0.0, -1.0), at=(0.0, 0.5))
        >>> buckling(link, loads=[load]).load_factors[0].round(6)  # stiffness / length
        Array(2., dtype=float64)
    """
    require_float64(mechanism.reference)
    if not loads and not drives:
        raise ValueError(
            "Nothing is multiplied by the load factor. Give `loads` or `drives`."
        )
    if any(load.follower for load in (*loads, *constant_loads)):
        raise ValueError(
            "There is a follower load. It has no potential, so the stiffness is not "
            "symmetric: use `path`, which locates critical points under such loads."
        )
    if modes < 1:
        raise ValueError(f"`modes` is {modes!r}, but must be at least 1.")
    prescribed, targets = prescribed_dofs(mechanism, drives)
    state = state_in_range(mechanism, "about", about)
    system = PathSystem(
        mechanism=mechanism,
        loads=LoadSet.of(mechanism, loads),
        constant_loads=LoadSet.of(mechanism, constant_loads),
        constraints=gather_constraints(mechanism, constraints),
        changes=None,
        start=state,
        targets=jnp.array(targets, float),
        time=as_float(time),
        dofs=DofPartition.of(mechanism, prescribed),
    )
    solution = _buckling(system, modes)

    def error(name: str, batch_index: tuple[int, ...]) -> Exception:
        text = result_message(name)
        if name == "unstable" and not batch_index:
            text += describe_free_motions(
                mechanism, system.constraints, system.dofs, state, time
            )
        return RuntimeError(text)

    return succeeded_or_raise(solution, error) if throw else solution


@fast_compile
def _buckling(system: PathSystem, modes: int) -> Buckling:
    """Solve the eigenvalue problem of `buckling`."""
    equations = system.at(jnp.zeros(()))
    free = system.start.reshape(-1)[equations.free]
    multipliers = equations.constraint_forces(system.start)
    point = jnp.concatenate([free, multipliers, jnp.zeros(1)])
    tangent = system.tangent(point)
    rate = -jnp.linalg.solve(tangent.jacobian, tangent.by_factor)
    direction = jnp.concatenate([rate, jnp.ones(1)])
    units = jax.lax.stop_gradient(metric_of(system, tangent, point).units[:-1])

    def scaled(point: Float[Array, " n"]) -> Float[Array, "unknowns unknowns"]:
        return units[:, None] * system.tangent(point).jacobian * units[None]

    stiffness, geometric = jax.jvp(scaled, (point,), (direction,))
    estimates, vectors, stable = _eigenvalues(
        *jax.lax.stop_gradient((stiffness, geometric)), len(equations.free)
    )
    count = min(modes, len(estimates))
    factors, vectors = jax.vmap(
        lambda factor, vector: _refined(stiffness, geometric, factor, vector)
    )(estimates[:count], vectors.T[:count])
    displacements = vectors[:, : len(equations.free)]
    size = jnp.linalg.norm(displacements, axis=1)
    displacements = displacements / jnp.where(size > 0, size, 1.0)[:, None]
    no_change = jnp.zeros(len(system.dofs.prescribed))
    shapes = jax.vmap(lambda mode: system.dofs.expand(mode, no_change))(
        displacements * units[None, : len(equations.free)]
    )
    # A singular stiffness has no geometric stiffness.
    finite = jnp.all(jnp.isfinite(geometric)) | ~stable
    finite &= jnp.all(jnp.isfinite(stiffness))
    result = RESULTS.where(stable, RESULTS.successful, RESULTS.unstable)
    result = RESULTS.where(finite, result, RESULTS.not_finite)
    valid = stable & finite
    return Buckling(
        load_factors=jnp.where(valid, factors, jnp.nan),
        shapes=jnp.where(valid, shapes, jnp.nan),
        result=result,
        names=system.mechanism.names,
    )


def _eigenvalues(
    stiffness: Float[Array, "n n"], geometric: Float[Array, "n n"], free: int
) -> tuple[Float[Array, " n"], Float[Array, "n n"], Array]:
    """Estimate load factors, in the order of their magnitudes, and their vectors.

    The last result is whether the equilibrium is stable. With constraints, `stiffness`
    has more rows than there are `free` degrees of freedom.
    """
    if len(stiffness) == free:
        lower, stable = _cholesky((stiffness + stiffness.T) / 2)
        lower = jnp.where(stable, lower, jnp.eye(free))
        half = jax.scipy.linalg.solve_triangular(lower, geometric, lower=True)
        matrix = jax.scipy.linalg.solve_triangular(lower, half.T, lower=True)
        values, vectors = jnp.linalg.eigh(-(matrix + matrix.T) / 2)
        vectors = jax.scipy.linalg.solve_triangular(lower.T, vectors, lower=False)
    else:
        values, vectors = jnp.linalg.eig(-jnp.linalg.solve(stiffness, geometric))
        real = jnp.abs(values.imag) <= 1e-8 * jnp.abs(values)
        values, vectors = jnp.where(real, values.real, 0.0), vectors.real
        rows = stiffness[free:, :free]
        basis = jnp.linalg.qr(rows.T, mode="complete")[0][:, len(rows) :]
        reduced = basis.T @ stiffness[:free, :free] @ basis
        _, stable = _cholesky(reduced)
    order = jnp.argsort(-jnp.abs(values))
    values, vectors = values[order], vectors[:, order]
    buckles = jnp.abs(values) > _NO_GEOMETRIC_STIFFNESS * jnp.abs(values[0])
    factors = jnp.where(buckles, 1 / jnp.where(buckles, values, 1.0), jnp.inf)
    return factors, vectors, stable


def _cholesky(matrix: Float[Array, "n n"]) -> tuple[Float[Array, "n n"], Flag]:
    """Factorize a matrix, and decide whether it is positive definite."""
    lower = jnp.linalg.cholesky(matrix)
    smallest = _SINGULAR * len(matrix) * jnp.max(jnp.abs(jnp.diagonal(matrix)))
    return lower, jnp.all(jnp.diagonal(lower) ** 2 > smallest)


def _refined(
    stiffness: Float[Array, "n n"],
    geometric: Float[Array, "n n"],
    factor: Scalar,
    vector: Float[Array, " n"],
) -> tuple[Scalar, Float[Array, " n"]]:
    """Apply Newton's method to one load factor, which gives it derivatives.

    Two steps from the exact value have the derivatives up to the third order.
    """
    buckles = jnp.isfinite(factor)
    factor, vector = jnp.where(buckles, factor, 0.0), jnp.where(buckles, vector, 1.0)
    vector = vector / jnp.linalg.norm(vector)
    right = jnp.zeros(len(vector) + 1).at[-1].set(1.0)
    null = vector
    for _ in range(2):
        matrix = stiffness + factor * geometric
        scale = jnp.linalg.norm(jax.lax.stop_gradient(matrix)) / len(vector)
        bordered = jnp.block(
            [
                [matrix, scale * vector[:, None]],
                [scale * vector[None], jnp.zeros((1, 1))],
            ]
        )
        solution = jnp.linalg.solve(bordered, scale * right)
        transposed = jnp.linalg.solve(bordered.T, scale * right)
        null, left, gap = solution[:-1], transposed[:-1], solution[-1]
        slope = jnp.where(buckles, left @ geometric @ null / scale, 1.0)
        factor = factor + jnp.where(buckles, gap / slope, 0.0)
    return jnp.where(buckles, factor, jnp.inf), null
