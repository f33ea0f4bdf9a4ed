"""Collocation for stiff mechanisms: linearly implicit solvers for diffrax.

A flexure mechanism is stiff in a way that defeats the usual methods: its hinges hardly
stretch, so what it can do is a curved surface among all displacements, and every
linearisation leaves it. The false tension of such a step is large, and points along the
surface as soon as the hinge has turned. Rosenbrock methods then take small steps, and
the Newton's method of implicit ones fails.

Here each hinge's stretch is an unknown of its own, foreseen from the last step, and
forced to agree with the displacements by the same linear solve that finds these: what a
hinge bears stays smooth, and three solves with one tangent, at the foreseen middle of the
step, suffice for steps six times as long as those of Rodas5P. Nothing iterates to
convergence, so that the lanes of a batch stay together; what the last solve still
changed counts as an error of the step.
"""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from .._utils.pytrees import stop_gradient
from .._utils.types import Scalar
from ..mechanism.hinge_forces import product
from .collocation_schemes import Scheme, scheme
from .motion_system import MotionSystem, Slopes, State
from .small_matrices import inverse


class StepHistory(NamedTuple):
    """What one step leaves to the next: polynomials in time, by their coefficients.

    Args:
        acceleration: of the free coordinates, at the end.
        stretches: that the hinges bear, at the end; m.
        accelerations: through the step.
        stretching: the stretches through the step.
        pushes: of the constraints, through the step.
        step: its length; s.
    """

    acceleration: Float[Array, " free"]
    stretches: Float[Array, " stretches"]
    accelerations: Float[Array, "degrees free"]
    stretching: Float[Array, "degrees stretches"]
    pushes: Float[Array, "degrees constraints"]
    step: Scalar


class DenseOutput(dfx.AbstractLocalInterpolation):
    """The motion within a step, as the integrals of its accelerations' polynomial.

    Args:
        t0: start of the step; s.
        t1: its end; s.
        y0: the state at its start.
        y1: the state at its end.
        accelerations: coefficients of their polynomial, lowest power first.
        powers: the same of what is done; W.
    """

    t0: Scalar
    t1: Scalar
    y0: State
    y1: State
    accelerations: Float[Array, "degrees free"]
    powers: Float[Array, "degrees works"]

    def evaluate(self, t0, t1=None, left=True) -> State:
        if t1 is not None:
            start, end = self.evaluate(t0, left=left), self.evaluate(t1, left=left)
            return jax.tree.map(jnp.subtract, end, start)
        length = self.t1 - self.t0
        part = (t0 - self.t0) / jnp.where(length > 0, length, 1.0)
        inside, end = self._inside(part), self._inside(jnp.ones_like(part))
        # constraints have shifted the end, which is to be met
        return jax.tree.map(
            lambda here, there, met: here + part**3 * (met - there), inside, end, self.y1
        )

    def _inside(self, part: Any) -> State:
        length = self.t1 - self.t0
        degrees = jnp.arange(1, 1 + len(self.accelerations), dtype=part.dtype)
        once = length * part**degrees / degrees
        twice = length * part * once / (degrees + 1)
        return State(
            position=self.y0.position
            + length * part * self.y0.rate
            + twice @ self.accelerations,
            rate=self.y0.rate + once @ self.accelerations,
            work=self.y0.work + once @ self.powers,
        )


class _Collocation(dfx.AbstractSolver):
    """A method of collocation, with a given number of linear solves a step.

    Its equation is `equation`, its arguments a `MotionSystem`.
    """

    sweeps: eqx.AbstractVar[int]
    kind: eqx.AbstractClassVar[Scheme]
    term_structure: ClassVar[Any] = dfx.ODETerm
    interpolation_cls: ClassVar[Callable[..., DenseOutput]] = DenseOutput

    def init(self, terms, t0, t1, y0, args):
        del terms, t1
        return _first(self.kind, t0, y0, args)

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        if made_jump is not False:
            fresh = self.init(terms, t0, t1, y0, args)
            solver_state = jax.tree.map(
                lambda new, old: jnp.where(made_jump, new, old), fresh, solver_state
            )
        return _step(self, t0, t1 - t0, y0, args, solver_state)


class Radau(_Collocation, dfx.AbstractAdaptiveSolver):
    """Collocation at Radau's three points, with a given number of linear solves a step.

    Of order five, stiffly accurate and L-stable. A step takes one tangent, and factors
    it twice: `M + h g D + (h g)^2 K`, of the size of the places alone, for one real and
    one complex number g. An angle or length that constraints keep is kept at each stage.

    Args:
        sweeps: linear solves for the stages of a step.

    Source:
        Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.8; the
        foreseen stretches after Magisano, Leonetti and Garcea, Int. J. Num. Meth. Eng.
        109, 2017.
    """

    sweeps: int = 3
    kind: ClassVar[Scheme] = scheme("radau", 3)

    def order(self, terms):
        del terms
        return 5


class Gauss(_Collocation):
    """Collocation at Gauss's two points: symplectic, for undamped motion at fixed steps.

    Of order four; of order two where constraints act. It keeps momenta, and energy but
    for an error that does not grow with time. There is no error estimate: `simulate` asks
    for a `step`, short against the fastest motion that matters.

    Args:
        sweeps: linear solves for the stages of a step, to reach rounding.

    Source:
        Hairer, Lubich and Wanner, Geometric Numerical Integration, chapters II and VI.
    """

    sweeps: int = 8
    kind: ClassVar[Scheme] = scheme("gauss", 2)

    def order(self, terms):
        del terms
        return 4


# its items are inherited, which type checkers do not see
_results: Any = dfx.RESULTS

# What the last solve of a step may still change, where nothing else controls its length
_UNSETTLED = 1e-2


def _first(kind: Scheme, time: Any, state: State, system: MotionSystem) -> StepHistory:
    """What there is to foresee the first step from: that nothing changes."""
    now = system.instant(time, state.position, state.rate)
    displacements, _ = system.expand(time, state.position, state.rate)
    stretches = system.mechanism.hinge_assembly.stretches(displacements).reshape(-1)

    def constant(value: Array) -> Array:
        return jnp.zeros((len(kind.through), value.size)).at[0].set(value)

    return StepHistory(
        acceleration=now.acceleration,
        stretches=stretches,
        accelerations=constant(now.acceleration),
        stretching=constant(stretches),
        pushes=constant(now.push)[: kind.stages],
        step=jnp.ones_like(time),
    )


@eqx.filter_jit  # diffrax traces a step three times
def _step(
    method: _Collocation,
    start: Any,
    step: Any,
    state: State,
    system: MotionSystem,
    history: StepHistory,
) -> tuple[State, State | None, dict[str, Any], StepHistory, dfx.RESULTS]:
    kind = method.kind
    size, mass = state.position.size, system.mass
    matrix = step * jnp.asarray(kind.matrix)
    twice = step**2 * jnp.asarray(kind.matrix @ kind.matrix)
    times = start + step * jnp.asarray(kind.nodes)

    # The stages, foreseen
    part = 1 + jnp.asarray(kind.nodes) * step / history.step
    ahead = part[:, None] ** np.arange(len(kind.through), dtype=float)[None]
    accelerations = product(ahead, history.accelerations)
    stretches = product(ahead, history.stretching)
    pushes = product(ahead[:, : kind.stages], history.pushes)

    def moved(accelerations: Array) -> tuple[Array, Array]:
        rates = state.rate[None] + product(matrix, accelerations)
        return state.position[None] + product(matrix, rates), rates

    # One tangent, at the middle one of them. How it depends on parameters is left to the
    # residual: it changes the way to an answer, not the answer.
    positions, rates = moved(accelerations)
    middle = kind.stages // 2
    still, *there = stop_gradient((system, times, positions, rates, stretches, pushes))
    tangent = still.slopes(*(row[middle] for row in there))
    to_eigenvectors, from_eigenvectors = (
        jnp.asarray(kind.to_eigenvectors),
        jnp.asarray(kind.from_eigenvectors),
    )
    eigenvalue = jax.lax.stop_gradient(step).astype(to_eigenvectors.dtype)
    eigenvalue = eigenvalue * jnp.asarray(kind.eigenvalues)[:, None, None]
    backwards = _backwards(tangent, eigenvalue, still.mass)

    def solve(_, found):
        accelerations, stretches, pushes, _ = found
        positions, rates = moved(accelerations)
        forces = jax.vmap(system.forces)(times, positions, rates, stretches, pushes)
        lacking = forces.net - mass[None] * accelerations
        lacking = lacking - product(forces.excess, tangent.bearing.T)
        right = product(to_eigenvectors, lacking.astype(to_eigenvectors.dtype))
        if pushes.size:
            gap = product(to_eigenvectors, forces.violation.astype(to_eigenvectors.dtype))
            gap = -gap / eigenvalue[:, 0] ** 2
            right = jnp.concatenate([right, gap], axis=1)
        solved = jnp.sum(backwards * right[:, None], axis=-1)
        solved = jnp.real(product(from_eigenvectors, solved))
        change, more = solved[:, :size], solved[:, size:]
        followed = product(product(twice, change), tangent.stretching)
        stretches = stretches + forces.excess + followed
        return accelerations + change, stretches, pushes + more, change

    found = accelerations, stretches, pushes, jnp.zeros_like(accelerations)
    found = jax.lax.fori_loop(0, method.sweeps, solve, found)
    accelerations, stretches, pushes, change = found
    positions, rates = moved(accelerations)

    weights = step * jnp.asarray(kind.weights)
    position = state.position + weights @ rates
    rate = state.rate + weights @ accelerations
    position, rate = system.project(start + step, position, rate)
    powers = jnp.zeros((kind.stages, state.work.size))
    if state.work.size:
        powers = jax.vmap(system.instant)(times, positions, rates).powers
    end = State(position, rate, state.work + weights @ powers)

    through = jnp.asarray(kind.through)
    values = accelerations, stretches
    if kind.ends:
        values = (
            jnp.concatenate([history.acceleration[None], accelerations]),
            jnp.concatenate([history.stretches[None], stretches]),
        )
    kept = StepHistory(
        acceleration=accelerations[-1],
        stretches=stretches[-1],
        accelerations=through @ values[0],
        stretching=through @ values[1],
        pushes=jnp.asarray(kind.powers) @ pushes,
        step=step,
    )
    dense = {
        "y0": state,
        "y1": end,
        "accelerations": jnp.asarray(kind.powers) @ accelerations,
        "powers": jnp.asarray(kind.powers) @ powers,
    }
    # A step that is not finite is tried again with less of it; but not for ever.
    lost = ~jnp.all(jnp.isfinite(history.acceleration))
    broken = ~jnp.all(jnp.isfinite(position)) | ~jnp.all(jnp.isfinite(rate))
    lost |= broken & (step < 1e-9 * system.period)
    left = system.norm(
        State(product(twice, change)[-1], product(matrix, change)[-1], end.work)
    )
    result = _results.where(
        left > _UNSETTLED, _results.nonlinear_divergence, _results.successful
    )
    result = _results.where(lost, _results.nonfinite, result)
    error = None
    if kind.ends:
        error = _error(
            kind, backwards, tangent,
            *stop_gradient(
                (step, state, system, history, rates, accelerations, change)
            ),
        )  # fmt: skip
        # kept, so that diffrax sees the result
        error = jax.tree.map(lambda part: jnp.where(lost, 0.0, part), error)
    return end, error, dense, kept, result


def _backwards(
    tangent: Slopes, eigenvalue: Array, mass: Array
) -> Complex[Array, "reaches unknowns unknowns"]:
    """Of the matrix of all stages, one direction at a time, constraints included."""
    inertia, damping, stiffness, jacobian = (
        part.astype(eigenvalue.dtype)[None]
        for part in (
            jnp.diag(mass), tangent.damping, tangent.stiffness, tangent.jacobian,
        )
    )  # fmt: skip
    matrix = inertia + eigenvalue * damping + eigenvalue**2 * stiffness
    count = len(tangent.jacobian)
    if count:
        jacobian = jnp.broadcast_to(jacobian, (len(eigenvalue), *jacobian.shape[1:]))
        across = jnp.swapaxes(jacobian, 1, 2)
        corner = jnp.zeros((len(eigenvalue), count, count), eigenvalue.dtype)
        matrix = jnp.block([[matrix, -across], [jacobian, corner]])
    return inverse(matrix)


def _error(
    kind: Scheme,
    backwards: Array,
    tangent: Slopes,
    step: Scalar,
    state: State,
    system: MotionSystem,
    history: StepHistory,
    rates: Array,
    accelerations: Array,
    change: Array,
) -> State:
    """The error of a step: of its collocation, and of solves that were too few.

    That of the collocation is estimated by a quadrature of the third order, whose root of
    degree 2/3 is of the method's own; that of the solves by their last change.

    Source:
        Hairer and Wanner, equations IV.8.19 and IV.8.20, and the exponent of their
        program RADAU.
    """
    eigenvalue = kind.eigenvalues[kind.real].real
    lower = _embedded(kind, eigenvalue)
    position = step * (eigenvalue * state.rate + lower @ rates)
    rate = step * (eigenvalue * history.acceleration + lower @ accelerations)
    eigenvalue = eigenvalue * step
    right = (
        system.mass * (eigenvalue * rate + position)
        + eigenvalue * tangent.damping @ position
    )
    size = position.size
    smooth = jnp.real(backwards[kind.real, :size, :size]) @ right
    estimate = State(smooth, (smooth - position) / eigenvalue, state.work * 0)
    estimate = jax.tree.map(jnp.abs, estimate)
    grown = 10**1.5 * jnp.sqrt(system.norm(estimate))
    weights = step * jnp.asarray(kind.weights)
    late = weights @ change
    last = State(
        jnp.abs(weights @ (step * jnp.asarray(kind.matrix) @ change)),
        jnp.abs(late),
        state.work * 0,
    )
    return jax.tree.map(lambda a, b: grown * a + b, estimate, last)


def _embedded(kind: Scheme, eigenvalue: float) -> np.ndarray:
    """Weights of the lower quadrature, less those of the method, the start's apart."""
    degrees = np.arange(1, kind.stages + 1)
    exact = 1 / degrees
    exact[0] -= eigenvalue
    return exact @ kind.powers - kind.weights
