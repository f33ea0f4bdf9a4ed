"""Stiffness of a beam out of its plane, about its deformed planar state."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import legendre

from ..._compile.compilation import fast_compile
from ..._utils.types import Matrix, Scalar
from .beam import Beam, is_uniform, values_along
from .under_load import beam_under_load, BeamSolution


# Positions along the axis from -1 to 1, and weights of the quadrature of Gauss
_NODES, _WEIGHTS = legendre.leggauss(200)
_TWISTS = 64  # polynomials by which the twist rate of a beam is approximated
_TERMS = 10  # of the series of the torsion constant, after which they are below 1e-13
# Sum of 1 / m^5 over all odd numbers m
_ODD_SUM = 1.004523762795139616
_DEGREE = 9  # of the polynomials between the cross-sections of a solution


def out_of_plane_stiffness(
    beam: Beam, solution: BeamSolution | None = None, *, warping: bool | None = None
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
    cross-sections of a short, wide leaf.

    Args:
        beam: The beam.
        solution: Its deformed state, from `beam_under_load` or `beam_at_pose`; by default
            the undeformed one.
        warping: Whether the ends cannot warp. By default they cannot if the thickness is
            uniform. The warping stiffness is that of a thin rectangle, which a notch is
            not.

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
    if solution is None:
        solution = beam_under_load(beam, [0.0, 0.0, 0.0])
    if warping is None:
        warping = is_uniform(beam)
    thickness = values_along(beam.profile, beam.length / 2 * _NODES)
    return _stiffness(beam, solution, thickness, warping)


@fast_compile
def _stiffness(
    beam: Beam, solution: BeamSolution, thickness: Float[Array, "200"], warping: bool
) -> Matrix:
    """Compute the stiffness for the thickness at the nodes of the quadrature (m)."""
    modulus, shear_modulus = beam.material.modulus, beam.material.shear_modulus
    weights = beam.length / 2 * _WEIGHTS
    angle, x, y = (_between(len(solution.centerline)) @ solution.centerline).T
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    # Columns: moments in frame a for a unit force and unit moments on frame b
    ones = jnp.ones_like(x)
    b_cos, b_sin = jnp.cos(solution.pose[0]), jnp.sin(solution.pose[0])
    moment_x = jnp.stack([solution.pose[2] - y, b_cos * ones, -b_sin * ones], axis=1)
    moment_y = jnp.stack([x - solution.pose[1], b_sin * ones, b_cos * ones], axis=1)
    torque = cos[:, None] * moment_x + sin[:, None] * moment_y
    bending = cos[:, None] * moment_y - sin[:, None] * moment_x

    poisson = beam.material.poisson
    shear_factor = 10 * (1 + poisson) / (12 + 11 * poisson)
    area, torsion = thickness * beam.width, torsion_constant(thickness, beam.width)
    by_bending = weights / (modulus * thickness * beam.width**3 / 12)
    by_shear = jnp.sum(weights / (shear_factor * shear_modulus * area))
    compliance = bending.T @ (by_bending[:, None] * bending)
    compliance = compliance.at[0, 0].add(by_shear)
    if not warping:
        by_torsion = weights / (shear_modulus * torsion)
        return jnp.linalg.inv(compliance + torque.T @ (by_torsion[:, None] * torque))
    # The twist rate is zero at both ends; its polynomials minimize the potential energy.
    values, slopes = _twist_rates()
    sectorial = (thickness * beam.width) ** 3 / 144
    twisting = weights * shear_modulus * torsion
    restraint = weights * modulus * sectorial * (2 / beam.length) ** 2
    matrix = values @ (twisting[:, None] * values.T)
    matrix = matrix + slopes @ (restraint[:, None] * slopes.T)
    work = values @ (weights[:, None] * torque)
    lower = jnp.linalg.cholesky(matrix)
    strains = jax.scipy.linalg.solve_triangular(lower, work, lower=True)
    return jnp.linalg.inv(compliance + strains.T @ strains)


def torsion_constant(
    thickness: Float[Array, "*sections"], width: Scalar
) -> Float[Array, "*sections"]:
    """Compute the torsion constant of rectangles, by its series; m^4."""
    short, long = jnp.minimum(thickness, width), jnp.maximum(thickness, width)
    odd = 2.0 * np.arange(_TERMS) + 1
    decay = jnp.exp(-np.pi * (long / short)[..., None] * odd[None])
    # tanh(u) = 1 - 2 exp(-2 u) / (1 + exp(-2 u))
    rest = jnp.sum(2 * decay / (1 + decay) / odd[None] ** 5, axis=-1)
    factor = 1 - 192 / np.pi**5 * short / long * (_ODD_SUM - rest)
    return long * short**3 / 3 * factor


def _between(sections: int) -> Float[np.ndarray, "200 sections"]:
    """Return the matrix that interpolates values at the sections of a solution.

    Their positions are sines of equally spaced angles. Polynomials of the angle through
    the nearest sections are used.
    """
    degree = min(_DEGREE, sections - 1)
    at = (np.arcsin(_NODES) / np.pi + 0.5) * (sections - 1)
    first = np.clip(np.round(at - degree / 2).astype(int), 0, sections - 1 - degree)
    local, points = at - first, np.arange(degree + 1)
    matrix = np.zeros((len(_NODES), sections))
    for k in points:
        others = points[points != k]
        share = np.prod((local[:, None] - others) / (k - others), axis=1)
        matrix[np.arange(len(_NODES)), first + k] = share
    return matrix


def _twist_rates() -> tuple[np.ndarray, np.ndarray]:
    """Return polynomials at the nodes that are zero at -1 and 1, and their slopes."""
    vander = legendre.legvander(_NODES, _TWISTS + 1)
    scale = 1 / np.sqrt(4 * np.arange(1, _TWISTS + 1) + 2)[:, None]
    slopes = vander[:, 1:-1] * (2 * np.arange(1, _TWISTS + 1) + 1)
    return scale * (vander[:, 2:] - vander[:, :-2]).T, scale * slopes.T
