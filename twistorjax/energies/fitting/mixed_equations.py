"""Equations for the coefficients of the potential W of a mixed energy.

The forces in the compliant directions and the displacements in the stiff directions are
derivatives of W, so they are linear in its coefficients if the forces in the stiff
directions are given. NumPy evaluates them for measured trials, because a program of JAX
for each order would compile for longer than the fit takes.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.host import on_host
from ..._utils.types import Matrix, Pose, Scalar, Twist
from ...geometry import se2
from ..evaluation import AnyArray, partial_derivative, power_derivatives
from ..monomials import Powers
from ..potentials import variable_units


class MixedTrials(NamedTuple):
    """Trials in the coordinates of a mixed energy; see `twists_and_stresses`."""

    twists: Float[AnyArray, "trials 3"]  # Twist of each trial; rad, m, m
    stresses: Float[AnyArray, "trials 3"]  # Generalized stress of each trial; N m, N, N
    # Matrices from an error of the generalized stress to the error of the wrench in
    # standard deviations
    to_wrenches: Float[AnyArray, "trials 3 3"]


class MixedEquations(NamedTuple):
    """Equations for the coefficients of W; see `mixed_equations`.

    The contributions of a term are those for a coefficient of one joule.
    """

    # The compliant directions, and the stiff ones, in the order of the variables of W
    compliant: np.ndarray
    stiff: np.ndarray
    # Forces in the stiff directions at which the terms are evaluated; N m, N
    forces: Float[AnyArray, "trials stiff"]
    # Contributions to the forces in the compliant directions, and to the displacements in
    # the stiff ones
    conjugates: Float[AnyArray, "trials 3 terms"]
    # Derivatives of the forces in the compliant directions by those in the stiff ones
    coupling: Float[AnyArray, "trials compliant stiff terms"]
    # Derivatives of the displacements in the stiff directions by the forces in them
    compliance: Float[AnyArray, "trials stiff stiff terms"]
    energy: Float[AnyArray, "trials terms"]  # Contributions to W; J


def mixed_equations(
    powers: Powers,
    stiff: tuple[int, ...],
    twists: Float[AnyArray, "trials 3"],
    forces: Float[AnyArray, "trials stiff"],
    length: Scalar | float,
    force: Scalar | float,
) -> MixedEquations:
    """Evaluate each term of W and its derivatives at many twists (rad, m, m) and forces.

    The forces (N m, N) are those in the stiff directions (see
    `AbstractMixedEnergy.stiff`), measured or predicted. `length` (m) and `force` (N) are
    the references.
    """
    compliant = [k for k in range(3) if k not in stiff]
    units = variable_units(stiff, length, force)
    units = [units[k] for k in (*compliant, *stiff)]
    xp, (twists, forces, *units) = on_host(twists, forces, *units)
    columns = [*(twists[:, k] for k in compliant), *forces.T]
    variables = [column / unit for column, unit in zip(columns, units, strict=True)]
    exponents = np.array(powers)
    of_coordinates, of_forces = range(len(compliant)), range(len(compliant), 3)
    powers_of_force = power_derivatives if len(stiff) == 2 else _continued_powers
    tables = [power_derivatives(variables[k], exponents[:, k]) for k in of_coordinates]
    tables += [powers_of_force(variables[k], exponents[:, k]) for k in of_forces]

    def derivative(*indices: int) -> Float[AnyArray, "trials terms"]:
        """Differentiate the terms with respect to some of the variables."""
        return partial_derivative(tables, indices) / math.prod(units[k] for k in indices)

    def derivatives(rows: range, columns: range) -> Float[AnyArray, "trials i j terms"]:
        blocks = [[derivative(i, j) for j in columns] for i in rows]
        return xp.stack([xp.stack(row, axis=1) for row in blocks], axis=1)

    gradient = [derivative(k) for k in of_coordinates]
    gradient += [-derivative(k) for k in of_forces]
    return MixedEquations(
        np.array(compliant),
        np.array(stiff),
        forces,
        conjugates=xp.stack(gradient, axis=1),
        coupling=derivatives(of_coordinates, of_forces),
        compliance=-derivatives(of_forces, of_forces),
        energy=derivative(),
    )


def _continued_powers(
    values: Float[AnyArray, " trials"], exponents: np.ndarray
) -> list[AnyArray]:
    """Compute powers of the only relative force, with two derivatives.

    Outside of the reference force, they are continued by parabolas; see `MixedEnergy`.
    """
    xp, (values,) = on_host(values)
    inside = xp.clip(values, -1.0, 1.0)
    outside = (values - inside)[:, None]
    power, slope, curvature = power_derivatives(inside, exponents)
    continued = power + outside * (slope + outside * curvature / 2)
    return [continued, slope + outside * curvature, curvature]


def weighted_equations(
    trials: MixedTrials,
    equations: MixedEquations,
    coefficients: Float[AnyArray, " terms"] | None,
) -> tuple[Float[AnyArray, "trials 3 terms"], Float[AnyArray, "trials 3"]]:
    """Weight the equations so that their residuals are errors of the wrench.

    An error of the displacements in the stiff directions is equivalent to an error of the
    forces in them, by the stiffness, and through it to errors of the other forces. The
    stiffness and these errors depend on the coefficients, so the least-squares problem is
    solved again with the coefficients (J) of the previous solution; at first there are
    none, if there is one stiff direction. If the terms are evaluated at the forces that
    these coefficients predict, this is a Gauss-Newton step for the errors of the
    predicted wrenches.
    """
    xp, _ = on_host(equations.conjugates)
    compliant, stiff = equations.compliant, equations.stiff
    forces, displacements = equations.forces, trials.twists[:, stiff]
    if coefficients is None:
        rms = xp.sqrt(xp.mean(forces**2))
        estimate = xp.std(displacements) / xp.where(rms > 0, rms, 1.0)
        estimate = xp.where(estimate > 0, estimate, 1.0)
        compliance = xp.full_like(forces[:, :, None], estimate)
        coupling = xp.zeros_like(equations.coupling[..., 0])
    else:
        compliance = equations.compliance @ coefficients
        coupling = equations.coupling @ coefficients
    if len(stiff) == 1:
        smallest = 1e-3 * xp.median(xp.abs(compliance))
        stiffness = 1 / xp.maximum(compliance, smallest)
    else:
        stiffness = xp.linalg.inv(compliance)

    def equivalent_stresses(conjugates: AnyArray) -> AnyArray:
        # A displacement that is too large corresponds to a force that is too small.
        in_stiff = -stiffness @ conjugates[:, len(compliant) :]
        in_compliant = conjugates[:, : len(compliant)] + coupling @ in_stiff
        return xp.concatenate([in_compliant, in_stiff], axis=1)

    measured = xp.concatenate([trials.stresses[:, compliant], displacements], axis=1)
    to_wrenches = trials.to_wrenches[:, :, np.append(compliant, stiff)]
    targets = to_wrenches @ equivalent_stresses(measured[..., None])
    excess = (trials.stresses[:, stiff] - forces)[..., None]
    targets = targets + trials.to_wrenches[:, :, stiff] @ excess
    return to_wrenches @ equivalent_stresses(equations.conjugates), targets[..., 0]


@jax.jit
def twists_and_stresses(
    poses: Float[Array, "trials 3"],
    wrenches: Float[Array, "trials 3"],
    deviations: Float[Array, "trials 3"],
) -> MixedTrials:
    """Convert poses and wrenches of body B in frame b to twists and generalized stresses.

    The generalized stress is the derivative of the energy with respect to the twist. Its
    second component is the axial force. Standard deviations are those of the wrenches.
    """

    def twist_and_matrix(pose: Pose) -> tuple[Twist, Matrix]:
        twist = se2.twist(pose)
        rotate_rows = jax.vmap(lambda row: se2.rotate(-pose[0], row))
        jacobian = jax.jacfwd(se2.exp)(twist)
        body_jacobian = jnp.concatenate([jacobian[:1], rotate_rows(jacobian[1:].T).T])
        return twist, body_jacobian.T

    twists, matrices = jax.vmap(twist_and_matrix)(poses)
    stresses = jnp.einsum("sij,sj->si", matrices, wrenches)
    errors = jnp.linalg.inv(matrices) / deviations[:, :, None]
    return MixedTrials(twists, stresses, errors)
