"""Energies with a validity range and an error estimate."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.host import all_concrete, concrete
from .._utils.types import Flag, NumberLike, Scalar, WrenchLike
from .._utils.validation import require_positive, require_row
from ..geometry.twistors import Displacement
from .base import AbstractEnergy, AbstractWrapper, Scaled, Sum
from .dilation import multiply_fields
from .stress_model import AbstractStressModel


class WithValidityRange(AbstractWrapper):
    """Energy with the range of rotations and forces in which it is valid.

    A pose out of this range raises an error, and so does a solution in which a hinge is
    out of its range.

    Args:
        energy: The energy.
        rotation: Largest rotation in both directions; rad.
        force: Largest magnitude of the force; N. If a displacement is given, it is that
            of the axial force, because the displacement limits the transverse force.
        error: Relative error of (moment, force 1, force 2) in the range: the rms error
            divided by the rms value, on samples that were not used to determine the
            energy.
        displacement: Largest displacement along axis 2 in both directions, by default
            without limit; m.
        stress_model: Stress in a flexure whose dimensions are known, such as that of
            `surrogate`; by default that of the energy.

    Raises:
        ValueError: `energy` is not an energy; `rotation` or `force` is not positive;
            `error` does not have three entries, or a negative one.

    Example:
        >>> from twistorjax import Quadratic
        >>> leaf = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0])))
        >>> limited = WithValidityRange(
        ...     leaf, rotation=0.1, force=5.0, error=[1e-3, 1e-3, 1e-3]
        ... )
        >>> limited.wrench(jnp.array([0.2, 0.0, 0.0]))
        Traceback (most recent call last):
            ...
        ValueError: Outside the validity range of the energy: its rotation is 0.2 rad and
        its force 0 N, but the energy is valid up to 0.1 rad and 5 N.
    """

    energy: AbstractEnergy
    rotation: Scalar
    force: Scalar
    error: Float[Array, "3"]
    displacement: Scalar | None = None
    stress_model: AbstractStressModel | None = eqx.field(default=None, repr=False)

    def __init__(
        self,
        energy: AbstractEnergy,
        rotation: NumberLike,
        force: NumberLike,
        error: WrenchLike,
        displacement: NumberLike | None = None,
        stress_model: AbstractStressModel | None = None,
    ):
        if not isinstance(energy, AbstractEnergy):
            raise ValueError(
                f"`energy` is a {type(energy).__name__}, but must be an energy."
            )
        self.energy = energy
        self.stress_model = stress_model
        self.rotation = require_positive("`rotation`", rotation)
        self.force = require_positive("`force`", force)
        self.error = require_row(
            "`error`", error, "one number for each of (moment, force 1, force 2)"
        )
        known = concrete(self.error)
        if known is not None and np.any(known < 0):
            raise ValueError(f"`error` is {known.tolist()}, but must not be negative.")
        self.displacement = None
        if displacement is not None:
            self.displacement = require_positive("`displacement`", displacement)

    def out_of_range(self, displacement: Displacement) -> Flag:
        """Decide whether the rotation or the force exceeds the validity range."""
        # The limits include rounding errors, and the error of the force itself.
        slack = 1 + 1e-9
        valid_rotation = jnp.abs(displacement.angle) <= slack * self.rotation
        largest_force = (slack + 3 * jnp.max(self.error)) * self.force
        valid = valid_rotation & (self._force_magnitude(displacement) <= largest_force)
        if self.displacement is not None:
            valid &= jnp.abs(_transverse(displacement)) <= slack * self.displacement
        return ~valid

    def dilated(self, scale: Float[Array, "*batch"]) -> "WithValidityRange":
        """Return the range if all dimensions of the hinge are multiplied."""
        return multiply_fields(self, scale, force=2, displacement=1)

    def _force_magnitude(self, displacement: Displacement) -> Scalar:
        """Compute the magnitude of the force that is limited, at a displacement; N."""

        def stored_energy(y1: Scalar, y2: Scalar) -> Scalar:
            angle, sigma, xi = displacement.angle, displacement.sigma, displacement.xi
            return self.energy.stored_energy(
                Displacement(angle, sigma, xi, y1 / 2, y2 / 2)
            )

        force_1, force_2 = jax.grad(stored_energy, (0, 1))(
            2 * displacement.x1, 2 * displacement.x2
        )
        if self.displacement is not None:
            return jnp.abs(force_1)
        return jnp.sqrt(force_1**2 + force_2**2)

    def range_message(self, displacement: Displacement) -> str:
        """Describe the displacement and the validity range."""
        force = self._force_magnitude(displacement)
        values = all_concrete([displacement.angle, force, self.rotation, self.force])
        if values is None:
            return "its rotation or its force exceeds its validity range"
        rotation, force, largest_rotation, largest_force = map(float, values)
        transverse = limit = axial = ""
        if self.displacement is not None:
            axial = "axial "
            transverse = (
                f", its transverse displacement {_transverse(displacement):.4g} m,"
            )
            limit = f", {float(self.displacement):.4g} m,"
        return (
            f"its rotation is {rotation:.4g} rad{transverse} and its {axial}force "
            f"{force:.4g} N, but the energy is valid up to {largest_rotation:.4g} rad"
            f"{limit} and {largest_force:.4g} N"
        )

    def __repr__(self) -> str:
        values = all_concrete([self.rotation, self.force, self.error])
        if values is None or values[0].shape:
            return eqx.tree_pformat(self)
        rotation, force, (moment, axial, transverse) = values
        terms = getattr(self.energy, "powers", None)
        size = "" if terms is None else f" with {len(terms)} terms"
        limit = ""
        if self.displacement is not None:
            limit = f", {float(self.displacement):.4g} m"
        return (
            f"{type(self.energy).__name__}{size}, valid up to {float(rotation):.4g} rad"
            f"{limit} and {float(force):.4g} N; rms error {100 * moment:.2g} % in "
            f"moment, {100 * axial:.2g} % in axial, {100 * transverse:.2g} % in "
            "transverse force"
        )


def _transverse(displacement: Displacement) -> Scalar:
    """Return the displacement along axis 2 of the mid-frame; m."""
    return 2 * displacement.x2


def without_ranges(energy: AbstractEnergy) -> AbstractEnergy:
    """Remove the validity ranges of an energy, and of its terms and factors."""
    if isinstance(energy, WithValidityRange):
        return without_ranges(energy.energy)
    if isinstance(energy, Sum):
        return Sum(tuple(without_ranges(part) for part in energy.parts))
    if isinstance(energy, Scaled):
        return Scaled(factor=energy.factor, energy=without_ranges(energy.energy))
    return energy
