"""Code, links, and names in the README and in the manual."""

import contextlib
import importlib
import io
import pathlib
import re
import sys
from decimal import Decimal

import jax.numpy as jnp
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest

import twistorjax as tj


mpl.use("agg")

ROOT = pathlib.Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
MANUAL, GALLERY = ROOT / "notebooks" / "manual", ROOT / "notebooks" / "gallery"
PAGES = {
    path.stem: path
    for path in sorted([*MANUAL.glob("*.md"), *GALLERY.glob("*.md")])
    if "```python\n" in path.read_text()
}


def outputs_of(text: str) -> list[tuple[str, str]]:
    """Return the Python code blocks of a Markdown text, and the outputs below them."""
    pattern = r"^```python\n(.*?)^```(?:\n\n```\n(.*?)^```)?"
    return re.findall(pattern, text, re.DOTALL | re.MULTILINE)


def code_of(text: str) -> list[str]:
    """Return the Python code blocks of a Markdown text."""
    return [code for code, _ in outputs_of(text)]


def assert_same_output(printed: str, shown: str) -> None:
    """Compare texts; numbers may differ by two in the last digit, integers not at all."""
    number = r"[-+]?\b\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?"
    words = [re.sub(number, "#", text).split() for text in (printed, shown)]
    assert words[0] == words[1]
    pairs = zip(re.findall(number, printed), re.findall(number, shown), strict=True)
    for pair in pairs:
        value, expected = (Decimal(text.replace(",", "")) for text in pair)
        place = expected.as_tuple().exponent
        tolerance = 2 * Decimal(10) ** int(place) if place else 0
        assert abs(value - expected) <= tolerance, pair


@pytest.fixture(autouse=True)
def _settings_of_the_tests(monkeypatch):
    """Keep the settings of JAX, which all tests share."""
    monkeypatch.setattr(tj, "configure", lambda: None)


@pytest.fixture
def run_page(monkeypatch, tmp_path):
    """Run the code of a page of the manual, and compare what it prints.

    Returns its variables.
    """
    guide = code_of((MANUAL / "start.md").read_text())[0]
    (tmp_path / "guide.py").write_text(guide)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "guide", raising=False)

    def run(name: str) -> dict:
        variables: dict = {"__name__": "test_page"}  # whose warnings are errors
        for code, output in outputs_of(PAGES[name].read_text()):
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                exec(code, variables)
            if output:
                assert_same_output(printed.getvalue(), output)
        plt.close("all")
        text = PAGES[name].read_text()
        for figure in re.findall(r"\]\(([\w-]+\.(?:svg|gif))\)", text):
            saved = (tmp_path / figure).exists() or f'"{figure}"' not in text
            assert saved, f"{name} does not save {figure}"
        return variables

    yield run
    sys.modules.pop("guide", None)


def test_the_example_of_the_readme_is_a_parallel_guide(capsys):
    ((block, output),) = outputs_of(README)
    variables: dict = {}
    exec(block, variables)
    angle, x, y = variables["solution"].displacement("table")
    # two guided leaves in parallel: 2 * 12 EI / L^3
    stiffness = 24 * 210e9 * 10e-3 * 0.5e-3**3 / 12 / 50e-3**3
    np.testing.assert_allclose(x, 5 / stiffness, rtol=0.02)
    assert abs(angle) < 1e-5
    np.testing.assert_allclose(y, -3 / 5 * x**2 / 50e-3, rtol=2e-3)
    assert_same_output(capsys.readouterr().out, output)


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if page not in ("large-displacements", "statics")],
)
def test_the_code_of_the_manual_prints_what_its_page_shows(page, run_page):
    run_page(page)


@pytest.mark.slow
def test_the_page_on_statics_computes_a_parallel_guide(run_page):
    variables = run_page("statics")
    solution, travels = variables["solution"], variables["travels"]
    np.testing.assert_allclose(solution.reaction("base")[1:], [-5.0, 0.0], atol=1e-8)
    assert jnp.all(jnp.diff(travels) < 0)  # thicker leaves are stiffer


@pytest.mark.slow
def test_the_table_of_the_page_on_large_displacements_moves_down(run_page):
    variables = run_page("large-displacements")
    _, x, y = variables["solution"].displacement("table")
    # a guided leaf is a cubic, whose shortening is 3/5 of the square over the length
    np.testing.assert_allclose(y, -3 / 5 * x**2 / 50e-3, rtol=0.01)


def test_the_readme_has_one_screen_of_text():
    assert len(README.splitlines()) <= 150


def test_the_tree_of_the_readme_is_that_of_the_package():
    tree = README.split("```\ntwistorjax/\n")[1].split("```")[0]
    listed = {line.split()[0].rstrip("/") for line in tree.splitlines()}
    packages = {path.parent.name for path in (ROOT / "twistorjax").glob("*/__init__.py")}
    assert listed == packages


@pytest.mark.parametrize("path", [ROOT / "README.md", ROOT / "CONTRIBUTING.md"])
def test_links_lead_to_files(path):
    for target in re.findall(r"\]\((?!http)([^)#]+)[^)]*\)", path.read_text()):
        assert (ROOT / target).exists(), target


_ROWS = re.findall(
    r"^\| an? [^|]+ \| `(\w+)` \| (.+) \|$", (ROOT / "CONTRIBUTING.md").read_text(), re.M
)


@pytest.mark.parametrize("example, files", _ROWS)
def test_the_table_of_files_to_touch_is_true(example, files):
    listed = set(re.findall(r"`(\S+\.\S+)`", files))
    folders = ROOT / "twistorjax", ROOT / "notebooks" / "api"
    paths = [path for folder in folders for path in folder.rglob("*.*")]
    paths += [ROOT / "README.md", ROOT / "pyproject.toml", ROOT / "mkdocs.yml"]
    naming = {
        str(path.relative_to(ROOT))
        for path in paths
        if path.suffix in {".py", ".pyi", ".md", ".toml", ".yml"}
        and re.search(rf"\b{example}\b", path.read_text())
    }
    assert listed <= naming
    # Other modules only use what was added.
    uses = {name for name in naming if re.fullmatch(r"twistorjax/(?!io/).*\.py", name)}
    assert naming - uses <= listed


def test_the_table_of_files_to_touch_has_four_rows():
    assert [example for example, _ in _ROWS] == [
        "PointCharges", "linear_leaf", "state_space", "range_shares",
    ]  # fmt: skip


def test_times_in_the_pages_are_those_of_the_benchmarks(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "notebooks"))
    performance = importlib.import_module("performance")
    for page, text in performance.pages().items():
        assert page.read_text() == text


def test_numbers_in_the_paper_are_those_of_the_benchmarks(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "notebooks"))
    performance = importlib.import_module("performance")
    own, fast = performance.results()
    identified = performance.IDENTIFIED
    names = [
        performance.GAINS,
        performance.DERIVATIVES,
        performance.PEER.format("EXUDYN"),
        performance.MOTION,
        performance.PEER_MOTION.format("EXUDYN"),
        performance.PEER_MOTION.format("SciPy LSODA with Numba"),
        *(f"{identified}: {kind} compilation" for kind in ("without", "with")),
        f"{identified}: {performance.ERROR}",
        performance.PEER_IDENTIFIED,
        f"{performance.PEER_STEPS}: {performance.ERROR}",
        *(performance.WRENCH.format(model) for model in ("linear_leaf", "surrogate")),
    ]
    rate = fast.value(f"{performance.GAINS}, 1,000,000 designs")
    numbers = [own(name).removesuffix(" /s") for name in names]
    paper = (ROOT / "notebooks" / "paper.md").read_text()
    for number in (*numbers, f"{rate / 1e6:.3g} million"):
        assert f" {number}" in paper or f"({number}" in paper


@pytest.mark.parametrize(
    "namespace",
    ["energies", "flexures", "solve", "identification", "sweeps", "plotting", "io"],
)
def test_every_public_name_has_an_entry_in_the_api_pages(namespace):
    pages = (ROOT / "notebooks" / "api").glob("*.md")
    entries = re.findall(
        rf"^::: twistorjax\.{namespace}\.(\S+)",
        "\n".join(map(pathlib.Path.read_text, pages)),
        re.M,
    )
    documented = {name.split(".")[-1] for name in entries}
    module = getattr(tj, namespace)
    source = (ROOT / "twistorjax" / namespace / "__init__.pyi").read_text()
    public = set(re.findall(r"\b(\w+) as \1\b", source))
    assert documented == public
    assert all(hasattr(module, name) for name in documented)


def test_every_name_at_the_top_level_has_an_entry_in_the_api_pages():
    pages = (ROOT / "notebooks" / "api").glob("*.md")
    entries = re.findall(
        r"^::: (\S+)", "\n".join(map(pathlib.Path.read_text, pages)), re.M
    )
    documented = {name.split(".")[-1] for name in entries}
    modules = {name for name in dir(tj) if isinstance(getattr(tj, name), type(tj))}
    assert set(dir(tj)) - modules <= documented
