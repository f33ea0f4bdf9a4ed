"""How one hinge pulls on its two bodies, at rest and in motion.

The energy and the dissipation are differentiated by JAX in the hinge's own three
coordinates. How these follow from the six of its bodies is written out here: by JAX it
takes twice the time to compile and 1.5 to 2 times the time to run a sweep of stages.
"""

from collections.abc import Callable, Sequence
from typing import Any, cast, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Inexact

from .._utils.types import Scalar
from ..energies.base import AbstractEnergy
from ..energies.damping import ViscousDamping
from ..energies.strains import half_square, strain
from ..geometry.twistors import Displacement, half_turn
from .hinge_kinematics import (
    combined,
    End,
    HingeKinematics,
    mid_frame,
    Six,
    SixBySix,
    Three,
    Two,
)


@jax.jit
def forces(
    energy: AbstractEnergy, first: End, second: End, axis: tuple[Scalar, Scalar]
) -> Six:
    """Derivative of a hinge's energy by the displacements of body A and of body B."""
    grip = HingeKinematics.of(first, second, axis)
    slope, _ = _slopes(energy, grip.half.displacement)
    return _pull(grip, slope)


@jax.jit
def tension(
    energy: AbstractEnergy,
    first: End,
    second: End,
    axis: tuple[Scalar, Scalar],
    borne: Three | None = None,
) -> Three:
    """What the hinge bears: its energy's slopes by the energy's own coordinates.

    `borne` is that which was foreseen, as for the `tangent`.
    """
    half = mid_frame(first, second, axis)
    (g0, g1, g2), _ = _slopes(_foreseen(energy, borne), half.displacement)
    longer, growth, _ = _stretch(energy, half.displacement)
    s1, s2 = g1 / longer, g2 / longer
    y1, y2 = 2 * half.displacement.x1, 2 * half.displacement.x2
    return g0 - growth * (y1 * s1 + y2 * s2), s1, s2


@jax.jit
def tangent(
    energy: AbstractEnergy,
    first: End,
    second: End,
    axis: tuple[Scalar, Scalar],
    borne: Three | None = None,
) -> tuple[Six, SixBySix, Scalar]:
    """The `forces`, their derivatives by the same six displacements, and their work.

    The work is a measure of the energy at play, never negative: sizes of slopes times
    sizes of what they are slopes by.

    Args:
        energy: of the hinge.
        first: its end on body A.
        second: its end on body B.
        axis: cosine and sine of its angle at rest.
        borne: the `tension` with which it stiffens as it turns, by default its own.
            Newton's method foresees it from its last step, and is then as fast for stiff
            hinges as for soft ones (Magisano, Leonetti and Garcea, Int. J. Num. Meth.
            Eng. 109, 2017).
    """
    grip = HingeKinematics.of(first, second, axis)
    displacement = grip.half.displacement
    slopes, push = _slopes(_foreseen(energy, borne), displacement)
    g0, g1, g2 = own = slopes
    one, zero = jnp.ones_like(g0), jnp.zeros_like(g0)
    (h00, h01, h02), (_, h11, h12), (_, _, h22) = (
        push(one, zero, zero),
        push(zero, one, zero),
        push(zero, zero, one),
    )
    y1, y2 = 2 * displacement.x1, 2 * displacement.x2
    work = jnp.abs(g0 * displacement.angle) + jnp.abs(g1 * y1) + jnp.abs(g2 * y2)
    if borne is not None:
        # The slopes, and what the bend of the energy's own coordinates adds to the second
        # derivatives, by the tension foreseen instead of by that which it has.
        longer, growth, bend = _stretch(energy, displacement)
        b0, b1, b2 = borne
        over1, over2 = b1 - g1 / longer, b2 - g2 / longer
        h00 = h00 + bend * (y1 * over1 + y2 * over2)
        h01, h02 = h01 + growth * over1, h02 + growth * over2
        slopes = b0 + growth * (y1 * b1 + y2 * b2), longer * b1, longer * b2
    curvature = (h00, h01, h02), (h01, h11, h12), (h02, h12, h22)
    columns = grip.columns()
    pushed = [combined(curvature, column) for column in columns]
    matrix = _spread(columns, pushed, grip.bend(slopes), symmetric=True)
    return _pull(grip, own), matrix, work


@jax.jit
def forces_in_motion(
    energy: AbstractEnergy,
    damping: ViscousDamping | None,
    first: End,
    second: End,
    axis: tuple[Scalar, Scalar],
    rates: tuple[Three, Three],
    stretch: Two | None = None,
) -> tuple[Six, Two, Scalar]:
    """What resists motion: elastic and viscous forces, and the power dissipated.

    Args:
        energy: of the hinge.
        damping: of the hinge, if any.
        first: its end on body A.
        second: its end on body B.
        axis: cosine and sine of its angle at rest.
        rates: of (angle, x, y) of both bodies; rad/s, m/s, m/s.
        stretch: the translation that it is taken to bear, by default its own: a solver
            may foresee it, as Newton's method does the tension in `tangent`; m.

    Returns:
        The forces; how much its own translation exceeds the `stretch`; the power.
    """
    grip = HingeKinematics.of(first, second, axis)
    at, excess = _borne(grip.half.displacement, stretch)
    slope, _ = _slopes(energy, at)
    moving = grip.rates(*rates)
    drag = (
        None if damping is None else _drag(energy, damping, at, _coordinates(at), moving)
    )
    if drag is None:
        return _pull(grip, slope), excess, jnp.zeros_like(slope[0])
    return _pull(grip, _sum(slope, drag)), excess, _dot(drag, moving)


class Tangent(NamedTuple):
    """How a hinge's forces follow its bodies, among their six displacements.

    Args:
        stiffness: by displacements, the stretch following them. Not symmetric where a
            damped hinge moves: how it drags depends on how far it has turned.
        damping: by their rates.
        stretching: of the half-way translation, by displacements.
        bearing: of the forces, by the half-way translation.
    """

    stiffness: Float[Array, "6 6"]
    damping: Float[Array, "6 6"]
    stretching: Float[Array, "2 6"]
    bearing: Float[Array, "2 6"]


@jax.jit
def tangent_in_motion(
    energy: AbstractEnergy,
    damping: ViscousDamping | None,
    first: End,
    second: End,
    axis: tuple[Scalar, Scalar],
    rates: tuple[Three, Three],
    stretch: Two | None = None,
) -> Tangent:
    """Derivatives of `forces_in_motion`, of the same arguments.

    In arrays, where the `tangent` is in scalars: that is run by the thousand and takes a
    fifth less time so, while this is compiled with every motion, in half the time.
    """
    grip = HingeKinematics.of(first, second, axis)
    at, _ = _borne(grip.half.displacement, stretch)
    columns = jnp.stack([jnp.stack(column) for column in grip.columns()])
    slope, push = _slopes(energy, at)
    by_place = jnp.stack(jax.vmap(push)(*jnp.eye(3)), axis=1)
    pushed, dragged = product(columns, by_place), None
    if damping is not None:
        moving = grip.rates(*rates)
        drag, drag_push = jax.linearize(
            lambda place, rates: _drag(energy, damping, at, place, rates, at),
            _coordinates(at),
            moving,
        )
        place, rate = jnp.split(jnp.eye(6), 2, axis=1)
        slopes = jnp.stack(jax.vmap(drag_push)(tuple(place.T), tuple(rate.T)), axis=1)
        by_place = by_place + slopes[:3]
        turning = grip.turning(moving, (rates[0][0] + rates[1][0]) / 2)
        turned = jnp.stack([jnp.stack(column) for column in turning])
        pushed = product(columns, by_place) + product(turned, slopes[3:])
        dragged = product(columns, slopes[3:])
        slope = _sum(slope, drag)
    bend = jnp.stack([jnp.stack(row) for row in grip.bend(slope)])
    spread = product(jnp.asarray(_MOTIONS), columns)

    def among(pushed: Array) -> Float[Array, "6 6"]:
        return product(spread, product(jnp.asarray(_MOTIONS), pushed).T)

    around = product(product(jnp.asarray(_MOTIONS), bend), jnp.asarray(_MOTIONS.T))
    return Tangent(
        stiffness=among(pushed) + around,
        damping=jnp.zeros((6, 6)) if dragged is None else among(dragged),
        stretching=spread[:, 1:].T,
        bearing=product(by_place[1:], spread.T),
    )


class Factored(NamedTuple):
    """The stiffness of a hinge, `rows.T diag(weights) rows + reference`.

    Args:
        rows: three combinations of its six displacements.
        weights: stiffness against each of them; N m/rad, N/m.
        reference: what the force that the hinge bears adds as it turns, and what of the
            stiffness is not positive.
    """

    rows: Float[Array, "3 6"]
    weights: Float[Array, "3"]
    reference: Float[Array, "6 6"]


@jax.jit
def factored(
    energy: AbstractEnergy, first: End, second: End, axis: tuple[Scalar, Scalar]
) -> Factored:
    """The stiffness of the `tangent` in factors: in a sum, small parts would be lost."""
    grip = HingeKinematics.of(first, second, axis)
    slope, push = _slopes(energy, grip.half.displacement)
    (a, b, c), (_, d, e), (_, _, f) = jnp.stack(jax.vmap(push)(*jnp.eye(3)), axis=1)
    # Gauss's elimination, as far as the stiffness is positive; it could lose what is not.
    one = (a >= 0) & (b * b <= a * d) & (c * c <= a * f)
    ba, ca = _over(b, a, one), _over(c, a, one)
    d, e, f = d - b * ba, e - c * ba, f - c * ca
    two = one & (d >= 0) & (e * e <= d * f)
    eb = _over(e, d, two)
    weights = [(one, a), (two, d), (two, f - e * eb)]
    weights = jnp.stack([jnp.where(found, value, 0.0) for found, value in weights])
    left = [(one, a), (one, b), (one, c), (two, d), (two, e), (two, f)]
    a, b, c, d, e, f = (jnp.where(found, 0.0, value) for found, value in left)
    left = jnp.stack([jnp.stack(row) for row in ((a, b, c), (b, d, e), (c, e, f))])
    first, second, third = jnp.stack([jnp.stack(row) for row in grip.columns()]).T
    rows = jnp.stack([first + ba * second + ca * third, second + eb * third, third])
    bend = jnp.stack([jnp.stack(row) for row in grip.bend(slope)])
    reference = product(product(rows.T, left), rows) + bend
    motions = jnp.asarray(_MOTIONS)
    reference = product(product(motions, reference), motions.T)
    return Factored(product(rows, motions.T), weights, reference)


def _over(above: Scalar, below: Scalar, sound: Bool[Array, ""]) -> Scalar:
    some = sound & (below != 0)
    return jnp.where(some, above / jnp.where(some, below, 1.0), 0.0)


# The six displacements by the four motions
_MOTIONS = np.array(
    [
        [1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, -1.0, 0.0],
        [0.0, 0.0, 0.0, -1.0],
        [0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ]
)


def product(
    first: Inexact[Array, "rows inner"], second: Inexact[Array, "inner columns"]
) -> Inexact[Array, "rows columns"]:
    """Their product, as a sum that is fused with what is around it.

    For a few rows a product of matrices costs more by its call than by its work.
    """
    return jnp.sum(first[:, :, None] * second[None], axis=1)


def _foreseen(energy: AbstractEnergy, borne: Three | None) -> AbstractEnergy:
    return energy if borne is None else energy.newton_model(borne[1])


def _borne(at: Displacement, stretch: Two | None) -> tuple[Displacement, Two]:
    """The displacement with a translation of its own, and what that leaves over."""
    if stretch is None:
        none = jnp.zeros_like(at.x1)
        return at, (none, none)
    y1, y2 = stretch
    borne = Displacement(at.angle, at.sigma, at.xi, y1 / 2, y2 / 2)
    return borne, (2 * at.x1 - y1, 2 * at.x2 - y2)


def _slopes(
    energy: AbstractEnergy, at: Displacement
) -> tuple[Three, Callable[..., Three]]:
    """The energy's derivatives by the angle and the half-way translation, linearised."""

    def stored_energy(angle: Scalar, y1: Scalar, y2: Scalar) -> Scalar:
        return energy.stored_energy(_moved(at, (angle, y1, y2)))

    return jax.linearize(jax.grad(stored_energy, argnums=(0, 1, 2)), *_coordinates(at))


def _drag(
    energy: AbstractEnergy,
    damping: ViscousDamping,
    at: Displacement,
    place: Three,
    rates: Three,
    resisting: Displacement | None = None,
) -> Three:
    """What a damping adds to the slopes, by the coordinates and their rates.

    A tangent may take for `resisting`, where the energy says what it resists, the place
    about which it is: a solver converges as fast, and is compiled in half the time.
    """

    def half_power(rates: Three) -> Scalar:
        def measure(angle: Scalar, y1: Scalar, y2: Scalar) -> Three:
            return strain(_moved(at, (angle, y1, y2)), damping.coordinates)

        _, strained = jax.jvp(measure, place, rates)
        if damping.resisted:
            where = _moved(at, place) if resisting is None else resisting
            strained = energy.resisted_rates(where, strained)
        return half_square(damping.damping, strained)

    return jax.grad(half_power)(rates)


def _stretch(energy: AbstractEnergy, at: Displacement) -> Three:
    """The energy's stretch, and its first two derivatives by the angle."""

    def stretch(angle: Scalar) -> Scalar:
        return energy.stretch(_moved(at, (angle, 2 * at.x1, 2 * at.x2)))

    def growing(angle: Scalar) -> tuple[Scalar, Scalar]:
        return jax.jvp(stretch, (angle,), (jnp.ones_like(angle),))

    (value, slope), (_, bend) = jax.jvp(growing, (at.angle,), (jnp.ones_like(at.angle),))
    return value, slope, bend


def _coordinates(at: Displacement) -> Three:
    return at.angle, 2 * at.x1, 2 * at.x2


def _moved(at: Displacement, place: Three) -> Displacement:
    """A displacement as a function of its coordinates, its sine and cosine known."""
    angle, y1, y2 = place
    cos, sin = half_turn(angle, at.sigma, at.xi)
    return Displacement(angle, cos, sin, y1 / 2, y2 / 2)


def _pull(grip: HingeKinematics, slopes: Three) -> Six:
    return _six(*(_dot(column, slopes) for column in grip.columns()))


def _six(on_first: Scalar, on_second: Scalar, x: Scalar, y: Scalar) -> Six:
    """Of the four motions, the six displacements."""
    return on_first, -x, -y, on_second, x, y


def _dot(first: Three, second: Three) -> Scalar:
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]


def _sum(first: Three, second: Three) -> Three:
    return first[0] + second[0], first[1] + second[1], first[2] + second[2]


def _spread(
    columns: Sequence[Three],
    pushed: Sequence[Three],
    bend: list[list[Scalar]] | None,
    *,
    symmetric: bool,
) -> SixBySix:
    """Products of the four motions' columns, among the six displacements."""
    four: list[list[Any]] = [[None] * 4 for _ in range(4)]
    for row in range(4):
        for column in range(4):
            if symmetric and column < row:
                four[row][column] = four[column][row]
                continue
            value = _dot(columns[row], pushed[column])
            four[row][column] = value if bend is None else value + bend[row][column]
    motions = (0, 1), (2, -1), (3, -1), (1, 1), (2, 1), (3, 1)
    six = [
        tuple(
            four[row][column] if up * left > 0 else -four[row][column]
            for column, left in motions
        )
        for row, up in motions
    ]
    return cast(SixBySix, tuple(six))
