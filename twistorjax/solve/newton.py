"""Newton's method along a growing load, and the derivatives of where it ends."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, ScalarLike

from .._utils.types import Poses, Scalar
from .static_system import Problem


RUNNING, CONVERGED, NOT_FINITE, LOOSE, STUCK, USED_UP = range(6)


class Settled(NamedTuple):
    """Where Newton's method ended, and how."""

    displacements: Poses
    fraction: Scalar
    steps: Int[Array, ""]
    status: Int[Array, ""]


# A load increment is rejected if Newton's corrections shrink by less than this factor: a
# fold may then lie between its two ends. The theorem of Newton and Kantorovich excludes
# one if h, the first correction times the relative curvature of the equations, is at most
# 1/2; the second correction is then at most h / (2 (1 - h)) of the first (Deuflhard,
# Newton Methods for Nonlinear Problems, 2011, sections 2.1 and 5.1). The factor stands
# for an h of 0.41.
_LARGEST_CONTRACTION = 0.35
# The same if the response to the increment, by the tangents at its two ends, differs by
# more. This measures h as well, and excludes that a correction is small because it leads
# to another branch by chance: there the stiffness is another one.
_LARGEST_DIFFERENCE = 0.4
# The share of both bounds at which the length of the next increment aims.
_GOOD_SHARE = 0.6
# Corrections below this share of the first one are too small to lead to another branch.
_SMALL_CORRECTION = 1e-6
# Corrections below this share of the displacements may consist of rounding errors alone.
_ROUNDING = 1e-12
_LARGEST_TURN = 1.0  # of a body in one increment; rad
_STEPS_EACH = 12
_LEAST_STEP = 1e-7  # of the whole load
_LEAST_SHARE = 1e-5  # of the fraction that has been reached


def settle(
    problem: Problem, start: Poses, tolerance: ScalarLike, max_steps: ScalarLike
) -> Settled:
    """Follow the equilibrium from `start` to the full loads and drives.

    Newton's method is applied to a growing fraction of them. The first increment is the
    whole. An increment is accepted only if Newton's corrections contract quickly and the
    tangents at its two ends agree, so that there is no fold between them; otherwise it is
    shortened. Both are measured over the whole mechanism: a part that hardly moves beside
    the rest may pass a fold of its own, and so may a symmetric path a bifurcation. The
    forces that hold
    the mechanism at `start` fade as the fraction grows: none in the reference
    configuration, the loads of another equilibrium otherwise. Driven coordinates move in
    the first Newton step of each increment, together with the first answer of the free
    ones.

    Convergence is measured by the energy that a Newton step changes, relative to the
    energy at work in the hinges. The observed convergence rate predicts the next error,
    which saves the last step. Contraction is measured in displacements: angles, and
    translations divided by the length of a lever of the mechanism. In the energy a stiff
    hinge that is stretched for one step would outweigh all others.
    """
    rows = problem.free
    begin = start.reshape(-1)[problem.driven]
    holding = problem.hinge_assembly.forces(start).reshape(-1)[rows]
    unit = _units(problem)
    unit_of_free = unit[rows % 3]

    class State(NamedTuple):
        now: Poses
        borne: Array  # by the hinges there, as the last step foresaw it
        done: Poses  # at the last fraction that converged
        done_borne: Array
        fraction: Scalar  # that converged
        stride: Scalar  # beyond it
        tries: Int[Array, ""]  # Newton steps in this stride
        changes: Float[Array, " free"]  # energy of the last step, by coordinate
        scale: Scalar  # energy of the first step of this stride
        first: Scalar  # length of the first correction of this stride
        last: Scalar  # length of the last correction
        lacking: Float[Array, " free"]  # forces at the start of this stride
        response: Float[
            Array, " free"
        ]  # to them and the drives, by the tangent at its start
        curving: Scalar  # how much of the bounds for an increment it takes
        steps: Int[Array, ""]
        status: Int[Array, ""]

    def advance(state: State) -> State:
        goal = state.fraction + state.stride
        residual, slope, work = problem.tangent(state.now, goal, state.borne)
        flat = state.now.reshape(-1)
        given = begin + goal * (problem.targets - begin)
        move = given - flat[problem.driven]
        residual = residual[rows] - (1 - goal) * holding
        right = -(residual + slope.push(move))
        factors = slope.factors(problem.symmetric)
        first = state.tries == 0
        lacking = jnp.where(first, -residual, state.lacking)
        pushed = lacking - slope.push(state.stride * (problem.targets - begin))
        step, response = jax.vmap(factors.solve)(jnp.stack([right, pushed]))
        now = problem.place(
            problem.place(state.now, free=flat[rows] + step), driven=given
        )

        def tension(displacements: Poses) -> Float[Array, "3 hinges"]:
            return problem.hinge_assembly.tension(displacements, state.borne)

        foreseen = sum(jax.jvp(tension, (state.now,), (now - state.now,)))

        changes = jnp.abs(step * right)
        change = jnp.sum(changes)
        scale = jnp.where(first, change, state.scale)
        # each coordinate by itself: a soft one converges beside stiff ones that have
        shares = jnp.where(first, 1.0, changes / state.changes)
        fast = shares < 0.0625  # the root of which is that of the errors
        saved = shares / (1 - jnp.sqrt(jnp.where(fast, shares, 0.0))) ** 2
        measure = jnp.maximum(scale, work)  # NaN only beside a change that is too
        left = jnp.sum(jnp.where(fast, changes * saved, changes))
        expected = jnp.sqrt(left / jnp.where(measure > 0, measure, 1.0))
        turned = jnp.max(jnp.abs(now - state.done)[:, 0], initial=0.0)
        resists = factors.resists()
        length = jnp.sqrt(jnp.sum(((now - state.now) / unit[None]) ** 2))
        longest = jnp.where(first, length, state.first)
        ratio = jnp.where(first, 0.0, length / state.last)
        size = jnp.sqrt(jnp.sum((now / unit[None]) ** 2))
        rounded = length <= _ROUNDING * size
        small = rounded | (length <= _SMALL_CORRECTION * longest)
        share = jnp.where(small, 0.0, ratio / _LARGEST_CONTRACTION)
        before = jnp.where(first, response, state.response)
        apart = jnp.sqrt(jnp.sum(((response - before) / unit_of_free) ** 2))
        apart /= jnp.where(longest > 0, longest, 1.0)
        share = jnp.maximum(share, apart / _LARGEST_DIFFERENCE)
        curving = jnp.where(first, 0.0, jnp.maximum(share, state.curving))
        contracts = share <= 1
        sane = resists & jnp.isfinite(change) & (turned <= _LARGEST_TURN) & contracts
        # a step that drives saw only the slope of the way they take
        seen = ~first | jnp.all(move == 0)
        # increments on the way are followed less closely than the last one
        enough = jnp.where(goal < 1, jnp.sqrt(tolerance), tolerance)
        # rounding errors, which no longer contract, of a mechanism of many bodies
        rounded &= ratio > _LARGEST_CONTRACTION
        rounded &= expected <= jnp.sqrt(jnp.finfo(float).eps)
        converged = sane & seen & ((expected <= enough) | rounded)

        finite = slope.finite() & jnp.all(jnp.isfinite(right))
        cut = ~converged & (~sane | (state.tries + 1 >= _STEPS_EACH))
        # both are proportional to the increment
        change_of_stride = _GOOD_SHARE / jnp.where(curving > 0, curving, 1.0)
        shorter = jnp.where(contracts, 0.25, jnp.clip(change_of_stride, 0.1, 0.5))
        stride = jnp.where(cut, shorter * state.stride, state.stride)
        least = jnp.maximum(_LEAST_STEP, _LEAST_SHARE * state.fraction)
        steps = state.steps + 1
        status = jnp.select(
            [
                (state.steps == 0) & ~finite,
                converged & (goal >= 1),
                # hardly loaded, it is the mechanism itself that does not resist
                (stride < least) & (state.fraction == 0) & first & ~resists,
                stride < least,
                steps >= max_steps,
            ],
            [NOT_FINITE, CONVERGED, LOOSE, STUCK, USED_UP],
            RUNNING,
        )
        fraction = jnp.where(converged, goal, state.fraction)
        left = 1 - fraction
        longer = jnp.where(curving > 0, jnp.clip(change_of_stride, 0.5, 4.0), 4.0)
        # no last stride so short that only rounding is left of it
        grown = jnp.where(1.05 * longer * stride > left, left, longer * stride)
        return State(
            now=jnp.where(cut, state.done, now),
            borne=jnp.where(cut, state.done_borne, foreseen),
            done=jnp.where(converged, now, state.done),
            done_borne=jnp.where(converged, foreseen, state.done_borne),
            fraction=fraction,
            stride=jnp.where(converged, grown, stride),
            tries=jnp.where(converged | cut, 0, state.tries + 1),
            changes=changes,
            scale=scale,
            first=longest,
            last=length,
            lacking=lacking,
            response=before,
            curving=jnp.where(converged | cut, 0.0, curving),
            steps=steps,
            status=status,
        )

    zero, none = jnp.zeros(()), jnp.zeros((), int)
    nothing = jnp.zeros(len(problem.free))
    borne = problem.hinge_assembly.tension(start)
    state = State(
        now=start,
        borne=borne,
        done=start,
        done_borne=borne,
        fraction=zero,
        stride=zero + 1,
        tries=none,
        changes=nothing,
        scale=zero,
        first=zero,
        last=zero,
        lacking=nothing,
        response=nothing,
        curving=zero,
        steps=none,
        status=none,
    )
    state = jax.lax.while_loop(lambda state: state.status == RUNNING, advance, state)
    return Settled(state.done, state.fraction, state.steps, state.status)


def _units(problem: Problem) -> Float[Array, "3"]:
    """The units of a body's displacement: 1 rad, and the length of a lever; rad, m, m."""
    lever = problem.hinge_assembly.lever(problem.places.free)
    lever = jnp.where(lever > 0, lever, 1.0)
    return jnp.stack([jnp.ones_like(lever), lever, lever])


@jax.custom_jvp
def follow(
    problem: Problem,
    root: Float[Array, " free"],
    reference: Poses,
    found: Bool[Array, ""],
) -> Array:
    """The free coordinates at equilibrium, as a function of the problem.

    `root` is where they are, found beforehand, and `reference` where the held ones are. The
    derivative is that of the equilibrium itself, by the implicit function theorem, not of
    Newton's way to it; being written with `follow` again, it has derivatives of every
    order. Where no equilibrium was found it is zero, not NaN, which a sum over a batch
    could not mask.
    """
    del problem, reference, found
    return root


@follow.defjvp
def _(primals, tangents):
    problem, root, reference, found = primals
    change, _, moved, _ = tangents
    free = follow(problem, root, reference, found)

    def unbalanced(problem: Problem, reference: Poses):
        displacements = problem.place(reference, free=free, driven=problem.targets)
        return problem.residual(displacements)[problem.free]

    dynamic, static = eqx.partition(problem, eqx.is_inexact_array)
    rates = eqx.filter(change, eqx.is_inexact_array)
    _, pull = jax.jvp(
        lambda dynamic, reference: unbalanced(eqx.combine(dynamic, static), reference),
        (dynamic, reference),
        (rates, moved),
    )
    displacements = problem.place(reference, free=free, driven=problem.targets)
    _, slope, _ = problem.tangent(displacements)
    pull = jnp.where(found, pull, 0.0)
    return free, -slope.where(found).factors(problem.symmetric).solve(pull)
