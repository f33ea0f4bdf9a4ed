"""Studies, designs and processes that several tests of sweeps use."""

import os
import pathlib
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

import twistorjax as tj


def spring(design):
    """Return a block on a spring of stiffness k."""
    stiffness = jnp.diag(jnp.stack([jnp.ones(()), design["k"], jnp.full((), 100.0)]))
    hinge = tj.Hinge("spring", "wall", "block", tj.Quadratic(stiffness), at=(0, 0, 0))
    return tj.Mechanism([tj.Body("wall"), tj.Body("block")], [hinge], fixed=["wall"])


def pulled_block(design):
    """The travel of a block on a spring, which is force divided by stiffness."""
    load = tj.Load("block", (0.0, design["force"], 0.0))
    solution = tj.equilibrium(spring(design), loads=[load], throw=False)
    return {"travel": solution.displacement("block")[1], "result": solution.result}


def area(design):
    """A study so cheap that the time of a sweep is that of its store."""
    return {"area": jnp.sin(design["a"]) * design["b"], "twice": 2.0 * design["a"]}


SIDES = {"a": np.linspace(0.0, 1.0, 1000), "b": np.linspace(1.0, 2.0, 1000)}


def assert_same_dataset(actual, expected):
    """Equal variables, coordinates and axes, with the same bits."""
    import xarray

    xarray.testing.assert_identical(actual.drop_attrs(), expected.drop_attrs())


@pytest.fixture
def compiled(monkeypatch):
    """Gather the new programs of studies, without those of other tests."""
    # Not before the plugin of jaxtyping has prepared the import of the package.
    from twistorjax.sweeps.executor import _programs, Program

    _programs.clear()
    programs, lower = [], Program.lower

    def counted(self):
        programs.append(self)
        lower(self)

    monkeypatch.setattr(Program, "lower", counted)
    return programs


# Start of the code of each process.
PREAMBLE = """
import sys, time, jax
jax.config.update("jax_enable_x64", True)
"""


def start_process(code, *arguments, **options):
    """Start a Python process that can import the modules of the tests."""
    here = str(pathlib.Path(__file__).parent)
    environment = {**os.environ, "PYTHONPATH": here}
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        **options,
    )
