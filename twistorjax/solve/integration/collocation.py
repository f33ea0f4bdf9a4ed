"""Collocation methods for stiff mechanisms, as solvers for diffrax.

The hinges of a flexure mechanism are stiff along their axes. Its motion therefore stays
close to a curved surface in the space of all displacements. A linearized step leaves this
surface: it stretches the hinges, which causes large, spurious forces. If the hinges have
rotated, these forces also act along the surface. For this reason Rosenbrock methods need
short steps, and Newton's method fails in ordinary implicit Runge-Kutta methods.

Here the mid-frame translations of the hinges are additional unknowns.
The forces of the hinges are computed for these translations and not for those that follow
from the displacements. One linear solve corrects displacements and translations together,
such that they agree to first order. The forces then remain smooth functions of the
unknowns for any stiffness of the hinges. In statics, the generalized stress has the same
purpose (Magisano, Leonetti and Garcea, Int. J. Num. Meth. Eng. 109, 2017).

A step has four parts:

1. Accelerations, translations, and constraint forces at the stages are extrapolated from
   the last step; see `StepHistory`.
2. The equations of motion are linearized once, at the extrapolated middle stage. In the
   basis of the eigenvectors of the collocation matrix, the stages decouple. One matrix of
   the size of the free degrees of freedom is inverted for each eigenvalue.
3. A fixed number of simplified Newton iterations corrects the stages. There is no test of
   convergence, so that all designs of a batch need the same time. The last correction is
   a part of the error estimate of the step.
4. The state at the end of the step is projected onto the constraints.

Three iterations are sufficient for steps six times as long as those of Rodas5P.
"""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Inexact

from ..._utils.pytrees import select, stop_gradient
from ..._utils.types import Scalar
from ...linalg.block_factors import BlockInverses, Layout
from ...linalg.elimination import inverse
from ...linalg.products import product
from .polynomials import DenseOutput, StepHistory
from .schemes import collocation_scheme, Scheme
from .system import MotionSystem, MotionTangent, State


class _Collocation(dfx.AbstractSolver):
    """A collocation method with a fixed number of iterations.

    Its term is `motion_system.equation`, and the `args` of diffrax are a `MotionSystem`.
    """

    iterations: eqx.AbstractVar[int]
    scheme: eqx.AbstractClassVar[Scheme]
    term_structure: ClassVar[Any] = dfx.ODETerm
    interpolation_cls: ClassVar[Callable[..., DenseOutput]] = DenseOutput

    def init(self, terms, t0, t1, y0, args):
        del terms, t1
        return StepHistory.constant(self.scheme, t0, y0, args)

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        if made_jump is not False:
            restarted = self.init(terms, t0, t1, y0, args)
            solver_state = select(made_jump, restarted, solver_state)
        return _step(self, t0, t1 - t0, y0, args, solver_state)


class Radau(_Collocation, dfx.AbstractAdaptiveSolver):
    """The method Radau IIA with three stages, for damped and stiff motion.

    Its order is five; it is stiffly accurate and L-stable. A step linearizes the
    equations of motion once and inverts two matrices of the size of the free degrees of
    freedom, M + h g D + (h g)^2 K, where h is the step and g is the real or the complex
    eigenvalue of the collocation matrix. Constraints are satisfied at each stage.

    Args:
        iterations: Number of Newton iterations in a step; by default 3.

    Source:
        Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.8.
    """

    iterations: int = 3
    scheme: ClassVar[Scheme] = collocation_scheme("radau", 3)

    def order(self, terms):
        del terms
        return 5


class Gauss(_Collocation):
    """Collocation at the two Gauss points, for undamped motion with a constant step.

    Its order is four, or two with constraints. It is symplectic: it conserves linear and
    angular momentum, and the error of the energy does not grow with time. There is no
    error estimate, so `simulate` needs a `step`. Choose one that is short compared with
    the period of the fastest motion of interest.

    Args:
        iterations: Number of Newton iterations in a step; by default 8, which reduces the
            error of the iteration to rounding errors.

    Source:
        Hairer, Lubich and Wanner, Geometric Numerical Integration, chapters II and VI.
    """

    iterations: int = 8
    scheme: ClassVar[Scheme] = collocation_scheme("gauss", 2)

    def order(self, terms):
        del terms
        return 4


# The members of diffrax's enumeration are inherited, which type checkers do not see.
_results: Any = dfx.RESULTS

# A step has failed if its last iteration changes the state by more than this, in the norm
# of the tolerance. This test is needed for constant steps, which have no error estimate.
_LARGEST_LAST_CHANGE = 1e-2
# A state that is not finite is reported if the step is below this fraction of the slowest
# period.
_SMALLEST_STEP = 1e-9


@eqx.filter_jit  # diffrax traces a step three times
def _step(
    solver: _Collocation,
    start: Any,
    step: Any,
    state: State,
    system: MotionSystem,
    history: StepHistory,
) -> tuple[State, State | None, dict[str, Any], StepHistory, dfx.RESULTS]:
    """Advance a motion by one step, from the time `start`; s.

    The results are the state at the end; its error estimate, if the method has one; the
    arguments of the dense output; the history of this step; and the result for diffrax.
    """
    scheme = solver.scheme
    size, mass = state.position.size, system.mass
    matrix = step * jnp.asarray(scheme.matrix)
    matrix_squared = step**2 * jnp.asarray(scheme.matrix @ scheme.matrix)
    times = start + step * jnp.asarray(scheme.nodes)
    accelerations, translations, multipliers = history.extrapolate(scheme, step)

    def positions_and_rates(accelerations: Array) -> tuple[Array, Array]:
        rates = state.rate[None] + product(matrix, accelerations)
        return state.position[None] + product(matrix, rates), rates

    # The tangent is not differentiated with respect to parameters: it determines how fast
    # the iteration converges, and the residual determines the solution.
    positions, rates = positions_and_rates(accelerations)
    middle = scheme.stages // 2
    frozen, *stages = stop_gradient(
        (system, times, positions, rates, translations, multipliers)
    )
    tangent = frozen.tangent(*(values[middle] for values in stages))
    frozen_step = jax.lax.stop_gradient(step)
    inverses = _stage_inverses(scheme, tangent, frozen_step, frozen)
    to_components = jnp.asarray(scheme.to_components)
    from_components = jnp.asarray(scheme.from_components)
    # The accelerations of a change that removes a violation at the stages.
    from_violation = jnp.asarray(-scheme.differentiate_twice) / frozen_step**2

    def iterate(_, unknowns: tuple[Array, ...]) -> tuple[Array, ...]:
        """Correct the stages once; the last result is the correction."""
        accelerations, translations, multipliers, _ = unknowns
        positions, rates = positions_and_rates(accelerations)
        forces = jax.vmap(system.forces)(
            times, positions, rates, translations, multipliers
        )
        residual = forces.net - mass[None] * accelerations
        residual -= jax.vmap(tangent.hinges.forces_of_translations)(forces.excess)
        right = product(to_components, residual)
        if multipliers.size:
            removal = product(from_violation, forces.violation)
            right = jnp.concatenate([right, removal], axis=1)
        solution = product(from_components, inverses.solve(right))
        change, multiplier_change = solution[:, :size], solution[:, size:]
        position_change = product(matrix_squared, change)
        translation_change = jax.vmap(tangent.hinges.translation_change)(position_change)
        translations = translations + forces.excess + translation_change
        return (
            accelerations + change,
            translations,
            multipliers + multiplier_change,
            change,
        )

    unknowns = accelerations, translations, multipliers, jnp.zeros_like(accelerations)
    unknowns = jax.lax.fori_loop(0, solver.iterations, iterate, unknowns)
    accelerations, translations, multipliers, change = unknowns
    positions, rates = positions_and_rates(accelerations)

    weights = step * jnp.asarray(scheme.weights)
    position = state.position + weights @ rates
    rate = state.rate + weights @ accelerations
    position, rate = system.project(start + step, position, rate)
    powers = jnp.zeros((scheme.stages, state.work.size))
    if state.work.size:
        powers = jax.vmap(system.instant)(times, positions, rates).powers
    end = State(position, rate, state.work + weights @ powers)

    new_history = history.next(scheme, accelerations, translations, multipliers, step)
    to_coefficients = jnp.asarray(scheme.to_coefficients)
    dense = {
        "y0": state,
        "y1": end,
        "accelerations": to_coefficients @ accelerations,
        "powers": to_coefficients @ powers,
    }
    # diffrax rejects a step whose error is NaN and tries a shorter one, which may avoid
    # values that are not finite. It would continue forever if the start of the step is
    # not finite either, or if no step is short enough.
    failed = ~jnp.all(jnp.isfinite(history.last_acceleration))
    not_finite = ~jnp.all(jnp.isfinite(position)) | ~jnp.all(jnp.isfinite(rate))
    failed |= not_finite & (step < _SMALLEST_STEP * system.period)
    last_change = system.norm(
        State(product(matrix_squared, change)[-1], product(matrix, change)[-1], end.work)
    )
    result = _results.where(
        last_change > _LARGEST_LAST_CHANGE,
        _results.nonlinear_divergence,
        _results.successful,
    )
    result = _results.where(failed, _results.nonfinite, result)
    error = None
    if scheme.stiffly_accurate:
        error = _error(
            scheme, inverses, tangent,
            *stop_gradient(
                (step, state, system, history, rates, accelerations, change)
            ),
        )  # fmt: skip
        # diffrax reports the result of an accepted step only.
        error = jax.tree.map(lambda value: jnp.where(failed, 0.0, value), error)
    return end, error, dense, new_history, result


def _stage_inverses(
    scheme: Scheme, tangent: MotionTangent, step: Scalar, system: MotionSystem
) -> "_StageInverses | _BlockStageInverses":
    """Invert the matrices of the decoupled stages for a step; s."""
    layout = system.layout
    arrange = jnp.diag if layout is None else layout.of_diagonal
    inertia = arrange(system.mass)

    def matrix(eigenvalue: Inexact[Array, ""]) -> Inexact[Array, "*matrix"]:
        parts = inertia, tangent.hinges.damping, tangent.stiffness
        inertial, damping, stiffness = (part.astype(eigenvalue.dtype) for part in parts)
        return inertial + eigenvalue * damping + eigenvalue**2 * stiffness

    real = None
    if scheme.real_eigenvalue is not None:
        real = matrix(scheme.real_eigenvalue * step)
    pair = matrix(step.astype(complex) * jnp.asarray(scheme.complex_eigenvalue))
    if layout is None:
        return _StageInverses.of(real, pair, tangent.jacobian)
    jacobian = tangent.jacobian
    return _BlockStageInverses(
        None if real is None else _ConstrainedInverse.of(real, layout, jacobian),
        _ConstrainedInverse.of(pair, layout, jacobian),
    )


class _StageInverses(NamedTuple):
    """Inverses of the matrices of the decoupled stages, including the constraints.

    They are transposed, because rows are multiplied by them.
    """

    # Inverse for the real eigenvalue, if there is one
    real: Float[Array, "unknowns unknowns"] | None
    # Real and imaginary part of the inverse for the complex eigenvalue
    pair: tuple[Float[Array, "unknowns unknowns"], Float[Array, "unknowns unknowns"]]

    @classmethod
    def of(
        cls, real: Array | None, pair: Array, jacobian: Float[Array, "entries free"]
    ) -> "_StageInverses":
        """Invert both matrices with the constraints."""

        def inverted(matrix: Inexact[Array, "free free"]) -> Array:
            transposed, entries = matrix.T, len(jacobian)
            if entries:
                rows, zero = jacobian.astype(matrix.dtype), jnp.zeros((entries, entries))
                zero = zero.astype(matrix.dtype)
                transposed = jnp.block([[transposed, rows.T], [-rows, zero]])
            return inverse(transposed)

        inverse_pair = inverted(pair)
        parts = jnp.real(inverse_pair), jnp.imag(inverse_pair)
        return cls(None if real is None else inverted(real), parts)

    def solve(
        self, right: Float[Array, "stages unknowns"]
    ) -> Float[Array, "stages unknowns"]:
        """Solve the linear systems of all components; see `Scheme`."""
        real, imaginary = (product(right[-2:], part) for part in self.pair)
        pair = jnp.stack([real[0] - imaginary[1], real[1] + imaginary[0]])
        if self.real is None:
            return pair
        return jnp.concatenate([product(right[:1], self.real), pair])

    def solve_real(self, right: Float[Array, " free"]) -> Float[Array, " free"]:
        """Solve the linear system of the real eigenvalue, without constraint forces."""
        assert self.real is not None
        return right @ self.real[: right.size, : right.size]


class _BlockStageInverses(NamedTuple):
    """Those of a mechanism of many bodies, which are block tridiagonal."""

    real: "_ConstrainedInverse | None"
    pair: "_ConstrainedInverse"  # Complex

    def solve(
        self, right: Float[Array, "stages unknowns"]
    ) -> Float[Array, "stages unknowns"]:
        """Solve the linear systems of all components; see `Scheme`."""
        pair = self.pair.solve(jax.lax.complex(right[-2], right[-1]))
        solutions = [jnp.real(pair), jnp.imag(pair)]
        if self.real is not None:
            solutions.insert(0, self.real.solve(right[0]))
        return jnp.stack(solutions)

    def solve_real(self, right: Float[Array, " free"]) -> Float[Array, " free"]:
        """Solve the linear system of the real eigenvalue, without constraint forces."""
        assert self.real is not None
        no_violation = jnp.zeros(len(self.real.jacobian))
        return self.real.solve(jnp.concatenate([right, no_violation]))[: right.size]


class _ConstrainedInverse(NamedTuple):
    """Inverse of a matrix in blocks, and the constraint forces that a violation needs."""

    blocks: BlockInverses
    jacobian: Inexact[Array, "entries free"]  # Derivatives of the violation
    # Accelerations for unit constraint forces, in columns
    response: Inexact[Array, "free entries"]
    by_violation: Inexact[Array, "entries entries"]  # Forces for unit violations

    @classmethod
    def of(
        cls, matrix: Inexact[Array, "3 blocks size size"], layout: Layout, jacobian: Array
    ) -> "_ConstrainedInverse":
        blocks, jacobian = BlockInverses.of(matrix, layout), jacobian.astype(matrix.dtype)
        if not len(jacobian):
            return cls(blocks, jacobian, jacobian.T, jacobian[:, :0])
        response = blocks.solve(jacobian.T)
        return cls(blocks, jacobian, response, inverse(jacobian @ response))

    def solve(self, right: Inexact[Array, " unknowns"]) -> Inexact[Array, " unknowns"]:
        free = right.size - len(self.jacobian)
        if free == right.size:
            return self.blocks.solve(right)
        change = self.blocks.solve(right[:free])
        forces = self.by_violation @ (right[free:] - self.jacobian @ change)
        return jnp.concatenate([change + self.response @ forces, forces])


def _error(
    scheme: Scheme,
    inverses: _StageInverses | _BlockStageInverses,
    tangent: MotionTangent,
    step: Scalar,
    state: State,
    system: MotionSystem,
    history: StepHistory,
    rates: Float[Array, "stages free"],
    accelerations: Float[Array, "stages free"],
    change: Float[Array, "stages free"],
) -> State:
    """Estimate the absolute error of a step: that of collocation and that of iteration.

    The error of the collocation is estimated by an embedded quadrature of order three.
    The power 3/2 of this estimate has the order of the method. The error of the iteration
    is the effect of its last correction, the `change` of the accelerations.

    Source:
        Hairer and Wanner, Solving Ordinary Differential Equations II, equations IV.8.19
        and IV.8.20. Their program RADAU5 compares ten times the estimate with the
        tolerance to the power 2/3, which is the same.
    """
    assert scheme.real_eigenvalue is not None
    embedded = scheme.embedded_weights()
    position = step * (scheme.real_eigenvalue * state.rate + embedded @ rates)
    rate = step * (
        scheme.real_eigenvalue * history.last_acceleration + embedded @ accelerations
    )
    eigenvalue = scheme.real_eigenvalue * step
    damping = tangent.hinges.damping_forces(position)
    right = system.mass * (eigenvalue * rate + position) + eigenvalue * damping
    filtered = inverses.solve_real(right)
    estimate = State(filtered, (filtered - position) / eigenvalue, state.work * 0)
    estimate = jax.tree.map(jnp.abs, estimate)
    factor = 10**1.5 * jnp.sqrt(system.norm(estimate))
    weights = step * jnp.asarray(scheme.weights)
    rate_change = weights @ change
    of_iteration = State(
        jnp.abs(weights @ (step * jnp.asarray(scheme.matrix) @ change)),
        jnp.abs(rate_change),
        state.work * 0,
    )
    return jax.tree.map(lambda a, b: factor * a + b, estimate, of_iteration)
