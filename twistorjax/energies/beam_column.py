"""The energy of a straight leaf as a beam-column, in closed form."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.host import all_concrete
from .._utils.types import Flag, NumberLike, Scalar
from .._utils.validation import require_positive
from ..geometry import se2
from ..geometry.twistors import Displacement
from .base import Rates
from .dilation import multiply_fields
from .evaluation import Orders
from .mixed import AbstractMixedEnergy
from .potentials import AbstractPotential, Rows, Variables
from .strains import Strain, strain
from .stress_model import AbstractStressModel


# The displacement is in range inside the ellipse with these half axes.
_ROTATION, _TRANSVERSE = 0.8, 0.25  # rad; of the length
_STRAIN = 0.05  # of the axis
_EULER = 4 * np.pi**2  # buckling load of a leaf with clamped ends, over E I / length^2
_NEARLY = 0.999  # share of the buckling load up to which the energy is valid


class BeamColumn(AbstractMixedEnergy):
    """Energy of a straight leaf of constant cross-section, from beam-column theory.

    It is exact in the axial force for small rotations and transverse displacements, in
    tension and in compression up to the buckling load of a leaf with clamped ends. So the
    change of the transverse stiffness by the axial force, buckling, the shortening by
    bending, and the axial compliance of the bent leaf follow from it. Terms of the fourth
    order in the displacement extend it to large rotations. In pure bending the moment is
    exact.

    Its coordinates are the angle `tau` and the translation `(t1, t2)` in the mid-frame.
    It is valid inside the ellipse `(tau / 0.8 rad)^2 + (t2 / (0.25 length))^2 = 1`, and
    up to an axial strain of 5 %. A straight leaf is valid in compression up to the
    buckling load with clamped ends, `4 pi^2 bending_stiffness / length^2`, which shear
    reduces; a leaf on the ellipse, up to half of it. For given rotation, transverse
    displacement, and axial force, the error of moment and transverse force is about 1 %
    for axial forces from -9 to 9 `bending_stiffness / length^2` (2 % near the ellipse in
    compression), and below 3 % in tension. In stronger compression, the transverse force
    errs by up to 3 % and the moment by up to 14 %, and by a quarter of
    `bending_stiffness tau / length` where it changes its sign, at -30. Without
    `shear_stiffness`, bending is that of a leaf of constant length, so that the error
    includes the axial strain.

    Args:
        length: Free length; m.
        bending_stiffness: Bending stiffness E I of the cross-section; N m^2.
        axial_stiffness: Axial stiffness E A; N.
        shear_stiffness: Shear stiffness, the shear correction factor times G A; None to
            neglect shear deformation; N.
        stress_model: Stress in the leaf, if its cross-section is known.

    Raises:
        ValueError: A value is not positive.

    Source:
        Timoshenko and Gere, Theory of Elastic Stability, 1961, sections 1.11 and 2.2. The
        terms of the fourth order, and those of shear, are derived in the manual ("The
        mechanics").

    Example:
        >>> leaf = BeamColumn(0.1, bending_stiffness=1.0, axial_stiffness=1e5)
        >>> leaf.tangent_stiffness().diagonal()
        Array([1.0e+01, 1.0e+06, 1.2e+04], dtype=float64)
    """

    length: Scalar
    bending_stiffness: Scalar
    axial_stiffness: Scalar
    shear_stiffness: Scalar | None = None
    stress_model: AbstractStressModel | None = eqx.field(default=None, repr=False)

    def __init__(
        self,
        length: NumberLike,
        bending_stiffness: NumberLike,
        axial_stiffness: NumberLike,
        shear_stiffness: NumberLike | None = None,
        stress_model: AbstractStressModel | None = None,
    ):
        self.length = require_positive("`length`", length)
        self.bending_stiffness = require_positive(
            "`bending_stiffness`", bending_stiffness
        )
        self.axial_stiffness = require_positive("`axial_stiffness`", axial_stiffness)
        self.shear_stiffness = None
        if shear_stiffness is not None:
            self.shear_stiffness = require_positive("`shear_stiffness`", shear_stiffness)
        self.stress_model = stress_model

    @property
    def potential(self) -> "BeamColumnPotential":
        """The potential W of beam-column theory."""
        force, shear = self.reference_force, self.shear_stiffness
        return BeamColumnPotential(
            self.bending_stiffness / self.length,
            force / self.axial_stiffness,
            None if shear is None else force / shear,
        )

    @property
    def is_unloaded(self) -> bool:
        return True

    @property
    def flexure_length(self) -> Scalar:
        """Length; m."""
        return self.length

    @property
    def reference_force(self) -> Scalar:
        """The force E I / length^2; N."""
        return self.bending_stiffness / self.length**2

    def coordinates_at(self, displacement: Displacement) -> Strain:
        return displacement.angle, 2 * displacement.x1, 2 * displacement.x2

    def resisted_rates(self, displacement: Displacement, rates: Rates) -> Rates:
        def in_mid_frame(rotation: Scalar, axial: Scalar, transverse: Scalar):
            scale = se2.sinc(rotation / 2)
            return rotation, scale * axial, scale * transverse

        _, rates = jax.jvp(in_mid_frame, strain(displacement, "twist"), rates)
        return super().resisted_rates(displacement, rates)

    def dilated(self, scale: Float[Array, "*batch"]) -> "BeamColumn":
        """Return the energy if all dimensions of the hinge are multiplied."""
        return multiply_fields(
            self, scale,
            length=1, bending_stiffness=4, axial_stiffness=2, shear_stiffness=2,
        )  # fmt: skip

    def out_of_range(self, displacement: Displacement) -> Flag:
        """Decide whether bending, buckling, or the axial strain is out of range."""
        variables, (axial,) = self.potential_variables(displacement)
        ellipse = self._square_in_ellipse(displacement)
        # The derivative of the energy by the axial force decreases with it. So the force
        # is above its limit if the derivative at the limit is positive.
        lowest = (1 + 1e-9) * self._lowest_force_ratio(ellipse)
        (slope,) = self.potential.derivatives(((0, 0, 1),), variables, (lowest,))
        elongation = axial / self.bending_stiffness * self.length
        return (ellipse > 1 + 1e-9) | (axial + slope < 0) | (elongation > _STRAIN)

    def range_message(self, displacement: Displacement) -> str:
        """Describe the displacement, the axial force, and the validity range."""
        rotation, transverse = displacement.angle, 2 * displacement.x2
        force = self.axial_force(displacement)
        ellipse = self._square_in_ellipse(displacement)
        lowest = self.reference_force * self._lowest_force_ratio(ellipse)
        values = all_concrete([rotation, transverse, force, self.length, ellipse, lowest])
        advice = (
            "Use `flexures.surrogate` of a `flexures.Beam` for large rotations, and "
            "`flexures.chain` for a leaf that buckles between its ends"
        )
        if values is None:
            return f"it is a leaf outside of its validity range. {advice}"
        rotation, transverse, force, length, ellipse, lowest = map(float, values)
        return (
            f"its rotation is {rotation:.4g} rad, its transverse displacement "
            f"{transverse:.4g} m, and its axial force {force:.4g} N. The energy of a "
            f"leaf is valid if (rotation / {_ROTATION} rad)^2 + (transverse displacement "
            f"/ {_TRANSVERSE * length:.4g} m)^2 is at most 1 (it is {ellipse:.3g}), for "
            f"axial forces above {lowest:.4g} N at this displacement, and elongations up "
            f"to {_STRAIN * length:.4g} m. {advice}"
        )

    def _square_in_ellipse(self, displacement: Displacement) -> Scalar:
        """Return the sum of squares that is one on the ellipse of valid displacements."""
        (rotation, transverse), _ = self.potential_variables(displacement)
        return (rotation / _ROTATION) ** 2 + (transverse / _TRANSVERSE) ** 2

    def _lowest_force_ratio(self, ellipse: Scalar) -> Scalar:
        """Return the relative axial force of the largest valid compression.

        `ellipse` is the result of `_square_in_ellipse`. A force p increases the
        deflection in proportion to `1 / x`, where `x = 1 + p / buckling`, and the
        relative error in proportion to the square of the deflection over x. On the
        ellipse, half of the buckling load is valid, and inside the force with the same
        error.
        """
        potential = self.potential
        share = 1 - jnp.cbrt(jnp.minimum(ellipse, 1.0)) / 2
        buckling = jnp.minimum(_NEARLY, share) * potential.buckling_ratio
        return -jnp.minimum(buckling, _STRAIN / potential.axial_compliance)


class BeamColumnPotential(AbstractPotential):
    """The potential of a beam-column.

    With the relative axial force p, and `a = tau^2`, `b = (t2 / length)^2`, it is
    `W = stiffness ((r(p) a + s(p) b - compliance p^2) / 2 + 108/35 b^2 + 3/10 a b
    + (36/175 b^2 + 9/1400 a b + a^2 / 480) p / (1 + 3/616 p))`. Above 0.999 times the
    buckling load, the functions of p are continued linearly.
    """

    stiffness: Scalar  # E I / length; J
    axial_compliance: Scalar  # E I / (E A length^2)
    # E I / (G A length^2), with the shear correction factor of G A; None without shear
    # deformation
    shear_compliance: Scalar | None

    @property
    def reference_curvature(self) -> Rows:
        return ((-self.stiffness * self.axial_compliance,),)

    @property
    def buckling_ratio(self) -> Scalar:
        """Compressive force at which the leaf buckles between clamped ends.

        With shear, it is the root of `p - d p^2 = -4 pi^2`; see `_functions_of_force`.
        """
        if self.shear_compliance is None:
            return jnp.full_like(self.axial_compliance, _EULER)
        return (
            2
            * _EULER
            / (
                1
                + jnp.sqrt(
                    1 + 4 * _EULER * (self.shear_compliance - self.axial_compliance)
                )
            )
        )

    def derivatives(
        self, orders: tuple[Orders, ...], compliant: Variables, forces: Variables
    ) -> Variables:
        rotation, transverse = compliant
        (p,) = forces
        one = jnp.ones_like(p)
        r, s, quartic = self._functions(p)
        a, b = rotation**2, transverse**2
        slope_a, slope_b, quartic_factor = _quartic_slopes(a, b)
        by_force = [
            (r[k] * a + s[k] * b - self.axial_compliance * square) / 2
            + quartic_factor * quartic[k]
            for k, square in enumerate((p**2, 2 * p, 2 * one))
        ]
        constant = (108 / 35 * b + 3 / 10 * a) * b
        of_rotation = [r[k] + 2 * slope_a * quartic[k] for k in (0, 1)]
        of_transverse = [s[k] + 2 * slope_b * quartic[k] for k in (0, 1)]
        of_rotation[0] = of_rotation[0] + 3 / 5 * b
        of_transverse[0] = of_transverse[0] + 432 / 35 * b + 3 / 5 * a
        values: dict[Orders, Scalar] = {
            (0, 0, 0): by_force[0] + constant,
            (0, 0, 1): by_force[1],
            (0, 0, 2): by_force[2],
            (1, 0, 0): of_rotation[0] * rotation,
            (0, 1, 0): of_transverse[0] * transverse,
            (1, 0, 1): of_rotation[1] * rotation,
            (0, 1, 1): of_transverse[1] * transverse,
            (2, 0, 0): of_rotation[0] + a / 60 * quartic[0],
            (1, 1, 0): rotation * transverse * (6 / 5 + 9 / 350 * quartic[0]),
            (0, 2, 0): of_transverse[0] + b * (864 / 35 + 288 / 175 * quartic[0]),
        }
        return tuple(self.stiffness * values[order] for order in orders)

    def forces_at(self, compliant: Variables, stretches: Variables) -> Variables:
        # The derivative of `p axial + W` is convex and decreasing. So Newton's iterations
        # increase monotonically to its zero if they start below, as they do after a step
        # from p = 0. If this step passes the pole of the derivative, a lower bound of the
        # zero follows from the pole alone, or is the force below which W is continued:
        # there, the derivative is not convex. Ten steps reach rounding errors for axial
        # displacements up to a tenth of the length, and any slenderness.
        axial = stretches[0] / self.stiffness
        a, b = compliant[0] ** 2, compliant[1] ** 2
        _, _, quartic_factor = _quartic_slopes(a, b)

        def excess_and_slope(p: Scalar) -> tuple[Scalar, Scalar]:
            r, s, quartic = self._functions(p)
            first, second = (
                (r[order] * a + s[order] * b) / 2 + quartic_factor * quartic[order]
                for order in (1, 2)
            )
            return (
                axial + first - self.axial_compliance * p,
                second - self.axial_compliance,
            )

        def newton_step(_, p: Scalar) -> Scalar:
            excess, decrease = excess_and_slope(p)
            return jnp.maximum(p - excess / decrease, lowest)

        buckling = self.buckling_ratio
        continued_below = -_NEARLY * buckling
        # Residue of the pole, for any shear stiffness
        residue = (_EULER if self.shear_compliance is None else buckling / 2) * a
        drop = a / 8 - b / 2 - axial
        above = jnp.sqrt(residue / jnp.where(drop > 0, drop, jnp.inf))
        lowest = jnp.where(drop > 0, jnp.minimum(above - buckling, 0.0), 0.0)
        buckled, _ = excess_and_slope(continued_below)
        lowest = jnp.maximum(lowest, continued_below)
        lowest = jnp.where(buckled > 0, lowest, -jnp.inf)
        return (jax.lax.fori_loop(0, 11, newton_step, jnp.zeros_like(axial)),)

    def _functions(self, p: Scalar) -> tuple[list[Scalar], ...]:
        """Evaluate the functions of the relative axial force, with two derivatives."""
        lowest = -_NEARLY * self.buckling_ratio
        return _functions_of_force(
            p, self.shear_compliance, self.axial_compliance, lowest
        )


def _quartic_slopes(a: Scalar, b: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Differentiate the factor of `p / (1 + 3/616 p)` by a and b, and compute it."""
    by_a, by_b = a / 240 + 9 / 1400 * b, 72 / 175 * b + 9 / 1400 * a
    return by_a, by_b, (by_a * a + by_b * b) / 2


_LARGE = 10.0  # limit between the two formulas of `_bessel_ratio`
# Poles and residues of a continued fraction, of which 7 suffice below this limit:
# 1 / (7 + q / (9 + q / (11 + ...))), as a sum of residue / (1 + pole q)
_ODD = 2.0 * np.arange(3, 17) + 1
_ROOTS, _VECTORS = np.linalg.eigh(
    np.diag((_ODD[:-1] * _ODD[1:]) ** -0.5, 1)
    + np.diag((_ODD[:-1] * _ODD[1:]) ** -0.5, -1)
)
_POLES, _RESIDUES = _ROOTS[7:] ** 2, 2 / 7 * _VECTORS[0, 7:] ** 2


def _bessel_ratio(q: Scalar) -> Scalar:
    """Compute `i[3](x) / (x i[2](x))` with `x = sqrt(q)`, also for a negative q.

    `i[n]` are the modified spherical Bessel functions of the first kind.
    """
    small = jnp.minimum(q, _LARGE)
    below = jnp.sum(_RESIDUES / (1 + small[..., None] * _POLES), axis=-1)
    large = jnp.maximum(q, _LARGE)
    root = jnp.sqrt(large)
    y0 = root / jnp.tanh(root)
    y2 = large / (large / (y0 - 1) - 3)
    return jnp.where(q < _LARGE, below, (y2 - 5) / large)


@jax.jit  # traced once for all its calls in a program
def _functions_of_force(
    p: Scalar, shear: Scalar | None, stretch: Scalar, lowest: Scalar
) -> tuple[list[Scalar], list[Scalar], list[Scalar]]:
    """Compute r, s, and `p / (1 + 3/616 p)`, with their first two derivatives by p.

    r is the moment at a unit rotation over E I / length, and s the transverse force at a
    unit displacement over E I / length^3. With `y[n] = x i[n - 1](x) / i[n](x)` and
    `q = x^2 = p / 4`, they are `r = y[0] - q` and `s = 4 y[0] y[1]`. The ratios are
    smooth functions of q down to the pole of `y[0] = x coth x` at `-pi^2`. They obey
    `y[n] = 2 n + 1 + q / y[n + 1]` and `dy[n]/dq = (1 - y[n] / y[n + 1]) / 2`. Below the
    force `lowest`, the functions are linear.

    With shear, r and s are those of Reissner's beam: `y` at `factor p` instead of p, with
    `factor = 1 + (stretch - shear) p`, and `s / (factor^2 + shear s)` instead of s.

    Source:
        Abramowitz and Stegun, Handbook of Mathematical Functions, 10.2.18 and 10.2.19.
        Buckling with shear: Haringx, Philips Research Reports 3, 1948.
    """
    inside = jnp.maximum(p, lowest)
    change = jnp.zeros_like(stretch) if shear is None else stretch - shear
    factor = 1 + change * inside
    q = factor * inside / 4
    inverse_y3 = _bessel_ratio(q)
    inverse_y2 = 1 / (5 + q * inverse_y3)
    y1 = 3 + q * inverse_y2
    inverse_y1 = 1 / y1
    y0 = 1 + q * inverse_y1
    inverse_y2_1 = inverse_y2 * (inverse_y3 - inverse_y2) / 2
    inverse_y1_1 = inverse_y1 * (inverse_y2 - inverse_y1) / 2
    y1_1 = (1 - y1 * inverse_y2) / 2
    y0_1 = (1 - y0 * inverse_y1) / 2
    y0_2 = -(y0_1 * inverse_y1 + y0 * inverse_y1_1) / 2
    y1_2 = -(y1_1 * inverse_y2 + y1 * inverse_y2_1) / 2
    r = [y0 - inside / 4, (y0_1 - 1) / 4, y0_2 / 16]
    s = [4 * (y1 + q), y1_1 + 1, y1_2 / 4]
    if shear is not None:
        rate = 1 + 2 * change * inside  # of `factor p`
        r[1] = (y0_1 * rate - 1) / 4
        r[2] = y0_2 / 16 * rate**2 + y0_1 / 2 * change
        s[1:] = s[1] * rate, s[2] * rate**2 + 2 * s[1] * change
        # s / (factor^2 + shear s), and its derivatives
        d = factor**2 + shear * s[0]
        d_1 = 2 * factor * change + shear * s[1]
        d_2 = 2 * change**2 + shear * s[2]
        s[0] = s[0] / d
        s[1] = (s[1] - s[0] * d_1) / d
        s[2] = (s[2] - 2 * s[1] * d_1 - s[0] * d_2) / d
    u = 1 / (1 + 3 / 616 * inside)
    quartic = [inside * u, u**2, -3 / 308 * u**3]
    outside = p - inside
    for row in (r, s, quartic):
        row[0] = row[0] + outside * row[1]
        row[2] = jnp.where(outside < 0, 0.0, row[2])
    return r, s, quartic
