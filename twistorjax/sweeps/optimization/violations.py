"""Shares of varying designs that violate the limits of an optimization."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np

from ..._utils.pytrees import entry_names
from ..._utils.types import NumbersLike
from ...designs.design_space import DesignSpace
from ...designs.sampling import sample_designs
from ..sweep import sweep
from .limits import Limit


if TYPE_CHECKING:
    import xarray


# Largest number of limits that are printed.
_MOST_PRINTED = 10


class Violations(NamedTuple):
    """Shares of sampled designs that violate limits.

    Args:
        any_limit: Share of the designs that violate a limit, or for which the study
            fails.
        by_limit: Share of the designs that violate each limit, by the name of the entry
            of the output and the side, such as "stress[left] upper".
        failed: Share of the designs for which the study fails.
        designs: Number of designs.
    """

    any_limit: float
    by_limit: Mapping[str, float]
    failed: float
    designs: int

    def __repr__(self) -> str:
        ranked = sorted(self.by_limit.items(), key=lambda item: -item[1])
        shares = {"any limit": self.any_limit, **dict(ranked[:_MOST_PRINTED])}
        if self.failed:
            shares["failed"] = self.failed
        width = max(map(len, shares))
        lines = [f"share of {self.designs:,} designs that violate a limit"]
        lines += [
            f"{name:<{width}}  {100 * share:7.2f} %" for name, share in shares.items()
        ]
        return "\n".join(lines)


def violations(
    study: Callable[[Any], Any],
    parameters: Any,
    limits: Mapping[str, Limit],
    standard_deviations: Mapping[str, NumbersLike],
    count: int,
    seed: int,
    sweep_options: Mapping[str, Any],
) -> Violations:
    """Count the designs that violate a limit.

    Args:
        study: Function of one design.
        parameters: Mean of each parameter.
        limits: Limits of the outputs, by name.
        standard_deviations: Standard deviation of each uncertain parameter, by name.
        count: Number of designs.
        seed: Seed of the random number generator.
        sweep_options: Further arguments of `sweep`.

    Returns:
        The shares.

    Raises:
        ValueError: There is no uncertain parameter, or a standard deviation is not valid.
    """
    if not standard_deviations:
        raise ValueError(
            "No parameter is uncertain. Give `standard_deviations` of some parameters."
        )
    space = DesignSpace.from_tree(parameters, standard_deviations)
    normal = space.normal_tree(space.start)
    designs = sample_designs(normal, count, method="random", seed=seed)
    table = sweep(study, designs, **sweep_options)
    failed = ~np.asarray(table["succeeded"])
    by_limit: dict[str, np.ndarray] = {}
    for name, limit in limits.items():
        values = np.asarray(table[name])
        for side, bound, sign in (("lower", limit.lower, 1), ("upper", limit.upper, -1)):
            if bound is not None:
                below = (sign * (values - bound) < 0).reshape(count, -1)
                for entry, column in zip(_entry_names(table, name), below.T, strict=True):
                    by_limit[f"{entry} {side}"] = column
    violated = np.any([failed, *by_limit.values()], axis=0)
    shares = {name: float(np.mean(each)) for name, each in by_limit.items()}
    return Violations(float(np.mean(violated)), shares, float(np.mean(failed)), count)


def _entry_names(table: "xarray.Dataset", name: str) -> list[str]:
    """Return the names of the entries of an output, such as "stress[left]"."""
    axes, shape = table[name].dims[1:], table[name].shape[1:]
    if len(axes) == 1 and axes[0] in table.coords:
        return [f"{name}[{label}]" for label in np.asarray(table[axes[0]])]
    return entry_names(name, shape)
