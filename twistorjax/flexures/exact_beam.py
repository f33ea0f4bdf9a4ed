"""A beam's own energy: exact, and slow."""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._utils.types import Pose, Scalar
from ..energies.base import AbstractEnergy
from ..geometry import se2
from ..geometry.twistors import Displacement
from .beam import Beam, beam_under_load, BeamSolution, end_of, last_section, units_of


class ExactBeam(AbstractEnergy):
    """The energy of a beam itself: exact at any displacement, and slow.

    The load that brings it to a displacement is found by Newton's method, from rest along
    the twist that leads there; where none is found, the energy is NaN. It takes some
    milliseconds a displacement, and as a hinge of a mechanism a minute to compile.

    Args:
        beam: with its frames at the middle, axis 1 along it.

    Example:
        >>> from twistorjax import Material
        >>> from twistorjax.flexures import beam_under_load
        >>> soft = Material(modulus=3.45e9, poisson=0.3)
        >>> leaf = Beam(soft, length=10e-3, thickness=1e-3, width=5e-3)
        >>> bent = beam_under_load(leaf, jnp.array([0.1, 0.0, 0.0]))
        >>> ExactBeam(leaf).wrench(bent.pose)[0]
        Array(0.1, dtype=float64)
    """

    beam: Beam

    def stored_energy(self, displacement: Displacement) -> Scalar:
        cos, sin = displacement.sigma, displacement.xi
        half, across = displacement.x1, displacement.x2
        place = jnp.stack([cos * half - sin * across, sin * half + cos * across])
        pose = jnp.concatenate([displacement.angle[None], 2 * place])
        return _stored(self.beam, pose)


def beam_at_pose(beam: Beam, pose: Pose, places: int = 21) -> BeamSolution:
    """A beam bent to a pose: what it bears there, its line and its stress.

    Args:
        beam: with its frames at the middle, axis 1 along it.
        pose: of frame b, seen from frame a, as `Mechanism.displacement_of` tells it of a
            hinge; rad, m, m.
        places: how many sections are told, the ends among them.

    Returns:
        NaN where no load is found that bends it there; see `ExactBeam`.

    Example:
        >>> from twistorjax import Material
        >>> soft = Material(modulus=3.45e9, poisson=0.3)
        >>> leaf = Beam(soft, length=10e-3, thickness=1e-3, width=5e-3)
        >>> beam_at_pose(leaf, jnp.array([0.1, 0.0, 0.0])).stress.max() / 1e6  # MPa
        Array(15.15..., dtype=float64)
    """
    return beam_under_load(beam, _load(beam, pose) * units_of(beam), places)


@jax.custom_jvp
def _stored(beam: Beam, pose: Pose) -> Scalar:
    """The energy of a beam at a pose."""
    return _through_load(beam, pose)


def _through_load(beam: Beam, pose: Pose) -> Scalar:
    return units_of(beam)[0] * last_section(beam, _load(beam, pose)).energy


@partial(_stored.defjvp, symbolic_zeros=True)
def _(primals, tangents):
    # by the pose it is the wrench, which is known; by the beam, that of its integral
    beam, pose = primals
    of_beam, of_pose = tangents
    load = _load(beam, pose)
    wrench = load * units_of(beam)
    moment = wrench[0] - se2._cross(pose[1:], wrench[1:])
    turn = _whole(of_pose, pose)
    rate = moment * turn[0] + jnp.dot(wrench[1:], turn[1:])

    if _still(of_beam):
        return _through_load(beam, pose), rate
    moving = (_whole(of_beam, beam),)
    value, more = eqx.filter_jvp(lambda beam: _through_load(beam, pose), (beam,), moving)
    return value, rate + more


def _still(tangents: Any) -> bool:
    """Whether nothing of it changes, so that its part need not be compiled."""
    leaves = jax.tree.leaves(tangents, is_leaf=_is_zero)
    return all(map(_is_zero, leaves))


def _is_zero(leaf: Any) -> bool:
    return isinstance(leaf, jax.custom_derivatives.SymbolicZero)


def _whole(tangents: Any, primals: Any) -> Any:
    leaves, tree = jax.tree.flatten(tangents, is_leaf=_is_zero)
    values = jax.tree.leaves(primals)
    filled = [
        jnp.zeros_like(value) if _is_zero(leaf) else leaf
        for leaf, value in zip(leaves, values, strict=True)
    ]
    return jax.tree.unflatten(tree, filled)


@jax.custom_jvp
def _load(beam: Beam, pose: Pose) -> Float[Array, "3"]:
    """The load, in its units, that brings a beam to a pose: by Newton's method.

    From rest along the twist that leads there, with a soft spring behind it along the
    axis, which is then stiffened: a thin beam by itself would be stretched or pressed on
    its way by far more than it bears, as bending draws its ends together. NaN where no
    load is found.
    """
    sizes = _sizes(beam)
    twist = se2.twist(pose)

    def nearer(k: Array, load: Array) -> Array:
        part = jnp.minimum(k // 2 + 1, _PARTS) / _PARTS
        stiffening = jnp.maximum(k // 2 + 1 - _PARTS, 0)
        soft = jnp.where(stiffening > _PARTS, 0.0, _SOFT * 0.2**stiffening)
        half = part * pose[0] / 2
        axis = jnp.stack([jnp.zeros(()), jnp.cos(half), jnp.sin(half)])
        reached, slope = _reached_and_slope(beam, load)
        gap = se2.exp(twist * part) / sizes - reached - soft * axis * (axis @ load)
        return load + jnp.linalg.solve(slope + soft * jnp.outer(axis, axis), gap)

    load = jax.lax.fori_loop(0, 4 * _PARTS + 4, nearer, jnp.zeros(3))
    gap = jnp.max(jnp.abs(_reached(beam, load) - pose / sizes))
    return jnp.where(gap < 1e-9, load, jnp.nan)


@partial(_load.defjvp, symbolic_zeros=True)
def _(primals, tangents):
    beam, pose = primals
    of_beam, of_pose = tangents
    load = _load(beam, pose)
    _, slope = _reached_and_slope(beam, load)

    rate = _whole(of_pose, pose) / _sizes(beam)
    if not _still(of_beam):

        def short(beam: Beam) -> Array:
            return pose / _sizes(beam) - _reached(beam, load)

        rate = rate + eqx.filter_jvp(short, (beam,), (_whole(of_beam, beam),))[1]
    return load, jnp.linalg.solve(slope, rate)


# on the way from rest to a displacement, and as many while the spring is stiffened
_PARTS = 8
_SOFT = 0.05  # lengths by E I / L^2


def _reached(beam: Beam, load: Array) -> Float[Array, "3"]:
    """The pose that a load leads to, translations in parts of the length."""
    pose, _ = end_of(beam, load * units_of(beam), last_section(beam, load))
    return pose / _sizes(beam)


def _sizes(beam: Beam) -> Float[Array, "3"]:
    return jnp.stack([jnp.ones(()), beam.length, beam.length])


def _reached_and_slope(beam: Beam, load: Array) -> tuple[Array, Array]:
    def twice(load: Array) -> tuple[Array, Array]:
        reached = _reached(beam, load)
        return reached, reached

    slope, reached = jax.jacfwd(twice, has_aux=True)(load)
    return reached, slope
