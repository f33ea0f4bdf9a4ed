"""Equilibrium of a mechanism under loads and imposed motions."""

from collections.abc import Sequence
from functools import lru_cache, partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, ScalarLike

from .._utils.types import Poses, PosesLike, Scalar, Wrenches
from .._utils.validation import all_concrete, concrete, require_float64
from ..mechanism.hinge_assembly import HingeAssembly
from ..mechanism.loads import Drive, driven, Load, loaded_bodies, LoadSet
from ..mechanism.mechanism import Mechanism
from . import newton
from .results import (
    count_results,
    PoseSolution,
    raise_failed,
    result_message,
    result_names,
    RESULTS,
)
from .static_system import DofPartition, Problem
from .tables import Column, Columns


class Equilibrium(PoseSolution):
    """Where the bodies of a mechanism rest, and what holds them there.

    Where none was found, displacements, reactions and energy are NaN, with derivatives of
    zero, so that a batch can be masked by `succeeded`; `reached` and `fraction` tell how
    far it went.

    Args:
        displacements: of each body from its rest; rad, m, m.
        reference: the poses from which they count; rad, m, m.
        reactions: what held and driven coordinates receive from outside; zero elsewhere.
            About each body's origin, in world axes; N m, N, N.
        energy: stored in the hinges; J.
        reached: displacements under that fraction of the loads and drives; rad, m, m.
        fraction: that was reached: 1, or less where it failed.
        steps: of Newton's method.
        result: how it ended: `RESULTS.successful`, or what went wrong; `result_names` gives
            its name.
        names: of the bodies, for its rows.
    """

    displacements: Poses
    reference: Poses
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
        ended = result_names(self.result)
        seen = all_concrete([self.reached, self.energy, self.fraction])
        if ended is None or seen is None:
            return eqx.tree_pformat(self)
        if ended.shape:
            return count_results("equilibria", ended)
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
        >>> mechanism = Mechanism([Body("wall"), Body("block")], [hinge], fixed=["wall"])
        >>> solution = equilibrium(mechanism, loads=[Load("block", (0.0, 5.0, 0.0))])
        >>> solution.displacement("block"), solution.reaction("wall")
        (Array([0.  , 0.05, 0.  ], dtype=float64), Array([ 0., -5.,  0.], dtype=float64))
    """
    require_float64(mechanism.reference)
    mechanism.require_support()
    if not 0 < tolerance < 1 or max_steps < 1:
        raise ValueError(
            f"`tolerance` is {tolerance!r} and `max_steps` is {max_steps!r}, but they "
            "must lie between 0 and 1, and be at least 1."
        )
    bodies = loaded_bodies(mechanism, loads)
    places, targets = driven(mechanism, drives)
    answer = _solve(
        mechanism.hinge_assembly,
        mechanism.reference,
        None if start is None else mechanism.displacements(start, "start", one=True),
        tuple(loads),
        targets,
        tolerance,
        max_steps,
        bodies=bodies,
        places=DofPartition(
            free_coordinates(len(mechanism.names), mechanism.fixed, places), places
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
    beyond = jnp.any(mechanism.hinge_assembly.out_of_range(moved))
    if concrete(beyond) is None:
        return jnp.where(beyond, jnp.nan, moved)
    if beyond:
        raise ValueError(
            f"`{name}` displaces a hinge beyond the range in which its energy is known. "
            f"{mechanism.range_messages(mechanism.reference + moved)}"
        )
    return moved


@lru_cache(maxsize=256)
def free_coordinates(
    bodies: int, fixed: tuple[int, ...], driven: tuple[int, ...]
) -> tuple[int, ...]:
    """The places of the coordinates that are neither held nor driven."""
    given = {*fixed, *driven}
    return tuple(place for place in range(3 * bodies) if place not in given)


@partial(jax.jit, static_argnames=("bodies", "places", "names"))
def _solve(
    hinge_assembly: HingeAssembly,
    reference: Poses,
    begin: Poses | None,
    loads: tuple[Load, ...],
    targets: tuple[Scalar, ...],
    tolerance: ScalarLike,
    max_steps: ScalarLike,
    *,
    bodies: tuple[int, ...],
    places: DofPartition,
    names: tuple[str, ...],
) -> Equilibrium:
    problem = Problem(
        hinge_assembly,
        LoadSet.of(loads, bodies, reference),
        jnp.array(targets, float),
        places,
    )
    begin = jnp.zeros_like(reference) if begin is None else begin
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
    beyond = found & jnp.any(hinge_assembly.out_of_range(settled.displacements))
    sure = found & ~beyond
    fixed = jnp.ones(flat.size).at[problem.free].set(0.0)
    reactions = (fixed * problem.residual(displacements)).reshape(reference.shape)
    result = RESULTS.successful
    for status, item in (
        (newton.NOT_FINITE, RESULTS.not_finite),
        (newton.LOOSE, RESULTS.unstable),
        (newton.STUCK, RESULTS.no_equilibrium),
        (newton.USED_UP, RESULTS.steps_used_up),
    ):
        result = RESULTS.where(settled.status == status, item, result)
    result = RESULTS.where(beyond, RESULTS.out_of_range, result)
    return Equilibrium(
        displacements=jnp.where(sure, displacements, jnp.nan),
        reference=reference,
        reactions=jnp.where(sure, reactions, jnp.nan),
        energy=jnp.where(sure, problem.hinge_assembly.energy(displacements), jnp.nan),
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
    answer: Equilibrium,
    mechanism: Mechanism | None,
    item: str,
    batch_index: tuple[int, ...],
) -> RuntimeError:
    fraction, steps = (
        np.asarray(value)[batch_index] for value in (answer.fraction, answer.steps)
    )
    where = (
        f" in lane {', '.join(map(str, batch_index))} of the batch" if batch_index else ""
    )
    text = result_message(item)
    if item == "out_of_range" and mechanism is not None and not batch_index:
        text += f" {mechanism.range_messages(mechanism.reference + answer.reached)}"
    return RuntimeError(f"{text} (fraction {fraction:.4g}, {steps} Newton steps{where})")
