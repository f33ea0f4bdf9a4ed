"""Checks of states: whether constraints are satisfied, and forces are in equilibrium."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._compile.compilation import fast_compile
from ..._utils.host import all_concrete
from ..._utils.pytrees import stop_gradient
from ..._utils.types import Entries, Flag, NumberLike, Poses, PosesOrResult, Scalar
from ...linalg.elimination import inverse
from ...mechanism.constraints import ConstraintSet
from ...mechanism.mechanism import COORDINATES, Mechanism
from .dofs import DofPartition
from .system import System


# Violations of the constraints up to this size are rounding errors: in rad, and in
# lengths of the mechanism.
LARGEST_INITIAL_VIOLATION = 1e-9
_LARGEST_INVERSE = 1e12  # of the Gram matrix of independent constraints
# In equilibrium, an unbalanced force is below one of these limits: this fraction of the
# largest force, the force that changes the energy by the square of this fraction, or what
# rounding of the poses by this fraction causes.
_LARGEST_IMBALANCE, _LARGEST_DECREMENT = 1e-4, 1e-6
_ROUNDING = 64 * np.finfo(float).eps


def require_equilibrium(
    mechanism: Mechanism,
    system: System,
    displacements: Poses,
    state: PosesOrResult | None,
    loads: str = "loads",
    held: tuple[int, ...] = (),
) -> Poses:
    """Check that a state about which a mechanism is linearized is an equilibrium.

    Args:
        state: The argument `about`; None for the reference configuration.
        loads: Name of the argument with the loads, for the message.
        held: Degrees of freedom on which unknown constant forces may act.

    Returns:
        The displacements; NaN if the state is traced and not an equilibrium.

    Raises:
        ValueError: The state is not an equilibrium, and not traced.
    """
    frozen = stop_gradient((system, mechanism.reference, displacements))
    excess, residual = _imbalance(*frozen)
    counts = ~np.isin(system.free, held)
    unbalanced = (excess > 1) & counts & consistent(system, displacements)
    known = all_concrete([unbalanced, excess, residual])
    if known is None:
        return jnp.where(jnp.any(unbalanced), jnp.nan, displacements)
    flags, excess, residual = known
    if not np.any(flags):
        return displacements
    worst = int(np.nanargmax(excess * counts))
    dof, value = system.free[worst], float(residual[worst])
    force = "a moment of {:.4g} N m"
    if dof % 3:
        force = f"a force of {{:.4g}} N along {COORDINATES[dof % 3]}"
    subject = "The reference configuration" if state is None else "`about`"
    raise ValueError(
        f"{subject} is not an equilibrium under the given `{loads}`: on the body "
        f"{mechanism.names[dof // 3]!r}, {force.format(-value)} is not balanced. Give "
        f"`about=equilibrium(mechanism, loads={loads})`, and the loads, constraints, and "
        "prescribed coordinates of this equilibrium."
    )


@fast_compile
def _imbalance(
    system: System, reference: Poses, displacements: Poses
) -> tuple[Float[Array, " free"], Float[Array, " free"]]:
    """Compute the forces on free degrees of freedom that are not balanced; N m, N.

    The first result is their ratio to the largest ones that occur in equilibrium.
    """
    hinges, multipliers = system.hinges, system.constraint_forces(displacements)
    tangent = hinges.tangent(displacements)
    applied = system.loads.apply(displacements)[0].reshape(-1)
    if system.constraints.size:
        constraint = system.constraints.forces(displacements, system.time, multipliers)
        applied = applied + constraint
    residual = tangent.forces() - applied
    units = jnp.tile(system.units(), len(displacements))
    length = units[-1]
    scales = jnp.stack([jnp.ones(()), jnp.ones(()), length, length])  # of four motions
    of_hinges = jnp.abs(jnp.stack(tangent.each.forces)) * scales[:, None]
    largest = jnp.maximum(jnp.max(of_hinges), jnp.max(jnp.abs(applied) * units))
    magnitudes = jnp.abs(tangent.hinge_stiffness())
    stiffness = hinges.multiply_stiffness(magnitudes, units)
    # Also a displacement that ought to be zero has a rounding error, of these units.
    poses = jnp.abs(reference) + jnp.abs(displacements)
    rounding = hinges.multiply_stiffness(magnitudes, poses.reshape(-1) + units)
    allowed = jnp.maximum(_LARGEST_IMBALANCE * largest, _ROUNDING * rounding * units)
    by_energy = _LARGEST_DECREMENT * jnp.sqrt(tangent.work * stiffness * units)
    allowed = jnp.maximum(allowed, by_energy)
    # Constraints pass rounding errors on to bodies that no hinge holds.
    allowed = jnp.maximum(allowed, _ROUNDING**2 * jnp.max(stiffness * units))
    excess = jnp.abs(residual) * units / jnp.where(allowed > 0, allowed, 1.0)
    return excess[system.free], residual[system.free]


def independent_rows(jacobian: Float[Array, "entries n"]) -> Flag:
    """Decide whether the rows of a constraint Jacobian are linearly independent.

    Its columns must be scaled by the units of the degrees of freedom.
    """
    if len(jacobian) > jacobian.shape[1]:
        return jnp.zeros((), bool)
    rows = jacobian / jnp.linalg.norm(jacobian, axis=1, keepdims=True)
    return jnp.max(jnp.abs(inverse(rows @ rows.T)), initial=0.0) < _LARGEST_INVERSE


def consistent_rows(
    jacobian: Float[Array, "entries n"], violation: Float[Array, " entries"]
) -> Flag:
    """Decide whether constraints are independent and satisfied.

    The columns of the Jacobian must be scaled by the units of the degrees of freedom. The
    violation of each constraint (rad or m) is divided by the norm of its row, so that
    units do not matter. Values that are not finite count as consistent; solvers report
    `not_finite`.
    """
    size = jnp.linalg.norm(jacobian, axis=1)
    scaled = jnp.abs(violation) / jnp.where(size > 0, size, 1.0)
    satisfied = jnp.all(scaled <= LARGEST_INITIAL_VIOLATION)
    finite = jnp.all(jnp.isfinite(jacobian)) & jnp.all(jnp.isfinite(violation))
    return (independent_rows(jacobian) & satisfied) | ~finite


def independent(system: System, displacements: Poses) -> Flag:
    """Decide whether constraints are independent at given displacements; rad, m, m.

    Derivatives that are not finite count as independent; solvers report `not_finite`.
    """
    if not system.constraints.size:
        return jnp.ones((), bool)
    scaled = _scaled_jacobian(system, displacements)
    return independent_rows(scaled) | ~jnp.all(jnp.isfinite(scaled))


def consistent(system: System, displacements: Poses) -> Flag:
    """Decide whether constraints are independent, and satisfied by displacements.

    The displacements (rad, m, m) are those of a state about which a mechanism is
    linearized.
    """
    if not system.constraints.size:
        return jnp.asarray(True)
    return _consistent(system, displacements)


@fast_compile
def _consistent(system: System, displacements: Poses) -> Flag:
    """Decide whether constraints, of which there are some, are consistent."""
    jacobian = _scaled_jacobian(system, displacements)
    return consistent_rows(jacobian, system.violation(displacements))


def _scaled_jacobian(
    system: System, displacements: Poses
) -> Float[Array, "entries free"]:
    """Differentiate constraints with respect to displacements divided by their units."""
    jacobian = system.jacobian(displacements)[:, system.free]
    return jacobian * system.free_units()[None]


def characteristic_length(mechanism: Mechanism) -> float:
    """Compute the length of a mechanism by which displacements are scaled; m."""
    free = DofPartition.of(mechanism).free
    return float(mechanism.hinge_assembly.characteristic_length(free)) or 1.0


@fast_compile
def _linearized(
    constraints: ConstraintSet, displacements: Poses, time: Scalar
) -> tuple[Entries, Float[Array, "entries dofs"]]:
    """Compute the violations of constraints, and their derivatives."""
    jacobian = constraints.jacobian(displacements, time)
    return constraints.violation(displacements, time), jacobian


def constraint_error(
    constraints: ConstraintSet,
    dofs: DofPartition,
    mechanism: Mechanism,
    displacements: Poses,
    time: NumberLike = 0.0,
) -> str:
    """Describe the constraints that are violated, redundant, or contradictory.

    They are evaluated at given displacements (rad, m, m) and a time (s). The result has
    one sentence for each such constraint, and is empty if there is none.
    """
    now = jnp.asarray(time, float)
    violation, jacobian = map(np.asarray, _linearized(constraints, displacements, now))
    units = np.where(np.array(dofs.free) % 3 == 0, 1.0, characteristic_length(mechanism))
    jacobian = jacobian[:, list(dofs.free)] * units[None]
    size = np.linalg.norm(jacobian, axis=1)
    size = np.where(size > 0, size, 1.0)
    jacobian, scaled_violation = jacobian / size[:, None], np.abs(violation) / size
    names = constraints.names()
    sentences = []
    for name in dict.fromkeys(names):
        rows = [k for k, owner in enumerate(names) if owner == name]
        previous = jacobian[: rows[0]]
        rank = np.linalg.matrix_rank(previous, 1e-9) if len(previous) else 0
        new_rank = np.linalg.matrix_rank(jacobian[: rows[-1] + 1], 1e-9) - rank
        largest = np.abs(violation[rows]).max()
        violated = scaled_violation[rows].max() > LARGEST_INITIAL_VIOLATION
        if new_rank < len(rows) and violated:
            sentences.append(
                f"{name!r} contradicts the previous constraints: no displacement removes "
                f"its violation of {largest:.3g}."
            )
        elif new_rank < len(rows):
            sentences.append(
                f"{name!r} is redundant: {len(rows) - new_rank} of its {len(rows)} "
                "equations follow from the previous constraints and from fixed or "
                "prescribed coordinates. Leave it out."
            )
        elif violated:
            sentences.append(f"{name!r} is violated by {largest:.3g}.")
    return " ".join(sentences)
