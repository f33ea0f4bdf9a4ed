"""Damaged files and strange command lines, at random.

Every file and every command line works or ends in one clear error. The few examples of
the usual tests are always the same; `pytest -m release` runs ten thousand.
"""

import contextlib
import io
import json
import pathlib
import re
import sys

import numpy as np
import pytest
from hypothesis import given, HealthCheck, settings, strategies as st

import twistorjax as tj
from twistorjax.cli.app import main


pytestmark = pytest.mark.untyped


def at_random(few, many):
    """Few examples in the usual tests, many in those of a release."""
    return pytest.mark.parametrize(
        "examples", [few, pytest.param(many, marks=pytest.mark.release)]
    )


def checked(examples, strategy, check):
    """Check so many examples; the first one that fails is shown in its smallest form."""
    run = settings(
        max_examples=examples,
        derandomize=True,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )(given(strategy)(check))
    run()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("damaged")


def is_clear(error, path):
    """The message is one line that names the file, and can be printed."""
    message = str(error)
    assert str(path) in message
    assert "\n" not in message and len(message) < 1500
    message.encode()


# JSON files: trees of lists, of fields (pairs of a name and a value), and of raw text


def energies():
    quadratic = tj.Quadratic(np.diag([2.0, 300.0, 40.0]), "twist")
    polynomial = tj.energies.Polynomial(
        [0.5, 0.1], [(0, 2, 0, 0), (0, 0, 0, 4)], scale=0.1
    )
    squares = tj.energies.SumOfSquares([[0.1, 0.7]], [(0, 1, 0, 0), (0, 0, 0, 1)])
    slender = tj.energies.MixedEnergy(
        [6.0, 0.6, -5e-4], [(0, 2, 0), (0, 2, 1), (0, 0, 2)], length=1.0, force=1.0
    )
    return [
        tj.energies.WithValidityRange(
            slender, turn=0.3, force=2.0, error=[1e-3, 1e-3, 1e-3]
        ),
        2.0 * tj.energies.Rational(polynomial, squares) + quadratic,
        tj.energies.PointCharges([1.0, -1.0], [[0.0, 0.1], [0.3, 0.0]]),
    ]


def model():
    corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
    bodies = [
        tj.Body("base", outline=corners),
        tj.Body("arm", (0.1, 0.2, 0.3), mass=1.0, inertia=2.0),
    ]
    damping = tj.energies.ViscousDamping(np.eye(3), "twist", resisted=True)
    hinges = [
        tj.Hinge(f"h{k}", "base", "arm", energy, at=(0.1, 0, 0), damping=given)
        for k, (energy, given) in enumerate(
            zip(energies(), (None, 1e-3, damping), strict=True)
        )
    ]
    hinges[0] = tj.Hinge("h0", "base", "arm", energies()[0], (0, 1, 0), outline=corners)
    return tj.Mechanism(bodies, hinges, fixed={"base": ["angle", "x", "y"], "arm": ["y"]})


class Fields(list):
    """An object of a file: pairs, of which two may have one name."""


def as_tree(value):
    if isinstance(value, dict):
        return Fields([json.dumps(key), as_tree(part)] for key, part in value.items())
    if isinstance(value, list):
        return [as_tree(part) for part in value]
    return json.dumps(value)


def as_text(tree):
    if isinstance(tree, Fields):
        return "{" + ",".join(f"{name}:{as_text(part)}" for name, part in tree) + "}"
    if isinstance(tree, list):
        return "[" + ",".join(map(as_text, tree)) + "]"
    return tree


def parts_of(tree):
    """Where there are lists and fields, and what is in each: owner and index."""
    waiting, found = [tree], []
    while waiting:
        owner = waiting.pop()
        for index, part in enumerate(owner):
            found.append((owner, index))
            inner = part[1] if isinstance(owner, Fields) else part
            if isinstance(inner, list):
                waiting.append(inner)
    return found


SUM = '{"kind":"Sum","parts":['
VALUES = [
    *("NaN", "Infinity", "-Infinity", "1e400", "-1e400", "1" + 400 * "0", "9" * 5000),
    *("0", "-0.0", "-1", "2.5", "1e308", "-1e308", "5e-324", "1e-200", str(2**63)),
    *("true", "null", "nul", "", "1_0", '""', '"x"', '"\\ud800"', '"a\\udfffb"'),
    *('"arm"', '"base"', '"twist"', '"Sum"', '"angle"', '"\ud800"', '"\\u0000"'),
    *("[]", "{}", "[[]]", "[{}]", "[1,[2]]", "[0,0,0]", "[1e308,1e308,1e308]", '{"":0}'),
    *('["x"]', '{"kind":"Sum","parts":[]}', '{"kind":[]}', '{"kind":"Quadratic"}'),
    *("[" * 100_000, "[" * 300 + "]" * 300, f'"{"x" * 100_000}"'),
    *(SUM * 300 + "]}" * 300, SUM * 90 + "]}" * 90, "[[1,2],[3]]"),
    *('{"kind":"Scaled","factor":-1,"energy":{}}', "[[NaN,0],[0,0],[1,1]]"),
]


SOUND = b"0 1 2 -1 3.5 1e-3 -0.0 1e308 -1e308 1e154 1e-160 5e-324 1e-308".split()


@st.composite
def damaged_trees(draw, originals):
    """The text of a file, of which one to three entries are not what they were."""
    original = draw(st.sampled_from(originals))
    if draw(st.booleans()):  # numbers for numbers, so that the layout is sound
        parts = re.split(rb"(?<=[ \[])(-?[\d.e+-]+)(?=[,\n])", original)
        for _ in range(draw(st.integers(1, 4))):
            place = draw(st.sampled_from(range(1, len(parts), 2)))
            parts[place] = draw(st.sampled_from(SOUND))
        return b"".join(parts)
    tree = as_tree(json.loads(original))
    for _ in range(draw(st.integers(1, 3))):
        owner, index = draw(st.sampled_from(parts_of(tree)))
        other, place = draw(st.sampled_from(parts_of(tree)))
        fields = isinstance(owner, Fields)
        value = draw(st.sampled_from(VALUES))
        if draw(st.booleans()):
            value = other[place][1] if isinstance(other, Fields) else other[place]
            value = as_text(value)
        match draw(st.sampled_from(["replace", "delete", "double", "insert", "rename"])):
            case "replace" if fields:
                owner[index] = [owner[index][0], value]
            case "replace":
                owner[index] = value
            case "delete":
                del owner[index]
            case "double":
                owner.insert(index, owner[index])
            case "insert" if fields:
                owner.insert(index, ['"unknown"', value])
            case "insert":
                owner.insert(index, value)
            case "rename" if fields:
                name = draw(st.sampled_from(['"x"', '"\\ud800"', "1", '"kind"', '""']))
                owner[index] = [name, owner[index][1]]
        if not parts_of(tree):
            break
    return as_text(tree).encode("utf-8", errors="surrogatepass")


STRANGE = [b"\0", b"\xff", b"\xed\xa0\x80", b'"', b"}", b"\xef\xbb\xbf"]


@st.composite
def damaged_bytes(draw, originals):
    """The bytes of a file, some of which were lost, doubled or changed."""
    content = draw(st.sampled_from(originals))
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(content)))
        end = min(len(content), start + draw(st.sampled_from([0, 1, 2, 7, 10**6])))
        middle = draw(st.sampled_from([b"", content[start:end] * 2, None]))
        if middle is None:
            middle = draw(st.sampled_from(STRANGE) | st.binary(max_size=3))
        content = content[:start] + middle + content[end:]
    return content


def content_of(save, thing, folder):
    save(thing, folder / "whole.json")
    return (folder / "whole.json").read_bytes()


@pytest.mark.parametrize("damaged", [damaged_trees, damaged_bytes])
@at_random(few=100, many=3000)
def test_a_damaged_model_or_energy(folder, damaged, examples):
    """It is refused by a `ValueError`, or it is read, and written as it was read."""
    path, again = folder / "damaged.json", folder / "again.json"
    originals = [content_of(tj.io.save_mechanism, model(), folder)]
    originals += [content_of(tj.io.save_energy, energy, folder) for energy in energies()]

    def check(content):
        path.write_bytes(content)
        for load, save in (
            (tj.io.load_mechanism, tj.io.save_mechanism),
            (tj.io.load_energy, tj.io.save_energy),
        ):
            try:
                thing = load(path)
            except ValueError as error:
                is_clear(error, path)
                continue
            save(thing, path)
            save(load(path), again)
            assert again.read_bytes() == path.read_bytes()

    checked(examples, damaged(originals), check)


# Files of columns


TRIALS = """angle_rad,px_m,py_m,moment_Nm,fx_N,fy_N,energy_J,note
0.1,0.001,0.002,1.5,2.5,3.5,0.1,first
0.2,0.001,-0.002,1.5,-2.5,3e-3,0.2,second
-0.1,0.002,0.001,2.5,.5,3.,0.3,"third, the last"
"""
MEASURED = [
    "time_ms,3.x_um,sd_3.x_um,hinge_a.force_1_mN\n0,1,0.5,2\n5,2,0.5,\n10,3,0.5,4\n",
    "load_3.force_x_mN;drive_4.angle_deg;3.x_\u00b5m;sd_3.x_nm\n1;2;3;4\n5;6;;8\n",
    "frequency_Hz\tsd_frequency_Hz\n10\t0.1\n20\t0.2\n20\t0.3\n",
]
CELLS = [
    *("", " ", "nan", "inf", "-inf", "1e400", "1e308", "-1e308", "5e-324", "0", "-1"),
    *("1_0", "1,5", "1.5", '"', '"x', 'x"', '"x"y', '"1"', "\u0661", "0x10", "1e", "."),
    *("\u2028", "\x85", "\0", "\r", "\n", ";", "\t", ",", "x" * 140_000, "9" * 5000, "+"),
    *("3.x_m", "3.x_\u03bcm", "sd_3.x_mm", "time_s", "frequency_kHz", "energy_J"),
    *("3.x_in", "sd_fx_N", "load_3.moment_Nm", "drive_3.x_m", "sd_energy_J", "angle_rad"),
    *("._", "..x_m", "\u03bcm"),
]


@st.composite
def damaged_columns(draw, originals):
    """The bytes of a file, of which some cells, rows or columns were changed."""
    text = draw(st.sampled_from(originals)).decode()
    separator = max(",;\t", key=text.split("\n")[0].count)
    rows = [line.split(separator) for line in text.split("\n")]
    for _ in range(draw(st.integers(1, 4))):
        row = draw(st.integers(0, len(rows) - 1))
        place = draw(st.integers(0, len(rows[row]) - 1)) if rows[row] else 0
        match draw(st.sampled_from(["cell", "head", "delete", "double", "lose", "swap"])):
            case "cell" if rows[row]:
                rows[row][place] = draw(st.sampled_from(CELLS))
            case "head" if rows[0]:
                rows[0][place % len(rows[0])] = draw(st.sampled_from(CELLS))
            case "delete" if len(rows) > 1:
                del rows[row]
            case "double":
                rows.insert(row, list(rows[row]))
            case "lose":
                rows = [line[:place] + line[place + 1 :] for line in rows]
            case "swap":
                rows[row], rows[-1] = rows[-1], rows[row]
    return "\n".join(map(separator.join, rows)).encode()


@st.composite
def strange_trials(draw):
    """A whole file of trials, of numbers that no hinge has."""
    numbers = [0.0, 0.1, -0.3, 1.0, 5e-324, 1e-160, -1e-8, 1e8, 1e100, 1e160, 1e308]
    row = st.lists(st.sampled_from(numbers), min_size=6, max_size=6)
    rows = draw(st.lists(row, min_size=1, max_size=5))
    head = TRIALS.split(",energy")[0]
    return "\n".join([head, *(",".join(map(str, row)) for row in rows)]).encode()


@pytest.mark.parametrize("damaged", [damaged_columns, damaged_bytes])
@at_random(few=120, many=1200)
def test_a_damaged_file_of_columns(folder, damaged, examples):
    path = folder / "damaged.csv"
    given = {"deviations": {"a.force_1": 1e-3}, "velocities": {"3": (0.0, 1.0, 0.0)}}

    def check(content):
        path.write_bytes(content)
        settings = given if b"time" in content else {}
        for read in (
            tj.energies.read_trials,
            lambda path: tj.identification.read_measurements(path, **settings),
        ):
            try:
                read(path)
            except ValueError as error:
                message = str(error)
                assert "\n" not in message and len(message) < 1500
            except TypeError as error:  # settings of another kind of test
                assert "unexpected keyword argument" in str(error)

    originals = [text.encode() for text in (TRIALS, *MEASURED)]
    checked(examples, damaged(originals), check)


# Command lines


def called(arguments):
    """The exit code of a command, what it printed, and its complaint."""
    out, complaint = io.StringIO(), io.StringIO()
    before, sys.argv = sys.argv, ["twistorjax", *arguments]
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(complaint):
            main()
    except SystemExit as ended:
        return ended.code, out.getvalue(), complaint.getvalue()
    finally:
        sys.argv = before
    raise AssertionError("A command ends by its exit code.")


def ends_clearly(arguments):
    code, out, complaint = called(arguments)
    assert code in (0, 1, 2)
    out.encode(errors="surrogateescape")
    if code:
        assert complaint.startswith("twistorjax: ") and complaint.count("\n") == 1
        assert len(complaint) < 1200
    else:
        assert complaint == ""


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
# options with values, and at last those of which at least one keeps it from solving
COMMANDS = {
    "stage": (
        {
            "--input": NUMBERS,
            "--web": NUMBERS,
            "--damping-time": NUMBERS,
            "--plot": PATHS,
        },
        [["--energy", "heat"], ["--web", "0"], ["--plot", "a.poem"], ["--help"]],
    ),
    "four-bar": (
        {"--hinges": TEXTS, "--release": NUMBERS, "--times": TEXTS, "--animate": PATHS},
        [["--energy", "heat"], ["--times", "0.2,0.1"], ["--animate", "film.avi"]],
    ),
    "identify": (
        {"--seed": NUMBERS, "--angle": NUMBERS, "--travel": NUMBERS},
        [["--seed", "-2"], ["--travel", "nan"], ["--seed", "9" * 20]],
    ),
    "water": (
        {"--order": NUMBERS, "--range": NUMBERS, "--points": NUMBERS, "--seed": NUMBERS},
        [["--order", "5"], ["--seed", "9" * 20], ["--points", "1"]],
    ),
    "random-data": ({"--plot": PATHS}, [["--plot", "a.poem"], ["--jsno"]]),
    "fit": (
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
    """A command with one to four options, some of which have no sensible value."""
    name = draw(st.sampled_from(sorted(COMMANDS)))
    options, refused = COMMANDS[name]
    arguments = name.split()
    for _ in range(draw(st.integers(0, 3))):
        option = draw(st.sampled_from(sorted(options)))
        arguments += [option, draw(st.sampled_from(options[option]))]
    if draw(st.integers(0, 9)) == 0:
        words = st.text(st.characters(exclude_characters="\0"), max_size=5)
        arguments.append(draw(words))
    return [*arguments, *draw(st.sampled_from(refused))]


@at_random(few=60, many=1550)
def test_a_strange_command_line(folder, examples, monkeypatch):
    monkeypatch.chdir(folder)
    with contextlib.suppress(FileExistsError):
        pathlib.Path("loop.json").symlink_to("loop.json")
    checked(examples, command_lines(), ends_clearly)


@at_random(few=5, many=300)
def test_a_damaged_file_on_the_command_line(folder, examples, monkeypatch):
    """Of one that can be read a model is exported, an energy is fitted."""
    monkeypatch.chdir(folder)
    model_text = content_of(tj.io.save_mechanism, model(), folder)
    trials = TRIALS.encode()
    lines = st.tuples(
        st.sampled_from(["a.json", "a.py", "a.svg", "a.dxf"]),
        damaged_trees([model_text]) | damaged_bytes([model_text]),
        st.sampled_from([[], ["--symmetry", "leaf"], ["--coordinates", "tension"]]),
        damaged_columns([trials]) | damaged_bytes([trials]) | strange_trials(),
    )

    def check(given):
        out, model, options, columns = given
        pathlib.Path("model.json").write_bytes(model)
        ends_clearly(["export", "model.json", "--out", out])
        pathlib.Path("trials.csv").write_bytes(columns)
        ends_clearly(["fit", "trials.csv", "--order", "2", *options])

    checked(examples, lines, check)
