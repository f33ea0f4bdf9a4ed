"""Unknowns of a design, found from what was measured on it."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from .._utils.validation import (
    all_concrete,
    compilation_error,
    require_float64,
    require_kind,
)
from ..mechanism.mechanism import Mechanism
from ..solve.results import raise_failed, result_message, RESULTS
from .compilation import fast_compile
from .measurement import a_key, as_tree, Measurement
from .objective import Problem
from .optimizer import AbstractDescent, constant, Found, Gradient, Marquardt, Optimistix
from .parameters import ParameterSet
from .report import Identification


# more unknowns than these are differentiated in reverse, where a method allows it
_MANY = 32


def identify(
    design: Callable[[Any], Mechanism],
    start: Any,
    data: Sequence[Measurement],
    *,
    held_out: Sequence[Measurement] = (),
    method: optax.GradientTransformation | optx.AbstractLeastSquaresSolver | None = None,
    robust: float | None = None,
    restarts: int = 0,
    spread: float = 0.5,
    key: Array | int | None = None,
    tolerance: float = 1e-8,
    max_steps: int | None = None,
    reverse: bool | None = None,
    progress: bool = False,
    throw: bool = True,
) -> Identification:
    """The unknowns with which a design reproduces what was measured on it.

    Least squares of the residuals, each in its reading's standard deviation, by the exact
    derivatives of equilibria, motions and frequencies. Unknowns are changed by parts of
    their own size, and stay within their bounds.

    Args:
        design: builds the mechanism from the unknowns. Define it once: another function
            is compiled anew.
        start: what the design takes, a tree: each of its numbers is unknown, and starts
            from there; or, where it has `Parameter`s, with their units and bounds, these
            alone are.
        data: what was measured: `test.measured(values)` of one or several tests.
        held_out: what was measured as well, and is to take no part: the fit is only
            compared with it.
        method: by default Levenberg's and Marquardt's; an optimiser of optax, for
            gradient descent, say `optax.sgd(0.5)`, where 1 would be the step of Gauss and
            Newton; or a least-squares solver of optimistix.
        robust: standard deviations beyond which a reading counts by its size instead of
            its square, against outliers (Huber's loss); 1.345 costs 5 % of the precision
            where there are none. It does not help against one that alone decides.
        restarts: how many more starts are tried, side by side. The best is taken.
        spread: standard deviation of the starts about the first, as relative changes.
        key: of random numbers, for these, or a whole number to make it of.
        tolerance: relative, of the estimates.
        max_steps: evaluations at most; by default 100, of gradient descent 3000.
        reverse: whether gradient descent differentiates in reverse, as is best for many
            unknowns; by default, for more than 32.
        progress: whether a bar is shown.
        throw: whether a failure is raised, or only told by the answer.

    Returns:
        The estimates, and how far they can be trusted.

    Raises:
        ValueError: double precision is off; there is no unknown or no measurement; the
            start is out of bounds; a setting makes no sense; or what a test refuses.
        RuntimeError: the design has no answer to a test at the start; the search did not
            settle.

    Source:
        Nocedal and Wright, Numerical Optimization, chapter 10; Huber, Ann. Math. Stat.
        35, 1964.

    Example:
        >>> from twistorjax import Body, Hinge, Load, Mechanism, Quadratic
        >>> from twistorjax.identification import BodySensor, StaticTest, Parameter
        >>> def spring(along):
        ...     energy = Quadratic(jnp.diag(jnp.stack([1.0, along, 10.0])))
        ...     hinge = Hinge("spring", "wall", "block", energy, at=(0, 0, 0))
        ...     return Mechanism([Body("wall"), Body("block")], [hinge], fixed=["wall"])
        >>> push, gauge = Load("block", (0, 5, 0)), BodySensor("block", "x", 1e-4)
        >>> pulled = StaticTest([[push]], [gauge])
        >>> identify(spring, Parameter(80.0, "N/m", above=0), [pulled.measured([[0.05]])])
        successful: 1 unknown from 1 reading in ... evaluations; residual ... standard ...
        unknown         estimate    ± standard error
        value          100  ± 0.2 N/m
        warning: 1 reading for 1 unknown: ...
    """
    if restarts < 0 or not spread > 0 or not 0 < tolerance < 1:
        raise ValueError(
            f"`restarts` is {restarts}, `spread` {spread} and `tolerance` {tolerance}, "
            "but they must be at least 0, positive, and between 0 and 1."
        )
    if robust is not None and (isinstance(robust, bool) or not robust > 0):
        raise ValueError(
            f"`robust` is {robust}, but must be a positive number of standard "
            "deviations: 1.345."
        )
    unknowns, taken = ParameterSet.of(start), _measured("data", data)
    descent, most = _descent(method, tolerance, unknowns)
    most = most if max_steps is None else max_steps
    if most < 1:
        raise ValueError(f"`max_steps` is {most}, but must be at least 1.")
    fresh = _measured("held_out", held_out)
    if not taken:
        raise ValueError("`data` is empty, but a fit needs a measurement.")
    problem = Problem(as_tree(design), unknowns, taken, fresh, robust)
    require_float64(problem.unknowns.leaves[0].value)
    count = len(problem.unknowns.names)
    matrix = not isinstance(descent, Gradient)
    forward = matrix or not (count > _MANY if reverse is None else reverse)
    try:
        searched = _searched(
            problem, descent, most, forward, restarts, spread, key, progress
        )
    except jax.errors.JAXTypeError as error:
        raise compilation_error("design", "about what is unknown", error) from error
    answer = _answer(problem, searched)
    return _raised(answer) if throw else answer


def _searched(
    problem: Problem,
    descent: AbstractDescent,
    most: int,
    forward: bool,
    restarts: int,
    spread: float,
    key: Array | int | None,
    progress: bool,
) -> "_Search":
    count = len(problem.unknowns.names)
    place = constant(np.zeros(count))
    arrays = jax.tree.leaves(eqx.filter((problem, key), eqx.is_array))
    if restarts:
        key = a_key(0 if key is None else key)
        more = spread * jax.random.normal(key, (restarts, count))
        places = jnp.concatenate([place[None], more])
        return _side_by_side(problem, descent, places, most, forward)
    if all_concrete(arrays) is None:
        return _side_by_side(problem, descent, place, most, forward)
    return _watched(problem, descent, place, most, forward, progress)


class _Search(eqx.Module):
    """How far a search has come.

    Args:
        place: at which it looks next.
        best: the best place so far.
        found: what is there.
        size: of the residual there.
        state: of the method.
        done: whether it has settled.
        steps: evaluations.
    """

    place: Float[Array, "*restarts unknowns"]
    best: Float[Array, "*restarts unknowns"]
    found: Found
    size: Float[Array, "*restarts"]
    state: Any
    done: Bool[Array, "*restarts"]
    steps: Int[Array, "*restarts"]


def _measured(name: str, data: Sequence[Measurement]) -> tuple[Measurement, ...]:
    require_kind(name, data, Measurement)
    return tuple(data)


def _descent(
    method: Any, tolerance: float, unknowns: ParameterSet
) -> tuple[AbstractDescent, int]:
    if method is None:
        bounded = [float(name in unknowns.bounded) for name in unknowns.names]
        return Marquardt(tolerance, constant(bounded)), 100
    if isinstance(method, optax.GradientTransformation):
        return Gradient(method, tolerance), 3000
    if isinstance(method, optx.AbstractLeastSquaresSolver):
        return Optimistix(method), 100
    raise ValueError(
        f"`method` is {method!r}, but must be an optimiser of optax or a least-squares "
        "solver of optimistix: `optax.sgd(0.5)`, `optimistix.Dogleg(1e-8, 1e-8)`."
    )


def _evaluate(problem: Problem, place: Array, forward: bool) -> Found:
    return problem.found(place, forward=forward)


_found = fast_compile(_evaluate)


def _begin(descent: AbstractDescent, place: Array, found: Found) -> _Search:
    """A search before its first step; of what is found only the shapes matter."""
    nothing = jax.tree.map(lambda leaf: constant(np.zeros(leaf.shape)), found)
    return _Search(
        place=place,
        best=place,
        found=nothing,
        size=constant(0.0),
        state=descent.begin(place, nothing),
        done=constant(False),
        steps=constant(0),
    )


def _step(descent: AbstractDescent, search: _Search, found: Found) -> _Search:
    """Goes on with what was found at the place of a search."""
    first = search.steps == 0
    place, state, done = descent.step(search.place, found, search.state)
    better = first | (found.loss < search.found.loss)
    best, kept = jax.tree.map(
        lambda new, old: jnp.where(better, new, old),
        (search.place, found),
        (search.best, search.found),
    )
    lost = first & ~jnp.isfinite(found.loss)
    size = jnp.sqrt(2 * kept.loss)
    steps = search.steps + 1
    return _Search(place, best, kept, size, state, done | lost, steps)


_go_on = fast_compile(_step)


def _watched(
    problem: Problem,
    descent: AbstractDescent,
    place: Array,
    most: int,
    forward: bool,
    progress: bool,
) -> _Search:
    """One search, step by step, so that it can be watched and interrupted."""
    from tqdm import tqdm

    search = None
    with tqdm(total=most, unit="evaluation", leave=False, disable=not progress) as bar:
        for _ in range(most):
            found = _found(problem, place, forward)
            search = _begin(descent, place, found) if search is None else search
            search = _go_on(descent, search, found)
            place = search.place
            bar.update()
            bar.set_postfix_str(f"residual {float(search.size):.4g}")
            if bool(search.done):
                break
    assert search is not None
    return search


@eqx.filter_jit
def _side_by_side(
    problem: Problem, descent: AbstractDescent, places: Array, most: int, forward: bool
) -> _Search:
    """Searches from several starts, or one that is being traced."""

    def one(place: Array) -> _Search:
        shapes = jax.eval_shape(lambda: problem.found(place, forward=forward))
        search = _begin(descent, place, shapes)
        moving, still = eqx.partition(search, eqx.is_array)

        def body(moving: Any) -> Any:
            search = eqx.combine(moving, still)
            found = problem.found(search.place, forward=forward)
            search = _step(descent, search, found)
            return eqx.filter(search, eqx.is_array)

        def going(moving: Any) -> Array:
            return ~moving.done & (moving.steps < most)

        moving = jax.lax.while_loop(going, body, moving)
        return eqx.combine(moving, still)

    return one(places) if places.ndim == 1 else eqx.filter_vmap(one)(places)


@eqx.filter_jit
def _answer(problem: Problem, searched: _Search) -> Identification:
    """What the best of several searches, or the only one, says."""
    search, losses = searched, jnp.atleast_1d(searched.size**2 / 2)
    if searched.done.ndim:
        best = jnp.argmin(losses)
        search = jax.tree.map(
            lambda leaf: leaf[best] if eqx.is_array(leaf) else leaf, searched
        )
    place, found = search.best, search.found
    if found.slopes.ndim == 1:  # of the loss alone, by gradient descent in reverse
        found = problem.found(place)
    row = problem.plain(found.residual)
    ends = np.cumsum([part.values.size for part in problem.data])
    tables = [
        table.reshape(part.values.shape)
        for table, part in zip(jnp.split(row, ends[:-1]), problem.data, strict=True)
    ]
    fresh = ()
    if problem.held_out:
        mechanism = problem.design(problem.unknowns.at(place))
        fresh = tuple(part.residuals(mechanism) for part in problem.held_out)
    result = RESULTS.where(search.done, RESULTS.successful, RESULTS.not_converged)
    nowhere = ~jnp.isfinite(found.loss)
    result = RESULTS.where(nowhere, RESULTS.no_solution_at_start, result)
    return Identification(
        estimates=problem.unknowns.at(place),
        place=place,
        sensitivity=problem.plain_slopes(found),
        residuals=tuple(tables),
        held_out=fresh,
        loss=found.loss,
        losses=losses,
        steps=search.steps,
        result=result,
        problem=problem,
    )


def _raised(answer: Identification) -> Identification:
    """The answer, if it succeeded; otherwise its failure is raised."""

    def failure(item: str, batch_index: tuple[int, ...]) -> Exception:
        text = result_message(item)
        problem = answer.problem
        if item == "no_solution_at_start" and not batch_index:
            mechanism = problem.design(problem.unknowns.at(jnp.zeros_like(answer.place)))
            for part in problem.data:
                try:
                    part.test.read(mechanism)
                except RuntimeError as error:
                    return RuntimeError(f"{text} {part.test!r} says: {error}")
            return ValueError(text)
        where = (
            f" in lane {', '.join(map(str, batch_index))} of the batch"
            if batch_index
            else ""
        )
        steps = np.asarray(answer.steps)[batch_index]
        return RuntimeError(f"{text} ({steps} evaluations{where})")

    return raise_failed(answer, failure)
