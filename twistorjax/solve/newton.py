"""Newton's method in load increments, and the derivatives of its solution."""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, ScalarLike

from .._utils.types import Count, Entries, Flag, Poses, Scalar
from .system import System


RUNNING, CONVERGED, NOT_FINITE, UNSTABLE, STUCK, USED_UP = range(6)


class NewtonSolution(NamedTuple):
    """The last equilibrium that Newton's method found, and why it stopped there.

    Args:
        displacements: Displacement of each body from its reference pose; rad, m, m.
        push: Constraint force of each constraint entry; None without constraints; N m, N.
        fraction: Fraction of the loads and prescribed displacements.
        steps: Number of Newton steps.
        status: Reason why the iteration stopped: one of the constants above.
    """

    displacements: Poses
    push: Entries | None
    fraction: Scalar
    steps: Count
    status: Count


# A load increment is rejected if Newton's corrections shrink by less than this factor: a
# fold may then lie between its two ends. The theorem of Newton and Kantorovich excludes
# one if h, the first correction times the relative curvature of the equations, is at most
# 1/2; the second correction is then at most h / (2 (1 - h)) of the first (Deuflhard,
# Newton Methods for Nonlinear Problems, 2011, sections 2.1 and 5.1). The factor
# corresponds to h = 0.41.
_LARGEST_CONTRACTION = 0.35
# An increment is also rejected if the responses to it by the tangents at its two ends
# differ by more. This measures h as well. It excludes corrections that are small because
# they lead to another branch by chance, where the stiffness is different.
_LARGEST_DIFFERENCE = 0.4
# The length of the next increment aims at this share of both bounds.
_GOOD_SHARE = 0.6
# Corrections below this share of the first one are too small to lead to another branch.
_SMALL_CORRECTION = 1e-6
# Corrections below this share of the displacements may consist of rounding errors.
_ROUNDING = 1e-12
_LARGEST_ROTATION = 1.0  # of a body in one increment; rad
_LARGEST_VIOLATION = 1e-10  # of a constraint; rad, and lengths of the mechanism
_STEPS_PER_INCREMENT = 12
_SMALLEST_INCREMENT = 1e-7  # of the whole load
_SMALLEST_SHARE = 1e-5  # of the fraction that has been reached


class _State(NamedTuple):
    """State of the iteration.

    An unknown vector has the displacements of the free degrees of freedom, then the
    constraint forces.

    Args:
        displacements: Displacements at the current iterate.
        push: Constraint forces at the current iterate.
        predicted: Generalized stress of the hinges that the last step predicted.
        converged: The first three at the last fraction that converged.
        fraction: Last fraction that converged.
        increment: Increment of the fraction that is being tried.
        tries: Newton steps in this increment.
        changes: Energy change of the last step, for each unknown.
        scale: Energy change of the first step of this increment.
        first: Length of the first correction of this increment.
        last: Length of the last correction.
        imbalance: Residual at the start of this increment, with the opposite sign.
        response: Response to this imbalance and to the prescribed displacements, by the
            tangent at the start of the increment.
        nonlinearity: Largest share of the bounds on increments that was observed.
        steps: Newton steps in total.
        status: Reason to stop, or `RUNNING`.
    """

    displacements: Poses
    push: Array | None
    predicted: Array
    converged: tuple[Poses, Array | None, Array]
    fraction: Scalar
    increment: Scalar
    tries: Count
    changes: Array
    scale: Scalar
    first: Scalar
    last: Scalar
    imbalance: Array
    response: Array
    nonlinearity: Scalar
    steps: Count
    status: Count


def solve_in_increments(
    system: System, start: Poses, tolerance: ScalarLike, max_steps: ScalarLike
) -> NewtonSolution:
    """Follow the equilibrium from `start` to the full loads and prescribed displacements.

    Newton's method is applied to a growing fraction of them. The first increment is the
    whole. An increment is accepted only if Newton's corrections contract quickly and the
    tangents at its two ends agree, so that there is no fold between them; otherwise it is
    shortened. Both criteria are measured over the whole mechanism: a part whose
    displacements are small beside those of the rest may pass a fold of its own, and a
    symmetric path may pass a bifurcation. The forces that hold the mechanism at `start`
    decrease in proportion as the fraction grows: none in the reference configuration, the
    loads of another equilibrium otherwise. So does a violation of constraints at `start`.
    Prescribed degrees of freedom move in the first Newton step of each increment,
    together with the first response of the free ones.

    Convergence is measured by the energy that a Newton step changes, relative to the
    energy at work in the hinges. The observed convergence rate predicts the next error,
    which saves the last step. Contraction is measured in displacements: rotations, and
    translations divided by a length of the mechanism. In the energy, a stiff hinge that
    is stretched during one step would outweigh all others.

    Args:
        system: The equations.
        start: Displacements at which the iteration starts; rad, m, m.
        tolerance: Relative tolerance on the square root of the Newton energy decrement.
        max_steps: Largest number of Newton steps in total.

    Returns:
        The last equilibrium that was found.
    """
    rows, count = system.free, len(system.free)
    entries = system.constraints.size
    begin = start.reshape(-1)[system.prescribed]
    no_push = jnp.zeros(entries) if entries else None
    held = _residual(system, system.hinges.forces(start).reshape(-1), start)
    unit = system.units()
    unit_of_free = unit[rows % 3]
    unit_of_entries = jnp.ones(0)
    if entries:
        jacobian = system.jacobian(start)[:, rows] * unit_of_free[None]
        size = jnp.linalg.norm(jacobian, axis=1)
        unit_of_entries = jnp.where(size > 0, size, 1.0)

    def advance(state: _State) -> _State:
        """Take one Newton step, and decide on the increment."""
        goal = state.fraction + state.increment
        residual, tangent, work = system.tangent(
            state.displacements, goal, state.predicted, state.push
        )
        flat = state.displacements.reshape(-1)
        given = begin + goal * (system.targets - begin)
        move = given - flat[system.prescribed]
        residual = _residual(system, residual, state.displacements)
        residual = residual - (1 - goal) * held
        right = -(residual + tangent.push(move))
        factors = tangent.factors(system.loads.conservative)
        first = state.tries == 0
        imbalance = jnp.where(first, -residual, state.imbalance)
        forcing = imbalance - tangent.push(state.increment * (system.targets - begin))
        step, response = jax.vmap(factors.solve)(jnp.stack([right, forcing]))
        displacements = system.place(
            state.displacements, free=flat[rows] + step[:count], prescribed=given
        )
        push = None if state.push is None else state.push - step[count:]

        def stress(at: Poses) -> Float[Array, "3 hinges"]:
            return system.hinges.generalized_stress(at, state.predicted)

        change = displacements - state.displacements
        predicted = sum(jax.jvp(stress, (state.displacements,), (change,)))

        changes = jnp.abs(step * right)
        energy = jnp.sum(changes)
        scale = jnp.where(first, energy, state.scale)
        # Each unknown has its own rate: a soft one converges beside stiff ones that have
        # converged already.
        shares = jnp.where(first, 1.0, changes / state.changes)
        fast = shares < 0.0625  # the square of the ratio of errors
        saved = shares / (1 - jnp.sqrt(jnp.where(fast, shares, 0.0))) ** 2
        measure = jnp.maximum(scale, work)  # NaN only beside an energy that is NaN
        left = jnp.sum(jnp.where(fast, changes * saved, changes))
        expected = jnp.sqrt(left / jnp.where(measure > 0, measure, 1.0))

        rotation = jnp.max(jnp.abs(displacements - state.converged[0])[:, 0], initial=0.0)
        resists = factors.resists()
        length = jnp.sqrt(jnp.sum((change / unit[None]) ** 2))
        longest = jnp.where(first, length, state.first)
        ratio = jnp.where(first, 0.0, length / state.last)
        distance = jnp.sqrt(jnp.sum((displacements / unit[None]) ** 2))
        rounded = length <= _ROUNDING * distance
        small = rounded | (length <= _SMALL_CORRECTION * longest)
        share = jnp.where(small, 0.0, ratio / _LARGEST_CONTRACTION)
        before = jnp.where(first, response, state.response)
        difference = (response - before)[:count] / unit_of_free
        difference = jnp.sqrt(jnp.sum(difference**2))
        difference /= jnp.where(longest > 0, longest, 1.0)
        share = jnp.maximum(share, difference / _LARGEST_DIFFERENCE)
        nonlinearity = jnp.where(first, 0.0, jnp.maximum(share, state.nonlinearity))
        contracts = share <= 1
        sane = resists & jnp.isfinite(energy) & (rotation <= _LARGEST_ROTATION)
        sane &= contracts
        # The first step of an increment with prescribed displacements used only the
        # tangent before them.
        settled = ~first | jnp.all(move == 0)
        # Intermediate increments are solved less accurately than the last one.
        enough = jnp.where(goal < 1, jnp.sqrt(tolerance), tolerance)
        # Rounding errors of a mechanism of many bodies do not contract any more.
        rounded &= ratio > _LARGEST_CONTRACTION
        rounded &= expected <= jnp.sqrt(jnp.finfo(float).eps)
        converged = sane & settled & ((expected <= enough) | rounded)
        if entries:
            violation = system.violation(displacements) - (1 - goal) * held[count:]
            converged &= jnp.all(
                jnp.abs(violation) <= _LARGEST_VIOLATION * unit_of_entries
            )

        finite = tangent.finite() & jnp.all(jnp.isfinite(right))
        cut = ~converged & (~sane | (state.tries + 1 >= _STEPS_PER_INCREMENT))
        # Both criteria are proportional to the increment.
        factor = _GOOD_SHARE / jnp.where(nonlinearity > 0, nonlinearity, 1.0)
        shorter = jnp.where(contracts, 0.25, jnp.clip(factor, 0.1, 0.5))
        increment = jnp.where(cut, shorter * state.increment, state.increment)
        smallest = jnp.maximum(_SMALLEST_INCREMENT, _SMALLEST_SHARE * state.fraction)
        steps = state.steps + 1
        status = jnp.select(
            [
                (state.steps == 0) & ~finite,
                converged & (goal >= 1),
                # Almost without load, the mechanism itself has no stiffness.
                (increment < smallest) & (state.fraction == 0) & first & ~resists,
                increment < smallest,
                steps >= max_steps,
            ],
            [NOT_FINITE, CONVERGED, UNSTABLE, STUCK, USED_UP],
            RUNNING,
        )
        fraction = jnp.where(converged, goal, state.fraction)
        left = 1 - fraction
        longer = jnp.where(nonlinearity > 0, jnp.clip(factor, 0.5, 4.0), 4.0)
        # The last increment is not so short that it consists of rounding.
        grown = jnp.where(1.05 * longer * increment > left, left, longer * increment)
        current = displacements, push, predicted
        kept = jax.tree.map(
            lambda new, old: jnp.where(converged, new, old), current, state.converged
        )
        current = jax.tree.map(
            lambda new, old: jnp.where(cut, old, new), current, state.converged
        )
        return _State(
            *current,
            converged=kept,
            fraction=fraction,
            increment=jnp.where(converged, grown, increment),
            tries=jnp.where(converged | cut, 0, state.tries + 1),
            changes=changes,
            scale=scale,
            first=longest,
            last=length,
            imbalance=imbalance,
            response=before,
            nonlinearity=jnp.where(converged | cut, 0.0, nonlinearity),
            steps=steps,
            status=status,
        )

    zero, none = jnp.zeros(()), jnp.zeros((), int)
    unknowns = jnp.zeros(count + entries)
    predicted = system.hinges.generalized_stress(start)
    state = _State(
        displacements=start,
        push=no_push,
        predicted=predicted,
        converged=(start, no_push, predicted),
        fraction=zero,
        increment=zero + 1,
        tries=none,
        changes=unknowns,
        scale=zero,
        first=zero,
        last=zero,
        imbalance=unknowns,
        response=unknowns,
        nonlinearity=zero,
        steps=none,
        status=none,
    )
    state = jax.lax.while_loop(lambda state: state.status == RUNNING, advance, state)
    return NewtonSolution(*state.converged[:2], state.fraction, state.steps, state.status)


def _residual(
    system: System, forces: Float[Array, " dofs"], displacements: Poses
) -> Float[Array, " unknowns"]:
    """Join the free forces and the violations; without arrays of size zero.

    Zero-size arrays make XLA lose the type of LAPACK calls in large programs (jaxlib
    0.10.2: "No registered implementation for untyped custom call").
    """
    forces = forces[system.free]
    if not system.constraints.size:
        return forces
    return jnp.concatenate([forces, system.violation(displacements)])


def differentiable_root(
    system: System, root: Array, start: Poses, found: Flag
) -> Float[Array, " unknowns"]:
    """Return the solution of a system, with derivatives by the system.

    The derivative is that of the equilibrium, by the implicit function theorem, and has
    derivatives of every order itself. Where no equilibrium was found it is zero and not
    NaN, which a sum over a batch could not mask.

    `optimistix.root_find` with its implicit adjoint would differentiate the residual to
    obtain the matrix. For the gain of the stage and its derivative it takes 1.4 times as
    long to compile, and 3 times as long for 4096 designs.

    Args:
        system: The equations.
        root: Displacements of the free degrees of freedom, then constraint forces, found
            beforehand.
        start: Displacements that the fixed degrees of freedom keep; rad, m, m.
        found: Whether `root` is a solution.

    Returns:
        The root.
    """
    dynamic, static = eqx.partition(system, eqx.is_inexact_array)
    return _root(static, dynamic, root, start, found)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _root(static: System, dynamic: System, root, start, found):
    """Return the root; see `differentiable_root`."""
    del static, dynamic, start, found
    return root


@_root.defjvp
def _(static, primals, tangents):
    dynamic, root, start, found = primals
    change, _, moved, _ = tangents
    root = _root(static, dynamic, root, start, found)
    system = eqx.combine(dynamic, static)
    count = len(system.free)

    def residual(dynamic: System, start: Poses) -> Array:
        system = eqx.combine(dynamic, static)
        displacements = system.place(start, free=root[:count], prescribed=system.targets)
        forces = system.residual(displacements, root[count:])
        return _residual(system, forces, displacements)

    _, rate = jax.jvp(residual, (dynamic, start), (change, moved))
    displacements = system.place(start, free=root[:count], prescribed=system.targets)
    _, tangent, _ = system.tangent(displacements, push=root[count:])
    rate = jnp.where(found, rate, 0.0)
    step = tangent.where(found).factors(system.loads.conservative).solve(rate)
    sign = jnp.where(np.arange(root.size) < count, -1.0, 1.0)
    return root, sign * step
