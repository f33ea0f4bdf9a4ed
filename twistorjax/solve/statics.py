"""Static equilibrium of a mechanism under loads and prescribed displacements."""

import warnings
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import TypeAliasType

from .._utils.compilation import fast_compile
from .._utils.host import all_concrete, concrete, program_input
from .._utils.pytrees import stop_gradient
from .._utils.types import Count, Entries, NumberLike, Poses, PosesLike, Scalar, Wrenches
from .._utils.validation import require_float64
from ..mechanism.constraints import AbstractConstraint, ConstraintSet, gather_constraints
from ..mechanism.hinge_assembly import HingeAssembly
from ..mechanism.loads import Drive, Load, LoadSet, prescribed_dofs
from ..mechanism.mechanism import Mechanism
from ..mechanism.support import require_support
from . import newton
from .consistency import constraint_error, independent
from .dofs import DofPartition
from .implicit_derivatives import differentiable_root
from .results import (
    count_results,
    PoseSolution,
    result_message,
    result_names,
    RESULTS,
    succeeded_or_raise,
)
from .stresses import report_stresses, reported_hinges, Stresses
from .system import System
from .tables import Column, Columns


# A stiffness below this fraction of the largest one does not count in messages.
_NO_STIFFNESS = 1e-12


class Equilibrium(PoseSolution):
    """A static equilibrium of a mechanism.

    If no equilibrium was found, displacements, reactions, constraint forces, and energy
    are NaN and their derivatives are zero, so that a batch can be masked by `succeeded`.

    Args:
        displacements: Displacement of each body from its reference pose; rad, m, m.
        reference: Poses from which displacements are measured; rad, m, m.
        reactions: External wrench on the fixed and prescribed degrees of freedom of each
            body, about the origin of the body and in world axes; zero for free degrees
            of freedom; N m, N, N.
        constraint_forces: Constraint forces, one for each scalar equation of the
            constraints; N m, N.
        energy: Energy stored in the hinges; J.
        reached: Displacements at the `fraction` that was reached; rad, m, m.
        fraction: Fraction of the loads and prescribed displacements that was reached:
            1, or less if the solve failed.
        steps: Number of Newton steps.
        range_shares: Displacement of each linear flexure, such as `flexures.leaf`,
            divided by the one at which its force or moment errs by 5 %; zero for other
            hinges; None if there are no linear flexures.
        result: `RESULTS.successful` or the reason of the failure; `result_names` returns
            its name.
        names: Names of the bodies.
        constraint_names: Name of the constraint to which each scalar equation belongs.
        strokes: Strokes of all hinges in a linear response to strokes; rad, m, m.
        stresses: Stresses in the hinges, if the `strength` of a material is given.
    """

    displacements: Poses
    reference: Poses
    reactions: Wrenches
    constraint_forces: Entries
    energy: Scalar
    reached: Poses
    fraction: Scalar
    steps: Count
    range_shares: Float[Array, "*batch hinges"] | None
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)
    constraint_names: tuple[str, ...] = eqx.field(static=True)
    strokes: Float[Array, "*batch hinges 3"] | None = None
    stresses: Stresses | None = None

    def columns(self) -> Columns:
        energy = Column(self.energy, (), "J")
        stresses = {} if self.stresses is None else self.stresses.columns()
        return {**self._body_columns(), "energy": energy, **stresses}

    def __repr__(self) -> str:
        names = result_names(self.result)
        values = all_concrete([self.reached, self.energy, self.fraction])
        if names is None or values is None:
            return eqx.tree_pformat(self)
        if names.shape:
            return count_results("equilibria", names)
        displacements, energy, fraction = values
        title = (
            f"{names}: {100 * float(fraction):.4g} % of loads and prescribed "
            f"displacements, {int(self.steps)} Newton steps"
        )
        if np.isfinite(energy):
            title += f", {float(energy):.6g} J in the hinges"
        if self.stresses is not None:
            title += f"\n{self.stresses.summary()}"
        return self._listed(title, "body", displacements)


# An equilibrium, or poses of the bodies; rad, m, m
StateLike = TypeAliasType("StateLike", PosesLike | Equilibrium)


def equilibrium(
    mechanism: Mechanism,
    *,
    loads: Sequence[Load] = (),
    drives: Sequence[Drive] = (),
    constraints: Sequence[AbstractConstraint] = (),
    start: StateLike | None = None,
    time: NumberLike = 0.0,
    tolerance: float = 1e-10,
    max_steps: int = 400,
    throw: bool = True,
) -> Equilibrium:
    """Compute the static equilibrium under loads and prescribed displacements.

    Displacements may be large. The loads are applied in increments if one Newton solve
    does not converge, or if a fold may lie within an increment. The result is the
    equilibrium that is connected to `start`, by default the reference configuration; the
    manual describes two exceptions. Unstable equilibria are rejected. The result has
    derivatives of every order, in forward and in reverse mode, which are computed by the
    implicit function theorem.

    Args:
        mechanism: The mechanism. Without loads, the result is the equilibrium to which
            the misfits of its hinges deform it.
        loads: Loads on its bodies.
        drives: Prescribed displacements of degrees of freedom that are not fixed.
        constraints: Pins, sliders, and other constraints between its bodies. Mechanisms
            with constraints are solved with dense matrices.
        start: Equilibrium or poses at which the iteration starts; by default the
            reference configuration. The best start is an equilibrium whose loads are
            close to the new ones; rad, m, m.
        time: Time at which time-dependent constraints are evaluated, by default zero; s.
        tolerance: Relative tolerance on the square root of the Newton energy decrement.
        max_steps: Largest total number of Newton steps of all load increments.
        throw: Whether a failure raises an error. In a batch, the failure of one design
            raises an error for the whole batch. If False, the arrays of a failed design
            are NaN, and the other designs are unaffected.

    Returns:
        The equilibrium. If `throw` is False and no equilibrium was found, its arrays are
        NaN and `result` is the reason.

    Raises:
        ValueError: Double precision is disabled, a name is unknown, a degree of freedom
            is prescribed twice or is fixed, constraints are redundant or contradict one
            another, a shape is wrong, or a setting is invalid.
        RuntimeError: No equilibrium was found; the message gives the reason.

    Source:
        Equations 5.25 and 6.4 of the dissertation without inertia.

    Example:
        >>> import jax.numpy as jnp
        >>> from twistorjax import Body, equilibrium, Hinge, Load, Mechanism, Quadratic
        >>> spring = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0])))
        >>> hinge = Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
        >>> mechanism = Mechanism([Body("wall"), Body("block")], [hinge], fixed=["wall"])
        >>> pushed = equilibrium(mechanism, loads=[Load("block", force=(5.0, 0.0))])
        >>> pushed.displacement("block"), pushed.reaction("wall")
        (Array([0.  , 0.05, 0.  ], dtype=float64), Array([ 0., -5.,  0.], dtype=float64))
    """
    require_float64(mechanism.reference)
    constraint_set = gather_constraints(mechanism, constraints)
    require_support(mechanism, constraint_set.bodies)
    if not 0 < tolerance < 1 or max_steps < 1:
        raise ValueError(
            f"`tolerance` is {tolerance!r} and `max_steps` is {max_steps!r}, but "
            "`tolerance` must be between 0 and 1, and `max_steps` at least 1."
        )
    load_set = LoadSet.of(mechanism, loads)
    prescribed, targets = prescribed_dofs(mechanism, drives)
    dofs = DofPartition.of(mechanism, prescribed)
    start_displacements = None
    if start is not None:
        start_displacements = mechanism.displacements(start, "start", single=True)
    # A call of a `jax.jit` function takes less time than one of `eqx.filter_jit`, but
    # constraints may contain functions.
    solve = _solve_with_functions if constraint_set.size else _solve
    solution = solve(
        mechanism.hinge_assembly,
        mechanism.reference,
        start_displacements,
        load_set,
        constraint_set,
        targets,
        program_input(time, float),
        program_input(tolerance, float),
        program_input(max_steps, int),
        dofs=dofs,
        names=(mechanism.names, reported_hinges(mechanism)),
    )
    if not throw:
        return solution

    def first_critical_point() -> str:
        from .path_message import describe_critical_point  # which imports this module

        if start is not None or mechanism.hinge_assembly.misfits is not None:
            return ""  # The forces at the start, or the misfits, change along the path.
        proportional = load_set, constraint_set, targets, dofs
        return describe_critical_point(mechanism, *proportional, solution, time)

    return check_equilibrium(
        solution, mechanism, constraint_set, dofs, time, first_critical_point
    )


def state_in_range(mechanism: Mechanism, name: str, state: StateLike | None) -> Poses:
    """Return the displacements of a state; rad, m, m.

    They are NaN if the state is traced and a hinge is outside the validity range of its
    energy.

    Raises:
        ValueError: A hinge is outside this range, and the state is not traced.
    """
    if state is None and mechanism.hinge_assembly.misfits is not None:
        raise ValueError(
            "The mechanism has misfits, so its reference configuration is not an "
            f"equilibrium. Give `{name}=equilibrium(mechanism)`."
        )
    if state is None:
        return jnp.zeros_like(mechanism.reference)
    displacements = mechanism.displacements(state, name, single=True)
    outside = jnp.any(mechanism.hinge_assembly.out_of_range(displacements))
    if concrete(outside) is None:
        return jnp.where(outside, jnp.nan, displacements)
    if outside:
        raise ValueError(
            f"At `{name}` a hinge is outside the validity range of its energy. "
            f"{mechanism.range_messages(mechanism.reference + displacements)}"
        )
    return displacements


def solve_equilibrium(
    hinges: HingeAssembly,
    reference: Poses,
    start_displacements: Poses | None,
    loads: LoadSet,
    constraints: ConstraintSet,
    targets: tuple[Scalar, ...],
    time: Scalar,
    tolerance: Scalar,
    max_steps: Count,
    *,
    dofs: DofPartition,
    names: tuple[tuple[str, ...], tuple[str, ...]],
) -> Equilibrium:
    """Compute the equilibrium; see `equilibrium`."""
    system = System(
        hinges, loads, constraints, jnp.array(targets, float), time, dofs,
        scales_misfits=start_displacements is None,
    )  # fmt: skip
    start_displacements = (
        jnp.zeros_like(reference) if start_displacements is None else start_displacements
    )
    fixed_system, start = stop_gradient((system, start_displacements))
    consistent = independent(fixed_system, start)
    solution = newton.solve_in_increments(fixed_system, start, tolerance, max_steps)
    flat = solution.displacements.reshape(-1)
    converged = (solution.status == newton.CONVERGED) & consistent
    root, multipliers = flat[system.free], jnp.zeros(0)
    if solution.multipliers is not None:
        root = jnp.concatenate([root, solution.multipliers])
    root = differentiable_root(system, root, start_displacements, converged)
    free = root
    if solution.multipliers is not None:
        free, multipliers = jnp.split(root, [len(system.free)])
    prescribed = jnp.where(converged, system.targets, flat[system.prescribed])
    displacements = system.with_displacements(
        start_displacements, free=free, prescribed=prescribed
    )
    outside = converged & jnp.any(hinges.out_of_range(solution.displacements))
    valid = converged & ~outside
    if solution.multipliers is not None:  # no array of size zero; see `System.equations`
        multipliers = jnp.where(valid, multipliers, jnp.nan)
    result = RESULTS.successful
    for status, item in (
        (newton.NOT_FINITE, RESULTS.not_finite),
        (newton.UNSTABLE, RESULTS.unstable),
        (newton.STUCK, RESULTS.no_equilibrium),
        (newton.USED_UP, RESULTS.steps_used_up),
    ):
        result = RESULTS.where(solution.status == status, item, result)
    failed = (solution.status != newton.NOT_FINITE) & ~consistent
    result = RESULTS.where(failed, RESULTS.inconsistent_constraints, result)
    result = RESULTS.where(outside, RESULTS.out_of_range, result)
    return Equilibrium(
        displacements=jnp.where(valid, displacements, jnp.nan),
        reference=reference,
        reactions=jnp.where(valid, system.reactions(displacements, multipliers), jnp.nan),
        constraint_forces=multipliers,
        energy=jnp.where(valid, hinges.energy(displacements), jnp.nan),
        reached=solution.displacements,
        fraction=solution.fraction,
        steps=solution.steps,
        range_shares=hinges.range_shares(solution.displacements),
        result=result,
        names=names[0],
        constraint_names=constraints.names(),
        stresses=report_stresses(hinges, displacements, names[1], valid),
    )


_solve = fast_compile(solve_equilibrium, jit=jax.jit, static_argnames=("dofs", "names"))
_solve_with_functions = fast_compile(solve_equilibrium)


def describe_free_motions(
    mechanism: Mechanism,
    constraints: ConstraintSet | None,
    dofs: DofPartition,
    displacements: Poses,
    time: NumberLike,
) -> str:
    """Name the bodies that can move without any resistance, for a message."""
    from .constraint_analysis import analyze  # which imports this module

    given = () if constraints is None else constraints.constraints
    if not np.all(np.isfinite(displacements)):
        return ""
    analysis = analyze(mechanism, dofs, given, displacements, time, ratio=_NO_STIFFNESS)
    if not analysis.motion_descriptions:
        return ""
    return f" Nothing resists the {'; the '.join(analysis.motion_descriptions)}."


def check_equilibrium(
    solution: Equilibrium,
    mechanism: Mechanism | None = None,
    constraints: ConstraintSet | None = None,
    dofs: DofPartition | None = None,
    time: NumberLike = 0.0,
    first_critical_point: Callable[[], str] | None = None,
) -> Equilibrium:
    """Return the solution if it succeeded, and raise its error otherwise.

    The mechanism, its constraints, its degrees of freedom, and the time (s) are needed
    only to name the hinges that are out of range, and the inconsistent constraints. A
    function describes the critical point that the load increments did not pass.
    """

    def error(item: str, batch_index: tuple[int, ...]) -> Exception:
        fraction = np.asarray(solution.fraction)[batch_index]
        steps = np.asarray(solution.steps)[batch_index]
        where = ""
        if batch_index:
            where = f" at index {', '.join(map(str, batch_index))} of the batch"
        text = result_message(item)
        if mechanism is not None and not batch_index:
            if item == "out_of_range":
                poses = mechanism.reference + solution.reached
                text += f" {mechanism.range_messages(poses)}"
            if item == "inconsistent_constraints":
                assert constraints is not None and dofs is not None
                detail = constraint_error(
                    constraints, dofs, mechanism, solution.reached, time
                )
                return ValueError(f"{text} {detail}")
            if item == "no_equilibrium" and first_critical_point is not None:
                text += first_critical_point()
            if item == "unstable" and dofs is not None:
                text += describe_free_motions(
                    mechanism, constraints, dofs, solution.reached, time
                )
        return RuntimeError(
            f"{text} (fraction {fraction:.4g}, {steps} Newton steps{where})"
        )

    solution = succeeded_or_raise(solution, error)
    shares = solution.range_shares
    known = None if shares is None else concrete(shares)
    if mechanism is not None and known is not None and np.any(known > 1):
        hinge = mechanism.hinge_names[np.argmax(known) % known.shape[-1]]
        warnings.warn(
            f"The hinge {hinge!r} has a linear energy (`flexures.leaf` or "
            f"`flexures.notch`), but its displacement is {np.max(known):.3g} times the "
            "one at which its force or moment errs by 5 %. Use `flexures.surrogate`, "
            "whose error is certified in its validity range, or `flexures.quartic_leaf`.",
            stacklevel=3,
        )
    return solution
