"""A state of a mechanism, and the validity ranges of its hinges there."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._compile.compilation import fast_compile
from ..._utils.host import concrete
from ..._utils.types import Flag, Poses, PosesOrResult
from ..._utils.validation import warn
from ...assembly.assembly import HingeAssembly
from ...mechanism.mechanism import Mechanism


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


def state_in_range(mechanism: Mechanism, name: str, state: PosesOrResult | None) -> Poses:
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
