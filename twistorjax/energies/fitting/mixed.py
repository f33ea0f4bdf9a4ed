"""Fit of a `MixedEnergy` to trials.

The axial force of a trial is known from its wrench. The moment, the transverse force and
the axial displacement are derivatives of the mixed potential W, so they are linear in its
coefficients.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.types import Matrix, Pose, Scalar, Twist
from ...geometry import se2
from ..evaluation import power_derivatives
from ..mixed import MixedEnergy
from ..monomials import Powers
from .least_squares import ConstrainedSolution, solve_constrained, solve_stable
from .trials import Trials


class MixedTerms(NamedTuple):
    """Contributions of each term of W, for a coefficient of one joule.

    Args:
        moment: Contribution to the derivative with respect to the rotation; N m.
        transverse_force: Contribution to the derivative with respect to the transverse
            displacement; N.
        axial_displacement: Contribution to the axial displacement; m.
        axial_compliance: Contribution to the derivative of the axial displacement with
            respect to the axial force; m/N.
        force_sensitivity: Derivatives of `moment` and `transverse_force` with respect to
            the axial force; N m/N and dimensionless.
        energy: Contribution to W; J.
    """

    moment: Float[Array, "trials terms"]
    transverse_force: Float[Array, "trials terms"]
    axial_displacement: Float[Array, "trials terms"]
    axial_compliance: Float[Array, "trials terms"]
    force_sensitivity: tuple[Float[Array, "trials terms"], Float[Array, "trials terms"]]
    energy: Float[Array, "trials terms"]


@partial(jax.jit, static_argnums=0)
def mixed_terms(
    powers: Powers,
    twists: Float[Array, "trials 3"],
    axial_forces: Float[Array, " trials"],
    length: Scalar | float,
    force: Scalar | float,
) -> MixedTerms:
    """Evaluate each term of W and its derivatives at many twists and axial forces.

    Args:
        powers: Powers of rotation, transverse displacement over `length`, and axial force
            over `force`.
        twists: Twists; rad, m, m.
        axial_forces: Axial forces; N.
        length: Reference length; m.
        force: Reference force; N.

    Returns:
        The contributions of each term.
    """
    rotations, _, transverse = twists.T
    exponents = np.array(powers)
    (t, dt, _), (y, dy, _), (n, dn, ddn) = (
        power_derivatives(values, exponents[:, k])
        for k, values in enumerate((rotations, transverse / length, axial_forces / force))
    )
    return MixedTerms(
        moment=dt * y * n,
        transverse_force=t * dy * n / length,
        axial_displacement=-t * y * dn / force,
        axial_compliance=-t * y * ddn / force**2,
        force_sensitivity=(dt * y * dn / force, t * dy * dn / (length * force)),
        energy=t * y * n,
    )


def twist_and_stress_matrix(pose: Pose) -> tuple[Twist, Matrix]:
    """Compute the twist of a pose, and the matrix from wrench to generalized stress.

    The generalized stress is the derivative of the energy with respect to the twist. Its
    second component is the axial force.

    Args:
        pose: Pose of frame b relative to frame a; rad, m, m.

    Returns:
        The twist (rad, m, m), and the matrix that maps the wrench on frame b to the
        generalized stress.
    """
    twist = se2.twist(pose)
    rotate_rows = jax.vmap(lambda row: se2.rotate(-pose[0], row))
    jacobian = jax.jacfwd(se2.exp)(twist)
    body_jacobian = jnp.concatenate([jacobian[:1], rotate_rows(jacobian[1:].T).T])
    return twist, body_jacobian.T


def fit_mixed(
    trials: Trials,
    powers: Powers,
    *,
    reference: str,
    ridge: float | None,
    scale: float | None,
) -> tuple[MixedEnergy, ConstrainedSolution]:
    """Fit a mixed energy to trials.

    An error of the axial displacement is equivalent to an error of the axial force, by
    the axial compliance, and through it to errors of the moment and the transverse force.
    The axial compliance results from the previous of four fits.

    Args:
        trials: Trials with wrenches.
        powers: Powers of the terms of W.
        reference: Condition in the reference configuration; see `fit_energy`.
        ridge: Ridge parameter; see `fit_energy`.
        scale: Reference length, by default the largest transverse displacement; m.

    Returns:
        The energy, and the solution of the least-squares problem.

    Raises:
        ValueError: The trials have no wrenches.
    """
    if trials.wrenches is None:
        raise ValueError(
            "`trials` have energies but no wrenches. A fit in the coordinates 'mixed' "
            "needs the wrench of each trial, because the axial force is a component of "
            "it. Use 'twistor' or 'twist'."
        )
    if reference != "free":
        powers = tuple(row for row in powers if sum(row) > 1)
    twists, matrices = map(np.asarray, jax.vmap(twist_and_stress_matrix)(trials.poses))
    stresses = np.einsum("sij,sj->si", matrices, np.asarray(trials.wrenches))
    axial_forces = stresses[:, 1]
    length = scale or _largest_magnitude(twists[:, 2])
    force = _largest_magnitude(axial_forces)
    terms = mixed_terms(
        powers, jnp.asarray(twists), jnp.asarray(axial_forces), length, force
    )
    terms = jax.tree.map(np.asarray, terms)
    deviations = np.asarray(trials.wrench_deviations)
    to_wrenches = np.linalg.inv(matrices) / deviations[:, :, None]
    curvature = _reference_curvature(powers, length, force)
    no_constraints = np.zeros((0, len(powers)))

    def fit_with(
        compliance: np.ndarray, sensitivities: Sequence[np.ndarray]
    ) -> ConstrainedSolution:
        """Fit with given axial compliances (m/N) and force sensitivities."""
        rows = np.stack(
            [
                terms.moment,
                -terms.axial_displacement / compliance[:, None],
                terms.transverse_force,
            ],
            axis=1,
        )
        axial_error = -twists[:, 1] / compliance
        targets = np.stack([stresses[:, 0], axial_error, stresses[:, 2]], axis=1)
        for component, sensitivity in zip((0, 2), sensitivities, strict=True):
            rows[:, component] += sensitivity[:, None] * rows[:, 1]
            targets[:, component] += sensitivity * targets[:, 1]
        rows = to_wrenches @ rows
        targets = np.einsum("sij,sj->si", to_wrenches, targets)
        if trials.energies is not None:
            deviations = np.asarray(trials.energy_deviations)[:, None]
            potentials = np.asarray(trials.energies) - axial_forces * twists[:, 1]
            rows = np.concatenate([rows, (terms.energy / deviations)[:, None]], axis=1)
            targets = np.concatenate([targets, potentials[:, None] / deviations], axis=1)
        if reference == "stable":
            return solve_stable(rows, targets, no_constraints, curvature, ridge)
        return solve_constrained(rows, targets, no_constraints, np.zeros(0), ridge)

    root_mean_square = np.sqrt(np.mean(axial_forces**2))
    estimate = np.std(twists[:, 1]) / (root_mean_square or 1.0) or 1.0
    zeros = np.zeros(len(trials))
    solution = fit_with(zeros + estimate, (zeros, zeros))
    for _ in range(3):
        coefficients = solution.coefficients
        compliance = terms.axial_compliance @ coefficients
        compliance = np.maximum(compliance, 1e-3 * np.median(np.abs(compliance)))
        solution = fit_with(
            compliance,
            [sensitivity @ coefficients for sensitivity in terms.force_sensitivity],
        )
    energy = MixedEnergy(solution.coefficients, powers, length=length, force=force)
    return energy, solution


def _largest_magnitude(values: np.ndarray) -> float:
    """Return the largest absolute value, or one if its square would underflow."""
    largest = float(np.abs(values).max())
    return largest if largest > 1e-150 else 1.0


def _reference_curvature(powers: Powers, length: float, force: float) -> np.ndarray:
    """Compute the matrix that is positive definite if the reference is stable.

    It holds the second derivatives of W with respect to rotation and transverse
    displacement, and minus that with respect to the axial force.

    Args:
        powers: Powers of the terms of W.
        length: Reference length; m.
        force: Reference force; N.

    Returns:
        The matrix for a coefficient of one joule of each term, in the last axis.
    """
    curvature = np.zeros((3, 3, len(powers)))
    for row, entries, value in (
        ((2, 0, 0), [(0, 0)], 2.0),
        ((1, 1, 0), [(0, 2), (2, 0)], 1 / length),
        ((0, 2, 0), [(2, 2)], 2 / length**2),
        ((0, 0, 2), [(1, 1)], -2 / force**2),
    ):
        if row in powers:
            for entry in entries:
                curvature[*entry, powers.index(row)] = value
    return curvature
