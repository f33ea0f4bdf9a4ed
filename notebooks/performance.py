"""Write the tables and figures of times in the manual and the README.

python -m benchmarks --out benchmarks/RESULTS
python notebooks/performance.py

All numbers are from `benchmarks/RESULTS.json`. Between the comments
`<!-- measured -->` and `<!-- end -->` of a page stands a table.
"""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import typer
from validation import save


FOLDER = Path(__file__).parent
RESULTS = FOLDER.parent / "benchmarks" / "RESULTS.json"
README = FOLDER.parent / "README.md"
PAGE = FOLDER / "manual" / "performance.md"

GAINS = "sweep: stage: nonlinear gains"
DERIVATIVES = f"{GAINS} and exact derivatives"
LINEAR = "sweep: stage: linearized gains"
FREQUENCIES = "sweep: stage: three natural frequencies"
MOTIONS = "sweep: released four-bar linkage: motion for 0.2 s"
ONE = "stage: one equilibrium, by a call of `equilibrium`"
COMPILED = "stage: one equilibrium, by the compiled program"
COMPILATION = "stage: compilation of the equilibrium"
MOTION = "released four-bar linkage: motion for 0.2 s"
MOTION_COMPILATION = "released four-bar linkage: compilation"
PEER = "{}: stage: nonlinear gains, on one core"
PEER_MOTION = "{}: released four-bar linkage: one simulation, on one core"
EQUILIBRIUM = "`equilibrium`, result, stage"
FIRST = "first call of {} in a new process, without a cache"
LATER = "first call of {} in a new process, with a cache"
GRADIENT = "reverse-mode gradient of simulate"
IDENTIFIED = "identification of three stiffnesses"
ERROR = "error of the estimates"
PEER_STEPS = "EXUDYN (1000 steps), finite differences, SciPy"
PEER_IDENTIFIED = f"{PEER_STEPS}: {IDENTIFIED}"
WRENCH = (
    "`{}`, rotations up to 46° in the range of `leaf`: "
    "RMS error of the wrench, largest component"
)
HEIGHT = "parallel guide displaced by L/10: change of height, error of `{}`"
ENERGIES = {
    "leaf": "leaf",
    "surrogate": "surrogate",
    "linear_leaf": "linear hinge",
}


class Results:
    """Results of a machine, formatted with their units."""

    def __init__(self, rows: Sequence[Mapping]) -> None:
        """Take the rows of a record of `RESULTS.json`."""
        self.rows = {row["benchmark"]: row for row in rows}

    def value(self, name: str) -> float:
        """Return a result without its unit."""
        return self.rows[name]["value"]

    def seconds(self, name: str) -> float:
        """Return a time in s."""
        factor = {"s": 1.0, "ms": 1e-3}[self.rows[name]["unit"]]
        return factor * self.value(name)

    def __call__(self, *names: str) -> str:
        """Format results: two digits, or three of a rate."""
        return ", ".join(map(self._format, names))

    def _format(self, name: str) -> str:
        value, unit = self.value(name), self.rows[name]["unit"]
        if unit == "/s":
            return f"{float(f'{value:.3g}'):,.0f} /s"
        if unit in ("s", "ms"):
            value, unit = self.seconds(name), "s"
            if value < 0.1:
                value, unit = 1e3 * value, "ms"
        if unit == "relative":
            return f"{value:.0e}"
        return f"{float(f'{abs(value):.2g}'):,g} {unit}".strip()


def readme(own: Results) -> str:
    """Format the table of the README."""
    errors = [
        ", ".join(
            f"{own(what.format(energy))} ({name})"
            for energy, name in ENERGIES.items()
        )
        for what in (WRENCH, HEIGHT)
    ]
    first = own(
        f"{EQUILIBRIUM}: first call",
        FIRST.format("simulate"),
        FIRST.format(GRADIENT),
    )
    later = own(
        f"{EQUILIBRIUM}: first call in a later process",
        LATER.format("simulate"),
        LATER.format(GRADIENT),
    )
    exudyn, numpy = (own(PEER.format(name)) for name in ("EXUDYN", "NumPy"))
    motions = [
        f"{label} {own(PEER_MOTION.format(name))}"
        for name, label in (
            ("EXUDYN", "EXUDYN"),
            ("SciPy LSODA", "SciPy (LSODA)"),
            ("SciPy LSODA with Numba", "compiled by Numba"),
        )
    ]
    rows = [
        ("wrench (moment and force) of a leaf in its validity range, with "
         "rotations up to 46°, error relative to the exact beam", errors[0],
         ""),
        ("height change of a parallel guide that is displaced by a tenth of "
         "its leaf length, error", errors[1], ""),
        ("displacement gain of the stage", f"{own(GAINS)} (2 cores)",
         f"EXUDYN {exudyn}, NumPy {numpy} (1 core each)"),
        ("gain and its exact derivatives",
         f"{own(DERIVATIVES)} (2 cores)", ""),
        ("motion of a four-bar linkage for 0.2 s, with an error of 1e-4 rad",
         own(MOTION), ", ".join(motions)),
        ("three stiffnesses identified from a motion",
         f"{own(f'{IDENTIFIED}: without compilation')}, error "
         f"{own(f'{IDENTIFIED}: {ERROR}')}",
         f"EXUDYN with SciPy {own(PEER_IDENTIFIED)}, error "
         f"{own(f'{PEER_STEPS}: {ERROR}')}"),
        ("first equilibrium, motion, gradient of a motion in a process: with "
         "compilation", first, ""),
        ("the same in later processes, which load the programs", later, ""),
    ]  # fmt: skip
    return table(("", "twistorjax", "peers"), rows)


def numbers(own: Results) -> str:
    """Format the table of the page for the processor."""
    later = "first call in a later process"
    rows = [
        ("sweep over designs of the stage: nonlinear displacement gains",
         own(GAINS)),
        ("sweep: nonlinear gains and their exact derivatives",
         own(DERIVATIVES)),
        ("sweep: linearized gains", own(LINEAR)),
        ("one equilibrium of the stage, by the compiled program, and by "
         "`tj.equilibrium`", own(COMPILED, ONE)),
        ("compilation of the equilibrium", own(COMPILATION)),
        ("the same nonlinear gains with EXUDYN (C++), one core",
         own(PEER.format("EXUDYN"))),
        ("the same nonlinear gains with Newton's method in NumPy, one core",
         own(PEER.format("NumPy"))),
        ("motion of a released four-bar linkage for 0.2 s, error 1e-4 rad",
         own(MOTION)),
        ("a batch of 1,000 such motions, one core",
         own("1,000 released four-bar linkages: simulations")),
        ("compilation of this motion", own(MOTION_COMPILATION)),
        ("the same motion and error with EXUDYN, one core",
         own(PEER_MOTION.format("EXUDYN"))),
        ("the same motion and error with LSODA of SciPy",
         own(PEER_MOTION.format("SciPy LSODA"))),
        ("the same with a time derivative that Numba compiles",
         own(PEER_MOTION.format("SciPy LSODA with Numba"))),
        (f"identification of three stiffnesses from a motion, error "
         f"{own(f'{IDENTIFIED}: {ERROR}')}, without and with compilation",
         own(f"{IDENTIFIED}: without compilation",
             f"{IDENTIFIED}: with compilation")),
        ("the same identification with EXUDYN (1,000 steps), finite "
         f"differences, and SciPy, error {own(f'{PEER_STEPS}: {ERROR}')}",
         own(PEER_IDENTIFIED)),
        ("first equilibrium in a new process, without and with stored "
         "programs",
         own(f"{EQUILIBRIUM}: first call", f"{EQUILIBRIUM}: {later}")),
        *(
            (f"{what}, without and with stored programs",
             own(FIRST.format(name), LATER.format(name)))
            for what, name in (
                ("first motion in a new process", "simulate"),
                ("its gradient in reverse mode", GRADIENT),
                ("this identification as the first call in a new process",
                 "identify"),
            )
        ),
        ("`twistorjax stage`, second call",
         f"{own('`twistorjax stage`: second call')} (`import jax`: "
         f"{own('`import jax`')})"),
    ]  # fmt: skip
    return table(("benchmark", "result"), rows)


def accelerators(own: Results, fast: Results) -> str:
    """Format the table of the page that compares with an accelerator."""
    million = f"{GAINS}, 1,000,000 designs"
    rows = [
        (what, fast(*names), own(*names))
        for what, *names in (
            ("sweep over 1,000,000 designs of the stage: nonlinear gains",
             million),
            ("sweep over 100,000 designs: nonlinear gains", GAINS),
            ("sweep over 100,000 designs: nonlinear gains and their exact "
             "derivatives", DERIVATIVES),
            ("sweep over 20,000 designs: three natural frequencies",
             FREQUENCIES),
            ("motions of a released four-bar linkage for 0.2 s, error 1e-4 "
             "rad, in a sweep of 100,000 designs (2 cores: 500)", MOTIONS),
            ("one equilibrium of the stage", COMPILED),
            ("one such motion", MOTION),
            ("compilation of the equilibrium, of the motion",
             COMPILATION, MOTION_COMPILATION),
        )
    ]  # fmt: skip
    return table(("benchmark", "NVIDIA H200", "2 cores"), rows)


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format a Markdown table."""
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def with_tables(page: Path, *tables: str) -> str:
    """Return the text of a page with other tables between its comments."""
    between = r"(?<=<!-- measured -->\n)[^<]*(?=\n<!-- end -->)"
    texts = iter(tables)
    text, count = re.subn(between, lambda _: next(texts), page.read_text())
    if count != len(tables):
        raise ValueError(f"{page} has {count} of {len(tables)} tables.")
    return text


def rates(own: Results, fast: Results) -> None:
    """Draw rates over the number of designs."""
    axes = axes_of("designs", "displacement gains per second")
    for label, results in (("2 cores", own), ("NVIDIA H200", fast)):
        # A single design is one equilibrium, whose time is in ms.
        measured = {
            1: 1e3 / results.value(ONE),
            100_000: results.value(GAINS),
        }
        for count in (100, 1_000, 10_000, 1_000_000):
            name = f"{GAINS}, {count:,} designs"
            if name in results.rows:
                measured[count] = results.value(name)
        points = zip(*sorted(measured.items()), strict=True)
        axes.plot(*points, "o-", label=f"twistorjax, {label}")
    for name, style in (("EXUDYN", "k--"), ("NumPy", "k:")):
        rate = 2 * own.value(PEER.format(name))
        axes.plot([1, 1e6], [rate, rate], style, label=f"{name}, 2 cores")
    save(axes, "rate")


def bodies(own: Results) -> None:
    """Draw times over the number of bodies."""
    axes = axes_of("bodies", "time (s)")
    chain = "chain of {:,} hinges, end rotated by 3 rad: {}"
    lattice = "lattice of {0} x {0} squares: motion for 20 ms"
    hinges, sides = (10, 100, 1_000, 3_000), (10, 20, 40)
    squares = [side**2 for side in sides]
    for label, style, sparse, prefix, way in (
        ("twistorjax", "o-", "", "", "without compilation"),
        ("EXUDYN", "s--", "EXUDYN, sparse: ", "EXUDYN: ", "10 load steps"),
    ):
        times = [own.value(sparse + chain.format(n, way)) for n in hinges]
        axes.plot(
            hinges,
            times,
            f"C0{style}",
            label=f"{label}, chain in equilibrium",
        )
        times = [own.value(prefix + lattice.format(n)) for n in sides]
        axes.plot(
            squares, times, f"C1{style}", label=f"{label}, lattice in motion"
        )
    save(axes, "bodies")


def first_calls(own: Results) -> None:
    """Draw times of first calls, also in later processes, and next calls."""
    names = {
        f"`{analysis}` of the stage": [
            f"`{analysis}`, result, stage: {kind}"
            for kind in (
                "first call",
                "first call in a later process",
                "next call",
            )
        ]
        for analysis in ("equilibrium", "vibrations", "path", "optimize")
    }
    names["`simulate` a four-bar linkage"] = [
        FIRST.format("simulate"), LATER.format("simulate"), MOTION
    ]  # fmt: skip
    for peer in ("SciPy LSODA with Numba", "EXUDYN"):
        first = f"{peer}: first motion in a new process"
        names[f"{peer}, the same"] = [first, first, PEER_MOTION.format(peer)]
    axes = axes_of("time (s)", "")
    heights = range(len(names))[::-1]
    kinds = (
        ("o", "first call"),
        ("s", "in a later process"),
        ("^", "next call"),
    )
    for (marker, kind), calls in zip(
        kinds, zip(*names.values(), strict=True), strict=True
    ):
        times = [own.seconds(call) for call in calls]
        axes.plot(times, heights, marker, mfc="none", label=kind)
    axes.set_yscale("linear")
    axes.set_yticks(heights, names)
    save(axes, "first-calls")


def axes_of(x: str, y: str) -> plt.Axes:
    """Create axes with logarithmic scales."""
    axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")[1]
    axes.set(xscale="log", yscale="log", xlabel=x, ylabel=y)
    return axes


def pages() -> dict[Path, str]:
    """Return the pages with the numbers of `RESULTS.json`."""
    own, fast = results()
    tables = numbers(own), accelerators(own, fast)
    return {
        README: with_tables(README, readme(own)),
        PAGE: with_tables(PAGE, *tables),
    }


def results() -> tuple[Results, Results]:
    """Return the results of two cores, and of an accelerator."""
    records = json.loads(RESULTS.read_text())
    two = [
        Results(records[machine]["rows"])
        for machine in (
            "2 cores, x86_64, cpu",
            "16 cores, x86_64, NVIDIA H200",
        )
    ]
    return two[0], two[1]


def main() -> None:
    """Write all tables and figures."""
    for page, text in pages().items():
        page.write_text(text)
    own, fast = results()
    rates(own, fast)
    bodies(own)
    first_calls(own)


if __name__ == "__main__":
    typer.run(main)
