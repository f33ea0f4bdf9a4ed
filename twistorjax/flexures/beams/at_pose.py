"""Energy of an exact beam as a function of its displacement: accurate, but slow."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._utils.pytrees import value_and_jacfwd
from ..._utils.types import Count, Pose, PoseLike, Scalar, Wrench
from ..._utils.validation import require_pose
from ...energies.base import AbstractEnergy
from ...geometry import se2
from ...geometry.twistors import Displacement
from .beam import Beam, is_uniform, load_units, pose_units
from .stress_models import BeamStress
from .under_load import (
    BeamSolution,
    end_section,
    pose_and_wrench,
    reference_ends,
    ReferenceEnds,
    state_under_load,
)


# Increments of the displacement, and as many for stiffening the auxiliary spring
_INCREMENTS = 8
_SPRING_COMPLIANCE = 0.05  # in lengths per E I / L^2


class ExactBeam(AbstractEnergy):
    """The energy of a geometrically exact beam, for any displacement.

    The load that belongs to a displacement is found by Newton's method. The displacement
    is approached in increments along a constant twist. If no load is found, the energy is
    NaN, as for a bent beam in tension above about 25 E I / L^2, for which `leaf` and
    `chain` are made. An evaluation takes some milliseconds. A mechanism with such a hinge
    takes about ten seconds to compile; `surrogate` makes a fast hinge of a beam.

    Args:
        beam: The beam.

    Example:
        >>> import twistorjax as tj
        >>> polymer = tj.Material(modulus=3.45e9, poisson=0.3)
        >>> beam = Beam(polymer, length=10e-3, thickness=1e-3, width=5e-3)
        >>> solution = tj.flexures.beam_under_load(beam, [0.1, 0.0, 0.0])
        >>> ExactBeam(beam).wrench(solution.pose)[0]  # the moment
        Array(0.1, dtype=float64)
    """

    beam: Beam
    stress_model: BeamStress

    def __init__(self, beam: Beam):
        self.beam = beam
        self.stress_model = BeamStress.of(beam)

    @property
    def is_unloaded(self) -> bool:
        return True

    def stored_energy(self, displacement: Displacement) -> Scalar:
        return _energy(self.beam, displacement.pose())

    def newton_model(self, stress: tuple[Scalar, Scalar, Scalar]) -> "AbstractEnergy":
        return _NewtonModel(self.beam, jnp.stack(stress))


class _NewtonModel(AbstractEnergy):
    """Replacement of an exact beam in Newton's method, near a predicted wrench.

    The wrench and the displacement are independent unknowns, and the residual of their
    relation is eliminated to first order, by the compliance of the beam under the
    predicted wrench. With the energy itself, a transverse Newton step would stretch the
    beam, whose large axial force would slow down Newton's method.
    """

    beam: Beam
    # Predicted moment, axial force, and transverse force; N m, N, N
    stress: Float[Array, "3"]

    def stored_energy(self, displacement: Displacement) -> Scalar:
        at = displacement
        coordinates = jnp.stack([at.angle, 2 * at.x1, 2 * at.x2])
        return _model_energy(self.beam, self.stress, coordinates)


# Derivatives with respect to the beam and the predicted wrench are not implemented:
# Newton's method calls these functions on a system without derivatives.
@jax.custom_jvp
def _model_energy(
    beam: Beam, stress: Float[Array, "3"], coordinates: Float[Array, "3"]
) -> Scalar:
    """Compute half the work of the wrench in the model; J.

    The coordinates are an angle and a translation in the mid-frame; rad, m, m.
    """
    return jnp.dot(_model_gradient(beam, stress, coordinates), coordinates) / 2


@_model_energy.defjvp
def _(primals, tangents):
    rate = jnp.dot(_model_gradient(*primals), tangents[2])
    return _model_energy(*primals), rate


@jax.custom_jvp
def _model_gradient(
    beam: Beam, stress: Float[Array, "3"], coordinates: Float[Array, "3"]
) -> Float[Array, "3"]:
    """Correct the predicted wrench to first order in the residual (N m, N, N)."""
    return _corrected_stress(beam, stress, coordinates)[0]


@_model_gradient.defjvp
def _(primals, tangents):
    corrected, stiffness = _corrected_stress(*primals)
    return corrected, stiffness @ tangents[2]


def _corrected_stress(
    beam: Beam, stress: Float[Array, "3"], coordinates: Float[Array, "3"]
) -> tuple[Float[Array, "3"], Float[Array, "3 3"]]:
    """Take one Newton step for the wrench and the stiffness at given coordinates.

    The wrench is in the mid-frame (N m, N, N), the coordinates are in rad, m, m. The
    relation between them is linearized at a deformed state whose wrench is close to the
    predicted one. There its derivative is symmetric, which keeps the much smaller
    stiffness in bending accurate.
    """
    forces, lengths = load_units(beam), pose_units(beam)
    target = coordinates / lengths
    ends = reference_ends(beam)

    def state(load: Array) -> Array:
        return _in_mid_frame(load, _reached(beam, ends, load))

    values, rates = value_and_jacfwd(state, _load_of(stress / forces, target))
    wrench, position = jnp.split(values, 2)
    wrench_rates, position_rates = jnp.split(rates, 2)
    stiffness = jnp.linalg.solve(position_rates.T, wrench_rates.T)
    stiffness = (stiffness + stiffness.T) / 2
    corrected = wrench + stiffness @ (target - position)
    # In the reference configuration, rounding errors would load the mechanism.
    undeformed = jnp.all(stress == 0) & jnp.all(target == 0)
    corrected = jnp.where(undeformed, 0.0, corrected)
    return forces * corrected, forces[:, None] * stiffness / lengths[None]


def _load_of(stress: Float[Array, "3"], coordinates: Float[Array, "3"]) -> Array:
    """Move a dimensionless wrench from the mid-frame to frame a."""
    force = se2.rotate(coordinates[0] / 2, stress[1:])
    arm = se2.rotate(coordinates[0] / 2, coordinates[1:]) / 2
    return jnp.concatenate([(stress[0] + se2.cross(arm, force))[None], force])


def _in_mid_frame(load: Float[Array, "3"], pose: Float[Array, "3"]) -> Array:
    """Return the wrench in the mid-frame and its coordinates, all dimensionless."""
    force, arm = (se2.rotate(-pose[0] / 2, part[1:]) for part in (load, pose))
    moment = load[0] - se2.cross(arm, force) / 2
    return jnp.concatenate([moment[None], force, pose[:1], arm])


def beam_at_pose(beam: Beam, pose: PoseLike, sections: int | None = None) -> BeamSolution:
    """Compute the deformed state of a beam at a given displacement of its ends.

    Args:
        beam: The beam.
        pose: Pose of frame b relative to frame a, for example the displacement of a hinge
            as `Mechanism.displacement_of` returns it; rad, m, m.
        sections: Number of cross-sections of the result; see `beam_under_load`.

    Returns:
        The deformed state. It is NaN if no load is found for this displacement; see
        `ExactBeam`.

    Raises:
        ValueError: The pose is not finite, or there are fewer than two sections.

    Example:
        >>> import twistorjax as tj
        >>> polymer = tj.Material(modulus=3.45e9, poisson=0.3)
        >>> beam = Beam(polymer, length=10e-3, thickness=1e-3, width=5e-3)
        >>> solution = beam_at_pose(beam, [0.1, 0.0, 0.0])
        >>> tj.flexures.largest_stress(solution) / 1e6  # MPa
        Array(20.79..., dtype=float64)
    """
    pose = require_pose("`pose` of the beam", pose)
    return state_under_load(beam, _load_at_pose(beam, pose), sections)


@eqx.filter_jit
def _load_at_pose(beam: Beam, pose: Pose) -> Wrench:
    """Find the load that displaces a beam to a pose (rad, m, m); N m, N, N."""
    return _load(beam, pose) * load_units(beam)


@eqx.filter_custom_jvp
def _energy(beam: Beam, pose: Pose) -> Scalar:
    """Compute the energy of a beam at a pose (rad, m, m); J."""
    return _integrated_energy(beam, pose)


def _integrated_energy(beam: Beam, pose: Pose) -> Scalar:
    """Compute the energy of a beam at a pose (rad, m, m) from its load; J."""
    end = end_section(beam, _load(beam, pose), reference_ends(beam))
    return load_units(beam)[0] * end.energy


@_energy.def_jvp
def _energy_jvp(primals, tangents):
    # The derivative with respect to the pose is the wrench, which is known. Only the
    # derivative with respect to the beam needs that of the integration.
    beam, pose = primals
    beam_tangent, pose_tangent = tangents
    load = _load(beam, pose)
    wrench = load * load_units(beam)
    moment = wrench[0] - se2.cross(pose[1:], wrench[1:])
    velocity = jnp.zeros(3) if pose_tangent is None else pose_tangent
    power = moment * velocity[0] + jnp.dot(wrench[1:], velocity[1:])

    if not jax.tree.leaves(beam_tangent):  # The beam is constant; compile less.
        return _integrated_energy(beam, pose), power
    energy, rate = eqx.filter_jvp(
        lambda beam: _integrated_energy(beam, pose), (beam,), (beam_tangent,)
    )
    return energy, power if rate is None else power + rate


@eqx.filter_custom_jvp
def _load(beam: Beam, pose: Pose) -> Float[Array, "3"]:
    """Find the load that displaces a beam to a pose, by Newton's method.

    The pose is approached in increments along the constant twist. Bending draws the ends
    of a beam together, so the axial force of a thin beam would be much too large on this
    way. An auxiliary axial spring in series with the beam prevents this. It is then
    stiffened in steps, and removed. With the spring, a beam of uniform thickness is
    integrated in a quarter of its steps, because only the last load must be accurate.
    The load is about the origin of frame a and in its axes, over `load_units`. It is NaN
    if no load is found.
    """
    units = pose_units(beam)
    twist = se2.twist(pose)
    ends = reference_ends(beam)
    first_steps = -(-beam.steps // 4) if is_uniform(beam) else beam.steps

    def newton_step(k: Array, load: Array) -> Array:
        fraction = jnp.minimum(k // 2 + 1, _INCREMENTS) / _INCREMENTS
        stiffenings = jnp.maximum(k // 2 + 1 - _INCREMENTS, 0)
        compliance = jnp.where(
            stiffenings > _INCREMENTS, 0.0, _SPRING_COMPLIANCE * 0.2**stiffenings
        )
        half = fraction * pose[0] / 2
        axis = jnp.stack([jnp.zeros(()), jnp.cos(half), jnp.sin(half)])
        steps = jnp.where(compliance > 0, first_steps, beam.steps)
        reached, derivative = value_and_jacfwd(
            partial(_reached, beam, ends, steps=steps), load
        )
        spring = compliance * axis * (axis @ load)
        residual = se2.exp(twist * fraction) / units - reached - spring
        matrix = derivative + compliance * jnp.outer(axis, axis)
        return load + jnp.linalg.solve(matrix, residual)

    load = jax.lax.fori_loop(0, 4 * _INCREMENTS + 4, newton_step, jnp.zeros(3))
    residual = jnp.max(jnp.abs(_reached(beam, ends, load) - pose / units))
    # In the reference configuration, rounding errors would load the mechanism.
    load = jnp.where(jnp.all(pose == 0), 0.0, load)
    return jnp.where(residual < 1e-9, load, jnp.nan)


@_load.def_jvp
def _load_jvp(primals, tangents):
    # Implicit differentiation of reached(beam, load) = pose
    beam, pose = primals
    load = _load(beam, pose)
    derivative = jax.jacfwd(partial(_reached, beam, reference_ends(beam)))(load)

    def residual(beam: Beam, pose: Pose) -> Array:
        return pose / pose_units(beam) - _reached(beam, reference_ends(beam), load)

    _, rate = eqx.filter_jvp(residual, primals, tangents)
    if rate is None:
        return load, None
    return load, jnp.linalg.solve(derivative, rate)


def _reached(
    beam: Beam, ends: ReferenceEnds, load: Array, steps: Count | int | None = None
) -> Float[Array, "3"]:
    """Compute the dimensionless pose that a dimensionless load produces.

    The beam is integrated in `beam.steps` or another number of steps.
    """
    end = end_section(beam, load, ends, steps)
    pose, _ = pose_and_wrench(beam, load * load_units(beam), end, ends)
    return pose / pose_units(beam)
