"""Structure of the package; `lint-imports` checks that imports run one way."""

import ast
import pathlib
import subprocess
import sys

import pytest

import twistorjax as tj


PACKAGE = pathlib.Path(tj.__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))
PACKAGES = [path for path in FILES if path.name == "__init__.py"]


def test_the_root_holds_at_most_twelve_packages():
    entries = [path for path in PACKAGE.iterdir() if path.is_dir()]
    assert len([path for path in entries if path.name != "__pycache__"]) <= 12


@pytest.mark.parametrize("path", PACKAGES, ids=lambda path: path.parent.name)
def test_every_package_says_what_it_is_for(path):
    words = ast.get_docstring(ast.parse(path.read_text()))
    assert words is not None
    assert len(words.split()) >= 15


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
