"""Stress in a flexure as a function of its displacement and its wrench."""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._utils.printing import Printed
from .._utils.types import Corners, Scalar
from .._utils.validation import require_positive_fields
from ..geometry.twistors import Displacement
from .base import AbstractEnergy, AbstractWrapper
from .natural_curvature import NaturallyCurved
from .sections import out_of_plane_stiffness as stiffness_of_sections, Sections


# Moment, axial force, and transverse force in the mid-frame; N m, N, N
MidWrench = tuple[Scalar, Scalar, Scalar]


class Strengths(Printed):
    """Strengths of a material, which are positive; None if they are not given."""

    # Largest allowable stress under static loads: the yield strength, or the fracture
    # strength of a brittle material; Pa
    static: Scalar | None = None
    ultimate: Scalar | None = None  # Ultimate tensile strength; Pa
    # Endurance limit: largest amplitude of a stress that alternates about zero, for
    # infinite life; Pa
    endurance: Scalar | None = None

    def __check_init__(self) -> None:
        require_positive_fields(self, "static", "ultimate", "endurance")


class AbstractStressModel(eqx.Module):
    """Stress at some points of the surface of a flexure, and its cross-sections.

    It is the normal stress. For a flexure under shear, it may be an equivalent stress,
    with a sign that changes with the load.
    """

    strengths: eqx.AbstractVar[Strengths]

    @abstractmethod
    def surface_stresses(
        self, displacement: Displacement, wrench: MidWrench
    ) -> Float[Array, " points"]:
        """Compute the normal stress at points of the surface; Pa, positive in tension.

        The points are always the same. The strain must follow from the wrench, which is
        without natural curvature; the displacement gives the arms of the forces only. The
        wrench has the moment about the point halfway between the two frames, the axial
        force, and the transverse force, in the mid-frame; N m, N, N.
        """

    @property
    def knows_sections(self) -> bool:
        """Whether `sections` can be called."""
        return False

    def sections(self, displacement: Displacement, wrench: MidWrench) -> Sections:
        """Return the deformed cross-sections in the mid-frame.

        The arguments are those of `surface_stresses`.
        """
        raise NotImplementedError

    def outline(self) -> Corners | None:
        """Return the corners of the undeformed flexure in its frame, for drawing; m.

        It is None if there is more than one flexure.
        """
        return None

    @abstractmethod
    def dilated(self, scale: Float[Array, "*batch"]) -> "AbstractStressModel":
        """Return the model if all dimensions are multiplied by a factor."""


def stress_model(energy: AbstractEnergy) -> AbstractStressModel | None:
    """Return the stress model of an energy, or of the energy that it wraps.

    An energy of a flexure has it as the field `stress_model`. A sum has none; its terms
    are treated as hinges in parallel.
    """
    inner: Any = energy
    while (model := getattr(inner, "stress_model", None)) is None:
        if not isinstance(inner, AbstractWrapper):
            return None
        inner = inner.energy
    return model


def surface_stresses(
    energy: AbstractEnergy, displacement: Displacement, wrench: MidWrench
) -> Float[Array, " points"]:
    """Compute the normal stress at points of the surface of a flexure; Pa.

    The energy has a stress model. The wrench is that of the hinge; N m, N, N.
    """
    if isinstance(energy, NaturallyCurved):
        # The strain is that of the deformed shape minus that of the natural curvature.
        zero = jnp.zeros_like(displacement.angle)
        straight = Displacement(zero, zero + 1, zero, zero, zero)
        deformed = energy.without_curvature(wrench)
        natural = energy.without_curvature((zero, zero, zero))
        stresses = surface_stresses(energy.energy, displacement, deformed)
        return stresses - surface_stresses(energy.energy, straight, natural)
    model = stress_model(energy)
    assert model is not None
    return model.surface_stresses(displacement, wrench_of_flexure(energy, wrench))


def out_of_plane_stiffness(
    energy: AbstractEnergy, displacement: Displacement, wrench: MidWrench, warping: bool
) -> Float[Array, "displacements displacements"] | None:
    """Compute the stiffness of a flexure out of its plane; None if it is not known.

    It is that of the mid-frame; see `sections.out_of_plane_stiffness`. The wrench is that
    of the hinge; N m, N, N.
    """
    if isinstance(energy, NaturallyCurved):
        deformed = energy.without_curvature(wrench)
        return out_of_plane_stiffness(energy.energy, displacement, deformed, warping)
    model = stress_model(energy)
    if model is None or not model.knows_sections:
        return None
    sections = model.sections(displacement, wrench_of_flexure(energy, wrench))
    return _multiple(energy) * stiffness_of_sections(sections, warping)


def wrench_of_flexure(energy: AbstractEnergy, wrench: MidWrench) -> MidWrench:
    """Compute the wrench of the flexure of a hinge; N m, N, N.

    A multiple of an energy is that of several equal flexures in parallel, each of which
    carries its share of the wrench of the hinge.
    """
    multiple = _multiple(energy)
    share = jnp.where(multiple > 0, 1 / multiple, 0.0)
    moment, axial, transverse = wrench
    return share * moment, share * axial, share * transverse


def _multiple(energy: AbstractEnergy) -> Scalar:
    """Return the number of equal flexures in parallel that make up a hinge."""
    inner: Any = energy
    multiple = jnp.ones(())
    while getattr(inner, "stress_model", None) is None:
        if inner.multiple is not None:
            multiple = multiple * inner.multiple
        inner = inner.energy
    return multiple
