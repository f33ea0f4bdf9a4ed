"""Strains and stored energy of a cross-section of a beam under its forces.

All quantities are dimensionless: lengths over the length `L` of the beam, moments over
`E I / L` and forces over `E I / L^2`, where `E I` is the bending stiffness of the middle
section, with its factor.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._utils.host import as_float, on_host
from ..._utils.types import Pose, Scalar, Wrench
from .beam import Beam, Law


Strains = tuple[Scalar, Scalar, Scalar]  # stretch, shear, curvature


class CrossSection(NamedTuple):
    """A cross-section of a beam."""

    height: Scalar  # Thickness over that of the middle section
    slenderness: Scalar  # Thickness of the middle section over the length of the beam
    bending_factor: Scalar  # Factor of the bending stiffness
    # Shear correction factor times shear modulus over Young's modulus; None to neglect
    # shear deformation
    shear_ratio: Scalar | None
    curvature: Scalar  # Curvature of the undeformed beam times its length


def section_of(beam: Beam, position: Scalar) -> CrossSection:
    """Return the cross-section at a position along the axis over the length."""
    middle = beam.profile(jnp.zeros(()))
    height = beam.profile(position * beam.length) / middle
    slenderness = middle / beam.length
    curvature = jnp.zeros(())
    if beam.curvature is not None:
        curvature = beam.length * beam.curvature(position * beam.length)
    factor = beam.bending_factor
    return CrossSection(height, slenderness, factor, shear_ratio(beam), curvature)


def shear_ratio(beam: Beam) -> Scalar | None:
    """Return the shear correction factor times shear modulus over Young's modulus."""
    if beam.shear_factor is None:
        return None
    _, (factor, poisson) = on_host(beam.shear_factor, beam.material.poisson)
    return as_float(factor / (2 * (1 + poisson)))


def section_rates(
    section: CrossSection,
    law: Law,
    load: Wrench,
    pose: Pose | tuple[Scalar, Scalar, Scalar],
) -> tuple[Pose, Scalar, Strains]:
    """Compute the rates of pose and energy along the axis of a beam, and the strains.

    The load and the pose of the cross-section are in frame a.
    """
    angle, x, y = pose
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    moment = load[0] - (x * load[2] - y * load[1])
    axial, transverse = cos * load[1] + sin * load[2], cos * load[2] - sin * load[1]
    strains, density = _section_strains(section, law, (axial, transverse, moment))
    stretch, shear, curvature = strains
    x_rate = cos * (1 + stretch) - sin * shear
    y_rate = sin * (1 + stretch) + cos * shear
    rates = jnp.stack([curvature + section.curvature, x_rate, y_rate])
    return rates, density, strains


def fiber_strains(section: CrossSection, law: Law, strains: Strains) -> Float[Array, "2"]:
    """Compute the strains of the outermost fibers, first on the side of axis 2."""
    stretch, shear, curvature = strains
    half_height = section.height * section.slenderness / 2
    fibers = stretch + jnp.stack([-half_height, half_height]) * curvature
    if law == "saint-venant-kirchhoff":
        fibers = fibers + (fibers**2 + shear**2) / 2
    return fibers


def _section_strains(
    section: CrossSection, law: Law, forces: tuple[Scalar, Scalar, Scalar]
) -> tuple[Strains, Scalar]:
    """Compute stretch, shear, and curvature, and the energy density; dimensionless.

    `forces` are axial force, shear force, and bending moment, dimensionless.
    """
    axial_force, shear_force, moment = forces
    height, slenderness, bending_factor = section[:3]
    axial_stiffness = 12 / (bending_factor * slenderness**2) * height
    bending_stiffness = height**3
    shear_stiffness = jnp.full_like(axial_stiffness, jnp.inf)
    if section.shear_ratio is not None:
        shear_stiffness = axial_stiffness * section.shear_ratio
    stretch, shear = axial_force / axial_stiffness, shear_force / shear_stiffness
    linear = stretch, shear, moment / bending_stiffness
    if law == "linear":
        work = axial_force * stretch + shear_force * shear + moment * linear[2]
        return linear, work / 2

    # The energy density is the square of the Green strain, integrated over the section.
    # Its derivatives are written out, because those of JAX take a minute to compile.
    quartic_stiffness = 0.0375 * slenderness**2 * height**5

    def green(stretch: Scalar, shear: Scalar) -> tuple[Scalar, Scalar]:
        """Return the Green strain of the axis, and the factor of the curvature."""
        strain = stretch + (stretch**2 + shear**2) / 2
        return strain, (1 + stretch) ** 2 + strain

    def newton_step(_, strains: Strains) -> Strains:
        stretch, shear, curvature = strains
        strain, factor = green(stretch, shear)
        bending, stretched = bending_stiffness * curvature**2, 1 + stretch
        rotational = bending_stiffness * factor + 2 * quartic_stiffness * curvature**2
        residuals = (
            axial_force - (axial_stiffness * strain + 1.5 * bending) * stretched,
            shear_force
            - (axial_stiffness * strain + shear_stiffness + bending / 2) * shear,
            moment - rotational * curvature,
        )
        a = axial_stiffness * factor + 1.5 * bending
        b = axial_stiffness * (shear**2 + strain) + shear_stiffness + bending / 2
        c = bending_stiffness * factor + 6 * quartic_stiffness * curvature**2
        d = axial_stiffness * shear * stretched
        e = 3 * bending_stiffness * curvature * stretched
        f = bending_stiffness * curvature * shear
        steps = _solve_symmetric((a, b, c, d, e, f), residuals)
        return stretch + steps[0], shear + steps[1], curvature + steps[2]

    previous = jax.lax.fori_loop(0, 6, newton_step, linear)
    stretch, shear, curvature = strains = newton_step(6, previous)
    # Above its largest moment a section has no equilibrium, and the iteration diverges.
    steps = [jnp.abs(new - old) for new, old in zip(strains, previous, strict=True)]
    converged = steps[0] + steps[1] + slenderness * steps[2] < 1e-8
    strain, factor = green(stretch, shear)
    density = (
        axial_stiffness * strain**2
        + shear_stiffness * shear**2
        + bending_stiffness * factor * curvature**2
        + quartic_stiffness * curvature**4
    ) / 2
    density = jnp.where(converged, density, jnp.nan)
    return (stretch, shear, jnp.where(converged, curvature, jnp.nan)), density


def _solve_symmetric(
    matrix: tuple[Scalar, ...], right: tuple[Scalar, Scalar, Scalar]
) -> tuple[Scalar, Scalar, Scalar]:
    """Solve three linear equations by cofactors.

    The entries of the symmetric matrix are 11, 22, 33, 12, 13 and 23.
    """
    a, b, c, d, e, f = matrix
    x, y, z = right
    aa, bb, cc = b * c - f * f, a * c - e * e, a * b - d * d
    dd, ee, ff = e * f - c * d, d * f - b * e, d * e - a * f
    determinant = a * aa + d * dd + e * ee
    return (
        (aa * x + dd * y + ee * z) / determinant,
        (dd * x + bb * y + ff * z) / determinant,
        (ee * x + ff * y + cc * z) / determinant,
    )
