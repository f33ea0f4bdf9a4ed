"""The micropositioning stage of chapter 6, from its drawing to its gain.

Six bodies and seven notch hinges, cut from one plate of aluminium by Scire and Teague
(Review of Scientific Instruments 49, 1978). Body 1 is the frame and is held; a drive
pushes body 6, the input; body 4, the output, moves some 28 times as far. The notches are
not pins: with pins the linkage could not move at all, and their stretch takes a quarter
of the gain of rigid levers.

The figures are those of the dissertation's listing. Its text differs in places: masses
there are for 2.8e3 kg/m3, equation 6.12 has 0.0952 for 0.00952 kg, equation 6.23 lacks
the target of the input, and section 6.2.3 has mm for um.
"""

from functools import partial
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from .._utils.types import Corners, Scalar
from ..energies.base import Quadratic
from ..energies.damping import ViscousDamping
from ..energies.strains import Coordinates
from ..flexures import Material, notch, notch_outline
from ..flexures.notch import Formula
from ..mechanism.body import Body
from ..mechanism.hinge import Hinge
from ..mechanism.loads import Drive
from ..mechanism.mechanism import Mechanism
from ..plotting.canvas import INK
from ..plotting.drawing import draw
from ..solve.results import RESULTS
from ..solve.statics import Equilibrium, equilibrium
from ..solve.tables import Column, Columns, Tabular


if TYPE_CHECKING:
    from matplotlib.axes import Axes


WEB = 0.25e-3  # m
TRAVEL = 1.35e-6  # of the input, in the experiments of 1978; m
MEASURED_GAIN = (27.8, 28.1)  # Scire and Teague, 1978
MEASURED_COMPRESSION = 50e-9  # of hinge a, under conditions they do not state; m
DISSERTATION_GAIN = 27.8  # section 6.4, read off its figure 6.3
RIGID_GAIN = 328 / 9  # levers on pins: 36.44

_MM = 1e-3

# name: centre of mass; m
_CENTRES = {
    "1": (0.0, 0.0),
    "2": (-21 * _MM, 23 * _MM),
    "3": (-14 * _MM, 15 * _MM),
    "4": (0.0, 24 * _MM),
    "5": (14 * _MM, 15 * _MM),
    "6": (-7 * _MM, 35 * _MM),
}

# name: the two bodies, and the middle of the neck; m
_HINGES = {
    "a": ("2", "6", (-14 * _MM, 35 * _MM)),
    "b": ("1", "2", (-14 * _MM, 44 * _MM)),
    "c": ("2", "3", (-14 * _MM, 3 * _MM)),
    "d": ("1", "3", (-14 * _MM, 0.0)),
    "e": ("3", "4", (-14 * _MM, 24 * _MM)),
    "f": ("4", "5", (14 * _MM, 24 * _MM)),
    "g": ("5", "1", (14 * _MM, 0.0)),
}


def aluminium() -> Material:
    """Aluminium 6061-T6, as the dissertation has it."""
    return Material(modulus=69e9, poisson=0.33, density=2.7e3)


def microstage(
    web: ArrayLike = WEB,
    *,
    hole: ArrayLike = 3e-3,
    width: float = 20e-3,
    material: Material | None = None,
    formula: Formula = "fitted",
    coordinates: Coordinates = "twistor",
    damping: ViscousDamping | ArrayLike | None = None,
) -> Mechanism:
    """The micropositioning stage.

    Args:
        web: thickness of the necks of its hinges, one for all, or one for each from a to
            g; m.
        hole: diameter of the holes that leave them; m.
        width: thickness of the plate; m.
        material: of the plate, by default `aluminium`.
        formula: for the stiffness of the notches.
        coordinates: of their quadratic energies, "twistor" or "twist".
        damping: of each notch, needed for motion alone: a `ViscousDamping`, or the time by
            which its stiffness is multiplied; s.

    Returns:
        Bodies "1" to "6" and hinges "a" to "g", as the dissertation calls them; "1" is
        held, and "6" but for its x, along which it is to be driven.

    Raises:
        ValueError: a dimension is not positive or outside the range of the formula;
            there are neither one nor seven webs.

    Source:
        Section 6.2 of the dissertation and its listing `microstage`.

    Example:
        >>> microstage()
        Mechanism of 6 bodies (1, 2, 3, 4, 5, 6), 7 hinges (a, b, c, d, e, f, g);
        fixed: 1, angle and y of 6
    """
    material = aluminium() if material is None else material

    def neck(web: ArrayLike) -> tuple[Quadratic, Corners]:
        energy = notch(
            material,
            hole=hole,
            web=web,
            width=width,
            formula=formula,
            coordinates=coordinates,
        )
        return energy, notch_outline(hole=hole, web=web)

    if np.shape(web) not in ((), (len(_HINGES),)):
        raise ValueError(
            f"`web` has shape {np.shape(web)}, but must be one thickness, or one for "
            f"each of the hinges {', '.join(_HINGES)}."
        )
    if np.shape(web):
        necks = [neck(each) for each in jnp.asarray(web, float)]
    else:
        necks = [neck(web)] * len(_HINGES)
    bodies = []
    for name, center in _CENTRES.items():
        outline = _OUTLINES[name] * _MM - np.array(center)
        if name == "1":
            bodies.append(Body(name, outline=outline))
            continue
        area, second_moment = _areas(name)
        density = 1.0 if material.density is None else material.density
        weight = density * width
        bodies.append(
            Body(
                name,
                pose=(0.0, *center),
                mass=None if material.density is None else weight * area,
                inertia=None if material.density is None else weight * second_moment,
                outline=outline,
            )
        )
    hinges = [
        Hinge(
            name, first, second, energy, at=(0.0, *at), damping=damping, outline=outline
        )
        for (name, (first, second, at)), (energy, outline) in zip(
            _HINGES.items(), necks, strict=True
        )
    ]
    fixed = {"1": ("angle", "x", "y"), "6": ("angle", "y")}
    return Mechanism(bodies, hinges, fixed=fixed)


class Amplification(Tabular):
    """What a stage makes of a motion of its input.

    Args:
        gain: travel of the output over travel of the input.
        output: travel of body 4 along x; m.
        input_force: what drives the input; N.
        compression: how much less body 2 moves at hinge a than the input does; m. In the
            listing's geometry the input lies beyond the hinge, seen along its travel, so
            that a travel along x stretches the neck, and one against x compresses it by
            as much.
        equilibrium: of the stage.
    """

    gain: Scalar
    output: Scalar
    input_force: Scalar
    compression: Scalar
    equilibrium: Equilibrium

    @property
    def result(self) -> RESULTS:
        """How it ended."""
        return self.equilibrium.result

    def columns(self) -> Columns:
        return {
            "gain": Column(self.gain, (), "1"),
            "output": Column(self.output, (), "m"),
            "input_force": Column(self.input_force, (), "N"),
            "compression": Column(self.compression, (), "m"),
            **self.equilibrium.columns(),
        }


def amplify(
    stage: Mechanism, travel: ArrayLike = TRAVEL, *, throw: bool = True
) -> Amplification:
    """Moves the input of a stage, and sees what the output does.

    Args:
        stage: a `microstage`.
        travel: of the input along x; m.
        throw: whether a failure is raised, or only told by the equilibrium's `result`.

    Source:
        Section 6.4 of the dissertation, without its transient.

    Example:
        >>> amplify(microstage()).gain
        Array(27.62804368, dtype=float64)
    """
    moved = equilibrium(stage, drives=[Drive("6", x=travel)], throw=throw)
    output = moved.displacement("4")[1]
    return Amplification(
        gain=output / travel,
        output=output,
        input_force=moved.reaction("6")[1],
        compression=stage.displacement_of("a", moved)[1],
        equilibrium=moved,
    )


@partial(jax.jit, static_argnames="coordinates")
def amplify_by_web(
    web: ArrayLike, travel: ArrayLike, coordinates: Coordinates = "twistor"
) -> tuple[Amplification, Scalar]:
    """The amplification of a stage with such webs, and how its gain changes with them.

    Args:
        web: thickness of the necks; m.
        travel: of the input along x; m.
        coordinates: of the hinges' energies, "twistor" or "twist".

    Returns:
        The amplification, whose `result` tells whether it succeeded, and the derivative
        of the gain by the web; 1/m.
    """

    def gain(web: Scalar) -> tuple[Scalar, Amplification]:
        stage = microstage(web, coordinates=coordinates)
        answer = amplify(stage, travel, throw=False)
        return answer.gain, answer

    web = jnp.asarray(web, float)
    _, slope, answer = jax.jvp(gain, (web,), (jnp.ones_like(web),), has_aux=True)
    return answer, slope


def plot(stage: Mechanism, answer: Amplification, *, magnify: float | int = 50) -> "Axes":
    """Draws a stage as its input has moved it, with the travels of input and output.

    Args:
        stage: a `microstage`.
        answer: what `amplify` made of it.
        magnify: a factor on displacements.
    """
    moved = answer.equilibrium
    axes = draw(stage, moved.poses, magnify=magnify)
    # beside the input, and below the output: where the drawing is empty
    for name, word, dx, dy in (("6", "input", 14.0, 0.0), ("4", "output", 0.0, -6.5)):
        row = moved.names.index(name)
        x, y = 1e3 * np.asarray(moved.reference)[row, 1:] + np.array([dx, dy])
        travel = 1e6 * float(moved.displacements[row, 1])
        label = f"{word} {travel:.4g} \N{MICRO SIGN}m"
        axes.annotate(label, (x, y - 0.8), color=INK, ha="center", va="top")
        style = {"arrowstyle": "->", "color": INK}
        axes.annotate("", (x + 3.5, y), (x - 3.5, y), arrowprops=style)
    axes.set_title(
        f"gain {float(answer.gain):.3f}, {axes.get_title()}", fontsize="medium"
    )
    return axes


def _areas(name: str) -> tuple[float, float]:
    """Area of a body, and its second moment about the centre; m2, m4.

    Sums of rectangles, as the listing has them, each (area, sides, centre).
    """
    bar = [(2 * 17 * 5, (17, 5), (2.5, 7.5))]
    parts = {
        "2": [
            (5 * 10, (5, 10), (1, 18)),
            (21 * 6, (6, 21), (2, 8)),
            (14 * 10 / 2, (6, 9), (3, 6)),
        ],
        "3": bar,
        "4": [(10 * 28, (28, 10), (0, 0))],
        "5": bar,
        "6": [(14 * 10, (7, 50), (0, 0))],
    }[name]
    area = sum(part[0] for part in parts)
    moment = sum(
        size * ((sides[0] ** 2 + sides[1] ** 2) / 12 + place[0] ** 2 + place[1] ** 2)
        for size, sides, place in parts
    )
    return area * _MM**2, moment * _MM**4


# Corners, in the world at rest, after figure 6.1; mm. The listing has no outlines: these
# leave the slots that the hinges' places and the bodies' bars tell of.
_RIGHT_LEVER = np.array(
    [
        (12.5, -1.9), (8.5, -1.9), (8.5, 15.5), (13, 18.5), (15.5, 22.2), (15.5, 25.8),
        (19.5, 25.8), (19.5, 13), (14.5, 9), (12.5, 5),
    ]
)  # fmt: skip
_OUTLINES = {
    "1": np.array(
        [
            (-12.5, 49), (-12.5, 42.3), (24, 42.3), (24, 4), (15.5, 1.7), (15.5, -1.7),
            (12.5, -4), (-12.5, -4), (-15.5, -1.7), (-15.5, 1.3), (-21, 1.3), (-27, -2),
            (-27, -9), (31, -9), (31, 49),
        ]
    ),
    "2": np.array(
        [
            (-27, 46), (-15.5, 46), (-15.5, 42.3), (-17.5, 41), (-17.5, 38),
            (-15.5, 36.7), (-15.5, 33.3), (-17.5, 32), (-20.5, 32), (-20.5, 11),
            (-17.5, 5.5), (-15.5, 4.7), (-15.5, 1.7), (-21, 1.7), (-27, 10),
        ]
    ),
    "3": _RIGHT_LEVER * np.array([-1, 1]),
    "4": np.array(
        [
            (-12.5, 22.3), (-9.5, 20), (9.5, 20), (12.5, 22.3), (12.5, 25.7),
            (9.5, 28.5), (-9.5, 28.5), (-12.5, 25.7),
        ]
    ),
    "5": _RIGHT_LEVER,
    "6": np.array(
        [(-12.5, 33.3), (-10, 31), (0, 31), (0, 39), (-10, 39), (-12.5, 36.7)]
    ),
}  # fmt: skip
