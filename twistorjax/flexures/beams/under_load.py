"""The deformed state of a beam under a load.

A cross-section moves and rotates as a rigid body; its strains are stretch, shear and
curvature. The equations are those of Reissner, On one-dimensional finite-strain beam
theory: the plane problem, ZAMP 23, 1972.
"""

from functools import partial
from typing import NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float
from typing_extensions import TypeAliasType

from ..._compile.compilation import fast_compile
from ..._utils.types import Count, NumberLike, Pose, Scalar, Wrench, WrenchLike
from ..._utils.validation import require_positive, require_row
from ...geometry import se2
from .beam import Beam, load_units, smallest_thickness, Uniform
from .cross_section import fiber_strains, section_of, section_rates


# Poses of the cross sections; rad, m, m
SectionPoses = TypeAliasType("SectionPoses", Float[Array, "sections 3"])
# Stresses at both edges of the cross sections; Pa
SectionStresses = TypeAliasType("SectionStresses", Float[Array, "sections 2"])


_INTERVALS = 32  # for the mean position of the center line, by the rule of Simpson
_SIMPSON = np.array([1.0, *_INTERVALS // 2 * (4.0, 2.0)])
_SIMPSON[-1] = 1.0

# The method of Dormand and Prince of order 8. Its last stage serves an error estimate.
_TABLEAU = dfx.Dopri8.tableau
_NODES = np.array([0.0, *_TABLEAU.c])[:-1]
_WEIGHTS = np.array(_TABLEAU.b_sol)[:-1]
_COEFFICIENTS = np.stack(
    [np.pad(row, (0, len(_NODES) - len(row))) for row in ([], *_TABLEAU.a_lower[:-1])]
)


class BeamSolution(eqx.Module):
    """The deformed state of a beam.

    Args:
        pose: Pose of frame b relative to frame a; rad, m, m.
        wrench: Wrench that body B exerts on the beam, about the displaced origin of frame
            b and in its axes; N m, N, N.
        energy: Stored energy; J.
        centerline: Poses of the cross-sections relative to frame a, from the first end of
            the beam to the second; rad, m, m.
        stress: Normal stress in the two outermost fibers of each cross-section, first on
            the side to which axis 2 points, then on the opposite side; Pa. It is signed:
            positive in tension and negative in compression. `largest_stress` returns its
            largest magnitude. For the law "saint-venant-kirchhoff" it is the second
            Piola-Kirchhoff stress.
    """

    pose: Pose
    wrench: Wrench
    energy: Scalar
    centerline: SectionPoses
    stress: SectionStresses


class ReferenceEnds(NamedTuple):
    """Poses of the two ends of the undeformed beam, in frame a; dimensionless."""

    first: Pose  # Pose of the first end; rad, -, -
    second: Pose  # Pose of the second end; rad, -, -


class SectionState(NamedTuple):
    """Position of a cross-section and energy of the beam up to it, dimensionless."""

    angle: Scalar
    x: Scalar
    y: Scalar
    energy: Scalar


def beam_under_load(
    beam: Beam, load: WrenchLike, sections: int | None = None
) -> BeamSolution:
    """Compute the deformed state of a beam under a load on body B. Body A is fixed.

    Args:
        beam: The beam.
        load: Wrench that body B exerts on the beam, about the origin of frame a and in
            the axes of frame a; N m, N, N.
        sections: Number of cross-sections of the result, including both ends. The default
            is 21 for a uniform thickness. Otherwise it is 201, because the stress changes
            rapidly along the beam.

    Returns:
        The deformed state. It is NaN if a cross-section cannot carry its bending moment:
        with the law "saint-venant-kirchhoff" the moment has a maximum of
        `0.7 E I / thickness`.

    Raises:
        ValueError: There are fewer than two sections, or the load is not finite.

    Source:
        The equations of Reissner (1972), integrated from one end to the other as an
        initial value problem.

    Example:
        >>> import twistorjax as tj
        >>> polymer = tj.Material(modulus=3.45e9, poisson=0.3)
        >>> beam = Beam(polymer, length=10e-3, thickness=1e-3, width=5e-3)
        >>> moment = beam.rotational_stiffness * 1.0  # bends the beam to an arc of 1 rad
        >>> solution = beam_under_load(beam, [moment, 0.0, 0.0])
        >>> solution.pose[0]
        Array(1., dtype=float64)
    """
    load = require_row("`load` of the beam", load, "(moment, force x, force y)")
    return state_under_load(beam, load, sections)


def state_under_load(beam: Beam, load: Wrench, sections: int | None) -> BeamSolution:
    """Compute the deformed state for a load (N m, N, N) that may be NaN.

    The state is then NaN; see `beam_under_load`.
    """
    if sections is None:
        sections = 21 if isinstance(beam.profile, Uniform) else 201
    if sections < 2:
        raise ValueError(f"`sections` is {sections!r}, but must be 2 or more.")
    return _solve(beam, load, sections)


@fast_compile
def _solve(beam: Beam, load: Wrench, sections: int) -> BeamSolution:
    """Compute the deformed state; see `beam_under_load`."""
    units = load_units(beam)
    parameters = jnp.asarray(np.linspace(-1.0, 1.0, sections))
    steps = -(-beam.steps // (sections - 1))
    ends = reference_ends(beam)
    states = _integrate(beam, load / units, ends.first, sections - 1, steps)
    length = beam.length
    # With the same steps as in `ExactBeam`, both have the same discretization error.
    end = end_section(beam, load / units, ends)
    pose, wrench = pose_and_wrench(beam, load, end, ends)
    return BeamSolution(
        pose=pose,
        wrench=wrench,
        energy=units[0] * end.energy,
        centerline=jnp.stack(
            [states.angle, length * states.x, length * states.y], axis=1
        ),
        stress=jax.vmap(partial(_stress, beam, load / units))(parameters, states),
    )


def largest_rotation(beam: Beam, stress: NumberLike) -> Scalar:
    """Compute the rotation by a pure moment at which a beam reaches a given stress.

    The stress is that of linear bending in the thinnest section, `6 M / (w t^2)`. Forces
    add to it; see `largest_stress`.

    Args:
        beam: A beam of any thickness profile.
        stress: Allowable stress of its material; Pa.

    Returns:
        The rotation; rad.

    Raises:
        ValueError: The stress is not positive.

    Example:
        >>> import twistorjax as tj
        >>> polymer = tj.Material(modulus=3.45e9, poisson=0.3)
        >>> beam = Beam(polymer, length=10e-3, thickness=1e-3, width=5e-3)
        >>> largest_rotation(beam, stress=40e6)  # 2 (length / thickness) (stress / E)
        Array(0.23188406, dtype=float64)
    """
    allowable = require_positive("`stress`", stress)
    moment = allowable * beam.width * smallest_thickness(beam) ** 2 / 6
    return beam_under_load(beam, jnp.stack([moment, 0 * moment, 0 * moment])).pose[0]


def reference_ends(beam: Beam) -> ReferenceEnds:
    """Compute the ends of the undeformed beam, whose middle is frame a; dimensionless."""
    half = jnp.stack([jnp.zeros(()), jnp.ones(()) / 2, jnp.zeros(())])
    if beam.curvature is None:
        return ReferenceEnds(-half, half)
    # The first end is at the inverse of the pose of the middle relative to it.
    no_load = jnp.zeros(3)
    steps = -(-beam.steps // 2)
    states = _integrate(beam, no_load, jnp.zeros(3), 2, steps)
    middle = jnp.stack([states.angle[1], states.x[1], states.y[1]])
    first = se2.inverse(middle)
    # The second end has the same discretization error as that of the loaded beam.
    end = _last(_integrate(beam, no_load, first, 1, beam.steps))
    return ReferenceEnds(first, jnp.stack([end.angle, end.x, end.y]))


@jax.jit
def ends_and_centroid(beam: Beam) -> tuple[Float[Array, "2 2"], Float[Array, "2"]]:
    """Compute the ends of an undeformed curved beam, and the mean of its center line; m.

    The positions are in the frame of the beam.
    """
    ends = reference_ends(beam)
    steps = -(-beam.steps // _INTERVALS)
    states = _integrate(beam, jnp.zeros(3), ends.first, _INTERVALS, steps)
    parameters = jnp.asarray(np.linspace(-1.0, 1.0, _INTERVALS + 1))
    _, rates = jax.vmap(position_of)(parameters)
    weights = jnp.asarray(_SIMPSON) * rates
    centroid = jnp.stack([states.x, states.y]) @ weights / jnp.sum(weights)
    positions = jnp.stack([ends.first[1:], ends.second[1:]])
    return beam.length * positions, beam.length * centroid


def end_section(
    beam: Beam, load: Wrench, ends: ReferenceEnds, steps: Count | int | None = None
) -> SectionState:
    """Compute the dimensionless state of the second end of a beam under a load.

    The load is about the origin of frame a and in its axes, over `load_units`. The
    default of `steps` is `beam.steps`. There are no derivatives in reverse mode if the
    number of steps is traced.
    """
    steps = beam.steps if steps is None else steps
    return _last(_integrate(beam, load, ends.first, 1, steps))


def pose_and_wrench(
    beam: Beam, load: Wrench, end: SectionState, ends: ReferenceEnds
) -> tuple[Pose, Wrench]:
    """Compute the pose of frame b, and the wrench that body B exerts on the beam.

    The wrench is about the displaced origin of frame b and in its axes. The load (N m, N,
    N) is about the origin of frame a and in its axes. `end` is the state of the second
    end, dimensionless.
    """
    length = beam.length
    angle = end.angle - ends.second[0]
    to_end = length * ends.second[1:]
    origin = length * jnp.stack([end.x, end.y]) - se2.rotate(angle, to_end)
    moment = load[0] - se2.cross(origin, load[1:])
    force = se2.rotate(-angle, load[1:])
    return (
        jnp.concatenate([angle[None], origin]),
        jnp.concatenate([moment[None], force]),
    )


def _last(states: SectionState) -> SectionState:
    return jax.tree.map(lambda values: values[-1], states)


def position_of(parameter: Scalar) -> tuple[Scalar, Scalar]:
    """Map the parameter of integration to the position along the axis over the length.

    The parameter is from -1 to 1. The positions, from -1/2 to 1/2, are denser at the
    ends, where the outline of a notch is steep. The derivative is returned as well.
    """
    half = jnp.pi / 2
    return jnp.sin(half * parameter) / 2, half * jnp.cos(half * parameter) / 2


def _integrate(
    beam: Beam, load: Wrench, start: Pose, intervals: int, steps: Count | int
) -> SectionState:
    """Integrate the equations of a beam from the pose of its first end, dimensionless.

    The steps are those of the method of Dormand and Prince of order 8. Its stages are a
    loop, so the equations are compiled once; with `diffrax.Dopri8` they are compiled for
    each stage, and an equilibrium with an `ExactBeam` takes several times as long to
    compile.

    The states at the ends of equal intervals of the parameter are returned, one more than
    their number. Each interval has the given number of steps.
    """
    step = 2.0 / (intervals * steps)
    coefficients, nodes = jnp.asarray(_COEFFICIENTS), jnp.asarray(_NODES)

    def derivative(parameter: Scalar, state: Float[Array, "4"]) -> Float[Array, "4"]:
        position, rate = position_of(parameter)
        section = section_of(beam, position)
        pose_rates, density, _ = section_rates(section, beam.law, load, state[:3])
        return rate * jnp.append(pose_rates, density)

    def advance(state: Array, start: Scalar) -> Array:
        def stage(index: Array, slopes: Array) -> Array:
            change = jnp.sum(coefficients[index][:, None] * slopes, axis=0)
            slope = derivative(start + step * nodes[index], state + step * change)
            return slopes.at[index].set(slope)

        slopes = lax.fori_loop(0, len(_NODES), stage, jnp.zeros((len(_NODES), 4)))
        weights = jnp.asarray(_WEIGHTS)[:, None]
        return state + step * jnp.sum(weights * slopes, axis=0)

    def interval(state: Array, start: Scalar) -> tuple[Array, Array]:
        state = lax.fori_loop(
            0, steps, lambda k, state: advance(state, start + step * k), state
        )
        return state, state

    zero = jnp.zeros_like(load[0])
    first = jnp.stack([zero + start[0], zero + start[1], zero + start[2], zero])
    starts = jnp.asarray(np.arange(intervals) * (2.0 / intervals) - 1.0)
    _, states = lax.scan(interval, first, starts)
    states = jnp.concatenate([first[None], states])
    return SectionState(*states.T)


def _stress(
    beam: Beam, load: Wrench, parameter: Scalar, state: SectionState
) -> Float[Array, "2"]:
    """Compute the signed stress of the two outermost fibers of a cross-section; Pa."""
    section = section_of(beam, position_of(parameter)[0])
    _, _, strains = section_rates(section, beam.law, load, state[:3])
    return beam.material.modulus * fiber_strains(section, beam.law, strains)
