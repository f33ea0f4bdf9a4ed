"""Newton's method along a growing load, and the derivatives of where it ends."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, ScalarLike

from .._types import Poses, Scalar
from ..boundary import Loads
from ..couplings import Couplings


RUNNING, CONVERGED, NOT_FINITE, LOOSE, STUCK, USED_UP = range(6)


class Places(NamedTuple):
    """Which coordinates are free and which are driven; the others are held."""

    free: tuple[int, ...]
    driven: tuple[int, ...]


class Problem(eqx.Module):
    """The equilibrium of couplings under loads, with some coordinates given.

    Coordinates are the bodies' displacements from rest, three a body. Those neither free
    nor driven are held where they start.

    Args:
        couplings: the hinges.
        loads: at their full size.
        targets: what the driven coordinates come to.
        places: of the free and of the driven coordinates.
    """

    couplings: Couplings
    loads: Loads
    targets: Float[Array, " driven"]
    places: Places = eqx.field(static=True)

    @property
    def free(self) -> np.ndarray:
        """Places of the free coordinates."""
        return np.array(self.places.free, int)

    @property
    def symmetric(self) -> bool:
        """Whether the loads have a potential, as all do that keep their direction."""
        return not any(self.loads.follows)

    @property
    def driven(self) -> np.ndarray:
        """Places of the driven coordinates."""
        return np.array(self.places.driven, int)

    def residual(self, displacements: Poses) -> Float[Array, " coordinates"]:
        """What hinges and loads leave unbalanced: the reactions where it is held."""
        applied, _ = self.loads.apply(displacements)
        return (self.couplings.forces(displacements) - applied).reshape(-1)

    def tangent(
        self,
        displacements: Poses,
        fraction: Scalar | float = 1.0,
        borne: Float[Array, "3 hinges"] | None = None,
    ) -> tuple[
        Float[Array, " coordinates"], Float[Array, "free free_and_driven"], Scalar
    ]:
        """The residual under a fraction of the loads, its slope, and the work in hinges.

        `borne` is the tension with which the hinges stiffen as they turn.
        """
        free, driven = self.places
        columns = free + driven
        forces, slope, work = self.couplings.tangent(displacements, free, columns, borne)
        if not self.loads.bodies:
            return forces, slope, work
        applied, by_angle = self.loads.apply(displacements)
        applied, by_angle = fraction * applied.reshape(-1), fraction * by_angle
        # a load's wrench depends on the angle of its own body alone
        place = {coordinate: column for column, coordinate in enumerate(columns)}
        pairs = [
            (row, place[3 * (coordinate // 3)], coordinate)
            for row, coordinate in enumerate(free)
            if coordinate // 3 in self.loads.bodies and 3 * (coordinate // 3) in place
        ]
        if pairs:
            rows, where, which = np.array(pairs).T
            slope = slope.at[rows, where].add(-by_angle.reshape(-1)[which])
        return forces - applied, slope, work

    def place(
        self,
        displacements: Poses,
        free: Array | None = None,
        driven: Array | None = None,
    ) -> Poses:
        """The displacements with new values of the free or the driven coordinates."""
        flat = displacements.reshape(-1)
        if free is not None:
            flat = flat.at[self.free].set(free)
        if driven is not None:
            flat = flat.at[self.driven].set(driven)
        return flat.reshape(displacements.shape)


class Factors(NamedTuple):
    """A tangent scaled by its diagonal, so that units do not matter, and factored.

    A symmetric one by Cholesky's method, which fails where the equilibrium is unstable:
    then all that follows from it is NaN.
    """

    scale: Float[Array, " free"]
    triangle: Float[Array, "free free"]
    pivots: Int[Array, " free"] | None

    @classmethod
    def of(cls, matrix: Float[Array, "free free"], symmetric: bool) -> "Factors":
        """Factors a tangent."""
        diagonal = jnp.abs(jnp.diagonal(matrix))
        scale = jnp.where(diagonal > 0, diagonal, 1.0) ** -0.5
        scaled = scale[:, None] * matrix * scale[None]
        if symmetric:
            return cls(scale, jnp.linalg.cholesky(scaled, symmetrize_input=False), None)
        return cls(scale, *jax.scipy.linalg.lu_factor(scaled))

    def solve(self, right: Float[Array, " free"]) -> Float[Array, " free"]:
        """The displacements that balance some forces."""
        right = self.scale * right
        if self.pivots is None:
            answer = jax.scipy.linalg.cho_solve((self.triangle, True), right)
        else:
            answer = jax.scipy.linalg.lu_solve((self.triangle, self.pivots), right)
        return self.scale * answer

    def resists(self) -> Bool[Array, ""]:
        """Whether every displacement meets resistance, beyond rounding.

        With followers the determinant's sign is all that is seen: it changes where a
        first displacement meets none.
        """
        diagonal = jnp.diagonal(self.triangle)
        if self.pivots is None:
            return jnp.all(diagonal > 1e-7)  # Cholesky's are the roots of pivots
        swaps = jnp.sum(self.pivots != jnp.arange(self.pivots.size, dtype=jnp.int32))
        negative = jnp.sum(diagonal < 0)
        upright = (swaps + negative) % 2 == 0
        return upright & jnp.all(jnp.abs(diagonal) > 1e-14)


class Settled(NamedTuple):
    """Where Newton's method ended, and how."""

    displacements: Poses
    fraction: Scalar
    steps: Int[Array, ""]
    status: Int[Array, ""]


# A load step is cut when it turns a body further, lest Newton end on another branch of
# equilibria; when it has not converged in so many steps; and not below the least.
_LARGEST_TURN = 1.0
_STEPS_EACH = 12
_LEAST_STEP = 1e-5


def settle(
    problem: Problem, start: Poses, tolerance: ScalarLike, max_steps: ScalarLike
) -> Settled:
    """Follows the equilibrium from `start` to the full loads and drives.

    Newton's method on a growing fraction of them, at first all. What holds the mechanism
    at `start` fades as they grow: at rest nothing, at another equilibrium its loads.
    Driven coordinates are moved within the first step of each fraction, together with
    the first answer of the free ones. Errors are measured by the energy that a step
    changes, against the energy at work in the hinges; near the answer each step's share
    of the last one tells what the next would be, and saves it.
    """
    rows = problem.free
    begin = start.reshape(-1)[problem.driven]
    count = len(problem.free)
    holding = problem.couplings.forces(start).reshape(-1)[rows]

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
        steps: Int[Array, ""]
        status: Int[Array, ""]

    def advance(state: State) -> State:
        goal = state.fraction + state.stride
        residual, slope, work = problem.tangent(state.now, goal, state.borne)
        flat = state.now.reshape(-1)
        given = begin + goal * (problem.targets - begin)
        move = given - flat[problem.driven]
        residual = residual[rows] - (1 - goal) * holding
        right = -(residual + slope[:, count:] @ move)
        factors = Factors.of(slope[:, :count], problem.symmetric)
        step = factors.solve(right)
        now = problem.place(
            problem.place(state.now, free=flat[rows] + step), driven=given
        )

        def tension(displacements: Poses) -> Float[Array, "3 hinges"]:
            return problem.couplings.tension(displacements, state.borne)

        foreseen = sum(jax.jvp(tension, (state.now,), (now - state.now,)))

        changes = jnp.abs(step * right)
        change = jnp.sum(changes)
        first = state.tries == 0
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
        sane = resists & jnp.isfinite(change) & (turned <= _LARGEST_TURN)
        # a step that drives saw only the slope of the way they take
        seen = ~first | jnp.all(move == 0)
        converged = sane & seen & (expected <= tolerance)

        finite = jnp.all(jnp.isfinite(slope)) & jnp.all(jnp.isfinite(right))
        cut = ~converged & (~sane | (state.tries + 1 >= _STEPS_EACH))
        stride = jnp.where(cut, state.stride / 4, state.stride)
        steps = state.steps + 1
        status = jnp.select(
            [
                (state.steps == 0) & ~finite,
                converged & (goal >= 1),
                # hardly loaded, it is the mechanism itself that does not resist
                (stride < _LEAST_STEP) & (state.fraction == 0) & first & ~resists,
                stride < _LEAST_STEP,
                steps >= max_steps,
            ],
            [NOT_FINITE, CONVERGED, LOOSE, STUCK, USED_UP],
            RUNNING,
        )
        fraction = jnp.where(converged, goal, state.fraction)
        left = 1 - fraction
        # no last stride so short that only rounding is left of it
        grown = jnp.where(2.1 * stride > left, left, 2 * stride)
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
            steps=steps,
            status=status,
        )

    zero, none = jnp.zeros(()), jnp.zeros((), int)
    nothing = jnp.zeros(count)
    borne = problem.couplings.tension(start)
    state = State(
        start, borne, start, borne, zero, zero + 1, none, nothing, zero, none, none
    )
    state = jax.lax.while_loop(lambda state: state.status == RUNNING, advance, state)
    return Settled(state.done, state.fraction, state.steps, state.status)


@jax.custom_jvp
def follow(
    problem: Problem, root: Float[Array, " free"], rest: Poses, found: Bool[Array, ""]
) -> Array:
    """The free coordinates at equilibrium, as a function of the problem.

    `root` is where they are, found beforehand, and `rest` where the held ones are. The
    derivative is that of the equilibrium itself, by the implicit function theorem, not of
    Newton's way to it; being written with `follow` again, it has derivatives of every
    order. Where no equilibrium was found it is zero, not NaN, which a sum over a batch
    could not mask.
    """
    del problem, rest, found
    return root


@follow.defjvp
def _(primals, tangents):
    problem, root, rest, found = primals
    change, _, moved, _ = tangents
    free = follow(problem, root, rest, found)

    def unbalanced(problem: Problem, rest: Poses):
        displacements = problem.place(rest, free=free, driven=problem.targets)
        return problem.residual(displacements)[problem.free]

    dynamic, static = eqx.partition(problem, eqx.is_inexact_array)
    rates = eqx.filter(change, eqx.is_inexact_array)
    _, pull = jax.jvp(
        lambda dynamic, rest: unbalanced(eqx.combine(dynamic, static), rest),
        (dynamic, rest),
        (rates, moved),
    )
    displacements = problem.place(rest, free=free, driven=problem.targets)
    _, slope, _ = problem.tangent(displacements)
    count = len(problem.free)
    slope = jnp.where(found, slope[:, :count], jnp.eye(count))
    pull = jnp.where(found, pull, 0.0)
    return free, -Factors.of(slope, problem.symmetric).solve(pull)
