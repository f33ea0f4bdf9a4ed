"""Samples of a sub-mechanism, and the fit of a `OneFreedomEnergy` to them."""

from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..._compile.compilation import fast_compile
from ..._utils.host import concrete
from ..._utils.pytrees import stop_gradient
from ..._utils.types import Matrix, Pose, Scalar, Twist, Wrench
from ...assembly.stress import member_models, member_states
from ...energies.monomials import Powers, symmetric_terms
from ...energies.one_freedom import (
    Freedom,
    FREEDOM_VARIABLES,
    OneFreedomEnergy,
    STIFF,
)
from ...energies.strains import strain
from ...energies.stress_model import Strengths
from ...energies.validity import WithValidityRange
from ...geometry import se2
from ...geometry.twistors import Displacement
from ...mechanism.loads import Drive, Load
from ...mechanism.sub_mechanism import SubMechanism
from ...results.codes import RESULTS
from ...solve.equilibrium import equilibrium
from ..beams.stress_models import MechanismStress, terms_of_state
from ..condensed import Condensed, reference_stiffness
from .fit import fit_coefficients, least_squares, relative_errors
from .samples import low_discrepancy_points, SAMPLES


_FORCE_ORDER = 4  # largest sum of the powers of both forces
_STRESS_ORDER = 6  # largest power of the compliant coordinate in a `MechanismStress`
# Signs of the twist under a symmetry operation; see `monomials`
_SIGNS = {"mirror": (-1, 1, -1), "ends": (-1, 1, 1), "arch": (1, 1, -1)}


class MechanismSamples(NamedTuple):
    """Displacements of a sub-mechanism and their wrenches."""

    poses: Float[Array, "samples 3"]  # Poses of frame b relative to frame a; rad, m, m
    # Wrenches that act on body B, in frame b; N m, N, N
    wrenches: Float[Array, "samples 3"]
    # Whether an equilibrium was found, and all hinges are in their ranges
    succeeded: Bool[Array, " samples"]
    outside: Bool[Array, " samples"]  # Whether a hinge is outside its validity range
    stiffness: Matrix  # Stiffness in the reference configuration; N m/rad, N/rad, N/m
    length: Scalar  # Reference length; m
    force: Scalar  # Reference force; N
    # States of the flexures with a known stress; see `member_states`
    states: Float[Array, "samples members 6"]


@partial(fast_compile, jit=partial(jax.jit, static_argnames="freedom"))
def sample_mechanism(
    part: SubMechanism, size: Scalar, force: Scalar, *, freedom: Freedom
) -> MechanismSamples:
    """Compute a sub-mechanism at displacements and forces that are uniformly distributed.

    The compliant coordinate (rad or m) is prescribed up to `size`. For the freedom
    "rotation", the forces are in a circle of the radius `force` (N). For the freedom
    "transverse", the axial force is up to `force`, and the moment up to the force times
    the reference length. The samples for the fit are followed by those for the error
    estimate.
    """
    stiffness = reference_stiffness(part)
    length = jnp.sqrt(stiffness[0, 0] / stiffness[1, 1])

    def sample(point: Float[Array, "3"]) -> tuple[Pose, Wrench, Array, RESULTS]:
        moved = size * (2 * point[0] - 1)
        zero = jnp.zeros(())
        if freedom == "rotation":
            direction = 2 * np.pi * point[2]
            magnitude = force * jnp.sqrt(point[1])
            axes = jnp.stack([jnp.cos(direction), jnp.sin(direction)])
            drive = Drive(part.second, angle=moved)
            load = jnp.concatenate([zero[None], magnitude * axes])
        else:
            drive = Drive(part.second, y=moved)
            moment = force * length * (2 * point[2] - 1)
            load = jnp.stack([moment, force * (2 * point[1] - 1), zero])
        loads = [Load(part.second, load)]
        found = equilibrium(part.mechanism, drives=[drive], loads=loads, throw=False)
        pose = found.displacement(part.second)
        total = load + found.reaction(part.second)
        in_b = jnp.concatenate([total[:1], se2.rotate(-pose[0], total[1:])])
        states = member_states(part.mechanism.hinge_assembly, found.displacements)
        return pose, in_b, states, found.result

    for_fit = low_discrepancy_points(SAMPLES)
    for_error = low_discrepancy_points(SAMPLES // 2, start=0.5)
    points = jnp.asarray(np.concatenate([for_fit, for_error]))
    poses, wrenches, states, results = jax.vmap(sample)(points)
    return MechanismSamples(
        poses,
        wrenches,
        results == RESULTS.successful,
        results == RESULTS.out_of_range,
        stiffness,
        length,
        force,
        states,
    )


def mechanism_symmetries(part: SubMechanism, samples: MechanismSamples) -> list[str]:
    """List the symmetries that the energies of a few samples have; none if traced."""
    changes = concrete(_symmetry_errors(*stop_gradient((part, samples.poses[:4]))))
    if changes is None:
        return []
    return [name for name, change in zip(_SIGNS, changes, strict=True) if change < 1e-8]


def mechanism_powers(symmetries: list[str], order: int, freedom: Freedom) -> Powers:
    """List the powers of the terms of a sub-mechanism with some symmetries."""
    rows = [row for row in _all_powers(order) if sum(row) > 1]
    return symmetric_terms(rows, FREEDOM_VARIABLES[freedom], symmetries)


def _all_powers(order: int) -> Powers:
    """List the powers of the coordinate up to an order, and of both forces."""
    rows = product(range(order + 1), *2 * (range(_FORCE_ORDER + 1),))
    return tuple(row for row in rows if row[1] + row[2] <= _FORCE_ORDER)


@jax.jit
def _symmetry_errors(
    part: SubMechanism, poses: Float[Array, "samples 3"]
) -> Float[Array, " symmetries"]:
    """Compute the relative change of the energy under each symmetry operation."""
    energy = Condensed(part)
    twists = jax.vmap(se2.twist)(poses)
    signs = jnp.asarray([(1, 1, 1), *_SIGNS.values()], float)
    images = signs[:, None] * twists[None]

    def stored_energy(twist: Twist) -> Scalar:
        return energy.stored_energy(Displacement.from_pose(se2.exp(twist)))

    values = jax.vmap(jax.vmap(stored_energy))(images)
    return jnp.max(jnp.abs(values[1:] / values[:1] - 1), axis=1)


@partial(fast_compile, jit=partial(jax.jit, static_argnums=(0, 1)))
def fit_mechanism(
    powers: Powers, freedom: Freedom, size: Scalar, samples: MechanismSamples
) -> WithValidityRange:
    """Fit an energy, and estimate its error on the samples that are not fitted."""
    references = samples.length, samples.force
    for_fit = samples.poses[:SAMPLES], samples.wrenches[:SAMPLES]
    coefficients = fit_coefficients(
        powers, STIFF[freedom], references, samples.stiffness, for_fit
    )
    energy = OneFreedomEnergy(
        coefficients,
        powers,
        freedom=freedom,
        length=samples.length,
        force=samples.force,
    )
    error = relative_errors(energy, samples.poses[SAMPLES:], samples.wrenches[SAMPLES:])
    if freedom == "rotation":
        return WithValidityRange(energy, size, samples.force, error)
    largest = jnp.max(jnp.abs(jax.lax.stop_gradient(samples.poses[:, 0])))
    return WithValidityRange(energy, largest, samples.force, error, displacement=size)


def mechanism_stress(
    part: SubMechanism, freedom: Freedom, samples: MechanismSamples
) -> MechanismStress | None:
    """Create the stress model of a surrogate; None if no stress in it is known."""
    models = member_models(part.mechanism.hinge_assembly)
    if not models:
        return None
    powers = tuple(row for row in _all_powers(_STRESS_ORDER) if any(row))
    strengths = [model.strengths for model in models]
    return MechanismStress(
        parts=models,
        coefficients=_fit_states(powers, freedom, samples),
        length=samples.length,
        force=samples.force,
        strengths=Strengths(
            static=_smallest([each.static for each in strengths]),
            ultimate=_smallest([each.ultimate for each in strengths]),
            endurance=_smallest([each.endurance for each in strengths]),
        ),
        powers=powers,
        freedom=freedom,
    )


def _smallest(strengths: Sequence[Scalar | None]) -> Scalar | None:
    """Return the smallest strength that is known; Pa."""
    known = [strength for strength in strengths if strength is not None]
    return jnp.min(jnp.stack(known)) if known else None


@partial(fast_compile, jit=partial(jax.jit, static_argnums=(0, 1)))
def _fit_states(
    powers: Powers, freedom: Freedom, samples: MechanismSamples
) -> Float[Array, "members 6 terms"]:
    """Fit the polynomials of a `MechanismStress` to the states of the flexures."""

    def terms(pose: Pose, wrench: Wrench) -> Float[Array, " terms"]:
        at = Displacement.from_pose(pose)
        force = se2.rotate(pose[0] / 2, wrench[1:])
        moment = wrench[0] + at.x1 * force[1] - at.x2 * force[0]
        units = samples.length, samples.force
        twist = strain(at, "twist")
        return terms_of_state(powers, freedom, units, twist, (moment, force[0], force[1]))

    rows = jax.vmap(terms)(samples.poses[:SAMPLES], samples.wrenches[:SAMPLES])
    states = samples.states[:SAMPLES]
    columns = states.reshape(SAMPLES, -1).T
    found = jax.vmap(lambda column: least_squares(rows, column))(columns)
    return found.reshape(*states.shape[1:], len(powers))
