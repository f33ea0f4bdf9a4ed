"""Stresses that a solution reports for its hinges."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.host import all_concrete
from ..._utils.pytrees import largest_of
from ..._utils.types import BatchScalar, Flag, Poses
from ..._utils.validation import index_of
from ...assembly.assembly import HingeAssembly
from ...assembly.stress import largest_stresses, rows_with_stress, strengths
from ...mechanism.mechanism import Mechanism
from ...results.tables import Column, Columns, Tabular


class Stresses(Tabular):
    """Largest stress in each hinge whose dimensions are known.

    Args:
        largest: Largest magnitude of the normal stress in each hinge; Pa.
        strength: Strength of the material of each hinge under static loads, infinite if
            it is not given; Pa.
        names: Names of the hinges.
    """

    largest: Float[Array, "*batch hinges"]
    strength: Float[Array, "*#batch hinges"]
    names: tuple[str, ...] = eqx.field(static=True)

    def of(self, hinge: str) -> BatchScalar:
        """Return the largest stress in a hinge.

        Args:
            hinge: Name of the hinge.

        Returns:
            The largest magnitude; Pa.

        Raises:
            ValueError: There is no such hinge, or its dimensions are not known.
        """
        return self.largest[..., index_of("`hinge`", "hinge", hinge, self.names)]

    @property
    def utilization(self) -> Float[Array, "*batch hinges"]:
        """Largest stress over the strength; zero if the strength is not given."""
        *batch, hinges = self.strength.shape
        new_axes = (self.largest.ndim - self.strength.ndim) * (1,)
        strength = self.strength.reshape(*batch, *new_axes, hinges)
        return self.largest / jnp.broadcast_to(strength, self.largest.shape)

    @property
    def safety_factor(self) -> BatchScalar:
        """Smallest ratio of strength and stress of all hinges."""
        return 1 / largest_of(self.utilization)

    def summary(self) -> str:
        """Describe the largest utilization of a hinge in one line."""
        utilization = np.asarray(self.utilization)
        row = int(np.argmax(utilization))
        stress = float(self.largest[row]) / 1e6
        return (
            f"largest stress over strength: {utilization[row]:.3g}, {stress:.4g} MPa in "
            f"{self.names[row]!r}"
        )

    def columns(self, *axes: str) -> Columns:
        labels = (("hinge", self.names),)
        return {
            "stress": Column(self.largest, (*axes, "hinge"), "Pa", labels),
            "strength": Column(self.strength, ("hinge",), "Pa", labels),
        }

    def __repr__(self) -> str:
        values = all_concrete([self.largest, self.strength])
        if values is None:
            return eqx.tree_pformat(self)
        largest, strength = values
        if largest.ndim > 1:
            index = int(np.argmax(np.nan_to_num(largest)))
            return (
                f"stresses of shape {largest.shape}, the last axis for hinges; largest "
                f"{largest.flat[index] / 1e6:.4g} MPa in "
                f"{self.names[index % len(self.names)]!r}"
            )
        width = max(map(len, ("hinge", *self.names)))
        lines = [f"{'hinge':<{width}}  {'stress (MPa)':>12}  {'of the strength':>15}"]
        for name, stress, limit in zip(self.names, largest, strength, strict=True):
            share = f"{stress / limit:.3g}" if np.isfinite(limit) else "-"
            lines.append(f"{name:<{width}}  {stress / 1e6:>12.4g}  {share:>15}")
        if len(lines) > 21:
            lines[11:-1] = [f"... {len(lines) - 12} more"]
        return "\n".join(lines)


def reported_hinges(mechanism: Mechanism) -> tuple[str, ...]:
    """Return the names of all hinges if a strength is known, or else none."""
    known = rows_with_stress(mechanism.hinge_assembly, "static")
    return mechanism.hinge_names if known else ()


def report_stresses(
    hinges: HingeAssembly, displacements: Poses, names: tuple[str, ...], valid: Flag
) -> Stresses | None:
    """Compute the stresses if names of hinges are reported; NaN if not valid."""
    if not names:
        return None
    largest = jnp.where(valid, largest_stresses(hinges, displacements), jnp.nan)
    return select_stresses(hinges, largest, names)


def select_stresses(
    hinges: HingeAssembly,
    largest: Float[Array, "*batch all_hinges"],
    names: tuple[str, ...],
) -> Stresses:
    """Select the hinges whose dimensions are known; stresses of all hinges in Pa."""
    rows = rows_with_stress(hinges)
    strength = strengths(hinges, "static")
    known = jnp.full(len(rows), jnp.inf)
    if strength is not None:
        known = strength[np.array(rows)]
    selected = tuple(names[row] for row in rows)
    return Stresses(largest[..., np.array(rows)], known, selected)
