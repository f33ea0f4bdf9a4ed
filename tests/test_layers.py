"""Imports run one way, from the mechanics to the studies."""

import ast
import pathlib
import subprocess
import sys

import pytest


LAYERS = [
    "_types", "_checks", "_trees", "se2", "clifford", "lines", "strains", "damping",
    "energy", "coulomb", "monomials", "polynomial", "slender", "mixed", "certified",
    "files", "schemas", "storage", "columns", "trials", "leastsquares", "fitted",
    "regression", "quotients", "flexure", "body", "hinge", "grip", "pull", "stacks",
    "assembly", "couplings", "mechanism", "boundary", "joints", "solve", "study",
    "sweeps", "show", "exchange", "cases", "commands", "__main__",
]  # fmt: skip
PACKAGE = pathlib.Path(__file__).parents[1] / "twistorjax"
FILES = [path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py"]


def layers_imported_by(path):
    climbs = len(path.relative_to(PACKAGE).parts)
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level == climbs:
            targets = [node.module] if node.module else [a.name for a in node.names]
            yield from (target.split(".")[0] for target in targets)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_a_layer_imports_only_earlier_ones(path):
    layer = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    earlier = LAYERS[: LAYERS.index(layer)]
    assert set(layers_imported_by(path)) <= set(earlier)


def test_no_file_is_longer_than_one_concept():
    assert max(len(path.read_text().splitlines()) for path in FILES) <= 400


def test_importing_changes_nothing():
    """Neither JAX's settings nor, by packages that few need, the time to start."""
    code = (
        "import jax, sys; before = jax.config.values.copy(); import twistorjax; "
        "assert jax.config.values == before; "
        "assert not {'matplotlib', 'msgspec'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
