"""Four-bar linkages with elastic hinges: driven by link 2, or released.

Four links are cut from a plate that is 5 mm thick. Link 1 is the ground link; links 2
and 4 stand on it, and link 3 connects their upper ends. Axis 1 of every hinge is
vertical. In section 5.2 of the dissertation all four hinges are identical leaves. In
section 5.3 one leaf is twice as long, and the upper two hinges are notches. The links are
made of aluminum; Young's modulus of the hinges is 1/20 of that of aluminum, which makes
the motion visible.

The dimensions are those of the dissertation's listing `fourbar`. Its damping matrix, 100
times the unit matrix, would suppress the motion; damping proportional to the stiffness
replaces it. The listing also fixes the x coordinate of link 2; the text does not, and
here it is free.
"""

from collections.abc import Mapping
from itertools import accumulate
from typing import Literal, NamedTuple, TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from .._utils.host import as_float, on_host
from .._utils.types import Corners, NumberLike, Scalar, TimesLike
from .._utils.validation import index_of
from ..energies.base import AbstractEnergy
from ..energies.damping import DampingLike
from ..energies.strains import Coordinates
from ..flexures import leaf_outline, linear_leaf, notch, notch_outline
from ..mechanism.body import Body, plate
from ..mechanism.hinge import Hinge
from ..mechanism.loads import Drive
from ..mechanism.material import Material
from ..mechanism.mechanism import Mechanism
from ..plotting.drawing import draw
from ..plotting.figure_style import subplots
from ..solve.integration.solution import Motion
from ..solve.simulate import simulate


if TYPE_CHECKING:
    from matplotlib.figure import Figure


FIGURE_TIMES = tuple(0.045 * k for k in range(10))  # panels of figures 5.3 and 5.6; s
DRIVEN_DAMPING = 1e-3  # ratio of damping to stiffness of the driven linkage; s
RELEASED_DAMPING = 1e-4  # ratio of damping to stiffness of the released linkage; s
RELEASE_SPEED = 10.0  # initial velocity of link 3 along x, from the listing; m/s

Hinges = Literal["identical", "leaves-and-notches"]

_WIDTH = 5e-3  # thickness of the plate, and in-plane width of the links; m
_LENGTH = 40e-3  # length of the links; m
_HALF_SPAN = 17.5e-3  # distance of links 2 and 4 from the center line; m


class _Flexure(NamedTuple):
    """The energy of a hinge, its length along axis 1 (m), and its outline (m)."""

    energy: AbstractEnergy
    length: NumberLike
    outline: Corners


def four_bar(
    hinges: Hinges = "identical",
    *,
    coordinates: Coordinates = "twistor",
    damping: DampingLike | None = DRIVEN_DAMPING,
    length: NumberLike = 10e-3,
    thickness: NumberLike = 1e-3,
    energies: Mapping[str, AbstractEnergy] | None = None,
) -> Mechanism:
    """Build a four-bar linkage with elastic hinges.

    Args:
        hinges: "identical" for four identical leaves (section 5.2), "leaves-and-notches"
            for two leaves and two notches (section 5.3).
        coordinates: Coordinates of the quadratic hinge energies, "twistor" or "twist".
        damping: Damping of each hinge: a `ViscousDamping`, or the ratio of damping to
            stiffness; s.
        length: Length of the leaves. In the linkage of leaves and notches, length of the
            shorter leaf; m.
        thickness: Thickness of the leaves; m.
        energies: Energies that replace those of the leaves and notches, by hinge name.

    Returns:
        A mechanism with the bodies "1" to "4" and the hinges "A" to "D", named as in the
        dissertation. Body "1" is fixed.

    Raises:
        ValueError: A dimension is not positive; or `hinges`, `coordinates`, or the name
            of a hinge is unknown.

    Source:
        Sections 5.2 and 5.3 of the dissertation, and its listing `fourbar`.

    Example:
        >>> four_bar("leaves-and-notches")
        Mechanism of 4 bodies (1, 2, 3, 4), 4 hinges (A, B, C, D); fixed: 1
    """
    energies = {} if energies is None else energies
    for name in energies:
        index_of("`energies`", "hinge", name, ("A", "B", "C", "D"))
    if hinges not in ("identical", "leaves-and-notches"):
        raise ValueError(
            f"`hinges` is {hinges!r}, but must be 'identical' or 'leaves-and-notches'."
        )
    aluminum = Material(modulus=69e9, poisson=0.3, density=2.7e3)
    soft = Material(modulus=69e9 / 20, poisson=0.3)

    def leaf_flexure(length: NumberLike) -> _Flexure:
        energy = linear_leaf(
            soft,
            length=length,
            thickness=thickness,
            width=_WIDTH,
            coordinates=coordinates,
        )
        return _Flexure(energy, length, leaf_outline(length=length, thickness=thickness))

    short_leaf = leaf_flexure(length)
    flexures = {"A": short_leaf, "B": short_leaf, "C": short_leaf, "D": short_leaf}
    length_2 = _LENGTH
    if hinges == "leaves-and-notches":
        hole, web = 8e-3, 0.5e-3
        energy = notch(soft, hole=hole, web=web, width=_WIDTH, coordinates=coordinates)
        outline = notch_outline(hole=hole, web=web, height=_WIDTH)
        flexures["A"] = leaf_flexure(2 * length)
        flexures["B"] = flexures["C"] = _Flexure(energy, hole, outline)
        length_2 = 30e-3

    a, link_2, b, top_2 = _heights(flexures["A"].length, length_2, flexures["B"].length)
    d, link_4, c, top_4 = _heights(flexures["D"].length, _LENGTH, flexures["C"].length)
    link_3 = (top_2 + top_4) / 2 + _WIDTH / 2

    def hinge(name: str, first: str, second: str, x: float, y: NumberLike) -> Hinge:
        flexure, up = flexures[name], jnp.pi / 2
        return Hinge(
            name,
            first,
            second,
            energies.get(name, flexure.energy),
            at=(up if x < 0 else -up, x, y),  # up on the left, down on the right
            damping=damping,
            outline=flexure.outline,
        )

    return Mechanism(
        bodies=[
            _link("1", 0.0, 0.0, _LENGTH, _WIDTH, aluminum),
            _link("2", -_HALF_SPAN, link_2, _WIDTH, length_2, aluminum),
            _link("3", 0.0, link_3, _LENGTH, _WIDTH, aluminum),
            _link("4", _HALF_SPAN, link_4, _WIDTH, _LENGTH, aluminum),
        ],
        hinges=[
            hinge("A", "1", "2", -_HALF_SPAN, a),
            hinge("B", "2", "3", -_HALF_SPAN, b),
            hinge("C", "3", "4", _HALF_SPAN, c),
            hinge("D", "4", "1", _HALF_SPAN, d),
        ],
        fixed=["1"],
    )


def crank_rotation(time: Scalar) -> list[Drive]:
    """Prescribe the rotation of link 2: five cycles a second, up to 18 degrees.

    Args:
        time: Time; the linkage is in its reference configuration at zero; s.

    Returns:
        The prescribed displacement of link 2 at this time.

    Source:
        Equation 5.26 of the dissertation, integrated.

    Example:
        >>> (crank,) = crank_rotation(jnp.array(0.1))  # when the rotation is largest
        >>> crank.angle
        Array(0.31415927, dtype=float64)
    """
    return [Drive("2", angle=0.05 * jnp.pi * (1 - jnp.cos(10 * jnp.pi * time)))]


def driven_motion(
    linkage: Mechanism,
    times: TimesLike = FIGURE_TIMES,
    **settings,
) -> Motion:
    """Simulate a linkage that is driven by the rotation of link 2.

    Args:
        linkage: A linkage made by `four_bar`.
        times: Times at which the motion is returned; s.
        settings: Further arguments of `simulate`.

    Returns:
        The motion of the linkage.

    Source:
        Figures 5.3 and 5.6 of the dissertation.

    Example:
        >>> motion = driven_motion(four_bar())
        >>> motion.displacement("3")[2]  # angle (rad), x (m), y (m)
        Array([ 0.002349, -0.014866, -0.002255], dtype=float64)
    """
    return simulate(linkage, times, drives=crank_rotation, **settings)


def released_motion(
    linkage: Mechanism,
    times: TimesLike,
    speed: NumberLike = RELEASE_SPEED,
    **settings,
) -> Motion:
    """Simulate a linkage that is released with an initial velocity of link 3 along x.

    Args:
        linkage: A linkage made by `four_bar`.
        times: Times at which the motion is returned; s.
        speed: Initial velocity of link 3 along x; m/s.
        settings: Further arguments of `simulate`.

    Returns:
        The motion of the linkage.

    Source:
        The listing `fourbar` of the dissertation, with its initial velocity.

    Example:
        >>> linkage = four_bar(damping=RELEASED_DAMPING)
        >>> motion = released_motion(linkage, times=[0.0, 0.05])
        >>> motion.displacement("3")[-1]  # angle (rad), x (m), y (m)
        Array([ 0.00226..., -0.02276..., -0.00540...], dtype=float64)
    """
    return simulate(linkage, times, velocities={"3": (0.0, speed, 0.0)}, **settings)


def plot(linkage: Mechanism, motion: Motion) -> "Figure":
    """Draw a linkage at several times of a motion.

    Args:
        linkage: A linkage made by `four_bar`.
        motion: Motion of this linkage. If it has more than ten times, ten of them are
            drawn, evenly spaced.

    Returns:
        A figure with one panel for each time.

    Source:
        Figures 5.3 and 5.6 of the dissertation.
    """
    rows = np.unique(np.linspace(0, len(motion.times) - 1, 10).round().astype(int))
    column_count = min(5, len(rows))
    row_count = -(-len(rows) // column_count)
    figure, axes = subplots(
        row_count,
        column_count,
        size=(2.4 * column_count, 3.2 * row_count),
        sharex=True,
        sharey=True,
        squeeze=False,
    )
    for panel, row in zip(axes.flat, rows, strict=False):
        draw(linkage, motion.poses[row], axes=panel, names=row == rows[0])
        panel.set_title(f"{float(motion.times[row]):.3f} s", fontsize="medium")
        panel.label_outer()
    for panel in axes.flat[len(rows) :]:
        panel.set_visible(False)
    return figure


def _heights(*lengths: NumberLike) -> list[NumberLike]:
    """Compute the heights of parts of given lengths (m) that stand on link 1.

    They are those of the center of each part, and of the upper end of the last part,
    above the center line of link 1; m.
    """
    *lower_ends, top = accumulate(lengths, initial=_WIDTH / 2)
    centers = [end + length / 2 for end, length in zip(lower_ends, lengths, strict=True)]
    return [*centers, top]


def _link(
    name: str,
    x: NumberLike,
    y: NumberLike,
    width: NumberLike,
    height: NumberLike,
    material: Material,
) -> Body:
    """Make a rectangular link with its center at (x, y); all lengths in m."""
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) / 2
    numbers, (x, y, width, height) = on_host(*map(as_float, (x, y, width, height)))
    size, center = numbers.stack([width, height]), numbers.stack([x, y])
    outline = as_float(center[None] + corners * size[None])
    return plate(name, outline, width=_WIDTH, material=material)
