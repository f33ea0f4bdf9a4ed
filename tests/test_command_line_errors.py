"""Every error of the command line is one line on stderr and an exit code."""

import pathlib
import subprocess
import sys

import pytest


REFERENCE = pathlib.Path(__file__).parent / "reference"


def assert_usage_error(done, message):
    """The command ended with code 2 and one line on stderr that contains a message."""
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.startswith("twistorjax: ")
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--web", "-1"], "Invalid value for '--web': -1 is not positive and finite"),
        (["--web", "nan"], "Invalid value for '--web': nan is not positive and finite"),
        (["--input", "0"], "Invalid value for '--input': 0 is not positive and finite"),
        (["--input", "inf"], "Invalid value for '--input': inf is not positive"),
        (["--input", "far"], "Invalid value for '--input'"),
        (["--energy", "heat"], "'heat' is not one of 'twistor', 'twist'"),
        (["--plot", "nowhere/stage.png"], "there is no folder nowhere"),
        (["--plot", "stage.poem"], "'--plot': stage.poem must end with one of"),
        (["--step"], "--step needs --transient"),
        (["--damping-time", "1e-4"], "--damping-time needs --transient"),
        (["--transient", "--temperature", "1"], "--temperature is for the static gain"),
        (["--gian"], "--gian"),
    ],
)
def test_invalid_input_of_stage(run_here, arguments, message):
    assert_usage_error(run_here("stage", *arguments), message)


def test_a_web_that_the_formula_does_not_allow(run_here):
    message = "cannot be used with holes of 3 mm: `web / hole` is 0.000333333"
    assert_usage_error(run_here("stage", "--web", "1e-6"), message)


def test_an_input_displacement_without_equilibrium_is_a_failure(run_here):
    done = run_here("stage", "--input", "1.0", "--json")
    assert done.returncode == 1
    assert done.stderr.startswith("twistorjax: --input 1: No equilibrium")
    assert "(fraction 0.0" in done.stderr
    assert done.stdout == ""


def test_a_bending_factor_that_is_too_large(run_here):
    message = "E I / L of the beam is inf N m/rad"
    assert_usage_error(run_here("parallelogram", "--bending-factor", "1e308"), message)


@pytest.mark.release
def test_load_cases_that_all_fail(run_here):
    """They exceed the range of the leaves; the table shows the reason of each."""
    table = "transverse_EI_L2,axial_EI_L2,moment_EI_L\n1e6,0,0\n0,-1e5,0\n"
    (run_here.folder / "cases.csv").write_text(table)
    done = run_here("parallelogram", "--cases", "cases.csv")
    assert done.returncode == 1
    assert "2 load cases: no_equilibrium" in done.stdout
    assert done.stderr.startswith("twistorjax: All load cases failed. No equilibrium")


@pytest.mark.parametrize(
    ("arguments", "needed"),
    [
        (["solve", "--magnify", "10"], "--plot"),
        (["path", "--over", "table:x"], "--plot"),
        (["modes", "--mode", "2"], "--animate"),
        (["fit-energy", "--without-range"], "--out"),
    ],
)
def test_an_option_that_has_no_effect_without_another(run_here, arguments, needed):
    command, *options = arguments
    (run_here.folder / "guide.json").touch()
    done = run_here(command, "guide.json", *options)
    assert_usage_error(done, f"{options[0]} needs {needed}")


def test_an_unknown_command(run_here):
    done = run_here("stgae")
    assert done.returncode == 2
    assert "stgae" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--hinges", "some"], "'some' is not one of 'identical', 'leaves-and-notches'"),
        (["--times", "0.2,0.1"], "must increase"),
        (["--times", "0.1,x"], "must be numbers separated by commas"),
        (["--damping-time", "-1"], "Invalid value for '--damping-time'"),
        (["--damping-time", "inf"], "inf is not finite"),
        (["--animate", "motion.avi"], "must end with one of .gif, .mp4"),
    ],
)
def test_invalid_input_of_four_bar(run_here, arguments, message):
    assert_usage_error(run_here("four-bar", *arguments), message)


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.csv"], "'nowhere.csv' does not exist"),
        ([str(REFERENCE / "stage.json")], "lacks the column angle_rad"),
        ([str(REFERENCE / "fe_notch.csv"), "--symmetry", "round"], "'mirror', 'ends'"),
        ([str(REFERENCE / "fe_notch.csv"), "--symmetry", ","], "'mirror', 'ends'"),
        ([str(REFERENCE / "fe_notch.csv"), "--seed", "-1"], "Invalid value for '--seed'"),
        ([str(REFERENCE / "fe_notch.csv"), "--hold-out", "1"], "`hold_out` is 1.0"),
        ([str(REFERENCE)], "is a directory"),
    ],
)
def test_invalid_input_of_fit_energy(run_here, arguments, message):
    assert_usage_error(run_here("fit-energy", *arguments), message)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--order", "5"], "--order is 5, but must be an even number"),
        (["--order", "0"], "Invalid value for '--order'"),
        (["--range", "0"], "Invalid value for '--range': 0 is not positive and finite"),
        (["--range", "7"], "Invalid value for '--range'"),
        (["--range", "nan"], "Invalid value for '--range'"),
        (["--points", "1"], "Invalid value for '--points'"),
        (["--seed", "-1"], "Invalid value for '--seed'"),
        (["--seed", "9" * 20], "Invalid value for '--seed'"),
        (["--plot", "nowhere/water.png"], "there is no folder nowhere"),
    ],
)
def test_invalid_input_of_water(run_here, arguments, message):
    assert_usage_error(run_here("water", *arguments), message)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--position-deviation", "0"], "0 is not positive and finite"),
        (["--seed", "-2"], "Invalid value for '--seed'"),
        (["--seed", "9" * 20], "Invalid value for '--seed'"),
    ],
)
def test_invalid_input_of_identify(run_here, arguments, message):
    assert_usage_error(run_here("identify", *arguments), message)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["stage", "--web", "1:2"],
            "--web is 1:2, but must be a positive number, or first:last:count",
        ),
        (["stage", "--web", "1:2:x"], "--web is 1:2:x, but must be"),
        (["stage", "--web", "-1:2:5"], "--web is -1:2:5, but must be"),
        (["four-bar", "--length", "nan"], "--length is nan, but must be"),
        (
            ["stage", "--web", "2e-4", "--plot", "gain.png"],
            "--plot needs a range first:last:count for --web or --hole",
        ),
        (["stage", "--resume"], "--resume needs --out"),
        (["stage", "--devices", "999"], "--devices is 999, but there are"),
        (["stage", "--web", "1:2:99999999999"], "the count may be at most 10,000,000"),
        (
            ["four-bar", "--length", "1:2:5000", "--thickness", "1:2:5000"],
            "The ranges have 25,000,000 designs",
        ),
        (["stage", "--devices", "0"], "Invalid value for '--devices'"),
        (["stage", "--chunk", "0"], "Invalid value for '--chunk'"),
    ],
)
def test_invalid_input_of_sweep(run_here, arguments, message):
    assert_usage_error(run_here("sweep", *arguments), message)


def test_a_folder_that_is_no_store(run_here):
    (run_here.folder / "empty").mkdir()
    done = run_here("sweep", "stage", "--web", "0.3e-3", "--out", "empty")
    assert_usage_error(done, "'empty' is not a store of a sweep")


@pytest.mark.slow
def test_a_store_that_cannot_be_used(run_here):
    """One store is damaged, and one is in a folder that is not writable."""
    sums = run_here.folder / "damaged" / "finished" / "sums"
    sums.mkdir(parents=True)
    (sums / "manifest.json").write_text("{}")
    for out, message in (
        ("damaged", "The store 'damaged' is damaged: its file 'finished/sums/manifest"),
        ("/proc/s.zarr", "The store '/proc/s.zarr' cannot be written: "),
    ):
        done = run_here("sweep", "stage", "--web", "0.3e-3", "--out", out)
        assert done.returncode == 1 and done.stdout == ""
        assert done.stderr.startswith(f"twistorjax: {message}")
        assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["stage", "--out", "stage.pdf"], "--out is stage.pdf, but must end with one of"),
        (["bridge", "--out", "a.svg"], "The mechanism is 'bridge', but must be stage"),
        (["none.json", "--out", "a.svg"], "No such file or directory: 'none.json'"),
        (["stage", "--out", "nowhere/a.svg"], "there is no folder nowhere"),
        (["stage", "--out", f"{'a' * 5000}/a.svg"], "there is no folder aaa"),
        (["stage", "--out", f"{'a' * 300}.json"], "File name too long"),
    ],
)
def test_invalid_input_of_export(run_here, arguments, message):
    assert_usage_error(run_here("export", *arguments), message)


SHELL = f"{sys.executable} -m twistorjax"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "codes", "out", "err"),
    [
        (f"{SHELL} --help | true; exit ${{PIPESTATUS[0]}}", (0, 1), "", ""),
        (f"{SHELL} --help | head -n 1", (0,), "Usage:", ""),
        (f"{SHELL} --version > /dev/full", (1,), "", "twistorjax: [Errno 28] No space"),
        (f"{SHELL} --version >&-", (0,), "", ""),
        (f"{SHELL} stage --web -1 2>&-", (2,), "", ""),
        (
            f"{SHELL} export stage --out $'\\xff.json'",
            (0,),
            "saved to \\udcff.json",
            "",
        ),
    ],
)
def test_output_that_cannot_be_written_or_is_not_read(tmp_path, line, codes, out, err):
    """A broken pipe, a full disk, or an unusual file name raises no traceback."""
    done = subprocess.run(
        ["bash", "-c", line], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert done.returncode in codes
    assert out in done.stdout
    assert done.stderr.startswith(err)
    assert done.stderr.count("\n") == bool(err)


@pytest.mark.parametrize(
    ("error", "code", "err"),
    [
        (KeyboardInterrupt(), 130, ""),
        (MemoryError(), 1, "twistorjax: There is not enough memory"),
        (RuntimeError("RESOURCE_EXHAUSTED: 9 GB"), 1, "twistorjax: There is not enough"),
        (OSError(5, "Input/output error"), 1, "twistorjax: [Errno 5] Input/output"),
        (BrokenPipeError(), 1, ""),
    ],
)
def test_interruptions_and_errors_of_the_machine(run_here, monkeypatch, error, code, err):
    def fail():
        raise error

    monkeypatch.setattr("twistorjax.cli.random_data.prepare_jax", fail)
    ends = []  # of Python at once: it could crash while XLA compiles in a thread
    monkeypatch.setattr("os._exit", lambda code: ends.append(code) or sys.exit(code))
    done = run_here("random-data")
    assert done.returncode == code
    assert ends == [130] * (code == 130)
    assert done.stderr.startswith(err)
    assert done.stderr.count("\n") == bool(err)


def test_an_error_in_the_program_is_not_hidden(run_here, monkeypatch):
    def fail():
        raise ZeroDivisionError

    monkeypatch.setattr("twistorjax.cli.random_data.prepare_jax", fail)
    with pytest.raises(ZeroDivisionError):
        run_here("random-data")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("identify", "--angle-deviation", "1e-300"),
            "--angle-deviation or --position-deviation cannot be used",
        ),
        (("stage", "--transient", "--input", "1e300"), "--input 1e+300: No equilibrium"),
    ],
)
def test_numbers_near_the_limits_of_double_precision(run_here, arguments, message):
    """After warnings of lengths that seem to be in millimeters."""
    done = run_here(*arguments)
    assert done.returncode in (1, 2)
    *warnings, error = done.stderr.splitlines()
    assert all(line.startswith("twistorjax: warning: ") for line in warnings)
    assert error.startswith("twistorjax: ") and message in error
