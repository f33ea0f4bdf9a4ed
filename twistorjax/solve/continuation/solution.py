"""Results of `path`: the path, its points, and its critical points."""

from collections.abc import Iterable, Iterator
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._utils.host import concrete
from ..._utils.types import Flag, NumberLike, Poses, Scalar
from ...results.codes import RESULTS
from ...results.solutions import BodyPoses, PoseSolution
from ...results.tables import Column, Columns
from ..equations.stresses import Stresses


class PathPoint(BodyPoses):
    """One equilibrium of a path.

    Args:
        load_factor: Load factor.
        displacements: Displacement of each body from its reference pose; rad, m, m.
        reference: Poses from which displacements are measured; rad, m, m.
        energy: Energy stored in the hinges; J.
        names: Names of the bodies.
    """

    load_factor: Scalar
    displacements: Poses
    reference: Poses
    energy: Scalar
    names: tuple[str, ...] = eqx.field(static=True)


class CriticalPoint(PathPoint):
    """An equilibrium with a singular stiffness: a limit point or a branch point.

    At a limit point, the load factor has a maximum or a minimum along the path: under a
    larger or a smaller load, the mechanism snaps through. At a branch point, another path
    crosses, on which a symmetric mechanism buckles to a side. To follow it, pass the
    branch point as `start` of `path`.

    Args:
        mode: Displacements of the bodies in the direction without stiffness: rotations,
            and translations over the characteristic length of the mechanism, of unit
            norm.
        reactions: External wrench on the fixed and prescribed degrees of freedom of each
            body, such as the force at which a driven mechanism snaps; N m, N, N.
        is_branch: Whether this is a branch point.
        length: Characteristic length of the mechanism; m.
        multiplicity: Number of eigenvalues of the stiffness that vanish at this point.
    """

    mode: Poses
    reactions: Poses
    is_branch: Flag
    length: Scalar
    multiplicity: NumberLike = 1

    @property
    def kind(self) -> str:
        """Kind of the point, "limit" or "branch"."""
        return "branch" if bool(self.is_branch) else "limit"

    def __repr__(self) -> str:
        if concrete(self.load_factor) is None:
            return eqx.tree_pformat(self)
        return "\n".join(_critical_lines([self]))


class CriticalPoints(eqx.Module):
    """Limit points and branch points of a path, in the order of the path.

    It behaves like a list of `CriticalPoint`. Inside `jax.jit`, it has as many rows as
    `max_critical`, of which those after the first `count` are NaN. Load factors and
    displacements have derivatives with respect to all parameters of the mechanism and its
    loads. Those of a branch point are correct for changes that do not destroy it, such as
    symmetric changes of a symmetric mechanism.

    Args:
        load_factors: Load factors.
        displacements: Displacements of the bodies; rad, m, m.
        reference: Poses from which displacements are measured; rad, m, m.
        energies: Energy stored in the hinges; J.
        reactions: External wrenches on fixed and prescribed degrees of freedom; N m, N,
            N.
        modes: Displacements without stiffness; see `CriticalPoint`.
        is_branch: Whether each of them is a branch point.
        multiplicities: Number of eigenvalues of the stiffness that vanish at each of
            them. Points whose distance is below 1e-8 are one multiple point, and so are
            limit points whose distance is below 1e-5.
        rows: Index of the point of the path that precedes each of them.
        count: Number of critical points that were found.
        length: Characteristic length of the mechanism; m.
        names: Names of the bodies.
    """

    load_factors: Float[Array, "*batch critical"]
    displacements: Float[Array, "*batch critical bodies 3"]
    reference: Float[Array, "*batch bodies 3"]
    energies: Float[Array, "*batch critical"]
    reactions: Float[Array, "*batch critical bodies 3"]
    modes: Float[Array, "*batch critical bodies 3"]
    is_branch: Bool[Array, "*batch critical"]
    multiplicities: Int[Array, "*batch critical"]
    rows: Int[Array, "*batch critical"]
    count: Int[Array, "*batch"]
    length: Float[Array, "*batch"]
    names: tuple[str, ...] = eqx.field(static=True)

    def __len__(self) -> int:
        return self.load_factors.shape[-1]

    def __getitem__(self, index: int) -> CriticalPoint:
        if not -len(self) <= index < len(self):
            raise IndexError(f"There are {len(self)} critical points.")
        return CriticalPoint(
            load_factor=self.load_factors[index],
            displacements=self.displacements[index],
            reference=self.reference,
            energy=self.energies[index],
            names=self.names,
            mode=self.modes[index],
            reactions=self.reactions[index],
            is_branch=self.is_branch[index],
            length=self.length,
            multiplicity=self.multiplicities[index],
        )

    def __iter__(self) -> Iterator[CriticalPoint]:
        return (self[index] for index in range(len(self)))

    def __repr__(self) -> str:
        factors = concrete(self.load_factors)
        if factors is None or factors.ndim > 1:
            return eqx.tree_pformat(self)
        return "\n".join(_critical_lines(self)) if len(self) else "no critical points"

    @property
    def limit_factors(self) -> Float[Array, " critical"]:
        """Load factors of the limit points; NaN for branch points."""
        return jnp.where(self.is_branch, jnp.nan, self.load_factors)


class Path(PoseSolution):
    """A path of equilibria, from `path`.

    Inside `jax.jit`, arrays have as many rows as `max_points`, of which those after the
    first `count` are NaN. The points have derivatives: if a parameter changes, each point
    moves perpendicular to the path, and the last one stays at the same load factor.

    Args:
        load_factors: Load factor at each point.
        displacements: Displacement of each body from its reference pose; rad, m, m.
        reference: Poses from which displacements are measured; rad, m, m.
        reactions: External wrench on the fixed and prescribed degrees of freedom of each
            body, about its origin and in world axes; N m, N, N.
        constraint_forces: Constraint forces; N m, N.
        energies: Energy stored in the hinges; J.
        negative_eigenvalues: Number of negative eigenvalues of the stiffness, zero for a
            stable equilibrium. With follower loads it is only known whether the number is
            even (0) or odd (1).
        critical_points: Limit points and branch points.
        count: Number of points.
        steps: Number of evaluations of the tangent stiffness.
        result: Reason of the end of the path; `result_names` returns its name.
        names: Names of the bodies.
        constraint_names: Name of the constraint to which each scalar equation belongs.
        range_shares: Displacement or axial force of each hinge, divided by the one at
            which it errs by 5 %, as those of an `Equilibrium`; None if all hinges have
            validity ranges.
        stresses: Stresses in the hinges at each point, if the `strength` of a material is
            given.
    """

    load_factors: Float[Array, "*batch points"]
    displacements: Float[Array, "*batch points bodies 3"]
    reference: Float[Array, "*batch bodies 3"]
    reactions: Float[Array, "*batch points bodies 3"]
    constraint_forces: Float[Array, "*batch points entries"]
    energies: Float[Array, "*batch points"]
    negative_eigenvalues: Int[Array, "*batch points"]
    critical_points: CriticalPoints
    count: Int[Array, "*batch"]
    steps: Int[Array, "*batch"]
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)
    constraint_names: tuple[str, ...] = eqx.field(static=True)
    range_shares: Float[Array, "*batch points hinges"] | None = None
    stresses: Stresses | None = None
    _plural: ClassVar[str] = "paths"

    @property
    def stable(self) -> Bool[Array, "*batch points"]:
        """Whether each point is a stable equilibrium."""
        return self.negative_eigenvalues == 0

    def columns(self) -> Columns:
        axes = ("point",)
        stresses = {} if self.stresses is None else self.stresses.columns(*axes)
        return {
            **self._body_columns(*axes),
            **stresses,
            "load_factor": Column(self.load_factors, axes, "1"),
            "energy": Column(self.energies, axes, "J"),
            "negative_eigenvalues": Column(self.negative_eigenvalues, axes, "1"),
        }

    def _summary(self, names: np.ndarray) -> str:
        factors = np.asarray(self.load_factors)
        stable = np.mean(np.asarray(self.negative_eigenvalues) == 0)
        lines = [
            f"{names}: {len(factors)} equilibria, load factor {factors[0]:.6g} to "
            f"{factors[-1]:.6g}, {stable:.0%} stable, "
            f"{int(self.steps)} steps"
        ]
        if len(self.critical_points):
            lines += _critical_lines(self.critical_points)
        return "\n".join(lines)


def _critical_lines(points: Iterable[CriticalPoint]) -> list[str]:
    lines = ["critical point   load factor  largest part of the mode"]
    for point in points:
        mode = np.asarray(point.mode)
        body, axis = np.unravel_index(np.argmax(np.abs(mode)), mode.shape)
        part = f"{('rotation', 'x', 'y')[axis]} of {point.names[body]!r}"
        times = int(np.asarray(point.multiplicity))
        kind = point.kind if times == 1 else f"{point.kind}, {times}-fold"
        lines.append(f"{kind:<14} {float(point.load_factor):>13.8g}  {part}")
    return lines
