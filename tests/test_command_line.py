"""The command line, as a user types it."""

import json
import pathlib
import subprocess
import sys

import numpy as np
import pytest

from twistorjax.cli.app import main


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Runs `twistorjax` in a process of its own, with a cache of its own."""
    import os

    folder = tmp_path_factory.mktemp("run")
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}

    def run(*arguments):
        return subprocess.run(
            [sys.executable, "-m", "twistorjax", *arguments],
            capture_output=True, text=True, env=environment, cwd=folder, check=False,
        )  # fmt: skip

    run.folder = folder
    return run


@pytest.fixture
def told(monkeypatch, capsys):
    """Runs it in this process, sooner: for what is answered before JAX is prepared."""

    def told(*arguments):
        monkeypatch.setattr(sys, "argv", ["twistorjax", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        out, complaint = capsys.readouterr()
        return subprocess.CompletedProcess(arguments, ended.value.code, out, complaint)

    return told


def test_stage_prints_its_gain_beside_the_measurement(run):
    done = run("stage")
    assert done.returncode == 0
    assert done.stderr == ""
    assert "27.628044   measured 27.8 to 28.1 (1978); dissertation 27.8" in done.stdout
    for part in ("30.5289 N", "192.20 nm", "20.6072 uJ", "-50661.2101 /m"):
        assert part in done.stdout


def test_stage_answers_in_json(run):
    done = run("stage", "--json", "--web", "0.3e-3", "--input", "2e-6")
    answer = json.loads(done.stdout)
    assert set(answer) == {
        "gain", "output_m", "input_force_N", "compression_a_m", "strain_energy_J",
        "dgain_dweb_per_m", "poses", "result",
    }  # fmt: skip
    np.testing.assert_allclose(answer["gain"], answer["output_m"] / 2e-6)
    assert answer["poses"]["6"] == [0.0, -0.007 + 2e-6, 0.035]
    assert answer["result"] == "successful"


def test_a_second_run_finds_its_program_compiled(run):
    run("stage")
    before = len(list((run.folder / "cache" / "twistorjax").iterdir()))
    run("stage")
    assert before == len(list((run.folder / "cache" / "twistorjax").iterdir())) > 0


@pytest.mark.parametrize("name", ["stage.png", "stage.svg"])
def test_stage_draws_itself(run, name):
    done = run("stage", "--plot", name)
    assert done.returncode == 0
    assert f"drawn to {name}" in done.stdout
    assert (run.folder / name).stat().st_size > 10_000


def is_one_clear_line(done, message):
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.startswith("twistorjax: ")
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


def test_input_that_fails_as_it_is_used_is_one_clear_line(run):
    told = "cannot be used, holes being 3 mm: `web / hole` is 0.000333333"
    is_one_clear_line(run("stage", "--web", "1e-6"), told)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--web", "-1"], "--web is -1, but must be positive and finite"),
        (["--web", "nan"], "--web is nan, but must be positive and finite"),
        (["--input", "0"], "--input is 0, but must be positive and finite"),
        (["--input", "inf"], "--input is inf, but must be positive and finite"),
        (["--input", "far"], "Invalid value for '--input'"),
        (["--energy", "heat"], "--energy is 'heat', but must be 'twistor' or 'twist'"),
        (["--plot", "nowhere/stage.png"], "there is no folder nowhere"),
        (["--plot", "stage.poem"], "--plot is stage.poem, but its name must end with"),
        (["--gian"], "No such option: --gian"),
    ],
)
def test_wrong_input_is_one_clear_line(told, arguments, message):
    is_one_clear_line(told("stage", *arguments), message)


def test_an_input_too_far_is_a_failure_and_not_an_answer(run):
    done = run("stage", "--input", "1.0", "--json")
    assert done.returncode == 1
    assert done.stderr.startswith("twistorjax: --input 1: No equilibrium was found")
    assert "(fraction 0.0" in done.stderr
    assert done.stdout == ""


def test_an_unknown_command_is_wrong_input(told):
    done = told("stgae")
    assert done.returncode == 2
    assert "stgae" in done.stderr


def test_without_a_command_it_tells_what_it_can_do(told):
    done = told()
    assert (done.returncode, done.stderr) == (0, "")
    assert "stage" in done.stdout
    assert len(done.stdout.splitlines()) > 5
    assert told("--version").stdout.startswith("twistorjax 0.")


def test_the_measurement_is_told_of_the_device_measured_alone(run):
    assert "measured" not in run("stage", "--web", "0.3e-3").stdout


def test_help_shows_examples(told):
    done = told("stage", "--help")
    assert done.returncode == 0
    assert "twistorjax stage --input 2e-6 --json" in done.stdout


def test_the_four_bar_answers_in_json_and_draws(run):
    done = run(
        "four-bar", "--hinges", "mixed", "--times", "0.09,0.405", "--json",
        "--plot", "panels.png",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert set(answer) == {"times", "poses", "reactions", "steps", "result"}
    assert answer["times"] == [0.09, 0.405]
    expected = [-0.01264399614, 0.06121225566]
    np.testing.assert_allclose(answer["poses"]["3"][0][1:], expected, atol=1e-7)
    assert (run.folder / "panels.png").stat().st_size > 10_000


def test_the_stage_settles_to_its_static_gain(run):
    done = run("stage", "--transient", "--step", "--json", "--plot", "transient.png")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert abs(answer["gain"] - answer["static_gain"]) < 1e-8 * answer["gain"]
    assert abs(answer["compression_a_m"] - 192.2e-9) < 0.1e-9


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--hinges", "some"], "must be 'identical' or 'mixed'"),
        (["--times", "0.2,0.1"], "must increase"),
        (["--times", "0.1,x"], "must be numbers between commas"),
        (["--damping-time", "-1"], "must be zero or positive"),
        (["--animate", "film.avi"], "its name must end with one of .gif, .mp4"),
    ],
)
def test_the_four_bar_refuses_in_one_line(told, arguments, message):
    is_one_clear_line(told("four-bar", *arguments), message)


REFERENCE = pathlib.Path(__file__).parent / "reference"


def test_fit_foretells_its_error_and_keeps_the_hinge(run):
    trials = str(REFERENCE / "fe_notch.csv")
    done = run(
        "fit", trials, "--order", "4", "--symmetry", "leaf", "--hold-out", "0.2",
        "--out", "notch.json", "--json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["rank"] == answer["terms"] == 12
    assert max(answer["relative_error"]["held_out"]) < 1e-3
    assert json.loads((run.folder / "notch.json").read_text())["twistorjax"] == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.csv"], "No such file"),
        ([str(REFERENCE / "stage.json")], "lacks the column angle_rad"),
        ([str(REFERENCE / "fe_notch.csv"), "--symmetry", "round"], "'mirror', 'ends'"),
        ([str(REFERENCE / "fe_notch.csv"), "--symmetry", ","], "'mirror', 'ends'"),
        ([str(REFERENCE / "fe_notch.csv"), "--seed", "-1"], "--seed is -1, but must be"),
        ([str(REFERENCE)], "Is a directory"),
    ],
)
def test_fit_refuses_in_one_line(run, arguments, message):
    is_one_clear_line(run("fit", *arguments), message)


def test_fit_takes_a_leaf_and_more(told):
    arguments = (str(REFERENCE / "fe_notch.csv"), "--order", "2", "--json")
    terms = [
        json.loads(told("fit", *arguments, "--symmetry", symmetry).stdout)["terms"]
        for symmetry in ("leaf", "leaf,mirror")
    ]
    assert terms[0] == terms[1] > 0


def test_trials_that_leave_nothing_to_fit_are_no_failure(told, tmp_path):
    """One trial, of which the stiffness is no stable one; JSON has no infinity."""
    path = tmp_path / "trial.csv"
    path.write_text("angle_rad,px_m,py_m,moment_Nm,fx_N,fy_N\n1,2,3,4,5,6\n")
    done = told("fit", str(path), "--order", "2", "--coordinates", "twist", "--json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert (answer["rank"], answer["condition"]) == (0, None)
    path.write_text("angle_rad,px_m,py_m,moment_Nm,fx_N,fy_N\n0,1,0,0,1e-320,0\n")
    done = told("fit", str(path), "--order", "2", "--coordinates", "tension")
    assert done.returncode == 2 and "are not those of a flexure" in done.stderr


def test_random_data_says_that_it_interpolates(run):
    done = run("random-data", "--json", "--plot", "random.png")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert (answer["terms"], answer["equations"], answer["rank"]) == (69, 51, 51)
    assert max(answer["largest_error_training"]) < 2.6e-5
    assert min(answer["relative_error_held_out"]) > 1
    assert "the fit interpolates" in answer["warning"]
    assert (run.folder / "random.png").stat().st_size > 10_000


def test_water_compares_its_fits(run):
    done = run("water", "--order", "4", "--json", "--plot", "water.png")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert (answer["fitted"], answer["held_out"]) == (500, 2000)
    errors = {name: fit["largest_error_held_out"] for name, fit in answer["fits"].items()}
    assert list(errors) == ["polynomial", "plain quotient", "kept from poles"]
    assert errors["kept from poles"] < errors["polynomial"] / 10
    assert (run.folder / "water.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--order", "5"], "--order is 5, but must be even, from 2 to 12"),
        (["--order", "0"], "--order is 0, but must be even"),
        (["--range", "0"], "--range is 0, but must be above 0, and at most a turn"),
        (["--range", "nan"], "--range is nan, but must be above 0"),
        (["--points", "1"], "--points is 1, but must lie between 2 and 20000"),
        (["--seed", "-1"], "--seed is -1, but must be a whole number"),
        (["--seed", "9" * 20], f"--seed is {'9' * 20}, but must be a whole number"),
        (["--plot", "nowhere/water.png"], "there is no folder nowhere"),
    ],
)
def test_water_refuses_in_one_line(told, arguments, message):
    is_one_clear_line(told("water", *arguments), message)


def test_identify_finds_what_was_put_in(run):
    done = run("identify", "--json", "--seed", "2")
    answer = json.loads(done.stdout)
    for name, true in answer["true"].items():
        gap = abs(answer["estimates"][name] - true)
        assert gap < 4 * answer["standard_errors"][name]
    assert answer["readings"] == 909
    assert answer["result"] == "successful"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--travel", "0"), "--travel is 0, but must be positive and finite"),
        (("--seed", "-2"), "--seed is -2, but must be 0 or larger"),
        (("--seed", "9" * 20), f"--seed is {'9' * 20}, but must be a whole number from"),
    ],
)
def test_identify_refuses_what_makes_no_sense(told, arguments, message):
    done = told("identify", *arguments)
    assert done.returncode == 2
    assert message in done.stderr


def test_sweep_goes_on_where_it_was(run):
    ask = ("sweep", "stage", "--web", "0.1e-3:0.4e-3:31", "--chunk", "8", "--json")
    done = run(*ask, "--out", "stage.zarr", "--plot", "gains.png")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    # the fitted stiffness of a notch is negative below a web of 0.0157 holes of 3 mm
    assert answer["designs"] == 31 and 0 < answer["failed"] < 10
    np.testing.assert_allclose(answer["answers"]["gain"]["lowest"], 20.5625079, rtol=1e-7)
    assert answer["answers"]["gain_by_web"]["unit"] == "1/m"
    assert (run.folder / "gains.png").stat().st_size > 10_000
    again = run(*ask, "--out", "stage.zarr", "--resume")
    assert json.loads(again.stdout)["answers"] == answer["answers"]
    is_one_clear_line(run(*ask, "--out", "stage.zarr"), "go on with it by --resume")
    (run.folder / "empty").mkdir()
    is_one_clear_line(run(*ask, "--out", "empty"), "'empty' is no store of a sweep")


def test_a_store_that_cannot_be_used_is_one_line(run):
    """A damaged one, and a place that takes no files, whoever asks."""
    sums = run.folder / "damaged" / "finished" / "sums"
    sums.mkdir(parents=True)
    (sums / "manifest.json").write_text("{}")
    for place, message in (
        ("damaged", "The store 'damaged' is damaged: its file 'finished/sums/manifest"),
        ("/proc/s.zarr", "The store '/proc/s.zarr' cannot be written: "),
    ):
        done = run("sweep", "stage", "--web", "0.3e-3", "--out", place)
        assert done.returncode == 1 and done.stdout == ""
        assert done.stderr.startswith(f"twistorjax: {message}")
        assert done.stderr.count("\n") == 1


def test_a_damaged_store_is_swept_again_where_it_must(run):
    ask = ("sweep", "stage", "--web", "0.3e-3:0.4e-3:6", "--chunk", "3", "--json")
    first = run(*ask, "--out", "torn.zarr")
    for damaged in ("finished/sums/c/1", "web/c/0"):
        file = run.folder / "torn.zarr" / damaged
        file.write_bytes(bytes(3))
        again = run(*ask, "--out", "torn.zarr", "--resume")
        assert (again.returncode, again.stderr) == (0, "")
        assert again.stdout == first.stdout
        assert len(file.read_bytes()) > 3


def test_a_sweep_without_any_answer_fails_and_says_why(told):
    done = told("sweep", "stage", "--web", "2e-3:3e-3:5")
    assert done.returncode == 1
    assert "5 without an answer, not_finite: A value of the mechanism" in done.stdout
    assert done.stderr.startswith("twistorjax: No design has an answer.")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["stage", "--web", "1:2"],
            "--web is 1:2, but must be a positive number, or two",
        ),
        (["stage", "--web", "1:2:x"], "--web is 1:2:x, but must be"),
        (["stage", "--web", "-1:2:5"], "--web is -1:2:5, but must be"),
        (["four-bar", "--length", "nan"], "--length is nan, but must be"),
        (
            ["stage", "--web", "2e-4", "--plot", "gain.png"],
            "--plot draws answers over a range: give one to --web or --hole",
        ),
        (["stage", "--resume"], "--resume goes on with the folder of --out"),
        (["stage", "--devices", "999"], "--devices is 999, but there are"),
        (["stage", "--web", "1:2:99999999999"], "may have at most 10,000,000 values"),
        (
            ["four-bar", "--length", "1:2:5000", "--thickness", "1:2:5000"],
            "These are 25,000,000 designs",
        ),
        (["stage", "--devices", "0"], "--devices and --chunk must be at least 1"),
    ],
)
def test_sweep_refuses_in_one_line(told, arguments, message):
    is_one_clear_line(told("sweep", *arguments), message)


@pytest.mark.parametrize("kind", ["json", "dxf", "svg", "py"])
def test_a_mechanism_is_exported_and_read_again(told, tmp_path, kind):
    model, out = tmp_path / "linkage.json", tmp_path / f"again.{kind}"
    done = told("export", "mixed-four-bar", "--out", str(model), "--json")
    assert json.loads(done.stdout)["hinges"] == ["A", "B", "C", "D"]
    done = told("export", str(model), "--out", str(out))
    assert done.returncode == 0 and "Mechanism of 4 bodies" in done.stdout
    assert out.stat().st_size > 3000
    if kind == "json":
        assert out.read_bytes() == model.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["stage", "--out", "stage.pdf"], "--out is stage.pdf, but must end with .json"),
        (["bridge", "--out", "a.svg"], "The mechanism is 'bridge', but must be stage"),
        (["none.json", "--out", "a.svg"], "No such file or directory: 'none.json'"),
        (["stage", "--out", "nowhere/a.svg"], "there is no folder nowhere"),
        (["stage", "--out", f"{'a' * 5000}/a.svg"], "there is no folder aaa"),
        (["stage", "--out", f"{'a' * 300}.json"], "File name too long"),
    ],
)
def test_export_refuses_in_one_line(told, arguments, message):
    is_one_clear_line(told("export", *arguments), message)


SHELL = f"{sys.executable} -m twistorjax"


@pytest.mark.parametrize(
    ("line", "code", "out", "complaint"),
    [
        (f"{SHELL} --help | true; exit ${{PIPESTATUS[0]}}", None, "", ""),
        (f"{SHELL} --help | head -n 1", 0, "Usage:", ""),
        (f"{SHELL} --version > /dev/full", 1, "", "twistorjax: [Errno 28] No space left"),
        (f"{SHELL} --version >&-", 0, "", ""),
        (f"{SHELL} stage --web -1 2>&-", 2, "", ""),
        (f"{SHELL} export stage --out $'\\xff.json'", 0, "kept in \\udcff.json", ""),
    ],
)
def test_output_that_nobody_reads_or_that_cannot_be_written(
    tmp_path, line, code, out, complaint
):
    """Neither a broken pipe, nor a full disk, nor a strange name ends in a traceback."""
    done = subprocess.run(
        ["bash", "-c", line], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert done.returncode in ((0, 1) if code is None else (code,))
    assert out in done.stdout
    assert done.stderr.startswith(complaint)
    assert done.stderr.count("\n") == bool(complaint)


@pytest.mark.parametrize(
    ("error", "code", "complaint"),
    [
        (KeyboardInterrupt(), 130, ""),
        (MemoryError(), 1, "twistorjax: There is not enough memory"),
        (RuntimeError("RESOURCE_EXHAUSTED: 9 GB"), 1, "twistorjax: There is not enough"),
        (OSError(5, "Input/output error"), 1, "twistorjax: [Errno 5] Input/output"),
        (BrokenPipeError(), 1, ""),
    ],
)
def test_what_the_machine_lacks_is_one_clear_line(
    told, monkeypatch, error, code, complaint
):
    def fails():
        raise error

    monkeypatch.setattr("twistorjax.cli.random_data.prepare_jax", fails)
    done = told("random-data")
    assert done.returncode == code
    assert done.stderr.startswith(complaint)
    assert done.stderr.count("\n") == bool(complaint)


def test_an_error_of_the_program_is_not_hidden(told, monkeypatch):
    def fails():
        raise ZeroDivisionError

    monkeypatch.setattr("twistorjax.cli.random_data.prepare_jax", fails)
    with pytest.raises(ZeroDivisionError):
        told("random-data")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("identify", "--angle", "1e-300"), "--angle or --travel cannot be used"),
        (("stage", "--transient", "--input", "1e300"), "--input 1e+300: No equilibrium"),
    ],
)
def test_numbers_near_the_ends_of_their_range_are_no_traceback(run, arguments, message):
    done = run(*arguments)
    assert done.returncode in (1, 2)
    assert done.stderr.startswith("twistorjax: ") and done.stderr.count("\n") == 1
    assert message in done.stderr


def test_help_has_a_line_for_each_command_and_an_example_in_each(told):
    overview = told("--help").stdout
    assert "..." not in overview.split("Commands:")[1]
    for line in overview.split("Commands:")[1].strip().splitlines():
        assert "Example" in told(line.split()[0], "--help").stdout
