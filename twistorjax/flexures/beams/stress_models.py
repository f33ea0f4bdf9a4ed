"""Stress models of leaves, notches, exact beams, and sub-mechanisms of flexures."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.host import as_float, on_host
from ..._utils.pytrees import group_by_structure
from ..._utils.types import Corners, NumberLike, Pose, Scalar, Wrench
from ..._utils.validation import require_positive_fields
from ...energies.dilation import multiply_fields
from ...energies.monomials import Powers
from ...energies.one_freedom import Freedom, FREEDOM_VARIABLES
from ...energies.polynomial import require_powers
from ...energies.sections import (
    at_nodes,
    bent_sections,
    first_end,
    nodes,
    Sections,
    seen_from,
)
from ...energies.strains import strain
from ...energies.stress_model import AbstractStressModel, MidWrench, Strengths
from ...geometry import se2
from ...geometry.twistors import Displacement
from .beam import Beam, breaks_of, Law, outline_along, values_along
from .cross_section import CrossSection, fiber_strains, section_rates, shear_ratio


_INTERVALS = 200  # Between cross-sections along a beam
# Axes of the fields of cross-sections that differ in height and curvature only
_ALONG = CrossSection._make((0, None, None, None, 0))


class SectionStress(AbstractStressModel):
    """Stress in a straight leaf at its ends, or in a notch at its thinnest section.

    The stress is that of linear bending and tension under the wrench of the hinge, times
    the stress concentration factors of the curved surface of a notch.

    Source:
        Stress concentration factors of deep hyperbolic notches: Neuber,
        Kerbspannungslehre (1937).
    """

    arm: Scalar  # From the middle to the section; zero for a notch; m
    thickness: Scalar  # In-plane thickness of the section; m
    width: Scalar  # Out-of-plane; m
    ratio: Scalar  # Half the thickness over the radius of the surface; zero for a leaf
    strengths: Strengths
    # Young's modulus and shear modulus (Pa), if a notch is circular
    moduli: tuple[Scalar, Scalar] | None = None
    # Length and in-plane thickness of the thick middle of a leaf; m
    reinforced: Float[Array, "2"] | None = None

    def __check_init__(self) -> None:
        require_positive_fields(self, "thickness", "width", or_zero=("arm", "ratio"))

    @classmethod
    def of_leaf(
        cls,
        strengths: Strengths,
        length: NumberLike,
        thickness: NumberLike,
        width: NumberLike,
        moduli: tuple[Scalar, Scalar] | None = None,
        reinforced: Float[Array, "2"] | None = None,
    ) -> "SectionStress":
        """Create the model of a leaf; m."""
        _, (length, thickness, width) = on_host(length, thickness, width)
        return cls(
            arm=as_float(length / 2),
            thickness=as_float(thickness),
            width=as_float(width),
            ratio=as_float(np.zeros(np.shape(length))),
            strengths=strengths,
            moduli=moduli,
            reinforced=reinforced,
        )

    @classmethod
    def of_notch(
        cls,
        strengths: Strengths,
        hole: NumberLike,
        web: NumberLike,
        width: NumberLike,
        moduli: tuple[Scalar, Scalar] | None = None,
    ) -> "SectionStress":
        """Create the model of a notch; m."""
        _, (hole, web, width) = on_host(hole, web, width)
        return cls(
            arm=as_float(np.zeros(np.shape(web))),
            thickness=as_float(web),
            width=as_float(width),
            ratio=as_float(web / hole),
            strengths=strengths,
            moduli=moduli,
        )

    def surface_stresses(
        self, displacement: Displacement, wrench: MidWrench
    ) -> Float[Array, "4"]:
        """Compute the stress on both sides of the sections at both ends; Pa."""
        del displacement  # The equations are those of the undeformed flexure.
        moment, axial, transverse = wrench
        bending_factor, tension_factor = _concentration_factors(self.ratio)
        area = self.width * self.thickness
        tension = tension_factor * axial / area
        modulus = area * self.thickness / 6
        stresses = []
        for arm in (-self.arm, self.arm):
            bending = bending_factor * (moment - arm * transverse) / modulus
            stresses += [tension - bending, tension + bending]
        return jnp.stack(stresses)

    @property
    def knows_sections(self) -> bool:
        return self.moduli is not None

    def sections(self, displacement: Displacement, wrench: MidWrench) -> Sections:
        """Bend the cross-sections by the moments of the undeformed flexure."""
        assert self.moduli is not None
        is_leaf = self.ratio == 0
        radius = self.thickness / jnp.where(is_leaf, 1.0, 2 * self.ratio)
        half = jnp.where(is_leaf, self.arm, radius)
        surface = jnp.where(is_leaf, 0.0, 2 * radius * (1 - np.sqrt(1 - nodes() ** 2)))
        # Middle, length, and thickness of each part
        contour = [(0.0, 2 * half, self.thickness + surface)]
        if self.reinforced is not None:
            inner, thick = self.reinforced
            outer, arm = half - inner / 2, (half + inner / 2) / 2
            thin = self.thickness
            contour = [(-arm, outer, thin), (0.0, inner, thick), (arm, outer, thin)]
        start, parts = first_end(displacement, 2 * half), []
        for middle, length, thickness in contour:
            moments = wrench[0] - (middle + length / 2 * nodes()) * wrench[2]
            curvature = 12 * moments / (self.moduli[0] * self.width * thickness**3)
            poses = bent_sections(start, length, curvature)
            parts.append((poses[:-1], thickness, length))
            start = poses[-1]
        all_poses, thicknesses, lengths = map(jnp.stack, zip(*parts, strict=True))
        return Sections(all_poses, thicknesses, lengths, self.width, *self.moduli)

    def outline(self) -> Corners:
        arm, thickness, ratio = map(np.asarray, (self.arm, self.thickness, self.ratio))
        if ratio > 0:
            angle = np.linspace(-np.pi / 2, np.pi / 2, 61)
            radius = thickness / (2 * ratio)
            surface = 2 * radius * (1 - np.cos(angle))
            return outline_along(radius * np.sin(angle), thickness + surface)
        if self.reinforced is None:
            return outline_along(np.linspace(-arm, arm, 24), np.full(24, thickness))
        length, thick = np.asarray(self.reinforced)
        inner = np.array([-length, length]) / 2
        outer = np.linspace(length / 2, arm, 12)
        position = np.concatenate([-outer[::-1], inner, outer])
        return outline_along(
            position, np.repeat([thickness, thick, thickness], [12, 2, 12])
        )

    def dilated(self, scale: Float[Array, "*batch"]) -> "SectionStress":
        return multiply_fields(
            self, scale, arm=1, thickness=1, width=1, reinforced=[1, 1]
        )


def _concentration_factors(ratio: Scalar) -> tuple[Scalar, Scalar]:
    """Compute the stress concentration factors of a neck in bending and in tension.

    The ratio is half the thickness of the neck over the radius of its surface. A factor
    is the largest stress over that of a beam.
    """
    # The factors are quotients of small differences for a thin neck, where their series
    # are used instead.
    thin = ratio < 1e-3
    safe = jnp.where(thin, 1.0, ratio)
    root = jnp.sqrt(safe)
    angle = jnp.arctan(root)
    bending = 4 * safe * root / (3 * (root + (safe - 1) * angle))
    bending = jnp.where(thin, 1 + 2 / 5 * ratio - 17 / 175 * ratio**2, bending)
    tension = 2 * (safe + 1) * root / ((safe + 1) * angle + root)
    tension = jnp.where(thin, 1 + 2 / 3 * ratio - 7 / 45 * ratio**2, tension)
    return bending, tension


class BeamColumnStress(AbstractStressModel):
    """Stress in a leaf as a beam-column, on both sides of 17 cross-sections.

    It includes the moment of the axial force in the bent leaf, which is largest between
    the ends under compression. Stress concentrations at the ends are not included.

    Source:
        Timoshenko and Gere, Theory of Elastic Stability, 1961, section 1.11.
    """

    length: Scalar  # Free length; m
    thickness: Scalar  # In-plane; m
    width: Scalar  # Out-of-plane; m
    modulus: Scalar  # Pa
    strengths: Strengths
    shear_ratio: Scalar | None = None  # As in `BeamStress`
    shear_modulus: Scalar | None = None  # Pa

    def __check_init__(self) -> None:
        require_positive_fields(
            self,
            "length",
            "thickness",
            "width",
            "modulus",
            "shear_ratio",
            "shear_modulus",
        )

    def surface_stresses(
        self, displacement: Displacement, wrench: MidWrench
    ) -> Float[Array, "34"]:
        """Compute the stress on both sides of each cross-section; Pa."""
        area = self.width * self.thickness
        moments = self._moments(displacement, wrench, jnp.linspace(-0.5, 0.5, 17))
        stress = 6 * moments / (area * self.thickness)
        return wrench[1] / area + jnp.concatenate([-stress, stress])

    @property
    def knows_sections(self) -> bool:
        return self.shear_modulus is not None

    def sections(self, displacement: Displacement, wrench: MidWrench) -> Sections:
        """Bend the cross-sections by the moments."""
        assert self.shear_modulus is not None
        moments = self._moments(displacement, wrench, jnp.asarray(nodes() / 2))
        stiffness = self.modulus * self.width * self.thickness**3 / 12
        start = first_end(displacement, self.length)
        poses = bent_sections(start, self.length, moments / stiffness)[:-1]
        return Sections(
            poses[None],
            self.thickness[None],
            self.length[None],
            self.width,
            self.modulus,
            self.shear_modulus,
        )

    def _moments(
        self,
        displacement: Displacement,
        wrench: MidWrench,
        position: Float[Array, " sections"],
    ) -> Float[Array, " sections"]:
        """Compute the bending moments at positions from -1/2 to 1/2; N m."""
        moment, axial, transverse = wrench
        area = self.width * self.thickness
        bending = self.modulus * area * self.thickness**2 / 12
        # Mean and half the difference of the moments at the ends, from the equilibrium
        arm = displacement.x1 + self.length / 2 * displacement.sigma
        mean = moment + self.length / 2 * displacement.xi * axial
        half = displacement.x2 * axial - arm * transverse
        ratio = axial * self.length**2 / bending
        if self.shear_ratio is not None:  # Shear and stretch change the bending.
            ratio = ratio * (
                1 + (1 - 1 / self.shear_ratio) * axial / (self.modulus * area)
            )
        root = jnp.sqrt(jnp.maximum(jnp.abs(ratio), 1e-8))
        # At a larger tension, the hyperbolic functions would overflow.
        position = jnp.minimum(root, 1000.0) * jnp.append(position, 0.5)
        compressed = ratio < 0
        cos = jnp.where(compressed, jnp.cos(position), jnp.cosh(position))
        sin = jnp.where(compressed, jnp.sin(position), jnp.sinh(position))
        bowing = bending / self.length * displacement.angle * root / 2
        return mean + (bowing * (cos - cos[-1]) + half * sin)[:-1] / sin[-1]

    def outline(self) -> Corners:
        position = np.asarray(self.length) * np.linspace(-0.5, 0.5, 24)
        return outline_along(position, np.full(24, self.thickness))

    def dilated(self, scale: Float[Array, "*batch"]) -> "BeamColumnStress":
        return multiply_fields(self, scale, length=1, thickness=1, width=1)


class BeamStress(AbstractStressModel):
    """Stress in the outermost fibers of the cross-sections of a beam.

    The moments are those in the deformed beam, for any displacement. The wrench is that
    of the energy, so the stress of a surrogate has about the error of its wrench. Stress
    concentrations at notches, fillets, and sharp corners are not included.

    Source:
        Reissner, On one-dimensional finite-strain beam theory: the plane problem, ZAMP
        23, 1972.
    """

    # At positions that are denser at the ends, and at both sides of the `breaks`; m
    thickness: Float[Array, "201"]
    # Of the undeformed beam at these positions; 1/m
    curvature: Float[Array, "201"] | None
    length: Scalar  # m
    width: Scalar  # Out-of-plane; m
    modulus: Scalar  # Pa
    bending_factor: Scalar  # Factor of the bending stiffness
    # Shear correction factor times shear modulus over Young's modulus; None to neglect
    # shear deformation
    shear_ratio: Scalar | None
    strengths: Strengths
    law: Law = eqx.field(static=True)
    shear_modulus: Scalar | None = None  # Pa
    # Whether other segments of the same flexure continue each end; see `Sections`
    continues: Float[Array, "2"] | None = None
    # Positions along the axis between which the thickness is smooth; m
    breaks: Float[Array, "4"] | None = None

    def __check_init__(self) -> None:
        require_positive_fields(
            self,
            "thickness",
            "length",
            "width",
            "modulus",
            "bending_factor",
            "shear_ratio",
            "shear_modulus",
        )

    @classmethod
    def of(cls, beam: Beam) -> "BeamStress":
        breaks, curvature = breaks_of(beam.profile), None
        _, (length,) = on_host(beam.length)
        positions = length * _along(_ends(length, breaks))[0]
        if beam.curvature is not None:
            curvature = values_along(beam.curvature, positions)
        material = beam.material
        return cls(
            thickness=values_along(beam.profile, positions),
            curvature=curvature,
            length=beam.length,
            width=beam.width,
            modulus=material.modulus,
            bending_factor=beam.bending_factor,
            shear_ratio=shear_ratio(beam),
            strengths=material.strengths,
            law=beam.law,
            shear_modulus=material.shear_modulus,
            breaks=breaks,
        )

    def surface_stresses(
        self, displacement: Displacement, wrench: MidWrench
    ) -> Float[Array, "402"]:
        """Compute the stress on both sides of each cross-section; Pa."""
        sections, load, poses = self._deformed(displacement, wrench)

        def fibers(section: CrossSection, pose: Pose) -> Float[Array, "2"]:
            _, _, strains = section_rates(section, self.law, load, pose)
            return fiber_strains(section, self.law, strains)

        along = jax.vmap(fibers, in_axes=(_ALONG, 0), out_axes=1)
        return self.modulus * along(sections, poses).reshape(-1)

    @property
    def knows_sections(self) -> bool:
        return self.shear_modulus is not None

    def sections(self, displacement: Displacement, wrench: MidWrench) -> Sections:
        """Return the cross-sections under the wrench."""
        assert self.shear_modulus is not None
        _, _, poses = self._deformed(displacement, wrench)
        poses = poses * jnp.stack([jnp.ones(()), self.length, self.length])[None]
        poses = seen_from(displacement.pose() / 2, poses)
        ends = _ends(self.length, self.breaks)
        count = len(ends) - 1
        of_parts = _INTERVALS // count * np.arange(count)[:, None]
        index = of_parts + np.arange(_INTERVALS // count + 1)
        return Sections(
            # Poses of the other sections are means, which are less accurate.
            jax.vmap(at_nodes)(poses[index[:, ::2]]),
            jax.vmap(at_nodes)(self.thickness[index]),
            self.length * (ends[1:] - ends[:-1]),
            self.width,
            self.modulus,
            self.shear_modulus,
            self.continues,
        )

    def _deformed(
        self, displacement: Displacement, wrench: MidWrench
    ) -> tuple[CrossSection, Wrench, Float[Array, "201 3"]]:
        """Compute sections, load, and poses of the sections, dimensionless in frame a."""
        height = self.thickness / self.length
        middle = height[len(height) // 2]
        area = self.modulus * self.width * self.length * middle
        unit = self.bending_factor * area * middle**2 / 12  # of the forces; N
        moment, axial, transverse = wrench
        # The load about frame a, from that about the point halfway between the frames
        cos, sin = displacement.sigma, displacement.xi
        x, y = displacement.x1 / self.length, displacement.x2 / self.length
        force_1, force_2 = axial / unit, transverse / unit
        load = jnp.stack(
            [
                moment / (unit * self.length) + x * force_2 - y * force_1,
                cos * force_1 - sin * force_2,
                sin * force_1 + cos * force_2,
            ]
        )
        curvature = jnp.zeros_like(height)
        if self.curvature is not None:
            curvature = self.length * self.curvature
        sections = CrossSection(
            height / middle, middle, self.bending_factor, self.shear_ratio, curvature
        )
        poses = self._integrate(sections, load, self._first_end(sections))
        return sections, load, poses

    def outline(self) -> Corners:
        length = np.asarray(self.length)
        position = length * np.asarray(_along(_ends(self.length, self.breaks))[0])
        return outline_along(position, np.asarray(self.thickness), self.curvature)

    def dilated(self, scale: Float[Array, "*batch"]) -> "BeamStress":
        return multiply_fields(
            self, scale, thickness=[1], curvature=[-1], length=1, width=1, breaks=[1]
        )

    def _integrate(
        self, sections: CrossSection, load: Wrench, start: Pose
    ) -> Float[Array, "sections 3"]:
        """Compute the poses of all cross-sections, dimensionless.

        A step of the method of Runge and Kutta goes from one section to the next but one.
        The pose of the section between them is the mean of both.
        """
        step = 2.0
        _, rates = _along(_ends(self.length, self.breaks))
        values = sections.height, sections.curvature, jnp.asarray(rates)

        def derivative(pose: Pose, at: tuple[Scalar, Scalar, Scalar]) -> Pose:
            height, curvature, rate = at
            section = sections._replace(height=height, curvature=curvature)
            return rate * section_rates(section, self.law, load, pose)[0]

        def advance(pose: Pose, at: tuple[Any, Any, Any]) -> tuple[Pose, Pose]:
            first, middle, last = at
            k1 = derivative(pose, first)
            k2 = derivative(pose + step / 2 * k1, middle)
            k3 = derivative(pose + step / 2 * k2, middle)
            k4 = derivative(pose + step * k3, last)
            pose = pose + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            return pose, pose

        first, middle, last = (
            tuple(value[part] for value in values)
            for part in (slice(0, -2, 2), slice(1, -1, 2), slice(2, None, 2))
        )
        _, even = jax.lax.scan(advance, start, (first, middle, last))
        even = jnp.concatenate([start[None], even])
        poses = jnp.zeros((len(sections.height), 3)).at[::2].set(even)
        return poses.at[1::2].set((even[:-1] + even[1:]) / 2)

    def _first_end(self, sections: CrossSection) -> Pose:
        """Compute the pose of the first end, seen from the middle; dimensionless."""
        if self.curvature is None:
            return jnp.array([0.0, -0.5, 0.0])
        poses = self._integrate(sections, jnp.zeros(3), jnp.zeros(3))
        return se2.inverse(poses[len(poses) // 2])


def _ends(length: Any, breaks: Any) -> Any:
    """Return the ends of the parts between breaks, over the length of the beam."""
    if breaks is None:
        return np.array([-0.5, 0.5])
    xp, (length, breaks) = on_host(length, breaks)
    # Breaks may be outside of a segment of a beam.
    margins = 1e-3 * np.arange(1, len(breaks) + 1)
    inside = xp.clip(breaks / length, margins - 0.5, 0.5 - margins[::-1])
    return xp.concatenate([np.array([-0.5]), inside, np.array([0.5])])


def _along(ends: Any) -> tuple[Any, Any]:
    """Return the positions of the cross-sections over the length of the beam.

    The second array has their derivatives by the index of the section. They are denser at
    the ends of each part, where the outline of a notch is steep.
    """
    xp, (ends,) = on_host(ends)
    count = _INTERVALS // (len(ends) - 1)
    angle = np.pi * (np.arange(1, count + 1) / count - 0.5)
    middle, half = (ends[:-1] + ends[1:]) / 2, (ends[1:] - ends[:-1]) / 2
    positions = xp.ravel(middle[:, None] + half[:, None] * np.sin(angle)[None])
    rates = xp.ravel(half[:, None] * np.pi / count * np.cos(angle)[None])
    return xp.concatenate([ends[:1], positions]), xp.concatenate([np.zeros(1), rates])


class MechanismStress(AbstractStressModel):
    """Stress in the flexures of a sub-mechanism that is replaced by one energy.

    The displacement and the wrench of each flexure are polynomials of the compliant
    coordinate and of the forces in the stiff directions, in the units of a
    `OneFreedomEnergy`. The stress follows from them by the stress model of the flexure.
    """

    parts: tuple[AbstractStressModel, ...]  # Stress models of the flexures
    # Coefficients of the polynomials of each flexure: displacement (angle, x, y), moment,
    # axial force, and transverse force in its mid-frame; rad, m, m, N m, N, N
    coefficients: Float[Array, "parts 6 terms"]
    length: Scalar  # Reference length, by which the transverse displacement is divided; m
    # Reference force, by which forces are divided; moments are divided by the force times
    # the length; N
    force: Scalar
    # Strengths of the material; the smallest ones, if the flexures have several materials
    strengths: Strengths
    # Powers of the compliant coordinate and of both forces in each term
    powers: Powers = eqx.field(static=True)
    # The compliant direction; see `OneFreedomEnergy`
    freedom: Freedom = eqx.field(static=True)

    def __check_init__(self) -> None:
        require_positive_fields(self, "length", "force")
        require_powers(self.powers, FREEDOM_VARIABLES[self.freedom])
        shape = len(self.parts), 6, len(self.powers)
        if self.coefficients.shape != shape or not self.parts:
            raise ValueError(
                f"`coefficients` has shape {self.coefficients.shape}, but must have the "
                f"shape {shape}: six rows for each of the `parts`, at least one, with a "
                "coefficient for each of the `powers`."
            )

    def surface_stresses(
        self, displacement: Displacement, wrench: MidWrench
    ) -> Float[Array, " points"]:
        """Compute the stress at the points of all flexures; Pa."""
        twist = strain(displacement, "twist")
        terms = terms_of_state(
            self.powers, self.freedom, (self.length, self.force), twist, wrench
        )
        states = self.coefficients @ terms
        stresses = {}
        # Flexures of the same kind are evaluated together.
        for rows in group_by_structure(self.parts):
            same = [self.parts[row] for row in rows]
            parts = jax.tree.map(lambda *leaves: jnp.stack(leaves), *same)
            values = jax.vmap(_stresses_at)(parts, states[np.array(rows)])
            stresses.update(zip(rows, values, strict=True))
        return jnp.concatenate([stresses[row] for row in sorted(stresses)])

    def dilated(self, scale: Float[Array, "*batch"]) -> "MechanismStress":
        exponents = np.array([0, 1, 1, 3, 2, 2])[None, :, None]
        new = multiply_fields(self, scale, coefficients=exponents, length=1, force=2)
        parts = tuple(part.dilated(scale) for part in self.parts)
        return eqx.tree_at(lambda model: model.parts, new, parts)


def terms_of_state(
    powers: Powers,
    freedom: Freedom,
    units: tuple[Scalar, Scalar],
    twist: tuple[Scalar, Scalar, Scalar],
    wrench: MidWrench,
) -> Float[Array, " terms"]:
    """Evaluate the terms of the polynomials of a `MechanismStress`.

    The units are the reference length and force (m, N). The twist (rad, m, m) and the
    wrench in the mid-frame (N m, N, N) are those of the sub-mechanism.
    """
    length, force = units
    moment, axial, transverse = wrench
    variables = twist[0], axial / force, transverse / force
    if freedom == "transverse":
        variables = twist[2] / length, moment / (force * length), axial / force
    factors = [
        jnp.stack([variable**k for k in range(max(column) + 1)])[np.array(column)]
        for variable, column in zip(variables, zip(*powers, strict=True), strict=True)
    ]
    return factors[0] * factors[1] * factors[2]


def _stresses_at(part: AbstractStressModel, state: Float[Array, "6"]) -> Array:
    """Compute the stress at the points of a flexure at a state; Pa."""
    displacement = Displacement.from_pose(state[:3])
    return part.surface_stresses(displacement, (state[3], state[4], state[5]))
