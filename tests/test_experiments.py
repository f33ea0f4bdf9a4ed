"""Sensors, tests on mechanisms, synthetic data, and the ranking of further tests."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from identification_helpers import positive, push, push_series, spring, TRUE

import twistorjax as tj
from twistorjax.examples import four_bar
from twistorjax.identification import (
    BodySensor,
    FunctionSensor,
    HingeSensor,
    HingeTest,
    MotionTest,
    rank_experiments,
    StaticTest,
    VibrationTest,
)
from twistorjax.identification.experiments.sensors import BodyQuantity, HingeQuantity


@pytest.fixture(scope="module")
def linkage():
    return four_bar.four_bar(damping=1e-3)


@pytest.fixture(scope="module")
def motion(linkage):
    times = np.linspace(0.0, 0.05, 201)
    return four_bar.driven_motion(linkage, times, tolerance=1e-8)


def read(sensors, linkage, motion):
    """Return the readings of several sensors, as one program."""

    @eqx.filter_jit
    def readings(linkage, motion):
        return [sensor.read(linkage, motion) for sensor in sensors]

    return map(np.asarray, readings(linkage, motion))


def test_a_sensor_at_a_point_follows_the_frame_of_the_body(linkage, motion):
    """Positions are compared with rotation matrices, velocities with differences."""
    point = np.array([0.02, -0.003])
    angle, x, y = np.asarray(motion.pose("3")).T
    cos, sin = np.cos(angle), np.sin(angle)
    position = np.stack(
        [x + cos * point[0] - sin * point[1], y + sin * point[0] + cos * point[1]]
    )
    reference = np.asarray(linkage.reference[linkage.index("3"), 1:]) + point
    step = motion.times[1]
    quantities: list[tuple[BodyQuantity, BodyQuantity]] = [
        ("x", "velocity_x"),
        ("y", "velocity_y"),
    ]
    for k, (name, rate) in enumerate(quantities):
        sensors = [
            BodySensor("3", name, 1.0, at=point),
            BodySensor("3", name, 1.0, at=point, absolute=True),
            BodySensor("3", rate, 1.0, at=point),
        ]
        displacement, absolute, velocity = read(sensors, linkage, motion)
        assert_close(displacement, position[k] - reference[k], digits=12)
        assert_close(absolute, position[k], digits=12)
        difference = (position[k][2:] - position[k][:-2]) / (2 * step)
        # The vibration of the stiff hinges decays in the first steps.
        error = np.abs(velocity[1:-1] - difference)[20:]
        assert np.max(error) < 2e-4 * np.abs(difference).max()


def test_sensors_read_the_quantities_of_the_motion(linkage, motion):
    displacement, velocity = (
        np.asarray(rows) for rows in (motion.displacement("3"), motion.velocity("3"))
    )
    of_body: dict[BodyQuantity, np.ndarray] = {
        "angle": displacement[:, 0],
        "x": displacement[:, 1],
        "angular_velocity": velocity[:, 0],
        "velocity_y": velocity[:, 2],
    }
    sensors = [BodySensor("3", quantity, 1.0) for quantity in of_body]
    readings = read(sensors, linkage, motion)
    for reading, expected in zip(readings, of_body.values(), strict=True):
        assert_close(reading, expected)
    pose = motion.poses[100]
    displacement = np.asarray(linkage.displacement_of("A", pose))
    wrench = np.asarray(linkage.wrench_of("A", pose))
    of_hinge: dict[HingeQuantity, np.ndarray] = {
        "angle": displacement[0],
        "y": displacement[2],
        "moment": wrench[0],
        "force_2": wrench[2],
    }
    sensors = [HingeSensor("A", quantity, 1.0) for quantity in of_hinge]
    readings = read(sensors, linkage, motion)
    for reading, expected in zip(readings, of_hinge.values(), strict=True):
        assert_close(reading[100], expected, digits=9)
    moment = BodySensor("2", "moment", 1.0)
    energy = FunctionSensor(
        lambda _, solution: solution.energies.elastic, "energy", "J", 1.0
    )
    moments, energies = read([moment, energy], linkage, motion)
    assert_close(moments, np.asarray(motion.reaction("2"))[:, 0])
    assert_close(energies, motion.energies.elastic)


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: BodySensor("3", "speed", 1.0),  # pyright: ignore[reportArgumentType]
            "`quantity` is 'speed', but must be one of",
        ),
        (
            lambda: BodySensor("3", "x", 0.0),
            r"`standard_deviation` of the sensor '3.x' is 0",
        ),
        (
            lambda: BodySensor("3", "angle", 1.0, at=(0, 0)),
            "is the same at all its points",
        ),
        (
            lambda: BodySensor("3", "moment", 1.0, absolute=True),
            "the moment of a body does not depend on its reference pose",
        ),
        (lambda: HingeSensor("A", "force_x", 1.0), "`quantity` is 'force_x'"),  # pyright: ignore[reportArgumentType]
        (lambda: StaticTest([], [BodySensor("3", "x", 1.0)]), "`load_cases` is empty"),
        (lambda: StaticTest([[]], []), "`sensors` is empty"),
        (lambda: StaticTest([tj.Load("3", (0, 0, 0))], []), "put this one in"),  # pyright: ignore[reportArgumentType]
        (lambda: MotionTest([0, 0], [BodySensor("3", "x", 1.0)]), "must increase"),
        (lambda: MotionTest([0, 1], [BodySensor("3", "x", 1.0)]), "Nothing sets"),
        (
            lambda: VibrationTest(1, 1.0).measurement([[jnp.inf]]),
            "has an infinite entry",
        ),
        (
            lambda: VibrationTest(2, 1.0).measurement([[1.0], []]),
            "different lengths",
        ),
        (lambda: VibrationTest(0, 1.0), "`count` is 0"),
        (lambda: VibrationTest(2, [1.0, 0.0]), "must be positive"),
        (
            lambda: VibrationTest(2, [1.0, 1.0, 1.0]),
            "`standard_deviation` has shape",
        ),
        (lambda: HingeTest("A", [[0.0, 0.0]], (1, 1, 1)), "`poses` has shape"),
        (
            lambda: VibrationTest(2, 1.0).measurement([[1.0]]),
            "must have 2 rows of 1",
        ),
        (lambda: VibrationTest(1, 1.0).measurement([[jnp.nan]]), "has no reading"),
        (
            lambda: VibrationTest(1, 1.0).measurement([[1.0]], np.array([[-1.0]])),
            "must be positive",
        ),
        (
            lambda: VibrationTest(1, 1.0).measurement([[1.0]], np.array([1.0, 2.0])),
            "but must have shape",
        ),
    ],
)
def test_wrong_sensors_and_tests_are_rejected(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        (BodySensor("5", "x", 1.0), "`body` is '5', but the bodies are"),
        (HingeSensor("E", "x", 1.0), "names the hinge 'E'"),
        (BodySensor("block", "velocity_x", 1.0), "only a motion has velocities"),
    ],
)
def test_a_sensor_that_does_not_fit_the_mechanism_is_rejected(sensor, message):
    with pytest.raises(ValueError, match=message):
        StaticTest([[]], [sensor]).predict(spring(TRUE))


def test_more_frequencies_than_the_mechanism_has_are_rejected(linkage):
    with pytest.raises(ValueError, match="has only 9 natural frequencies"):
        VibrationTest(10, 1.0).predict(linkage)


@pytest.mark.slow
def test_load_cases_of_different_kinds_are_read_in_their_order(linkage):
    """Each row is compared with a separate equilibrium."""
    load_cases = [
        [tj.Load("3", (0.0, 2.0, 0.0))],
        [tj.Drive("2", angle=0.1)],
        [tj.Load("3", (0.0, -1.0, 0.0)), tj.Load("4", (0.01, 0.0, 0.0))],
        [tj.Load("3", (0.0, 1.0, 0.0)), tj.Load("3", (0.0, 1.0, 0.0), at=(0.01, 0))],
        [tj.Drive("2", angle=0.2), tj.Load("4", (0.0, 0.0, 3.0), follower=True)],
    ]
    sensors = [BodySensor("3", "x", 1.0), BodySensor("4", "angle", 1.0)]
    readings = StaticTest(load_cases, sensors).predict(linkage)
    for row, load_case in zip(readings, load_cases, strict=True):
        loads = [part for part in load_case if isinstance(part, tj.Load)]
        drives = [part for part in load_case if isinstance(part, tj.Drive)]
        solution = tj.equilibrium(linkage, loads=loads, drives=drives)
        expected = [solution.displacement("3")[1], solution.displacement("4")[0]]
        assert_close(row, jnp.stack(expected), digits=9)


def test_measured_frequencies_must_be_positive_and_ascending():
    test = VibrationTest(3, 1.0)
    test.measurement([[1.0], [np.nan], [1.0]])
    with pytest.raises(ValueError, match=r"`values\[2\]`: the frequency is 1 Hz and fol"):
        test.measurement([[2.0], [np.nan], [1.0]])
    with pytest.raises(ValueError, match=r"`values\[0\]`: the frequency is -1 Hz"):
        test.measurement([[-1.0], [2.0], [3.0]])


@pytest.mark.slow
def test_the_errors_of_synthetic_data_have_the_given_standard_deviation():
    test = push_series(400 * [0.1], standard_deviation=1e-5)
    noisy = test.synthetic_data(spring(TRUE), jax.random.key(0))
    assert abs(float(jnp.std(noisy.values)) / 1e-5 - 1) < 0.15
    exact = test.synthetic_data(spring(TRUE))
    assert_close(exact.values, jnp.full((400, 1), 1e-3), digits=8)


def test_an_error_names_the_test_that_does_not_fit_the_mechanism():
    other = StaticTest([[tj.Load("arm", (0, 1, 0))]], [BodySensor("block", "x", 1)])
    data = [other.measurement([[0.0]])]
    message = r"StaticTest of 1 load case, .*: .* body 'arm', but"
    with pytest.raises(ValueError, match=message):
        tj.identify(spring, dict(TRUE), data)


def test_the_ranking_follows_from_the_determinant_of_the_information():
    """The information on each ln k is (F / (k s))^2, and the matrix is diagonal."""
    true = {"rotation": 2.0, "along": 100.0, "across": 50.0}
    order = ["rotation", "along", "across"]

    def static_test(wrench, sensors: dict[BodyQuantity, float]):
        load = tj.Load("block", tuple(1e-3 * np.array(wrench)))
        return StaticTest(
            [[load]],
            [BodySensor("block", name, deviation) for name, deviation in sensors.items()],
        )

    along = push(1e-3, standard_deviation=1e-6)
    start = {name: positive(value) for name, value in true.items()}
    data = [along.measurement([[1e-3 / 100.0]])]
    result = tj.identify(spring, start, data, throw=False)
    tests = {
        "again": along,
        "better": push(5e-3, standard_deviation=1e-6),
        "all": static_test((1.0, 5.0, 3.0), {"angle": 1e-4, "x": 1e-6, "y": 1e-6}),
    }
    ranking = rank_experiments(result, tests, count=2)

    def information(force, stiffness, deviation):
        return (1e-3 * force / (stiffness * deviation)) ** 2

    rotation = information(1, 2, 1e-4)
    across = information(3, 50, 1e-6)
    strong, weak = (information(force, 100, 1e-6) for force in (5, 1))
    before = np.array([1.0, 1 + weak, 1.0])  # with the prior information of 1
    added = {
        "again": [0, weak, 0],
        "better": [0, strong, 0],
        "all": [rotation, strong, across],
        "all, block.y alone": [0, 0, across],
    }
    candidates = {candidate.name: candidate for candidate in ranking.candidates}
    entries = [result.names.index(name) for name in order]
    for name, row in added.items():
        total = before + np.array(row)
        candidate = candidates[name]
        gain = np.log(total / before).sum() / 2
        np.testing.assert_allclose(candidate.information_gain, gain, rtol=1e-3)
        errors = np.asarray(candidate.standard_errors)[entries]
        np.testing.assert_allclose(errors, total**-0.5, rtol=1e-3)
    assert ranking.candidates[0].name == "all"
    assert ranking.selected[0] == "all"
    assert "selected: all, " in repr(ranking)
    after = before + np.array(added["all"]) + np.array(added[ranking.selected[1]])
    errors = np.asarray(ranking.standard_errors_after)[entries]
    np.testing.assert_allclose(errors, after**-0.5, rtol=1e-3)
    with pytest.raises(ValueError, match="`candidates` is empty"):
        rank_experiments(result, {})
    with pytest.raises(ValueError, match="`count` is 4, but must be between 1 and"):
        rank_experiments(result, tests, count=4)
