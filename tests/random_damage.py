"""Random damage to the contents of files, as strategies of hypothesis.

The fast tests check the same few examples each time, `pytest -m slow` more, and
`pytest -m release` about ten thousand.
"""

import json
import re

import numpy as np
import pytest
from hypothesis import given, HealthCheck, settings, strategies as st

import twistorjax as tj


def random_examples(slow, release):
    """Parametrize a test with its number of examples in each kind of tests."""
    return pytest.mark.parametrize(
        "examples",
        [
            pytest.param(max(slow // 20, 2), id="fast"),
            pytest.param(slow, id="slow", marks=pytest.mark.slow),
            pytest.param(release, id="release", marks=pytest.mark.release),
        ],
    )


def check_examples(examples, strategy, check):
    """Check a number of examples. Hypothesis shrinks the first one that fails."""
    run = settings(
        max_examples=examples,
        derandomize=True,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),  # pyright: ignore[reportArgumentType]
    )(given(strategy)(check))
    run()


# JSON files. Their content is a tree of lists, of objects, and of raw text.


def energies():
    quadratic = tj.Quadratic(np.diag([2.0, 300.0, 40.0]), "twist")
    polynomial = tj.energies.Polynomial(
        [0.5, 0.1], [(0, 2, 0, 0), (0, 0, 0, 4)], scale=0.1
    )
    squares = tj.energies.SumOfSquares([[0.1, 0.7]], [(0, 1, 0, 0), (0, 0, 0, 1)])
    mixed = tj.energies.MixedEnergy(
        [6.0, 0.6, -5e-4], [(0, 2, 0), (0, 2, 1), (0, 0, 2)], length=1.0, force=1.0
    )
    return [
        tj.energies.WithValidityRange(
            mixed, rotation=0.3, force=2.0, error=[1e-3, 1e-3, 1e-3]
        ),
        2.0 * tj.energies.Rational(polynomial, squares) + quadratic,
        tj.energies.PointCharges([1.0, -1.0], [[0.0, 0.1], [0.3, 0.0]]),
    ]


def mechanism():
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    bodies = [
        tj.Body("base", outline=corners),
        tj.Body("arm", (0.1, 0.2, 0.3), mass=1.0, inertia=2.0),
    ]
    damping = tj.energies.ViscousDamping(np.eye(3), "twist", resisted=True)
    hinges = [
        tj.Hinge(f"h{k}", "base", "arm", energy, at=(0.1, 0, 0), damping=hinge_damping)
        for k, (energy, hinge_damping) in enumerate(
            zip(energies(), (None, 1e-3, damping), strict=True)
        )
    ]
    hinges[0] = tj.Hinge("h0", "base", "arm", energies()[0], (0, 1, 0), outline=corners)
    return tj.Mechanism(bodies, hinges, fixed={"base": ["angle", "x", "y"], "arm": ["y"]})


class Fields(list):
    """An object in a file: pairs of a name and a value. Names may occur twice."""


def to_tree(value):
    """Convert the content of a JSON file into a tree."""
    if isinstance(value, dict):
        return Fields([json.dumps(key), to_tree(part)] for key, part in value.items())
    if isinstance(value, list):
        return [to_tree(part) for part in value]
    return json.dumps(value)


def to_text(tree):
    """Convert a tree into JSON."""
    if isinstance(tree, Fields):
        return "{" + ",".join(f"{name}:{to_text(part)}" for name, part in tree) + "}"
    if isinstance(tree, list):
        return "[" + ",".join(map(to_text, tree)) + "]"
    return tree


def entries_of(tree):
    """Find all entries of a tree, each as the list that contains it and its index."""
    unvisited, entries = [tree], []
    while unvisited:
        owner = unvisited.pop()
        for index, part in enumerate(owner):
            entries.append((owner, index))
            inner = part[1] if isinstance(owner, Fields) else part
            if isinstance(inner, list):
                unvisited.append(inner)
    return entries


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


VALID_NUMBERS = b"0 1 2 -1 3.5 1e-3 -0.0 1e308 -1e308 1e154 1e-160 5e-324 1e-308".split()


@st.composite
def damaged_trees(draw, originals):
    """JSON in which one to three entries are replaced, moved, deleted or renamed."""
    original = draw(st.sampled_from(originals))
    if draw(st.booleans()):  # only numbers change, so that the file fits its schema
        parts = re.split(rb"(?<=[ \[])(-?[\d.e+-]+)(?=[,\n])", original)
        for _ in range(draw(st.integers(1, 4))):
            position = draw(st.sampled_from(range(1, len(parts), 2)))
            parts[position] = draw(st.sampled_from(VALID_NUMBERS))
        return b"".join(parts)
    tree = to_tree(json.loads(original))
    for _ in range(draw(st.integers(1, 3))):
        owner, index = draw(st.sampled_from(entries_of(tree)))
        other, other_index = draw(st.sampled_from(entries_of(tree)))
        fields = isinstance(owner, Fields)
        value = draw(st.sampled_from(VALUES))
        if draw(st.booleans()):
            value = other[other_index]
            value = to_text(value[1] if isinstance(other, Fields) else value)
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
        if not entries_of(tree):
            break
    return to_text(tree).encode("utf-8", errors="surrogatepass")


INVALID_BYTES = [b"\0", b"\xff", b"\xed\xa0\x80", b'"', b"}", b"\xef\xbb\xbf"]


@st.composite
def damaged_bytes(draw, originals):
    """The bytes of a file in which some are lost, doubled or replaced."""
    content = draw(st.sampled_from(originals))
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(content)))
        end = min(len(content), start + draw(st.sampled_from([0, 1, 2, 7, 10**6])))
        middle = draw(st.sampled_from([b"", content[start:end] * 2, None]))
        if middle is None:
            middle = draw(st.sampled_from(INVALID_BYTES) | st.binary(max_size=3))
        content = content[:start] + middle + content[end:]
    return content


# CSV files


TRIALS = """angle_rad,px_m,py_m,moment_Nm,fx_N,fy_N,energy_J,note
0.1,0.001,0.002,1.5,2.5,3.5,0.1,first
0.2,0.001,-0.002,1.5,-2.5,3e-3,0.2,second
-0.1,0.002,0.001,2.5,.5,3.,0.3,"third, the last"
"""
MEASUREMENTS = [
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
    """The bytes of a file in which cells, rows or columns are changed."""
    text = draw(st.sampled_from(originals)).decode()
    separator = max(",;\t", key=text.split("\n")[0].count)
    rows = [line.split(separator) for line in text.split("\n")]
    for _ in range(draw(st.integers(1, 4))):
        row = draw(st.integers(0, len(rows) - 1))
        column = draw(st.integers(0, len(rows[row]) - 1)) if rows[row] else 0
        match draw(st.sampled_from(["cell", "head", "delete", "double", "lose", "swap"])):
            case "cell" if rows[row]:
                rows[row][column] = draw(st.sampled_from(CELLS))
            case "head" if rows[0]:
                rows[0][column % len(rows[0])] = draw(st.sampled_from(CELLS))
            case "delete" if len(rows) > 1:
                del rows[row]
            case "double":
                rows.insert(row, list(rows[row]))
            case "lose":
                rows = [line[:column] + line[column + 1 :] for line in rows]
            case "swap":
                rows[row], rows[-1] = rows[-1], rows[row]
    return "\n".join(map(separator.join, rows)).encode()


@st.composite
def extreme_trials(draw):
    """A file of trials with numbers that no real hinge has."""
    numbers = [0.0, 0.1, -0.3, 1.0, 5e-324, 1e-160, -1e-8, 1e8, 1e100, 1e160, 1e308]
    row = st.lists(st.sampled_from(numbers), min_size=6, max_size=6)
    rows = draw(st.lists(row, min_size=1, max_size=5))
    header = TRIALS.split(",energy")[0]
    return "\n".join([header, *(",".join(map(str, row)) for row in rows)]).encode()
