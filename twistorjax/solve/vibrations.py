"""Natural vibrations of a mechanism about an equilibrium."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp

from .._compile.compilation import fast_compile
from .._utils.host import is_traced
from .._utils.progress import announced
from .._utils.types import NumberLike, Poses
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Load
from ..mechanism.mechanism import fixed_bodies, Mechanism
from ..results.codes import RESULTS
from .equations.consistency import consistent
from .equations.modes import natural_modes
from .equations.problem import Problem
from .equations.system import System
from .out_of_plane import out_of_plane
from .statics.solution import StateLike
from .vibration_results import AbstractSource, Vibrations


class _Source(AbstractSource):
    """A mechanism and the equilibrium about which it vibrates."""

    mechanism: Mechanism
    about: StateLike | None
    held: tuple[str, ...] = eqx.field(static=True)  # Bodies that do not move

    def lowest_out_of_plane(self) -> float | None:
        try:
            model = out_of_plane(self.mechanism, self.about, fixed=self.held)
            return float(model.vibrations(modes=1).frequencies[0])
        except (ValueError, RuntimeError):
            return None


@announced("vibrations")
def vibrations(
    mechanism: Mechanism,
    prescribed: Sequence[str] | Mapping[str, Sequence[str]] = (),
    *,
    modes: int | None = None,
    about: StateLike | None = None,
    loads: Sequence[Load] = (),
    constraints: Sequence[AbstractConstraint] = (),
    time: NumberLike = 0.0,
    throw: bool = True,
) -> Vibrations:
    """Compute the natural frequencies and mode shapes in the plane about an equilibrium.

    A mechanism may have lower modes out of its plane, which `out_of_plane` computes; the
    printed result says so if they are known. Damping is neglected; `frequency_response`
    includes it. Hinges have no mass: divide a flexure whose mass matters by
    `flexures.chain`. The result is differentiable. If some frequencies are equal, only
    symmetric functions of them have first derivatives, and only their sum has second
    derivatives. A few `modes` of a mechanism of many bodies without constraints take a
    small part of the time of all modes.

    Args:
        mechanism: The mechanism. Bodies that can move need mass and inertia, and the
            origin of their frame at the center of mass.
        prescribed: Coordinates that do not vibrate because their displacement is
            prescribed: names of bodies for all three coordinates, or a mapping from names
            to some of "angle", "x", "y".
        modes: Number of modes, from the lowest frequency; by default all.
        about: The equilibrium, or its poses; by default the reference configuration;
            rad, m, m.
        loads: Loads that act at this equilibrium, but no follower loads. They contribute
            to the tangent stiffness, because their moments depend on the rotations of the
            bodies.
        constraints: Pins, sliders, and other constraints between the bodies. They must be
            satisfied at the equilibrium.
        time: Time at which time-dependent constraints are evaluated, by default zero; s.
        throw: Whether a failure raises an error; otherwise it is reported by `result`.

    Returns:
        The natural frequencies (Hz) in ascending order, and the mass-normalized mode
        shapes. If `throw` is False, the frequencies of unstable modes are NaN.

    Raises:
        ValueError: Double precision is disabled, a name is unknown, a body that moves has
            no mass, a load is a follower load, which has no potential, no coordinate is
            free, `modes` is invalid, the state is not an equilibrium under the loads, or
            the constraints are not independent or not satisfied.
        RuntimeError: The equilibrium is not stable, or a value is not finite.

    Source:
        The matrices of equation 5.24 of the dissertation, linearized.

    Example:
        >>> import jax.numpy as jnp
        >>> from twistorjax import Body, Hinge, Mechanism, Quadratic, vibrations
        >>> spring = Quadratic(jnp.diag(jnp.array([1.0, 400.0, 100.0])))
        >>> hinge = Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
        >>> block = Body("block", mass=1.0, inertia=0.1)
        >>> mechanism = Mechanism([Body("wall"), block], [hinge], fixed=["wall"])
        >>> 2 * jnp.pi * vibrations(mechanism).frequencies
        Array([ 3.16227766, 10.        , 20.        ], dtype=float64)
    """
    held = mechanism.dofs_of("prescribed", prescribed)
    problem = Problem.of(
        mechanism, loads, (), constraints, time, held=held, supported=False
    )
    problem.loads.require_potential("`frequency_response`, or `simulate` the motion")
    if len(problem.dofs.free) <= problem.constraints.size:
        raise ValueError(
            "No coordinate can vibrate: all of them are fixed, prescribed, or determined "
            "by constraints. Leave at least one coordinate free."
        )
    count = problem.mode_count(modes)
    state = problem.state(about)
    solution = _vibrations(mechanism, problem.system, state, count)
    if not is_traced(solution) and not constraints:
        still = tuple(mechanism.names[row] for row in sorted(fixed_bodies(held)))
        source = _Source(mechanism, about, still)
        solution = replace(solution, source=source)
    return problem.finish(solution, throw, state)


@fast_compile
def _vibrations(
    mechanism: Mechanism, system: System, displacements: Poses, count: int
) -> Vibrations:
    """Solve the eigenvalue problem of `vibrations`."""
    angular, vectors, unstable = natural_modes(mechanism, system, displacements, count)
    is_consistent = consistent(system, displacements)
    finite = jnp.all(jnp.isfinite(angular))
    stable = ~jnp.any(unstable)
    frequencies = jnp.maximum(angular, 0.0) / (2 * jnp.pi)
    frequencies = jnp.where(unstable, jnp.nan, frequencies)
    shapes = jnp.zeros((vectors.shape[1], mechanism.reference.size))
    shapes = shapes.at[:, system.free].set(vectors.T)
    result = RESULTS.where(stable, RESULTS.successful, RESULTS.unstable)
    result = RESULTS.where(is_consistent, result, RESULTS.inconsistent_constraints)
    result = RESULTS.where(finite | ~is_consistent, result, RESULTS.not_finite)
    return Vibrations(
        frequencies=jnp.where(finite, frequencies, jnp.nan),
        shapes=jnp.where(finite, shapes, jnp.nan).reshape(-1, *mechanism.reference.shape),
        result=result,
        names=mechanism.names,
    )
