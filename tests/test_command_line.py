"""What the commands of the command line compute, print, and write."""

import json
import os
import pathlib
import subprocess
import sys

import numpy as np
import pytest
from saved_models import GUIDE_BY_DIMENSIONS

import twistorjax as tj


REFERENCE = pathlib.Path(__file__).parent / "reference"


def test_without_a_command_the_help_is_printed(run_here):
    done = run_here()
    assert (done.returncode, done.stderr) == (0, "")
    assert "stage" in done.stdout
    assert len(done.stdout.splitlines()) > 5
    assert run_here("--version").stdout.startswith("twistorjax 0.")


def test_the_help_has_one_line_and_one_example_for_each_command(run_here):
    commands = run_here("--help").stdout.split("Commands:")[1]
    assert "..." not in commands
    for line in commands.strip().splitlines():
        assert "Example" in run_here(line.split()[0], "--help").stdout


def test_help_shows_examples(run_here):
    done = run_here("stage", "--help")
    assert done.returncode == 0
    assert "twistorjax stage --input 2e-6 --json" in done.stdout


def test_stage_prints_its_gain_and_the_measured_gain(run):
    done = run("stage")
    assert done.returncode == 0
    assert done.stderr == ""
    assert "27.628044   measured 27.8 to 28.1 (1978); dissertation 27.8" in done.stdout
    for part in ("30.5289 N", "192.20 nm", "20.6072 uJ", "-50661.2101 /m"):
        assert part in done.stdout


def test_the_measurement_is_shown_only_for_the_measured_device(run_here):
    assert "measured" not in run_here("stage", "--web", "0.3e-3").stdout


def test_stage_prints_json(run_here):
    done = run_here("stage", "--json", "--web", "0.3e-3", "--input", "2e-6")
    result = json.loads(done.stdout)
    assert set(result) == {
        "gain",
        "output_m",
        "input_force_N",
        "elongation_a_m",
        "strain_energy_J",
        "dgain_dweb_per_m",
        "poses",
        "result",
    }
    np.testing.assert_allclose(result["gain"], result["output_m"] / 2e-6)
    assert result["poses"]["6"] == [0.0, -0.007 + 2e-6, 0.035]
    assert result["result"] == "successful"


@pytest.mark.slow
def test_a_second_run_uses_the_cached_program(run_with_own_cache):
    run_with_own_cache("stage")
    cache = run_with_own_cache.folder / "cache" / "twistorjax" / "programs"
    count = len(list(cache.iterdir()))
    run_with_own_cache("stage")
    assert count == len(list(cache.iterdir())) > 0


@pytest.mark.parametrize("name", ["stage.png", "stage.svg"])
def test_stage_draws_the_mechanism(run_here, name):
    done = run_here("stage", "--plot", name)
    assert done.returncode == 0
    assert f"figure saved to {name}" in done.stdout
    assert (run_here.folder / name).stat().st_size > 10_000


@pytest.mark.slow
def test_the_transient_response_of_the_stage_ends_at_its_static_gain(run_here):
    done = run_here("stage", "--transient", "--step", "--json", "--plot", "transient.png")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert abs(result["gain"] - result["static_gain"]) < 1e-8 * result["gain"]
    assert abs(result["elongation_a_m"] - 192.2e-9) < 0.1e-9


@pytest.mark.slow
def test_four_bar_prints_json_and_draws_the_motion(run):
    done = run(
        "four-bar", "--hinges", "leaves-and-notches", "--times", "0.09,0.405", "--json",
        "--plot", "panels.png",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert set(result) == {"times", "poses", "reactions", "steps", "result"}
    assert result["times"] == [0.09, 0.405]
    expected = [-0.01264399614, 0.06121225566]
    np.testing.assert_allclose(result["poses"]["3"][0][1:], expected, atol=1e-7)
    assert (run.folder / "panels.png").stat().st_size > 10_000


def test_fit_energy_reports_its_errors_and_saves_the_energy(run_here):
    done = run_here(
        "fit-energy", str(REFERENCE / "fe_notch.csv"), "--order", "4", "--symmetry",
        "leaf", "--hold-out", "0.2", "--out", "notch.json", "--json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["rank"] == result["terms"] == 12
    assert max(result["relative_error"]["held_out"]) < 1e-3
    np.testing.assert_allclose(result["stiffness_eigenvalues"][0], 2.3875, rtol=2e-3)
    saved = tj.io.load_energy(run_here.folder / "notch.json")
    assert isinstance(saved, tj.energies.WithValidityRange)
    trials = tj.energies.read_trials(REFERENCE / "fe_notch.csv")
    np.testing.assert_allclose(saved.rotation, np.max(np.abs(trials.poses[:, 0])))


def test_fit_energy_saves_no_worthless_energy(run_here, tmp_path):
    """The sign of the wrench is reversed; `--accept` saves the fit nevertheless."""
    trials = np.loadtxt(REFERENCE / "fe_notch.csv", delimiter=",", skiprows=1)[:, :6]
    header = "angle_rad,px_m,py_m,moment_Nm,fx_N,fy_N"
    path, out = tmp_path / "reversed.csv", tmp_path / "hinge.json"
    np.savetxt(
        path, trials * [1, 1, 1, -1, -1, -1], "%.17g", ",", header=header, comments=""
    )
    arguments = ("fit-energy", str(path), "--order", "2", "--out", str(out))
    done = run_here(*arguments)
    assert done.returncode == 1 and not out.exists()
    assert "the wrench points back to the reference" in done.stderr
    assert "eigenvalues" in done.stdout
    done = run_here(*arguments, "--accept", "--without-range")
    assert done.returncode == 0, done.stderr
    assert isinstance(tj.io.load_energy(out), tj.energies.Polynomial)


@pytest.mark.slow
def test_fit_energy_accepts_several_symmetries(run_here):
    """The symmetries of a leaf include the mirror symmetry."""
    arguments = (str(REFERENCE / "fe_notch.csv"), "--order", "2", "--json")
    terms = []
    for symmetry in ("leaf", "leaf,mirror"):
        done = run_here("fit-energy", *arguments, "--symmetry", symmetry)
        terms.append(json.loads(done.stdout)["terms"])
    assert terms[0] == terms[1] > 0


def test_fit_energy_reports_trials_that_determine_no_coefficient(run_here, tmp_path):
    """The infinite condition number is null in JSON."""
    path = tmp_path / "trial.csv"
    path.write_text("angle_rad,px_m,py_m,moment_Nm,fx_N,fy_N\n1,2,3,4,5,6\n")
    options = ("--order", "2", "--json")
    done = run_here("fit-energy", str(path), "--coordinates", "twist", *options)
    assert done.returncode == 1 and "the error at new trials is" in done.stderr
    result = json.loads(done.stdout)
    assert (result["rank"], result["condition"]) == (0, None)
    path.write_text("angle_rad,px_m,py_m,moment_Nm,fx_N,fy_N\n0,1,0,0,1e-320,0\n")
    done = run_here("fit-energy", str(path), "--coordinates", "mixed", "--order", "2")
    assert done.returncode == 2 and "The axial force of all" in done.stderr


@pytest.mark.slow
def test_random_data_warns_that_the_fit_interpolates(run_here):
    done = run_here("random-data", "--json", "--plot", "random.png")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert (result["terms"], result["value_count"], result["rank"]) == (69, 51, 51)
    assert max(result["largest_error_training"]) < 2.6e-5
    assert min(result["relative_error_held_out"]) > 1
    assert "the fit interpolates" in result["warning"]
    assert (run_here.folder / "random.png").stat().st_size > 10_000


@pytest.mark.slow
def test_water_compares_its_fits(run_here):
    done = run_here("water", "--order", "4", "--json", "--plot", "water.png")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert (result["fitted"], result["held_out"]) == (500, 2000)
    errors = {name: fit["largest_error_held_out"] for name, fit in result["fits"].items()}
    assert list(errors) == [
        "polynomial",
        "unregularized rational",
        "regularized rational",
    ]
    assert errors["regularized rational"] < errors["polynomial"] / 10
    assert (run_here.folder / "water.png").stat().st_size > 10_000


@pytest.mark.slow
def test_identify_finds_the_true_stiffnesses(run_here):
    done = run_here("identify", "--json", "--seed", "2")
    result = json.loads(done.stdout)
    for name, true in result["true"].items():
        error = abs(result["estimates"][name] - true)
        assert error < 4 * result["standard_errors"][name]
    assert result["readings"] == 909
    assert result["result"] == "successful"


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["json", "dxf", "svg", "py"])
def test_an_exported_model_can_be_exported_again(run_here, tmp_path, suffix):
    model, out = tmp_path / "linkage.json", tmp_path / f"again.{suffix}"
    example = "four-bar-leaves-and-notches"
    done = run_here("export", example, "--out", str(model), "--json")
    assert json.loads(done.stdout)["hinges"] == ["A", "B", "C", "D"]
    done = run_here("export", str(model), "--out", str(out))
    assert done.returncode == 0 and "Mechanism of 4 bodies" in done.stdout
    assert out.stat().st_size > 3000
    if suffix == "json":
        assert out.read_bytes() == model.read_bytes()


@pytest.mark.slow
def test_a_sweep_can_be_resumed(run_here):
    command = ("sweep", "stage", "--web", "0.1e-3:0.4e-3:31", "--chunk", "8", "--json")
    done = run_here(*command, "--out", "stage.zarr", "--plot", "gains.png")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    # the fitted stiffness of a notch is negative below a ratio of web to hole of 0.0157
    assert result["designs"] == 31 and 0 < result["failed"] < 10
    gain = result["outputs"]["gain"]
    np.testing.assert_allclose(gain["minimum"], 20.5625079, rtol=1e-7)
    assert result["outputs"]["gain_by_web"]["unit"] == "1/m"
    assert (run_here.folder / "gains.png").stat().st_size > 10_000
    resumed = run_here(*command, "--out", "stage.zarr", "--resume")
    assert json.loads(resumed.stdout)["outputs"] == result["outputs"]
    repeated = run_here(*command, "--out", "stage.zarr")
    assert repeated.returncode == 2 and repeated.stdout == ""
    assert "Continue it with --resume" in repeated.stderr
    assert repeated.stderr.count("\n") == 1


@pytest.mark.slow
def test_parts_of_a_sweep_share_a_folder(run_here):
    command = ("sweep", "stage", "--web", "0.3e-3:0.4e-3:31", "--chunk", "8", "--json")
    whole = json.loads(run_here(*command).stdout)
    command = (*command, "--out", "parts.zarr")
    first, second = (run_here(*command, "--part", part) for part in ("2/2", "1/2"))
    assert json.loads(first.stdout)["missing"] == 16
    assert json.loads(second.stdout) == whole
    wrong = run_here(*command, "--part", "3/2")
    assert wrong.returncode == 2 and "the k-th of n parts, such as 3/64" in wrong.stderr


@pytest.mark.slow
def test_a_path_that_fails_shows_what_was_found(run_here):
    """A leaf whose rotation is too large at a part of the load."""
    assert run_here("new", "folded-guide").returncode == 0
    arguments = ("folded-guide.json", "--load", "table:400,0", "--plot", "path.png")
    done = run_here("path", *arguments)
    assert done.returncode == 1 and "axial force" in done.stderr
    assert "out_of_range: " in done.stdout
    assert (run_here.folder / "path.png").stat().st_size > 10_000


@pytest.mark.slow
def test_resuming_a_sweep_repairs_damaged_files(run_here):
    command = ("sweep", "stage", "--web", "0.3e-3:0.4e-3:6", "--chunk", "3", "--json")
    first = run_here(*command, "--out", "damaged.zarr")
    for damaged in ("finished/sums/c/1", "web/c/0"):
        file = run_here.folder / "damaged.zarr" / damaged
        file.write_bytes(bytes(3))
        resumed = run_here(*command, "--out", "damaged.zarr", "--resume")
        assert (resumed.returncode, resumed.stderr) == (0, "")
        assert resumed.stdout == first.stdout
        assert len(file.read_bytes()) > 3


def test_a_sweep_in_which_all_designs_fail_prints_the_reason(run_here):
    done = run_here("sweep", "stage", "--web", "2e-3:3e-3:5")
    assert done.returncode == 1
    assert "5 failed, not_finite: A value of the mechanism" in done.stdout
    assert done.stderr.startswith("twistorjax: All designs failed.")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "platform", "devices"),
    [
        ("", "cpu", 1),
        ("accelerator=True", "None", 1),
        ("accelerator=True, cpu_cores=2", "cpu", 2),
    ],
)
def test_only_several_cpu_cores_force_a_sweep_to_the_cpu(
    monkeypatch, arguments, platform, devices
):
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    code = (
        "from twistorjax.cli.common import prepare_jax\n"
        f"prepare_jax({arguments})\n"
        "import jax\n"
        "print(jax.config.jax_platforms, jax.config.jax_num_cpu_devices)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    printed_platform, printed_devices = done.stdout.split()
    assert printed_platform == platform
    assert max(int(printed_devices), 1) == devices


def test_a_warm_stage_drifts(run_here):
    """A plate that expands as a whole keeps its gain; 23.6e-6 / K times 24 mm."""
    done = run_here("stage", "--temperature", "2.0", "--json")
    drift = json.loads(done.stdout)["drift"]
    free, held = drift["guide_expands"], drift["guide_keeps_its_place"]
    np.testing.assert_allclose(free["output_y_m"], 2 * 23.6e-6 * 24e-3, rtol=1e-9)
    assert abs(free["output_x_m"]) < 1e-15
    np.testing.assert_allclose(free["gain"], json.loads(done.stdout)["gain"], rtol=1e-6)
    # The lever ratio multiplies the displacement of the input relative to the plate.
    relative = 2 * 23.6e-6 * 7e-3
    assert 20 * relative < held["output_x_m"] < 36 * relative
    assert "guide keeps its place" in run_here("stage", "--temperature", "2.0").stdout


STIFFNESS = 24 * 210e9 * 10e-3 * 0.5e-3**3 / 12 / 50e-3**3  # N/m


@pytest.fixture
def guide_file(tmp_path):
    path = tmp_path / "guide.json"
    path.write_text(json.dumps({"twistorjax": 6, "mechanism": GUIDE_BY_DIMENSIONS}))
    return str(path)


def test_solve_computes_a_mechanism_in_a_file(run_here, guide_file, tmp_path):
    figure = "--plot", "guide.svg", "--magnify", "7"
    done = run_here("solve", guide_file, "--load", "table:5,0", *figure)
    assert done.returncode == 0 and "0.00118986" in done.stdout
    assert "magnified 7 times" in (tmp_path / "guide.svg").read_text()
    done = run_here("solve", guide_file, "--drive", "table:x=1e-4,angle=0", "--json")
    result = json.loads(done.stdout)
    force = result["reactions"]["table"][1]
    np.testing.assert_allclose(force, STIFFNESS * 1e-4, rtol=1e-3)
    np.testing.assert_allclose(
        result["stresses_Pa"]["left"], 3 * 210e9 * 0.5e-3 * 1e-4 / 50e-3**2, rtol=0.01
    )


@pytest.mark.parametrize(
    ("option", "message"),
    [
        (("--load", "table:5"), "must be BODY:FX,FY"),
        (("--load", "table:5,y"), "has 'y' where a number is needed"),
        (("--load", "tabel:5,0"), "names the body 'tabel'"),
        (("--drive", "table:z=1"), "must be BODY:x=1e-3"),
        (("--drive", "table:x=1,x=2"), "at most once"),
    ],
)
def test_solve_explains_wrong_loads(option, message, run_here, guide_file):
    done = run_here("solve", guide_file, *option)
    assert done.returncode == 2 and message in done.stderr


def test_modes_computes_and_animates_a_mechanism_in_a_file(
    run_here, guide_file, tmp_path
):
    done = run_here("modes", guide_file, "--json", "--animate", "mode.gif")
    lowest = json.loads(done.stdout)["frequencies_Hz"][0]
    np.testing.assert_allclose(lowest, np.sqrt(STIFFNESS / 0.1) / 2 / np.pi, rtol=0.01)
    assert (tmp_path / "mode.gif").stat().st_size > 1000
    done = run_here("modes", guide_file, "--animate", "mode.gif", "--mode", "9")
    assert (done.returncode, done.stderr.count("only 3 modes")) == (2, 1)


def test_path_follows_the_snap_through_of_a_truss_in_a_file(run_here, tmp_path):
    truss = tj.examples.truss.von_mises_truss()
    tj.io.save_mechanism(truss, tmp_path / "truss.json")
    options = "path", "truss.json", "--load", "apex:0,-20"
    done = run_here(*options, "--plot", "truss.png", "--over", "apex:y")
    assert done.returncode == 0 and (tmp_path / "truss.png").exists()
    record = json.loads(run_here(*options, "--json").stdout)
    found = tj.path(truss, loads=[tj.Load("apex", force=(0.0, -20.0))])
    points = record["critical_points"]
    assert [point["kind"] for point in points] == ["limit", "limit"]
    factors = [point["load_factor"] for point in points]
    np.testing.assert_allclose(factors, found.critical_points.load_factors, rtol=1e-9)
    assert record["stable"].count(False) == np.sum(~found.stable)
    done = run_here(*options, "--plot", "truss.png", "--over", "apex:z")
    assert (done.returncode, done.stderr.count("--over is 'apex:z'")) == (2, 1)


@pytest.mark.slow
def test_new_writes_a_script_and_a_file_of_the_same_mechanism(run_here, tmp_path):
    assert run_here("new", "folded-guide").returncode == 0
    done = subprocess.run(
        [sys.executable, "folded-guide.py"],
        cwd=tmp_path,
        env=os.environ | {"MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert (tmp_path / "folded-guide.png").exists()
    solved = run_here("solve", "folded-guide.json", "--load", "table:2,0").stdout
    assert done.stdout.startswith(solved)
    frequencies = run_here("modes", "folded-guide.json").stdout.splitlines()
    assert all(line in done.stdout for line in frequencies)
    again = run_here("new", "folded-guide")
    assert (again.returncode, again.stderr.count("folded-guide.py exists")) == (2, 1)


def test_report_writes_a_page_about_a_mechanism_in_a_file(run_here, guide_file, tmp_path):
    done = run_here("report", guide_file, "--load", "table:5,0", "--out", "guide.html")
    assert (done.returncode, done.stdout) == (0, "saved to guide.html\n")
    page = (tmp_path / "guide.html").read_text()
    assert page.count("<h2>") == 8 and page.count("<svg") == 2
    assert "0.00118986" in page and "150.9" in page
    assert "<p>Not computed: &#x27;table&#x27; can move out of the plane" in page
    assert "src=" not in page and "@import" not in page
    assert run_here("report", guide_file, "--out", "guide.pdf").returncode == 2
