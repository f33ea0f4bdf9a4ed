"""Linear least-squares fit of the potential of a mixed energy to samples."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array, Float

from ..._utils.types import Matrix, Scalar, Wrench
from ...energies.base import AbstractEnergy
from ...energies.fitting.mixed_equations import (
    mixed_equations,
    twists_and_stresses,
    weighted_equations,
)
from ...energies.monomials import Powers
from ...energies.potentials import variable_units


_DIAGONAL = 1e-13  # above the rounding errors of products of columns of unit norm


def fit_coefficients(
    powers: Powers,
    stiff: tuple[int, ...],
    references: tuple[Scalar, Scalar],
    stiffness: Matrix,
    samples: tuple[Float[Array, "samples 3"], Float[Array, "samples 3"]],
) -> Float[Array, " terms"]:
    """Fit the coefficients (J) of W that do not follow from the stiffness.

    All components of the wrench have the same relative weight. The references are a
    length and a force (m, N). The samples are poses, and wrenches in frame b (N m, N, N).
    For the stiff directions, see `AbstractMixedEnergy.stiff`.
    """
    poses, wrenches = samples
    rms = jnp.sqrt(jnp.mean(wrenches**2, axis=0))
    trials = twists_and_stresses(poses, wrenches, jnp.broadcast_to(rms, wrenches.shape))
    forces = trials.stresses[:, np.array(stiff)]
    equations = mixed_equations(powers, stiff, trials.twists, forces, *references)
    quadratic = _quadratic_coefficients(stiff, references, stiffness)
    zero = jnp.zeros(())
    start = jnp.stack([quadratic.get(row, zero) for row in powers])
    free = np.array([k for k, row in enumerate(powers) if row not in quadratic])

    def solve(previous: Float[Array, " terms"] | None) -> Float[Array, " terms"]:
        """Solve with the weights of a previous solution."""
        rows, targets = map(jnp.asarray, weighted_equations(trials, equations, previous))
        rows, targets = rows.reshape(-1, len(powers)), targets.reshape(-1)
        found = least_squares(rows[:, free], targets - rows @ start)
        return start.at[free].set(found)

    coefficients = solve(None if len(stiff) == 1 else start)
    for _ in range(3):
        coefficients = solve(coefficients)
    return coefficients


def _quadratic_coefficients(
    stiff: tuple[int, ...], references: tuple[Scalar, Scalar], stiffness: Matrix
) -> dict[tuple[int, ...], Scalar]:
    """Return the coefficients that follow from the stiffness, and are not fitted; J."""
    compliant = [k for k in range(3) if k not in stiff]
    count, order = len(compliant), [*compliant, *stiff]
    stiffness = stiffness[np.ix_(order, order)]
    # The displacements in the stiff directions are replaced by the forces.
    compliance = jnp.linalg.inv(stiffness[count:, count:])
    transfer = compliance @ stiffness[count:, :count]
    remaining = stiffness[:count, :count] - stiffness[:count, count:] @ transfer
    matrix = jnp.block([[remaining, transfer.T], [transfer, -compliance]])
    units = variable_units(stiff, *references)
    scale = jnp.stack([jnp.asarray(units[k]) for k in order])
    matrix = matrix * jnp.outer(scale, scale)
    coefficients = {}
    for i in range(3):
        for j in range(i + 1):
            row = tuple((k == i) + (k == j) for k in range(3))
            coefficients[row] = matrix[i, j] / (2 if i == j else 1)
    return coefficients


def least_squares(
    rows: Float[Array, "equations terms"], targets: Float[Array, " equations"]
) -> Float[Array, " terms"]:
    """Solve linear least squares by normal equations of columns of unit norm.

    Normal equations are easy to differentiate. With small forces, some terms are almost
    linear combinations of others: the small diagonal determines their coefficients.
    """
    norms = jnp.sqrt(jnp.sum(rows**2, axis=0))
    scaled = rows / norms[None]
    factor = cho_factor(scaled.T @ scaled + _DIAGONAL * jnp.eye(len(norms)))
    return cho_solve(factor, scaled.T @ targets) / norms


def relative_errors(
    energy: AbstractEnergy,
    poses: Float[Array, "samples 3"],
    wrenches: Float[Array, "samples 3"],
) -> Wrench:
    """Compute the rms error of each component of the wrench over its rms value.

    The wrenches are in frame b (N m, N, N), at the poses of frame b (rad, m, m).
    """
    change = jax.vmap(energy.wrench)(poses) - wrenches
    return jnp.sqrt(jnp.mean(change**2, axis=0) / jnp.mean(wrenches**2, axis=0))
