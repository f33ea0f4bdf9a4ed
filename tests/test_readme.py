"""The README's code runs as it stands."""

import pathlib
import re

import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest


mpl.use("agg")

README = (pathlib.Path(__file__).parents[1] / "README.md").read_text()


@pytest.mark.slow
def test_its_code_runs_and_its_table_is_a_parallelogram(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scope = {}
    for block in re.findall(r"```python\n(.*?)```", README, re.DOTALL):
        exec(block, scope)
    solution, sweep = scope["solution"], scope["sweep"]
    # two guided leaves side by side: 2 * 12 EI / L^3
    stiffness = 24 * 210e9 * 10e-3 * 0.5e-3**3 / 12 / 50e-3**3
    np.testing.assert_allclose(
        solution.displacement("table")[1], 5 / stiffness, rtol=0.02
    )
    assert abs(solution.displacement("table")[2]) < 1e-8  # what the README says it misses
    np.testing.assert_allclose(solution.reaction("base")[1:], [-5.0, 0.0], atol=1e-8)
    assert jnp.all(jnp.diff(sweep) < 0)  # thicker is stiffer
    printed = capsys.readouterr().out.splitlines()
    assert "[ True False] ['successful' 'not_finite']" in printed
    assert "m/m 10000" in printed
    _, travel, sinking = scope["sinking"].displacement("table")
    np.testing.assert_allclose(sinking, -3 / 5 * travel**2 / 50e-3, rtol=0.01)


def test_its_tree_is_that_of_the_package():
    package = pathlib.Path(__file__).parents[1] / "twistorjax"
    tree = README.split("```\ntwistorjax/\n")[1].split("```")[0]
    told = {line.split()[0].rstrip("/") for line in tree.splitlines()}
    there = {
        path.name
        for path in package.iterdir()
        if not path.name.startswith("__") and not path.name.startswith("_")
    } | {"__main__.py"}
    assert told == there - {"py.typed"}


def test_its_links_lead_somewhere():
    for target in re.findall(r"\]\((?!http)([^)]+)\)", README):
        assert (pathlib.Path(__file__).parents[1] / target).exists(), target
