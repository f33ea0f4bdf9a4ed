"""Structure of the package; `lint-imports` checks that imports run one way."""

import ast
import importlib
import inspect
import pathlib
import re
import subprocess
import sys
import tomllib

import jax
import jax.numpy as jnp
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


def test_all_files_state_the_same_version():
    patterns = {
        "README.md": r"version = \{(.*)\}",
        "CITATION.cff": r"^version: (.*)$",
        "CHANGELOG.md": r"^## (\d\S*) \(\d{4}-\d\d-\d\d\)$",
    }
    for name, pattern in patterns.items():
        found = re.search(pattern, (ROOT / name).read_text(), re.M)
        assert found is not None and found[1] == tj.__version__, name


def test_the_list_of_versions_has_every_dependency():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    needed = [*project["project"]["dependencies"]]
    for group in project["project"]["optional-dependencies"].values():
        needed += group
    for group in project["dependency-groups"].values():
        needed += [entry for entry in group if isinstance(entry, str)]
    names = {re.split(r"[^\w-]", entry)[0].replace("_", "-") for entry in needed}
    listed = re.findall(
        r"^([\w-]+)==", (ROOT / "tests" / "constraints.txt").read_text(), re.M
    )
    assert names <= set(listed)


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


def test_misspelled_names_are_corrected():
    with pytest.raises(AttributeError, match="Did you mean 'equilibrium'"):
        getattr(tj, "equilbrium")  # noqa: B009
    with pytest.raises(AttributeError, match=r"'twistorjax.flexures' has no attr"):
        getattr(tj.flexures, "zzz")  # noqa: B009
    assert not hasattr(tj, "__wrapped__")


def test_parts_of_a_mechanism_are_printed_with_their_numbers():
    steel = tj.Material(modulus=210e9, poisson=0.3)
    assert repr(steel) == "Material(modulus=2.1e+11, poisson=0.3)"
    leaf = tj.flexures.leaf(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
    hinge = tj.Hinge("left", "base", "table", leaf, at=(0.0, 0.1, 0.2))
    assert "bending_stiffness=0.021875" in repr(hinge)
    assert "at=[0, 0.1, 0.2]" in repr(hinge)
    assert repr(tj.Body("base")) == "Body(name='base', pose=[0, 0, 0])"
    many = jax.vmap(lambda pose: tj.Body("base", pose))(jnp.zeros((100, 3)))
    assert "f64[100,3]" in repr(many)
    sizes = []
    jax.jit(lambda x: sizes.append(repr(tj.Body("base", x))))(jnp.zeros(3))
    assert "pose=f64[3]" in sizes[0]
