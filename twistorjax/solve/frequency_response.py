"""Harmonic response of a mechanism about an equilibrium."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from .._compile.compilation import fast_compile
from .._utils.progress import announced
from .._utils.types import FrequenciesLike, NumberLike, PoseLike, Poses, Scalar
from .._utils.validation import require_array
from ..linalg.block_factors import Layout, solve_in_blocks
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Drive, Load, LoadSet, prescribed_dofs
from ..mechanism.mechanism import Mechanism
from ..mechanism.misfits import stroke_forces, stroke_rows
from ..results.codes import RESULTS
from ..results.solutions import BodySolution
from ..results.tables import Column, Columns
from .equations.consistency import consistent
from .equations.problem import Problem
from .equations.system import System
from .statics.solution import StateLike


# A frequency is a resonance if the condition number of the dynamic stiffness is larger.
_LARGEST_CONDITION = 1e13


class FrequencyResponse(BodySolution):
    """Complex amplitudes of a mechanism at each frequency.

    The response to an excitation `cos(2 pi f t)` is the real part of the amplitude times
    `exp(2 pi i f t)`.

    Args:
        frequencies: Frequencies of the excitation; Hz.
        displacements: Amplitude of the displacement of each body from the equilibrium;
            rad, m, m.
        reactions: Amplitude of the external wrench on the fixed and prescribed degrees of
            freedom of each body; N m, N, N.
        constraint_forces: Amplitude of the constraint forces, one for each scalar
            equation of the constraints; N m, N.
        result: `RESULTS.successful` or the reason of the failure; `result_names` returns
            its name.
        names: Names of the bodies.
        constraint_names: Name of the constraint to which each scalar equation belongs.
    """

    frequencies: Float[Array, " frequencies"]
    displacements: Complex[Array, "frequencies bodies 3"]
    reactions: Complex[Array, "frequencies bodies 3"]
    constraint_forces: Complex[Array, "frequencies entries"]
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)
    constraint_names: tuple[str, ...] = eqx.field(static=True)
    _plural: ClassVar[str] = "frequency responses"

    def columns(self) -> Columns:
        frequency = Column(self.frequencies, ("frequency",), "Hz")
        return {"frequency": frequency, **self._body_columns("frequency")}

    def _summary(self, names: np.ndarray) -> str:
        frequencies = np.asarray(self.frequencies)
        text = f"{names}: {len(frequencies)} frequencies"
        if not len(frequencies):
            return text
        return f"{text}, {frequencies.min():.6g} to {frequencies.max():.6g} Hz"


@announced("frequency response")
def frequency_response(
    mechanism: Mechanism,
    frequencies: FrequenciesLike,
    *,
    loads: Sequence[Load] = (),
    drives: Sequence[Drive] = (),
    strokes: Mapping[str, PoseLike] = MappingProxyType({}),
    about: StateLike | None = None,
    static_loads: Sequence[Load] = (),
    constraints: Sequence[AbstractConstraint] = (),
    time: NumberLike = 0.0,
    throw: bool = True,
) -> FrequencyResponse:
    """Compute the response to small harmonic loads and prescribed displacements.

    Args:
        mechanism: The mechanism. Bodies that can move need mass and inertia, and the
            origin of their frame at the center of mass. Hinges may be damped.
        frequencies: Frequencies of the excitation; Hz.
        loads: Amplitudes of the loads; N m, N, N.
        drives: Amplitudes of the prescribed displacements; rad, m, m.
        strokes: Amplitudes of the strokes of actuators, by the names of their hinges; see
            `Mechanism.with_strokes`; rad, m, m.
        about: Equilibrium about which the mechanism vibrates, or its poses; by default
            the reference configuration; rad, m, m.
        static_loads: Constant loads that act at this equilibrium. They contribute to the
            tangent stiffness.
        constraints: Pins, sliders, and other constraints between the bodies. They must be
            satisfied at the equilibrium.
        time: Time at which time-dependent constraints are evaluated, by default zero; s.
        throw: Whether a failure raises an error; otherwise it is reported by `result`.

    Returns:
        The complex amplitudes of displacements, reactions, and constraint forces, one row
        for each frequency.

    Raises:
        ValueError: Double precision is disabled, a name is unknown, a coordinate is
            prescribed twice or is fixed, a body that moves has no mass, the state is not
            an equilibrium under the static loads, or the constraints are not independent
            or not satisfied.
        TypeError: An amplitude is complex. The excitations are in phase; the response to
            excitations that are not is a sum of responses with complex factors.
        RuntimeError: A frequency is a resonance without damping, or a value is not
            finite.

    Example:
        >>> import jax.numpy as jnp
        >>> from twistorjax import Body, Hinge, Load, Mechanism, Quadratic
        >>> from twistorjax import frequency_response
        >>> spring = Quadratic(jnp.diag(jnp.array([1.0, 400.0, 100.0])))
        >>> hinge = Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
        >>> block = Body("block", mass=1.0, inertia=0.1)
        >>> mechanism = Mechanism([Body("wall"), block], [hinge], fixed=["wall"])
        >>> push = Load("block", force=(1.0, 0.0))
        >>> response = frequency_response(mechanism, [0.0], loads=[push])
        >>> abs(response.displacement("block")[0, 1])  # 1 N over 400 N/m
        Array(0.0025, dtype=float64)
    """
    requirement = (
        "be a list or a one-dimensional array, such as [100.0] or "
        "jnp.linspace(0, 100, 11)"
    )
    values = require_array("`frequencies`", frequencies, (None,), requirement)
    held, prescribed = prescribed_dofs(mechanism, drives)
    problem = Problem.of(
        mechanism, static_loads, (), constraints, time, held=held, supported=False
    )
    rows = stroke_rows(mechanism.hinge_names, strokes) if strokes else None
    excitation = Excitation(LoadSet.of(mechanism, loads), prescribed, rows)
    state = problem.state(about, "static_loads")
    response = _frequency_response(mechanism, problem.system, values, excitation, state)
    not_finite = (
        "At some frequency the response is not finite: there is a resonance without "
        "damping, or a value of the mechanism is not finite. Give the hinges `damping`, "
        "or leave out the frequency."
    )
    return problem.finish(response, throw, state, {"not_finite": not_finite})


class Excitation(NamedTuple):
    """Loads, prescribed displacements, and strokes that excite small motions."""

    loads: LoadSet  # Loads; N m, N
    # Displacement of each prescribed degree of freedom; rad, m
    prescribed: tuple[Any, ...]
    # Strokes of all hinges; None if there are none; rad, m, m
    strokes: Float[Array, "hinges 3"] | None

    def at(
        self, system: System, jacobian: Float[Array, "entries dofs"], displacements: Poses
    ) -> tuple[Float[Array, " dofs"], Float[Array, " dofs"], Float[Array, " dofs"]]:
        """Compute the forces, those by the rate, and the displacements that it imposes.

        Constraints transmit prescribed displacements to free degrees of freedom; N m, N,
        N m s, N s, rad, m.
        """
        applied, _ = self.loads.apply(displacements)
        force = applied.reshape(-1)
        viscous = jnp.zeros_like(force)
        if self.strokes is not None:
            elastic, by_rate = stroke_forces(system.hinges, displacements, self.strokes)
            force, viscous = force - elastic.reshape(-1), -by_rate.reshape(-1)
        dofs, free = system.dofs, system.free
        imposed = jnp.array(self.prescribed, float)
        moved = dofs.expand(jnp.zeros(len(free)), imposed).reshape(-1)
        if system.constraints.size:
            allowed = system.allowed_displacements(jacobian[:, free])
            moved = moved.at[free].set(-allowed.imposed(jacobian @ moved))
        return force, viscous, moved


@fast_compile
def _frequency_response(
    mechanism: Mechanism,
    system: System,
    frequencies: Array,
    excitation: Excitation,
    displacements: Poses,
) -> FrequencyResponse:
    """Solve the harmonic equations; see `frequency_response`."""
    dofs, free = system.dofs, system.free
    all_dofs = tuple(range(dofs.total))
    no_velocities = jnp.zeros_like(displacements)
    tangent = system.hinges.tangent_in_motion(displacements, no_velocities, all_dofs)
    damping = tangent.damping
    stiffness, jacobian = system.whole_stiffness(displacements)
    inertia = mechanism.inertia().reshape(-1)
    inertia = jnp.where(jnp.isinf(inertia), 0.0, inertia)
    force, viscous, moved = excitation.at(system, jacobian, displacements)
    allowed = system.allowed_displacements(jacobian[:, free])
    jacobian, allowed, moved = jax.tree.map(
        lambda array: array.astype(complex), (jacobian, allowed, moved)
    )
    layout, square, blocks = system.layout, (free[:, None], free), []
    if layout is not None:
        elastic, by_rate = (
            layout.of_dense(part[square]) for part in (stiffness, damping)
        )
        blocks = [elastic, layout.of_diagonal(inertia[free]), by_rate]

    def unbalanced(
        omega: Scalar, amplitude: Complex[Array, " dofs"]
    ) -> Complex[Array, " dofs"]:
        """Compute the forces that an amplitude needs in addition to the excitation."""
        parts = jnp.stack([amplitude.real, amplitude.imag], axis=1)
        elastic = stiffness @ parts - omega**2 * inertia[:, None] * parts
        by_rate = omega * (damping @ parts)
        real, imaginary = elastic[:, 0] - by_rate[:, 1], elastic[:, 1] + by_rate[:, 0]
        return jax.lax.complex(real - force, imaginary - omega * viscous)

    def amplitude_at(omega: Scalar, right: Complex[Array, " free"]) -> Array:
        # Rows and columns are scaled by their sizes, so that units do not matter.
        size = (
            jnp.diagonal(stiffness) + omega**2 * inertia + omega * jnp.diagonal(damping)
        )[free]
        size = jnp.abs(size)
        if allowed.basis is not None:
            size = jnp.sum(jnp.abs(allowed.basis) ** 2 * size[:, None], axis=0)
        size = jnp.sqrt(size)
        units = 1 / jnp.where(size > 0, size, 1.0)
        if layout is None:
            matrix = jax.lax.complex(
                stiffness - omega**2 * jnp.diag(inertia), omega * damping
            )
            change = _solve(allowed.reduced(matrix[square]), units, right)
        else:
            elastic, inertial, by_rate = blocks
            matrix = jax.lax.complex(elastic - omega**2 * inertial, omega * by_rate)
            change = _solve_in_blocks(matrix, layout, units, right)
        return moved.at[free].add(allowed.expanded(change))

    def forces_at(omega: Scalar, amplitude: Array) -> tuple[Array, Array]:
        """Compute reactions and constraint forces."""
        forces, multipliers = unbalanced(omega, amplitude), jnp.zeros(0, complex)
        if system.constraints.size:
            multipliers = allowed.multipliers(forces[free])
            forces = forces - multipliers @ jacobian
        return dofs.reactions(forces), multipliers

    omegas = 2 * jnp.pi * frequencies
    forces = jax.vmap(lambda omega: -unbalanced(omega, moved)[free])(omegas)
    rights = jax.vmap(allowed.projected)(forces)
    if layout is None:
        amplitudes = jax.vmap(amplitude_at)(omegas, rights)
    else:  # The matrices at all frequencies would take too much memory.
        each = omegas, rights
        amplitudes = jax.lax.map(lambda arguments: amplitude_at(*arguments), each)
    reactions, multipliers = jax.vmap(forces_at)(omegas, amplitudes)
    amplitudes = amplitudes.reshape(-1, *displacements.shape)
    is_finite = jnp.all(jnp.isfinite(amplitudes))
    result = RESULTS.where(is_finite, RESULTS.successful, RESULTS.not_finite)
    is_consistent = consistent(system, displacements)
    result = RESULTS.where(is_consistent, result, RESULTS.inconsistent_constraints)
    return FrequencyResponse(
        frequencies=frequencies,
        displacements=amplitudes,
        reactions=reactions,
        constraint_forces=multipliers,
        result=result,
        names=mechanism.names,
        constraint_names=system.constraints.names(),
    )


def _solve(
    matrix: Complex[Array, "n n"], units: Float[Array, " n"], right: Complex[Array, " n"]
) -> Complex[Array, " n"]:
    """Solve a linear system in units; NaN if the matrix is nearly singular."""
    factors = units.astype(complex)
    scaled = factors[:, None] * matrix * factors[None]
    inverse = jnp.linalg.inv(scaled)
    condition = jnp.linalg.norm(scaled) * jnp.linalg.norm(inverse)
    solution = factors * (inverse @ (factors * right))
    return jnp.where(condition < _LARGEST_CONDITION, solution, jnp.nan)


def _solve_in_blocks(
    matrix: Complex[Array, "3 blocks size size"],
    layout: Layout,
    units: Float[Array, " free"],
    right: Complex[Array, " free"],
) -> Complex[Array, " free"]:
    """Solve a linear system in units; NaN if the matrix is nearly singular."""
    factors = units.astype(complex)
    solution, condition = solve_in_blocks(
        layout.scaled(matrix, units), layout, factors * right
    )
    return jnp.where(condition < _LARGEST_CONDITION, factors * solution, jnp.nan)
