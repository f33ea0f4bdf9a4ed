"""The energy of a hinge as a function of the displacement of its two frames.

The displacement is that of frame b relative to frame a; both coincide in the reference
configuration. Wrench and stiffness are derivatives of the energy. Chapters 3 and 4 of the
dissertation.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import fields
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._compile.compilation import fast_compile
from .._utils.host import concrete
from .._utils.printing import Printed
from .._utils.pytrees import largest_of
from .._utils.types import (
    Flag,
    Matrix,
    NumberLike,
    Pose,
    PoseLike,
    Scalar,
    Twist,
    Wrench,
)
from .._utils.validation import require_shape
from ..geometry import se2
from ..geometry.twistors import Displacement
from .damping import ViscousDamping


Rates = tuple[Scalar, Scalar, Scalar]  # rad/s, m/s, m/s
Stress = tuple[Scalar, Scalar, Scalar]  # Moment, axial, and transverse force; N m, N, N


class AbstractEnergy(Printed):
    """Elastic energy of a hinge as a function of the displacement of b relative to a.

    A subclass implements one method, `stored_energy`. Wrench, stiffness, sums, and
    multiples follow from it. A subclass may replace further methods and properties:
    `out_of_range` together with `range_message`, `range_share`, `validation_error`,
    `flexure_length`, `dilated`, `is_unloaded`, `proportional_damping`, `resisted_rates`,
    and `translation_scale` and `newton_model`, which change the number of solver steps
    but no result. With a field `stress_model`, the stress in the hinge is known. All of
    these describe this object alone. The library also finds those of the terms of a sum,
    of a multiple, and of an energy with a validity range.

    Example:
        >>> class QuarticSpring(AbstractEnergy):
        ...     stiffness: float
        ...
        ...     def stored_energy(self, displacement):
        ...         return self.stiffness * displacement.angle**4 / 4
        >>> QuarticSpring(2.0).wrench(jnp.array([0.1, 0.0, 0.0]))
        Array([0.002, 0.   , 0.   ], dtype=float64)
    """

    # Whether the energies in its fields have the same displacement
    _parts_are_displaced_alike: ClassVar[bool] = True

    @abstractmethod
    def stored_energy(self, displacement: Displacement) -> Scalar:
        """Compute the energy that is stored at a displacement.

        A subclass writes it with `jax.numpy`. The energy must be twice differentiable. If
        it has a validity range, it is continued beyond it, best convexly. Its constants
        are fields: a compiled program keeps the values of other variables.

        Args:
            displacement: Displacement of frame b relative to frame a, with `twist()`
                (rad, m, m), `strain()` (twice the vector part of the twistor; -, m, m),
                the `angle` (rad), the cosine `sigma` and the sine `xi` of half of it, and
                `x1` and `x2`, half of the translation in the frame in the middle between
                both (m). In it, the vector between the ends of a flexure of length L,
                whose frames are in its middle, is `(2 x1 + L sigma, 2 x2)`.

        Returns:
            The energy; J.
        """

    def __call__(self, pose: PoseLike) -> Scalar:
        """Compute the energy that is stored at a pose of frame b relative to frame a.

        Returns:
            The energy; J.

        Raises:
            ValueError: The pose does not have three numbers, or is outside the validity
                range. If the pose is traced, the result is NaN out of the range.
        """
        return self._value_at(pose, _energy)

    def wrench(self, pose: PoseLike) -> Wrench:
        """Compute the wrench that body B exerts on the hinge, about frame b, in its axes.

        It is the derivative of the energy with respect to infinitesimal displacements of
        frame b along its own axes.

        Args:
            pose: Pose of frame b relative to frame a; rad, m, m.

        Returns:
            Moment, and force along axes 1 and 2 of frame b; N m, N, N.

        Raises:
            ValueError: The pose does not have three numbers, or is outside the validity
                range. If the pose is traced, the result is NaN out of the range.

        Source:
            Equations 3.52 and 4.34 of the dissertation; 3.53 and 4.35 are the closed
            forms for quadratic energies.

        Example:
            >>> from twistorjax import Quadratic
            >>> leaf = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0])))
            >>> leaf.wrench(jnp.array([0.0, 0.0, 0.5]))
            Array([0., 0., 5.], dtype=float64)
        """
        return self._value_at(pose, _wrench)

    def tangent_stiffness(self, pose: PoseLike = (0.0, 0.0, 0.0)) -> Matrix:
        """Compute the derivative of the wrench.

        It is the derivative with respect to infinitesimal displacements of frame b along
        its own axes.

        Args:
            pose: Pose of frame b relative to frame a; by default the reference pose; rad,
                m, m.

        Returns:
            The stiffness; N m/rad, N/rad, N/m. It is symmetric if the hinge is not
            loaded. Otherwise its antisymmetric part is determined by the wrench, because
            displacements along body axes do not commute.

        Example:
            >>> from twistorjax import Quadratic
            >>> Quadratic(2.0 * jnp.eye(3)).tangent_stiffness()
            Array([[2., 0., 0.],
                   [0., 2., 0.],
                   [0., 0., 2.]], dtype=float64)
        """
        return self._value_at(pose, _tangent_stiffness)

    def out_of_range(self, displacement: Displacement) -> Flag | None:
        """Decide whether a displacement is outside the validity range of this energy.

        Nested energies do not count.

        Returns:
            True outside the range; None, the default, if the energy is valid everywhere.
        """
        del displacement

    def range_message(self, displacement: Displacement) -> str:
        """Describe a displacement outside the validity range, and the range.

        Returns:
            Text that follows the name of the hinge in a message, without a period.
        """
        del displacement
        return f"`{type(self).__name__}` does not describe its range"

    def range_share(self, displacement: Displacement) -> Scalar | None:
        """Compute the share of a displacement, or of its axial force, in the largest one.

        Returns:
            1 where the error is 5 %; None, the default, if the energy is not limited to
            small displacements and axial forces.
        """
        del displacement

    def validation_error(self) -> str | None:
        """Describe the first invalid value of the fields, which JAX does not trace.

        A mechanism with this energy, and a file with it, are refused with this message.

        Returns:
            The rest of a sentence, with a period; None, the default, if all values are
            valid.
        """

    @property
    def flexure_length(self) -> Scalar | None:
        """Length of the flexure along axis 1; None, the default, if it is unknown; m.

        If it is known, warnings are given of a flexure that is far from the outlines of
        its bodies, and of one without `expansion` whose temperature changes.
        """
        return None

    @property
    def is_unloaded(self) -> bool:
        """Whether the wrench is known to be zero in the reference configuration.

        If it is False, the default, analyses of a mechanism in this configuration check
        that it is an equilibrium.
        """
        return False

    def dilated(self, scale: Float[Array, "*batch"]) -> "AbstractEnergy":
        """Return the energy if all dimensions of the hinge are multiplied.

        The energy at a rotation and a translation becomes `scale^3` times that at the
        rotation and the translation divided by `scale`. Nested energies and a stress
        model are dilated beside it.

        Args:
            scale: The factor; one for each energy if the energies are stacked.

        Returns:
            The energy of the larger hinge; by default the same object, if the dimensions
            of the hinge are unknown.
        """
        del scale
        return self

    def proportional_damping(self, time: Scalar) -> ViscousDamping:
        """Return the damping that is the stiffness times a time.

        Args:
            time: Factor of the stiffness in the reference configuration; s.

        Returns:
            The damping; N m s/rad, N s/rad, N s/m.
        """
        return ViscousDamping(time * self.tangent_stiffness())

    def resisted_rates(self, displacement: Displacement, rates: Rates) -> Rates:
        """Return the part of the strain rates that the energy resists.

        Args:
            displacement: Displacement of frame b relative to frame a.
            rates: Rates of the strain; rad/s, m/s, m/s.

        Returns:
            The rates on which damping with `resisted` acts, by default all; rad/s, m/s,
            m/s.
        """
        del displacement
        return rates

    @property
    def resists_all_rates(self) -> bool:
        """Whether the energy resists all strain rates."""
        return type(self).resisted_rates is AbstractEnergy.resisted_rates

    def translation_scale(self, displacement: Displacement) -> Scalar:
        """Compute the factor by which mid-frame translations are multiplied.

        Newton's method predicts the generalized stress of a hinge with respect to the
        scaled translations. It takes few steps if the energy is nearly quadratic in them.

        Returns:
            The dimensionless factor, a function of the angle only; by default one.
        """
        return jnp.ones_like(displacement.angle)

    def newton_model(self, stress: Stress) -> "AbstractEnergy":
        """Return the energy that replaces this one in a Newton step.

        Args:
            stress: Predicted generalized stress: moment, axial force, and transverse
                force; N m, N, N.

        Returns:
            An energy with the same gradient where the stress is the predicted one, and
            with a similar one near it; by default this energy. A flexure that is stiff
            along its axis and shortens if it bends needs another one: otherwise
            `equilibrium` takes hundreds of steps at moderate rotations. The gradient and
            the second derivatives of the model may neglect what vanishes there, so that
            they need not be derivatives of one another.
        """
        del stress
        return self

    def __add__(self, other: "AbstractEnergy") -> "Sum":
        if not isinstance(other, AbstractEnergy):
            return NotImplemented
        return Sum((self, other))

    def __rmul__(self, factor: NumberLike) -> "Scaled":
        array = jnp.asarray(factor, float)
        if array.shape:
            raise ValueError(
                f"An energy is multiplied by an array of shape {array.shape}, but the "
                "factor must be one number; for many of them use `jax.vmap`."
            )
        return Scaled(factor=array, energy=self)

    def __mul__(self, factor: NumberLike) -> "Scaled":
        return self.__rmul__(factor)

    def __truediv__(self, divisor: NumberLike) -> "Scaled":
        return self.__rmul__(1 / jnp.asarray(divisor, float))

    def _value_at(
        self, pose: PoseLike, function: Callable[["AbstractEnergy", Pose], Array]
    ) -> Array:
        """Evaluate a function at a pose, or raise an error if the pose is out of range.

        If the pose is traced, the value is NaN instead.
        """
        pose = require_shape("`pose`", pose, (3,), "be three numbers: angle, x, and y")
        value, outside = _evaluate(function, self, pose)
        if outside is None:
            return value
        decided = concrete(outside)
        if decided is not None and np.any(decided):
            message = range_message(self, Displacement.from_pose(pose))
            raise ValueError(f"Outside the validity range of the energy: {message}.")
        # A product, so that derivatives are NaN as well.
        return value * jnp.where(outside, jnp.nan, 1.0)


@fast_compile
def _evaluate(
    function: Callable[[AbstractEnergy, Pose], Array], energy: AbstractEnergy, pose: Pose
) -> tuple[Array, Flag | None]:
    """Evaluate a function at a pose, and decide whether the pose is out of range."""
    return function(energy, pose), out_of_range(energy, Displacement.from_pose(pose))


def _energy(energy: AbstractEnergy, pose: Pose) -> Scalar:
    """Compute the energy at a pose; J."""
    return energy.stored_energy(Displacement.from_pose(pose))


def _wrench(energy: AbstractEnergy, pose: Pose) -> Wrench:
    """Compute the wrench on the hinge in the axes of frame b; N m, N, N."""
    slope = jax.grad(lambda pose: _energy(energy, pose))(pose)
    return jnp.concatenate([slope[:1], se2.rotate(-pose[0], slope[1:])])


def _tangent_stiffness(energy: AbstractEnergy, pose: Pose) -> Matrix:
    """Differentiate the wrench with respect to displacements in the axes of frame b."""

    def wrench(step: Twist) -> Wrench:
        return _wrench(energy, se2.compose(pose, se2.exp(step)))

    return jax.jacfwd(wrench)(jnp.zeros(3)) + 0.0


class Sum(AbstractEnergy):
    """Sum of the energies of hinges in parallel, between the same two frames.

    Args:
        parts: The energies.

    Example:
        >>> from twistorjax import Quadratic
        >>> spring = Quadratic(jnp.eye(3))
        >>> (spring + 2.0 * spring)(jnp.array([0.0, 1.0, 0.0]))
        Array(1.5, dtype=float64)
    """

    parts: tuple[AbstractEnergy, ...]

    def __check_init__(self) -> None:
        if not self.parts:
            raise ValueError("`parts` is empty, but a sum needs at least one energy.")

    @property
    def flexure_length(self) -> Scalar | None:
        lengths = (part.flexure_length for part in self.parts)
        return next((length for length in lengths if length is not None), None)

    @property
    def is_unloaded(self) -> bool:
        return all(part.is_unloaded for part in self.parts)

    def stored_energy(self, displacement: Displacement) -> Scalar:
        energies = [part.stored_energy(displacement) for part in self.parts]
        return jnp.sum(jnp.stack(energies))


class AbstractWrapper(AbstractEnergy):
    """A multiple of another energy, or the same energy with additional methods.

    The methods that describe a hinge in motion and in a Newton step are those of the
    wrapped energy; `nested` finds the others.
    """

    energy: eqx.AbstractVar[AbstractEnergy]

    @property
    def multiple(self) -> Scalar | None:
        """Factor of the wrapped energy; None for 1."""
        return None

    def stored_energy(self, displacement: Displacement) -> Scalar:
        energy = self.energy.stored_energy(displacement)
        return energy if self.multiple is None else self.multiple * energy

    @property
    def flexure_length(self) -> Scalar | None:
        return self.energy.flexure_length

    @property
    def is_unloaded(self) -> bool:
        return self.energy.is_unloaded

    def proportional_damping(self, time: Scalar) -> ViscousDamping:
        factor = 1.0 if self.multiple is None else self.multiple
        return self.energy.proportional_damping(factor * time)

    def resisted_rates(self, displacement: Displacement, rates: Rates) -> Rates:
        return self.energy.resisted_rates(displacement, rates)

    @property
    def resists_all_rates(self) -> bool:
        return self.energy.resists_all_rates

    def translation_scale(self, displacement: Displacement) -> Scalar:
        return self.energy.translation_scale(displacement)

    def newton_model(self, stress: Stress) -> AbstractEnergy:
        if self.multiple is None:
            return self.energy.newton_model(stress)
        positive = self.multiple > 0
        multiple = jnp.where(positive, self.multiple, 1.0)
        m, n1, n2 = (jnp.where(positive, part / multiple, 0.0) for part in stress)
        return Scaled(factor=self.multiple, energy=self.energy.newton_model((m, n1, n2)))


class Scaled(AbstractWrapper):
    """A multiple of an energy, such as that of a wider or stiffer hinge."""

    factor: Scalar  # The factor; finite and not negative
    energy: AbstractEnergy

    @property
    def multiple(self) -> Scalar:
        return self.factor

    def validation_error(self) -> str | None:
        factor = concrete(self.factor)
        if factor is not None and not np.all((factor >= 0) & np.isfinite(factor)):
            return f"its factor must be finite and not negative, but is {factor}."
        return None


def nested(
    energy: AbstractEnergy, *, displaced_alike: bool = False
) -> Iterator[AbstractEnergy]:
    """Iterate over an energy and all energies in its fields, at any depth.

    If they must be `displaced_alike`, those in a sub-mechanism are left out.
    """
    yield energy
    if displaced_alike and not energy._parts_are_displaced_alike:
        return
    for field in fields(energy):
        value = getattr(energy, field.name, None)
        for part in jax.tree.leaves(value, is_leaf=is_energy):
            if is_energy(part):
                yield from nested(part, displaced_alike=displaced_alike)


def is_energy(value: Any) -> bool:
    """Decide whether a value is an energy."""
    return isinstance(value, AbstractEnergy)


def out_of_range(energy: AbstractEnergy, displacement: Displacement) -> Flag | None:
    """Decide whether a displacement is outside a validity range of an energy.

    The ranges of all nested energies count. The result is None if there is no range.
    """
    parts = nested(energy, displaced_alike=True)
    outside = [part.out_of_range(displacement) for part in parts]
    outside = [flag for flag in outside if flag is not None]
    return jnp.any(jnp.stack(outside)) if outside else None


def range_message(energy: AbstractEnergy, displacement: Displacement) -> str:
    """Describe a displacement and the first validity range outside of which it is."""
    for part in nested(energy, displaced_alike=True):
        outside = part.out_of_range(displacement)
        if outside is not None and concrete(outside) is not None and outside:
            return part.range_message(displacement)
    return "the energy is valid everywhere"


def range_share(energy: AbstractEnergy, displacement: Displacement) -> Scalar | None:
    """Compute the largest share of a displacement in the range of a simple flexure.

    The result is None if no nested energy is that of a linear flexure or `quartic_leaf`.
    """
    parts = nested(energy, displaced_alike=True)
    shares = [part.range_share(displacement) for part in parts]
    shares = [share for share in shares if share is not None]
    return largest_of(jnp.stack(shares)) if shares else None


def validation_error(energy: AbstractEnergy) -> str | None:
    """Describe the first invalid value of an energy; None if all are valid."""
    errors = (part.validation_error() for part in nested(energy))
    return next((error for error in errors if error), None)


def positive_error(energy: AbstractEnergy, *names: str) -> str | None:
    """Describe the first of some fields that is known and not positive."""
    for name in names:
        value = concrete(getattr(energy, name))
        if value is not None and not np.all((value > 0) & np.isfinite(value)):
            return f"`{name}` must be positive and finite, but is {value}."
    return None


class _RangeOnly(AbstractEnergy):
    """The validity range of a sum, without its energy."""

    energy: AbstractEnergy

    def stored_energy(self, displacement: Displacement) -> Scalar:
        return jnp.zeros_like(displacement.angle)


def parallel_terms(energy: AbstractEnergy) -> tuple[AbstractEnergy, ...]:
    """Split an energy into the terms of its sum; itself, if it is not a sum.

    A mechanism treats the terms as hinges in parallel, so that each term has its own
    optional methods. If a sum has a validity range, an additional term without energy
    checks this range.
    """
    if isinstance(energy, Sum):
        return tuple(term for part in energy.parts for term in parallel_terms(part))
    if not isinstance(energy, AbstractWrapper):
        return (energy,)
    terms = parallel_terms(energy.energy)
    if len(terms) == 1:
        return (energy,)
    if energy.multiple is not None:
        terms = tuple(Scaled(factor=energy.multiple, energy=term) for term in terms)
    if type(energy).out_of_range is not AbstractEnergy.out_of_range:
        terms = (*terms, _RangeOnly(energy))
    return terms
