"""Measurements that are read from text files and datasets."""

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close

import twistorjax as tj
from twistorjax.examples import four_bar
from twistorjax.identification import MotionTest, read_measurements, StaticTest


@pytest.fixture(scope="module")
def linkage():
    return four_bar.four_bar(damping=1e-3)


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def test_static_trials_are_read_and_converted_to_si_units(tmp_path):
    path = write(
        tmp_path / "trials.csv",
        "load_table.force_x_mN,load_table.moment_Nm,drive_arm.angle_deg,table.x_um,"
        "sd_table.x_nm,hinge_left.force_1_kN\n"
        "1500,0.25,90,12,5,\n"
        "-2,0,45,,6,0.5\n",
    )
    data = read_measurements(path, standard_deviations={"left.force_1": 2.0})
    assert isinstance(data.test, StaticTest)
    first, second = data.test.load_cases
    load, drive = first
    assert isinstance(load, tj.Load) and isinstance(drive, tj.Drive)
    assert_close(load.wrench, jnp.array([0.25, 1.5, 0.0]))
    assert_close(drive.angle, np.pi / 2)
    load = second[0]
    assert isinstance(load, tj.Load)
    assert_close(load.wrench, jnp.array([0.0, -2e-3, 0.0]))
    assert_close(data.values, np.array([[12e-6, np.nan], [np.nan, 500.0]]))
    assert_close(data.standard_deviations, np.array([[5e-9, 2.0], [6e-9, 2.0]]))
    assert data.test.columns == ("table.x", "left.force_1")


def test_a_body_and_a_hinge_of_the_same_name_keep_their_standard_deviations(tmp_path):
    path = write(
        tmp_path / "trials.csv",
        "drive_b.x_um,a.x_um,sd_a.x_um,hinge_a.x_um,sd_hinge_a.x_um\n1,2,0.5,3,7\n",
    )
    data = read_measurements(path)
    assert_close(data.standard_deviations, np.array([[0.5e-6, 7e-6]]))


def test_motions_and_natural_frequencies_are_read(tmp_path):
    path = write(tmp_path / "motion.csv", "time_ms,3.angle_mrad\n0,0\n10,1.5\n20,2.5\n")
    data = read_measurements(
        path, standard_deviations={"angle": 1e-5}, velocities={"3": (0.0, 10.0, 0.0)}
    )
    assert isinstance(data.test, MotionTest)
    assert_close(data.test.times, np.array([0.0, 0.01, 0.02]))
    assert_close(data.values[:, 0], np.array([0.0, 1.5e-3, 2.5e-3]))
    path = write(
        tmp_path / "frequencies.csv", "frequency_kHz,sd_frequency_Hz\n1.5,2\n2.5,3\n"
    )
    data = read_measurements(path, prescribed=["6"])
    assert_close(data.values, np.array([[1500.0], [2500.0]]))
    assert_close(data.standard_deviations, np.array([[2.0], [3.0]]))


@pytest.mark.parametrize("micro", ["u", "\u00b5", "\u03bc"])
def test_the_prefix_micro_is_accepted_in_three_spellings(tmp_path, micro):
    """These are the letter u, the micro sign, and the Greek letter mu."""
    head = f"load_b.force_x_{micro}N,b.x_{micro}m,sd_b.x_{micro}m,b.angle_{micro}rad"
    path = write(tmp_path / "trials.csv", f"{head},sd_b.angle_{micro}rad\n1,2,3,4,5\n")
    data = read_measurements(path)
    assert_close(data.values, np.array([[2e-6, 4e-6]]))


@pytest.mark.slow
def test_a_simulated_motion_is_read_from_its_dataset(linkage):
    """The dataset contains poses in the world frame, and the sensors read poses."""
    times = jnp.linspace(0.0, 0.02, 5)
    motion = four_bar.driven_motion(linkage, times)
    table = motion.to_xarray()[["x", "angle"]].sel(body=["3", "4"])
    data = read_measurements(
        table,
        standard_deviations={"x": 1e-6, "angle": 1e-5},
        drives=four_bar.crank_rotation,
        tolerance=1e-6,
    )
    assert data.test.columns == ("3.x", "4.x", "3.angle", "4.angle")
    np.testing.assert_allclose(data.residuals(linkage), 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,3.x_in\n0,1\n", "'3.x_in' in 'in', but the unit of x must be one of m,"),
        ("time_s,3.speed_m\n0,1\n", "has the column '3.speed_m', but a column is"),
        ("time_s,3.x_m,3.x_m\n0,1,1\n", "has the column 3.x_m more than once"),
        ("time_s,3.x_m\n0,1\n1,2\n", r"has no standard deviation of 3\.x: add a column"),
        ("time_s,3.x_m,sd_3.x_m\n0,one,1\n", "3.x_m is one, but must be a finite"),
        ("time_s,3.x_m,sd_3.x_m\n,1,1\n", "time_s is empty"),
        ("3.x_m,sd_3.x_m\n1,1\n", "has neither times, nor loads or drives"),
        ("time_s\n0\n1\n", "has no readings"),
        ("time_s,load_3.force_x_N,3.x_m,sd_3.x_m\n0,1,1,1\n", "only load cases have"),
        ("time_s,3.x_m,3.x_mm,sd_3.x_m\n0,1,1,1\n", "has 3.x twice"),
        ("time_s,3.x_m,sd_3.x_m,sd_4.x_m\n0,1,1,1\n", "deviation of '4.x', but"),
        ("time_s,3.x_m\n", "only the line of column names"),
        ("load_3.x_m,3.x_m\n1,1\n", "has the column 'load_3.x_m'"),
        ("frequency_Hz,sd_frequency_Hz\n2,1\n1,1\n", "line 3: the frequency is 1 Hz and"),
        ("frequency_kHz,sd_frequency_Hz\n-2,1\n", "line 2: the frequency is -2000 Hz"),
        ("frequency_Hz,3.x_m,sd_3.x_m\n2,1,1\n", r"has the column of 3\.x beside that"),
        ("load_3.force_x_kN,3.x_m,sd_3.x_m\n1e308,1,1\n", "line 2: .* It is too large"),
    ],
)
def test_the_error_of_a_wrong_file_names_the_entry(tmp_path, text, message):
    with pytest.raises(ValueError, match=message):
        read_measurements(write(tmp_path / "file.csv", text))


def test_a_dataset_without_units_is_rejected():
    xarray = pytest.importorskip("xarray")
    coordinates = {"time": np.linspace(0.0, 0.02, 5), "body": ["2", "3"]}
    table = xarray.Dataset({"x": (("time", "body"), np.zeros((5, 2)))}, coordinates)
    with pytest.raises(ValueError, match="'x' without `units`"):
        read_measurements(table, standard_deviations={"x": 1e-6})
