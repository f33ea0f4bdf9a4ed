"""Times of every analysis and of its gradient: first calls and next calls.

Each pair of an analysis and a mechanism is measured in two processes, which share a cache
folder that is empty at first. The first process compiles the programs, and the second one
loads them. Next calls in the second process have other dimensions. The times of first
calls include imports of modules that only the analysis needs, but neither the start of
Python nor the construction of the mechanism. `python -m benchmarks analyses --table FILE`
writes the table of the manual.
"""

import statistics
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

import twistorjax as tj

from .first_calls import empty_cache, printed_times
from .measure import Row


REPEATS = 3  # of next calls
CHANGE = 1e-4  # of the thickness from one call to the next, relative
WHEN = ("first call", "first call in a later process", "next call")
RESULT, GRADIENT = "result", "gradient"


@dataclass(frozen=True)
class Case:
    """A mechanism and what the analyses do with it.

    Args:
        build: Function that builds the mechanism from the thickness of its flexures.
        thickness: This thickness; m.
        loads: Input, as loads.
        stroke: Input, as the argument of `port_motion`.
        squeeze: Loads that compress the flexures.
        port: Body and coordinate of the output.
        travel: Displacement of the output under the loads, roughly; m.
        duration: Duration of the motion, roughly a period of the lowest mode; s.
    """

    build: Callable[[Any], tj.Mechanism]
    thickness: float
    loads: Sequence[tj.Load]
    stroke: Mapping[str, Any]
    squeeze: Sequence[tj.Load]
    port: tuple[str, Literal["x", "y"]]
    travel: float
    duration: float

    def output(self, solution: Any) -> jax.Array:
        """Return the displacement of the output, with axes of points or times in front.

        Args:
            solution: Any result that has displacements.
        """
        body, coordinate = self.port
        return solution.displacement(body)[..., ("angle", "x", "y").index(coordinate)]


def guide(thickness: Any) -> tj.Mechanism:
    """Build the guide of the README, with mass, damping, and properties for fatigue.

    Args:
        thickness: Thickness of the leaves; m.
    """
    steel = tj.Material(
        modulus=210e9, poisson=0.3, ultimate_strength=800e6, endurance_limit=300e6
    )
    leaf = tj.flexures.leaf(steel, length=50e-3, thickness=thickness, width=10e-3)
    bodies = [
        tj.Body("base"),
        tj.Body("table", pose=(0.0, 0.0, 60e-3), mass=0.078, inertia=6.6e-5),
    ]
    hinges = [
        tj.Hinge(name, "base", "table", leaf, at=(np.pi / 2, x, 30e-3), damping=1e-4)
        for name, x in (("left", -40e-3), ("right", 40e-3))
    ]
    return tj.Mechanism(bodies, hinges, fixed=["base"])


def stage(web: Any) -> tj.Mechanism:
    """Build the micropositioning stage, with damping and properties for fatigue.

    Args:
        web: Smallest thickness of the necks; m.
    """
    return tj.examples.stage.microstage(web, material=_aluminum(), damping=1e-5)


def bridge(web: Any) -> tj.Mechanism:
    """Build a bridge amplifier of eight notches, with the stack that drives it.

    Four links form a rhombus between the base, two input blocks, and the output block at
    the top. There is a notch at both ends of each link. If the stack between the input
    blocks becomes longer, the top moves down. The gain of rigid links on pins is the
    cotangent of the inclination of the links, 5.67.

    Args:
        web: Smallest thickness of the necks; m.
    """
    width, inclination, length = 10e-3, np.radians(10), 30e-3  # length of the links
    half, gap = 10e-3, 10e-3  # base and top: half width; input blocks: height
    aluminum = _aluminum()
    notch = tj.flexures.notch(aluminum, hole=3e-3, web=web, width=width)
    reach = half + length * np.cos(inclination)
    rise = length * np.sin(inclination)
    top = 2 * rise + gap

    def bar(name: str, start: np.ndarray, end: np.ndarray, height: float) -> tj.Body:
        along = (end - start) / np.linalg.norm(end - start)
        side = height / 2 * np.array([-along[1], along[0]])
        corners = np.array([start - side, end - side, end + side, start + side])
        return tj.plate(name, corners, width=width, material=aluminum)

    def block(name: str, x: float, y: float, size_x: float, size_y: float) -> tj.Body:
        start, end = np.array([x - size_x / 2, y]), np.array([x + size_x / 2, y])
        return bar(name, start, end, size_y)

    bodies = [
        block("base", 0.0, -3e-3, 2 * half, 6e-3),
        block("left", -reach - 3e-3, top / 2, 6e-3, gap),
        block("right", reach + 3e-3, top / 2, 6e-3, gap),
        block("top", 0.0, top + 3e-3, 2 * half, 6e-3),
    ]
    stack = tj.flexures.piezo_stack(
        free_stroke=60e-6, blocking_force=800.0, length=60e-3, width=5e-3
    )
    hinges = [tj.Hinge("stack", "left", "right", stack, at=(0.0, 0.0, top / 2))]
    for block_name, x in (("left", -1.0), ("right", 1.0)):
        for end_name, y, up in (("base", 0.0, 1.0), ("top", top, -1.0)):
            start = np.array([x * half, y])
            end = np.array([x * reach, y + up * rise])
            along = (end - start) / length
            link = f"{end_name} {block_name}"
            bodies.append(bar(link, start + 2e-3 * along, end - 2e-3 * along, 4e-3))
            angle = np.arctan2(along[1], along[0])
            for first, second, at in ((end_name, link, start), (link, block_name, end)):
                pose, name = (angle, *at), f"{first} to {second}"
                hinges.append(tj.Hinge(name, first, second, notch, pose, damping=1e-5))
    return tj.Mechanism(bodies, hinges, fixed=["base"])


def _aluminum() -> tj.Material:
    """Return the aluminum of the stage, with properties for fatigue."""
    return tj.Material(
        modulus=69e9,
        poisson=0.33,
        density=2.7e3,
        expansion=23.6e-6,
        ultimate_strength=310e6,
        endurance_limit=95e6,
    )


# Functions, because no array may be created before the cache folder is set.
CASES: dict[str, Callable[[], Case]] = {
    "guide": lambda: Case(
        guide,
        thickness=0.5e-3,
        loads=[tj.Load("table", force=(5.0, 0.0))],
        stroke={"drive": tj.Drive("table", x=1e-3)},
        squeeze=[tj.Load("table", force=(0.0, -200.0))],
        port=("table", "x"),
        travel=1.2e-3,
        duration=0.1,
    ),
    "stage": lambda: Case(
        stage,
        thickness=0.25e-3,
        loads=[tj.Load("6", force=(30.0, 0.0))],
        stroke={"drive": tj.Drive("6", x=1.35e-6)},
        squeeze=[tj.Load("4", force=(0.0, -100.0))],
        port=("4", "x"),
        travel=37e-6,
        duration=0.01,
    ),
    "bridge": lambda: Case(
        bridge,
        thickness=0.3e-3,
        loads=[tj.Load("left", force=(-800.0, 0)), tj.Load("right", force=(800.0, 0))],
        stroke={"strokes": {"stack": (0.0, 60e-6, 0.0)}},
        squeeze=[tj.Load("left", force=(200.0, 0)), tj.Load("right", force=(-200.0, 0))],
        port=("top", "y"),
        travel=-0.34e-3,
        duration=0.01,
    ),
}

Call = Callable[[Case, tj.Mechanism], Any]


def _with_gradient(
    call: Call, value: Callable[[Case, Any], jax.Array]
) -> tuple[Call, Call]:
    """Return an analysis, and its gradient with respect to all numbers of the mechanism.

    Args:
        call: The analysis.
        value: Number, computed from the result, that is differentiated.
    """

    def gradient(case: Case, mechanism: tj.Mechanism) -> tj.Mechanism:
        return eqx.filter_grad(lambda new: value(case, call(case, new)))(mechanism)

    return call, gradient


def _switch(_: Case, guide: tj.Mechanism) -> tj.Bistability:
    """Find the states of the guide under a weight that buckles its leaves.

    A small force selects the first state, and the load pushes the table to the other one.
    """
    weight = tj.Load("table", force=(0.05, -174.0))
    push = tj.Load("table", force=(-1.0, 0.0))
    return tj.bistability(guide, loads=[push], constant_loads=[weight])


def _study(case: Case) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """Return the function that sweeps, tolerances, and optimizations evaluate."""

    def study(design: Mapping[str, Any]) -> dict[str, Any]:
        mechanism = case.build(design["thickness"])
        solution = tj.equilibrium(mechanism, loads=case.loads, throw=False)
        travel = case.output(solution)
        error = (travel / case.travel - design.get("target", 1.0)) ** 2
        return {"travel": travel, "error": error, "result": solution.result}

    return study


def _sweep(case: Case, **settings: Any) -> Any:
    """Sweep over a hundred designs."""
    thickness = case.thickness * np.linspace(0.9, 1.1, 100)
    return tj.sweep(_study(case), {"thickness": thickness}, **settings)


def _start(case: Case) -> dict[str, Any]:
    """Return the parameters with which optimizations begin."""
    low, start, high = (ratio * case.thickness for ratio in (0.8, 1.1, 1.25))
    return {"thickness": tj.Parameter(start, lower=low, upper=high), "target": 1.0}


def _test(case: Case) -> tj.identification.StaticTest:
    """Return a test that measures the output under the loads."""
    sensor = tj.identification.BodySensor(*case.port, 1e-3 * abs(case.travel))
    return tj.identification.StaticTest([case.loads], [sensor])


def _identify(case: Case, travel: Any) -> tj.identification.Identification:
    """Identify the thickness from a measured displacement of the output (m)."""
    start = tj.Parameter(1.1 * case.thickness, lower=0)
    return tj.identify(case.build, start, [_test(case).measurement([[travel]])])


# The analyses, and their gradients or None. That of `sweep` has the derivatives of all
# designs. The other results without a gradient cannot be differentiated by `jax.grad`:
# `constraint_analysis`, `tolerances`, `optimize`, and `posterior` compute with NumPy, and
# the number of steps of `identify` depends on the data.
ANALYSES: dict[str, tuple[Call, Call | None]] = {
    "`equilibrium`": _with_gradient(
        lambda case, mechanism: tj.equilibrium(mechanism, loads=case.loads),
        lambda case, result: case.output(result),
    ),
    "`linearize` and a response": _with_gradient(
        lambda case, mechanism: tj.linearize(mechanism)(loads=case.loads),
        lambda case, result: case.output(result),
    ),
    "`port_compliance`": _with_gradient(
        lambda case, mechanism: tj.port_compliance(mechanism, case.port[0]),
        lambda case, result: result.stiffness_along(case.port[1]),
    ),
    "`port_motion`": _with_gradient(
        lambda case, mechanism: tj.port_motion(
            mechanism, case.port[0], direction=case.port[1], **case.stroke
        ),
        lambda _, result: result.force[-1],
    ),
    "`constraint_analysis`": (
        lambda _, mechanism: tj.constraint_analysis(mechanism),
        None,
    ),
    "`path`": _with_gradient(
        lambda case, mechanism: tj.path(mechanism, loads=case.squeeze),
        lambda _, result: result.energies[result.count - 1],
    ),
    "`buckling`": _with_gradient(
        lambda case, mechanism: tj.buckling(mechanism, loads=case.squeeze, modes=1),
        lambda _, result: result.load_factors[0],
    ),
    "`bistability`": _with_gradient(_switch, lambda _, result: result.snap_factors[0]),
    "`equilibrium` and `stresses`": _with_gradient(
        lambda case, mechanism: tj.stresses(
            mechanism, tj.equilibrium(mechanism, loads=case.loads)
        ),
        lambda _, result: result.largest[-1],
    ),
    "`range_of_motion`": _with_gradient(
        lambda case, mechanism: tj.range_of_motion(
            mechanism, loads=case.loads, stress=200e6
        ),
        lambda _, result: result.factors[1],
    ),
    "`equilibrium` and `fatigue`": _with_gradient(
        lambda case, mechanism: tj.fatigue(
            mechanism,
            [mechanism.reference, tj.equilibrium(mechanism, loads=case.loads)],
        ),
        lambda _, result: result.utilization[-1],
    ),
    "`vibrations`": _with_gradient(
        lambda _, mechanism: tj.vibrations(mechanism),
        lambda _, result: result.frequencies[0],
    ),
    "`frequency_response`": _with_gradient(
        lambda case, mechanism: tj.frequency_response(
            mechanism, [50.0, 500.0], loads=case.loads
        ),
        lambda case, result: jnp.abs(case.output(result)[0]),
    ),
    "`state_space`": _with_gradient(
        lambda case, mechanism: tj.state_space(
            mechanism, {load.body: load for load in case.loads}, {"output": case.port}
        ),
        lambda _, result: result.static_gain[0, 0],
    ),
    "`simulate`": _with_gradient(
        lambda case, mechanism: tj.simulate(
            mechanism, np.linspace(0.0, case.duration, 21), loads=case.loads
        ),
        lambda case, result: case.output(result)[-1],
    ),
    "`sweep`": (
        lambda case, _: _sweep(case),
        lambda case, _: _sweep(case, derivatives=["travel"]),
    ),
    "`tolerances`": (
        lambda case, _: tj.sweeps.tolerances(
            _study(case),
            {"thickness": tj.sweeps.Normal(case.thickness, 0.01 * case.thickness)},
            "travel",
        ),
        None,
    ),
    "`optimize`": (
        lambda case, _: tj.optimize(_study(case), _start(case), minimize="error"),
        None,
    ),
    "`optimize_cases`": (
        lambda case, _: tj.sweeps.optimize_cases(
            _study(case), _start(case), {"target": [0.999, 1.001]}, minimize="error"
        ),
        None,
    ),
    "`identify`": (
        lambda case, _: _identify(case, case.travel),
        None,
    ),
    "`identify` and `rank_experiments`": (
        lambda case, _: tj.identification.rank_experiments(
            _identify(case, case.travel),
            {"again": _test(case), "vibration": tj.identification.VibrationTest(1, 1.0)},
        ),
        None,
    ),
    "`identify` and `posterior`": (
        lambda case, _: tj.identification.posterior(
            _identify(case, case.travel), draws=100, tune=100
        ),
        None,
    ),
}

# Mechanisms of the analyses that make no sense for all of them. The stage and the bridge
# have one stable state.
ONLY = {"`bistability`": ("guide",)}


def run() -> Iterator[Row]:
    """Yield the rows of the table."""
    cells = [
        (kind, analysis, mechanism)
        for analysis, calls in ANALYSES.items()
        for kind, call in zip((RESULT, GRADIENT), calls, strict=True)
        for mechanism in ONLY.get(analysis, CASES)
        if call is not None
    ]
    for cell in tqdm(cells, desc="analyses", leave=False, disable=None):
        arguments = ["-W", "ignore::FutureWarning", "-m", __name__, *cell]  # of arviz
        with empty_cache() as environment:
            (first,) = printed_times([*arguments, "1"], environment)
            later, *following = printed_times([*arguments, str(1 + REPEATS)], environment)
        times = (first, later, statistics.median(following))
        for when, elapsed in zip(WHEN, times, strict=True):
            yield Row(_name(*cell, when), elapsed, "s")


def _name(kind: str, analysis: str, mechanism: str, when: str) -> str:
    """Return the name of a row."""
    return f"{analysis}, {kind}, {mechanism}: {when}"


def print_times(kind: str, analysis: str, mechanism: str, count: int) -> None:
    """Print the times of some calls in this process, one in each line; s.

    Raises:
        RuntimeError: A gradient is not finite.
    """
    tj.configure(progress=False)
    call = ANALYSES[analysis][(RESULT, GRADIENT).index(kind)]
    assert call is not None
    for number in range(count):
        case = CASES[mechanism]()
        case = replace(case, thickness=(1 + CHANGE * number) * case.thickness)
        built = case.build(case.thickness)
        jax.block_until_ready(eqx.filter(built, eqx.is_array))
        start = time.perf_counter()
        result = eqx.filter(call(case, built), eqx.is_inexact_array)
        jax.block_until_ready(result)
        print(time.perf_counter() - start)
        if kind == GRADIENT and not all(
            bool(jnp.all(jnp.isfinite(leaf))) for leaf in jax.tree.leaves(result)
        ):
            raise RuntimeError(f"The gradient of {analysis} is not finite: {result}")


HEAD = """# Times of first and next calls

The tables list the times of three calls of each analysis:

* **first**: the first call in a process, with an empty folder of compiled programs; s.
* **later**: the first call in a later process, which loads these programs; s.
* **next**: the next call in this process, with another thickness of the flexures, the
  median of {repeats} calls; ms.

The times include imports of modules that only the analysis needs, but neither the start
of Python, nor `import twistorjax`, nor the construction of the mechanism. `python -m
benchmarks analyses --table FILE` writes this page. See also
[First calls](performance.md#first-calls).

The mechanisms are:

* **guide**: a table on two leaves, two bodies and two hinges;
* **stage**: the [micropositioning stage](examples.md), six bodies and seven notches;
* **bridge**: a bridge amplifier, in which a piezoelectric stack drives four links with a
  notch at both ends, eight bodies and nine hinges.

`sweep` evaluates 100 designs, `tolerances` 8,192, and `optimize_cases` optimizes for two
values of a constant. `posterior` draws 100 samples in each of two chains, after 100 steps
of adaptation. An empty cell is an analysis that makes no sense for the mechanism: the
stage and the bridge have one stable state.

The times were {caption}.
"""
TITLES = {
    RESULT: "## Results\n",
    GRADIENT: """## Gradients

These calls are `equinox.filter_grad` of one number of the result, such as a displacement,
a frequency, or a load factor, with respect to all numbers of the mechanism, outside of
`jax.jit`. Each includes the computation of the result. For `sweep`, they are the
derivatives of all designs. Analyses that `jax.grad` cannot differentiate are left out.
""",
}


def to_markdown(rows: Sequence[Row], caption: str) -> str:
    """Format the page of the manual.

    Args:
        rows: Rows of `run`, and perhaps others.
        caption: Date, versions, and machine of the measurement.
    """
    seconds = {row.benchmark: row.value for row in rows}

    def cell(*names: str) -> str:
        value = seconds.get(_name(*names))
        if value is None:
            return ""
        if names[-1] == WHEN[-1]:
            value *= 1e3  # ms
        return f"{value:,.0f}" if value >= 99.5 else f"{value:.2g}"

    heading = " | ".join(f"{name}: first, s | later, s | next, ms" for name in CASES)
    parts = [HEAD.format(repeats=REPEATS, caption=caption)]
    for kind, title in TITLES.items():
        parts += [title, f"| analysis | {heading} |", "|---|" + "---:|" * 3 * len(CASES)]
        for analysis in ANALYSES:
            cells = [cell(kind, analysis, name, when) for name in CASES for when in WHEN]
            if any(cells):
                parts.append(f"| {analysis} | {' | '.join(cells)} |")
        parts.append("")
    return "\n".join(parts)


if __name__ == "__main__":
    *chosen, calls = sys.argv[1:]
    print_times(*chosen, count=int(calls))
