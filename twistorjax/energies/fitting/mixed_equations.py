"""Equations for the coefficients of a `MixedEnergy`; see `fit_mixed`.

The moment, the transverse force and the axial displacement are derivatives of the mixed
potential W, so they are linear in its coefficients if the axial force is given. NumPy
evaluates them for measured trials, because a program of JAX for each order would compile
for longer than the fit takes.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.host import on_host
from ..._utils.types import Matrix, Pose, Scalar, Twist
from ...geometry import se2
from ..evaluation import AnyArray, power_derivatives
from ..monomials import Powers


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

    # Axial force at which the terms are evaluated; N
    axial_forces: Float[AnyArray, " trials"]
    # Contributions to the derivative with respect to the rotation; N m
    moment: Float[AnyArray, "trials terms"]
    # Contributions to the derivative with respect to the transverse displacement; N
    transverse_force: Float[AnyArray, "trials terms"]
    # Contributions to the axial displacement; m
    axial_displacement: Float[AnyArray, "trials terms"]
    # Contributions to the derivative of the axial displacement with respect to the axial
    # force; m/N
    axial_compliance: Float[AnyArray, "trials terms"]
    # Derivatives of `moment` with respect to the axial force; m
    moment_sensitivity: Float[AnyArray, "trials terms"]
    # Derivatives of `transverse_force` with respect to the axial force; dimensionless
    transverse_sensitivity: Float[AnyArray, "trials terms"]
    energy: Float[AnyArray, "trials terms"]  # Contributions to W; J


def mixed_equations(
    powers: Powers,
    twists: Float[AnyArray, "trials 3"],
    axial_forces: Float[AnyArray, " trials"],
    length: Scalar | float,
    force: Scalar | float,
) -> MixedEquations:
    """Evaluate each term of W and its derivatives at many twists and axial forces.

    Args:
        powers: Powers of rotation, transverse displacement over `length`, and axial force
            over `force`.
        twists: Twist of each trial; rad, m, m.
        axial_forces: Axial force of each trial, measured or predicted; N.
        length: Reference length; m.
        force: Reference force; N.
    """
    xp, arrays = on_host(twists, axial_forces, length, force)
    twists, axial_forces, length, force = arrays
    rotations, _, transverse = twists.T
    exponents = np.array(powers)
    force_ratios = axial_forces / force
    inside = xp.clip(force_ratios, -1.0, 1.0)
    variables = rotations, transverse / length, inside
    (t, dt, _), (y, dy, _), (n, dn, ddn) = (
        power_derivatives(values, exponents[:, k]) for k, values in enumerate(variables)
    )
    # Outside of the reference force, W is continued by a parabola; see `MixedEnergy`.
    outside = (force_ratios - inside)[:, None]
    n, dn = n + outside * (dn + outside * ddn / 2), dn + outside * ddn
    return MixedEquations(
        axial_forces,
        moment=dt * y * n,
        transverse_force=t * dy * n / length,
        axial_displacement=-t * y * dn / force,
        axial_compliance=-t * y * ddn / force**2,
        moment_sensitivity=dt * y * dn / force,
        transverse_sensitivity=t * dy * dn / (length * force),
        energy=t * y * n,
    )


def weighted_equations(
    trials: MixedTrials,
    equations: MixedEquations,
    coefficients: Float[AnyArray, " terms"] | None,
) -> tuple[Float[AnyArray, "trials 3 terms"], Float[AnyArray, "trials 3"]]:
    """Weight the equations so that their residuals are errors of the wrench.

    An error of the axial displacement is equivalent to an error of the axial force, by
    the axial compliance, and through it to errors of the moment and the transverse force.
    The compliance and these errors depend on the coefficients, so the least-squares
    problem is solved again with the coefficients of the previous solution. If the terms
    are evaluated at the axial forces that these coefficients predict, this is a
    Gauss-Newton step for the errors of the predicted wrenches.

    Args:
        coefficients: Coefficients of the previous solution, or `None` at first; J.

    Returns:
        The matrix and the right-hand side of the least-squares problem.
    """
    xp, _ = on_host(equations.moment)
    axial_displacements, axial_forces = trials.twists[:, 1], equations.axial_forces
    if coefficients is None:
        rms = xp.sqrt(xp.mean(axial_forces**2))
        estimate = xp.std(axial_displacements) / xp.where(rms > 0, rms, 1.0)
        estimate = xp.where(estimate > 0, estimate, 1.0)
        compliance = xp.full_like(axial_forces, estimate)
        by_moment = by_transverse_force = xp.zeros_like(axial_forces)
    else:
        compliance = equations.axial_compliance @ coefficients
        compliance = xp.maximum(compliance, 1e-3 * xp.median(xp.abs(compliance)))
        by_moment = equations.moment_sensitivity @ coefficients
        by_transverse_force = equations.transverse_sensitivity @ coefficients
    axial_rows = -equations.axial_displacement / compliance[:, None]
    axial_targets = -axial_displacements / compliance
    rows = [
        equations.moment + by_moment[:, None] * axial_rows,
        axial_rows,
        equations.transverse_force + by_transverse_force[:, None] * axial_rows,
    ]
    targets = [
        trials.stresses[:, 0] + by_moment * axial_targets,
        trials.stresses[:, 1] - axial_forces + axial_targets,
        trials.stresses[:, 2] + by_transverse_force * axial_targets,
    ]
    return (
        trials.to_wrenches @ xp.stack(rows, axis=1),
        xp.einsum("sij,sj->si", trials.to_wrenches, xp.stack(targets, axis=1)),
    )


@jax.jit
def twists_and_stresses(
    poses: Float[Array, "trials 3"],
    wrenches: Float[Array, "trials 3"],
    deviations: Float[Array, "trials 3"],
) -> MixedTrials:
    """Convert poses and wrenches to twists and generalized stresses.

    The generalized stress is the derivative of the energy with respect to the twist. Its
    second component is the axial force.

    Args:
        poses: Poses of frame b relative to frame a; rad, m, m.
        wrenches: Wrenches that body B exerts, in frame b; N m, N, N.
        deviations: Standard deviations of the wrenches; N m, N, N.
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
