"""Stiffness of a beam out of its plane, about its deformed planar state."""

from functools import partial

import jax

from ..._compile.compilation import fast_compile
from ..._utils.types import Matrix
from ..._utils.validation import require_float64
from ...energies.sections import (
    out_of_plane_stiffness as stiffness_of_sections,
    seen_from,
)
from ...geometry import se2
from ...geometry.twistors import Displacement
from .beam import Beam
from .stress_models import BeamStress
from .under_load import beam_under_load, BeamSolution


def out_of_plane_stiffness(
    beam: Beam, solution: BeamSolution | None = None, *, warping: bool = True
) -> Matrix:
    """Compute the stiffness of a beam against small displacements out of its plane.

    A beam whose plate is symmetric about its middle plane has no other coupling with the
    planar displacements than their size: the compliance is an integral over the bent
    center line, of shear, of bending about the in-plane normal of each cross-section, and
    of its torsion. The bent beam is much softer, because a force out of the plane twists
    it.

    Torsion warps a thin cross-section. Between two thick bodies, the ends of a leaf
    cannot warp, which stiffens it. Solid finite elements of a leaf between parallel
    bodies, at a stroke of 10 % of its length, are 9 % stiffer than this theory if the
    leaf is half as wide as long, and 0.2 % if it is a tenth as wide; without the
    restraint of warping, they would be 3.6 times and 17 % stiffer. The theory has neither
    the stress in the deformed beam, so no lateral buckling, nor the deformation of the
    cross-sections of a short, wide leaf. At a stroke s of a guide of length L, the stress
    makes it stiffer by about `0.43 (s / L)^2`.

    Args:
        beam: The beam. If its thickness is a function, it should be smooth. The profile
            of a leaf with a reinforced middle is integrated part by part.
        solution: Its deformed state, from `beam_under_load` or `beam_at_pose`; by default
            the undeformed one.
        warping: Whether the ends cannot warp. The restraint is the bending of the fibers
            of thin cross-sections, which is most of the torsional stiffness of a notch
            that is wider than long, and up to 25 % too large for it; see the manual.

    Returns:
        The forces on frame b, about its displaced origin and in its displaced axes, for
        unit displacements: force along z, moments about axes 1 and 2, for z and the
        rotations about axes 1 and 2; N/m, N/rad, N m/m, N m/rad.

    Source:
        Timoshenko and Goodier, Theory of Elasticity, 1970, section 109: torsion of a
        rectangle. Vlasov, Thin-Walled Elastic Beams, 1961: warping. Cowper, The shear
        coefficient in Timoshenko's beam theory, Journal of Applied Mechanics 33, 1966.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3)
        >>> leaf = Beam(steel, length=0.1, thickness=0.5e-3, width=0.01)
        >>> def support(travel):  # stiffness along z if frame b does not tilt
        ...     pose = [0.0, -6.02e-3 * travel, 0.1 * travel]
        ...     bent = tj.flexures.beam_at_pose(leaf, pose)
        ...     return out_of_plane_stiffness(leaf, bent)[0, 0].round(-2)
        >>> support(0.0), support(0.1)  # N/m
        (Array(101900., dtype=float64), Array(56400., dtype=float64))
    """
    require_float64(beam.length)
    if solution is None:
        solution = beam_under_load(beam, [0.0, 0.0, 0.0])
    return _stiffness(BeamStress.of(beam), solution, warping)


@fast_compile
def _stiffness(model: BeamStress, solution: BeamSolution, warping: bool) -> Matrix:
    """Compute the stiffness in frame b of the cross-sections of a stress model."""
    displacement = Displacement.from_pose(solution.pose)
    to_second = se2.between(solution.pose / 2, solution.pose)
    wrench = se2.transform_wrench(to_second, solution.wrench)
    sections = model.sections(displacement, (wrench[0], wrench[1], wrench[2]))
    poses = jax.vmap(partial(seen_from, to_second))(sections.poses)
    return stiffness_of_sections(sections._replace(poses=poses), warping)
