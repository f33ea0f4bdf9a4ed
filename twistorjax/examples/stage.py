"""The micropositioning stage of chapter 6: its mechanism and its static gain.

`amplification` computes the gain: the displacement of body 4 divided by that of body 6.

The stage has six bodies and seven notch hinges, cut from one aluminum plate by Scire and
Teague (Review of Scientific Instruments 49, 1978). Body 1 is the frame and is fixed. An
actuator displaces body 6, the input; body 4, the output, moves about 28 times as far.
With rigid levers on ideal pins, only an infinitesimal motion would be possible; its gain
would be 36.44. The compliance of the notches allows a finite motion, and reduces the gain
by a quarter.

The dimensions are those of the dissertation's listing `microstage`. The text differs in
places: its masses are those for 2.8e3 kg/m3, equation 6.12 has 0.0952 instead of
0.00952 kg, equation 6.23 lacks the input displacement, and section 6.2.3 has mm instead
of um.
"""

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from .. import plotting
from .._compile.compilation import fast_compile
from .._utils.host import as_float, on_host
from .._utils.types import Corners, NumberLike, Scalar
from ..energies.damping import DampingLike
from ..energies.quadratic import Quadratic
from ..energies.strains import Coordinates
from ..flexures import notch, notch_outline
from ..flexures.notch import Formula
from ..mechanism.body import Body
from ..mechanism.hinge import Hinge
from ..mechanism.loads import Drive
from ..mechanism.material import Expansion, Material
from ..mechanism.mechanism import Mechanism
from ..plotting.figure_style import DARK_BLUE
from ..results.codes import RESULTS
from ..results.tables import Column, Columns, Tabular
from ..solve.equilibrium import equilibrium
from ..solve.statics.solution import Equilibrium


if TYPE_CHECKING:
    from matplotlib.axes import Axes


WEB = 0.25e-3  # smallest thickness of the necks, as built; m
TRAVEL = 1.35e-6  # input displacement in the experiments of 1978; m
MEASURED_GAIN = (27.8, 28.1)  # lowest and highest value; Scire and Teague, 1978
MEASURED_ELONGATION = 50e-9  # of hinge a, magnitude; the conditions are not stated; m
DISSERTATION_GAIN = 27.8  # section 6.4, read off its figure 6.3
RIGID_GAIN = 328 / 9  # rigid levers on pins: 36.44

_MM = 1e-3

# center of mass of each body; m
_CENTERS = {
    "1": (0.0, 0.0),
    "2": (-21 * _MM, 23 * _MM),
    "3": (-14 * _MM, 15 * _MM),
    "4": (0.0, 24 * _MM),
    "5": (14 * _MM, 15 * _MM),
    "6": (-7 * _MM, 35 * _MM),
}

# the two bodies of each hinge, and the center of its neck; m
_HINGES = {
    "a": ("2", "6", (-14 * _MM, 35 * _MM)),
    "b": ("1", "2", (-14 * _MM, 44 * _MM)),
    "c": ("2", "3", (-14 * _MM, 3 * _MM)),
    "d": ("1", "3", (-14 * _MM, 0.0)),
    "e": ("3", "4", (-14 * _MM, 24 * _MM)),
    "f": ("4", "5", (14 * _MM, 24 * _MM)),
    "g": ("5", "1", (14 * _MM, 0.0)),
}


def aluminum() -> Material:
    """Return aluminum 6061-T6, with the properties that the dissertation uses.

    The coefficient of thermal expansion is from the data sheet of the alloy.
    """
    return Material(modulus=69e9, poisson=0.33, density=2.7e3, expansion=23.6e-6)


def microstage(
    web: NumberLike = WEB,
    *,
    hole: NumberLike = 3e-3,
    width: float = 20e-3,
    material: Material | None = None,
    formula: Formula = "fitted",
    coordinates: Coordinates = "twistor",
    damping: DampingLike | None = None,
    guided: bool = True,
    more_hinges: Sequence[Hinge] = (),
) -> Mechanism:
    """Build the micropositioning stage.

    Args:
        web: Smallest thickness of the necks of the notch hinges: one value for all
            hinges, or one for each hinge from a to g; m.
        hole: Diameter of the holes on both sides of a neck; m.
        width: Thickness of the plate; m.
        material: Material of the plate. By default `aluminum()`.
        formula: Formula for the stiffness of the notches; see `flexures.notch`.
        coordinates: Coordinates of the quadratic hinge energies, "twistor" or "twist".
        damping: Damping of each hinge, used by simulations only: a `ViscousDamping`, or
            the ratio of damping to stiffness; s.
        guided: Whether body "6" can only move along x, which is the direction of the
            input displacement.
        more_hinges: Further hinges, such as an actuator between the bodies "1" and "6".

    Returns:
        A mechanism with the bodies "1" to "6" and the hinges "a" to "g", named as in the
        dissertation. Body "1" is fixed.

    Raises:
        ValueError: A dimension is not positive or outside the range of the formula, or
            `web` has neither one nor seven values.

    Source:
        Section 6.2 of the dissertation and its listing `microstage`.

    Example:
        >>> microstage()
        Mechanism of 6 bodies (1, 2, 3, 4, 5, 6), 7 hinges (a, b, c, d, e, f, g);
        fixed: 1, angle and y of 6
    """
    material = aluminum() if material is None else material

    def neck(web: NumberLike) -> tuple[Quadratic, Corners]:
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
    expansion = None
    if material.expansion is not None:
        expansion = Expansion(material, length=hole)
    hinges = []
    for name, (energy, outline) in zip(_HINGES, necks, strict=True):
        first, second, (x, y) = _HINGES[name]
        hinges.append(
            Hinge(
                name,
                first,
                second,
                energy,
                at=(0.0, x, y),
                damping=damping,
                outline=outline,
                expansion=expansion,
            )
        )
    outline = _OUTLINES["1"] * _MM - np.array(_CENTERS["1"])
    frame = Body("1", outline=outline, expansion=material.expansion)
    moving = [_moving_body(name, material, width) for name in ("2", "3", "4", "5", "6")]
    held = {"6": ("angle", "y")} if guided else {}
    fixed = {"1": ("angle", "x", "y"), **held}
    return Mechanism([frame, *moving], [*hinges, *more_hinges], fixed=fixed)


class Amplification(Tabular):
    """Displacements and forces of a stage whose input is displaced.

    Args:
        gain: Ratio of the output displacement to the input displacement.
        output: Displacement of the output, body 4, along x; m.
        input_force: Force that displaces the input; N.
        elongation: Elongation of the neck of hinge a, positive in tension; m. It is the
            displacement of the input (body 6) minus that of body 2, both at hinge a and
            along x. In the geometry of the listing, body 6 is on the +x side of hinge a:
            an input displacement along +x stretches the neck, and one along -x compresses
            it by as much.
        equilibrium: Equilibrium of the stage.
    """

    gain: Scalar
    output: Scalar
    input_force: Scalar
    elongation: Scalar
    equilibrium: Equilibrium

    @property
    def result(self) -> RESULTS:
        """Result of the solve for the equilibrium."""
        return self.equilibrium.result

    def columns(self) -> Columns:
        return {
            "gain": Column(self.gain, (), "1"),
            "output": Column(self.output, (), "m"),
            "input_force": Column(self.input_force, (), "N"),
            "elongation": Column(self.elongation, (), "m"),
            **self.equilibrium.columns(),
        }


def amplification(
    stage: Mechanism, travel: NumberLike = TRAVEL, *, throw: bool = True
) -> Amplification:
    """Compute how a stage amplifies a displacement of its input.

    Args:
        stage: A stage made by `microstage`.
        travel: Displacement of the input along x; m.
        throw: Whether a failed solve raises an error. If False, the failure is reported
            by `Amplification.result`.

    Returns:
        The gain, the displacements, and the forces.

    Raises:
        RuntimeError: No equilibrium was found, and `throw` is True.

    Source:
        Section 6.4 of the dissertation, without its transient.

    Example:
        >>> stage = microstage()
        >>> amplification(stage).gain
        Array(27.62804368, dtype=float64)
    """
    deformed = equilibrium(stage, drives=[Drive("6", x=travel)], throw=throw)
    output = deformed.displacement("4")[1]
    return Amplification(
        gain=output / travel,
        output=output,
        input_force=deformed.reaction("6")[1],
        elongation=stage.displacement_of("a", deformed)[1],
        equilibrium=deformed,
    )


@partial(fast_compile, jit=jax.jit, static_argnames="coordinates")
def amplification_and_slope(
    web: NumberLike, travel: NumberLike, coordinates: Coordinates = "twistor"
) -> tuple[Amplification, Scalar]:
    """Compute the amplification and the derivative of the gain with respect to the web.

    Args:
        web: Smallest thickness of the necks; m.
        travel: Displacement of the input along x; m.
        coordinates: Coordinates of the hinge energies, "twistor" or "twist".

    Returns:
        The amplification, whose `result` reports a failure, and the derivative of the
        gain with respect to the web; 1/m.
    """

    def gain(web: Scalar) -> tuple[Scalar, Amplification]:
        stage = microstage(web, coordinates=coordinates)
        result = amplification(stage, travel, throw=False)
        return result.gain, result

    web = jnp.asarray(web, float)
    _, slope, result = jax.jvp(gain, (web,), (jnp.ones_like(web),), has_aux=True)
    return result, slope


def plot(stage: Mechanism, result: Amplification, *, magnify: float | int = 50) -> "Axes":
    """Draw the deformed stage, with the displacements of input and output.

    Args:
        stage: A stage made by `microstage`.
        result: Amplification of this stage.
        magnify: Factor by which displacements are magnified.

    Returns:
        The axes; their unit is the millimeter.
    """
    deformed = result.equilibrium
    axes = plotting.draw(stage, deformed.poses, magnify=magnify)
    # the labels are beside the input and below the output, where the drawing is empty
    for name, word, dx, dy in (("6", "input", 14.0, 0.0), ("4", "output", 0.0, -6.5)):
        row = deformed.names.index(name)
        x, y = 1e3 * np.asarray(deformed.reference)[row, 1:] + np.array([dx, dy])
        travel = 1e6 * float(deformed.displacements[row, 1])
        label = f"{word} {travel:.4g} \N{MICRO SIGN}m"
        axes.annotate(label, (x, y - 0.8), color=DARK_BLUE, ha="center", va="top")
        style = {"arrowstyle": "->", "color": DARK_BLUE}
        axes.annotate("", (x + 3.5, y), (x - 3.5, y), arrowprops=style)
    axes.set_title(
        f"gain {float(result.gain):.3f}, {axes.get_title()}", fontsize="medium"
    )
    return axes


def _moving_body(name: str, material: Material, width: float) -> Body:
    """Make one of the bodies 2 to 6 from a plate of this thickness (m).

    If the material has no density, the body has no mass.
    """
    center = _CENTERS[name]
    outline = _OUTLINES[name] * _MM - np.array(center)
    pose = (0.0, *center)
    if material.density is None:
        return Body(name, pose=pose, outline=outline, expansion=material.expansion)
    area, second_moments = _areas(name)
    _, (density, width) = on_host(material.density, width)
    mass_per_area = density * width
    polar = np.trace(second_moments)
    about_axes = (polar + area * width**2 / 12) * np.eye(2) - second_moments
    return Body(
        name,
        pose=pose,
        mass=mass_per_area * area,
        inertia=mass_per_area * polar,
        outline=outline,
        expansion=material.expansion,
        tilt_inertia=as_float(mass_per_area * about_axes),
    )


def _areas(name: str) -> tuple[float, np.ndarray]:
    """Compute the area of a body and its second moments of area; m2, m4.

    As in the listing, a body consists of rectangles. Each has an area (mm2), two sides
    (mm), and a center relative to the body's frame (mm).
    """
    lever = [(2 * 17 * 5, (17, 5), (2.5, 7.5))]
    rectangles = {
        "2": [
            (5 * 10, (5, 10), (1, 18)),
            (21 * 6, (6, 21), (2, 8)),
            (14 * 10 / 2, (6, 9), (3, 6)),
        ],
        "3": lever,
        "4": [(10 * 28, (28, 10), (0, 0))],
        "5": lever,
        "6": [(14 * 10, (7, 50), (0, 0))],
    }[name]
    total_area = sum(area for area, _, _ in rectangles)
    moments = np.zeros((2, 2))
    for area, sides, center in rectangles:
        moments += area * (np.diag(np.square(sides)) / 12 + np.outer(center, center))
    return total_area * _MM**2, moments * _MM**4


# Corners in the reference configuration, after figure 6.1; mm. The listing has no
# outlines. These leave the slots that follow from the positions of the hinges and from
# the rectangles above.
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
