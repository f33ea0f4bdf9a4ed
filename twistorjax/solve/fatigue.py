"""Fatigue of the hinges of a mechanism under a cyclic input."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from typing_extensions import TypeAliasType

from .._utils.host import all_concrete
from .._utils.progress import announced
from .._utils.pytrees import largest_of
from .._utils.types import BatchScalar, Poses, PosesOrResult
from ..assembly.assembly import HingeAssembly
from ..assembly.stress import member_stresses, rows_of_points, rows_with_stress, strengths
from ..mechanism.mechanism import Mechanism
from ..results.tables import Column, Columns, Tabular


# A path, motion, batch or range of motion; or a list of equilibria
CycleLike = TypeAliasType("CycleLike", PosesOrResult | Sequence[PosesOrResult])


class Fatigue(Tabular):
    """Fatigue of each hinge with an endurance limit, at its most critical point.

    Args:
        amplitude: Half the difference of the largest and the smallest stress; Pa.
        mean: Mean of the largest and the smallest stress; Pa.
        utilization: Ratio of the stress to that of infinite life, by the Goodman
            relation; above 1, the life is finite.
        endurance_limit: Endurance limit of the material of each hinge; Pa.
        ultimate_strength: Its ultimate strength; Pa.
        names: Names of the hinges.
    """

    amplitude: Float[Array, " hinges"]
    mean: Float[Array, " hinges"]
    utilization: Float[Array, " hinges"]
    endurance_limit: Float[Array, " hinges"]
    ultimate_strength: Float[Array, " hinges"]
    names: tuple[str, ...] = eqx.field(static=True)

    @property
    def infinite_life(self) -> Bool[Array, " hinges"]:
        """Whether each hinge has an infinite life."""
        return self.utilization <= 1

    @property
    def safety_factor(self) -> BatchScalar:
        """Smallest factor by which all stresses may be multiplied, for infinite life."""
        return 1 / largest_of(self.utilization)

    def columns(self) -> Columns:
        labels = (("hinge", self.names),)
        return {
            "amplitude": Column(self.amplitude, ("hinge",), "Pa", labels),
            "mean": Column(self.mean, ("hinge",), "Pa", labels),
            "utilization": Column(self.utilization, ("hinge",), "1", labels),
        }

    def __repr__(self) -> str:
        values = all_concrete([self.amplitude, self.mean, self.utilization])
        if values is None or values[0].ndim > 1:
            return eqx.tree_pformat(self)
        width = max(map(len, ("hinge", *self.names)))
        lines = [f"{'hinge':<{width}}  amplitude (MPa)  mean (MPa)  utilization  life"]
        for name, amplitude, mean, utilization in zip(self.names, *values, strict=True):
            life = "infinite" if utilization <= 1 else "finite"
            lines.append(
                f"{name:<{width}}  {amplitude / 1e6:>15.4g}  {mean / 1e6:>10.4g}  "
                f"{utilization:>11.3g}  {life}"
            )
        return "\n".join(lines)


@announced("fatigue")
def fatigue(mechanism: Mechanism, cycle: CycleLike) -> Fatigue:
    """Check whether the hinges of a mechanism have an infinite life under a cycle.

    At each point of the surface of a flexure, amplitude and mean of the stress are those
    of the largest and the smallest stress in the cycle. The life is infinite if

        amplitude / endurance_limit + mean / ultimate_strength <= 1,

    where a negative mean counts as zero. The stresses are those of `stresses`, which do
    not include the stress concentration at fillets and sharp corners; reduce the
    `endurance_limit` by the notch factor, and by factors of surface, size, and
    reliability.

    Args:
        mechanism: The mechanism. Materials of its flexures have an `endurance_limit` and
            an `ultimate_strength`.
        cycle: States of one cycle: two equilibria at its ends, a `RangeOfMotion`, a path,
            a motion, or a batch of equilibria.

    Returns:
        Amplitude, mean, and utilization of each hinge with an endurance limit.

    Raises:
        ValueError: No material has an endurance limit and an ultimate strength, the cycle
            has only one state, or it is not that of the mechanism.

    Source:
        Goodman, Mechanics applied to engineering, 1899.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(
        ...     modulus=210e9, poisson=0.3, ultimate_strength=800e6, endurance_limit=300e6
        ... )
        >>> leaf = tj.flexures.leaf(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
        >>> hinge = tj.Hinge("leaf", "wall", "block", leaf, at=(0, 0, 0))
        >>> bodies = [tj.Body("wall"), tj.Body("block")]
        >>> mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
        >>> bent = tj.equilibrium(mechanism, loads=[tj.Load("block", moment=0.1)])
        >>> fatigue(mechanism, [mechanism.reference, bent])
        hinge  amplitude (MPa)  mean (MPa)  utilization  life
        leaf               120         120         0.55  infinite
    """
    hinges = mechanism.hinge_assembly
    endurance, ultimate = (strengths(hinges, name) for name in ("endurance", "ultimate"))
    if endurance is None or ultimate is None:
        raise ValueError(
            "No material has an endurance limit and an ultimate strength. Give "
            "`Material(..., endurance_limit=..., ultimate_strength=...)`; Pa."
        )
    states: Any = cycle if isinstance(cycle, list | tuple) else [cycle]
    parts = [mechanism.of_hinges(state, _signed_stresses) for state in states]
    values = jnp.concatenate([part.reshape(-1, part.shape[-1]) for part in parts])
    if len(values) < 2:
        raise ValueError(
            "`cycle` has one state, but needs at least two: give a list of equilibria, "
            "such as `[mechanism.reference, deformed]`, a path, or a motion."
        )
    rows = rows_of_points(hinges)
    used = jnp.isfinite(values[:, :1])  # the points of a path in `jax.jit`
    largest = largest_of(jnp.where(used, values, -jnp.inf), axis=0)
    smallest = -largest_of(jnp.where(used, -values, -jnp.inf), axis=0)
    amplitude, mean = (largest - smallest) / 2, (largest + smallest) / 2
    utilization = amplitude / endurance[rows] + jnp.maximum(mean, 0.0) / ultimate[rows]
    limited = np.array(rows_with_stress(hinges, "endurance"))
    of_hinge = jnp.asarray(rows[None] == limited[:, None])
    index = jnp.argmax(jnp.where(of_hinge, utilization[None], -1.0), axis=1)
    names = tuple(mechanism.hinge_names[row] for row in limited)
    return Fatigue(
        amplitude[index], mean[index], utilization[index],
        endurance[limited], ultimate[limited], names,
    )  # fmt: skip


@jax.jit
def _signed_stresses(hinges: HingeAssembly, displacements: Poses) -> Array:
    """Compute the stress at all points of the surfaces of all flexures; Pa."""
    parts = member_stresses(hinges, displacements)
    return jnp.concatenate([part.values.reshape(-1) for part in parts])
