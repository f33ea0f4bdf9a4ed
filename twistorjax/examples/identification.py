"""Four things to be found from measurements: what they tell, and what they do not.

The measurements of the linkages and of the leaf are rehearsed by the library itself, with
errors of sensors where a key is given, so that what is found can be compared with what
was put in. Those of the stage are real ones.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..energies.base import AbstractEnergy, Quadratic
from ..energies.mixed import MixedEnergy
from ..flexures import Beam, Material, quartic_leaf, surrogate
from ..identification import (
    AbstractSensor,
    BodySensor,
    HingeSensor,
    Identification,
    identify,
    MotionTest,
    Parameter,
    StaticTest,
)
from ..mechanism.body import Body
from ..mechanism.hinge import Hinge
from ..mechanism.loads import Drive, Load
from ..mechanism.mechanism import Mechanism
from . import four_bar, stage


# Of a leaf of the linkages: rotation, along its axis, across it
LEAF = {"rotation": 0.14375, "along": 1.725e6, "across": 17250.0}
UNITS = {"rotation": "N m/rad", "along": "N/m", "across": "N/m"}
GUESS = {"rotation": 1.5, "along": 0.6, "across": 0.5}  # parts of the true ones
RELEASE = np.linspace(0.0, 0.05, 101)  # s


def linkage(leaf_a: Mapping[str, ArrayLike]) -> Mechanism:
    """The four-bar linkage of section 5.2, its hinge A with other stiffnesses.

    Args:
        leaf_a: "rotation", "along" and "across" its axis; N m/rad, N/m, N/m.

    Example:
        >>> linkage(LEAF)
        Mechanism of 4 bodies (1, 2, 3, 4), 4 hinges (A, B, C, D); fixed: 1
    """
    row = [jnp.asarray(leaf_a[name], float) for name in LEAF]
    energy = Quadratic(jnp.diag(jnp.stack(row)))
    damping = four_bar.RELEASED_DAMPING
    return four_bar.four_bar(damping=damping, energies={"A": energy})


def let_go(
    times: Float[ArrayLike, " times"] = RELEASE,
    *,
    angle: float = 1e-5,
    travel: float = 1e-6,
    tolerance: float = 1e-7,
) -> MotionTest:
    """Link 3 let go with 10 m/s, and followed by a camera on all three links.

    Args:
        times: of its pictures; s.
        angle: standard deviation of an angle; rad.
        travel: that of a travel; m.
        tolerance: for `simulate`.

    Example:
        >>> let_go().columns[:4]
        ('2.angle', '2.x', '2.y', '3.angle')
    """
    return MotionTest(
        times,
        _seen("234", angle, travel),
        velocities={"3": (0.0, four_bar.SPEED, 0.0)},
        tolerance=tolerance,
    )


def hinge_a(
    key: Array | None = None,
    *,
    angle: float = 1e-5,
    travel: float = 1e-6,
    **settings: Any,
) -> Identification:
    """The three stiffnesses of hinge A, from the motion of the linkage as it is let go.

    Args:
        key: of the errors of the camera; by default there are none.
        angle: standard deviation of its angles; rad.
        travel: that of its travels; m.
        settings: for `fit`.

    Example:
        >>> hinge_a().estimates["rotation"]
        Array(0.14375, dtype=float64)
    """
    start = {
        name: Parameter(GUESS[name] * value, UNITS[name], above=0)
        for name, value in LEAF.items()
    }
    test = let_go(angle=angle, travel=travel)
    return identify(linkage, start, [test.synthetic_data(linkage(LEAF), key)], **settings)


def plate(unknown: Mapping[str, ArrayLike]) -> Mechanism:
    """The stage, cut from a plate with other webs, or of another modulus.

    Args:
        unknown: "web", the thickness of the necks; m; and, if it is there, "modulus",
            over that of aluminium.
    """
    alloy = stage.aluminium()
    modulus = unknown.get("modulus", 1.0) * alloy.modulus
    softer = Material(modulus=modulus, poisson=alloy.poisson, density=alloy.density)
    return stage.microstage(unknown["web"], material=softer)


def stage_web(compression: bool = True, **settings: Any) -> Identification:
    """The web and the modulus of the stage, from what was measured on it in 1978.

    One number, the gain, tells one other: a web of 243.6 um, with which the model has a
    gain of 27.95, half way between those measured. Of the modulus it tells nothing, nor
    does any other length that follows from a length: stiffnesses that are all scaled by
    one factor move every body as before. A force would tell it.

    The compression of hinge a, 50 nm, cannot be met by either: it and the gain contradict
    each other by nine of their standard deviations, in this model.

    Args:
        compression: whether the compression of hinge a is taken, too, for good to 10 nm;
            Scire and Teague do not tell its error, nor the conditions.
        settings: for `fit`.

    Source:
        Scire and Teague, Review of Scientific Instruments 49, 1978.
    """
    low, high = stage.MEASURED_GAIN
    middle, half = (low + high) / 2, (high - low) / 2
    sensors: list[AbstractSensor] = [BodySensor("4", "x", half * stage.TRAVEL)]
    readings = [middle * stage.TRAVEL]
    start = {"web": Parameter(stage.WEB, "m", above=0.1e-3, below=0.5e-3)}
    if compression:
        sensors.append(HingeSensor("a", "x", 10e-9))
        readings.append(stage.MEASURED_COMPRESSION)
        start["modulus"] = Parameter(1.0, above=0)
    moved = StaticTest([[Drive("6", x=stage.TRAVEL)]], sensors)
    return identify(plate, start, [moved.measured([readings])], **settings)


def bench(energy: AbstractEnergy) -> Mechanism:
    """A table on two leaves, and a flag on a third: three leaves of one energy.

    The table is guided, so that its leaves bend to an S; the flag's bends as it likes.
    """
    up, height = jnp.pi / 2, 50e-3
    bodies = [
        Body("base"),
        Body("table", pose=(0.0, 0.0, height)),
        Body("flag", pose=(0.0, 0.2, height)),
    ]
    places = {"left": ("table", -0.04), "right": ("table", 0.04), "third": ("flag", 0.2)}
    hinges = [
        Hinge(name, "base", body, energy, at=(up, x, height / 2))
        for name, (body, x) in places.items()
    ]
    return Mechanism(bodies, hinges, fixed=["base"])


def blade() -> dict[str, Any]:
    """The leaves of the `bench`, of steel."""
    steel = Material(modulus=210e9, poisson=0.3)
    return {"material": steel, "length": 50e-3, "thickness": 0.5e-3, "width": 10e-3}


def bench_of(parts: Mapping[str, ArrayLike]) -> Mechanism:
    """The `bench` with leaves of five terms, each a part of what beam theory says.

    Args:
        parts: of "turn" and "shift", the energies of turning and of being guided across;
            of "turn_shortens" and "shift_shortens", by how much these draw the ends
            together; and of "give", along the axis.
    """
    leaf = quartic_leaf(**blade())
    named: dict[tuple[int, ...], str] = {
        (2, 0, 0): "turn",
        (0, 2, 0): "shift",
        (0, 2, 1): "shift_shortens",
        (2, 0, 1): "turn_shortens",
        (0, 0, 2): "give",
    }
    row = jnp.stack([jnp.asarray(parts[named[each]], float) for each in leaf.powers])
    return bench(
        MixedEnergy(
            leaf.coefficients * row, leaf.powers, length=leaf.length, force=leaf.force
        )
    )


def leaf_on_bench(key: Array | None = None, **settings: Any) -> Identification:
    """The coefficients of a leaf's energy, from what a mechanism of three does.

    What is measured has exact beams for leaves; what is fitted starts far from them. The
    table's sinking tells how much a leaf shortens as it is guided, the flag's swing how
    much as it turns. All five are one, where beam theory is right.

    Args:
        key: of the errors of the sensors; by default there are none.
        settings: for `fit`.
    """
    size = blade()
    material = size.pop("material")
    exact = bench(surrogate(Beam(material, **size), turn=0.5))
    trials = [
        *([Load("table", (0.0, push, 0.0))] for push in (1.0, 2.0, 3.0)),
        *([Load("table", (0.0, 2.0, pull))] for pull in (-5.0, 50.0)),
        *([Load("flag", (moment, 0.0, 0.0))] for moment in (0.05, 0.1)),
        [Load("flag", (0.0, 0.3, 0.5))],
    ]
    test = StaticTest(trials, _seen(("table", "flag"), 20e-6, 0.2e-6))
    guess = {
        "turn": 1.3,
        "shift": 0.7,
        "turn_shortens": 0.5,
        "shift_shortens": 0.5,
        "give": 2.0,
    }
    start = {name: Parameter(part, above=0) for name, part in guess.items()}
    return identify(bench_of, start, [test.synthetic_data(exact, key)], **settings)


def irregular(stiffness: Mapping[str, Array]) -> Mechanism:
    """The four-bar linkage of section 5.3, with other stiffnesses.

    Args:
        stiffness: of each hinge: rotation, along its axis, across it; N m/rad, N/m, N/m.
    """
    energies = {name: Quadratic(jnp.diag(row)) for name, row in stiffness.items()}
    return four_bar.four_bar("mixed", energies=energies)


def twelve(key: Array | None = None, **settings: Any) -> Identification:
    """All stiffnesses of the irregular linkage, from its motion as link 2 is turned.

    A camera follows the links, and the drive tells the moment that it takes. Without the
    moment no stiffness could be told but for a common factor. The four rotations are
    hardly told apart: the moment is their sum, nearly.

    Args:
        key: of the errors of the sensors; by default there are none.
        settings: for `fit`.
    """
    linkage = four_bar.four_bar("mixed")
    true = {
        name: jnp.diagonal(linkage.hinge_assembly.energy_of(row).stiffness)  # pyright: ignore
        for row, name in enumerate(linkage.hinge_names)
    }
    test = MotionTest(
        np.linspace(0.0, 0.405, 82),
        [
            *_seen("34", 1e-5, 1e-6),
            *(BodySensor("2", name, 1e-6) for name in ("x", "y")),
            BodySensor("2", "moment", 1e-4),
        ],
        drives=four_bar.turn,
    )
    start = {
        name: Parameter(row * jnp.array([1.5, 0.6, 0.7]), tuple(UNITS.values()), above=0)
        for name, row in true.items()
    }
    return identify(
        irregular, start, [test.synthetic_data(irregular(true), key)], **settings
    )


def _seen(bodies: Iterable[str], angle: float, travel: float) -> list[BodySensor]:
    """What a camera sees: angles, and travels along x and y."""
    return [
        sensor
        for body in bodies
        for sensor in (
            BodySensor(body, "angle", angle),
            BodySensor(body, "x", travel),
            BodySensor(body, "y", travel),
        )
    ]
