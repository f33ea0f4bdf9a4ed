"""Static equilibrium of a mechanism, and states that are given by one."""

from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import TypeAliasType

from ..._utils.types import Count, Entries, Poses, PosesLike, Scalar, Wrenches
from ...mechanism.loads import LoadSet
from ...results.codes import RESULTS
from ...results.solutions import PoseSolution
from ...results.tables import Column, Columns
from ..equations.stresses import Stresses


class Equilibrium(PoseSolution):
    """A static equilibrium of a mechanism.

    If no equilibrium was found, displacements, reactions, constraint forces, and energy
    are NaN and their derivatives are zero, so that a batch can be masked by `succeeded`.

    Args:
        displacements: Displacement of each body from its reference pose; rad, m, m.
        reference: Poses from which displacements are measured; rad, m, m.
        reactions: External wrench on the fixed and prescribed degrees of freedom of each
            body, about the origin of the body and in world axes; zero for free degrees
            of freedom; N m, N, N.
        constraint_forces: Constraint forces, one for each scalar equation of the
            constraints; N m, N.
        energy: Energy stored in the hinges; J.
        reached: Displacements at the `fraction` that was reached; rad, m, m.
        fraction: Fraction of the loads and prescribed displacements that was reached:
            1, or less if the solve failed.
        steps: Number of Newton steps.
        range_shares: Displacement or axial force of each flexure without a validity
            range, such as `flexures.notch` and `flexures.linear_leaf`, divided by the one
            at which its force or moment errs by 5 %; zero for other hinges; None if there
            are no such flexures.
        loads: Sums of the loads on each body. Together with the misfits and the
            constraint forces, they let another solve start at this equilibrium.
        misfits: The six numbers of the misfit of each hinge; None if there are none.
        result: `RESULTS.successful` or the reason of the failure; `result_names` returns
            its name.
        names: Names of the bodies.
        constraint_names: Name of the constraint to which each scalar equation belongs.
        stresses: Stresses in the hinges, if the `strength` of a material is given.
    """

    displacements: Poses
    reference: Poses
    reactions: Wrenches
    constraint_forces: Entries
    energy: Scalar
    reached: Poses
    fraction: Scalar
    steps: Count
    range_shares: Float[Array, "*batch hinges"] | None
    loads: LoadSet
    misfits: Float[Array, "*batch hinges 6"] | None
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)
    constraint_names: tuple[str, ...] = eqx.field(static=True)
    stresses: Stresses | None = None
    _plural: ClassVar[str] = "equilibria"

    def columns(self) -> Columns:
        energy = Column(self.energy, (), "J")
        stresses = {} if self.stresses is None else self.stresses.columns()
        return {**self._body_columns(), "energy": energy, **stresses}

    def _summary(self, names: np.ndarray) -> str:
        title = (
            f"{names}: {100 * float(self.fraction):.4g} % of loads and prescribed "
            f"displacements, {int(self.steps)} Newton step{'s' * (int(self.steps) != 1)}"
        )
        if np.isfinite(self.energy):
            title += f", {float(self.energy):.6g} J in the hinges"
        if self.stresses is not None:
            title += f"\n{self.stresses.summary()}"
        if float(self.fraction) < 1:
            title += "\nlast displacements that were reached:"
        return self._listed(title, "body", np.asarray(self.reached))


# An equilibrium, a linear response, or poses of the bodies; rad, m, m
StateLike = TypeAliasType("StateLike", PosesLike | PoseSolution)
