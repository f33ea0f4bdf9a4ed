"""Stiffness of a flexure out of its plane, from its deformed cross-sections."""

from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import Pose, Scalar
from ..geometry import se2
from ..geometry.twistors import Displacement


_NODES = 200  # of the quadrature along the axis
_TWISTS = 64  # polynomials by which the twist rate of a flexure is approximated
_TERMS = 10  # of the series of the torsion constant, after which they are below 1e-13
# Sum of 1 / m^5 over all odd numbers m
_ODD_SUM = 1.004523762795139616


class Sections(NamedTuple):
    """Cross-sections of a deformed flexure, which consists of parts in series.

    They are at the `nodes` along the axis of each part.
    """

    # Poses of the cross-sections in a frame, by which the stiffness is described; rad, m,
    # m
    poses: Float[Array, "parts nodes 3"]
    # In-plane, changes smoothly along a part; one number if it is uniform; m
    thickness: Float[Array, " parts *nodes"]
    length: Float[Array, " parts"]  # Along the axis; m
    width: Scalar  # Out of the plane; m
    modulus: Scalar  # Pa
    shear_modulus: Scalar  # Pa
    # For each end: 1 if another segment of the same flexure continues it, so that it can
    # warp, and 0 if it is clamped; None if both are clamped
    continues: Float[Array, "2"] | None = None


@cache
def _quadrature() -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes from -1 to 1 and the weights of the quadrature of Gauss."""
    # This package takes 20 ms to load, and few programs need it.
    from numpy.polynomial import legendre

    return legendre.leggauss(_NODES)


def nodes() -> Float[np.ndarray, " nodes"]:
    """Return the positions of the cross-sections along the axis, from -1 to 1."""
    return _quadrature()[0]


def _weighted(values: Float[np.ndarray, "rows nodes"]) -> np.ndarray:
    """Multiply values at the nodes by the weights of the quadrature."""
    return _quadrature()[1] * values


def _polynomials(degree: int) -> Float[np.ndarray, "nodes polynomials"]:
    """Return the polynomials of Legendre at the nodes, up to a degree."""
    from numpy.polynomial import legendre

    return legendre.legvander(nodes(), degree)


class _Compliance(NamedTuple):
    """Displacements of an end by forces on it and by the twist rates of both ends.

    The displacements are `by_forces @ forces + by_twist_rates @ twist_rates`, and the
    bimoments are `restraint @ twist_rates - by_twist_rates.T @ forces`.
    """

    by_forces: Float[Array, "3 3"]
    by_twist_rates: Float[Array, "3 ends"]
    restraint: Float[Array, "ends ends"]


def out_of_plane_stiffness(
    sections: Sections, warping: bool
) -> Float[Array, "displacements displacements"]:
    """Compute the forces out of the plane on one end, for unit displacements of it.

    They are the force along z and the moments about axes 1 and 2 of the frame of the
    sections, for z and the rotations about these axes, at its origin; N/m, N/rad, N
    m/rad. With `warping`, clamped ends of the flexure cannot warp. If it `continues` at
    its ends, two more displacements are the twist rates at both ends (rad/m), and the
    forces are bimoments; N m^2.

    Source:
        See `flexures.out_of_plane_stiffness`.
    """
    continues = sections.continues
    along = jax.vmap(partial(_compliance, sections, warping))
    found = _in_series(along(sections.poses, sections.thickness, sections.length))
    stiffness = jnp.linalg.inv(found.by_forces)
    if continues is None:
        return stiffness
    by_twist_rates = found.by_twist_rates * continues[None]
    coupling = -stiffness @ by_twist_rates
    restraint = found.restraint * continues[:, None] * continues[None]
    restraint = restraint - by_twist_rates.T @ coupling
    return jnp.block([[stiffness, coupling], [coupling.T, restraint]])


def _in_series(parts: _Compliance) -> _Compliance:
    """Join parts with the same twist rate where they meet; no bimoment acts there."""
    count = len(parts.by_forces)
    if count == 1:
        return jax.tree.map(lambda values: values[0], parts)
    by_twist_rates = jnp.zeros((3, count + 1))
    restraint = jnp.zeros((count + 1, count + 1))
    for k in range(count):
        ends = slice(k, k + 2)
        by_twist_rates = by_twist_rates.at[:, ends].add(parts.by_twist_rates[k])
        restraint = restraint.at[ends, ends].add(parts.restraint[k])
    joints, ends = slice(1, -1), np.array([0, count])
    couplings = jnp.concatenate([by_twist_rates, -restraint[ends]])[:, joints]
    eliminated = couplings @ jnp.linalg.solve(restraint[joints, joints], couplings.T)
    return _Compliance(
        jnp.sum(parts.by_forces, axis=0) + eliminated[:3, :3],
        by_twist_rates[:, ends] + eliminated[:3, 3:],
        restraint[ends][:, ends] - eliminated[3:, 3:],
    )


def _compliance(
    sections: Sections,
    warping: bool,
    poses: Float[Array, "nodes 3"],
    thickness: Float[Array, "*nodes"],
    length: Scalar,
) -> _Compliance:
    """Integrate the compliance along a part."""
    width, modulus = sections.width, sections.modulus
    shear_modulus = sections.shear_modulus
    weights = length / 2 * _quadrature()[1]
    angle, x, y = poses.T
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    torque = jnp.stack([-cos * y + sin * x, cos, sin], axis=1)
    bending = jnp.stack([sin * y + cos * x, -sin, cos], axis=1)

    poisson = modulus / (2 * shear_modulus) - 1
    shear_factor = 10 * (1 + poisson) / (12 + 11 * poisson)
    area, torsion = thickness * width, torsion_constant(thickness, width)
    by_bending = weights / (modulus * thickness * width**3 / 12)
    by_shear = jnp.sum(weights / (shear_factor * shear_modulus * area))
    compliance = bending.T @ (by_bending[:, None] * bending)
    compliance = compliance.at[0, 0].add(by_shear)
    if not warping:
        by_torsion = weights / (shear_modulus * torsion)
        compliance = compliance + torque.T @ (by_torsion[:, None] * torque)
        return _Compliance(compliance, jnp.zeros((3, 2)), jnp.eye(2))
    # The twist rate minimizes the potential energy.
    values, slopes = _twist_rates()
    twisting = length / 2 * shear_modulus * torsion
    restraint = 2 / length * modulus * area**3 / 144
    if thickness.ndim:
        at_nodes = (values * twisting[None]) @ _weighted(values).T
        matrix = at_nodes + (slopes * restraint[None]) @ _weighted(slopes).T
    else:
        matrix = twisting * (values @ _weighted(values).T)
        matrix = matrix + restraint * (slopes @ _weighted(slopes).T)
    work = jnp.matmul(values, weights[:, None] * torque)
    at_ends, inside = slice(2), slice(2, None)
    lower = jnp.linalg.cholesky(matrix[inside, inside])
    right = jnp.concatenate([work, matrix[:, at_ends]], axis=1)[inside]
    solved = jax.scipy.linalg.solve_triangular(lower, right, lower=True)
    strains, imposed = solved[:, :3], solved[:, 3:]
    return _Compliance(
        compliance + strains.T @ strains,
        work[at_ends].T - strains.T @ imposed,
        jnp.subtract(matrix[at_ends, at_ends], imposed.T @ imposed),
    )


def torsion_constant(
    thickness: Float[Array, "*sections"], width: Scalar
) -> Float[Array, "*sections"]:
    """Compute the torsion constant of rectangles, by its series; m^4."""
    short, long = jnp.minimum(thickness, width), jnp.maximum(thickness, width)
    odd = np.reshape(2.0 * np.arange(_TERMS) + 1, (*thickness.ndim * (1,), -1))
    decay = jnp.exp(-np.pi * (long / short)[..., None] * odd)
    # tanh(u) = 1 - 2 exp(-2 u) / (1 + exp(-2 u))
    rest = jnp.sum(2 * decay / (1 + decay) / odd**5, axis=-1)
    factor = 1 - 192 / np.pi**5 * short / long * (_ODD_SUM - rest)
    return long * short**3 / 3 * factor


@cache
def _twist_rates() -> tuple[np.ndarray, np.ndarray]:
    """Return polynomials at the nodes, and their slopes.

    The first two are 1 at one of the ends -1 and 1, the others zero at both ends.
    """
    polynomials = _polynomials(_TWISTS + 1)
    # The difference of those of degrees n + 1 and n - 1 has the slope (2 n + 1) P_n.
    odd = 2 * np.arange(1, _TWISTS + 1) + 1
    values = (polynomials[:, 2:] - polynomials[:, :-2]) / np.sqrt(2 * odd)
    slopes = (polynomials[:, 1:-1] * np.sqrt(odd / 2)).T
    at, half = nodes(), np.full(_NODES, 0.5)
    linear = [(1 - at) / 2, (1 + at) / 2]
    return np.concatenate([linear, values.T]), np.concatenate([[-half, half], slopes])


def at_nodes(values: Float[Array, "sections ..."]) -> Float[Array, "nodes ..."]:
    """Interpolate values along the axis to the nodes.

    Their positions are the sines of equally spaced angles. Polynomials of the angle
    through the nearest ones are used.
    """
    count = len(values)
    degree = min(9, count - 1)
    at = (np.arcsin(nodes()) / np.pi + 0.5) * (count - 1)
    first = np.clip(np.round(at - degree / 2).astype(int), 0, count - 1 - degree)
    local, points = at - first, np.arange(degree + 1)
    matrix = np.zeros((_NODES, count))
    for k in points:
        others = points[points != k]
        share = np.prod((local[:, None] - others) / (k - others), axis=1)
        matrix[np.arange(_NODES), first + k] = share
    return jnp.asarray(matrix) @ values


def seen_from(
    frame: Pose, poses: Float[Array, "sections 3"]
) -> Float[Array, "sections 3"]:
    """Return poses as seen from a frame, which has a pose in the same frame as they."""
    return jax.vmap(partial(se2.compose, se2.inverse(frame)))(poses)


def first_end(displacement: Displacement, length: Scalar) -> Pose:
    """Compute the pose of the first end of a flexure, which is fixed to frame a.

    The pose is in the mid-frame; rad, m, m.
    """
    x = -length / 2 * displacement.sigma - displacement.x1
    y = length / 2 * displacement.xi - displacement.x2
    return jnp.stack([-displacement.angle / 2, x, y])


def bent_sections(
    start: Pose, length: Scalar, curvature: Float[Array, " nodes"]
) -> Float[Array, "nodes+1 3"]:
    """Integrate a curvature along a part of a flexure, from the pose of its start.

    The poses are those of the cross-sections at the nodes and at the end; rad, m, m.
    """
    # The same matrix for a whole batch: `benchmarks.sweeps`
    integrals, arm = jnp.asarray(_integrals_along()), length / 2
    angles = arm * (integrals @ curvature) + start[0]
    x = arm * (integrals @ jnp.cos(angles[:-1])) + start[1]
    y = arm * (integrals @ jnp.sin(angles[:-1])) + start[2]
    return jnp.stack([angles, x, y], axis=1)


@cache
def _integrals_along() -> Float[np.ndarray, "rows nodes"]:
    """Return the matrix that integrates values at the nodes from -1 to each and to 1."""
    at, weights = _quadrature()
    polynomials, degrees = _polynomials(_NODES), np.arange(_NODES)
    # The integral of P_n is (P_(n+1) - P_(n-1)) / (2 n + 1), and that of P_0 is x + 1.
    integrals = (polynomials[:, 2:] - polynomials[:, :-2]) / (2 * degrees[1:] + 1)
    integrals = np.concatenate([at[:, None] + 1, integrals], axis=1)
    along = integrals @ (polynomials[:, :-1].T * weights * (degrees + 0.5)[:, None])
    return np.concatenate([along, weights[None]])
