"""Equilibrium of a mechanism under loads and imposed motions."""

from collections.abc import Sequence
from functools import lru_cache, partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, ScalarLike

from .._checks import all_known, known, need_float64
from .._types import Poses, PosesLike, Scalar, Wrenches
from ..boundary import Drive, driven, Load, loaded, Loads
from ..couplings import Couplings
from ..mechanism import Mechanism
from . import newton
from .problem import Places, Problem
from .results import counted, meaning, outcomes, Placed, raise_failed, RESULTS
from .tables import Column, Columns


class Equilibrium(Placed):
    """Where the bodies of a mechanism rest, and what holds them there.

    Where none was found, displacements, reactions and energy are NaN, with derivatives of
    zero, so that a batch can be masked by `succeeded`; `reached` and `fraction` tell how
    far it went.

    Args:
        displacements: of each body from its rest; rad, m, m.
        rest: the poses from which they count; rad, m, m.
        reactions: what held and driven coordinates receive from outside; zero elsewhere.
            About each body's origin, in world axes; N m, N, N.
        energy: stored in the hinges; J.
        reached: displacements under that fraction of the loads and drives; rad, m, m.
        fraction: that was reached: 1, or less where it failed.
        steps: of Newton's method.
        result: how it ended: `RESULTS.successful`, or what went wrong; `outcomes` gives
            its name.
        names: of the bodies, for its rows.
    """

    displacements: Poses
    rest: Poses
    reactions: Wrenches
    energy: Scalar
    reached: Poses
    fraction: Scalar
    steps: Int[Array, ""]
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)

    def columns(self) -> Columns:
        told = self._by_body(self.poses)
        return {**told, "energy": Column(self.energy, (), "J")}

    def __repr__(self) -> str:
        ended = outcomes(self.result)
        seen = all_known([self.reached, self.energy, self.fraction])
        if ended is None or seen is None:
            return eqx.tree_pformat(self)
        if ended.shape:
            return counted("equilibria", ended)
        moved, energy, fraction = seen
        title = (
            f"{ended}: {100 * float(fraction):.4g} % of loads and drives, "
            f"{int(self.steps)} Newton steps"
        )
        if np.isfinite(energy):
            title += f", {float(energy):.6g} J in the hinges"
        return self._listed(title, "body", moved)


def equilibrium(
    mechanism: Mechanism,
    *,
    loads: Sequence[Load] = (),
    drives: Sequence[Drive] = (),
    start: PosesLike | Equilibrium | None = None,
    tolerance: float = 1e-10,
    max_steps: int = 400,
    throw: bool = True,
) -> Equilibrium:
    """Where a mechanism comes to rest under loads and imposed motions.

    Displacements may be large: where the whole load is too much for one solve it is
    applied in steps, cut and grown as the mechanism allows, so that the answer continues
    the state at rest. Held and driven coordinates are given exactly, and their reactions
    returned. The answer has derivatives of every order, forward and reverse, by
    everything that made the mechanism, its loads and its drives.

    An unstable equilibrium is not an answer. Of loads that follow a body, which have no
    potential, only the first loss of stability is seen.

    Args:
        mechanism: at rest where nothing loads it.
        loads: on its bodies.
        drives: of coordinates that are not held.
        start: Equilibrium, or poses, from which to begin, by default at rest. Best is an
            equilibrium whose loads are near the new ones; rad, m, m.
        tolerance: on the answer, relative: of the energy at work, its root.
        max_steps: of Newton's method, altogether.
        throw: whether a failure is raised, or only told by the answer. In a batch a
            failure of one is raised for all; with `throw=False` the others are unharmed.

    Returns:
        The equilibrium; NaN where there is none, with `throw=False`.

    Raises:
        ValueError: double precision is off; a name is unknown; a coordinate is driven
            twice, or driven and held; a shape is wrong; a setting makes no sense.
        RuntimeError: no equilibrium was found; the text says why.

    Source:
        Equations 5.25 and 6.4 of the dissertation, with the multipliers eliminated.

    Example:
        >>> from twistorjax import Body, Hinge, Mechanism, Quadratic
        >>> spring = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0])))
        >>> hinge = Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
        >>> mechanism = Mechanism([Body("wall"), Body("block")], [hinge], held=["wall"])
        >>> rest = equilibrium(mechanism, loads=[Load("block", (0.0, 5.0, 0.0))])
        >>> rest.displacement("block"), rest.reaction("wall")
        (Array([0.  , 0.05, 0.  ], dtype=float64), Array([ 0., -5.,  0.], dtype=float64))
    """
    need_float64(mechanism.rest)
    mechanism.need_support()
    if not 0 < tolerance < 1 or max_steps < 1:
        raise ValueError(
            f"`tolerance` is {tolerance!r} and `max_steps` is {max_steps!r}, but they "
            "must lie between 0 and 1, and be at least 1."
        )
    bodies = loaded(mechanism, loads)
    places, targets = driven(mechanism, drives)
    answer = _solve(
        mechanism.couplings,
        mechanism.rest,
        None if start is None else mechanism.displacements(start, "start", one=True),
        tuple(loads),
        targets,
        tolerance,
        max_steps,
        bodies=bodies,
        places=Places(
            free_coordinates(len(mechanism.names), mechanism.held, places), places
        ),
        names=mechanism.names,
    )
    return raised(answer, mechanism) if throw else answer


def within_range(
    mechanism: Mechanism, name: str, state: PosesLike | Equilibrium
) -> Poses:
    """The displacements of a state, unless a hinge is beyond its range there.

    Args:
        mechanism: whose bodies they are.
        name: what messages call the state.
        state: an equilibrium, or poses; rad, m, m.
    """
    moved = mechanism.displacements(state, name, one=True)
    beyond = jnp.any(mechanism.couplings.beyond(moved))
    if known(beyond) is None:
        return jnp.where(beyond, jnp.nan, moved)
    if beyond:
        raise ValueError(
            f"`{name}` displaces a hinge beyond the range in which its energy is known. "
            f"{mechanism.ranges_beyond(mechanism.rest + moved)}"
        )
    return moved


@lru_cache(maxsize=256)
def free_coordinates(
    bodies: int, held: tuple[int, ...], driven: tuple[int, ...]
) -> tuple[int, ...]:
    """The places of the coordinates that are neither held nor driven."""
    given = {*held, *driven}
    return tuple(place for place in range(3 * bodies) if place not in given)


@partial(jax.jit, static_argnames=("bodies", "places", "names"))
def _solve(
    couplings: Couplings,
    rest: Poses,
    begin: Poses | None,
    loads: tuple[Load, ...],
    targets: tuple[Scalar, ...],
    tolerance: ScalarLike,
    max_steps: ScalarLike,
    *,
    bodies: tuple[int, ...],
    places: Places,
    names: tuple[str, ...],
) -> Equilibrium:
    problem = Problem(
        couplings, Loads.of(loads, bodies, rest), jnp.array(targets, float), places
    )
    begin = jnp.zeros_like(rest) if begin is None else begin
    settled = newton.settle(
        jax.lax.stop_gradient(problem),
        jax.lax.stop_gradient(begin),
        tolerance,
        max_steps,
    )
    flat = settled.displacements.reshape(-1)
    found = settled.status == newton.CONVERGED
    free = newton.follow(problem, flat[problem.free], begin, found)
    given = jnp.where(found, problem.targets, flat[problem.driven])
    displacements = problem.place(begin, free=free, driven=given)
    beyond = found & jnp.any(couplings.beyond(settled.displacements))
    sure = found & ~beyond
    held = jnp.ones(flat.size).at[problem.free].set(0.0)
    reactions = (held * problem.residual(displacements)).reshape(rest.shape)
    result = RESULTS.successful
    for status, item in (
        (newton.NOT_FINITE, RESULTS.not_finite),
        (newton.LOOSE, RESULTS.loose),
        (newton.STUCK, RESULTS.no_equilibrium),
        (newton.USED_UP, RESULTS.steps_used_up),
    ):
        result = RESULTS.where(settled.status == status, item, result)
    result = RESULTS.where(beyond, RESULTS.out_of_range, result)
    return Equilibrium(
        displacements=jnp.where(sure, displacements, jnp.nan),
        rest=rest,
        reactions=jnp.where(sure, reactions, jnp.nan),
        energy=jnp.where(sure, problem.couplings.energy(displacements), jnp.nan),
        reached=settled.displacements,
        fraction=settled.fraction,
        steps=settled.steps,
        result=result,
        names=names,
    )


def raised(answer: Equilibrium, mechanism: Mechanism | None = None) -> Equilibrium:
    """The answer, if it succeeded; otherwise its failure is raised.

    Given the mechanism of one answer, its text names the hinges beyond their range.
    """
    return raise_failed(answer, partial(_failure, answer, mechanism))


def _failure(
    answer: Equilibrium, mechanism: Mechanism | None, item: str, lane: tuple[int, ...]
) -> RuntimeError:
    fraction, steps = (
        np.asarray(value)[lane] for value in (answer.fraction, answer.steps)
    )
    where = f" in lane {', '.join(map(str, lane))} of the batch" if lane else ""
    text = meaning(item)
    if item == "out_of_range" and mechanism is not None and not lane:
        text += f" {mechanism.ranges_beyond(mechanism.rest + answer.reached)}"
    return RuntimeError(f"{text} (fraction {fraction:.4g}, {steps} Newton steps{where})")
