"""How much energy an elastic coupling stores at a displacement of its two frames.

An energy is a function of the displacement of frame b seen from frame a, which coincide
when the coupling is unstressed. Wrenches and stiffnesses are its derivatives. Chapters 3
and 4 of the dissertation.
"""

from abc import abstractmethod
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from .._utils.types import Matrix, Pose, Scalar, Twist, Wrench
from .._utils.validation import concrete, require_choice
from ..geometry import se2
from ..geometry.twistors import Displacement
from .damping import ViscousDamping
from .strains import Coordinates, half_square, matrix_error, strain, stretch


class AbstractEnergy(eqx.Module):
    """The energy of a coupling as a function of the displacement of its frames.

    A subclass writes `stored_energy`. Of every energy:
    what it says does not depend on the observer; its wrench is conservative.
    """

    @abstractmethod
    def stored_energy(self, displacement: Displacement) -> Scalar:
        """The energy stored at a displacement; J."""

    def stretch(self, displacement: Displacement) -> Scalar:
        """How much longer its own translations are than those seen half way.

        Changes no answer. Newton's method foresees the tension of a hinge in these
        coordinates, and takes few steps where the energy is nearly quadratic in them.
        """
        return jnp.ones_like(displacement.angle)

    def newton_model(self, tension: Scalar) -> "AbstractEnergy":
        """What stands for it in a step of Newton's method.

        Changes no answer. Of an energy that knows better than its own derivatives how it
        goes on near a tension: near that, its slopes are its own to first order.

        Args:
            tension: foreseen, along axis 1; N.
        """
        del tension
        return self

    def proportional_damping(self, time: Scalar) -> "ViscousDamping":
        """The damping that is its stiffness at rest times a time; N m s/rad, N s/m."""
        return ViscousDamping(time * self.tangent_stiffness())

    def resisted_rates(
        self, displacement: Displacement, rates: tuple[Scalar, Scalar, Scalar]
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Of the rates of the twist, those that its stiffness at rest resists.

        For dampings that are asked for it; see `ViscousDamping`.
        """
        del displacement
        return rates

    def out_of_range(self, displacement: Displacement) -> Bool[Array, ""] | None:
        """Whether it is not known there, or nothing, where it is known everywhere."""
        del displacement
        return None

    def validation_error(self) -> str | None:
        """What is wrong with the values it was given, in words, or nothing."""
        return None

    def parallel_terms(self) -> tuple["AbstractEnergy", ...]:
        """The energies of which this one is the sum; itself, if it is no sum.

        A mechanism treats them as hinges side by side, so that a sum is damped and solved
        as its terms are.
        """
        return (self,)

    def has_resisted_rates(self) -> bool:
        """Whether it has a rule of its own for the rates that it resists."""
        return type(self).resisted_rates is not AbstractEnergy.resisted_rates

    def __call__(self, pose: Pose) -> Scalar:
        """The energy stored when frame b is seen at a pose from frame a; J.

        Raises:
            ValueError: the pose is beyond the range of the energy; NaN where it is being
                traced.
        """
        return self._within(pose, self.stored_energy(Displacement.of(pose)))

    def _within(self, pose: Pose, value: Array) -> Array:
        """The value at a pose, unless that is beyond the range."""
        beyond = self.out_of_range(Displacement.of(pose))
        if beyond is None:
            return value
        seen = concrete(beyond)
        if seen is not None and np.any(seen):
            place = self.range_message(Displacement.of(pose))
            raise ValueError(f"Beyond the range of the energy: {place}.")
        # a product, so that its derivatives are NaN as well
        return value * jnp.where(beyond, jnp.nan, 1.0)

    def range_message(self, displacement: Displacement) -> str:
        """How far it is displaced, and how far it is known, in words."""
        del displacement
        return "it is known everywhere"

    def wrench(self, pose: Pose) -> Wrench:
        """What body B exerts on the coupling: about the origin of b, in the axes of b.

        The derivative of the energy along displacements that are fixed to b.

        Args:
            pose: frame b seen from frame a; rad, m, m.

        Source:
            Equations 3.52 and 4.34 of the dissertation; 3.53 and 4.35 are its closed
            forms for the quadratic energies.

        Example:
            >>> leaf = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0])))
            >>> leaf.wrench(jnp.array([0.0, 0.0, 0.5]))
            Array([0., 0., 5.], dtype=float64)
        """
        slope = jax.grad(lambda pose: self.stored_energy(Displacement.of(pose)))(pose)
        force = se2._turn(-pose[0], slope[1:])
        return self._within(pose, jnp.concatenate([slope[:1], force]))

    def tangent_stiffness(self, pose: Pose | None = None) -> Matrix:
        """How the wrench grows with displacements that are fixed to b; N m/rad, N/m.

        Args:
            pose: frame b seen from frame a, by default at rest; rad, m, m.

        Returns:
            The derivative of `wrench`. It is symmetric where the coupling is unstressed;
            elsewhere its antisymmetric part is the wrench's own, for displacements fixed
            to a body do not commute.

        Example:
            >>> Quadratic(2.0 * jnp.eye(3)).tangent_stiffness()
            Array([[2., 0., 0.],
                   [0., 2., 0.],
                   [0., 0., 2.]], dtype=float64)
        """
        pose = jnp.zeros(3) if pose is None else pose

        def moved(step: Twist) -> Wrench:
            return self.wrench(se2.compose(pose, se2.exp(step)))

        return jax.jacfwd(moved)(jnp.zeros(3)) + 0.0

    def __add__(self, other: "AbstractEnergy") -> "Sum":
        if not isinstance(other, AbstractEnergy):
            return NotImplemented
        return Sum((self, other))

    def __rmul__(self, factor: ArrayLike) -> "Scaled":
        array = jnp.asarray(factor, float)
        if array.shape:
            raise ValueError(
                f"An energy is multiplied by an array of shape {array.shape}, but the "
                "factor must be one number; for many of them use `jax.vmap`."
            )
        return Scaled(factor=array, energy=self)


class CoordinateEnergy(AbstractEnergy):
    """An energy written in the coordinates of the twist, or of the twistor.

    The twist is not defined at a full turn, and beyond one it repeats: an energy of the
    twist holds below a full turn alone.
    """

    coordinates: eqx.AbstractVar[Coordinates]

    def stretch(self, displacement: Displacement) -> Scalar:
        return stretch(displacement, self.coordinates)

    def out_of_range(self, displacement: Displacement) -> Bool[Array, ""] | None:
        """Whether the twist is undefined there."""
        if self.coordinates == "twistor":
            return None
        return jnp.abs(displacement.angle) >= 2 * jnp.pi

    def range_message(self, displacement: Displacement) -> str:
        """How far it is turned, and how far the twist is defined, in words."""
        if self.coordinates == "twistor":
            return super().range_message(displacement)
        angle = concrete(displacement.angle)
        turned = "" if angle is None else f" by {float(angle):.4g} rad"
        return (
            f"it is turned{turned}, but its energy is one of the twist, which is defined "
            "below a full turn, 6.283 rad; take coordinates='twistor'"
        )


class Quadratic(CoordinateEnergy):
    """Half the stiffness times the square of the twist, or of the twistor.

    Both have the stiffness that they were given at rest, and differ from the third order
    on. The energy of the twist grows without bound with the angle; that of the twistor is
    bounded in it, bears no moment at half a turn, and is the cheaper one: no sine, no
    cosine. The twist is not defined at a full turn of one hinge, and solves that end
    beyond it are refused.

    Args:
        stiffness: symmetric, with no negative eigenvalue, for the frame of the hinge:
            its row and column order is rotation, axis 1, axis 2; N m/rad, N/rad, N/m.
        coordinates: "twistor" for `2 v K v` of v = (xi, x1, x2), "twist" for
            `t K t / 2` of the twist t.

    Raises:
        ValueError: the stiffness is not 3 by 3, not symmetric, has a negative eigenvalue
            or a value that is not finite; the coordinates are unknown.

    Source:
        Equations 3.4 and 4.7 of the dissertation.

    Example:
        >>> leaf = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0])))
        >>> leaf(jnp.array([0.0, 0.0, 0.5]))
        Array(1.25, dtype=float64)
    """

    stiffness: Matrix
    coordinates: Coordinates = eqx.field(static=True)

    def __init__(
        self,
        stiffness: Float[ArrayLike, "3 3"],
        coordinates: Coordinates = "twistor",
    ):
        self.stiffness = jnp.asarray(stiffness, float)
        self.coordinates = require_choice(
            "`coordinates`", coordinates, ("twistor", "twist")
        )
        if fault := self.validation_error():
            raise ValueError(f"A `Quadratic` energy cannot be made: {fault}")

    def validation_error(self) -> str | None:
        """What is wrong with the stiffness, in words, or nothing."""
        return matrix_error("stiffness", self.stiffness)

    def stored_energy(self, displacement: Displacement) -> Scalar:
        return half_square(self.stiffness, strain(displacement, self.coordinates))

    def proportional_damping(self, time: Scalar) -> ViscousDamping:
        # its stiffness at rest, which by derivatives is a third of a motion to compile
        return ViscousDamping(time * self.stiffness)


class Sum(AbstractEnergy):
    """Couplings side by side, between the same two frames: their energies add up.

    Example:
        >>> spring = Quadratic(jnp.eye(3))
        >>> (spring + 2.0 * spring)(jnp.array([0.0, 1.0, 0.0]))
        Array(1.5, dtype=float64)
    """

    parts: tuple[AbstractEnergy, ...]

    def validation_error(self) -> str | None:
        """What is wrong with the first part at fault, or nothing."""
        return next(
            (fault for part in self.parts if (fault := part.validation_error())), None
        )

    def parallel_terms(self) -> tuple[AbstractEnergy, ...]:
        return tuple(term for part in self.parts for term in part.parallel_terms())

    def stored_energy(self, displacement: Displacement) -> Scalar:
        energies = [part.stored_energy(displacement) for part in self.parts]
        return jnp.sum(jnp.stack(energies))

    def out_of_range(self, displacement: Displacement) -> Bool[Array, ""] | None:
        """Whether one of the parts is not known there."""
        return any_beyond(self.parts, displacement)

    def range_message(self, displacement: Displacement) -> str:
        """How far it is displaced, and how far that part is known, in words."""
        return place_in_ranges(self.parts, displacement)


class Wrapped(AbstractEnergy):
    """What is another energy but for something of its own: for the rest it asks that."""

    energy: eqx.AbstractVar[AbstractEnergy]

    def validation_error(self) -> str | None:
        """What is wrong with the energy, in words, or nothing."""
        return self.energy.validation_error()

    def stored_energy(self, displacement: Displacement) -> Scalar:
        return self.energy.stored_energy(displacement)

    def stretch(self, displacement: Displacement) -> Scalar:
        return self.energy.stretch(displacement)

    def newton_model(self, tension: Scalar) -> AbstractEnergy:
        return self.energy.newton_model(tension)

    def out_of_range(self, displacement: Displacement) -> Bool[Array, ""] | None:
        """Whether the energy is not known there."""
        return self.energy.out_of_range(displacement)

    def range_message(self, displacement: Displacement) -> str:
        """How far it is displaced, and how far the energy is known, in words."""
        return self.energy.range_message(displacement)

    def proportional_damping(self, time: Scalar) -> ViscousDamping:
        return self.energy.proportional_damping(time)

    def resisted_rates(
        self, displacement: Displacement, rates: tuple[Scalar, Scalar, Scalar]
    ) -> tuple[Scalar, Scalar, Scalar]:
        return self.energy.resisted_rates(displacement, rates)

    def has_resisted_rates(self) -> bool:
        return self.energy.has_resisted_rates()


class Scaled(Wrapped):
    """An energy times a factor: the same coupling, wider or of a stiffer material."""

    factor: Scalar
    energy: AbstractEnergy

    def validation_error(self) -> str | None:
        """What is wrong with the factor or the energy, or nothing."""
        factor = concrete(self.factor)
        if factor is not None and not np.all((factor >= 0) & np.isfinite(factor)):
            return f"its factor must be finite and not negative, but is {factor}."
        return super().validation_error()

    def stored_energy(self, displacement: Displacement) -> Scalar:
        return self.factor * super().stored_energy(displacement)

    def newton_model(self, tension: Scalar) -> "Scaled":
        some = self.factor > 0
        share = jnp.where(some, tension / jnp.where(some, self.factor, 1.0), 0.0)
        return Scaled(factor=self.factor, energy=super().newton_model(share))

    def parallel_terms(self) -> tuple[AbstractEnergy, ...]:
        terms = self.energy.parallel_terms()
        if len(terms) == 1:
            return (self,)
        return tuple(Scaled(factor=self.factor, energy=term) for term in terms)

    def proportional_damping(self, time: Scalar) -> ViscousDamping:
        return super().proportional_damping(self.factor * time)


def any_beyond(
    energies: Sequence[AbstractEnergy], displacement: Displacement
) -> Bool[Array, ""] | None:
    """Whether a displacement is beyond the range of one of several energies."""
    seen = [energy.out_of_range(displacement) for energy in energies]
    found = [beyond for beyond in seen if beyond is not None]
    return jnp.any(jnp.stack(found)) if found else None


def place_in_ranges(
    energies: Sequence[AbstractEnergy], displacement: Displacement
) -> str:
    """The place in the first range that a displacement is beyond, in words."""
    for energy in energies:
        beyond = energy.out_of_range(displacement)
        if beyond is not None and concrete(beyond) is not None and beyond:
            return energy.range_message(displacement)
    return "it is known everywhere"
