"""What was measured: a test on a mechanism, its readings, and how sure they are."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .._utils.pytrees import alike
from .._utils.validation import all_concrete, concrete
from ..mechanism.mechanism import Mechanism
from .compilation import fast_compile


class AbstractTest(eqx.Module):
    """What is done to a mechanism, and what is read.

    Readings form a table: a row for each trial, time or vibration, a column for each
    sensor.
    """

    @abstractmethod
    def read(
        self, mechanism: Mechanism, *, forward: bool = True, throw: bool = True
    ) -> Float[Array, "rows columns"]:
        """What a mechanism would read, without error.

        Args:
            mechanism: on which the test is done.
            forward: whether it will be differentiated forwards, or in reverse.
            throw: whether a solve that fails is raised; otherwise its rows are NaN.
        """

    @property
    @abstractmethod
    def columns(self) -> tuple[str, ...]:
        """What the columns are called."""

    @property
    @abstractmethod
    def units(self) -> tuple[str, ...]:
        """In which they read."""

    @property
    @abstractmethod
    def deviations(self) -> Float[Array, "rows columns"]:
        """The standard deviation of each reading."""

    def measured(
        self,
        values: Float[ArrayLike, "rows columns"] | Sequence[Sequence[ArrayLike]],
        deviations: Float[ArrayLike, "*rows columns"] | None = None,
    ) -> "Measurement":
        """The test with what was read.

        Args:
            values: a row for each trial, time or vibration, a column for each sensor;
                NaN where nothing was read.
            deviations: of each reading, by default those of the sensors.

        Raises:
            ValueError: a shape is wrong, nothing was read, or a deviation is not
                positive.
        """
        told = self.deviations if deviations is None else jnp.asarray(deviations, float)
        shape = self.deviations.shape
        try:
            array = jnp.asarray(values, float)
        except ValueError:
            raise ValueError(
                f"`values` has rows of different lengths, but this test reads {shape[0]} "
                f"rows of {shape[1]}: {', '.join(self.columns)}. Give NaN where nothing "
                "was read."
            ) from None
        if array.shape != shape:
            raise ValueError(
                f"`values` has shape {array.shape}, but this test reads {shape[0]} rows "
                f"of {shape[1]}: {', '.join(self.columns)}."
            )
        try:
            told = jnp.broadcast_to(told, shape)
        except ValueError:
            raise ValueError(
                f"`deviations` has shape {told.shape}, but must fit {shape}."
            ) from None
        seen = concrete(told)
        if seen is not None and not np.all((seen > 0) & np.isfinite(seen)):
            raise ValueError("`deviations` must be positive and finite.")
        seen = concrete(array)
        if seen is not None and np.any(np.isinf(seen)):
            raise ValueError("`values` is infinite somewhere: NaN is for no reading.")
        if seen is not None and np.all(np.isnan(seen)):
            raise ValueError("`values` has no reading: all are NaN.")
        return Measurement(self, array, told)

    def synthetic_data(
        self, mechanism: Mechanism, key: Array | int | None = None
    ) -> "Measurement":
        """The test with what a known mechanism would read.

        Args:
            mechanism: on which it is done.
            key: of random numbers, or a whole number to make it of, for the errors of the
                sensors; by default there are none.
        """
        arrays = eqx.filter((self, mechanism), eqx.is_array)
        if all_concrete(jax.tree.leaves(arrays)) is None:
            values = self.read(mechanism, throw=False)
        else:
            values = _read(self, mechanism)
            if np.any(np.isnan(values)):
                self.read(mechanism, throw=True)  # which says why
        if key is not None:
            noise = jax.random.normal(a_key(key), values.shape, values.dtype)
            values = values + self.deviations * noise
        return Measurement(self, values, self.deviations)


class Measurement(eqx.Module):
    """A test, and what was read in it.

    Args:
        test: what was done.
        values: what was read; NaN where nothing was.
        deviations: of each reading.
    """

    test: AbstractTest
    values: Float[Array, "rows columns"]
    deviations: Float[Array, "rows columns"]

    def residuals(
        self, mechanism: Mechanism, *, forward: bool = True
    ) -> Float[Array, "rows columns"]:
        """What a mechanism would read less what was read, in standard deviations.

        Zero where nothing was read, NaN where the mechanism has no answer.
        """
        model = self.test.read(mechanism, forward=forward, throw=False)
        there = jnp.isfinite(self.values)
        apart = model - jnp.where(there, self.values, 0.0)
        return jnp.where(there, apart / self.deviations, 0.0)

    def __repr__(self) -> str:
        seen = concrete(self.values)
        if seen is None or seen.ndim != 2:
            return eqx.tree_pformat(self)
        count = int(np.sum(np.isfinite(seen)))
        return f"{count} readings of {self.test!r}"


@fast_compile
def _read(test: AbstractTest, mechanism: Mechanism) -> Float[Array, "rows columns"]:
    return test.read(mechanism, throw=False)


def a_key(key: Array | int) -> Array:
    """A key of random numbers, of a whole number, too.

    Raises:
        ValueError: it is neither.
    """
    small = not isinstance(key, int) or -(2**63) <= key < 2**63
    if isinstance(key, bool) or not isinstance(key, int | Array) or not small:
        raise ValueError(
            f"`key` is {key!r}, but must be a whole number of at most 63 bits, or a key: "
            "jax.random.key(0)."
        )
    return jax.random.key(key) if isinstance(key, int) else key


def mapped(function: Callable[[Any], Array], things: Sequence[Any]) -> list[Array]:
    """A function of each thing, those of like structure mapped as one.

    Args:
        function: of a tree.
        things: trees; the like ones are stacked.

    Returns:
        What it gives for each thing, in their order.
    """
    given: dict[int, Array] = {}
    for places in alike(things):
        if len(places) == 1:
            given[places[0]] = function(things[places[0]])
            continue
        several = [things[place] for place in places]
        stack = jax.tree.map(lambda *leaves: jnp.stack(leaves), *several)
        given.update(zip(places, jax.vmap(function)(stack), strict=True))
    return [given[place] for place in range(len(things))]


def as_tree(function: Any) -> Any:
    """A function that may stand in a tree of arrays, as part of its structure."""
    if isinstance(function, eqx.Module):
        return function
    return jax.tree_util.Partial(function)


def so_many_deviations(given: Any, count: int) -> Float[Array, " count"]:
    """So many standard deviations, of one or of as many."""
    sizes = jnp.asarray(given, float)
    if sizes.shape not in ((), (count,)):
        raise ValueError(
            f"`deviation` has shape {sizes.shape}, but must be one number, or {count}."
        )
    seen = concrete(sizes)
    if seen is not None and not np.all((seen > 0) & np.isfinite(seen)):
        raise ValueError(f"`deviation` is {seen.tolist()}, but must be positive.")
    return jnp.broadcast_to(sizes, (count,))
