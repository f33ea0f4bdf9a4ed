"""Periodic states of a lattice: one cell, and images of bodies of its neighbors."""

import equinox as eqx
import jax.numpy as jnp

from .._utils.types import Numbers, Point, Poses, Scalar
from ..mechanism.constraints import AbstractConstraint


class Periodicity(AbstractConstraint):
    """A body of a neighboring cell that moves as that of the cell, with a translation.

    `UnitCell.periodicity` creates these constraints.

    Args:
        name: Name of the constraint.
        bodies: Names of the body of the cell, and of its image in the other cell.
        translation: Translation of the image relative to the body; m.
    """

    name: str = eqx.field(static=True)
    bodies: tuple[str, ...] = eqx.field(static=True)
    translation: Point

    def violation(self, poses: Poses, references: Poses, time: Scalar) -> Numbers:
        del time
        own, image = poses - references
        return image - own - jnp.concatenate([jnp.zeros(1), self.translation])
