"""What a store cannot hold or write is rejected early, with one clear message."""

import contextlib
import os
import pathlib
import resource
import shutil
import sys
import time

import jax.numpy as jnp
import numpy as np
import pytest
from sweep_helpers import area, assert_same_dataset, PREAMBLE, SIDES, start_process

import twistorjax as tj


pytest.importorskip("xarray")
pytest.importorskip("zarr")

VALUES = np.arange(3.0)
SIDE_LABELS = ("side", ("left", "right", "back"))


def untraceable(design):
    raise AssertionError("The study has been traced.")


def uncompilable(program):
    raise AssertionError("The program has been compiled.")


def doubled(design):
    return {"double": sum(2.0 * part for part in design.values())}


@pytest.mark.parametrize("name", ["a b", "a/b", "a\\b", "a\tb", "__a", "..", "finished"])
@pytest.mark.parametrize("kind", [dict, tj.Grid])
def test_parameters_that_a_store_cannot_hold_are_rejected_at_once(tmp_path, name, kind):
    designs = kind({name: VALUES, "c": VALUES})
    with pytest.raises(ValueError) as error:
        tj.sweep(untraceable, designs, store=tmp_path / "s.zarr")
    assert f"cannot hold the name {name!r}" in str(error.value)
    assert "must not contain spaces, slashes" in str(error.value)
    assert not list(tmp_path.iterdir())
    # A dataset in memory has no such limit.
    table = tj.sweep(doubled, {name: VALUES, "c": VALUES})
    np.testing.assert_array_equal(table[name], VALUES)


@pytest.mark.parametrize("name", ["a b", "a/b", "finished"])
def test_outputs_that_a_store_cannot_hold_are_rejected_before_compilation(
    tmp_path, name, monkeypatch
):
    monkeypatch.setattr("twistorjax.sweeps.executor.Program._compile", uncompilable)
    for output in (
        {name: 1.0},
        {"b": {name: 1.0}},
        {"b": tj.solve.Column(jnp.ones(1), ("x",), "", ((name, ("one",)),))},
        {
            "b": {name: tj.solve.Column(jnp.ones(1), (name,))},
            "y": tj.solve.Column(jnp.ones(1)),
        },
    )[: 2 if name != "finished" else 1]:
        with pytest.raises(ValueError, match="cannot hold the name"):
            tj.sweep(lambda _, out=output: out, {"c": VALUES}, store=tmp_path / "s.zarr")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("stored", [False, True])
@pytest.mark.parametrize(
    ("designs", "message"),
    [
        ({"result": VALUES}, "has a parameter 'result', but this name is reserved"),
        ({"succeeded": VALUES}, "has a parameter 'succeeded', but this name is reserved"),
        ({"a.b": VALUES, "a": {"b": VALUES}}, "has 2 parameters 'a.b'"),
    ],
)
def test_parameters_that_a_dataset_cannot_hold_are_rejected(
    tmp_path, designs, message, stored
):
    with pytest.raises(ValueError) as error:
        tj.sweep(untraceable, designs, store=tmp_path / "s.zarr" if stored else None)
    assert message in str(error.value)


@pytest.mark.untyped
@pytest.mark.parametrize("name", ["result", "", 3])
def test_a_grid_rejects_names_that_a_dataset_cannot_hold(name):
    with pytest.raises(ValueError, match="has a parameter"):
        tj.Grid({name: VALUES})


@pytest.mark.parametrize(
    ("designs", "output", "message"),
    [
        (
            tj.Grid({"side": VALUES}),
            {"y": tj.solve.Column(jnp.ones(3), ("side",))},
            "'y' has an axis 'side', but this is an axis of the designs",
        ),
        (
            {"side": VALUES},
            {"y": tj.solve.Column(jnp.ones(3), ("side",), "", (SIDE_LABELS,))},
            "'side' is an axis with its own values or labels",
        ),
        (
            {"k": VALUES},
            {"y": tj.solve.Column(jnp.ones(2), ("side",), "", (SIDE_LABELS,))},
            "'y' has 2 entries along 'side', but 3 labels",
        ),
        (
            {"k": VALUES},
            {
                "y": tj.solve.Column(jnp.ones(3), ("side",), "", (SIDE_LABELS,)),
                "z": tj.solve.Column(
                    jnp.ones(3), ("side",), "", (("side", ("a", "b", "c")),)
                ),
            },
            "The axis 'side' of 'z' has other labels",
        ),
        (
            {"time_coordinate": VALUES},
            {"time": tj.solve.Column(jnp.ones(3), ("time",))},
            "A parameter or an output has the name 'time_coordinate'",
        ),
        (
            {"k": VALUES},
            {"y": tj.solve.Column(jnp.ones(3))},
            "'y' has shape (3,), but its axes",
        ),
    ],
)
def test_axes_that_a_dataset_cannot_have_are_rejected(
    designs, output, message, monkeypatch
):
    monkeypatch.setattr("twistorjax.sweeps.executor.Program._compile", uncompilable)
    with pytest.raises(ValueError) as error:
        tj.sweep(lambda design: output, designs)
    assert message in str(error.value)


def test_an_output_may_have_a_name_like_that_of_a_coordinate(tmp_path):
    """It is the same for all designs, but it has no axis and stays an output."""
    table = tj.sweep(
        lambda design: {"y": design["k"], "pick_coordinate": 7.0},
        {"k": VALUES},
        store=tmp_path / "s.zarr",
    )
    np.testing.assert_array_equal(table["pick_coordinate"], [7.0, 7.0, 7.0])
    assert set(table.coords) == {"k"}


@pytest.mark.parametrize("resume", [False, True])
def test_two_processes_may_create_a_store_at_the_same_time(tmp_path, monkeypatch, resume):
    """The second creates it between the work of the first and its last step."""
    path, rename = tmp_path / "s.zarr", os.rename
    expected = tj.sweep(area, SIDES)

    def delayed_rename(temporary, target):
        monkeypatch.setattr(os, "rename", rename)
        assert_same_dataset(tj.sweep(area, SIDES, store=path, resume=resume), expected)
        # The second has not removed the folder of the first.
        assert os.path.exists(temporary)
        rename(temporary, target)

    monkeypatch.setattr(os, "rename", delayed_rename)
    if resume:
        assert_same_dataset(tj.sweep(area, SIDES, store=path, resume=True), expected)
    else:
        with pytest.raises(ValueError, match="which another process created after"):
            tj.sweep(area, SIDES, store=path)
    assert [file.name for file in tmp_path.iterdir()] == ["s.zarr"]
    assert os.rename is rename


CREATING = (
    PREAMBLE
    + """
import os, signal
from sweep_helpers import area, SIDES
import twistorjax as tj
def kill(*paths):
    os.kill(os.getpid(), signal.SIGKILL)
if sys.argv[2] == "killed":
    os.rename = kill
elif sys.argv[2] == "paused":
    import time
    rename = os.rename
    def delayed_rename(temporary, path):
        print("created", flush=True)
        sys.stdin.readline()
        rename(temporary, path)
    os.rename = delayed_rename
tj.sweep(area, SIDES, store=sys.argv[1], resume=True)
print("done", flush=True)
"""
)


@pytest.mark.release
def test_folders_of_killed_creators_are_removed_and_those_of_others_stay(tmp_path):
    path = tmp_path / "s.zarr"
    process = start_process(CREATING, path, "killed")
    process.communicate()
    (abandoned,) = tmp_path.iterdir()
    assert abandoned.name.startswith(".s.zarr.")
    # A process may still write a recent folder.
    recent, other = tmp_path / ".s.zarr.0123abcd", tmp_path / ".s.zarr.backup"
    shutil.copytree(abandoned, recent)
    other.mkdir()
    for folder in (abandoned, other):
        os.utime(folder, (0, 0))

    with contextlib.ExitStack() as stack:
        paused = start_process(CREATING, path, "paused", stdin=-1)
        stack.callback(paused.kill)
        assert paused.stdout is not None and paused.stderr is not None
        assert "created" in paused.stdout.readline(), paused.stderr.read()
        assert not abandoned.exists()
        assert recent.exists() and other.exists()
        assert_same_dataset(tj.sweep(area, SIDES, store=path), tj.sweep(area, SIDES))
        output, errors = paused.communicate("continue\n", timeout=100)
        assert "done" in output, errors
    names = sorted(folder.name for folder in tmp_path.iterdir())
    assert names == sorted([recent.name, other.name, "s.zarr"])


def test_files_that_another_process_is_writing_stay(tmp_path):
    path = tmp_path / "s.zarr"
    tj.sweep(area, SIDES, store=path)
    recent, old = (path / "area" / "c" / f"0.{n}.partial" for n in range(2))
    for part in (recent, old):
        part.write_bytes(b"half")
    os.utime(old, (time.time() - 1e4, time.time() - 1e4))
    tj.sweep(area, SIDES, store=path, resume=True)
    assert recent.exists() and not old.exists()


@contextlib.contextmanager
def largest_file(size):
    """Simulate a full disk: no file can become larger than `size`; bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def sines(design):
    return {"sines": jnp.sin(design["a"] * jnp.arange(1e3))}


def assert_clear_error(error, path):
    """The error names the store, has one line, and hides the error of zarr."""
    assert f"The store {str(path)!r} cannot be written: " in str(error.value)
    assert len(str(error.value).splitlines()) == 1
    assert error.value.__cause__ is None
    assert error.value.__context__ is None or error.value.__suppress_context__


@pytest.mark.parametrize("size", [100, 4000])
def test_a_full_disk_is_one_clear_error(tmp_path, size):
    """It occurs while the store is created, or when the first chunk is written."""
    path = tmp_path / "s.zarr"
    with largest_file(size), pytest.raises(OSError, match="File too large") as error:
        tj.sweep(sines, {"a": VALUES}, chunk_size=2, store=path)
    assert_clear_error(error, path)
    assert [file.name for file in tmp_path.iterdir()] == ["s.zarr"][: size > 100]
    assert not list(tmp_path.rglob("*.partial"))
    stored = tj.sweep(sines, {"a": VALUES}, chunk_size=2, store=path, resume=True)
    assert_same_dataset(stored, tj.sweep(sines, {"a": VALUES}, chunk_size=2))


def test_a_read_only_folder_is_rejected_before_any_work(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write anywhere
    path = tmp_path / "new" / "s.zarr"
    with pytest.raises(PermissionError, match="is read-only") as error:
        tj.sweep(untraceable, {"a": VALUES}, store=path)
    assert_clear_error(error, path)
    assert not list(tmp_path.iterdir())


def test_a_parent_that_is_not_a_folder_is_rejected_before_any_work(tmp_path):
    (tmp_path / "file").touch()
    path = tmp_path / "file" / "s.zarr"
    with pytest.raises(NotADirectoryError, match="is not a folder") as error:
        tj.sweep(untraceable, {"a": VALUES}, store=path)
    assert_clear_error(error, path)


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_a_folder_that_accepts_no_files_is_one_clear_error():
    path = pathlib.Path("/proc/s.zarr")
    with pytest.raises(OSError) as error:
        tj.sweep(area, SIDES, store=path)
    assert_clear_error(error, path)


def test_a_complete_store_that_is_read_only_is_resumed(tmp_path):
    path = tmp_path / "s.zarr"
    stored = tj.sweep(area, SIDES, store=path)
    with largest_file(0):
        assert_same_dataset(tj.sweep(area, SIDES, store=path, resume=True), stored)


def many_designs(count):
    """Return a given number of equal designs, which need almost no memory."""
    return {"a": np.broadcast_to(1.0, count)}


@pytest.mark.parametrize("stored", [False, True])
@pytest.mark.parametrize(
    "designs",
    [
        tj.Grid({name: np.linspace(0.0, 1.0, 30_000) for name in "abc"}),
        many_designs(2**45),
        {"a": np.broadcast_to(1.0, (2**30, 2**15))},
    ],
)
def test_a_dataset_that_exceeds_the_memory_is_rejected_before_any_work(
    tmp_path, designs, stored
):
    start = time.monotonic()
    with pytest.raises(ValueError) as error:
        tj.sweep(untraceable, designs, store=tmp_path / "s.zarr" if stored else None)
    assert "GiB, which is more than the memory of this machine (" in str(error.value)
    assert "Use fewer designs, or split them" in str(error.value)
    assert time.monotonic() - start < 1.0 and not list(tmp_path.iterdir())


def test_outputs_that_exceed_the_memory_are_rejected_before_compilation(monkeypatch):
    """A million designs of a gigabyte each."""
    monkeypatch.setattr("twistorjax.sweeps.executor.Program._compile", uncompilable)
    with pytest.raises(ValueError) as error:
        tj.sweep(lambda d: d["a"] * jnp.ones(2**27), many_designs(2**20), chunk_size=1)
    assert "1,048,576 designs needs at least 1.05e+06 GiB" in str(error.value)


def test_a_failed_allocation_is_a_clear_error_if_the_memory_is_unknown(monkeypatch):
    monkeypatch.setattr("twistorjax._utils.memory._machine_memory", lambda: None)
    with pytest.raises(ValueError, match=r"is more than the memory of this machine\."):
        tj.sweep(area, {name: np.broadcast_to(1.0, 2**46) for name in "ab"})


@pytest.mark.parametrize("method", ["sobol", "latin_hypercube", "random"])
def test_samples_that_exceed_the_memory_are_rejected(method):
    designs = {"a": tj.sweeps.Uniform([0.0, 0.0], 1.0)}
    with pytest.raises(ValueError, match=r"at least 1\.49e\+06 GiB"):
        tj.sweeps.sample_designs(designs, 10**14, method=method)
    with pytest.raises(ValueError, match=r"at least 1\.49e\+06 GiB"):
        tj.sweeps.tolerances(untraceable, designs, count=10**14, method=method)


def test_a_grid_with_too_many_designs_is_rejected():
    grid = tj.Grid({name: np.linspace(0.0, 1.0, 10**5) for name in "abcd"})
    with pytest.raises(ValueError, match=r"a grid of 1e\+20 designs, but at most 9.22e"):
        tj.sweep(untraceable, grid)
