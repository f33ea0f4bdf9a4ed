"""Motions that nothing resists, and loads that need no deformation."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..._compile.compilation import fast_compile
from ..._utils.host import concrete
from ..._utils.types import Poses
from ...assembly.assembly import HingeAssembly
from ...mechanism.mechanism import COORDINATES, Mechanism
from .system import System


_FORCES = ("moment", "axial force", "transverse force")

_hinge_rows = fast_compile(HingeAssembly.rows_and_stiffness, optimize=False)

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
        coordinates: Names of the three coordinates of a body.
    """

    motions: Float[np.ndarray, "motions bodies 3"]
    self_stresses: Float[np.ndarray, "states directions"]
    directions: tuple[str, ...]
    length: float
    names: tuple[str, ...]
    coordinates: tuple[str, ...] = COORDINATES

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
            sizes = np.round(np.abs(motion), 6)  # of equal ones, rotations come first
            body, coordinate = np.unravel_index(np.argmax(sizes), motion.shape)
            descriptions.append(
                f"motion of {', '.join(map(repr, bodies))}, mainly "
                f"{self.coordinates[coordinate]} of {self.names[body]!r}"
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


class HingeStiffness(NamedTuple):
    """Stiffness of all hinges against their coordinates, in the plane or out of it."""

    # Derivatives of the coordinates of each hinge by those of the bodies
    rows: Float[np.ndarray, "hinges 3 dofs"]
    stiffness: Float[np.ndarray, "hinges 3 3"]
    forces: tuple[str, ...]  # Names of the three forces of a hinge
    coordinates: tuple[str, ...]  # Names of the three coordinates of a body
    # Which of the coordinates, of hinges and of bodies, are rotations
    rotations: tuple[bool, ...]
    lengths: Float[np.ndarray, " hinges"]  # of flexures; 0 if it is not known; m


def analyze(
    mechanism: Mechanism, system: System, state: Poses, ratio: float
) -> ConstraintAnalysis:
    """Analyze displacements (rad, m, m) in the plane; see `constraint_analysis`."""
    rows, stiffness = map(np.asarray, _hinge_rows(mechanism.hinge_assembly, state))
    hinges = HingeStiffness(
        rows,
        stiffness,
        _FORCES,
        COORDINATES,
        rotations=(True, False, False),
        lengths=flexure_lengths(mechanism.hinge_assembly),
    )
    free = system.dofs.free
    length = float(mechanism.hinge_assembly.characteristic_length(free))
    jacobian = np.asarray(system.jacobian(state))
    names = system.constraints.names()
    bodies = mechanism.names, mechanism.hinge_names
    return analyze_hinges(*bodies, hinges, free, length, ratio, jacobian, names)


def flexure_lengths(hinges: HingeAssembly) -> Float[np.ndarray, " hinges"]:
    """Return the length of each flexure; 0 if it is not known; m."""
    lengths = np.zeros(len(hinges.ends))
    for group in hinges.groups:
        for member, row in enumerate(group.members):
            length = group.of_member(member)[0].flexure_length
            known = None if length is None else concrete(length)
            if known is not None:
                lengths[row] = max(lengths[row], float(known))
    return lengths


def analyze_hinges(
    names: tuple[str, ...],
    hinge_names: Sequence[str],
    hinges: HingeStiffness,
    free: Sequence[int] | np.ndarray,
    length: float,
    ratio: float,
    jacobian: Float[np.ndarray, "entries dofs"] | None = None,
    constraints: Sequence[str] = (),
) -> ConstraintAnalysis:
    """Find motions and self-stresses of the hinges and of further rigid constraints.

    The first names are those of the bodies. The degrees of freedom that can move are
    `free`. The length (m), or that of a flexure if this is larger, relates rotations and
    translations: the origin of a body may be in the middle of a pivot. The
    derivatives of the constraints are in `jacobian`.
    """
    length = length or float(np.max(hinges.lengths)) or 1.0
    rotates = np.array(hinges.rotations)
    lengths = np.maximum(hinges.lengths, length)
    units = np.where(rotates, lengths[:, None], 1.0)
    scaled = hinges.stiffness / (units[:, :, None] * units[:, None])
    values, vectors = np.linalg.eigh(scaled)
    dofs, total = np.array(free, int), 3 * len(names)
    column_units = np.where(rotates[dofs % 3], 1.0, length)
    stiff, directions = [], []
    largest = np.max(np.abs(values), initial=0.0)
    for k, name in enumerate(hinge_names):
        for value, vector in zip(values[k], vectors[k].T, strict=True):
            if value >= ratio * largest:
                row = (vector * units[k]) @ hinges.rows[k][:, dofs] * column_units
                stiff.append(row / lengths[k])
                force = hinges.forces[np.argmax(np.abs(vector))]
                directions.append(f"{force} of {name!r}")
    if jacobian is not None:
        rows = jacobian[:, dofs] * column_units
        for name, row in zip(constraints, rows, strict=True):
            stiff.append(row / max(np.linalg.norm(row), np.finfo(float).tiny))
            directions.append(f"constraint {name!r}")
    matrix = np.array(stiff).reshape(len(directions), len(dofs))
    free_motions, self_stresses = _null_spaces(matrix)
    motions = np.zeros((len(free_motions), total))
    motions[:, dofs] = free_motions
    return ConstraintAnalysis(
        motions=motions.reshape(-1, len(names), 3),
        self_stresses=self_stresses,
        directions=tuple(directions),
        length=length,
        names=names,
        coordinates=hinges.coordinates,
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
