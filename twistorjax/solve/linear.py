"""Linearization of a mechanism about an equilibrium."""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp

from .._utils.types import DofsMatrix, EntriesMatrix, Flag, Poses
from .._utils.validation import require_float64
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Drive, Load, loaded_bodies, LoadSet, prescribed_dofs
from ..mechanism.mechanism import Mechanism
from .consistency import independent
from .dofs import DofPartition
from .factorization import ConstrainedFactors, Factors
from .results import RESULTS
from .statics import Equilibrium, raise_error, state_in_range, StateLike
from .system import System


class Linearization(eqx.Module):
    """The linear map from small loads and drives to displacements and reactions.

    The tangent stiffness is factored once. A call returns an `Equilibrium` whose
    displacements, reactions, and constraint forces are the changes from the state, to
    first order. Its energy is half the product of displacements and forces: in the
    reference configuration the energy stored in the hinges, about a loaded state the
    second-order change of the total potential.

    Args:
        mechanism: The mechanism.
        about: Poses of the state; rad, m, m.
        matrix: Tangent stiffness among all degrees of freedom; N m/rad, N/rad, N/m.
        jacobian: Derivatives of the constraint violations by all degrees of freedom.
        factors: Factors of the stiffness of the free degrees of freedom.
        finite: Whether the matrices are finite.
        consistent: Whether the constraints are independent.
        dofs: Partition of the degrees of freedom.
        constraint_names: Name of the constraint of each constraint entry.
    """

    mechanism: Mechanism
    about: Poses
    matrix: DofsMatrix
    jacobian: EntriesMatrix
    factors: Factors | ConstrainedFactors
    finite: Flag
    consistent: Flag
    dofs: DofPartition = eqx.field(static=True)
    constraint_names: tuple[str, ...] = eqx.field(static=True)

    def __call__(
        self,
        *,
        loads: Sequence[Load] = (),
        drives: Sequence[Drive] = (),
        throw: bool = True,
    ) -> Equilibrium:
        """Compute the change of the equilibrium under small loads and drives.

        Args:
            loads: Small loads, in addition to those that act at the state.
            drives: Small prescribed displacements of the coordinates that were named to
                `linearize`, all of them.
            throw: Whether a failure raises an error; otherwise it is reported by
                `result`.

        Returns:
            The changes of displacements, reactions, and constraint forces.

        Raises:
            ValueError: The prescribed coordinates are not those that were named, or a
                name is unknown.
            RuntimeError: The state is not stable, or a value is not finite.
        """
        mechanism, count = self.mechanism, len(self.dofs.free)
        prescribed, targets = prescribed_dofs(mechanism, drives)
        if sorted(prescribed) != sorted(self.dofs.prescribed):
            raise ValueError(
                f"`drives` prescribes {_listed(mechanism, prescribed)}, but this map was "
                f"made by `linearize` for {_listed(mechanism, self.dofs.prescribed)}."
            )
        loaded_bodies(mechanism, loads)
        applied, _ = LoadSet.of(loads, mechanism.names, mechanism.reference).apply(
            self.about - mechanism.reference
        )
        applied = applied.reshape(-1)
        given = DofPartition(self.dofs.total, self.dofs.free, prescribed)
        moved = given.expand(jnp.zeros(count), jnp.array(targets, float)).reshape(-1)
        free = jnp.array(self.dofs.free, int)
        right = (applied - self.matrix @ moved)[free]
        push, constraint = jnp.zeros(0), jnp.zeros_like(moved)
        if self.constraint_names:
            right = jnp.concatenate([right, -self.jacobian @ moved])
        solution = self.factors.solve(right)
        flat = moved.at[free].set(solution[:count])
        if self.constraint_names:
            push = -solution[count:]
            constraint = push @ self.jacobian
        forces = self.matrix @ flat
        stable = self.factors.resists()
        result = RESULTS.where(stable, RESULTS.successful, RESULTS.unstable)
        dependent = RESULTS.inconsistent_constraints
        result = RESULTS.where(self.consistent, result, dependent)
        finite = self.finite & jnp.all(jnp.isfinite(applied))
        result = RESULTS.where(finite, result, RESULTS.not_finite)
        displacements = flat.reshape(self.about.shape)
        change = Equilibrium(
            displacements=displacements,
            reference=self.about,
            reactions=given.reactions(forces - applied - constraint),
            constraint_forces=push,
            energy=jnp.vdot(flat, forces) / 2,
            reached=displacements,
            fraction=jnp.ones(()),
            steps=jnp.zeros((), int),
            result=result,
            names=mechanism.names,
            constraint_names=self.constraint_names,
        )
        return raise_error(change) if throw else change


def linearize(
    mechanism: Mechanism,
    prescribed: Sequence[str] | Mapping[str, Sequence[str]] = (),
    *,
    about: StateLike | None = None,
    loads: Sequence[Load] = (),
    constraints: Sequence[AbstractConstraint] = (),
) -> Linearization:
    """Linearize a mechanism about an equilibrium, and factor its tangent stiffness.

    Args:
        mechanism: The mechanism.
        prescribed: Coordinates whose displacement will be prescribed: names of bodies for
            all three coordinates, or a mapping from names to some of "angle", "x", "y".
        about: Equilibrium about which the mechanism is linearized, or its poses; by
            default the reference configuration; rad, m, m.
        loads: Loads that act at this equilibrium. They add to the stiffness because
            their moments and directions depend on the rotations.
        constraints: Pins, sliders, and other constraints between the bodies.

    Returns:
        The linear map, a function of loads and drives.

    Raises:
        ValueError: Double precision is off, or a name is unknown.

    Example:
        >>> from twistorjax import Body, Hinge, Mechanism, Quadratic
        >>> spring = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0])))
        >>> hinge = Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
        >>> mechanism = Mechanism([Body("wall"), Body("block")], [hinge], fixed=["wall"])
        >>> small = linearize(mechanism, prescribed={"block": ["y"]})
        >>> small(drives=[Drive("block", y=1e-3)]).reaction("block")
        Array([0.  , 0.  , 0.01], dtype=float64)
    """
    require_float64(mechanism.reference)
    dofs = mechanism.coordinates("prescribed", prescribed)
    if both := sorted(set(dofs) & set(mechanism.fixed)):
        raise ValueError(
            f"`prescribed` has the {_listed(mechanism, both)}, but that is fixed already."
        )
    dofs = DofPartition.of(mechanism, dofs)
    system = System.of(mechanism, dofs, loads, constraints)
    mechanism.require_support(system.constraints.bodies)
    displacements = state_in_range(mechanism, "about", about)
    matrix, jacobian = system.whole_stiffness(displacements)
    free = system.free
    factors = system.factors(matrix[free[:, None], free], jacobian[:, free])
    return Linearization(
        mechanism=mechanism,
        about=mechanism.reference + displacements,
        matrix=matrix,
        jacobian=jacobian,
        factors=factors,
        finite=jnp.all(jnp.isfinite(matrix)) & jnp.all(jnp.isfinite(jacobian)),
        consistent=independent(system, displacements),
        dofs=dofs,
        constraint_names=system.constraints.names(),
    )


def _listed(mechanism: Mechanism, dofs: Sequence[int]) -> str:
    """Name coordinates in words."""
    return " and ".join(mechanism.coordinate(dof) for dof in sorted(dofs)) or "nothing"
