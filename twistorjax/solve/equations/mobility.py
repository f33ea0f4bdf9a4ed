"""Motions that nothing resists, and loads that need no deformation."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..._utils.types import Poses
from ...assembly.assembly import HingeAssembly
from ...mechanism.mechanism import COORDINATES, Mechanism
from .system import System


_DIRECTIONS = ("moment", "axial force", "transverse force")

_hinge_rows = jax.jit(HingeAssembly.rows_and_stiffness)

# Singular values, and entries of vectors, below this fraction are rounding errors.
_ROUNDING = 1e-9


class ConstraintAnalysis(NamedTuple):
    """Motions that no stiff direction resists, and states of self-stress.

    Args:
        motions: Displacements of the bodies in each independent motion that no stiff
            direction resists. The largest coordinate of each motion is 1, with
            translations divided by `length`; -, -, -.
        self_stresses: Forces in the stiff directions of each independent state of
            self-stress, the largest of which is 1. Such forces are in equilibrium without
            loads: the mechanism is over-constrained.
        directions: Name of each stiff direction, such as "axial force of 'left'".
        length: Characteristic length of the mechanism; m.
        names: Names of the bodies.
    """

    motions: Float[np.ndarray, "motions bodies 3"]
    self_stresses: Float[np.ndarray, "states directions"]
    directions: tuple[str, ...]
    length: float
    names: tuple[str, ...]

    @property
    def moving_bodies(self) -> tuple[tuple[str, ...], ...]:
        """Names of the bodies that move in each motion."""
        return tuple(_nonzero(self.names, motion) for motion in self.motions)

    @property
    def releases(self) -> tuple[tuple[str, ...], ...]:
        """Stiff directions of which one must be released, for each self-stress."""
        return tuple(_nonzero(self.directions, row) for row in self.self_stresses)

    @property
    def motion_descriptions(self) -> tuple[str, ...]:
        """Sentences such as "motion of 'table', mainly x of 'table'", for each motion."""
        descriptions = []
        for motion, bodies in zip(self.motions, self.moving_bodies, strict=True):
            body, coordinate = np.unravel_index(np.argmax(np.abs(motion)), motion.shape)
            descriptions.append(
                f"motion of {', '.join(map(repr, bodies))}, mainly "
                f"{COORDINATES[coordinate]} of {self.names[body]!r}"
            )
        return tuple(descriptions)

    def __repr__(self) -> str:
        def count(number: int, noun: str) -> str:
            return f"{number} {noun}{'' if number == 1 else 's'}"

        lines = [
            f"{count(len(self.motions), 'motion')} that no stiff direction resists, "
            f"{count(len(self.self_stresses), 'over-constraint')}"
        ]
        lines += self.motion_descriptions
        lines += [
            f"over-constraint: release one of {', '.join(directions)}"
            for directions in self.releases
        ]
        return "\n".join(lines)


def analyze(
    mechanism: Mechanism, system: System, state: Poses, ratio: float
) -> ConstraintAnalysis:
    """Analyze displacements (rad, m, m); see `constraint_analysis`."""
    dofs = system.dofs
    rows, stiffness = map(np.asarray, _hinge_rows(mechanism.hinge_assembly, state))
    length = float(system.units()[1])
    units = np.array([length, 1.0, 1.0])
    scaled = stiffness / (units[:, None] * units)
    values, vectors = np.linalg.eigh(scaled)
    column_units = np.where(np.array(dofs.free, int) % 3, length, 1.0)
    stiff, names = [], []
    largest = np.max(np.abs(values), initial=0.0)
    for k, name in enumerate(mechanism.hinge_names):
        for value, vector in zip(values[k], vectors[k].T, strict=True):
            if value >= ratio * largest:
                row = (vector * units) @ rows[k][:, dofs.free] * column_units
                stiff.append(row / length)
                names.append(f"{_DIRECTIONS[np.argmax(np.abs(vector))]} of {name!r}")
    jacobian = np.asarray(system.jacobian(state))[:, dofs.free] * column_units
    for name, row in zip(system.constraints.names(), jacobian, strict=True):
        stiff.append(row / max(np.linalg.norm(row), np.finfo(float).tiny))
        names.append(f"constraint {name!r}")
    matrix = np.array(stiff).reshape(len(names), len(dofs.free))
    free_motions, self_stresses = _null_spaces(matrix)
    motions = np.zeros((len(free_motions), dofs.total))
    motions[:, list(dofs.free)] = free_motions
    return ConstraintAnalysis(
        motions=motions.reshape(-1, len(mechanism.names), 3),
        self_stresses=self_stresses,
        directions=tuple(names),
        length=length,
        names=mechanism.names,
    )


def _nonzero(names: Sequence[str], values: np.ndarray) -> tuple[str, ...]:
    """Return the names of the rows that have values other than zero."""
    return tuple(
        name
        for name, row in zip(names, values, strict=True)
        if np.any(np.abs(row) > _ROUNDING)
    )


def _null_spaces(
    matrix: Float[np.ndarray, "rows columns"],
) -> tuple[Float[np.ndarray, "right columns"], Float[np.ndarray, "left rows"]]:
    """Compute bases of the right and the left null space, with many zeros."""
    if not matrix.size:
        rows, columns = matrix.shape
        return np.eye(columns), np.eye(rows)
    left, values, right = np.linalg.svd(matrix)
    rank = int(np.sum(values > _ROUNDING * max(values[0], np.finfo(float).tiny)))
    return _with_zeros(right[rank:]), _with_zeros(left[:, rank:].T)


def _with_zeros(
    basis: Float[np.ndarray, "vectors entries"],
) -> Float[np.ndarray, "vectors entries"]:
    """Return a basis of the same space in reduced row echelon form."""
    from scipy.linalg import qr  # takes 0.1 s to load

    _, pivots = qr(basis, mode="r", pivoting=True)
    basis = np.linalg.solve(basis[:, pivots[: len(basis)]], basis)
    basis[np.abs(basis) < _ROUNDING] = 0.0
    return basis / np.max(np.abs(basis), axis=1, keepdims=True, initial=0.0)
