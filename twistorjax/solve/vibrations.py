"""Small vibrations about an equilibrium: free ones, and those that are forced."""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Complex, Float

from .._utils.types import Poses, PosesLike
from .._utils.validation import require_float64
from ..mechanism.loads import Drive, driven as driven_by, Load, loaded_bodies, LoadSet
from ..mechanism.mechanism import Mechanism
from .eigenmodes import modes, Stiffness
from .results import (
    BodySolution,
    count_results,
    raise_failed,
    result_message,
    result_names,
    RESULTS,
)
from .static_system import DofPartition, Problem
from .statics import Equilibrium, free_coordinates, within_range
from .tables import Column, Columns, columns, Tabular


class Vibrations(Tabular):
    """The natural vibrations of a mechanism, the slowest first.

    Where the equilibrium is unstable its frequency is NaN.

    Args:
        frequencies: Hz.
        shapes: displacements of each body, of unit modal mass; rad, m, m, all of them by
            the root of kg m2.
        result: how it ended; `result_names` gives its name.
        names: of the bodies, for their rows.
    """

    frequencies: Float[Array, "*batch modes"]
    shapes: Float[Array, "*batch modes bodies 3"]
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)

    def columns(self) -> Columns:
        rows = ("mode", "body")
        moved = ("shape_angle", ""), ("shape_x", ""), ("shape_y", "")
        return {
            "frequency": Column(self.frequencies, ("mode",), "Hz"),
            **columns(self.shapes, rows, *moved, body=self.names),
        }

    @property
    def succeeded(self) -> Bool[Array, "*batch"]:
        """Whether the equilibrium is stable, so that it vibrates."""
        return self.result == RESULTS.successful

    def __repr__(self) -> str:
        ended = result_names(self.result)
        if ended is None:
            return eqx.tree_pformat(self)
        if ended.shape:
            return count_results("sets of vibrations", ended)
        lines = [f"{ended}: {self.frequencies.size} vibrations", "frequency (Hz)  moves"]
        for frequency, shape in zip(self.frequencies[:20], self.shapes, strict=False):
            travels = np.linalg.norm(np.asarray(shape)[:, 1:], axis=1)
            most = [body for body in np.argsort(-travels)[:3] if travels[body] > 0]
            moved = ", ".join(self.names[body] for body in most) or "turns alone"
            lines.append(f"{float(frequency):>14.6g}  {moved}")
        return "\n".join(lines)


def vibrations(
    mechanism: Mechanism,
    driven: Sequence[str] | Mapping[str, Sequence[str]] = (),
    *,
    about: PosesLike | Equilibrium | None = None,
    loads: Sequence[Load] = (),
    throw: bool = True,
) -> Vibrations:
    """The natural frequencies of a mechanism about an equilibrium, and their shapes.

    Damping is left aside; `frequency_response` has it. The answer has derivatives by
    everything that made the mechanism. Of equal frequencies only symmetric functions have
    first derivatives, and only the sum has second ones.

    Args:
        mechanism: its bodies that can move need mass and inertia.
        driven: which coordinates a drive holds: names of bodies, for all three, or a
            mapping from names to some of "angle", "x" and "y".
        about: poses of the equilibrium, by default rest; rad, m, m.
        loads: that hold the mechanism there; they add to its stiffness as they turn.
        throw: whether an unstable equilibrium is raised, or only told by `result`.

    Raises:
        ValueError: double precision is off; a name is unknown; a body that moves has no
            mass; a load follows its body, so that there is no potential; no coordinate is
            free.
        RuntimeError: the equilibrium is not stable.

    Source:
        The matrices of equation 5.24 of the dissertation, linearised.

    Example:
        >>> from twistorjax import Body, Hinge, Mechanism, Quadratic
        >>> spring = Quadratic(jnp.diag(jnp.array([1.0, 400.0, 100.0])))
        >>> hinge = Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
        >>> block = Body("block", mass=1.0, inertia=0.1)
        >>> mechanism = Mechanism([Body("wall"), block], [hinge], fixed=["wall"])
        >>> 2 * jnp.pi * vibrations(mechanism).frequencies
        Array([ 3.16227766, 10.        , 20.        ], dtype=float64)
    """
    require_float64(mechanism.reference)
    if any(load.follower for load in loads):
        raise ValueError(
            "`loads` has one that follows its body. It has no potential, so vibrations "
            "need not be: see how the mechanism answers with `frequency_response`, or "
            "let it move with `simulate`."
        )
    given = mechanism.coordinates("driven", driven)
    free = free_coordinates(len(mechanism.names), mechanism.fixed, given)
    if not free:
        raise ValueError(
            "No coordinate can vibrate: all bodies are held, or named in `driven`. Leave "
            "one free."
        )
    answer = _vibrations(mechanism, _state(mechanism, about), tuple(loads), free)
    return raise_failed(answer, _loose) if throw else answer


def _loose(item: str, batch_index: tuple[int, ...]) -> RuntimeError:
    del batch_index
    return RuntimeError(result_message(item))


@eqx.filter_jit
def _vibrations(
    mechanism: Mechanism, moved: Poses, loads: tuple[Load, ...], free: tuple[int, ...]
) -> Vibrations:
    rows = np.array(free, int)
    root = jnp.sqrt(mechanism.inertia().reshape(-1)[rows])
    lines, weights, reference = mechanism.hinge_assembly.factored(moved, free)
    _, by_angle = LoadSet.of(
        loads, loaded_bodies(mechanism, loads), mechanism.reference
    ).apply(moved)
    # loads that keep their direction have moments alone that depend on angles
    reference = reference - jnp.diag(by_angle.reshape(-1)[rows])
    reference = reference / (root[:, None] * root[None])
    angular, vectors = modes(Stiffness(lines / root[None], weights, reference))
    angular = jnp.diagonal(angular)
    finite = jnp.all(jnp.isfinite(angular))
    stable = angular[0] > -1e-7 * angular[-1]
    frequencies = jnp.maximum(angular, 0.0) / (2 * jnp.pi)
    frequencies = jnp.where((angular > 0) | stable, frequencies, jnp.nan)
    shapes = jnp.zeros((len(free), mechanism.reference.size))
    shapes = shapes.at[:, rows].set((vectors / root[:, None]).T)
    result = RESULTS.where(stable, RESULTS.successful, RESULTS.unstable)
    result = RESULTS.where(finite, result, RESULTS.not_finite)
    return Vibrations(
        frequencies=jnp.where(finite, frequencies, jnp.nan),
        shapes=jnp.where(finite, shapes, jnp.nan).reshape(-1, *mechanism.reference.shape),
        result=result,
        names=mechanism.names,
    )


class FrequencyResponse(BodySolution):
    """How a mechanism answers to what swings, at each frequency.

    Amplitudes are complex: what swings with `cos(2 pi f t)` is answered by the real part
    of the amplitude times `exp(2 pi i f t)`.

    Args:
        frequencies: Hz.
        displacements: amplitude of each body's, from the equilibrium; rad, m, m.
        reactions: amplitude of what held and driven coordinates receive; N m, N, N.
        result: how it ended; `result_names` gives its name.
        names: of the bodies, for their rows.
    """

    frequencies: Float[Array, " frequencies"]
    displacements: Complex[Array, "frequencies bodies 3"]
    reactions: Complex[Array, "frequencies bodies 3"]
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)

    def columns(self) -> Columns:
        told = self._by_body(self.displacements, "frequency")
        return {"frequency": Column(self.frequencies, ("frequency",), "Hz"), **told}


def frequency_response(
    mechanism: Mechanism,
    frequencies: Float[ArrayLike, " frequencies"] | Sequence[ArrayLike],
    *,
    loads: Sequence[Load] = (),
    drives: Sequence[Drive] = (),
    about: PosesLike | Equilibrium | None = None,
    static_loads: Sequence[Load] = (),
    throw: bool = True,
) -> FrequencyResponse:
    """The answer of a mechanism to small loads and drives that swing.

    Args:
        mechanism: its bodies that can move need mass and inertia; its hinges may be
            damped.
        frequencies: Hz.
        loads: amplitudes of loads.
        drives: amplitudes of driven coordinates.
        about: poses of the equilibrium about which it swings, by default rest; rad, m, m.
        static_loads: loads that hold the mechanism there; they add to its stiffness.
        throw: whether a failure is raised, or only told by `result`.

    Raises:
        ValueError: double precision is off; a name is unknown; a coordinate is driven
            twice, or driven and held; a body that moves has no mass.
        RuntimeError: a frequency is a resonance without damping, or a value not finite.

    Example:
        >>> from twistorjax import Body, Hinge, Mechanism, Quadratic
        >>> spring = Quadratic(jnp.diag(jnp.array([1.0, 400.0, 100.0])))
        >>> hinge = Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
        >>> block = Body("block", mass=1.0, inertia=0.1)
        >>> mechanism = Mechanism([Body("wall"), block], [hinge], fixed=["wall"])
        >>> push = Load("block", (0.0, 1.0, 0.0))
        >>> answer = frequency_response(mechanism, [0.0], loads=[push])
        >>> abs(answer.displacement("block")[0, 1])  # 1 N over 400 N/m
        Array(0.0025, dtype=float64)
    """
    require_float64(mechanism.reference)
    values = jnp.asarray(frequencies, float)
    if values.ndim != 1:
        raise ValueError(
            f"`frequencies` has shape {values.shape}, but must be a row of them: "
            "[100.0], or jnp.linspace(0, 100, 11)."
        )
    places, targets = driven_by(mechanism, drives)
    free = free_coordinates(len(mechanism.names), mechanism.fixed, places)
    loaded_bodies(mechanism, loads)
    answer = _response(
        mechanism,
        values,
        tuple(loads),
        targets,
        _state(mechanism, about),
        tuple(static_loads),
        DofPartition(free, places),
    )
    return raise_failed(answer, _resonant) if throw else answer


def _resonant(item: str, batch_index: tuple[int, ...]) -> RuntimeError:
    del item, batch_index
    return RuntimeError(
        "At some frequency the answer is not finite: a resonance without damping or a "
        "value of the mechanism that is not finite. Give the hinges `damping`, or leave "
        "the frequency out."
    )


@eqx.filter_jit
def _response(
    mechanism: Mechanism,
    frequencies: Array,
    loads: tuple[Load, ...],
    targets: tuple[Array, ...],
    moved: Poses,
    static_loads: tuple[Load, ...],
    places: DofPartition,
) -> FrequencyResponse:
    every = tuple(range(mechanism.reference.size))
    still = jnp.zeros_like(mechanism.reference)
    damping = mechanism.hinge_assembly.tangent_in_motion(moved, still, every).damping
    stiffness = _stiffness(mechanism, moved, static_loads)
    inertia = mechanism.inertia().reshape(-1)
    inertia = jnp.where(jnp.isinf(inertia), 0.0, inertia)
    bodies = loaded_bodies(mechanism, loads)
    applied, _ = LoadSet.of(loads, bodies, mechanism.reference).apply(moved)
    force = applied.reshape(-1)
    free, given = (np.array(chosen, int) for chosen in places)
    mask = np.ones(force.size, complex)
    mask[free] = 0.0
    fixed = jnp.asarray(mask)

    def at(frequency: Array) -> tuple[Array, Array]:
        omega = 2 * jnp.pi * frequency
        real = stiffness - omega**2 * jnp.diag(inertia)
        matrix = jax.lax.complex(real, omega * damping)
        swing = jnp.zeros(force.size, matrix.dtype)
        swing = swing.at[given].set(jnp.array(targets, float).astype(matrix.dtype))
        right = (force.astype(matrix.dtype) - matrix @ swing)[free]
        # each row and column by its own size, so that units do not matter
        size = (
            jnp.diagonal(stiffness) + omega**2 * inertia + omega * jnp.diagonal(damping)
        )
        size = jnp.sqrt(jnp.abs(size[free]))
        size = jnp.where(size > 0, size, 1.0).astype(matrix.dtype)
        scaled = matrix[free[:, None], free] / (size[:, None] * size[None])
        back = jnp.linalg.inv(scaled)
        worst = jnp.linalg.norm(scaled) * jnp.linalg.norm(back)
        solved = back @ (right / size) / size
        swing = swing.at[free].set(jnp.where(worst < 1e13, solved, jnp.nan))
        return swing.reshape(still.shape), (
            fixed * (matrix @ swing - force.astype(matrix.dtype))
        ).reshape(still.shape)

    displacements, reactions = jax.vmap(at)(frequencies)
    finite = jnp.all(jnp.isfinite(displacements))
    return FrequencyResponse(
        frequencies=frequencies,
        displacements=displacements,
        reactions=reactions,
        result=RESULTS.where(finite, RESULTS.successful, RESULTS.not_finite),
        names=mechanism.names,
    )


def _stiffness(
    mechanism: Mechanism, moved: Poses, loads: tuple[Load, ...]
) -> Float[Array, "coordinates coordinates"]:
    every = DofPartition(tuple(range(mechanism.reference.size)), ())
    acting = LoadSet.of(loads, loaded_bodies(mechanism, loads), mechanism.reference)
    problem = Problem(mechanism.hinge_assembly, acting, jnp.zeros(0), every)
    return problem.matrix(moved)[1]


def _state(mechanism: Mechanism, about: PosesLike | Equilibrium | None) -> Poses:
    if about is None:
        return jnp.zeros_like(mechanism.reference)
    return within_range(mechanism, "about", about)
