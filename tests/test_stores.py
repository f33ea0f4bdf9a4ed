"""Stores: tables that are too large."""

import time

import jax.numpy as jnp
import numpy as np
import pytest
from test_sweeps import area

import twistorjax as tj


xarray = pytest.importorskip("xarray")
pytest.importorskip("zarr")

ONE = np.arange(3.0)


def never(design):
    raise AssertionError("The study has been traced.")


def doubled(design):
    return {"double": sum(2.0 * part for part in design.values())}


def large(count):
    """So many designs without the memory for them."""
    return {"a": np.broadcast_to(1.0, count)}


@pytest.mark.parametrize("stored", [False, True])
@pytest.mark.parametrize(
    "designs",
    [
        tj.Grid({name: np.linspace(0.0, 1.0, 30_000) for name in "abc"}),
        large(2**45),
        {"a": np.broadcast_to(1.0, (2**30, 2**15))},
    ],
)
def test_a_table_beyond_the_memory_is_refused_before_any_work(tmp_path, designs, stored):
    start = time.monotonic()
    with pytest.raises(ValueError) as error:
        tj.sweep(never, designs, store=tmp_path / "s.zarr" if stored else None)
    assert "GiB, which the memory of this machine of" in str(error.value)
    assert "Use fewer designs, or split them" in str(error.value)
    assert time.monotonic() - start < 1.0 and not list(tmp_path.iterdir())


def test_answers_beyond_the_memory_are_refused_before_they_are_compiled(monkeypatch):
    """A million designs of a gigabyte each."""
    monkeypatch.setattr("twistorjax.sweeps.engine.Program._compile", never)
    with pytest.raises(ValueError) as error:
        tj.sweep(lambda d: d["a"] * jnp.ones(2**27), large(2**20), chunk=1)
    assert "1,048,576 designs needs at least 1.05e+06 GiB" in str(error.value)


def test_where_the_memory_is_not_known_its_end_is_a_clear_error(monkeypatch):
    monkeypatch.setattr("twistorjax.sweeps.machine._memory", lambda: None)
    with pytest.raises(ValueError, match="the memory of this machine cannot hold"):
        tj.sweep(area, {name: np.broadcast_to(1.0, 2**46) for name in "ab"})


@pytest.mark.parametrize("method", ["sobol", "latin", "random"])
def test_more_samples_than_the_memory_holds_are_refused(method):
    with pytest.raises(ValueError, match=r"at least 1\.49e\+06 GiB"):
        tj.sampled({"a": tj.Uniform([0.0, 0.0], 1.0)}, 10**14, method=method)
    with pytest.raises(ValueError, match=r"at least 1\.49e\+06 GiB"):
        spread = {"a": tj.Uniform([0.0, 0.0], 1.0)}
        tj.tolerances(never, spread, count=10**14, method=method)


def test_more_designs_than_can_be_numbered_are_refused():
    grid = tj.Grid({name: np.linspace(0.0, 1.0, 10**5) for name in "abcd"})
    with pytest.raises(ValueError, match=r"a grid of 1e\+20 designs, but at most 9.22e"):
        tj.sweep(never, grid)
