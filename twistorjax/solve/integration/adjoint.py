"""Reverse-mode derivatives of a motion, step by step.

The forward pass records the states from which its steps start. The backward pass goes
through these steps in reverse order. For each step it multiplies the derivative with
respect to the end of the step by the Jacobian of the step. Step lengths are constants.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..._utils.pytrees import select, stop_gradient
from ..._utils.types import Scalar


# Number of states that are recorded in the forward pass. A longer motion keeps every
# second, fourth, ... of them, and the backward pass computes the others again.
_RECORDED_STATES = 512


class Start(NamedTuple):
    """What a solver of diffrax needs at the start of a step."""

    state: Any  # State of the motion
    solver_state: Any


class Inputs(NamedTuple):
    """Inputs of a motion by which it is differentiated."""

    # Function that makes a step, and the values over which it closes, for example those
    # of loads that are functions of time
    step: Callable
    args: Any  # Arguments of the equations of motion
    start: Start  # State at the start of the motion
    first_time: Scalar  # Time at the start; s
    saved_times: Float[Array, " times"]  # Times at which the motion is saved; s


class Record(NamedTuple):
    """The accepted steps of a motion."""

    starts: Start  # Recorded starts of steps, stacked. The last row is not used.
    ends: Any  # Time at the end of each step; s
    # Number of steps from one recorded start to the next one, a power of two
    stride: Int[Array, ""]

    @classmethod
    def empty(cls, start: Start, time: Scalar, max_steps: int) -> "Record":
        """Return a record without steps, with space for those of a motion."""
        capacity = min(_RECORDED_STATES, 1 << (max_steps - 1).bit_length())
        starts = _stack_of_zeros(start, capacity + 1)
        return cls(starts, jnp.zeros(max_steps, jnp.result_type(time)), jnp.array(1))

    @property
    def capacity(self) -> int:
        """Number of starts that can be recorded."""
        return jax.tree.leaves(self.starts, is_leaf=_has_shape)[0].shape[0] - 1

    @property
    def longest_stride(self) -> int:
        """Stride of the longest motion."""
        return 1 << max(0, -(-self.ends.shape[0] // self.capacity) - 1).bit_length()

    def add(self, index: Int[Array, ""], start: Start, end: Scalar) -> "Record":
        """Add the step with an index, or replace it if it was rejected."""
        stride = jnp.where(index >= self.stride * self.capacity, 2, 1) * self.stride
        row = jnp.where(_remainder(index, stride) == 0, self._row(index), self.capacity)
        starts = set_row(self.starts, row, start)
        return Record(starts, set_row(self.ends, index, end), stride)

    def start(self, index: Int[Array, ""]) -> Start:
        """Return the start of a step whose index is a multiple of the stride."""
        return get_row(self.starts, self._row(index))

    def _row(self, index: Int[Array, ""]) -> Int[Array, ""]:
        """Return the row of a start: its index, or a row that is not needed any more.

        While the stride doubles from s to 2 s, the starts with odd multiples of s are
        replaced, in their order, by the new ones.
        """
        stride = self.longest_stride
        while stride > 1:
            stride //= 2
            first = self.capacity * stride
            pair = (index - first) >> (2 * stride).bit_length() - 1
            replaced = (2 * pair + 1) * stride
            index = jnp.where(index >= first, replaced, index)
        return index


def _remainder(index: Int[Array, ""], stride: int | Int[Array, ""]) -> Int[Array, ""]:
    """Return the remainder of the division by a power of two, in one operation.

    The division of integers takes a dozen operations, a tenth of the compiled program.
    """
    return index & (stride - 1)


def _has_shape(value: Any) -> bool:
    """Return whether a value is an array, or an array in a loop of equinox."""
    return hasattr(value, "shape")


def _stack_of_zeros(tree: Any, rows: int) -> Any:
    """Return stacked pytrees of zeros, with a number of rows."""
    return jax.tree.map(lambda value: jnp.zeros((rows, *value.shape), value.dtype), tree)


def get_row(tree: Any, index: int | Int[Array, ""]) -> Any:
    """Return one row of stacked pytrees."""
    return jax.tree.map(lambda values: values[index], tree, is_leaf=_has_shape)


def set_row(tree: Any, index: Int[Array, ""], row: Any, condition: Any = True) -> Any:
    """Replace one row of stacked pytrees, if a condition is satisfied."""
    return jax.tree.map(
        lambda values, value: eqxi.buffer_at_set(values, index, value, pred=condition),
        tree, row, is_leaf=_has_shape,
    )  # fmt: skip


class _SolverWithStep(eqx.Module):
    """A solver of diffrax with another function for its step."""

    solver: dfx.AbstractSolver
    function: Callable

    @property
    def interpolation_cls(self):
        return self.solver.interpolation_cls

    def error_order(self, terms):
        return self.solver.error_order(terms)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        del terms, made_jump
        return self.function(args, t0, t1, Start(y0, solver_state))


class StepwiseAdjoint(dfx.AbstractAdjoint):
    """Reverse-mode derivatives of a motion, for the collocation methods without events.

    Its programs are smaller than those of `diffrax.RecursiveCheckpointAdjoint`. There are
    no second derivatives in reverse mode, but forward-mode derivatives of the gradient.
    """

    def loop(self, *, args, terms, solver, saveat, init_state, t0, **settings):
        for name in ("throw", "passed_solver_state", "passed_controller_state"):
            settings.pop(name)
        start = Start(init_state.y, init_state.solver_state)

        def step(args: Any, t0: Scalar, t1: Scalar, start: Start) -> tuple:
            return solver.step(
                terms, t0, t1, start.state, args, start.solver_state, False
            )

        step = eqx.filter_closure_convert(step, args, t0, t0, start)
        inputs = Inputs(step, args, start, t0, saveat.subs[0].ts)
        settings |= {"terms": terms, "loop": self._loop}
        return _solve(inputs, stop_gradient((solver, saveat, init_state, settings)))


def _solve_with(outer_loop: Callable, inputs: Inputs, constants: Any) -> Any:
    """Return the result of diffrax with a given outer loop."""
    solver, saveat, state, settings = constants
    settings = dict(settings)
    loop = settings.pop("loop")
    return loop(
        args=inputs.args,
        solver=_SolverWithStep(solver, inputs.step),
        saveat=eqx.tree_at(lambda saveat: saveat.subs[0].ts, saveat, inputs.saved_times),
        init_state=eqx.tree_at(
            lambda state: (state.y, state.solver_state), state, tuple(inputs.start)
        ),
        t0=inputs.first_time,
        inner_while_loop=_while_loop,
        outer_while_loop=outer_loop,
        **settings,
    )


_while_loop = partial(eqxi.while_loop, kind="lax")


@eqx.filter_custom_vjp
def _solve(inputs: Inputs, constants: Any) -> Any:
    return _solve_with(_while_loop, inputs, constants)


@_solve.def_fwd
def _solve_and_record(perturbed: Inputs, inputs: Inputs, constants: Any) -> Any:
    """Return the result of diffrax, and what the backward pass needs."""
    del perturbed
    records = []

    def recording_loop(condition, body, state, *, max_steps, buffers):
        def record_and_step(carry):
            state, record = carry
            start = Start(state.y, state.solver_state)
            return body(state), record.add(state.num_accepted_steps, start, state.tnext)

        state, record = _while_loop(
            lambda carry: condition(carry[0]),
            record_and_step,
            (state, Record.empty(inputs.start, state.tnext, max_steps)),
            max_steps=max_steps,
            buffers=lambda carry: (*buffers(carry[0]), carry[1].starts, carry[1].ends),
        )
        records.append(record)
        return state

    result = _solve_with(recording_loop, inputs, constants)
    state, _ = result
    (record,) = records
    return result, (record, state.num_accepted_steps, state.save_state[0].save_index)


class _Carry(eqx.Module):
    """State of the backward pass."""

    index: Int[Array, ""]  # Index of the step that is differentiated next
    position: Int[Array, ""]  # Index of the step that begins at `current`
    current: Start  # Start of a step, at most the one with the index
    segment: Start | None  # Starts of the steps since the last recorded start, stacked
    row: Int[Array, ""]  # Index of the last saved time that is not yet differentiated
    by_end: Start  # Derivative with respect to the end of the step with the index
    by_values: Any  # Derivatives with respect to step function and arguments
    by_shift: Scalar  # Derivative with respect to a shift of the times of all steps
    by_times: Float[Array, " times"]  # Derivative with respect to the saved times


@_solve.def_bwd
def _differentiate(
    residuals: Any, gradient: Any, perturbed: Inputs, inputs: Inputs, constants: Any
) -> Inputs:
    """Go through the steps in reverse order."""
    record, count, saved_count = residuals
    interpolation = constants[0].interpolation_cls
    zero = jnp.zeros_like(inputs.first_time)
    zeros = partial(jax.tree.map, jnp.zeros_like)
    by_saved, by_last = (part.ys for part in gradient[0].save_state)
    start = inputs.start.state
    by_saved = _or_zero(by_saved, _stack_of_zeros(start, len(inputs.saved_times)))
    by_last = get_row(_or_zero(by_last, _stack_of_zeros(start, 1)), 0)
    values, static = eqx.partition((inputs.step, inputs.args), eqx.is_array)
    values, constant = eqx.partition(values, (perturbed.step, perturbed.args))

    def times(index: Array, shift: Scalar) -> tuple[Scalar, Scalar]:
        start = jnp.where(index > 0, record.ends[index - 1], inputs.first_time)
        return start + shift, record.ends[index] + shift

    def step(index: Array, values: Any, shift: Scalar, start: Start) -> tuple[Start, Any]:
        function, args = eqx.combine(values, constant, static)
        state, _, dense, solver_state, _ = function(args, *times(index, shift), start)
        return Start(state, solver_state), dense

    def differentiate_output(
        index: Array, dense: Any, row: Array, by_times: Array
    ) -> tuple[Array, Any, Scalar, Array]:
        """Differentiate the states that were saved during a step."""
        first, _ = times(index, zero)

        def output(dense: Any, shift: Scalar, time: Scalar) -> Any:
            t0, t1 = times(index, shift)
            return interpolation(t0=t0, t1=t1, **dense).evaluate(time)

        def in_step(carry: tuple) -> Array:
            row = carry[0]
            return (row >= 0) & ((inputs.saved_times[row] > first) | (index == 0))

        def add(carry: tuple) -> tuple:
            row, by_dense, by_shift, by_times = carry
            _, pullback = jax.vjp(output, dense, zero, inputs.saved_times[row])
            parts = pullback(get_row(by_saved, row))
            by_dense, by_shift = jax.tree.map(jnp.add, (by_dense, by_shift), parts[:2])
            return row - 1, by_dense, by_shift, by_times.at[row].add(parts[2])

        return jax.lax.while_loop(in_step, add, (row, zeros(dense), zero, by_times))

    def recorded(index: Array) -> tuple[Array, Start]:
        """Return the last recorded start that is not after that of a step."""
        position = index - _remainder(index, record.stride)
        return position, record.start(position)

    def before(index: Array, segment: Start | None) -> tuple[Array, Start]:
        """Return the last known start before that of a step."""
        previous = jnp.maximum(index - 1, 0)
        if record.longest_stride == 1:
            return recorded(previous)
        in_segment = (
            previous,
            get_row(segment, _remainder(previous, record.longest_stride)),
        )
        at_record = _remainder(index, record.stride) == 0
        return select(at_record, recorded(previous), in_segment)

    def go_back(carry: _Carry) -> _Carry:
        """Differentiate a step, or replay it if a later one is differentiated first."""
        replay = carry.position < carry.index
        (end, dense), pullback = jax.vjp(
            partial(step, carry.position), values, zero, carry.current
        )
        row = jnp.where(replay, -1, carry.row)
        row, by_dense, shift_by_output, by_times = differentiate_output(
            carry.position, dense, row, carry.by_times
        )
        parts, shift_by_step, by_start = pullback((carry.by_end, by_dense))
        segment_row = _remainder(carry.position, record.longest_stride)
        segment = set_row(carry.segment, segment_row, carry.current, replay)
        position, current = before(carry.index, segment)
        gone_back = _Carry(
            index=carry.index - 1,
            position=position,
            current=current,
            segment=None,
            row=row,
            by_end=by_start,
            by_values=jax.tree.map(jnp.add, carry.by_values, parts),
            by_shift=carry.by_shift + shift_by_output + shift_by_step,
            by_times=by_times,
        )
        replayed = replace(carry, position=carry.position + 1, current=end, segment=None)
        return replace(select(replay, replayed, gone_back), segment=segment)

    segment = None
    if record.longest_stride > 1:
        segment = _stack_of_zeros(inputs.start, record.longest_stride)
    position, current = recorded(jnp.maximum(count - 1, 0))
    carry = _while_loop(
        lambda carry: carry.index >= 0,
        go_back,
        _Carry(
            index=count - 1,
            position=position,
            current=current,
            segment=segment,
            row=saved_count - 1,
            by_end=Start(by_last, zeros(inputs.start.solver_state)),
            by_values=zeros(values),
            by_shift=zero,
            by_times=_or_zero(gradient[0].save_state[0].ts, inputs.saved_times),
        ),
        buffers=lambda carry: carry.segment,
        max_steps=None,
    )
    by_step, by_args = carry.by_values
    return Inputs(by_step, by_args, carry.by_end, carry.by_shift, carry.by_times)


def _or_zero(gradient: Any, values: Any) -> Any:
    """Replace gradients that are None by zeros with the shapes of the values."""
    return jax.tree.map(
        lambda value, part: jnp.zeros_like(value) if part is None else part,
        values, gradient,
    )  # fmt: skip
