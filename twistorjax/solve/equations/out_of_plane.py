"""Linear algebra of small displacements out of the plane.

The coordinates of each body are z and the rotations about x and y, at its displaced
origin; m, rad, rad. Matrices are those of the bodies that can move.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from ..._utils.types import Pose, Scalar
from ...geometry import se2
from ...linalg.eigenvalues import modes, Stiffness
from ...linalg.factors import Factors


COORDINATES = ("z", "rotation_x", "rotation_y")

# A frequency is at a resonance if the modal stiffness is a smaller fraction of its terms.
_RESONANT = 1e-13


class NormalModes(NamedTuple):
    """All modes of vibration."""

    angular: Float[Array, " modes"]  # Angular frequencies; rad/s
    # Mass-normalized mode shapes, one in each column; 1/kg^0.5, rad/(kg^0.5 m)
    shapes: Float[Array, "free modes"]


def compliance_of_port(
    body: int, port: Pose, stiffness: Float[Array, "free free"], pose: Pose
) -> Float[Array, "3 3"]:
    """Compute the compliance of a port (rad, m, m) on one of the bodies, in its axes.

    `pose` is that of the body.
    """
    rows = slice(3 * body, 3 * body + 3)
    unit_forces = jnp.eye(len(stiffness))[:, rows]
    compliance = displacements(stiffness, unit_forces)[rows]
    angle, x, y = se2.compose(pose * jnp.array([1.0, 0.0, 0.0]), port)
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    one, zero = jnp.ones_like(x), jnp.zeros_like(x)
    moved = jnp.array([[one, y, -x], [zero, cos, sin], [zero, -sin, cos]])
    return moved @ compliance @ moved.T


def displacements(
    stiffness: Float[Array, "free free"], forces: Float[Array, "free ..."]
) -> Float[Array, "free ..."]:
    """Compute the response to constant forces; N, N m, N m."""
    return Factors.of(stiffness, symmetric=True).solve(forces)


def normal_modes(
    stiffness: Float[Array, "free free"], inertia: Float[Array, "bodies 3 3"]
) -> NormalModes:
    """Compute the modes of bodies with these masses and moments of inertia."""
    count, size = len(inertia), len(stiffness)
    lower = jnp.linalg.cholesky(inertia)
    units = jnp.linalg.inv(lower)
    blocks = stiffness.reshape(count, 3, count, 3)
    scaled = jnp.einsum("iab,ibjc,jdc->iajd", units, blocks, units).reshape(size, size)
    rows, weights = jnp.zeros((0, size)), jnp.zeros(0)
    root, vectors = modes(Stiffness(rows, weights, scaled))
    shapes = jnp.einsum("iba,ibm->iam", units, vectors.reshape(count, 3, size))
    return NormalModes(jnp.diagonal(root), shapes.reshape(size, size))


def amplitudes(
    natural: NormalModes,
    damping_ratio: Scalar,
    forces: Float[Array, " free"],
    frequencies: Float[Array, " frequencies"],
) -> Complex[Array, "frequencies free"]:
    """Compute the response to forces at each frequency (Hz); NaN at a resonance."""
    omega, angular = 2 * jnp.pi * frequencies[:, None], natural.angular[None]
    elastic = (angular - omega) * (angular + omega)
    viscous = 2 * damping_ratio * angular * omega
    size = angular**2 + omega**2
    resonant = jnp.abs(elastic) + jnp.abs(viscous) < _RESONANT * size
    stiffness = jax.lax.complex(jnp.where(resonant, jnp.nan, elastic), viscous)
    coordinates = (natural.shapes.T @ forces)[None].astype(complex) / stiffness
    return coordinates @ natural.shapes.T.astype(complex)


def state_space_matrices(
    natural: NormalModes,
    damping_ratio: Scalar,
    kept: int,
    forces: Float[Array, "free inputs"],
    observed: Float[Array, "outputs free"],
) -> tuple[Array, Array, Array, Array]:
    """Compute the matrices A, B, C, D of a model in which some modes are kept."""
    angular, by_mode = natural.angular, natural.shapes.T @ forces
    seen = observed @ natural.shapes
    zero, lowest = jnp.zeros((kept, kept)), angular[:kept]
    damping = 2 * damping_ratio * lowest
    a = jnp.block([[zero, jnp.eye(kept)], [-jnp.diag(lowest**2), -jnp.diag(damping)]])
    b = jnp.concatenate([jnp.zeros_like(by_mode[:kept]), by_mode[:kept]])
    c = jnp.concatenate([seen[:, :kept], jnp.zeros_like(seen[:, :kept])], axis=1)
    static = by_mode[kept:] / angular[kept:, None] ** 2
    return a, b, c, seen[:, kept:] @ static
