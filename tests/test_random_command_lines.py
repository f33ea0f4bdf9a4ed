"""Random command lines: each succeeds, or ends with one clear message."""

import contextlib
import io
import pathlib
import sys
import warnings

import pytest
from hypothesis import strategies as st
from random_damage import (
    check_examples,
    damaged_bytes,
    damaged_columns,
    damaged_trees,
    extreme_trials,
    mechanism,
    random_examples,
    TRIALS,
)

import twistorjax as tj
from twistorjax.cli.app import main


pytestmark = pytest.mark.untyped


def run_command(arguments):
    """Return the exit code, the output and the error message of a command."""
    output, message = io.StringIO(), io.StringIO()
    before, sys.argv = sys.argv, ["twistorjax", *arguments]
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(message):
            main()
    except SystemExit as error:
        return error.code, output.getvalue(), message.getvalue()
    finally:
        sys.argv = before
    raise AssertionError("A command must end with its exit code.")


def assert_clear_end(arguments):
    """The command succeeds without a message, or fails with a message of one line."""
    code, output, message = run_command(arguments)
    assert code in (0, 1, 2)
    output.encode(errors="surrogateescape")
    if code:
        assert message.startswith("twistorjax: ") and message.count("\n") == 1
        assert len(message) < 1200
    else:
        assert message == ""


NUMBERS = ["nan", "-inf", "1e400", "-1", "0", "1e308", "5e-324", "x", "", "9" * 5000]
TEXTS = [
    *("", " ", "leaf", "leaf,mirror", ",", "0.1,0.2", "0.2,0.1", "nan", "1:2:3"),
    *("1:2:1e9", "1:2:99999999999", "twist", "mixed", "x" * 5000, "\udcff", "\u03bc"),
    *("--", "-", "\n"),
]
PATHS = [
    *("nowhere/a.png", "a.poem", "", "x" * 300 + ".png", "x" * 5000 + "/a.png", ".", "/"),
    *("\udcff.png", "loop.json", "loop.json/a.png", "/dev/full", "~", "a.json/b.png"),
]
# For each command: options with their values, and arguments of which one list is added
# to each command line, so that the command does not reach a long computation.
COMMANDS = {
    "stage": (
        {
            "--input": NUMBERS,
            "--web": NUMBERS,
            "--damping-time": NUMBERS,
            "--temperature": NUMBERS,
            "--plot": PATHS,
        },
        [["--energy", "heat"], ["--web", "0"], ["--plot", "a.poem"], ["--help"]],
    ),
    "four-bar": (
        {"--hinges": TEXTS, "--release": NUMBERS, "--times": TEXTS, "--animate": PATHS},
        [["--energy", "heat"], ["--times", "0.2,0.1"], ["--animate", "motion.avi"]],
    ),
    "four-bar-models": ({"--plot": PATHS}, [["--plot", "a.poem"], ["--jsno"]]),
    "identify": (
        {
            "--seed": NUMBERS,
            "--angle-deviation": NUMBERS,
            "--position-deviation": NUMBERS,
        },
        [["--seed", "-2"], ["--position-deviation", "nan"], ["--seed", "9" * 20]],
    ),
    "water": (
        {"--order": NUMBERS, "--range": NUMBERS, "--points": NUMBERS, "--seed": NUMBERS},
        [["--order", "5"], ["--seed", "9" * 20], ["--points", "1"]],
    ),
    "random-data": ({"--plot": PATHS}, [["--plot", "a.poem"], ["--jsno"]]),
    "parallelogram": (
        {"--cases": PATHS, "--bending-factor": NUMBERS, "--plot": PATHS},
        [["--bending-factor", "0"], ["--cases", "none.csv"], ["--plot", "a.poem"]],
    ),
    "truss": (
        {"--rise": NUMBERS, "--half-span": NUMBERS, "--plot": PATHS},
        [["--rise", "0"], ["--stiffness", "nan"], ["--plot", "a.poem"], ["--help"]],
    ),
    "fit-energy": (
        {"--order": NUMBERS, "--symmetry": TEXTS, "--hold-out": NUMBERS, "--out": PATHS},
        [["none.csv"], ["."], ["\udcff.csv"], ["a", "b"], []],
    ),
    "export": (
        {"stage": TEXTS, "loop.json": TEXTS, "--out": PATHS},
        [["--out", "a.pdf"], ["none.json"], [], ["--json"]],
    ),
    "sweep stage": (
        {"--web": TEXTS, "--hole": NUMBERS, "--chunk": NUMBERS, "--devices": NUMBERS},
        [["--devices", "0"], ["--web", "1:2"], ["--help"]],
    ),
    "": (
        {"--version": TEXTS, "stgae": TEXTS, "--json": NUMBERS},
        [["stgae"], ["--help"]],
    ),
}


@st.composite
def command_lines(draw):
    """A command with up to three random options and some that prevent a computation."""
    name = draw(st.sampled_from(sorted(COMMANDS)))
    options, final = COMMANDS[name]
    arguments = name.split()
    for _ in range(draw(st.integers(0, 3))):
        option = draw(st.sampled_from(sorted(options)))
        arguments += [option, draw(st.sampled_from(options[option]))]
    if draw(st.integers(0, 9)) == 0:
        texts = st.text(st.characters(exclude_characters="\0"), max_size=5)
        arguments.append(draw(texts))
    return [*arguments, *draw(st.sampled_from(final))]


@random_examples(slow=60, release=1550)
def test_a_random_command_line(tmp_path, examples, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with contextlib.suppress(FileExistsError):
        pathlib.Path("loop.json").symlink_to("loop.json")
    check_examples(examples, command_lines(), assert_clear_end)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (
            "stage --temperature -1e9",
            2,
            "--temperature -1e+09: The body '1' would expand",
        ),
        ("stage --temperature 1e300", 2, "must be between -0.5 and 0.5"),
        ("stage --temperature 1e4", 1, "--temperature 10000: No equilibrium"),
        ("stage --input 5e-324", 1, "gain, dgain_dweb_per_m are not finite"),
        ("truss --rise 1e-9", 2, "`rise / half_span` is 1e-09, but must be between 0.02"),
        ("truss --rise 1e200", 2, "`pose` of the body 'apex' is [0.0, 0.0, 1e+200]"),
        ("truss --half-span 1e9", 2, "`rise / half_span` is 3e-10"),
        ("truss --rise 1e300 --half-span 1e300", 2, "powers of larger lengths overflow"),
    ],
)
def test_an_extreme_number_ends_with_a_message(arguments, code, message):
    found, output, text = run_command(arguments.split())
    assert (found, output) == (code, "") and message in text and text.count("\n") == 1


def test_a_warning_is_one_line():
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        code, _, text = run_command(["stage", "--temperature", "3e3"])
    assert code == 0 and text.startswith(
        "twistorjax: warning: The displacement or the axial force of the hinge 'a'"
    )
    assert text.count("\n") == text.count("twistorjax: warning")


@random_examples(slow=5, release=300)
def test_a_damaged_file_on_the_command_line(tmp_path, examples, monkeypatch):
    """A mechanism is exported, and an energy is fitted, if the file can be read."""
    monkeypatch.chdir(tmp_path)
    tj.io.save_mechanism(mechanism(), "mechanism.json")
    original = pathlib.Path("mechanism.json").read_bytes()
    trials = TRIALS.encode()
    lines = st.tuples(
        st.sampled_from(["a.json", "a.py", "a.svg", "a.dxf"]),
        damaged_trees([original]) | damaged_bytes([original]),
        st.sampled_from([[], ["--symmetry", "leaf"], ["--coordinates", "mixed"]]),
        damaged_columns([trials]) | damaged_bytes([trials]) | extreme_trials(),
    )

    def check(example):
        out, content, options, columns = example
        pathlib.Path("mechanism.json").write_bytes(content)
        assert_clear_end(["export", "mechanism.json", "--out", out])
        pathlib.Path("trials.csv").write_bytes(columns)
        assert_clear_end(["fit-energy", "trials.csv", "--order", "2", *options])

    check_examples(examples, lines, check)
