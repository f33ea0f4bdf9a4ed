"""Structure of the package; `lint-imports` checks that imports run one way."""

import ast
import importlib
import inspect
import pathlib
import re
import subprocess
import sys
import tomllib

import pytest

import twistorjax as tj


PACKAGE = pathlib.Path(tj.__file__).parent
ROOT = pathlib.Path(__file__).parents[1]
FILES = sorted(PACKAGE.rglob("*.py"))
LONG_NAMES = r"Union\[|jax\.jaxlib"  # which `help` would print without aliases
GEOMETRY = ["lines", "se2", "twistors"]
PACKAGES = [path for path in FILES if path.name == "__init__.py"]


def test_the_readme_lists_all_packages_from_the_lowest_to_the_highest():
    """The contract on layers in `pyproject.toml` keeps this order."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    layers = project["tool"]["importlinter"]["contracts"][0]["layers"]
    packages = [layer.split(".")[1] for layer in layers[:0:-1]]
    listed = re.findall(r"^  (\w+)/ ", (ROOT / "README.md").read_text(), re.M)
    assert listed == packages
    assert {path.parent.name for path in PACKAGE.glob("*/__init__.py")} == set(packages)


@pytest.mark.parametrize("path", PACKAGES, ids=lambda path: path.parent.name)
def test_every_package_has_a_docstring_about_its_purpose(path):
    docstring = ast.get_docstring(ast.parse(path.read_text()))
    assert docstring is not None
    assert len(docstring.split()) >= 15


@pytest.mark.slow
def test_importing_does_not_change_settings_of_jax():
    """Packages that take long to load are imported when they are used."""
    code = (
        "import jax, sys; before = jax.config.values.copy(); import twistorjax; "
        "assert jax.config.values == before; "
        "twistorjax.Mechanism, twistorjax.equilibrium, twistorjax.flexures.leaf; "
        "slow = {'matplotlib', 'diffrax', 'scipy'} & set(sys.modules); "
        "assert not slow, slow"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def _public():
    """Return all public functions, classes, and methods by name."""
    namespaces = [tj, *(getattr(tj, name) for name in dir(tj))]
    namespaces = [space for space in namespaces if inspect.ismodule(space)]
    parts = [importlib.import_module(f"twistorjax.geometry.{name}") for name in GEOMETRY]
    parts += [
        space
        for name in dir(tj.examples)
        if inspect.ismodule(space := getattr(tj.examples, name))
    ]
    found = {}
    for space in [*namespaces, *parts]:
        for name in dir(space):
            value = getattr(space, name)
            home = getattr(value, "__module__", "")
            local = home == space.__name__ if space in parts else "twistorjax" in home
            if name.startswith("_") or not callable(value) or not local:
                continue
            found[f"{home}.{name}"] = value
            for part in inspect.getmro(value) if inspect.isclass(value) else ():
                if part.__module__.startswith("twistorjax"):
                    found |= _methods(part)
    return found


def _methods(part):
    members = {
        f"{part.__module__}.{part.__name__}.{name}": getattr(
            value, "fget", getattr(value, "__func__", value)
        )
        for name, value in vars(part).items()
        if name == "__init__" or not name.startswith("_")
    }
    return {
        name: value
        for name, value in members.items()
        if callable(value) and not inspect.isclass(value)
    }


def test_docstrings_of_public_functions_describe_all_arguments():
    missing = []
    for name, value in _public().items():
        _, has_section, section = (inspect.getdoc(value) or "").partition("Args:")
        if has_section and not inspect.isclass(value):
            arguments = {*inspect.signature(value).parameters} - {"self", "cls"}
            missing += [
                f"{name}: {each}" for each in arguments if f"{each}:" not in section
            ]
    assert not missing


def test_signatures_print_the_names_of_types():
    shown = {name: str(inspect.signature(value)) for name, value in _public().items()}
    assert len(shown) > 300
    long = [name for name, text in shown.items() if re.search(LONG_NAMES, text)]
    assert not long
