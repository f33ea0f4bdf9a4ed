"""Flexures of any outline as exact planar beams: large turns, stretch and shear.

A section of the beam turns and moves as a rigid body; its strains are stretch, shear and
curvature (Reissner). What is needed of the geometry is the thickness along the axis, so a
leaf, a notch and a filleted hinge are one thing.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Literal, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .._utils.types import Pose, Scalar, Wrench
from .._utils.validation import require_choice, require_kind, require_positive
from ..geometry import se2
from .material import Material


Law = Literal["linear", "saint-venant-kirchhoff"]


class Beam(eqx.Module):
    """A straight flexure, by its thickness along the axis.

    Args:
        material: of the plate.
        length: along axis 1, free of its clamps; m.
        thickness: in the plane, across; or a function that gives it at a place along the
            axis, from -length / 2 to length / 2, as `notch_profile` makes one; m.
        width: out of the plane: the plate's own thickness; m.
        law: "linear" for forces that are linear in a section's strains;
            "saint-venant-kirchhoff" for a material whose stress is linear in Green's
            strain, as finite elements for large displacements take it. Of a leaf of ten
            thicknesses that turns to 46 degrees they differ by some 10 % of the wrench.
        shear_factor: the part of the section that bears shear, or nothing for a beam
            that does not shear.
        steps: of the integration along it. Sixteen give ten digits for a leaf; take more
            for necks that are short against their length.

    Raises:
        ValueError: a dimension is not positive.

    Example:
        >>> soft = Material(modulus=3.45e9, poisson=0.3)
        >>> Beam(soft, length=10e-3, thickness=1e-3, width=5e-3).bending
        Array(0.14375, dtype=float64)
    """

    material: Material
    length: Scalar
    profile: Callable[[Scalar], Scalar]
    width: Scalar
    shear_factor: Scalar | None
    law: Law = eqx.field(static=True)
    steps: int = eqx.field(static=True)

    def __init__(
        self,
        material: Material,
        *,
        length: ArrayLike,
        thickness: ArrayLike | Callable[[Scalar], Scalar],
        width: ArrayLike,
        law: Law = "linear",
        shear_factor: ArrayLike | None = 5 / 6,
        steps: int = 16,
    ):
        require_kind("material", [material], Material)
        self.material = material
        self.length, self.width = (
            require_positive("`length`", length),
            require_positive("`width`", width),
        )
        self.law = require_choice("`law`", law, ("linear", "saint-venant-kirchhoff"))
        self.shear_factor = None
        if shear_factor is None and law != "linear":
            raise ValueError(
                f"`shear_factor` is None, but the law {law!r} has shear in its strain: "
                'give a factor, or take the law "linear".'
            )
        if shear_factor is not None:
            self.shear_factor = require_positive("`shear_factor`", shear_factor)
        if steps < 1:
            raise ValueError(f"`steps` is {steps!r}, but must be at least 1.")
        self.steps = steps
        if callable(thickness):
            kept = isinstance(thickness, jax.tree_util.Partial)
            self.profile = thickness if kept else jax.tree_util.Partial(thickness)
        else:
            thickness = require_positive("`thickness`", thickness)
            self.profile = jax.tree_util.Partial(uniform, thickness)

    @property
    def bending(self) -> Scalar:
        """Bending stiffness over the length, E I / L, of its middle section; N m/rad."""
        height = self.profile(jnp.zeros(()))
        modulus = self.material.modulus
        return modulus * self.width * height**3 / (12 * self.length)


def uniform(thickness: Scalar, place: Scalar) -> Scalar:
    """One thickness everywhere."""
    del place
    return thickness


class BeamSolution(eqx.Module):
    """What a load makes of a beam.

    Args:
        pose: of frame b, seen from frame a; rad, m, m.
        wrench: that body B exerts on it: about the displaced origin of b, in its axes;
            N m, N, N.
        energy: stored; J.
        line: poses of its sections, from its first end to its last, in frame a;
            rad, m, m.
        stress: along the axis, in the outermost fibres: on the side that axis 2 points
            to, and on the other; Pa.
    """

    pose: Pose
    wrench: Wrench
    energy: Scalar
    line: Float[Array, "places 3"]
    stress: Float[Array, "places 2"]


class State(NamedTuple):
    """A section of a beam: where it is, and what is stored up to it; in its units."""

    angle: Scalar
    x: Scalar
    y: Scalar
    energy: Scalar


def beam_under_load(beam: Beam, load: Wrench, places: int = 21) -> BeamSolution:
    """A beam under a load at its end, body A being held.

    Args:
        beam: with its frames at the middle, axis 1 along it.
        load: the wrench that body B exerts on it, about the origin of frame a and in its
            axes, where it keeps its direction; N m, N, N.
        places: how many sections are told, the ends among them.

    Returns:
        What the load makes of it. NaN where a section of the law
        "saint-venant-kirchhoff" cannot bear it: that gives way beyond a moment of
        `0.7 E I / thickness`.

    Source:
        Reissner, On one-dimensional finite-strain beam theory: the plane problem, ZAMP
        23, 1972, integrated from one end as an initial value problem.

    Example:
        >>> soft = Material(modulus=3.45e9, poisson=0.3)
        >>> leaf = Beam(soft, length=10e-3, thickness=1e-3, width=5e-3)
        >>> beam_under_load(leaf, jnp.array([0.14375, 0.0, 0.0])).pose[0]  # bent to a circle
        Array(1., dtype=float64)
    """
    units = units_of(beam)
    parts = jnp.asarray(np.linspace(-1.0, 1.0, places))
    states = integrated(beam, load / units, dfx.SaveAt(ts=parts))
    length = beam.length
    pose, wrench = end_of(beam, load, last_of(states))
    return BeamSolution(
        pose=pose,
        wrench=wrench,
        energy=units[0] * states.energy[-1],
        line=jnp.stack([states.angle, length * states.x, length * states.y], axis=1),
        stress=jax.vmap(partial(_stress, beam, load / units))(parts, states),
    )


def largest_rotation(beam: Beam, stress: ArrayLike) -> Scalar:
    """The turn by a moment alone at which the thinnest section bears a stress.

    Args:
        beam: of any outline.
        stress: that its material is allowed to bear; Pa.

    Returns:
        The turn; rad. What forces besides the moment add is told by `beam_under_load`.

    Raises:
        ValueError: the stress is not positive.

    Example:
        >>> soft = Material(modulus=3.45e9, poisson=0.3)
        >>> leaf = Beam(soft, length=10e-3, thickness=1e-3, width=5e-3)
        >>> largest_rotation(leaf, 40e6)  # 2 L / t of the strain
        Array(0.23188406, dtype=float64)
    """
    allowed = require_positive("`stress`", stress)
    places = beam.length * jnp.asarray(np.linspace(-0.5, 0.5, 201))
    thinnest = jnp.min(jax.vmap(beam.profile)(places))
    moment = allowed * beam.width * thinnest**2 / 6
    return beam_under_load(beam, jnp.stack([moment, 0 * moment, 0 * moment])).pose[0]


def last_of(states: State) -> State:
    """The last of those that were kept."""
    return jax.tree.map(lambda values: values[-1], states)


def last_section(beam: Beam, load: Wrench) -> State:
    """Where a load, in units of the beam, brings its last section."""
    return last_of(integrated(beam, load, dfx.SaveAt(t1=True)))


def units_of(beam: Beam) -> Float[Array, "3"]:
    """E I / L and E I / L^2 of the middle section."""
    moment = beam.bending
    return jnp.stack([moment, moment / beam.length, moment / beam.length])


def end_of(beam: Beam, load: Wrench, end: State) -> tuple[Pose, Wrench]:
    """The pose of frame b, and the wrench on it."""
    length = beam.length
    back = jnp.stack([length / 2, jnp.zeros(())])
    place = length * jnp.stack([end.x, end.y]) - se2._turn(end.angle, back)
    moment = load[0] - se2._cross(place, load[1:])
    force = se2._turn(-end.angle, load[1:])
    return (
        jnp.concatenate([end.angle[None], place]),
        jnp.concatenate([moment[None], force]),
    )


def _along(part: Scalar) -> tuple[Scalar, Scalar]:
    """A place from -1/2 to 1/2 and its rate, for parts from -1 to 1.

    Places crowd at the ends, where the outline of a notch is steep.
    """
    half = jnp.pi / 2
    return jnp.sin(half * part) / 2, half * jnp.cos(half * part) / 2


def _section(beam: Beam, load: Wrench, part: Scalar, state: State):
    """Strains of a section, and what it stores."""
    place, _ = _along(part)
    moment = load[0] - (state.x * load[2] - state.y * load[1])
    cos, sin = jnp.cos(state.angle), jnp.sin(state.angle)
    axial, shear = cos * load[1] + sin * load[2], cos * load[2] - sin * load[1]
    return (cos, sin), *_strains(beam, place, (axial, shear, moment))


def integrated(beam: Beam, load: Wrench, saveat: dfx.SaveAt) -> State:
    """The beam's line in units of its length."""

    def field(part: Any, state: State, given: tuple[Beam, Wrench]) -> State:
        _, rate = _along(part)
        (cos, sin), (stretch, shear, curvature), stored = _section(*given, part, state)
        return State(
            rate * curvature,
            rate * (cos * (1 + stretch) - sin * shear),
            rate * (sin * (1 + stretch) + cos * shear),
            rate * stored,
        )

    zero = jnp.zeros_like(load[0])
    solution = dfx.diffeqsolve(
        dfx.ODETerm(field),
        dfx.Dopri8(),
        -1.0,
        1.0,
        2.0 / beam.steps,
        State(zero, zero - 0.5, zero, zero),
        args=(beam, load),
        saveat=saveat,
        stepsize_controller=dfx.ConstantStepSize(),
        adjoint=dfx.DirectAdjoint(),
        max_steps=beam.steps + 1,
        throw=False,
    )
    assert solution.ys is not None
    return solution.ys


def _stress(beam: Beam, load: Wrench, part: Scalar, state: State) -> Float[Array, "2"]:
    _, (stretch, slip, curvature), _ = _section(beam, load, part, state)
    place, _ = _along(part)
    half_height = beam.profile(place * beam.length) / beam.length / 2
    strain = stretch + jnp.stack([-half_height, half_height]) * curvature
    if beam.law == "saint-venant-kirchhoff":
        strain = strain + (strain**2 + slip**2) / 2
    return beam.material.modulus * strain


def _strains(
    beam: Beam, place: Scalar, forces: tuple[Scalar, Scalar, Scalar]
) -> tuple[tuple[Scalar, Scalar, Scalar], Scalar]:
    """Stretch, shear and curvature of a section under its forces, and what it stores."""
    axial, shear, moment = forces
    middle = beam.profile(jnp.zeros(()))
    height = beam.profile(place * beam.length) / middle
    slender = middle / beam.length
    stiff = 12 / slender**2
    material = beam.material
    along, turning = stiff * height, height**3
    across = jnp.full_like(along, jnp.inf)
    if beam.shear_factor is not None:
        across = along * beam.shear_factor * material.shear_modulus / material.modulus
    linear = axial / along, shear / across, moment / turning
    if beam.law == "linear":
        stored = (axial * linear[0] + shear * linear[1] + moment * linear[2]) / 2
        return linear, stored

    # The square of Green's strain, integrated over the section. Written out, with both
    # derivatives: by JAX they take a minute to compile.
    far = 0.0375 * slender**2 * height**5

    def green(stretch: Scalar, slip: Scalar) -> tuple[Scalar, Scalar]:
        strain = stretch + (stretch**2 + slip**2) / 2
        return strain, (1 + stretch) ** 2 + strain

    def nearer(_, strains: tuple[Scalar, Scalar, Scalar]):
        stretch, slip, curvature = strains
        strain, longer = green(stretch, slip)
        bent, stretched = turning * curvature**2, 1 + stretch
        gaps = (
            axial - (along * strain + 1.5 * bent) * stretched,
            shear - (along * strain + across + bent / 2) * slip,
            moment - (turning * longer + 2 * far * curvature**2) * curvature,
        )
        a = along * longer + 1.5 * bent
        b = along * (slip**2 + strain) + across + bent / 2
        c = turning * longer + 6 * far * curvature**2
        d = along * slip * stretched
        e = 3 * turning * curvature * stretched
        f = turning * curvature * slip
        steps = _symmetric((a, b, c, d, e, f), gaps)
        return stretch + steps[0], slip + steps[1], curvature + steps[2]

    before = jax.lax.fori_loop(0, 6, nearer, linear)
    stretch, slip, curvature = strains = nearer(6, before)
    # Beyond some moment the section gives way, and there are no strains that bear it
    moved = [jnp.abs(new - old) for new, old in zip(strains, before, strict=True)]
    settled = moved[0] + moved[1] + slender * moved[2] < 1e-8
    strain, longer = green(stretch, slip)
    stored = along * strain**2 + across * slip**2 + turning * longer * curvature**2
    stored = jnp.where(settled, (stored + far * curvature**4) / 2, jnp.nan)
    return (stretch, slip, jnp.where(settled, curvature, jnp.nan)), stored


def _symmetric(
    matrix: tuple[Scalar, ...], right: tuple[Scalar, Scalar, Scalar]
) -> tuple[Scalar, Scalar, Scalar]:
    """Solves for three unknowns by cofactors; the matrix as (11, 22, 33, 12, 13, 23)."""
    a, b, c, d, e, f = matrix
    x, y, z = right
    aa, bb, cc = b * c - f * f, a * c - e * e, a * b - d * d
    dd, ee, ff = e * f - c * d, d * f - b * e, d * e - a * f
    whole = a * aa + d * dd + e * ee
    return (
        (aa * x + dd * y + ee * z) / whole,
        (dd * x + bb * y + ff * z) / whole,
        (ee * x + ff * y + cc * z) / whole,
    )
