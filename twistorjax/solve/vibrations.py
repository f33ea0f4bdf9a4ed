"""Natural vibrations of a mechanism about an equilibrium."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._compile.compilation import fast_compile
from .._utils.host import is_traced
from .._utils.progress import announced
from .._utils.types import NumberLike, Poses
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Load
from ..mechanism.mechanism import COORDINATES, Mechanism
from ..results.codes import RESULTS, Solution
from ..results.tables import Column, Columns, columns, Tabular
from .equations.consistency import consistent
from .equations.modes import natural_modes
from .equations.problem import Problem
from .equations.system import System
from .statics.solution import StateLike


class Vibrations(Solution, Tabular):
    """Natural frequencies and mode shapes of a mechanism.

    If the equilibrium is unstable with respect to a mode, the frequency of this mode is
    NaN.

    Args:
        frequencies: Natural frequencies in ascending order; Hz.
        shapes: Mass-normalized mode shapes; rad/(kg^0.5 m), 1/kg^0.5, 1/kg^0.5.
        result: `RESULTS.successful` or the reason of the failure; `result_names` returns
            its name.
        names: Names of the bodies.
        source: What vibrates, from which its modes out of the plane can be computed; None
            if they cannot.
    """

    frequencies: Float[Array, "*batch modes"]
    shapes: Float[Array, "*batch modes bodies 3"]
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)
    source: "VibrationSource | None" = None
    _plural: ClassVar[str] = "sets of vibrations"
    _coordinates: ClassVar[tuple[str, ...]] = COORDINATES
    _where: ClassVar[str] = "in the plane"

    def columns(self) -> Columns:
        axes = ("mode", "body")
        entries = [(f"shape_{name}", "") for name in self._coordinates]
        return {
            "frequency": Column(self.frequencies, ("mode",), "Hz"),
            **columns(self.shapes, axes, *entries, body=self.names),
        }

    def _summary(self, names: np.ndarray) -> str:
        title = f"{names}: {self.frequencies.size} vibrations {self._where}"
        lines = [title, "frequency (Hz)  largest translations"]
        for frequency, shape in zip(self.frequencies[:20], self.shapes, strict=False):
            translations = [name in ("x", "y", "z") for name in self._coordinates]
            travel = np.linalg.norm(np.asarray(shape)[:, translations], axis=1)
            largest = [body for body in np.argsort(-travel)[:3] if travel[body] > 0]
            moving = ", ".join(self.names[body] for body in largest) or "rotations only"
            lines.append(f"{float(frequency):>14.6g}  {moving}")
        lowest = None if self.source is None else self.source.lowest_out_of_plane()
        if lowest is not None and lowest < float(self.frequencies[-1]):
            lines.append(
                f"It vibrates out of the plane from {lowest:.6g} Hz on: "
                "`out_of_plane(mechanism).vibrations()`."
            )
        return "\n".join(lines)


class VibrationSource(eqx.Module):
    """A mechanism and the equilibrium about which it vibrates."""

    mechanism: Mechanism
    about: StateLike | None
    held: tuple[str, ...] = eqx.field(static=True)  # Bodies that do not move

    def lowest_out_of_plane(self) -> float | None:
        """Return the lowest natural frequency out of the plane (Hz), if it is known."""
        # That module builds on this one.
        from .out_of_plane import out_of_plane

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
        dofs = set(held)
        still = [
            name
            for row, name in enumerate(mechanism.names)
            if {3 * row, 3 * row + 1, 3 * row + 2} <= dofs
        ]
        source = VibrationSource(mechanism, about, tuple(still))
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
