"""Flexures of any thickness profile and curvature, as geometrically exact planar beams.

The geometry is the thickness and the curvature along the axis, so a leaf, a notch, a
hinge with fillets, and an arch are the same model. `beam_under_load` computes the
deformed state under a load, and `beam_at_pose` at a given displacement.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from typing_extensions import TypeAliasType

from ..._compile.traced_function import traced
from ..._utils.host import as_float, on_host, tree_on_host
from ..._utils.types import Corners, NumberLike, Numbers, Scalar
from ..._utils.validation import (
    require_choice,
    require_finite,
    require_instance,
    require_length,
    require_positive,
)
from ...mechanism.material import Material


Law = Literal["linear", "saint-venant-kirchhoff"]


# One number, or a function of the arc length; m
ThicknessLike = TypeAliasType("ThicknessLike", NumberLike | Callable[[Scalar], Scalar])
# One number, or a function of the arc length; 1/m
CurvatureLike = TypeAliasType("CurvatureLike", NumberLike | Callable[[Scalar], Scalar])


class Beam(eqx.Module):
    """A flexure that is defined by its thickness and its curvature along the axis.

    Its frames a and b coincide at the middle of the undeformed beam, with axis 1 along
    the beam. Frame a is fixed to its first end, and frame b to its second end.

    Args:
        material: Material of the plate.
        length: Free length along the axis, without the clamped parts; m.
        thickness: In-plane thickness across the axis; m. Either a number, or a function
            of the position along the axis from -length / 2 to length / 2, such as
            `notch_profile` returns.
        width: Out-of-plane width, which is the thickness of the plate; m.
        curvature: Curvature of the undeformed beam, by default zero; 1/m. Either a
            number, or a function of the same position. A positive curvature turns the
            axis from axis 1 towards axis 2. A beam that is made straight and bent into
            place is a straight beam; give the misfit of its ports, see `Hinge`.
        bending_factor: Factor of the bending stiffness only. A leaf that is wide compared
            with its length bends as a plate, and is stiffer by up to
            `1 / (1 - poisson**2)`.
        law: Constitutive law. With "linear", the forces are linear in the strains of a
            section. With "saint-venant-kirchhoff", the stress is linear in the Green
            strain, as in finite-element programs for large displacements. The wrenches of
            the two laws differ by about 10 % for a leaf with a length of ten thicknesses
            that rotates by 46 degrees.
        shear_factor: Shear correction factor; `None` to neglect shear deformation.
        steps: Number of integration steps along the axis. With 16 steps the relative
            error for a leaf is about 1e-10. A beam whose thickness changes strongly along
            the axis, such as the neck of a notch, needs more steps, for example 48.

    Raises:
        ValueError: A dimension or the factor is not positive, the curvature is not
            finite, or a curved beam has another law than "linear".

    Source:
        Reissner, On one-dimensional finite-strain beam theory: the plane problem, ZAMP
        23, 1972.

    Example:
        >>> polymer = Material(modulus=3.45e9, poisson=0.3)
        >>> beam = Beam(polymer, length=10e-3, thickness=1e-3, width=5e-3)
        >>> beam.rotational_stiffness
        Array(0.14375, dtype=float64)
    """

    material: Material
    length: Scalar
    profile: Callable[[Scalar], Scalar]
    width: Scalar
    curvature: Callable[[Scalar], Scalar] | None
    bending_factor: Scalar
    shear_factor: Scalar | None
    law: Law = eqx.field(static=True)
    steps: int = eqx.field(static=True)

    def __init__(
        self,
        material: Material,
        *,
        length: NumberLike,
        thickness: ThicknessLike,
        width: NumberLike,
        curvature: CurvatureLike | None = None,
        bending_factor: NumberLike = 1.0,
        law: Law = "linear",
        shear_factor: NumberLike | None = 5 / 6,
        steps: int = 16,
    ):
        self.material = require_instance("material", material, Material)
        self.length = require_length("`length`", length, material.modulus)
        self.width = require_length("`width`", width, material.modulus)
        self.bending_factor = require_positive("`bending_factor`", bending_factor)
        self.law = require_choice("`law`", law, ("linear", "saint-venant-kirchhoff"))
        if curvature is not None and law != "linear":
            raise ValueError(
                f'`law` is {law!r}, but a curved beam has the law "linear" only.'
            )
        self.shear_factor = None
        if shear_factor is None and law != "linear":
            raise ValueError(
                f"`shear_factor` is None, but the law {law!r} needs shear deformation. "
                'Give a factor, or use the law "linear".'
            )
        if shear_factor is not None:
            self.shear_factor = require_positive("`shear_factor`", shear_factor)
        if steps < 1:
            raise ValueError(f"`steps` is {steps!r}, but must be at least 1.")
        self.steps = steps
        if not callable(thickness):
            thickness = require_length("`thickness`", thickness, material.modulus)
        self.profile = _along_axis(thickness)
        self.curvature = None
        if curvature is not None:
            if not callable(curvature):
                curvature = require_finite("`curvature`", curvature)
            self.curvature = _along_axis(curvature)

    @property
    def rotational_stiffness(self) -> Scalar:
        """Rotational stiffness E I / L, with E I of the middle section; N m/rad."""
        height = self.profile(jnp.zeros(()))
        modulus = self.bending_factor * self.material.modulus
        return modulus * self.width * height**3 / (12 * self.length)


def _along_axis(
    value: Scalar | Callable[[Scalar], Scalar],
) -> Callable[[Scalar], Scalar]:
    """Return a function of the position; m."""
    if not callable(value):
        return Uniform(value)
    function = traced(value)
    if isinstance(function, eqx.Module | jax.tree_util.Partial):
        return function  # pyright: ignore[reportReturnType]
    return jax.tree_util.Partial(function)


class AbstractProfile(eqx.Module):
    """A function of the position along the axis that accepts an array of positions.

    It is computed by NumPy, so it compiles no program, unless a number is traced.
    """

    @abstractmethod
    def values(self, xp: Any, position: Any) -> Any:
        """Compute the values at positions (m) with the functions of NumPy or JAX."""

    def __call__(self, position: Numbers) -> Numbers:
        xp, (profile, at) = tree_on_host((self, position))
        return as_float(profile.values(xp, at))


class Uniform(AbstractProfile):
    """A value that is the same at any position."""

    value: Scalar

    def values(self, xp: Any, position: Any) -> Any:
        return xp.broadcast_to(self.value, xp.shape(position))


def breaks_of(function: Callable[[Scalar], Scalar]) -> Float[Array, "4"] | None:
    """Return the positions (m) between which a function is smooth.

    They are known of functions that have the property `breaks`.
    """
    return getattr(function, "breaks", None)


def outline_along(
    position: Any, thickness: Any, curvature: Array | None = None
) -> Corners:
    """Return the corners of a flexure by values along its axis; m, m, 1/m."""
    xp, (x, thickness) = on_host(position, thickness)
    angle, axis = 0 * x, xp.stack([x, 0 * x], axis=1)
    if curvature is not None:
        angle = _integrated(np.asarray(curvature), x)
        axis = _integrated(np.stack([np.cos(angle), np.sin(angle)], axis=1), x[:, None])
    half = thickness[:, None] / 2 * xp.stack([-xp.sin(angle), xp.cos(angle)], axis=1)
    return as_float(xp.concatenate([axis + half, (axis - half)[::-1]]))


def _integrated(values: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Integrate values at positions by trapezoids, from the middle one."""
    steps = np.diff(position, axis=0) * (values[1:] + values[:-1]) / 2
    integral = np.concatenate([np.zeros_like(steps[:1]), np.cumsum(steps, axis=0)])
    return integral - integral[len(integral) // 2]


def values_along(
    function: Callable[..., Numbers], positions: Float[ArrayLike, " positions"]
) -> Float[Array, " positions"]:
    """Evaluate a function of the position at many positions; m."""
    array = as_float(positions)
    if isinstance(function, AbstractProfile):
        return function(array)
    return _mapped(function, array)


@eqx.filter_jit
def _mapped(
    function: Callable[[Scalar], Scalar], positions: Float[Array, " positions"]
) -> Float[Array, " positions"]:
    """Evaluate a function of one position at many of them; m."""
    return jax.vmap(function)(positions)


def functions_along(beam: Beam) -> list[Callable[[Scalar], Scalar]]:
    """List the functions of the position that describe a beam."""
    return [beam.profile] if beam.curvature is None else [beam.profile, beam.curvature]


def is_uniform(beam: Beam) -> bool:
    """Decide whether thickness and curvature of a beam are known to be constant."""
    return all(isinstance(function, Uniform) for function in functions_along(beam))


def load_units(beam: Beam) -> Float[Array, "3"]:
    """Return the units of a load, (E I / L, E I / L^2, E I / L^2); N m, N, N."""
    moment = beam.rotational_stiffness
    return jnp.stack([moment, moment / beam.length, moment / beam.length])


def pose_units(beam: Beam) -> Float[Array, "3"]:
    """Return the units of a dimensionless pose, (1, L, L); rad, m, m."""
    return jnp.stack([jnp.ones(()), beam.length, beam.length])


def smallest_thickness(beam: Beam) -> Scalar:
    """Return the smallest of the thicknesses at 201 positions along a beam; m."""
    _, (length,) = on_host(beam.length)
    xp, (values,) = on_host(
        values_along(beam.profile, length * np.linspace(-0.5, 0.5, 201))
    )
    return as_float(xp.min(values))


def arc_rotation(beam: Beam, stress: Scalar) -> Scalar:
    """Compute the rotation of an arc of the smallest thickness at a stress (Pa); rad."""
    strain = stress / beam.material.modulus
    return 2 * strain * beam.length / smallest_thickness(beam)
