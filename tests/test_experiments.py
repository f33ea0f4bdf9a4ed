"""Tests on mechanisms: what sensors read, files of readings, which test to do next."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close

import twistorjax as tj
from twistorjax.examples import four_bar


@pytest.fixture(scope="module")
def linkage():
    return four_bar.four_bar(damping=1e-3)


@pytest.fixture(scope="module")
def moved(linkage):
    times = jnp.linspace(0.0, 0.05, 201)
    return four_bar.drive(linkage, times, tolerance=1e-8)


def test_a_point_on_a_body_is_where_its_frame_takes_it(linkage, moved):
    """Against products of matrices, and its velocity against differences in time."""
    arm = np.array([0.02, -0.003])
    angle, x, y = np.asarray(moved.pose("3")).T
    cos, sin = np.cos(angle), np.sin(angle)
    there = np.stack([x + cos * arm[0] - sin * arm[1], y + sin * arm[0] + cos * arm[1]])
    solution = np.asarray(linkage.reference[linkage.index("3"), 1:]) + arm
    step = moved.times[1]
    for k, name in enumerate("xy"):
        sensor = tj.identification.BodySensor("3", name, 1.0, at=arm)
        assert_close(sensor.read(linkage, moved), there[k] - solution[k], digits=12)
        sensor = tj.identification.BodySensor("3", name, 1.0, at=arm, absolute=True)
        assert_close(sensor.read(linkage, moved), there[k], digits=12)
        speed = tj.identification.BodySensor("3", f"velocity_{name}", 1.0, at=arm).read(
            linkage, moved
        )
        slope = (there[k][2:] - there[k][:-2]) / (2 * step)
        gap = np.abs(speed[1:-1] - slope)[20:]  # once the stiff hinges have settled
        assert np.max(gap) < 2e-4 * np.abs(slope).max()


def test_sensors_read_what_the_motion_tells(linkage, moved):
    for name, told in (
        ("angle", moved.displacement("3")[:, 0]),
        ("x", moved.displacement("3")[:, 1]),
        ("angular_velocity", moved.velocity("3")[:, 0]),
        ("velocity_y", moved.velocity("3")[:, 2]),
    ):
        assert_close(
            tj.identification.BodySensor("3", name, 1.0).read(linkage, moved), told
        )
    moment = tj.identification.BodySensor("2", "moment", 1.0)
    assert_close(moment.read(linkage, moved), moved.reaction("2")[:, 0])
    pose = moved.poses[100]
    gauges = [
        tj.identification.HingeSensor("A", name, 1.0)
        for name in ("angle", "y", "moment", "force_2")
    ]
    strained, borne = linkage.displacement_of("A", pose), linkage.wrench_of("A", pose)
    told = [strained[0], strained[2], borne[0], borne[2]]
    for gauge, value in zip(gauges, told, strict=True):
        assert_close(gauge.read(linkage, moved)[100], value, digits=9)
    energy = tj.identification.FunctionSensor(
        lambda _, answer: answer.energies.elastic, "energy", "J", 1.0
    )
    assert_close(energy.read(linkage, moved), moved.energies.elastic)


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: tj.identification.BodySensor("3", "speed", 1.0),
            "`quantity` is 'speed', but must be one of",
        ),
        (
            lambda: tj.identification.BodySensor("3", "x", 0.0),
            r"`deviation` of the sensor '3.x' is 0",
        ),
        (
            lambda: tj.identification.BodySensor("3", "angle", 1.0, at=(0, 0)),
            "is one for all its points",
        ),
        (
            lambda: tj.identification.BodySensor("3", "moment", 1.0, absolute=True),
            "the moment has no place",
        ),
        (
            lambda: tj.identification.HingeSensor("A", "force_x", 1.0),
            "`quantity` is 'force_x'",
        ),
        (
            lambda: tj.identification.StaticTest(
                [], [tj.identification.BodySensor("3", "x", 1.0)]
            ),
            "`trials` is empty",
        ),
        (lambda: tj.identification.StaticTest([[]], []), "`sensors` is empty"),
        (
            lambda: tj.identification.StaticTest([tj.Load("3", (0, 0, 0))], []),
            "put this one in",
        ),
        (
            lambda: tj.identification.MotionTest(
                [0, 0], [tj.identification.BodySensor("3", "x", 1.0)]
            ),
            "must increase",
        ),
        (
            lambda: tj.identification.MotionTest(
                [0, 1], [tj.identification.BodySensor("3", "x", 1.0)]
            ),
            "Nothing sets",
        ),
        (
            lambda: tj.identification.VibrationTest(1, 1.0).measured([[jnp.inf]]),
            "is infinite somewhere",
        ),
        (
            lambda: tj.identification.VibrationTest(2, 1.0).measured([[1.0], []]),
            "different lengths",
        ),
        (lambda: tj.identification.VibrationTest(0, 1.0), "`count` is 0"),
        (lambda: tj.identification.VibrationTest(2, [1.0, 0.0]), "must be positive"),
        (
            lambda: tj.identification.VibrationTest(2, [1.0, 1.0, 1.0]),
            "`deviation` has shape",
        ),
        (
            lambda: tj.identification.HingeTest("A", [[0.0, 0.0]], (1, 1, 1)),
            "`poses` has shape",
        ),
        (
            lambda: tj.identification.VibrationTest(2, 1.0).measured([[1.0]]),
            "reads 2 rows of 1",
        ),
        (
            lambda: tj.identification.VibrationTest(1, 1.0).measured([[jnp.nan]]),
            "has no reading",
        ),
        (
            lambda: tj.identification.VibrationTest(1, 1.0).measured([[1.0]], [[-1.0]]),
            "be positive",
        ),
        (
            lambda: tj.identification.VibrationTest(1, 1.0).measured([[1.0]], [1.0, 2.0]),
            "must fit",
        ),
    ],
)
def test_what_cannot_be_tested_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_sensor_on_no_body_is_refused(linkage):
    test = tj.identification.StaticTest(
        [[]], [tj.identification.BodySensor("5", "x", 1.0)]
    )
    with pytest.raises(ValueError, match="`body` is '5', but the bodies are"):
        test.read(linkage)
    test = tj.identification.StaticTest(
        [[]], [tj.identification.HingeSensor("E", "x", 1.0)]
    )
    with pytest.raises(ValueError, match="names the hinge 'E'"):
        test.read(linkage)
    test = tj.identification.StaticTest(
        [[]], [tj.identification.BodySensor("3", "velocity_x", 1.0)]
    )
    with pytest.raises(ValueError, match="only a motion has"):
        test.read(linkage)
    with pytest.raises(ValueError, match="has only 9 vibrations"):
        tj.identification.VibrationTest(10, 1.0).read(linkage)


def test_trials_of_any_kind_are_read_in_their_order(linkage):
    """Loads and drives mixed, against one equilibrium each."""
    trials = [
        [tj.Load("3", (0.0, 2.0, 0.0))],
        [tj.Drive("2", angle=0.1)],
        [tj.Load("3", (0.0, -1.0, 0.0)), tj.Load("4", (0.01, 0.0, 0.0))],
        [tj.Load("3", (0.0, 1.0, 0.0)), tj.Load("3", (0.0, 1.0, 0.0), at=(0.01, 0))],
        [tj.Drive("2", angle=0.2), tj.Load("4", (0.0, 0.0, 3.0), follower=True)],
    ]
    test = tj.identification.StaticTest(
        trials,
        [
            tj.identification.BodySensor("3", "x", 1.0),
            tj.identification.BodySensor("4", "angle", 1.0),
        ],
    )
    read = test.read(linkage)
    for row, trial in zip(read, trials, strict=True):
        loads = [part for part in trial if isinstance(part, tj.Load)]
        drives = [part for part in trial if isinstance(part, tj.Drive)]
        solution = tj.equilibrium(linkage, loads=loads, drives=drives)
        told = [solution.displacement("3")[1], solution.displacement("4")[0]]
        assert_close(row, jnp.stack(told), digits=9)


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def test_trials_are_read_from_a_file_in_its_units(tmp_path):
    path = write(
        tmp_path / "trials.csv",
        "load_table.force_x_mN,load_table.moment_Nm,drive_arm.angle_deg,table.x_um,"
        "sd_table.x_nm,hinge_left.force_1_kN\n"
        "1500,0.25,90,12,5,\n"
        "-2,0,45,,6,0.5\n",
    )
    data = tj.identification.read_measurements(path, deviations={"left.force_1": 2.0})
    first, second = data.test.trials
    assert_close(first[0].wrench, jnp.array([0.25, 1.5, 0.0]))
    assert_close(first[1].angle, np.pi / 2)
    assert_close(second[0].wrench, jnp.array([0.0, -2e-3, 0.0]))
    assert_close(data.values, np.array([[12e-6, np.nan], [np.nan, 500.0]]))
    assert_close(data.deviations, np.array([[5e-9, 2.0], [6e-9, 2.0]]))
    assert data.test.columns == ("table.x", "left.force_1")


def test_a_body_and_a_hinge_of_one_name_keep_their_deviations(tmp_path):
    path = write(
        tmp_path / "trials.csv",
        "drive_b.x_um,a.x_um,sd_a.x_um,hinge_a.x_um,sd_hinge_a.x_um\n1,2,0.5,3,7\n",
    )
    data = tj.identification.read_measurements(path)
    assert_close(data.deviations, np.array([[0.5e-6, 7e-6]]))


def test_a_motion_and_frequencies_are_read_from_files(tmp_path):
    path = write(tmp_path / "motion.csv", "time_ms,3.angle_mrad\n0,0\n10,1.5\n20,2.5\n")
    data = tj.identification.read_measurements(
        path, deviations={"angle": 1e-5}, velocities={"3": (0.0, 10.0, 0.0)}
    )
    assert_close(data.test.times, np.array([0.0, 0.01, 0.02]))
    assert_close(data.values[:, 0], np.array([0.0, 1.5e-3, 2.5e-3]))
    path = write(tmp_path / "tones.csv", "frequency_kHz,sd_frequency_Hz\n1.5,2\n2.5,3\n")
    data = tj.identification.read_measurements(path, driven=["6"])
    assert_close(data.values, np.array([[1500.0], [2500.0]]))
    assert_close(data.deviations, np.array([[2.0], [3.0]]))


@pytest.mark.parametrize("micro", ["u", "\u00b5", "\u03bc"])
def test_micro_may_be_written_in_three_ways(tmp_path, micro):
    """As a u, as the sign for micro, and as the Greek letter, which looks the same."""
    head = f"load_b.force_x_{micro}N,b.x_{micro}m,sd_b.x_{micro}m,b.angle_{micro}rad"
    path = write(tmp_path / "trials.csv", f"{head},sd_b.angle_{micro}rad\n1,2,3,4,5\n")
    data = tj.identification.read_measurements(path)
    assert_close(data.values, np.array([[2e-6, 4e-6]]))


def test_measured_frequencies_are_positive_and_ascend():
    test = tj.identification.VibrationTest(3, 1.0)
    test.measured([[1.0], [np.nan], [1.0]])
    with pytest.raises(ValueError, match=r"`values\[2\]`: the frequency is 1 Hz and fol"):
        test.measured([[2.0], [np.nan], [1.0]])
    with pytest.raises(ValueError, match=r"`values\[0\]`: the frequency is -1 Hz"):
        test.measured([[-1.0], [2.0], [3.0]])


def test_a_motion_of_the_library_is_read_back(linkage):
    """What `to_xarray` tells are places in the world; displacements are the same data."""
    times = jnp.linspace(0.0, 0.02, 5)
    told = four_bar.drive(linkage, times)
    table = told.to_xarray()[["x", "angle"]].sel(body=["3", "4"])
    data = tj.identification.read_measurements(
        table, deviations={"x": 1e-6, "angle": 1e-5}, drives=four_bar.turn, tolerance=1e-6
    )
    assert data.test.columns == ("3.x", "4.x", "3.angle", "4.angle")
    residuals = data.residuals(linkage)
    np.testing.assert_allclose(residuals, 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,3.x_in\n0,1\n", "'3.x_in' in 'in', but x is told in m, mm"),
        ("time_s,3.speed_m\n0,1\n", "has the column '3.speed_m', but a column is"),
        ("time_s,3.x_m,3.x_m\n0,1,1\n", "has the column 3.x_m more than once"),
        ("time_s,3.x_m\n0,1\n1,2\n", r"does not tell the standard deviation of 3\.x"),
        ("time_s,3.x_m,sd_3.x_m\n0,one,1\n", "3.x_m is one, but must be a finite"),
        ("time_s,3.x_m,sd_3.x_m\n,1,1\n", "time_s is empty"),
        ("3.x_m,sd_3.x_m\n1,1\n", "tells neither times, nor loads or drives"),
        ("time_s\n0\n1\n", "has no readings"),
        ("time_s,load_3.force_x_N,3.x_m,sd_3.x_m\n0,1,1,1\n", "only trials at rest"),
        ("time_s,3.x_m,3.x_mm,sd_3.x_m\n0,1,1,1\n", "tells 3.x twice"),
        ("time_s,3.x_m,sd_3.x_m,sd_4.x_m\n0,1,1,1\n", "deviation of '4.x', but"),
        ("time_s,3.x_m\n", "only the line of names"),
        ("load_3.x_m,3.x_m\n1,1\n", "has the column 'load_3.x_m'"),
        ("frequency_Hz,sd_frequency_Hz\n2,1\n1,1\n", "line 3: the frequency is 1 Hz and"),
        ("frequency_kHz,sd_frequency_Hz\n-2,1\n", "line 2: the frequency is -2000 Hz"),
        ("frequency_Hz,3.x_m,sd_3.x_m\n2,1,1\n", r"has the column of 3\.x beside that"),
        ("load_3.force_x_kN,3.x_m,sd_3.x_m\n1e308,1,1\n", "line 2: .* It is too large"),
    ],
)
def test_a_file_that_cannot_be_read_says_where(tmp_path, text, message):
    with pytest.raises(ValueError, match=message):
        tj.identification.read_measurements(write(tmp_path / "file.csv", text))


def test_a_dataset_without_units_is_refused(linkage):
    table = four_bar.drive(linkage, jnp.linspace(0.0, 0.02, 5)).to_xarray()[["x"]]
    table["x"].attrs.clear()
    with pytest.raises(ValueError, match="'x' without `units`"):
        tj.identification.read_measurements(table, deviations={"x": 1e-6})


def spring(k):
    energy = tj.Quadratic(jnp.diag(jnp.stack([k["turn"], k["along"], k["across"]])))
    hinge = tj.Hinge("spring", "wall", "block", energy, at=(0, 0, 0))
    return tj.Mechanism([tj.Body("wall"), tj.Body("block")], [hinge], fixed=["wall"])


def test_advice_is_that_of_the_determinant():
    """Diagonal information in closed form: (F / (k dev))^2 of each ln k."""
    true = {"turn": 2.0, "along": 100.0, "across": 50.0}
    start = {name: tj.Parameter(value, above=0) for name, value in true.items()}

    def pushed(wrench, **sensors):
        load = [tj.Load("block", tuple(1e-3 * np.array(wrench)))]
        return tj.identification.StaticTest(
            [load],
            [
                tj.identification.BodySensor("block", name, size)
                for name, size in sensors.items()
            ],
        )

    along = pushed((0, 1.0, 0), x=1e-6)
    found = tj.identify(spring, start, [along.synthetic_data(spring(true))], throw=False)
    candidates = {
        "again": along,
        "better": pushed((0, 5.0, 0), x=1e-6),
        "turned": pushed((1.0, 0, 0), angle=1e-4),
        "all": pushed((1.0, 5.0, 3.0), angle=1e-4, x=1e-6, y=1e-6),
    }
    advice = tj.identification.rank_experiments(found, candidates, picks=2)

    def seen(force, k, size):
        return (1e-3 * force / (k * size)) ** 2

    now = np.array([1.0, 1 + seen(1, 100, 1e-6), 1.0])  # turn, along, across, and a prior
    more = {
        "again": [0, seen(1, 100, 1e-6), 0],
        "better": [0, seen(5, 100, 1e-6), 0],
        "turned": [seen(1, 2, 1e-4), 0, 0],
        "all": [seen(1, 2, 1e-4), seen(5, 100, 1e-6), seen(3, 50, 1e-6)],
        "all, block.y alone": [0, 0, seen(3, 50, 1e-6)],
    }
    told = {candidate.name: candidate for candidate in advice.candidates}
    order = [found.names.index(name) for name in ("turn", "along", "across")]
    for name, information in more.items():
        total = now + np.array(information)
        gain = np.log(total / now).sum() / 2
        np.testing.assert_allclose(told[name].gain, gain, rtol=1e-3)
        np.testing.assert_allclose(told[name].errors[order], total**-0.5, rtol=1e-3)
    assert advice.candidates[0].name == "all"
    assert advice.picked[0] == "all"
    assert "best, one after another: all, " in repr(advice)
    both = now + np.array(more["all"]) + np.array(more[advice.picked[1]])
    np.testing.assert_allclose(advice.after[order], both**-0.5, rtol=1e-3)
    with pytest.raises(ValueError, match="There are 0 candidates"):
        tj.identification.rank_experiments(found, {})


def test_a_test_of_another_mechanism_is_named():
    start = {"turn": 1.0, "along": 1.0, "across": 1.0}
    strange = tj.identification.StaticTest(
        [[tj.Load("arm", (0, 1, 0))]], [tj.identification.BodySensor("block", "x", 1)]
    )
    with pytest.raises(
        ValueError, match=r"StaticTest of 1 trial, .*: .* body 'arm', but"
    ):
        tj.identify(spring, start, [strange.measured([[0.0]])])


@pytest.mark.slow
def test_samples_are_those_of_the_posterior():
    """Of a compliance, linear in its readings: its mean and spread in closed form."""
    blackjax = pytest.importorskip("blackjax")
    del blackjax

    def design(k):
        one = jnp.ones(())
        return spring({"turn": one, "along": 1 / k["give"], "across": one})

    push = tj.identification.StaticTest(
        [[tj.Load("block", (0, 1.0, 0))]] * 3,
        [tj.identification.BodySensor("block", "x", 1e-3)],
    )
    readings = np.array([[0.0095], [0.0105], [0.0112]])
    start = {"give": tj.Parameter(0.01, "m/N", scale=0.01)}
    found = tj.identify(design, start, [push.measured(readings)])
    draws = tj.identification.posterior(found, draws=500, tune=200, chains=2)
    values = np.asarray(draws.posterior["give"])
    assert values.shape == (2, 500)
    spread = 1e-3 / np.sqrt(3)
    assert abs(values.mean() - readings.mean()) < 0.2 * spread
    assert abs(values.std() / spread - 1) < 0.15
    robust = tj.identify(design, start, [push.measured(readings)], robust=1.345)
    with pytest.raises(ValueError, match="A robust loss is not"):
        tj.identification.posterior(robust)


def test_noise_is_as_large_as_told():
    true = {name: jnp.ones(()) for name in ("turn", "along", "across")}
    load = [tj.Load("block", (0.0, 1e-3, 0.0))]
    test = tj.identification.StaticTest(
        [load] * 400, [tj.identification.BodySensor("block", "x", 1e-5)]
    )
    data = test.synthetic_data(spring(true), jax.random.key(0))
    assert abs(float(jnp.std(data.values)) / 1e-5 - 1) < 0.15
    exact = test.synthetic_data(spring(true))
    assert_close(exact.values, jnp.full((400, 1), 1e-3), digits=8)
