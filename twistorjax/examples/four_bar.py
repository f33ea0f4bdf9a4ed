"""The four-bar linkages of chapter 5: driven, and let go.

Four links cut from a plate 5 mm thick, upright rectangles on a ground link, joined by
elastic hinges whose axes are upright. In section 5.2 the hinges are four leaves of one
kind; in section 5.3 one leaf is twice as long, and the upper two hinges are notches. The
links are of aluminium; to make the motion visible, the hinges have a twentieth of its
stiffness.

The figures are those of the dissertation's listing. Its damping, 100 times the unit
matrix, would freeze everything; one that is in proportion to the stiffness is taken
instead. The listing also holds the driven link's x, which the text does not.
"""

from collections.abc import Mapping, Sequence
from typing import Literal, TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from .._utils.types import Scalar
from .._utils.validation import index_of
from ..energies.base import AbstractEnergy
from ..energies.damping import ViscousDamping
from ..energies.strains import Coordinates
from ..flexures import leaf, leaf_outline, Material, notch, notch_outline
from ..mechanism.body import Body, plate
from ..mechanism.hinge import Hinge
from ..mechanism.loads import Drive
from ..mechanism.mechanism import Mechanism
from ..plotting.canvas import subplots
from ..plotting.drawing import draw
from ..solve.dynamics import simulate
from ..solve.motion import Motion


if TYPE_CHECKING:
    from matplotlib.figure import Figure


PANELS = tuple(0.045 * k for k in range(10))  # of figures 5.3 and 5.6; s
DRIVEN_DAMPING = 1e-3  # stiffness to damping, where the linkage is driven; s
RELEASED_DAMPING = 1e-4  # where it is let go; s
SPEED = 10.0  # of link 3 as it is let go, in the listing; m/s

Hinges = Literal["identical", "mixed"]

_WIDTH = 5e-3  # out of the plane, and of the links in it; m
_LENGTH = 40e-3  # of the links; m
_HALF = 17.5e-3  # from the middle to the upright links; m


def four_bar(
    hinges: Hinges = "identical",
    *,
    coordinates: Coordinates = "twistor",
    damping: ViscousDamping | ArrayLike | None = DRIVEN_DAMPING,
    length: ArrayLike = 10e-3,
    thickness: ArrayLike = 1e-3,
    energies: Mapping[str, AbstractEnergy] | None = None,
) -> Mechanism:
    """A four-bar linkage with elastic hinges.

    Args:
        hinges: "identical" leaves, as in section 5.2, or "mixed", as in section 5.3.
        coordinates: of the hinges' quadratic energies, "twistor" or "twist".
        damping: of each hinge: a `ViscousDamping`, or the time by which its stiffness is
            multiplied; s.
        length: of the leaves; of the mixed linkage, of the short one; m.
        thickness: of the leaves; m.
        energies: of some hinges, by their names, instead of those of leaves and notches.

    Returns:
        Bodies "1" to "4" and hinges "A" to "D", as the dissertation calls them; "1" is
        held.

    Raises:
        ValueError: a dimension is not positive; `hinges`, `coordinates` or the name of a
            hinge is unknown.

    Source:
        Sections 5.2 and 5.3 of the dissertation, and its listing `fourbar`.

    Example:
        >>> four_bar("mixed")
        Mechanism of 4 bodies (1, 2, 3, 4), 4 hinges (A, B, C, D); fixed: 1
    """
    energies = {} if energies is None else energies
    for name in energies:
        index_of("`energies`", "hinge", name, tuple("ABCD"))
    if hinges not in ("identical", "mixed"):
        raise ValueError(f"`hinges` is {hinges!r}, but must be 'identical' or 'mixed'.")
    links = Material(modulus=69e9, poisson=0.3, density=2.7e3)
    soft = Material(modulus=69e9 / 20, poisson=0.3)

    def blade(length: ArrayLike):
        energy = leaf(
            soft, length=length, thickness=thickness, width=_WIDTH,
            coordinates=coordinates,
        )  # fmt: skip
        return length, energy, leaf_outline(length=length, thickness=thickness)

    short = blade(length)
    kinds = dict.fromkeys("ABCD", short)
    heights = dict.fromkeys("24", _LENGTH)
    if hinges == "mixed":
        hole, web = 8e-3, 0.5e-3
        neck = notch(soft, hole=hole, web=web, width=_WIDTH, coordinates=coordinates)
        waist = hole, neck, notch_outline(hole=hole, web=web, height=_WIDTH)
        kinds = {"A": blade(2 * length), "B": waist, "C": waist, "D": short}
        heights = {"2": 30e-3, "4": _LENGTH}

    bodies = [_link("1", 0.0, 0.0, _LENGTH, _WIDTH, links)]
    joints = []
    uprights = (("2", -_HALF, "A", "B"), ("4", _HALF, "D", "C"))
    tops = []
    for name, x, lower, upper in uprights:
        ground, foot = _WIDTH / 2, kinds[lower][0]
        link, head = heights[name], kinds[upper][0]
        bodies.append(_link(name, x, ground + foot + link / 2, _WIDTH, link, links))
        joints.append((lower, "1", name, x, ground + foot / 2))
        joints.append((upper, name, "3", x, ground + foot + link + head / 2))
        tops.append(ground + foot + link + head)
    top = _link("3", 0.0, sum(tops) / 2 + _WIDTH / 2, _LENGTH, _WIDTH, links)
    first, left, right = bodies
    return Mechanism(
        [first, left, top, right],
        [
            Hinge(
                name,
                *((other, below) if name in "CD" else (below, other)),
                energies.get(name, kinds[name][1]),
                at=(jnp.pi / 2, x, y),
                damping=damping,
                outline=kinds[name][2],
            )
            for name, below, other, x, y in sorted(joints)
        ],
        fixed=["1"],
    )


def turn(time: Scalar) -> list[Drive]:
    """How link 2 is turned: from rest, forth and back five times a second.

    Source:
        Equation 5.26 of the dissertation, integrated.

    Example:
        >>> turn(jnp.array(0.1))[0].angle  # at its furthest
        Array(0.31415927, dtype=float64)
    """
    return [Drive("2", angle=0.05 * jnp.pi * (1 - jnp.cos(10 * jnp.pi * time)))]


def drive(
    linkage: Mechanism,
    times: Float[ArrayLike, " times"] | Sequence[ArrayLike] = PANELS,
    **settings,
) -> Motion:
    """Moves a linkage by turning link 2.

    Args:
        linkage: a `four_bar`.
        times: at which its motion is told; s.
        settings: for `simulate`.

    Source:
        Figures 5.3 and 5.6 of the dissertation.

    Example:
        >>> drive(four_bar()).displacement("3")[2]
        Array([ 0.002349, -0.014866, -0.002255], dtype=float64)
    """
    return simulate(linkage, times, drives=turn, **settings)


def release(
    linkage: Mechanism,
    times: Float[ArrayLike, " times"] | Sequence[ArrayLike],
    speed: ArrayLike = SPEED,
    **settings,
) -> Motion:
    """Lets a linkage go, with link 3 moving along x.

    Args:
        linkage: a `four_bar`.
        times: at which its motion is told; s.
        speed: of link 3 at the start; m/s.
        settings: for `simulate`.

    Source:
        The listing `fourbar` of the dissertation, with its initial velocity.

    Example:
        >>> moved = release(four_bar(damping=1e-4), [0.0, 0.05])
        >>> moved.displacement("3")[-1]
        Array([ 0.00226..., -0.02276..., -0.00540...], dtype=float64)
    """
    return simulate(linkage, times, velocities={"3": (0.0, speed, 0.0)}, **settings)


def plot(linkage: Mechanism, motion: Motion) -> "Figure":
    """Draws a linkage at the times of a motion, as the panels of figures 5.3 and 5.6.

    Args:
        linkage: a `four_bar`.
        motion: of it; at most ten of its times are drawn, evenly chosen.
    """
    shown = np.unique(np.linspace(0, len(motion.times) - 1, 10).round().astype(int))
    columns = min(5, len(shown))
    rows = -(-len(shown) // columns)
    figure, axes = subplots(
        rows,
        columns,
        size=(2.4 * columns, 3.2 * rows),
        sharex=True,
        sharey=True,
        squeeze=False,
    )
    for panel, row in zip(axes.flat, shown, strict=False):
        draw(linkage, motion.poses[row], axes=panel, names=row == shown[0], ghost=True)
        panel.set_title(f"{float(motion.times[row]):.3f} s", fontsize="medium")
        panel.label_outer()
    for panel in axes.flat[len(shown) :]:
        panel.set_visible(False)
    return figure


def _link(
    name: str, x: ArrayLike, y: ArrayLike, wide: ArrayLike, high: ArrayLike, of: Material
) -> Body:
    corners = jnp.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) / 2
    size = jnp.stack([jnp.asarray(wide, float), jnp.asarray(high, float)])
    place = jnp.stack([jnp.asarray(x, float), jnp.asarray(y, float)])
    return plate(name, place[None] + corners * size[None], width=_WIDTH, of=of)
