"""Newton's method in load increments."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, ScalarLike

from ..._utils.pytrees import select
from ..._utils.types import Count, Entries, Flag, Poses, Scalar
from ..equations.system import System


RUNNING, CONVERGED, NOT_FINITE, UNSTABLE, STUCK, USED_UP, INCONSISTENT = range(7)


class NewtonSolution(NamedTuple):
    """The last equilibrium that Newton's method found."""

    displacements: Poses  # Displacement of each body from its reference pose; rad, m, m
    multipliers: Entries | None  # Constraint forces; None without constraints; N m, N
    fraction: Scalar  # Fraction of the loads and prescribed displacements
    steps: Count  # Number of Newton steps
    # Reason why the iteration stopped: one of the constants above. `INCONSISTENT` is set
    # outside of the iteration, which does not check it.
    status: Count


# A load increment is rejected if the ratio of two successive Newton corrections is
# larger: a fold may then lie between its two ends. The theorem of Newton and Kantorovich
# excludes a fold if h, the first correction times the relative curvature of the
# equations, is at most 1/2; the second correction is then at most h / (2 (1 - h)) of the
# first (Deuflhard, Newton Methods for Nonlinear Problems, 2011, sections 2.1 and 5.1).
# This ratio corresponds to h = 0.41.
_LARGEST_CONTRACTION = 0.35
# An increment is also rejected if the responses to it by the tangents at its two ends
# differ by more. This measures h as well. It excludes corrections that are small although
# they lead to another branch, where the stiffness is different.
_LARGEST_DIFFERENCE = 0.4
# The next increment is chosen such that it reaches this fraction of both bounds.
_GOOD_SHARE = 0.6
# Bounds of the ratio of two successive increments. An increment whose corrections
# contract, and which fails for another reason, says nothing about the next one.
_SHORTER, _BLIND_REDUCTION, _LONGER = (0.1, 0.5), 0.25, (0.5, 4.0)
# The last increment may be longer by this factor, so that it is not so short that it
# consists of rounding errors.
_LONGER_AT_THE_END = 1.05
# Corrections below this fraction of the first one cannot lead to another branch.
_SMALL_CORRECTION = 1e-6
# Corrections below this fraction of the displacements may consist of rounding errors.
_ROUNDING = 1e-12
# Violations of constraints are computed from poses, so smaller corrections of a mechanism
# with constraints are rounding errors; rad, and lengths of the mechanism.
_ROUNDING_OF_POSES = 16 * np.finfo(float).eps
# Nothing moves in an increment whose energy changes are below this fraction of the work
# of the hinges.
_NO_MOTION = 1e-20
# A contact closes or opens if its stiffness changes by more, as a fraction of the largest
# stiffness of a contact.
_CONTACT_CHANGE = 0.1
_LARGEST_ROTATION = 1.0  # of a body in one increment; rad
_LARGEST_VIOLATION = 1e-10  # of a constraint; rad, and lengths of the mechanism
_STEPS_PER_INCREMENT = 12
_SMALLEST_INCREMENT = 1e-7  # as a fraction of the full load
_SMALLEST_SHARE = 1e-5  # as a fraction of the load that has been reached


class _Iterate(NamedTuple):
    """An approximation of the equilibrium at a fraction of the loads."""

    displacements: Poses  # Displacement of each body from its reference pose; rad, m, m
    multipliers: Array | None  # Constraint forces; None without constraints; N m, N
    # Generalized stress of the hinges that the last step predicted; N m, N, N
    predicted: Array


class _State(NamedTuple):
    """State of the iteration.

    A vector of unknowns has the displacements of the free degrees of freedom (rad, m),
    then the constraint forces (N m, N).
    """

    current: _Iterate
    last_equilibrium: _Iterate  # At the last fraction that converged
    fraction: Scalar  # Last fraction that converged
    increment: Scalar  # Increment of the fraction that is being tried
    tries: Count  # Number of Newton steps in this increment
    energies: Array  # Energy change of the last step, for each unknown; J
    energy_scale: Scalar  # Energy change of the first step of this increment; J
    first_correction: Scalar  # Norm of the first correction of this increment
    last_correction: Scalar  # Norm of the last correction
    # Residual at the start of this increment, with the misfits there, and with the
    # opposite sign
    imbalance: Array
    # Response to this imbalance, to the change of misfits, and to the prescribed
    # displacements, by the tangent at the start of the increment
    response: Array
    # Stiffness of the contacts before the last step; see `AssemblyTangent`
    contact_stiffness: Array
    # Largest nonlinearity that was observed in this increment, as a fraction of its bound
    nonlinearity: Scalar
    steps: Count  # Total number of Newton steps
    status: Count  # Reason to stop, or `RUNNING`


def solve_in_increments(
    system: System, start: Poses, tolerance: ScalarLike, max_steps: ScalarLike
) -> NewtonSolution:
    """Follow the equilibrium from `start` to the full loads and prescribed displacements.

    Newton's method is applied to an increasing fraction of the loads and prescribed
    displacements. The first increment is the full load. An increment is accepted only if
    Newton's corrections contract quickly and the tangents at its two ends agree, so that
    there is no fold between them. Otherwise the iteration returns to the last fraction
    that converged and tries a shorter increment. Both criteria are measured over the
    whole mechanism. A fold of a part whose displacements are small compared with those of
    the rest, and a bifurcation of a symmetric path, may remain undetected.

    Loads and misfits change in proportion from those at `start` to the given ones. If the
    former are unknown, forces of constant direction keep the mechanism at `start`, and
    decrease in proportion as the fraction increases. A violation of constraints at
    `start` decreases in the same way.
    Prescribed degrees of freedom and misfits change in the first Newton step of each
    increment, together with the first response of the free degrees of freedom.

    Convergence is measured by the energy change of a Newton step, relative to the sum of
    the absolute values of force times displacement of the hinges, or to the energy change
    of the first step of the increment if it is larger. The observed
    convergence rate predicts the next error, which saves the last step. Contraction is
    measured in displacements: rotations, and translations divided by a length of the
    mechanism. In the energy, a stiff hinge that is stretched during one step would
    dominate all others.

    Args:
        tolerance: Relative tolerance on the square root of the Newton energy decrement.

    Returns:
        The last equilibrium that was found.
    """
    entries = system.constraints.size
    units, free_units = system.units(), system.free_units()
    forces, predicted = system.hinges_at(0.0).forces_and_stress(start)
    unbalanced = system.unbalanced_at_start(forces, start)
    initial_residual = system.residual(unbalanced, start)
    multipliers = jnp.zeros(entries) if entries else None
    if system.at_start is not None and system.at_start.constraint_forces is not None:
        multipliers = jnp.asarray(system.at_start.constraint_forces)
    largest_violation = jnp.zeros(0)
    if entries:
        jacobian = system.jacobian(start)[:, system.free] * free_units[None]
        size = jnp.linalg.norm(jacobian, axis=1)
        largest_violation = _LARGEST_VIOLATION * jnp.where(size > 0, size, 1.0)
    floor = _ROUNDING_OF_POSES if entries else 0.0

    def advance(state: _State) -> _State:
        """Take one Newton step, and accept, reject, or continue the increment."""
        step = _newton_step(system, start, initial_residual, state)
        is_first = state.tries == 0
        # A contact that closes or opens changes the mechanism. Its corrections contract
        # from this step on, and no fold is between it and the other one.
        begins = is_first | _contact_changed(step, state)
        error, energy, energy_scale = _predicted_error(step, state, begins)
        length = _length(step.change, units)
        longest = jnp.where(begins, length, state.first_correction)
        ratio = jnp.where(begins, 0.0, length / state.last_correction)
        rounded = length <= _ROUNDING * _length(step.reached.displacements, units)
        small = rounded | (length <= _SMALL_CORRECTION * longest) | (length <= floor)
        over_bound = jnp.where(small, 0.0, ratio / _LARGEST_CONTRACTION)
        response = jnp.where(is_first, step.response, state.response)
        size = longest
        if step.response_at_start is not None:
            response = step.response_at_start
            # The first correction may pass through a gap that the contact then closes.
            travel = step.reached.displacements - state.last_equilibrium.displacements
            size = _length(travel, units)
        difference = (step.response - response)[: len(system.free)] / free_units
        difference = jnp.sqrt(jnp.sum(difference**2))
        difference /= jnp.where(size > floor, size, 1.0)
        if system.changes_misfits:
            # After the first step, a stiff hinge that turns by its misfit is stretched.
            difference = jnp.where(state.tries == 1, 0.0, difference)
        over_bound = jnp.maximum(over_bound, difference / _LARGEST_DIFFERENCE)
        # If misfits load the hinges and nothing moves, all corrections are rounding
        # errors.
        moves = jnp.maximum(energy_scale, energy) > _NO_MOTION * step.work
        over_bound = jnp.where(is_first | moves, over_bound, 0.0)
        nonlinearity = jnp.where(
            is_first, 0.0, jnp.maximum(over_bound, state.nonlinearity)
        )

        contracts = over_bound <= 1
        rotations = step.reached.displacements - state.last_equilibrium.displacements
        rotation = jnp.max(jnp.abs(rotations[:, 0]), initial=0.0)
        acceptable = step.stable & jnp.isfinite(energy) & (rotation <= _LARGEST_ROTATION)
        acceptable &= contracts
        # The first step of an increment with prescribed displacements or misfits used
        # only the tangent before them.
        tangent_is_current = ~is_first | step.prescribed_imposed
        # Intermediate increments are solved less accurately than the last one.
        goal_tolerance = jnp.where(step.goal < 1, jnp.sqrt(tolerance), tolerance)
        # In a mechanism of many bodies, corrections that are rounding errors do not
        # contract.
        stalled = rounded & (ratio > _LARGEST_CONTRACTION)
        stalled &= error <= jnp.sqrt(jnp.finfo(float).eps)
        small_error = (error <= goal_tolerance) | stalled
        if entries:
            small_error |= ~is_first & (length <= floor)
            violation = system.violation(step.reached.displacements)
            violation -= (1 - step.goal) * initial_residual[len(system.free) :]
            small_error &= jnp.all(jnp.abs(violation) <= largest_violation)
            # The first tangent lacks the geometric stiffness of the constraint forces.
            tangent_is_current &= ~is_first
        converged = acceptable & tangent_is_current & small_error
        rejected = ~acceptable | (state.tries + 1 >= _STEPS_PER_INCREMENT)
        rejected &= ~converged

        # Both measures of nonlinearity are proportional to the increment.
        factor = _GOOD_SHARE / jnp.where(nonlinearity > 0, nonlinearity, 1.0)
        reduction = jnp.where(contracts, _BLIND_REDUCTION, jnp.clip(factor, *_SHORTER))
        increment = jnp.where(rejected, reduction * state.increment, state.increment)
        smallest = jnp.maximum(_SMALLEST_INCREMENT, _SMALLEST_SHARE * state.fraction)
        steps = state.steps + 1
        # Each condition that holds replaces the earlier ones.
        status = jnp.where(steps >= max_steps, USED_UP, RUNNING)
        status = jnp.where(increment < smallest, STUCK, status)
        # The stiffness is singular or indefinite already at the smallest load.
        singular = (state.fraction == 0) & is_first & ~step.stable
        status = jnp.where((increment < smallest) & singular, UNSTABLE, status)
        status = jnp.where(converged & (step.goal >= 1), CONVERGED, status)
        status = jnp.where((state.steps == 0) & ~step.finite, NOT_FINITE, status)
        fraction = jnp.where(converged, step.goal, state.fraction)
        remaining = 1 - fraction
        growth = jnp.where(nonlinearity > 0, jnp.clip(factor, *_LONGER), _LONGER[1])
        is_last = _LONGER_AT_THE_END * growth * increment > remaining
        longer = jnp.where(is_last, remaining, growth * increment)

        return _State(
            current=select(rejected, state.last_equilibrium, step.reached),
            last_equilibrium=select(converged, step.reached, state.last_equilibrium),
            fraction=fraction,
            increment=jnp.where(converged, longer, increment),
            tries=jnp.where(converged | rejected, 0, state.tries + 1),
            energies=step.energies,
            energy_scale=energy_scale,
            first_correction=longest,
            last_correction=length,
            imbalance=step.imbalance,
            response=response,
            contact_stiffness=step.contact_stiffness,
            nonlinearity=jnp.where(converged | rejected, 0.0, nonlinearity),
            steps=steps,
            status=status,
        )

    zero, no_steps = jnp.zeros(()), jnp.zeros((), int)
    unknowns = jnp.zeros(len(system.free) + entries)
    first = _Iterate(start, multipliers, predicted)
    state = _State(
        current=first,
        last_equilibrium=first,
        fraction=zero,
        increment=zero + 1,
        tries=no_steps,
        energies=unknowns,
        energy_scale=zero,
        first_correction=zero,
        last_correction=zero,
        imbalance=unknowns,
        response=unknowns,
        contact_stiffness=jnp.zeros((10, len(system.hinges.contacts))),
        nonlinearity=zero,
        steps=no_steps,
        status=jnp.zeros((), int),
    )
    state = jax.lax.while_loop(lambda state: state.status == RUNNING, advance, state)
    displacements, multipliers, _ = state.last_equilibrium
    return NewtonSolution(
        displacements, multipliers, state.fraction, state.steps, state.status
    )


class _Step(NamedTuple):
    """Result of one Newton step."""

    reached: _Iterate  # The iterate after the step
    change: Poses  # Change of the displacements; rad, m, m
    energies: Array  # Energy change for each unknown; J
    # Sum of the absolute values of force times displacement of the hinges before the
    # step; J
    work: Scalar
    imbalance: Array  # Residual at the start of the increment, as in `_State`
    response: Array  # Response to the whole increment by the tangent before the step
    # The same by the tangent at the start of the increment, but with the contacts of the
    # tangent before the step; None without contacts
    response_at_start: Array | None
    contact_stiffness: Array  # As in `_State`
    goal: Scalar  # Fraction at the end of the increment
    stable: Flag  # Whether the tangent stiffness indicates a stable equilibrium
    finite: Flag  # Whether residual and tangent are finite
    # Whether the prescribed displacements and misfits had their values already
    prescribed_imposed: Flag


def _newton_step(
    system: System, start: Poses, initial_residual: Array, state: _State
) -> _Step:
    """Take one Newton step toward the end of the increment."""
    goal = state.fraction + state.increment
    is_first = state.tries == 0
    misfit_fraction = jnp.where(is_first, state.fraction, goal)
    displacements, multipliers, predicted = state.current
    unbalanced, tangent, hinge_tangents = system.tangent(
        displacements, goal, predicted, multipliers, misfit_fraction
    )
    flat = displacements.reshape(-1)
    prescribed_at_start = start.reshape(-1)[system.prescribed]
    travel = system.targets - prescribed_at_start
    prescribed = prescribed_at_start + goal * travel
    prescribed_change = prescribed - flat[system.prescribed]
    residual = system.residual(unbalanced, displacements) - (1 - goal) * initial_residual
    # The forces due to misfits and prescribed displacements follow from the tangent.
    misfit_forces, misfit_stress = system.misfit_response(
        displacements, misfit_fraction, state.increment
    )
    right = -(residual + tangent.prescribed_forces(prescribed_change))
    right = jnp.where(is_first, right - misfit_forces, right)
    imbalance = jnp.where(is_first, -residual, state.imbalance)
    whole_change = tangent.prescribed_forces(state.increment * travel)
    forcing = imbalance - misfit_forces - whole_change
    rights = jnp.stack([right, forcing])
    (step, response), stable = tangent.solve_and_check(rights, system.conservative)
    free = flat[system.free] + step[: len(system.free)]
    reached = system.dofs.expand(free, prescribed)
    if multipliers is not None:
        multipliers = multipliers - step[len(system.free) :]
    change = reached - displacements
    predicted = hinge_tangents.predicted_stress(change)
    predicted = predicted + jnp.where(is_first, misfit_stress, 0.0)
    imposed = jnp.all(prescribed_change == 0)
    contacts, response_at_start = system.hinges.contacts, None
    contact_stiffness = hinge_tangents.stiffness[:, contacts]
    if contacts.size:
        _, at_start, _ = system.tangent(
            state.last_equilibrium.displacements,
            goal,
            state.last_equilibrium.predicted,
            state.last_equilibrium.multipliers,
            misfit_fraction,
            contact_stiffness,
        )
        whole_change = at_start.prescribed_forces(state.increment * travel)
        forcing = imbalance - misfit_forces - whole_change
        (response_at_start,), _ = at_start.solve_and_check(
            forcing[None], system.conservative
        )
    return _Step(
        reached=_Iterate(reached, multipliers, predicted),
        change=change,
        energies=jnp.abs(step * right),
        work=hinge_tangents.work,
        imbalance=imbalance,
        response=response,
        response_at_start=response_at_start,
        contact_stiffness=contact_stiffness,
        goal=goal,
        stable=stable,
        finite=hinge_tangents.finite() & jnp.all(jnp.isfinite(right)),
        prescribed_imposed=imposed & (not system.changes_misfits),
    )


def _contact_changed(step: _Step, state: _State) -> Flag | bool:
    """Decide whether a contact closed or opened in the last step."""
    now, before = step.contact_stiffness, state.contact_stiffness
    if not now.size:
        return False
    change, largest = jnp.max(jnp.abs(now - before)), jnp.max(jnp.abs(now))
    return change > _CONTACT_CHANGE * jnp.maximum(largest, jnp.max(jnp.abs(before)))


def _predicted_error(
    step: _Step, state: _State, begins: Flag
) -> tuple[Scalar, Scalar, Scalar]:
    """Predict the error after a step from the observed convergence rate.

    Each unknown has its own rate, because those of compliant hinges may still converge
    when those of stiff hinges have converged already.

    Args:
        begins: Whether the corrections begin to contract with this step.

    Returns:
        Relative error, the square root of a ratio of energies; energy change of the step;
        and energy change of the step with which the corrections begin to contract; J.
    """
    energy = jnp.sum(step.energies)
    scale = jnp.where(begins, energy, state.energy_scale)
    rates = jnp.where(begins, 1.0, step.energies / state.energies)
    fast = rates < 0.0625  # the square of the ratio of errors
    remaining_share = rates / (1 - jnp.sqrt(jnp.where(fast, rates, 0.0))) ** 2
    remaining = jnp.where(fast, step.energies * remaining_share, step.energies)
    reference = jnp.maximum(scale, step.work)  # NaN only if the energy is NaN as well
    reference = jnp.where(reference > 0, reference, 1.0)
    return jnp.sqrt(jnp.sum(remaining) / reference), energy, scale


def _length(displacements: Poses, units: Float[Array, "3"]) -> Scalar:
    """Compute the Euclidean norm of displacements, divided by their units."""
    return jnp.sqrt(jnp.sum((displacements / units[None]) ** 2))
