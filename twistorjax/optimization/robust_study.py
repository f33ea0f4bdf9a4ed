"""Study that also returns the standard deviations of its outputs, to first order."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array

from .._utils.pytrees import path_name
from ..solve.tables import Column
from ..sweeps.outputs import read_study
from .design_space import DESIGN, DEVIATIONS


class RobustStudy:
    """A study with the standard deviations of some outputs as further outputs.

    The standard deviation of an output y is, to first order, the root of the sum of the
    squares of s dy/dp over all uncertain numbers p with the standard deviations s. The
    standard deviation of `stress` has the name of `deviation_name("stress")`.

    Two instances are equal if they have the same study and the same outputs, so that they
    share a compiled program.

    Args:
        study: Function of one design. `RobustStudy` takes a mapping of this design and of
            the standard deviation of each uncertain parameter.
        names: Names of the outputs.
    """

    def __init__(self, study: Callable[[Any], Any], names: tuple[str, ...]):
        self._study, self._names = study, names
        self.__qualname__ = getattr(study, "__qualname__", type(study).__qualname__)

    def __call__(self, given: Any) -> dict[str, Any]:
        leaves, structure = jax.tree_util.tree_flatten_with_path(given[DESIGN])
        names = [path_name(path) for path, _ in leaves]
        values = [leaf for _, leaf in leaves]
        uncertain = {name: values[names.index(name)] for name in given[DEVIATIONS]}
        point, unravel = ravel_pytree(uncertain)
        scales = ravel_pytree(given[DEVIATIONS])[0]

        def selected(point: Array) -> Any:
            changed = {**dict(zip(names, values, strict=True)), **unravel(point)}
            design = jax.tree.unflatten(structure, [changed[name] for name in names])
            columns, results = read_study(self._study, design)
            for name in self._names:
                if name not in columns:
                    raise ValueError(
                        f"`limits` names {name!r}, but the outputs of the study are "
                        f"{', '.join(map(repr, columns))}."
                    )
            return [columns[name].values for name in self._names], (columns, results)

        def directional(direction: Array) -> Any:
            values, changes, others = jax.jvp(
                selected, (point,), (direction,), has_aux=True
            )
            return values, changes, others

        _, changes, (columns, results) = jax.vmap(directional, out_axes=(None, 0, None))(
            jnp.diag(scales)
        )
        deviations = {}
        for name, change in zip(self._names, changes, strict=True):
            variance = jnp.sum(change**2, axis=0)
            # The derivative of the root is infinite at zero.
            positive = jnp.where(variance > 0, variance, 1.0)
            values = jnp.where(variance > 0, jnp.sqrt(positive), 0.0)
            column = columns[name]
            deviations[deviation_name(name)] = Column(
                values, column.axes, column.unit, column.labels
            )
        return {**columns, **deviations, "results": results}

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RobustStudy) and self._signature == other._signature

    def __hash__(self) -> int:
        return hash(self._signature)

    @property
    def _signature(self) -> tuple[Any, ...]:
        return self._study, self._names


def deviation_name(name: str) -> str:
    """Return the name of the standard deviation of an output."""
    return f"standard deviation of {name}"
