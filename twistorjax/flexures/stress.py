"""The largest stress in a flexure, from what it bears."""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import ArrayLike, Float

from .._utils.types import Scalar
from .._utils.validation import require_positive, require_row


def leaf_stress(
    wrench: Float[ArrayLike, "3"] | Sequence[ArrayLike],
    *,
    length: ArrayLike,
    thickness: ArrayLike,
    width: ArrayLike,
) -> Scalar:
    """The largest stress along a leaf, at the surface of one of its ends; Pa.

    As of a straight beam: without what fillets or sharp corners add. Where the leaf bends
    far take the stress of `beam_at_pose`.

    Args:
        wrench: that it bears at its middle, as `mechanism.wrench_of` tells; N m, N, N.
        length: m.
        thickness: in the plane; m.
        width: out of the plane; m.

    Returns:
        Its size, tension or pressure.

    Raises:
        ValueError: a dimension is not positive, or a shape is wrong.

    Example:
        >>> leaf_stress((0.0, 0.0, 1.0), length=10e-3, thickness=1e-3, width=5e-3)
        Array(6000000., dtype=float64)
    """
    moment, axial, across = jnp.abs(
        require_row("`wrench`", wrench, "(moment, force 1, force 2)")
    )
    thickness, width = (
        require_positive("`thickness`", thickness),
        require_positive("`width`", width),
    )
    largest = moment + across * require_positive("`length`", length) / 2
    return 6 * largest / (width * thickness**2) + axial / (width * thickness)


def notch_stress(
    wrench: Float[ArrayLike, "3"] | Sequence[ArrayLike],
    *,
    hole: ArrayLike,
    web: ArrayLike,
    width: ArrayLike,
) -> Scalar:
    """The largest stress in the neck of a notch, at the surface where it is thinnest; Pa.

    The stress of a beam there, times what the curved surface adds: 3 % in bending and
    5 % in tension for a web of a twelfth of the hole.

    Args:
        wrench: that it bears at its middle, as `mechanism.wrench_of` tells; N m, N, N.
        hole: diameter of the two round holes; m.
        web: thickness of the neck where it is thinnest; m.
        width: out of the plane; m.

    Returns:
        Its size, tension or pressure.

    Raises:
        ValueError: a dimension is not positive, or a shape is wrong.

    Source:
        The deep hyperbolic notches of Neuber, Kerbspannungslehre (1937), with the radius
        of the hole.

    Example:
        >>> notch_stress((0.01, 0.0, 0.0), hole=3e-3, web=0.25e-3, width=0.02)
        Array(49568906.12688149, dtype=float64)
    """
    moment, axial, _ = jnp.abs(
        require_row("`wrench`", wrench, "(moment, force 1, force 2)")
    )
    web, width = require_positive("`web`", web), require_positive("`width`", width)
    bending, tension = _factors(web / require_positive("`hole`", hole))
    return bending * 6 * moment / (width * web**2) + tension * axial / (width * web)


def _factors(ratio: Scalar) -> tuple[Scalar, Scalar]:
    """The surface's stress over that of a beam, bent and pulled.

    Args:
        ratio: half the neck's thickness over the radius of its surface.
    """
    root = jnp.sqrt(ratio)
    turn = jnp.arctan(root)
    # of thin necks the quotient is one of differences: its series instead
    small = ratio < 1e-3
    safe = jnp.where(small, 1.0, ratio)
    x = jnp.sqrt(safe)
    bending = 4 * safe * x / (3 * (x + (safe - 1) * jnp.arctan(x)))
    bending = jnp.where(small, 1 + 2 / 5 * ratio - 17 / 175 * ratio**2, bending)
    tension = 2 * (ratio + 1) * root / ((ratio + 1) * turn + root)
    return bending, tension
