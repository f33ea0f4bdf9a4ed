"""Result codes of solvers, and the errors that they raise."""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._utils.host import concrete, is_traced
from .._utils.types import BatchFlag


class RESULTS(eqx.Enumeration):  # pyright: ignore[reportGeneralTypeIssues]
    """Reasons why a solve ended.

    A result prints its name, which is `result_names(solution.result)`.
    `RESULTS[solution.result]` is its message, which is empty for `successful`.

    * Equilibria end as `successful`, `not_finite`, `unstable`, `no_equilibrium`,
      `steps_used_up`, `inconsistent_constraints`, or `out_of_range`.
    * Linear responses and vibrations end as `successful`, `not_finite`, `unstable`, or
      `inconsistent_constraints`; frequency responses as `successful`, `not_finite`, or
      `inconsistent_constraints`.
    * Paths end as `successful` at a limit of the load factor, `event_occurred`,
      `returned_to_start`, `max_points_reached`, `out_of_range`, `path_interrupted`,
      `critical_point_not_found`, `until_not_a_number`, `not_finite`, or `unstable` if a
      body can move without any resistance.
    * Buckling analyses end as `successful`, `critical_point_not_found`, `out_of_range`,
      `unstable`, or `not_finite`; searches for a second stable state as `successful`,
      `no_equilibrium`, or as paths.
    * Ends of a range of motion end as `successful`, `stress_exceeded`,
      `stress_not_reached`, or as paths.
    * Motions end as `successful`, `event_occurred`, `max_steps_reached`, `not_finite`,
      `out_of_range`, `step_too_long`, `step_too_short`, or `solver_failed`. If they
      cannot start, they end as `not_finite`, `times_not_increasing`, `drive_jumps`,
      `damping_gives_energy`, or `inconsistent_constraints`.
    * Identifications end as `successful`, `not_converged`, or `no_solution_at_start`;
      optimizations also as `no_feasible_design`.
    """

    successful = ""
    not_finite = (
        "A value of the mechanism, its loads, or its prescribed displacements is not "
        "finite: a NaN was given, a dimension of a hinge is outside the range of its "
        "formula, or its energy is not defined at its displacement. Build the mechanism "
        "once without `jax.grad`, `jax.vmap`, and `jax.jit`: the message then names the "
        "value."
    )
    unstable = (
        "A body can move without an increase of the energy, so the equilibrium is not "
        "unique or not stable: the `stiffness` of the mechanism is singular or has a "
        "negative eigenvalue. Fix the body with `fixed`, prescribe its displacement, or "
        "add a hinge or a stiffer one."
    )
    no_equilibrium = (
        "No equilibrium at the full loads and prescribed displacements was found that "
        "is connected to the start. `fraction` is the part of them that was reached: "
        "there the mechanism may buckle or snap through, or a hinge may leave the range "
        "of its energy. `path` follows the mechanism beyond such a point. Reduce the "
        "loads, prescribe a displacement instead of a load, or, if a symmetric mechanism "
        "may buckle to either side, add a small load that selects a side. Check also the "
        "units (m, Pa) and the positions of the hinges."
    )
    steps_used_up = (
        "The largest number of Newton steps was reached. `fraction` is the part of the "
        "loads and prescribed displacements that was reached. Check the units (m, Pa) "
        "and the positions of the hinges, increase `max_steps`, or give a `start` that "
        "is closer to the equilibrium."
    )
    out_of_range = (
        "The displacement of a hinge is outside the validity range of its energy. Create "
        "the energy for a larger range, or reduce the loads."
    )

    event_occurred = "The motion or the path ended at an event."
    max_steps_reached = (
        "The largest number of steps was reached before the last time. Increase "
        "`max_steps`, or simulate a shorter time."
    )
    step_too_short = (
        "The solver needs steps that are shorter than the smallest one that its step "
        "size controller allows. Increase the tolerance, or allow shorter steps."
    )
    solver_failed = (
        "The solver of diffrax could not solve the equations of a step. Use the default "
        "`solver`, or a larger tolerance."
    )
    step_too_long = (
        "The steps of constant length are too long for this motion: the equations of one "
        "step did not converge. Give a shorter `step`, or leave it out, so that the "
        "tolerance determines the steps."
    )
    times_not_increasing = (
        "The times do not increase. Give at least two times in increasing order. The "
        "times of `saveat` must lie between the first and the last of them."
    )
    drive_jumps = (
        "At the first time, the prescribed displacement of a coordinate differs from its "
        "initial displacement, so the coordinate would have to jump. Let the prescribed "
        "motion begin at the initial displacement, or change `start`."
    )
    damping_gives_energy = (
        "The damping of a hinge has a negative eigenvalue, so it would supply energy to "
        "the mechanism instead of dissipating it. Every eigenvalue must be zero or "
        "positive."
    )
    inconsistent_constraints = (
        "The constraints are redundant or contradict one another, or the given state "
        "violates them."
    )

    not_converged = (
        "The search has not converged. Increase `max_steps`, give better start values or "
        "more of them, or leave out parameters that have no effect. A problem without "
        "limits may have no optimum."
    )
    no_solution_at_start = (
        "At the start values of the parameters, a solve fails, or a value or its "
        "derivative is not finite. Give other start values."
    )

    returned_to_start = "The path is closed: it returned to its first point."
    max_points_reached = (
        "The largest number of points was reached before the end of the path. Increase "
        "`max_points` or `largest_step`."
    )
    path_interrupted = (
        "No next point of the path was found, even at a very short distance. Several "
        "branches may meet at one point, as in a mechanism with several symmetries, or "
        "an energy may not be smooth. Break the symmetry by a small load, use smooth "
        "energies, or start in another `direction` from a multiple branch point."
    )
    critical_point_not_found = (
        "A critical point was not found. On a path, the number of negative eigenvalues "
        "of the stiffness changes between two points, but no critical point between them "
        "explains this change: the path may have jumped to another one. It ends before; "
        "reduce `largest_step`. In a buckling analysis, the stiffness is not singular "
        "near the load factor of the linearized equations; use `path`."
    )
    until_not_a_number = (
        "The function `until` returned NaN on the path, so the end of the path is not "
        "known. Let it return a number at every point."
    )

    stress_exceeded = (
        "Without the input, the stress in a hinge already exceeds its allowable stress. "
        "Reduce the constant loads or the misfits, or allow a larger stress."
    )
    stress_not_reached = (
        "The input does not change the stress in any hinge with an allowable stress, or "
        "the stress stays below it for all inputs. Give another input."
    )

    no_feasible_design = (
        "No search ended at a design within all limits. Relax a limit or a bound, or "
        "give more `starts`."
    )


def result_names(result: RESULTS) -> np.ndarray | None:
    """Return the names of results, such as "successful".

    Args:
        result: Result of a solution, or of a batch of solutions.

    Returns:
        Array of names with the shape of the batch; None if the result is traced.
    """
    index = concrete(result._value)
    return (
        None if index is None else np.array(np.array(RESULT_NAMES, object)[index], object)
    )


def result_of_status(
    status: Any, results: Sequence[tuple[Any, RESULTS]], default: RESULTS
) -> RESULTS:
    """Convert the status of a solver to a result.

    The status is a traced integer or a member of an enumeration of equinox. Those that
    are not in `results` get the default.
    """
    result = default
    for value, item in results:
        result = RESULTS.where(status == value, item, result)
    return result


def is_success(result: RESULTS) -> BatchFlag:
    """Decide whether a solve succeeded, or an event ended the motion.

    If the result is not traced, no program is compiled for the comparison.
    """
    successes = (
        RESULTS.successful,
        RESULTS.event_occurred,
        RESULTS.returned_to_start,
    )
    index = concrete(result._value)
    if index is None:
        return jnp.any(jnp.stack([result == item for item in successes]), axis=0)
    return jax.device_put(np.isin(index, [int(item._value) for item in successes]))


def count_results(noun: str, names: np.ndarray) -> str:
    """Return one line with the number of solutions of a batch for each result."""
    counts = Counter(map(str, names.ravel()))
    words = ", ".join(f"{count:,} {name}" for name, count in counts.items())
    return f"{names.size:,} {noun}, of shape {names.shape}: {words}"


class Solution(eqx.Module):
    """The solution of an analysis, which reports how it ended."""

    result: eqx.AbstractVar[RESULTS]
    _plural: eqx.AbstractClassVar[str]  # What several such solutions are called
    _result_axes: ClassVar[int] = 0  # Axes of the result of a single solution

    @property
    def succeeded(self) -> BatchFlag:
        """Whether the solve succeeded, or an event ended the motion or the path."""
        return is_success(self.result)

    def _summary(self, names: np.ndarray) -> str:
        """Describe a single solution that is not traced; `names` are of its result."""
        del names
        return eqx.tree_pformat(self)

    def _batch_summary(self, names: np.ndarray) -> str:
        """Describe several solutions, from the names of their results."""
        return count_results(self._plural, names)

    def __repr__(self) -> str:
        names = result_names(self.result)
        if names is None or is_traced(self):
            return eqx.tree_pformat(self)
        if names.ndim > self._result_axes:
            return self._batch_summary(names)
        return self._summary(names)


AnySolution = TypeVar("AnySolution", bound=Solution)


# Results whose reason is in the arguments of the user
_INVALID_INPUT = (
    "times_not_increasing",
    "drive_jumps",
    "damping_gives_energy",
    "inconsistent_constraints",
)


def result_error(name: str, batch_index: tuple[int, ...], more: str = "") -> Exception:
    """Return the error of a result, from its name and its index in a batch.

    `more` follows the message of the result.
    """
    index = ", ".join(map(str, batch_index))
    place = f" (at index {index} of the batch)" if index else ""
    error = ValueError if name in _INVALID_INPUT else RuntimeError
    return error(f"{result_message(name)}{more}{place}")


def finish(
    solution: AnySolution,
    throw: bool,
    error: Callable[[str, tuple[int, ...]], Exception] = result_error,
) -> AnySolution:
    """Return a solution; if it may `throw`, raise the error of the first failed one.

    `error` returns this error from the name of the result and the index in the batch.
    """
    if not throw:
        return solution
    index = concrete(solution.result._value)
    if index is None:
        return solution.result.error_if(solution, ~solution.succeeded)
    if not np.any(index):  # `successful` is the first item, so most calls end here
        return solution
    names = result_names(solution.result)
    failed = ~np.asarray(solution.succeeded)
    if np.any(failed):
        index = tuple(map(int, np.unravel_index(np.argmax(failed), failed.shape)))
        raise error(np.asarray(names)[index], index)
    return solution


def result_message(name: str) -> str:
    """Return the message of a result, by its name."""
    return RESULTS[getattr(RESULTS, name)]


# The names of the results, in the order of their values in the enumeration.
RESULT_NAMES = tuple(
    sorted(RESULTS._name_to_item, key=lambda name: int(getattr(RESULTS, name)._value))
)

_Item: Any = type(RESULTS.successful)


class _NamedResult(_Item):
    """A result that prints its name. Equinox prints the message, which may be empty."""

    def __repr__(self) -> str:
        known = not self.is_traced() and isinstance(self._value, np.ndarray | Array)
        return f"RESULTS<{result_names(self) if known else RESULTS[self]}>"


_where: Any = RESULTS.where


def _named_where(pred: Any, a: RESULTS, b: RESULTS) -> RESULTS:
    """Select one of two results; see `eqx.Enumeration.where`."""
    return _NamedResult(_where(pred, a, b)._value, RESULTS)


for _name, _item in RESULTS._name_to_item.items():
    RESULTS._name_to_item[_name] = _NamedResult(_item._value, RESULTS)

RESULTS.where = _named_where
