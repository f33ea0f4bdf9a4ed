"""Four identification problems with synthetic or published measurements.

Start reading in `identify_hinge_a`. The measurements of the linkages and of the leaf are
synthetic data, computed by the library itself. A random key adds sensor errors to them.
The estimates can therefore be compared with the true values. The measurements of the
stage are real.
"""

from collections.abc import Iterable
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._utils.host import as_float, on_host
from .._utils.types import Key, NamedNumbers, TimesLike
from ..energies.base import AbstractEnergy
from ..energies.mixed import MixedEnergy
from ..energies.quadratic import Quadratic
from ..flexures import Beam, quartic_leaf, surrogate
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
from ..mechanism.material import Material
from ..mechanism.mechanism import Mechanism
from . import four_bar, stage


# stiffnesses of one leaf of the four-bar linkage: rotation about its center, and
# translation along and across its axis
LEAF = {"rotation": 0.14375, "axial": 1.725e6, "transverse": 17250.0}
UNITS = {"rotation": "N m/rad", "axial": "N/m", "transverse": "N/m"}
START_RATIOS = {"rotation": 1.5, "axial": 0.6, "transverse": 0.5}  # start / true value
CAMERA_TIMES = np.linspace(0.0, 0.05, 101)  # s

# dimensions of the leaves on the `leaf_bench`; m
LEAF_LENGTH = 50e-3
LEAF_THICKNESS = 0.5e-3
LEAF_WIDTH = 10e-3


def linkage(stiffnesses: NamedNumbers) -> Mechanism:
    """Build the four-bar linkage of section 5.2 with given stiffnesses of hinge A.

    Args:
        stiffnesses: Stiffnesses of hinge A: "rotation" (N m/rad), "axial" (N/m), and
            "transverse" (N/m).

    Returns:
        The linkage. Its damping is that of the released linkage.

    Example:
        >>> linkage(LEAF)
        Mechanism of 4 bodies (1, 2, 3, 4), 4 hinges (A, B, C, D); fixed: 1
    """
    numbers, diagonal = on_host(*(as_float(stiffnesses[name]) for name in LEAF))
    energy = Quadratic(numbers.diag(numbers.stack(diagonal)))
    return four_bar.four_bar(damping=four_bar.RELEASED_DAMPING, energies={"A": energy})


def release_test(
    times: TimesLike = CAMERA_TIMES,
    *,
    angle_deviation: float = 1e-5,
    position_deviation: float = 1e-6,
    tolerance: float = 1e-7,
) -> MotionTest:
    """Describe a test in which the linkage is released and a camera measures its motion.

    Link 3 starts with a velocity of 10 m/s along x. The camera measures the angles and
    positions of links 2, 3, and 4.

    Args:
        times: Times of the readings; s.
        angle_deviation: Standard deviation of the measured angles; rad.
        position_deviation: Standard deviation of the measured positions; m.
        tolerance: Tolerance of `simulate`.

    Returns:
        The test, with nine readings at each time.

    Example:
        >>> release_test().columns[:4]
        ('2.angle', '2.x', '2.y', '3.angle')
    """
    return MotionTest(
        times,
        _camera(("2", "3", "4"), angle_deviation, position_deviation),
        velocities={"3": (0.0, four_bar.RELEASE_SPEED, 0.0)},
        tolerance=tolerance,
    )


def identify_hinge_a(
    key: Key | None = None,
    *,
    angle_deviation: float = 1e-5,
    position_deviation: float = 1e-6,
    **settings: Any,
) -> Identification:
    """Identify the three stiffnesses of hinge A from the motion of the released linkage.

    Args:
        key: Random key of the camera's errors. By default there are no errors.
        angle_deviation: Standard deviation of the camera's angles; rad.
        position_deviation: Standard deviation of the camera's positions; m.
        settings: Further arguments of `identify`.

    Returns:
        The estimates and their uncertainty.

    Example:
        >>> result = identify_hinge_a()
        >>> result.estimates["rotation"]  # N m/rad
        Array(0.14375, dtype=float64)
    """
    start = {
        name: Parameter(START_RATIOS[name] * value, UNITS[name], lower=0)
        for name, value in LEAF.items()
    }
    test = release_test(
        angle_deviation=angle_deviation, position_deviation=position_deviation
    )
    data = test.synthetic_data(linkage(LEAF), key)
    return identify(linkage, start, [data], **settings)


def stage_model(parameters: NamedNumbers) -> Mechanism:
    """Build the micropositioning stage with another web or another Young's modulus.

    Args:
        parameters: "web", the smallest thickness of the necks (m), and optionally
            "modulus", the ratio of Young's modulus to that of aluminum.

    Returns:
        The stage.
    """
    alloy = stage.aluminum()
    modulus = parameters.get("modulus", 1.0) * alloy.modulus
    material = Material(modulus=modulus, poisson=alloy.poisson, density=alloy.density)
    return stage.microstage(parameters["web"], material=material)


def identify_stage_web(elongation: bool = True, **settings: Any) -> Identification:
    """Identify the web and Young's modulus of the stage from measurements of 1978.

    The gain is one number and determines one parameter: a web of 243.6 um, with which the
    model has a gain of 27.95, the center of the measured interval. Displacements do not
    determine the modulus: if all stiffnesses are scaled by one factor, every body moves
    as before. A measured force would determine it.

    No web and no modulus gives both the measured gain and the measured elongation of
    hinge a, 50 nm. In the best fit, the residual of the gain is 4 standard deviations and
    that of the elongation 12 standard deviations.

    Args:
        elongation: Whether the elongation of hinge a is used as well, with an assumed
            standard deviation of 10 nm. Scire and Teague state neither its error nor the
            conditions of the measurement.
        settings: Further arguments of `identify`.

    Returns:
        The estimates and their uncertainty.

    Source:
        Scire and Teague, Review of Scientific Instruments 49, 1978.
    """
    low, high = stage.MEASURED_GAIN
    gain, gain_deviation = (low + high) / 2, (high - low) / 2
    sensors: list[AbstractSensor] = [BodySensor("4", "x", gain_deviation * stage.TRAVEL)]
    readings = [gain * stage.TRAVEL]
    start = {"web": Parameter(stage.WEB, "m", lower=0.1e-3, upper=0.5e-3)}
    if elongation:
        sensors.append(HingeSensor("a", "x", 10e-9))
        readings.append(stage.MEASURED_ELONGATION)
        start["modulus"] = Parameter(1.0, lower=0)
    input_displacement = Drive("6", x=stage.TRAVEL)
    test = StaticTest([[input_displacement]], sensors)
    return identify(stage_model, start, [test.measurement([readings])], **settings)


def leaf_bench(energy: AbstractEnergy) -> Mechanism:
    """Build a test bench for leaves: a table on two leaves, and a flag on a third leaf.

    The two leaves guide the table, so they bend into an S shape. The flag is free to
    rotate.

    Args:
        energy: Energy of all three leaves.

    Returns:
        The bench, with the bodies "base" (fixed), "table", and "flag".
    """
    up, height = jnp.pi / 2, LEAF_LENGTH
    return Mechanism(
        bodies=[
            Body("base"),
            Body("table", pose=(0.0, 0.0, height)),
            Body("flag", pose=(0.0, 0.2, height)),
        ],
        hinges=[
            Hinge("left", "base", "table", energy, at=(up, -0.04, height / 2)),
            Hinge("right", "base", "table", energy, at=(up, 0.04, height / 2)),
            Hinge("third", "base", "flag", energy, at=(up, 0.2, height / 2)),
        ],
        fixed=["base"],
    )


def steel() -> Material:
    """Return the material of the leaves on the `leaf_bench`."""
    return Material(modulus=210e9, poisson=0.3)


def scaled_leaf_bench(factors: NamedNumbers) -> Mechanism:
    """Build the `leaf_bench` with leaves whose energy has five scaled coefficients.

    Args:
        factors: Ratio of each coefficient to its value by beam theory: "rotation" and
            "transverse" scale the energies of a rotation and of a transverse
            displacement, "rotation_shortening" and "transverse_shortening" scale how much
            these reduce the distance of the ends, and "axial_compliance" scales the
            extension under an axial force.

    Returns:
        The bench, with three leaves of this energy.
    """
    leaf = quartic_leaf(
        steel(), length=LEAF_LENGTH, thickness=LEAF_THICKNESS, width=LEAF_WIDTH
    )
    # by the powers of rotation, transverse displacement, and axial force
    names: dict[tuple[int, ...], str] = {
        (2, 0, 0): "rotation",
        (0, 2, 0): "transverse",
        (0, 2, 1): "transverse_shortening",
        (2, 0, 1): "rotation_shortening",
        (0, 0, 2): "axial_compliance",
    }
    scales = [jnp.asarray(factors[names[powers]], float) for powers in leaf.powers]
    energy = MixedEnergy(
        leaf.coefficients * jnp.stack(scales),
        leaf.powers,
        length=leaf.length,
        force=leaf.force,
    )
    return leaf_bench(energy)


def identify_leaf(key: Key | None = None, **settings: Any) -> Identification:
    """Identify the coefficients of a leaf's energy from static tests on the bench.

    The synthetic data are those of geometrically exact beams. The vertical displacement
    of the table determines how much a leaf shortens under a transverse displacement; the
    motion of the flag determines how much it shortens under a rotation. If beam theory
    holds, all five factors are 1.

    Args:
        key: Random key of the sensor errors. By default there are no errors.
        settings: Further arguments of `identify`.

    Returns:
        The estimates of the five factors of `scaled_leaf_bench`, and their uncertainty.
    """
    beam = Beam(steel(), length=LEAF_LENGTH, thickness=LEAF_THICKNESS, width=LEAF_WIDTH)
    exact = leaf_bench(surrogate(beam, rotation=0.5))
    load_cases = [
        [Load("table", force=(1.0, 0.0))],
        [Load("table", force=(2.0, 0.0))],
        [Load("table", force=(3.0, 0.0))],
        [Load("table", force=(2.0, -5.0))],
        [Load("table", force=(2.0, 50.0))],
        [Load("flag", moment=0.05)],
        [Load("flag", moment=0.1)],
        [Load("flag", force=(0.3, 0.5))],
    ]
    sensors = _camera(("table", "flag"), angle_deviation=20e-6, position_deviation=0.2e-6)
    data = StaticTest(load_cases, sensors).synthetic_data(exact, key)
    start = {
        "rotation": Parameter(1.3, lower=0),
        "transverse": Parameter(0.7, lower=0),
        "rotation_shortening": Parameter(0.5, lower=0),
        "transverse_shortening": Parameter(0.5, lower=0),
        "axial_compliance": Parameter(2.0, lower=0),
    }
    return identify(scaled_leaf_bench, start, [data], **settings)


def leaf_and_notch_linkage(stiffnesses: NamedNumbers) -> Mechanism:
    """Build the four-bar linkage of section 5.3 with given stiffnesses of all hinges.

    Args:
        stiffnesses: Rotational (N m/rad), axial (N/m), and transverse (N/m) stiffness of
            each hinge, by name.

    Returns:
        The linkage.
    """
    energies = {name: Quadratic(jnp.diag(row)) for name, row in stiffnesses.items()}
    return four_bar.four_bar("leaves-and-notches", energies=energies)


def identify_twelve_stiffnesses(
    key: Key | None = None, **settings: Any
) -> Identification:
    """Identify all stiffnesses of leaves and notches from the driven motion of a linkage.

    The linkage is that of section 5.3. A camera follows the links, and the moment on link
    2 is measured. Without the moment, the stiffnesses would only be determined up to a
    common factor. The four rotational
    stiffnesses are strongly correlated, because the moment is nearly proportional to
    their sum.

    Args:
        key: Random key of the sensor errors. By default there are no errors.
        settings: Further arguments of `identify`.

    Returns:
        The estimates and their uncertainty.
    """
    linkage = four_bar.four_bar("leaves-and-notches")
    true = {
        name: jnp.diagonal(linkage.hinge_assembly.energy_of(row).stiffness)  # pyright: ignore
        for row, name in enumerate(linkage.hinge_names)
    }
    sensors = [
        *_camera(("3", "4"), angle_deviation=1e-5, position_deviation=1e-6),
        BodySensor("2", "x", 1e-6),
        BodySensor("2", "y", 1e-6),
        BodySensor("2", "moment", 1e-4),
    ]
    test = MotionTest(
        np.linspace(0.0, 0.405, 82), sensors, drives=four_bar.crank_rotation
    )
    start_ratios = jnp.array([1.5, 0.6, 0.7])
    units = tuple(UNITS.values())
    start = {
        name: Parameter(start_ratios * row, units, lower=0) for name, row in true.items()
    }
    data = test.synthetic_data(leaf_and_notch_linkage(true), key)
    return identify(leaf_and_notch_linkage, start, [data], **settings)


def _camera(
    bodies: Iterable[str], angle_deviation: float, position_deviation: float
) -> list[BodySensor]:
    """List the sensors of a camera: angle, x, and y of each body; rad, m, m."""
    sensors = []
    for body in bodies:
        sensors.append(BodySensor(body, "angle", angle_deviation))
        sensors.append(BodySensor(body, "x", position_deviation))
        sensors.append(BodySensor(body, "y", position_deviation))
    return sensors
