"""Linearization of a mechanism about an equilibrium."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._compile.compilation import fast_compile
from .._utils.host import concrete
from .._utils.progress import announced
from .._utils.types import Entries, Flag, NumberLike, PoseLike, Poses, Scalar, Wrenches
from ..linalg.constraints import BorderedFactors, ConstrainedFactors
from ..linalg.factors import Elimination, Factors
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Drive, Load, LoadSet, prescribed_dofs
from ..mechanism.mechanism import Mechanism
from ..mechanism.misfits import stroke_forces, stroke_rows
from ..results.codes import (
    finish,
    RESULTS,
)
from ..results.solutions import PoseSolution
from ..results.tables import Column, Columns
from .equations.consistency import consistent
from .equations.dofs import DofPartition
from .equations.problem import Problem
from .equations.system import System
from .statics.solution import StateLike


class LinearResponse(PoseSolution):
    """First-order changes from the equilibrium about which a mechanism is linearized.

    Args:
        displacements: Change of the displacement of each body; rad, m, m.
        reference: Poses of the equilibrium, from which it is measured; rad, m, m.
        reactions: Change of the external wrench on the fixed and prescribed degrees of
            freedom of each body, about the origin of the body and in world axes; zero for
            free degrees of freedom; N m, N, N.
        constraint_forces: Change of the constraint forces, one for each scalar equation
            of the constraints; N m, N.
        energy: Half the product of displacements and forces; J. For a linearization about
            the reference configuration, it is the energy stored in the hinges; about a
            loaded equilibrium, the second-order change of the total potential energy.
        strokes: Strokes of all hinges; None if there are none; rad, m, m.
        result: `RESULTS.successful` or the reason of the failure; `result_names` returns
            its name.
        names: Names of the bodies.
        constraint_names: Name of the constraint to which each scalar equation belongs.
    """

    displacements: Poses
    reference: Poses
    reactions: Wrenches
    constraint_forces: Entries
    energy: Scalar
    strokes: Float[Array, "*batch hinges 3"] | None
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)
    constraint_names: tuple[str, ...] = eqx.field(static=True)
    _plural: ClassVar[str] = "linear responses"

    def columns(self) -> Columns:
        return {**self._body_columns(), "energy": Column(self.energy, (), "J")}

    def _summary(self, names: np.ndarray) -> str:
        title = f"{names}: {float(self.energy):.6g} J"
        return self._listed(title, "body", np.asarray(self.displacements))


class Linearization(eqx.Module):
    """Linear map from small loads and prescribed displacements to the response.

    Call it as `linear(loads=..., drives=..., strokes=..., throw=...)`. The tangent
    stiffness is computed once. A call returns a `LinearResponse`.

    Args:
        mechanism: The mechanism.
        about: Poses of the equilibrium about which the mechanism was linearized; rad, m,
            m.
        matrix: Tangent stiffness with respect to all degrees of freedom; N m/rad, N/rad,
            N/m.
        jacobian: Derivatives of the constraint violations with respect to all degrees of
            freedom.
        factors: Factors of the stiffness of the free degrees of freedom.
        finite: Whether the matrices are finite.
        consistent: Whether the constraints are independent and satisfied.
        dofs: Partition of the degrees of freedom.
        constraint_names: Name of the constraint to which each scalar equation belongs.
    """

    mechanism: Mechanism
    about: Poses
    matrix: Float[Array, "dofs dofs"]
    jacobian: Float[Array, "entries dofs"]
    factors: Factors | Elimination | ConstrainedFactors | BorderedFactors
    finite: Flag
    consistent: Flag
    dofs: DofPartition = eqx.field(static=True)
    constraint_names: tuple[str, ...] = eqx.field(static=True)

    def __repr__(self) -> str:
        return f"linearization of: {self.mechanism!r}"

    def __call__(
        self,
        *,
        loads: Sequence[Load] = (),
        drives: Sequence[Drive] = (),
        strokes: Mapping[str, PoseLike] = MappingProxyType({}),
        throw: bool = True,
    ) -> LinearResponse:
        """Compute the first-order response.

        Args:
            loads: Small loads, in addition to those that act at the equilibrium.
            drives: Small prescribed displacements. They must be given for all coordinates
                that were named as `prescribed` in `linearize`; rad, m.
            strokes: Small strokes of actuators, by the names of their hinges; see
                `Mechanism.with_strokes`; rad, m, m.
            throw: Whether a failure raises an error; otherwise it is reported by
                `result`.

        Returns:
            The changes of displacements, reactions, and constraint forces.

        Raises:
            ValueError: The prescribed coordinates are not those that were named, or a
                name is unknown.
            RuntimeError: The equilibrium is not stable, the constraints are not
                independent, or a value is not finite.
        """
        mechanism = self.mechanism
        prescribed, targets = prescribed_dofs(mechanism, drives)
        if sorted(prescribed) != sorted(self.dofs.prescribed):
            raise ValueError(
                f"`drives` prescribes {_listed(mechanism, prescribed)}, but this map was "
                f"made by `linearize` for {_listed(mechanism, self.dofs.prescribed)}. "
                "Name the coordinates of all drives as `prescribed` of `linearize`."
            )
        load_set = LoadSet.of(mechanism, loads)
        rows = stroke_rows(mechanism.hinge_names, strokes) if strokes else None
        response = _respond(self, load_set, rows, targets, prescribed)
        return finish(response, throw)


@fast_compile
def _respond(
    linear: Linearization,
    loads: LoadSet,
    strokes: Float[Array, "hinges 3"] | None,
    targets: tuple[Scalar, ...],
    prescribed: tuple[int, ...],
) -> LinearResponse:
    """Compute the response to loads, strokes, and prescribed displacements; rad, m."""
    mechanism, count = linear.mechanism, len(linear.dofs.free)
    displacements = linear.about - mechanism.reference
    applied, _ = loads.apply(displacements)
    if strokes is not None:
        hinges = mechanism.hinge_assembly
        applied = applied - stroke_forces(hinges, displacements, strokes)[0]
    applied = applied.reshape(-1)
    dofs = DofPartition(linear.dofs.total, linear.dofs.free, prescribed)
    imposed = dofs.expand(jnp.zeros(count), jnp.array(targets, float)).reshape(-1)
    free = np.array(dofs.free, int)
    right = (applied - linear.matrix @ imposed)[free]
    multipliers, constraint = jnp.zeros(0), jnp.zeros_like(imposed)
    if linear.constraint_names:
        right = jnp.concatenate([right, -linear.jacobian @ imposed])
    solution, stable = linear.factors.solve_and_check(right)
    flat = imposed.at[free].set(solution[:count])
    if linear.constraint_names:
        multipliers = -solution[count:]
        constraint = multipliers @ linear.jacobian
    forces = linear.matrix @ flat
    result = RESULTS.where(stable, RESULTS.successful, RESULTS.unstable)
    finite = linear.finite & jnp.all(jnp.isfinite(applied))
    result = RESULTS.where(finite, result, RESULTS.not_finite)
    # The matrices of redundant constraints are not finite.
    inconsistent = RESULTS.inconsistent_constraints
    result = RESULTS.where(linear.consistent, result, inconsistent)
    return LinearResponse(
        displacements=flat.reshape(linear.about.shape),
        reference=linear.about,
        reactions=dofs.reactions(forces - applied - constraint),
        constraint_forces=multipliers,
        energy=jnp.vdot(flat, forces) / 2,
        strokes=strokes,
        result=result,
        names=mechanism.names,
        constraint_names=linear.constraint_names,
    )


@announced("linearization")
def linearize(
    mechanism: Mechanism,
    prescribed: Sequence[str] | Mapping[str, Sequence[str]] = (),
    *,
    about: StateLike | None = None,
    loads: Sequence[Load] = (),
    constraints: Sequence[AbstractConstraint] = (),
    time: NumberLike = 0.0,
) -> Linearization:
    """Linearize a mechanism about an equilibrium.

    Args:
        mechanism: The mechanism.
        prescribed: Coordinates whose displacement will be prescribed: names of bodies for
            all three coordinates, or a mapping from names to some of "angle", "x", "y".
        about: Equilibrium about which the mechanism is linearized, or its poses; by
            default the reference configuration; rad, m, m.
        loads: Loads that act at this equilibrium. They contribute to the tangent
            stiffness, because their moments, and the directions of follower loads, depend
            on the rotations of the bodies.
        constraints: Pins, sliders, and other constraints between the bodies. They must be
            satisfied at the equilibrium.
        time: Time at which time-dependent constraints are evaluated, by default zero; s.

    Returns:
        The linear map. Call it with `loads` and `drives`; it returns a `LinearResponse`.

    Raises:
        ValueError: Double precision is disabled, a name is unknown, a coordinate in
            `prescribed` is fixed, a hinge is outside the validity range of its energy,
            the state is not an equilibrium under the loads, or the constraints are not
            independent or not satisfied.

    Example:
        >>> import jax.numpy as jnp
        >>> from twistorjax import Body, Drive, Hinge, linearize, Mechanism, Quadratic
        >>> spring = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0])))
        >>> hinge = Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
        >>> mechanism = Mechanism([Body("wall"), Body("block")], [hinge], fixed=["wall"])
        >>> small = linearize(mechanism, prescribed={"block": ["y"]})
        >>> small(drives=[Drive("block", y=1e-3)]).reaction("block")
        Array([0.  , 0.  , 0.01], dtype=float64)
    """
    return linearize_held(mechanism, (), prescribed, about, loads, constraints, time)


def linearize_held(
    mechanism: Mechanism,
    held: tuple[int, ...],
    prescribed: Sequence[str] | Mapping[str, Sequence[str]],
    about: StateLike | None,
    loads: Sequence[Load],
    constraints: Sequence[AbstractConstraint],
    time: NumberLike,
) -> Linearization:
    """Linearize a mechanism about an equilibrium; see `linearize`.

    Unknown constant forces may act on the degrees of freedom `held` at this equilibrium.
    """
    dofs = mechanism.dofs_of("prescribed", prescribed)
    if both := sorted(set(dofs) & set(mechanism.fixed)):
        raise ValueError(
            f"`prescribed` names {_listed(mechanism, both)}, but fixed coordinates "
            "cannot be prescribed: remove them."
        )
    problem = Problem.of(mechanism, loads, (), constraints, time, held=dofs)
    system, displacements = problem.system, problem.state(about, held=held)
    is_consistent = consistent(system, displacements)
    if concrete(is_consistent) is not None and not is_consistent:
        raise problem.inconsistency(displacements)
    return _linearize(mechanism, system, displacements, is_consistent)


@fast_compile
def _linearize(
    mechanism: Mechanism, system: System, displacements: Poses, is_consistent: Flag
) -> Linearization:
    """Factorize the stiffness at given displacements; rad, m, m."""
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
        consistent=is_consistent,
        dofs=system.dofs,
        constraint_names=system.constraints.names(),
    )


def _listed(mechanism: Mechanism, dofs: Sequence[int]) -> str:
    """Return the names of degrees of freedom for a message."""
    return " and ".join(mechanism.dof_name(dof) for dof in sorted(dofs)) or "nothing"
