"""Bending stiffness of leaves that are wide compared with their length."""

from typing import Literal

from .._utils.host import as_float, on_host
from .._utils.types import NumberLike, Scalar
from .._utils.validation import require_choice, require_interval, require_positive
from .limits import nan_where_nan, require_ratio


Shape = Literal["s-shaped", "circular"]

# Up to this ratio of thickness and length the factor was compared with a solid.
_THICKEST = 0.1


def bending_factor(
    *,
    width: NumberLike,
    length: NumberLike,
    thickness: NumberLike,
    poisson: NumberLike,
    shape: Shape = "s-shaped",
) -> Scalar:
    """Compute the factor by which a wide leaf is stiffer in bending than a beam.

    A bent leaf also bends across its width, in the opposite direction, because of
    Poisson's ratio. The clamps prevent this near both ends. So the factor is 1 for a
    narrow leaf and tends to `1 / (1 - poisson^2)` if the width exceeds the length. It is
    a factor of the bending stiffness only; use it as the `bending_factor` of a `Beam`.
    The axial and the shear stiffness do not change.

    Compared with a clamped elastic solid, for a width from 0.05 to 4 times the length and
    a thickness from 0.01 to 0.1 times the length, the error of the factor is at most
    0.7 % for a Poisson's ratio of 0.3 and 2.5 % for 0.45. The factor is that of small
    displacements. If a leaf is bent to a curvature above `3 thickness / width^2`, its
    deflection across the width is also suppressed far from the clamps, and the bending
    stiffness increases by more than 1 %, up to `1 / (1 - poisson^2)` (Searle, 1908;
    Ashwell, 1950).

    Args:
        width: Out-of-plane width, which is the thickness of the plate; m.
        length: Free length along axis 1, without the clamped parts; m.
        thickness: In-plane thickness, at most a tenth of the length; m. The factor does
            not depend on it in this range.
        poisson: Poisson's ratio.
        shape: Shape of the bent leaf. It is "s-shaped" if the ends remain parallel, as in
            a parallel guide, or "circular" if a pure moment bends the leaf to an arc, as
            in a hinge. The factor of the circular shape is smaller, because the clamps
            are where the S-shaped leaf is bent most.

    Returns:
        The factor of the bending stiffness.

    Raises:
        ValueError: A dimension is not positive, the thickness exceeds a tenth of the
            length, Poisson's ratio is not between -1 and 0.5, or the shape is unknown.

    Source:
        Kirchhoff's theory of plates with the deflection `f(x) + g(x) y^2` (method of
        Kantorovich), where `g` is zero at the clamps. The energy of the bending across
        the width and of the twist is included, and that of the bending of `g` along the
        leaf is neglected. For a moment `m(x)` per width and the bending stiffness `D` of
        the plate, the minimum of the energy is given by
        `g'' - 6 (1 + nu) / w^2 g = 3 nu / ((1 - nu) w^2) m / D` and
        `f'' = m / D - 2 nu g`.

    Example:
        >>> bending_factor(width=50e-3, length=250e-3, thickness=5e-3, poisson=0.3)
        Array(1.03426714, dtype=float64)
    """
    require_choice("`shape`", shape, ("s-shaped", "circular"))
    length = require_positive("`length`", length)
    thickness = require_ratio(
        "`thickness / length`",
        require_positive("`thickness`", thickness),
        length,
        _THICKEST,
        f"the factor is that of a plate, and valid up to {_THICKEST:g}",
    )
    requirement = "must be above -1 and at most 0.5"
    xp, (width, length, poisson) = on_host(
        require_positive("`width`", width),
        nan_where_nan(thickness, length),
        require_interval("`poisson`", poisson, -1.0, 0.5, requirement),
    )
    # The share of the anticlastic bending that the clamps suppress
    z = xp.sqrt(1.5 * (1 + poisson)) * length / width
    if shape == "circular":
        share = xp.tanh(z) / z
    else:
        # 3 (z coth(z) - 1) / z^2, and its series where this difference is inaccurate
        wide = z < 0.03
        safe = xp.where(wide, 1.0, z)
        exact = 3 * (safe / xp.tanh(safe) - 1) / safe**2
        share = xp.where(wide, 1 - z**2 / 15 + 2 * z**4 / 315, exact)
    return as_float(1 / (1 - poisson**2 * share))
