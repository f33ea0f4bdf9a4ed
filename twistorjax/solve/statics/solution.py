"""Static equilibrium of a mechanism, and states that are given by one."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import TypeAliasType

from ..._compile.compilation import fast_compile
from ..._utils.host import all_concrete, concrete
from ..._utils.types import Count, Entries, Flag, Poses, PosesLike, Scalar, Wrenches
from ..._utils.validation import warn
from ...assembly.assembly import HingeAssembly
from ...mechanism.loads import LoadSet
from ...mechanism.mechanism import Mechanism
from ...results.codes import count_results, result_names, RESULTS
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
            constraint forces, they let another solve start at this equilibrium; None for
            a linear response.
        misfits: The six numbers of the misfit of each hinge; None if there are none.
        result: `RESULTS.successful` or the reason of the failure; `result_names` returns
            its name.
        names: Names of the bodies.
        constraint_names: Name of the constraint to which each scalar equation belongs.
        strokes: Strokes of all hinges in a linear response to strokes; rad, m, m.
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
    loads: LoadSet | None
    misfits: Float[Array, "*batch hinges 6"] | None
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)
    constraint_names: tuple[str, ...] = eqx.field(static=True)
    strokes: Float[Array, "*batch hinges 3"] | None = None
    stresses: Stresses | None = None

    def columns(self) -> Columns:
        energy = Column(self.energy, (), "J")
        stresses = {} if self.stresses is None else self.stresses.columns()
        return {**self._body_columns(), "energy": energy, **stresses}

    def __repr__(self) -> str:
        names = result_names(self.result)
        values = all_concrete([self.reached, self.energy, self.fraction])
        if names is None or values is None:
            return eqx.tree_pformat(self)
        if names.shape:
            return count_results("equilibria", names)
        displacements, energy, fraction = values
        title = (
            f"{names}: {100 * float(fraction):.4g} % of loads and prescribed "
            f"displacements, {int(self.steps)} Newton steps"
        )
        if np.isfinite(energy):
            title += f", {float(energy):.6g} J in the hinges"
        if self.stresses is not None:
            title += f"\n{self.stresses.summary()}"
        return self._listed(title, "body", displacements)


# An equilibrium, or poses of the bodies; rad, m, m
StateLike = TypeAliasType("StateLike", PosesLike | Equilibrium)


def warn_outside_linear_range(
    mechanism: Mechanism, shares: Float[Array, "*batch hinges"] | None
) -> None:
    """Warn if a flexure without a validity range errs by more than 5 %.

    `shares` are those of `Equilibrium.range_shares`, also in a batch, where NaN does not
    count.
    """
    known = None if shares is None else concrete(shares)
    if known is not None and np.any(known > 1):
        hinge = mechanism.hinge_names[np.nanargmax(known) % known.shape[-1]]
        warn(
            f"The displacement or the axial force of the hinge {hinge!r} is "
            f"{np.nanmax(known):.3g} times the one at which its force or moment errs by "
            "5 %, because its energy is that of small displacements under small axial "
            "forces. Use `flexures.leaf`, or `flexures.surrogate` for other contours, "
            "whose errors are known in their validity ranges."
        )


@fast_compile
def _range_of(
    hinges: HingeAssembly, displacements: Poses
) -> tuple[Flag, Float[Array, " hinges"] | None]:
    """Decide whether a hinge is out of range, and compute the `range_shares`."""
    outside = jnp.any(hinges.out_of_range(displacements))
    return outside, hinges.range_shares(displacements)


def state_in_range(mechanism: Mechanism, name: str, state: StateLike | None) -> Poses:
    """Return the displacements of a state; rad, m, m.

    They are NaN if the state is traced and a hinge is outside the validity range of its
    energy. A warning is given if a flexure without such a range errs by more than 5 %.

    Raises:
        ValueError: A hinge is outside this range, and the state is not traced.
    """
    if state is None and mechanism.hinge_assembly.misfits is not None:
        raise ValueError(
            "The mechanism has misfits, so its reference configuration is not an "
            f"equilibrium. Give `{name}=equilibrium(mechanism)`."
        )
    if state is None:
        return jnp.zeros_like(mechanism.reference)
    displacements = mechanism.displacements(state, name, single=True)
    outside, shares = _range_of(mechanism.hinge_assembly, displacements)
    if concrete(outside) is None:
        return jnp.where(outside, jnp.nan, displacements)
    if outside:
        raise ValueError(
            f"At `{name}` a hinge is outside the validity range of its energy. "
            f"{mechanism.range_messages(mechanism.reference + displacements)}"
        )
    warn_outside_linear_range(mechanism, shares)
    return displacements
