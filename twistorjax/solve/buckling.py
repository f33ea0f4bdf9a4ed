"""Buckling of a mechanism: critical points near those of the linearized equations."""

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._compile.compilation import fast_compile
from .._utils.host import concrete
from .._utils.progress import announced
from .._utils.pytrees import stop_gradient
from .._utils.types import Count, Flag, NumberLike, Poses, Scalar
from .._utils.validation import warn
from ..linalg.factors import Factors
from ..linalg.lowest_modes import dominant_modes, has_subspace
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Drive, Load, LoadSet, prescribed_dofs
from ..mechanism.mechanism import Mechanism
from ..results.codes import finish, result_error, RESULTS, Solution
from ..results.tables import Column, Columns, columns, Tabular
from .continuation.arc_length import Metric
from .continuation.critical_points import (
    differentiable_critical_points,
    differentiable_null_vectors,
    LARGEST_MULTIPLICITY,
    null_vectors,
)
from .continuation.points import allowed_stiffness
from .continuation.start import first_point, metric_of
from .continuation.system import PathSystem, PathTangent
from .equations.problem import Problem
from .equations.state import warn_outside_linear_range
from .statics.errors import describe_free_motions
from .statics.solution import StateLike


# Of the largest diagonal entry of a matrix; a smaller pivot may be a rounding error.
_SINGULAR = 10 * np.finfo(float).eps
# A mode whose geometric stiffness is below this share of the largest one does not buckle.
_NO_GEOMETRIC_STIFFNESS = 1e-9
_COUPLED = 0.1  # share of a mode in the first displacements that leads to a limit point
_LARGEST_CHANGE = 0.5  # of the amplitude of a mode, as a fraction of it
_SMALL_DIFFERENCE = 1e-5  # of eigenvalues that are one without loads
# Fraction of the stiffness without loads that is added to a stiffness which may be
# singular, and the number of solutions that remove the effect
_SHIFT, _REFINEMENTS = 1e-3, 3
_NO_DISPLACEMENT = 1e-6  # in a mode at the estimated load; rad, or of the length
_NEGLIGIBLE = 1e-11  # change after which the iteration ends
_CONVERGED = 1e-7  # largest last change that is accepted
_ITERATIONS = 30
_SAME_FACTOR = 1e-8  # difference of load factors that are equal, as a fraction of them
_NEAR = 1.1  # ratio of the linearized load factors of modes that may have the same one
# The equilibrium is followed in steps to this share of the first load factor, where the
# stiffness in one direction must be below this share of its initial value.
_NEARLY_CRITICAL, _SMALL_STIFFNESS = 0.98, 0.5
_LOAD_STEPS, _CORRECTIONS = 12, 10
_FOLLOWED = 1e-8  # largest last correction of an equilibrium, in the units of the metric
_EXPONENTS = -15.0, 15.0  # of ten, of load factors that may be out of a validity range
_TRIED_FACTORS = 301


class Buckling(Solution, Tabular):
    """Buckling loads and modes.

    Args:
        load_factors: Factors of the loads at which the mechanism buckles, in the order of
            their magnitudes. The last ones are infinite if fewer were found: modes may
            not buckle within the validity ranges of the energies, or only at limit points
            far from the linearized equations. If all are, a warning names the hinge that
            limits the range. A negative factor is one for loads in the opposite
            direction.
        shapes: Displacements of the bodies in each mode: rotations (rad) and translations
            (m). The rotations, and the translations over the characteristic length of the
            mechanism, have unit norm. At most six modes with equal load factors are
            different.
        result: `RESULTS.successful` or the reason of the failure; `result_names` returns
            its name.
        names: Names of the bodies.
        range_shares: Displacement or axial force of each hinge at the first load factor,
            divided by the one at which it errs by 5 %, as those of an `Equilibrium`; None
            if all hinges have validity ranges.
    """

    load_factors: Float[Array, "*batch modes"]
    shapes: Float[Array, "*batch modes bodies 3"]
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)
    range_shares: Float[Array, "*batch hinges"] | None = None
    _plural: ClassVar[str] = "buckling analyses"

    def columns(self) -> Columns:
        entries = ("shape_angle", "rad"), ("shape_x", "m"), ("shape_y", "m")
        return {
            "load_factor": Column(self.load_factors, ("mode",), "1"),
            **columns(self.shapes, ("mode", "body"), *entries, body=self.names),
        }

    def _summary(self, names: np.ndarray) -> str:
        if not np.any(np.isfinite(self.load_factors)) and names == "successful":
            return f"{names}: no mode buckles within the validity ranges of the energies"
        finite = np.isfinite(self.load_factors)
        lines = [
            f"{names}: {np.sum(finite)} modes within the validity ranges",
            "load factor  largest translation",
        ]
        for row in np.flatnonzero(finite):
            travel = np.linalg.norm(np.asarray(self.shapes[row])[:, 1:], axis=1)
            largest = int(np.argmax(travel))
            body = self.names[largest] if travel[largest] > 0 else "rotations only"
            lines.append(f"{float(self.load_factors[row]):>11.6g}  {body}")
        return "\n".join(lines)


@announced("buckling")
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
    """Compute the factors of the loads at which a mechanism buckles.

    An eigenvalue problem, in which the tangent stiffness changes in proportion to the
    load factor, gives first estimates. From these, Newton's method finds the factors at
    which the stiffness of the nonlinear equations is singular. The displacements in the
    buckling modes before buckling are those of the linearized equations, which is exact
    if they are zero, as in a straight column, and if the load snaps the mechanism through
    a limit point. Otherwise the error of the factors is of the order of these
    displacements; `path` has no such error. The equilibrium is followed up to the first
    factor: if it becomes unstable before, the result is `critical_point_not_found`.

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
        Load factors and modes. Both have derivatives. Those of equal load factors are
        the derivatives of their mean.

    Raises:
        ValueError: Double precision is disabled, a name is unknown, nothing is multiplied
            by the load factor, a load is a follower load, or `about` is not an
            equilibrium under the constant loads.
        RuntimeError: The equilibrium is not stable, a value is not finite, a hinge is
            outside the validity range of its energy at the first load factor, or the
            stiffness is not singular near its estimate.

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
    if not loads and not drives:
        raise ValueError(
            "Nothing is multiplied by the load factor. Give `loads` or `drives`."
        )
    if modes < 1:
        raise ValueError(f"`modes` is {modes!r}, but must be at least 1.")
    multiplied = LoadSet.of(mechanism, loads)
    held, targets = prescribed_dofs(mechanism, drives)
    problem = Problem.of(
        mechanism, constant_loads, (), constraints, time, held=held, supported=False
    )
    for load_set in (multiplied, problem.loads):
        load_set.require_potential(
            "`path`, which locates critical points under such loads"
        )
    if not problem.dofs.free:
        raise ValueError(
            "All bodies are fixed or driven, so none can buckle. Drive fewer "
            "displacements, or divide a flexure by `flexures.chain`, so that it can "
            "buckle between its ends."
        )
    state = problem.state(about, "constant_loads")
    scaled = problem._replace(loads=multiplied, targets=targets)
    system = PathSystem.of(scaled, problem.loads, state)
    solution, displacements = _buckling(system, modes)

    def error(name: str, batch_index: tuple[int, ...]) -> Exception:
        detail = ""
        known, at, reached = stop_gradient((problem, state, displacements))
        mechanism = known.mechanism
        if name == "out_of_range" and not batch_index:
            detail = f" {mechanism.range_messages(mechanism.reference + reached)}"
        if name == "unstable" and not batch_index:
            detail = describe_free_motions(mechanism, known.system, at)
        return result_error(name, batch_index, detail)

    if throw:
        warn_outside_linear_range(mechanism, solution.range_shares)
        factors = concrete(solution.load_factors)
        if factors is not None and np.all(np.isinf(factors)):
            _warn_of_range(system)
    return finish(solution, throw, error)


def _warn_of_range(system: PathSystem) -> None:
    """Warn that no mode buckles before a hinge leaves its validity range."""
    point = concrete(_range_limit(system))
    if point is not None and np.isfinite(point[-1]):
        warn(
            f"No mode of the bodies buckles up to the load factor {point[-1]:.4g}, at "
            "which a hinge leaves the validity range of its energy: "
            f"{system.range_messages(jnp.asarray(point))} Buckling of a flexure between "
            "its ends is no mode of the bodies."
        )


@fast_compile
def _range_limit(system: PathSystem) -> Float[Array, " n"]:
    """Find the first linearized displacements outside a validity range.

    The load factor of the returned point is infinite if there are none.
    """
    point = first_point(system, system.start, jnp.zeros(()))
    rate = _rate(system.tangent(point))
    exponents, factor = jnp.linspace(*_EXPONENTS, _TRIED_FACTORS), jnp.zeros(())
    for _ in range(3):
        factors = jnp.stack([10.0**exponents, -(10.0**exponents)])
        outside = jax.vmap(lambda factor: system.out_of_range(point + factor * rate))
        found = outside(factors.reshape(-1)).reshape(2, -1)
        row = jnp.argmax(jnp.any(found, axis=0))
        factor = factors[jnp.argmax(found[:, row]), row]
        factor = jnp.where(jnp.any(found), factor, jnp.inf)
        start = exponents[jnp.maximum(row - 1, 0)]
        exponents = jnp.linspace(start, exponents[row], _TRIED_FACTORS)
    return jnp.where(jnp.isfinite(factor), point + factor * rate, jnp.inf)


class _Modes(NamedTuple):
    """Modes of the linearized equations, in the order of their load factors."""

    point: Float[Array, " n"]  # The equilibrium about which the equations are linearized
    rate: Float[Array, " n"]  # Change of this point with the load factor
    # Square root of twice the energy of this change; J^0.5
    rate_size: Scalar
    # Modes as columns, orthonormal in energy; rad, m
    vectors: Float[Array, "unknowns modes"]
    # Products of the stiffness and the modes; N m, N
    forces: Float[Array, "unknowns modes"]
    # Load factors; infinite if a mode has no geometric stiffness
    factors: Float[Array, " modes"]
    # Derivatives of the residual at this point, but without constraints
    stiffness: Float[Array, "unknowns unknowns"]

    def reduced(
        self, tangent: PathTangent, held: Bool[Array, " modes"]
    ) -> tuple[Float[Array, "unknowns modes"], Float[Array, " unknowns"]]:
        """Eliminate all displacements but the amplitudes of the modes.

        Args:
            tangent: Residual and derivatives at another point.
            held: Whether the amplitude of each mode does not change.

        Returns:
            The displacements with unit amplitudes that the other forces do not resist, of
            which the stiffness is singular where the whole one is; and those that balance
            the residual otherwise.
        """
        # Factors of a singular stiffness would be useless.
        shifted = tangent.jacobian + _SHIFT * self.stiffness
        factors = replace(tangent, jacobian=shifted).factors(symmetric=False)
        moved = factors.solve(self.forces)
        flexibility = self.forces.T @ moved

        def balanced(right: Array, held: Array) -> Array:
            both = held[:, None] & held[None]
            matrix = jnp.where(both, flexibility, jnp.eye(len(held)))
            found = jnp.zeros_like(right)
            for _ in range(_REFINEMENTS):
                change = factors.solve(right - tangent.jacobian @ found)
                amplitudes = jnp.where(held[:, None], self.forces.T @ change, 0.0)
                found += change - moved @ jnp.linalg.solve(matrix, amplitudes)
            return found

        forces = -tangent.jacobian @ self.vectors
        shapes = self.vectors + balanced(forces, jnp.ones_like(held))
        return shapes, balanced(-tangent.residual[:, None], held)[:, 0]


class _Iteration(NamedTuple):
    """State of the iteration for one load factor."""

    point: Float[Array, " n"]  # Current point
    amplitude: Scalar  # Load factor at which the linearized equations have the same modes
    last: Float[Array, "2"]  # Amplitude and eigenvalue at the last iterate
    rate: Scalar  # Change of the eigenvalue with the amplitude
    # Last change of the amplitude or of the point, whichever is larger, as a fraction of
    # it
    change: Scalar
    iterations: Count


@fast_compile
def _buckling(system: PathSystem, modes: int) -> tuple[Buckling, Poses]:
    """Solve the linearized equations of `buckling`, and correct their load factors.

    The second result has the displacements at the first load factor; rad, m, m.
    """
    fixed = stop_gradient(system)
    point = first_point(fixed, fixed.start, jnp.zeros(()))
    tangent = fixed.tangent(point)
    metric = metric_of(fixed, tangent, point)
    # Modes with the same load factor as the last one are needed as well.
    count_with_copies = modes + LARGEST_MULTIPLICITY - 1
    linear, stable, finite = _linearized(fixed, metric, point, tangent, count_with_copies)
    count_with_copies = len(linear.factors)
    count = min(modes, count_with_copies)
    rows, estimates = jnp.arange(count_with_copies), jnp.abs(linear.factors)
    wanted = (rows < count) | (estimates <= _NEAR * estimates[count - 1])
    points, coupled, converged, outside = jax.lax.map(
        lambda mode: _corrected(fixed, metric, linear, *mode), (rows, wanted)
    )

    factors, valid = points[:, -1], converged & ~outside
    # A mode in which the load does no work buckles near its estimate.
    lost = jnp.isfinite(estimates) & ~coupled & ~converged & ~outside
    sizes = jnp.where(valid, jnp.abs(factors), jnp.inf)
    positive = jnp.where(factors > 0, sizes, jnp.inf)
    lowest = jnp.stack([jnp.argmin(sizes), jnp.argmin(positive)])
    followed = jax.lax.fori_loop(
        jnp.where(lowest[0] == lowest[1], 1, 0),
        2,
        lambda k, followed: (
            followed
            & (_is_first(fixed, metric, linear, points[lowest[k]]) | ~valid[lowest[k]])
        ),
        jnp.ones((), bool),
    )
    # Under loads in the opposite direction, a mechanism may not buckle.
    first, reached = linear.factors[0], points[0]
    missing = jnp.isfinite(first) & ~valid[0] & ((first > 0) | ~jnp.any(valid))
    missing |= ~followed | jnp.any(lost[:count])
    distances = jnp.abs(factors[:, None] - factors[None])
    same = distances <= _SAME_FACTOR * jnp.abs(factors)[:, None]
    same = (same & valid[:, None] & valid[None]) | jnp.eye(count_with_copies, dtype=bool)
    chosen = jnp.argsort(sizes)[:count]
    # Those with the same load factor are modes of one point.
    leading = jnp.argmax(same, axis=1)[chosen]
    places = jnp.sum(same & (rows[None] < rows[:, None]), axis=1)[chosen]
    is_branch, valid = ~coupled[leading], valid[chosen]
    points = jnp.where(valid[:, None], points[leading], jnp.nan)
    known = jnp.where(valid[:, None], points, linear.point[None])
    null = null_vectors(fixed, metric, known, is_branch, jnp.sum(same, axis=1)[chosen])
    at = differentiable_critical_points(system, metric, points, is_branch, null)
    known = jnp.where(valid[:, None], at, linear.point[None])
    null = differentiable_null_vectors(system, metric, known, null)
    vectors = jax.vmap(lambda vectors, place: vectors[:, place])(null, places)
    free = len(fixed.dofs.free)
    vectors, units = vectors[:, :free], metric.units[:free]
    vectors = vectors / jnp.linalg.norm(vectors, axis=1, keepdims=True)
    shapes = jax.vmap(lambda mode: fixed.mode_displacements(units * mode))(vectors)

    factors = jnp.where(valid, at[:, -1], jnp.inf)
    result = RESULTS.where(missing, RESULTS.critical_point_not_found, RESULTS.successful)
    result = RESULTS.where(missing & outside[0], RESULTS.out_of_range, result)
    result = RESULTS.where(stable, result, RESULTS.unstable)
    result = RESULTS.where(finite, result, RESULTS.not_finite)
    valid = result == RESULTS.successful
    at_factor, displacements, _ = fixed.split(reached)
    solution = Buckling(
        load_factors=jnp.where(valid, factors, jnp.nan),
        shapes=jnp.where(valid, shapes, jnp.nan),
        result=result,
        names=system.mechanism.names,
        range_shares=at_factor.hinges.range_shares(displacements),
    )
    return solution, displacements


def _linearized(
    system: PathSystem,
    metric: Metric,
    point: Float[Array, " n"],
    tangent: PathTangent,
    count: int,
) -> tuple[_Modes, Flag, Flag]:
    """Compute the first modes of linearized buckling, of which there may be fewer.

    The other results are whether the equilibrium is stable, and all values are finite.
    """
    rate = _rate(tangent)

    def allowed(point: Float[Array, " n"]) -> tuple[Array, Array]:
        return allowed_stiffness(system, metric, system.tangent(point))

    (stiffness, basis), (geometric, _) = jax.jvp(allowed, (point,), (rate,))
    lower, stable = _cholesky((stiffness + stiffness.T) / 2)
    # A singular stiffness has no geometric stiffness.
    finite = jnp.all(jnp.isfinite(geometric)) | ~stable
    finite &= jnp.all(jnp.isfinite(stiffness))
    usable = stable & finite
    lower = jnp.where(usable, lower, jnp.eye(len(lower)))
    geometric = jnp.where(usable, geometric, 0.0)
    geometric = (geometric + geometric.T) / 2

    def apply(columns: Array) -> Array:
        moved = jax.scipy.linalg.solve_triangular(lower.T, columns, lower=False)
        return -jax.scipy.linalg.solve_triangular(lower, geometric @ moved, lower=True)

    size = len(lower)
    if has_subspace(size, count):
        values, vectors, converged = dominant_modes(
            apply, size, count, _NO_GEOMETRIC_STIFFNESS
        )
        finite &= converged
    else:
        values, vectors = jnp.linalg.eigh(apply(jnp.eye(size)))
        order = jnp.argsort(-jnp.abs(values))[:count]
        values, vectors = values[order], vectors[:, order]
    buckles = jnp.abs(values) > _NO_GEOMETRIC_STIFFNESS * jnp.abs(values[0])
    modes = jax.scipy.linalg.solve_triangular(lower.T, vectors, lower=False)
    units = metric.units[: len(basis), None]
    strain = lower.T @ (basis.T @ (rate[: len(basis)] / units[:, 0]))
    others = (0, system.constraints.size)
    free = tangent.jacobian[: len(basis), : len(basis)]
    return (
        _Modes(
            point=point,
            rate=rate,
            rate_size=jnp.linalg.norm(strain),
            vectors=jnp.pad(units * (basis @ modes), (others, (0, 0))),
            forces=jnp.pad(basis @ (lower @ vectors) / units, (others, (0, 0))),
            factors=jnp.where(buckles, 1 / jnp.where(buckles, values, 1.0), jnp.inf),
            stiffness=jnp.pad(free, others),
        ),
        stable,
        finite,
    )


def _corrected(
    system: PathSystem, metric: Metric, linear: _Modes, row: Count, wanted: Flag
) -> tuple[Array, Flag, Flag, Flag]:
    """Find the equilibrium with a singular stiffness to which a linearized mode belongs.

    The amplitudes of this mode, and of those that buckle before, are extrapolated from
    the linearized equations; the other displacements are in equilibrium. If the load does
    work in the mode, the mechanism snaps at a limit point: the load factor then follows
    from the equilibrium in this mode. A mode that is not `wanted` is left out.

    Three flags are returned: whether the load does work in the mode, whether the
    iteration has converged, and whether a hinge is outside its validity range.
    """
    estimate = linear.factors[row]
    buckles = wanted & jnp.isfinite(estimate)
    estimate = jnp.where(buckles, estimate, 0.0)
    earlier = jnp.arange(len(linear.factors)) < row
    index = jnp.sum(earlier & (linear.factors * estimate > 0))
    held = jnp.abs(linear.factors) <= 2 * jnp.abs(estimate)
    shares = linear.forces.T @ linear.rate[:-1]
    held_rate = jnp.append(linear.vectors @ jnp.where(held, shares, 0.0), 0.0)
    mode = linear.vectors[:, row]
    coupled = jnp.abs(shares[row]) > _COUPLED * linear.rate_size
    # In these units, all displacements of a rigid column are rounding errors.
    size = metric.length(jnp.append(mode, 0.0) / metric.units)
    coupled &= jnp.abs(estimate * shares[row]) * size > _NO_DISPLACEMENT

    def improve(state: _Iteration) -> _Iteration:
        point, amplitude = state.point, state.amplitude
        tangent = system.tangent(point)
        shapes, correction = linear.reduced(tangent, held)
        stiffness = system.stiffness_against(point, shapes)
        value = jnp.linalg.eigvalsh(stiffness)[index]
        secant = (value - state.last[1]) / (amplitude - state.last[0])
        # Small differences may be rounding errors.
        known = jnp.abs(value - state.last[1]) > _SMALL_DIFFERENCE
        rate = jnp.where(known, secant, state.rate)
        limit = _LARGEST_CHANGE * jnp.abs(amplitude)
        change = jnp.clip(-value / rate, -limit, limit)
        work, slope = mode @ tangent.residual, mode @ tangent.by_factor
        by_factor = jnp.where(coupled, -work / jnp.where(coupled, slope, 1.0), change)
        correction = jnp.append(correction, 0.0)
        correction += by_factor * linear.rate + (change - by_factor) * held_rate
        moved = metric.length((point - linear.point) / metric.units)
        share = metric.length(correction / metric.units) / moved
        return _Iteration(
            point + correction,
            amplitude + change,
            jnp.stack([amplitude, value]),
            rate,
            jnp.maximum(jnp.abs(change / amplitude), share),
            state.iterations + 1,
        )

    def unfinished(state: _Iteration) -> Flag:
        return (state.change > _NEGLIGIBLE) & (state.iterations < _ITERATIONS)

    start = linear.point + estimate * linear.rate
    change, none = jnp.where(buckles, 1.0, 0.0), jnp.zeros((), int)
    # Without loads, the stiffness against the amplitude is one.
    last, rate = jnp.array([0.0, 1.0]), -1 / estimate
    state = _Iteration(start, estimate, last, rate, change, none)
    state = jax.lax.while_loop(unfinished, improve, state)
    converged = buckles & (state.change <= _CONVERGED)
    point = jnp.where(converged, state.point, start)
    outside = system.out_of_range(point)
    return point, coupled, converged, outside


def _is_first(
    system: PathSystem, metric: Metric, linear: _Modes, critical: Float[Array, " n"]
) -> Flag:
    """Decide whether the equilibrium becomes unstable first at a critical point.

    It is followed from the load factor zero almost to this point. It must stay stable,
    and in one direction the stiffness must have become a fraction of its initial value.
    Otherwise the equilibrium has become unstable before, or the point is on another path.
    """

    def correct(state: tuple[Array, Scalar, Count]) -> tuple[Array, Scalar, Count]:
        point, _, count = state
        tangent = system.tangent(point)
        change = -tangent.factors(symmetric=False).solve(tangent.residual)
        change = jnp.append(change, 0.0)
        return point + change, metric.length(change / metric.units), count + 1

    def follow(
        state: tuple[Array, Array, Flag], share: Scalar
    ) -> tuple[tuple[Array, Array, Flag], Scalar]:
        point, rate, stable = state
        start = point + (share * critical[-1] - point[-1]) * rate
        point, size, _ = jax.lax.while_loop(
            lambda state: (state[1] > _FOLLOWED) & (state[2] < _CORRECTIONS),
            correct,
            (start, jnp.ones(()), jnp.zeros((), int)),
        )
        tangent = system.tangent(point)
        # The initial stiffness against the amplitudes is the unit matrix.
        none = jnp.zeros(linear.factors.shape, bool)
        shapes, _ = linear.reduced(tangent, none)
        lowest = jnp.linalg.eigvalsh(shapes.T @ tangent.jacobian @ shapes)[0]
        stable &= _is_stable(system, metric, tangent) & (size <= _FOLLOWED)
        return (point, _rate(tangent), stable), lowest

    shares = jnp.linspace(0.0, _NEARLY_CRITICAL, _LOAD_STEPS + 1)[1:]
    start = linear.point, linear.rate, jnp.ones((), bool)
    (_, _, stable), lowest = jax.lax.scan(follow, start, shares)
    return stable & (lowest[-1] < _SMALL_STIFFNESS)


def _rate(tangent: PathTangent) -> Float[Array, " n"]:
    """Return the change of a point of the equilibrium with the load factor."""
    change = -tangent.factors(symmetric=False).solve(tangent.by_factor)
    return jnp.append(change, 1.0)


def _is_stable(system: PathSystem, metric: Metric, tangent: PathTangent) -> Flag:
    """Decide whether the stiffness resists all displacements that are allowed."""
    if not system.constraints.size:
        return tangent.factors(symmetric=True).is_stable()
    matrix, _ = allowed_stiffness(system, metric, tangent)
    return Factors.of(matrix, symmetric=True).is_stable()


def _cholesky(matrix: Float[Array, "n n"]) -> tuple[Float[Array, "n n"], Flag]:
    """Factorize a matrix, and decide whether it is positive definite."""
    lower = jnp.linalg.cholesky(matrix)
    smallest = _SINGULAR * len(matrix) * jnp.max(jnp.abs(jnp.diagonal(matrix)))
    return lower, jnp.all(jnp.diagonal(lower) ** 2 > smallest)
