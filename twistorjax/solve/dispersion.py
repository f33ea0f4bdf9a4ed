"""Waves in an infinite lattice, by the theorem of Bloch."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from .._compile.compilation import fast_compile
from .._utils.progress import announced
from .._utils.types import Point, Poses, WaveVectorsLike
from .._utils.validation import index_of, require_array, require_instance
from ..lattices.periodicity import Periodicity
from ..lattices.unit_cell import UnitCell
from ..linalg.eigenvalues import hermitian_modes
from ..mechanism.mechanism import COORDINATES, Mechanism
from ..results.codes import RESULTS, Solution
from ..results.tables import Column, Columns, columns, Tabular
from .equations.consistency import consistent
from .equations.problem import mode_count, Problem
from .equations.system import System
from .statics.solution import StateLike


# The square of a frequency may be a rounding error below this fraction of the largest.
_ROUNDING = 1e-12


class Dispersion(Solution, Tabular):
    """Frequencies and shapes of the waves in an infinite lattice.

    In the cell at the position R, the displacement of a body is the real part of its
    shape times `exp(i (k . R - 2 pi f t))`, for the wave vector k and the frequency f.

    Args:
        wave_vectors: Wave vectors; rad/m.
        frequencies: Frequencies for each wave vector, in ascending order; Hz. NaN if the
            lattice is not stable with respect to a wave.
        shapes: Mass-normalized shapes of the bodies of the cell; rad/(kg^0.5 m),
            1/kg^0.5, 1/kg^0.5.
        result: `RESULTS.successful` or the reason of the failure; `result_names` returns
            its name.
        names: Names of the bodies of the cell.
    """

    wave_vectors: Float[Array, "waves 2"]
    frequencies: Float[Array, "waves modes"]
    shapes: Complex[Array, "waves modes bodies 3"]
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)
    _plural: ClassVar[str] = "dispersions"

    def columns(self) -> Columns:
        axes = ("wave", "mode", "body")
        entries = ("shape_angle", ""), ("shape_x", ""), ("shape_y", "")
        directions = ("wave_x", "rad/m"), ("wave_y", "rad/m")
        return {
            **columns(self.wave_vectors, ("wave",), *directions),
            "frequency": Column(self.frequencies, ("wave", "mode"), "Hz"),
            **columns(self.shapes, axes, *entries, body=self.names),
        }

    def _summary(self, names: np.ndarray) -> str:
        waves, modes = self.frequencies.shape
        lines = [f"{names}: {modes} waves for each of {waves} wave vectors"]
        for mode, band in enumerate(np.asarray(self.frequencies).T[:20], 1):
            lines.append(f"band {mode}: {band.min():.6g} to {band.max():.6g} Hz")
        return "\n".join(lines)


@announced("dispersion")
def dispersion(
    cell: UnitCell,
    wave_vectors: WaveVectorsLike,
    *,
    modes: int | None = None,
    fixed: Sequence[str] | Mapping[str, Sequence[str]] = (),
    about: StateLike | None = None,
    throw: bool = True,
) -> Dispersion:
    """Compute the frequencies of waves in an infinite lattice of equal cells.

    Damping is neglected. The result is differentiable, also by the wave vectors: the
    derivative of a frequency is the group velocity divided by 2 pi. Where frequencies are
    equal, only symmetric functions of them have derivatives, and where one is zero, it
    has none.

    Args:
        cell: The cell. Bodies that can move need mass and inertia, and the origin of
            their frame at the center of mass.
        wave_vectors: Wave vectors, as those of `UnitCell.wave_vectors`; rad/m.
        modes: Number of waves for each wave vector, from the lowest frequency; by default
            all.
        fixed: Bodies of the cell, or their coordinates, that cannot move; see
            `Mechanism`.
        about: Periodic equilibrium about which the lattice vibrates, computed with
            `UnitCell.mechanism` and `UnitCell.periodicity`, or its poses; by default the
            reference configuration; rad, m, m.
        throw: Whether a failure raises an error; otherwise it is reported by `result`.

    Returns:
        The frequencies (Hz) and shapes for each wave vector.

    Raises:
        ValueError: Double precision is disabled, a name is unknown, a body that moves has
            no mass, `modes` is invalid, no coordinate is free, or the state is not a
            periodic equilibrium.
        RuntimeError: The lattice is not stable with respect to a wave, or a value is not
            finite.

    Source:
        Theorem of Bloch: Hussein, Leamy and Ruzzene, Dynamics of phononic materials and
        structures, Applied Mechanics Reviews 66, 2014.

    Example:
        >>> import twistorjax as tj
        >>> spring = tj.Quadratic(np.diag([1.0, 100.0, 100.0]))
        >>> hinge = tj.Hinge("spring", "mass", "mass[1]", spring, at=(0, 0.05, 0))
        >>> mass = tj.Body("mass", mass=1.0, inertia=1e-3)
        >>> cell = tj.lattices.UnitCell([mass], [hinge], [(0.1, 0.0)])
        >>> edge = np.array([[np.pi / 0.1, 0.0]])
        >>> 2 * np.pi * dispersion(cell, edge, modes=1).frequencies  # 2 (k / m)^0.5
        Array([[20.]], dtype=float64)
    """
    require_instance("cell", cell, UnitCell)
    requirement = "be wave vectors (x, y), such as those of `UnitCell.wave_vectors`"
    waves = require_array("`wave_vectors`", wave_vectors, (None, 2), requirement)
    if not len(waves):
        raise ValueError(f"`wave_vectors` is empty, but must {requirement}; rad/m.")
    for name in fixed:
        index_of("`fixed`", "body", name, [body.name for body in cell.bodies])
    one = cell.mechanism(fixed)
    constraints = _periodicity(cell, one, about)
    problem = Problem.of(one, (), (), constraints, supported=False)
    bodies = len(cell.bodies)
    free = tuple(dof for dof in problem.dofs.free if dof < 3 * bodies)
    if not free:
        raise ValueError(
            "No coordinate can vibrate, because all are fixed. Leave one of them free."
        )
    count = mode_count(modes, len(free))
    # The inertia of an image is that of its body.
    images = dict.fromkeys(one.names[bodies:], COORDINATES)
    given = fixed if isinstance(fixed, Mapping) else dict.fromkeys(fixed, COORDINATES)
    inertia = cell.mechanism({**given, **images}).inertia()[:bodies]
    state = problem.state(about)
    solution = _dispersion(
        cell,
        problem.system,
        inertia.reshape(-1)[np.array(free)],
        waves,
        state,
        free,
        count,
    )
    message = (
        "The lattice is not stable with respect to waves of some wave vectors. With "
        "`throw=False`, their frequencies are NaN."
    )
    return problem.finish(solution, throw, state, {"unstable": message})


@fast_compile
def _dispersion(
    cell: UnitCell,
    system: System,
    inertia: Float[Array, " free"],
    wave_vectors: Float[Array, "waves 2"],
    displacements: Poses,
    free: tuple[int, ...],
    count: int,
) -> Dispersion:
    """Solve the eigenvalue problems of `dispersion`."""
    stiffness, _ = system.whole_stiffness(displacements)
    bodies, images = len(cell.bodies), cell.images()
    order = [body.name for body in cell.bodies]
    sources = [order.index(body.name) for body, _ in images.values()]
    offsets = np.array([offset for _, offset in images.values()], float)
    distances = offsets.reshape(len(images), cell.directions) @ cell.vectors
    units = 1 / jnp.sqrt(inertia)

    def of_wave(wave_vector: Array) -> tuple[Array, Array]:
        """Compute the squares of the angular frequencies, and the vectors."""
        angles = distances @ wave_vector
        phases = jax.lax.complex(jnp.cos(angles), jnp.sin(angles))
        # The displacements of all bodies follow from those of the cell.
        own = jnp.eye(bodies, dtype=complex)
        follow = jnp.concatenate([own, phases[:, None] * own[np.array(sources, int)]])
        follow = jnp.kron(follow, jnp.eye(3, dtype=complex))[:, np.array(free)]
        follow = follow * units.astype(complex)[None]
        matrix = follow.conj().T @ stiffness.astype(complex) @ follow
        squares, vectors = hermitian_modes((matrix + matrix.conj().T) / 2)
        return squares, units.astype(complex)[:, None] * vectors

    squares, vectors = jax.vmap(of_wave)(wave_vectors)
    smallest = -_ROUNDING * jnp.max(jnp.abs(squares), axis=1, keepdims=True)
    stable = squares >= smallest
    finite = jnp.all(jnp.isfinite(squares))
    frequencies = jnp.sqrt(jnp.where(stable, jnp.maximum(squares, 0.0), jnp.nan))
    shapes = jnp.zeros((*squares.shape, 3 * bodies), complex)
    shapes = shapes.at[:, :, np.array(free)].set(jnp.swapaxes(vectors, 1, 2))
    result = RESULTS.where(jnp.all(stable), RESULTS.successful, RESULTS.unstable)
    result = RESULTS.where(finite, result, RESULTS.not_finite)
    is_consistent = consistent(system, displacements)
    result = RESULTS.where(is_consistent, result, RESULTS.inconsistent_constraints)
    return Dispersion(
        wave_vectors=wave_vectors,
        frequencies=frequencies[:, :count] / (2 * jnp.pi),
        shapes=shapes.reshape(*squares.shape, bodies, 3)[:, :count],
        result=result,
        names=tuple(order),
    )


def _periodicity(
    cell: UnitCell, one: Mechanism, about: StateLike | None
) -> tuple[Periodicity, ...]:
    """Return the constraints of a state, whose mean deformation is that of the state."""
    if about is None:
        return cell.periodicity()
    displacements = one.displacements(about, "about", single=True)
    translations: dict[tuple[int, ...], Point] = {}
    constraints = []
    for name, (body, offset) in cell.images().items():
        own, image = (displacements[one.index(row)] for row in (body.name, name))
        translation = translations.setdefault(offset, (image - own)[1:])
        constraints.append(Periodicity(name, (body.name, name), translation))
    return tuple(constraints)
