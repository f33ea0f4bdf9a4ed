"""Energies of beams as polynomials: nearly exact, at the cost of one hinge."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array, ArrayLike, Float

from .._utils.types import Matrix, Pose, Scalar, Wrench
from .._utils.validation import (
    all_concrete,
    concrete,
    require_float64,
    require_interval,
    require_kind,
    require_positive,
)
from ..energies.fitting import mixed
from ..energies.mixed import MixedEnergy
from ..energies.monomials import monomials, Powers, Symmetry
from ..energies.validity import WithValidityRange
from .beam import Beam, end_of, last_section, uniform, units_of


_ORDERS = (4, 6, 8, 10)
_SAMPLES = 800  # to fit, and half as many to certify


def surrogate(
    beam: Beam,
    *,
    turn: ArrayLike,
    force: ArrayLike | None = None,
    error: float = 1e-3,
    order: int | None = None,
) -> WithValidityRange:
    """A beam's energy as a hinge: a polynomial that is nearly exact over a range.

    Of a mixed kind, see `MixedEnergy`: so it takes as few terms for a very slender leaf as
    for a thick one. At rest its stiffness is the beam's own. It can be differentiated by
    all dimensions of the beam, to the error that it has in the wrench. A sweep over them
    goes under `jax.jit` and `jax.lax.map`, with `order` given.

    Args:
        beam: leaf, notch or any other outline.
        turn: the largest, either way, up to which it is to hold; rad.
        force: the largest, in any direction; by default five times the bending stiffness
            over the length, five E I / L^2 of a leaf. At some ten times it would buckle
            between its ends, which no polynomial follows; N.
        error: the largest that is accepted in any component of the wrench, root mean
            square over that of the wrenches, on samples that the fit has not seen. While
            the beam is being traced it cannot be looked at: then it is only told.
        order: of the polynomial in turn and translation: 4, 6, 8 or 10; by default the
            least that has the error; six while the beam is being traced.

    Returns:
        The energy with its range, and its error as `error`, for (moment, axial force,
        transverse force) on fresh samples, spread evenly over turns and forces.

    Raises:
        ValueError: double precision is off; the error is not met, or the beam cannot be
            bent so far; a setting makes no sense.

    Source:
        The polynomial energies of section 4.7 of the dissertation, of a beam instead of
        measurements, in the form of `MixedEnergy`.

    Example:
        >>> from twistorjax import Material
        >>> from twistorjax.flexures import beam_under_load
        >>> soft = Material(modulus=3.45e9, poisson=0.3)
        >>> leaf = Beam(soft, length=10e-3, thickness=1e-3, width=5e-3)
        >>> hinge = surrogate(leaf, turn=0.8)
        >>> hinge.wrench(beam_under_load(leaf, jnp.array([0.05, 0.0, 2.0])).pose)[2].round(2)
        Array(1.88, dtype=float64)
    """
    require_kind("beam", [beam], Beam)
    require_float64(beam.length)
    turn = require_interval(
        "`turn`", turn, 0.0, 2 * np.pi, "must be positive, to a full turn"
    )
    if not error > 0:
        raise ValueError(f"`error` is {error!r}, but must be positive.")
    if order is not None and order not in _ORDERS:
        raise ValueError(f"`order` is {order!r}, but must be one of {_ORDERS}.")
    if force is not None:
        force = require_positive("`force`", force)
    alike = _alike(beam)
    middle = beam.profile(jnp.zeros(()))
    samples = _sampled(beam, turn, force)
    if all_concrete([middle, turn, *jax.tree.leaves(samples)]) is None:
        return _fitted(_powers(order or 6, alike), beam.length, turn, samples)
    missed = float(jnp.max(samples.missed))
    ends = f"a turn of {float(turn):.4g} rad and a force of {float(samples.force):.4g} N"
    if not missed < 1e-6:
        raise ValueError(
            f"The beam cannot be bent everywhere up to {ends}: from "
            f"{float(samples.least_missed):.3g} N on some turns are not found. Pressed "
            "by some ten times its bending stiffness over its length it buckles between "
            "its ends. Take a smaller `turn` or `force`."
        )
    reached = {}
    for tried in _ORDERS if order is None else (order,):
        hinge = _fitted(_powers(tried, alike), beam.length, turn, samples)
        reached[tried] = float(jnp.max(hinge.error))
        if reached[tried] <= error:
            return hinge
    told = ", ".join(f"order {tried} {worst:.2g}" for tried, worst in reached.items())
    raise ValueError(
        f"An error of {error:g} is not met up to {ends}, but by {told}. Take a smaller "
        "range, or accept a larger `error`."
    )


class _Samples(NamedTuple):
    """Displacements of a beam, and what they take.

    Args:
        poses: of frame b, seen from frame a; rad, m, m.
        wrenches: that body B exerts: about b, in its axes; N m, N, N.
        missed: by how much the turn is not what was wanted; rad.
        least_missed: the least force under which one is missed; N.
        force: the largest; N.
        stiffness: of the beam at rest, rotation first; N m/rad, N/rad, N/m.
    """

    poses: Float[Array, "samples 3"]
    wrenches: Float[Array, "samples 3"]
    missed: Float[Array, " samples"]
    least_missed: Scalar
    force: Scalar
    stiffness: Matrix


@jax.jit
def _sampled(beam: Beam, turn: Scalar, force: Scalar | None) -> _Samples:
    """Turns and forces spread evenly, those to fit first, each with its moment."""
    units = units_of(beam)

    def sample(load: Wrench) -> tuple[Pose, Wrench]:
        return end_of(beam, load * units, last_section(beam, load))

    stiffness = jnp.linalg.inv(
        jax.jacfwd(lambda load: sample(load)[0])(jnp.zeros(3)) / units[None]
    )
    limit = 5 * stiffness[0, 0] / beam.length if force is None else force
    still, largest, slack, softest = lax.stop_gradient(
        (beam, turn, limit / units[1], units[0] / stiffness[0, 0])
    )

    def turned(moment: Scalar, force: Float[Array, "2"]) -> Scalar:
        return last_section(still, jnp.concatenate([moment[None], force])).angle

    def load(spread: Float[Array, "3"]) -> tuple[Wrench, Scalar]:
        wanted = largest * (2 * spread[0] - 1)
        angle = 2 * np.pi * spread[2]
        direction = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        across = slack * jnp.sqrt(spread[1]) * direction

        def nearer(_, moment: Scalar) -> Scalar:
            one = jnp.ones_like(moment)
            reached, slope = jax.jvp(lambda m: turned(m, across), (moment,), (one,))
            # no more than from one winding to the next
            gap = jnp.clip(wanted - reached, -1.0, 1.0)
            return moment + gap / jnp.maximum(slope, 0.03 * softest)

        moment = lax.fori_loop(0, 10, nearer, wanted / softest)
        missed = jnp.abs(turned(moment, across) - wanted)
        return jnp.concatenate([moment[None], across]), missed

    loads, missed = jax.vmap(load)(_spread())
    poses, wrenches = jax.vmap(sample)(lax.stop_gradient(loads))
    missed = jnp.where(jnp.isfinite(missed), missed, jnp.inf)
    forces = units[1] * jnp.linalg.norm(loads[:, 1:], axis=1)
    least = jnp.min(jnp.where(missed < 1e-6, jnp.inf, forces))
    return _Samples(poses, wrenches, missed, least, limit, stiffness)


def _spread() -> Float[Array, "samples 3"]:
    """Points that fill a cube evenly: multiples of powers of a generalised golden ratio.

    Those that certify are a sequence of their own, half a cube away.
    """
    golden = 1.2207440846057596  # the root of x^4 = x + 1
    steps = golden ** -np.arange(1.0, 4.0)
    to_fit = np.arange(1, _SAMPLES + 1)[:, None] * steps
    to_certify = 0.5 + np.arange(1, _SAMPLES // 2 + 1)[:, None] * steps
    return jnp.asarray(np.concatenate([to_fit, to_certify]) % 1)


def _alike(beam: Beam) -> bool:
    """Whether both ends are seen to be alike."""
    if getattr(beam.profile, "func", None) is uniform:
        return True
    places = jnp.asarray(np.linspace(-0.5, 0.5, 101)) * beam.length
    heights = concrete(jax.vmap(beam.profile)(places))
    return heights is not None and np.allclose(heights, heights[::-1], rtol=1e-9, atol=0)


def _powers(order: int, alike: bool) -> Powers:
    """Those of a flexure that is its own mirror image, and bears nothing at rest."""
    symmetry: Sequence[Symmetry] = ("mirror", "ends") if alike else ("mirror",)
    powers = monomials(order, "tension", symmetry=symmetry)
    return tuple(row for row in powers if row not in ((0, 0, 0), (0, 0, 1)))


@partial(jax.jit, static_argnums=0)
def _fitted(
    powers: Powers, length: Scalar, turn: Scalar, samples: _Samples
) -> WithValidityRange:
    """The energy, and its error on the samples left over."""
    coefficients = _coefficients(powers, length, samples)
    energy = MixedEnergy(coefficients, powers, length=length, force=samples.force)
    left = jax.vmap(energy.wrench)(samples.poses[_SAMPLES:])
    truth = samples.wrenches[_SAMPLES:]
    error = jnp.sqrt(jnp.mean((left - truth) ** 2, axis=0) / jnp.mean(truth**2, axis=0))
    return WithValidityRange(energy, turn, samples.force, error)


def _coefficients(
    powers: Powers, length: Scalar, samples: _Samples
) -> Float[Array, " terms"]:
    """By linear least squares of moment, transverse force and length.

    An error of the length is one of the tension, by how much the beam gives there: so
    the lengths' weights follow from a first fit, and from another.
    """
    twists, turning = jax.vmap(mixed.by_twist)(samples.poses[:_SAMPLES])
    pulls = jnp.einsum("sij,sj->si", turning, samples.wrenches[:_SAMPLES])
    adds = mixed.terms(powers, twists, pulls[:, 1], length, samples.force)
    at_rest = _at_rest(length, samples)
    none = jnp.zeros(())
    start = jnp.stack([at_rest.get(row, none) for row in powers])
    rows = jnp.stack([adds.moment, adds.shear, adds.length])
    right = jnp.stack([pulls[:, 0], pulls[:, 2], twists[:, 1]]) - rows @ start
    free = np.array([k for k, row in enumerate(powers) if row not in at_rest])
    rows, gives = rows[..., free], adds.give[:, free]

    moment, tension, shear = jnp.sqrt(jnp.mean(pulls**2, axis=0))
    stiffest = samples.stiffness[1, 1]
    give = jnp.full_like(twists[:, 1], jnp.std(twists[:, 1]) / tension)
    found = jnp.zeros(len(free))
    for _ in range(4):
        each = 1 / (give * tension)
        alike = [jnp.full_like(each, 1 / size) for size in (moment, shear)]
        weights = jnp.stack([*alike, each])
        weighted = (weights[..., None] * rows).reshape(-1, len(free))
        found = _least_squares(weighted, (weights * right).reshape(-1))
        give = jnp.maximum(gives @ found + 1 / stiffest, 1e-3 / stiffest)
    return start.at[free].set(found)


def _at_rest(length: Scalar, samples: _Samples) -> dict[tuple[int, ...], Scalar]:
    """The coefficients that the stiffness at rest tells, which are not fitted."""
    stiffness = samples.stiffness
    return {
        (2, 0, 0): stiffness[0, 0] / 2,
        (1, 1, 0): stiffness[0, 2] * length,
        (0, 2, 0): stiffness[2, 2] * length**2 / 2,
        (0, 0, 2): -(samples.force**2) / (2 * stiffness[1, 1]),
    }


def _least_squares(
    rows: Float[Array, "equations terms"], right: Float[Array, " equations"]
) -> Float[Array, " terms"]:
    """By normal equations, which differentiate well; the columns made alike in size."""
    size = jnp.sqrt(jnp.sum(rows**2, axis=0))
    scaled = rows / size[None]
    square = cho_factor(scaled.T @ scaled)
    return cho_solve(square, scaled.T @ right) / size
