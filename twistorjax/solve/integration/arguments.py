"""Checks of the arguments of a motion."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.host import as_float, concrete, on_host, padded_size
from ..._utils.types import NumberLike, NumbersLike, Poses, VelocityLike
from ..._utils.validation import compilation_error, index_of, require_row
from ...mechanism.mechanism import Mechanism


_SMALLEST_TIME_COUNT = 64  # of a compiled program


def check_times(given: NumbersLike) -> Float[Array, " times"]:
    """Convert the times of a motion (s), which must increase, to an array."""
    times = as_float(given)
    if times.ndim != 1 or len(times) < 2:
        raise ValueError(
            f"`times` has shape {times.shape}, but must be a list of at least two times, "
            "the start and the end of the motion."
        )
    check_finite("times", times)
    values = concrete(times)
    if values is not None and (late := np.flatnonzero(np.diff(values) <= 0)).size:
        k = int(late[0])
        raise ValueError(
            f"`times` must increase, but `times[{k + 1}]` = {values[k + 1]:g} comes "
            f"after `times[{k}]` = {values[k]:g}."
        )
    return times


def pad_times(times: Float[Array, " times"]) -> Float[Array, " padded"]:
    """Repeat the last time (s) up to a number of times that many motions share.

    The times must not be traced. The number is a power of two, and 64 or more, so that
    motions with different numbers of times use the same program.
    """
    count = padded_size(len(times), _SMALLEST_TIME_COUNT)
    return as_float(np.pad(times, (0, count - len(times)), mode="edge"))


def check_finite(name: str, array: Array) -> None:
    """Raise a ValueError if an array that is not traced is not finite."""
    values = concrete(array)
    if values is not None and not np.all(np.isfinite(values)):
        raise ValueError(f"`{name}` must be finite, but has {values.tolist()}.")


@contextmanager
def explain_compilation(time: Array, **functions: Any) -> Iterator[None]:
    """Raise a ValueError with the name of a function of time that JAX cannot compile.

    `functions` are tried at a time (s); values that are not functions are ignored.
    """
    try:
        yield
    except jax.errors.JAXTypeError:
        for name, function in functions.items():
            if callable(function):
                try:
                    eqx.filter_eval_shape(function, time)
                except jax.errors.JAXTypeError as error:
                    raise compilation_error(name, "about the time", error) from error
        raise


def check_settings(
    tolerance: NumberLike, max_steps: int, step: NumberLike | None
) -> None:
    """Raise a ValueError if a setting of the solver is not positive."""
    for name, given in (("tolerance", tolerance), ("step", step)):
        value = None if given is None else concrete(given)
        if value is not None and not np.all((value > 0) & np.isfinite(value)):
            raise ValueError(f"`{name}` is {given!r}, but must be positive and finite.")
    if max_steps < 1:
        raise ValueError(f"`max_steps` is {max_steps!r}, but must be at least 1.")


def check_velocities(
    mechanism: Mechanism,
    given: Mapping[str, VelocityLike] | None,
    free: tuple[int, ...],
) -> Poses | None:
    """Arrange the initial velocities of named bodies (rad/s, m/s, m/s) in rows.

    They are zero for the other bodies, and may be given for free coordinates only. If
    none are `given`, the result is None.
    """
    if given is None:
        return None
    if not isinstance(given, Mapping):
        raise ValueError(
            f"`velocities` is {given!r}, but must be a mapping from names of bodies to "
            'velocities (angle, x, y), such as {"link": (0, 1, 0)}.'
        )
    rows = {}
    for name, velocity in given.items():
        body = index_of("`velocities`", "body", name, mechanism.names)
        where = f"`velocities` of the body {name!r}"
        rows[body] = require_row(where, velocity, "(angular velocity, x, y)")
        values = concrete(rows[body])
        for k in range(3):
            dof = 3 * body + k
            if dof not in free and values is not None and values[k] != 0:
                raise ValueError(
                    f"{where} has a velocity for the {mechanism.dof_name(dof)}, but this "
                    "coordinate is fixed or prescribed, which determines its velocity."
                )
    xp, given_rows = on_host(*rows.values())
    if xp is np:
        velocities = np.zeros(mechanism.reference.shape)
        velocities[list(rows)] = np.reshape(given_rows, (-1, 3))
        return as_float(velocities)
    velocities = jnp.zeros(mechanism.reference.shape)
    return velocities.at[np.array(list(rows))].set(jnp.stack(given_rows))
