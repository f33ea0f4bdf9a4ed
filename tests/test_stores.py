"""Stores: names, several creators, folders that cannot be written, tables too large."""

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
from test_sweeps import area, HEAD, python, same, SIDES

import twistorjax as tj


xarray = pytest.importorskip("xarray")
pytest.importorskip("zarr")

ONE = np.arange(3.0)


def never(design):
    raise AssertionError("The study has been traced.")


def doubled(design):
    return {"double": sum(2.0 * part for part in design.values())}


@pytest.mark.parametrize("name", ["a b", "a/b", "a\\b", "a\tb", "__a", "..", "finished"])
@pytest.mark.parametrize("kind", [dict, tj.Grid])
def test_parameters_that_a_store_cannot_keep_are_refused_at_once(tmp_path, name, kind):
    with pytest.raises(ValueError) as error:
        tj.sweep(never, kind({name: ONE, "c": ONE}), store=tmp_path / "s.zarr")
    assert f"cannot keep the name {name!r}" in str(error.value)
    assert "without spaces, slashes" in str(error.value)
    assert not list(tmp_path.iterdir())
    # a table in memory has no such limit
    table = tj.sweep(doubled, {name: ONE, "c": ONE})
    np.testing.assert_array_equal(table[name], ONE)


@pytest.mark.parametrize("name", ["a b", "a/b", "finished"])
def test_answers_that_a_store_cannot_keep_are_refused_before_they_are_compiled(
    tmp_path, name, monkeypatch
):
    monkeypatch.setattr("twistorjax.sweeps.executor.Program._compile", never)
    for answer in (
        {name: 1.0},
        {"b": {name: 1.0}},
        {"b": tj.solve.Column(jnp.ones(1), ("x",), "", ((name, ("one",)),))},
        {
            "b": {name: tj.solve.Column(jnp.ones(1), (name,))},
            "y": tj.solve.Column(jnp.ones(1)),
        },
    )[: 2 if name != "finished" else 1]:
        with pytest.raises(ValueError, match="cannot keep the name"):
            tj.sweep(lambda d, a=answer: a, {"c": ONE}, store=tmp_path / "s.zarr")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("stored", [False, True])
@pytest.mark.parametrize(
    ("designs", "message"),
    [
        ({"result": ONE}, "has a parameter 'result', but every table has"),
        ({"succeeded": ONE}, "has a parameter 'succeeded', but every table has"),
        ({"a.b": ONE, "a": {"b": ONE}}, "has 2 parameters 'a.b'"),
    ],
)
def test_parameters_that_a_table_cannot_have_are_refused(
    tmp_path, designs, message, stored
):
    with pytest.raises(ValueError) as error:
        tj.sweep(never, designs, store=tmp_path / "s.zarr" if stored else None)
    assert message in str(error.value)


@pytest.mark.untyped
@pytest.mark.parametrize("name", ["result", "", 3])
def test_a_grid_refuses_names_that_a_table_cannot_have(name):
    with pytest.raises(ValueError, match="has a parameter"):
        tj.Grid({name: ONE})


SIDE = ("side", ("left", "right", "back"))


@pytest.mark.parametrize(
    ("designs", "answer", "message"),
    [
        (
            tj.Grid({"side": ONE}),
            {"y": tj.solve.Column(jnp.ones(3), ("side",))},
            "'y' has an axis 'side', but that is an axis of the designs",
        ),
        (
            {"side": ONE},
            {"y": tj.solve.Column(jnp.ones(3), ("side",), "", (SIDE,))},
            "'side' is an axis that has values or labels of its own",
        ),
        (
            {"k": ONE},
            {"y": tj.solve.Column(jnp.ones(2), ("side",), "", (SIDE,))},
            "'y' has 2 entries along 'side', but 3 labels",
        ),
        (
            {"k": ONE},
            {
                "y": tj.solve.Column(jnp.ones(3), ("side",), "", (SIDE,)),
                "z": tj.solve.Column(
                    jnp.ones(3), ("side",), "", (("side", ("a", "b", "c")),)
                ),
            },
            "The axis 'side' of 'z' has other labels",
        ),
        (
            {"time_places": ONE},
            {"time": tj.solve.Column(jnp.ones(3), ("time",))},
            "'time_places' is the name of a parameter or of an answer",
        ),
        (
            {"k": ONE},
            {"y": tj.solve.Column(jnp.ones(3))},
            "'y' has shape (3,), but its axes",
        ),
    ],
)
def test_axes_that_a_table_cannot_have_are_refused(designs, answer, message, monkeypatch):
    monkeypatch.setattr("twistorjax.sweeps.executor.Program._compile", never)
    with pytest.raises(ValueError) as error:
        tj.sweep(lambda design: answer, designs)
    assert message in str(error.value)


def test_an_answer_may_be_called_as_values_along_an_axis_are(tmp_path):
    """It is the same for all designs, but an answer nevertheless."""
    table = tj.sweep(
        lambda d: {"y": d["k"], "pick_places": 7.0}, {"k": ONE}, store=tmp_path / "s.zarr"
    )
    np.testing.assert_array_equal(table["pick_places"], [7.0, 7.0, 7.0])
    assert set(table.coords) == {"k"}


@pytest.mark.parametrize("resume", [False, True])
def test_of_two_that_create_a_store_at_once_none_dies(tmp_path, monkeypatch, resume):
    """The second creates it between the work of the first and its last step."""
    path, rename = tmp_path / "s.zarr", os.rename

    def late(made, place):
        monkeypatch.setattr(os, "rename", rename)
        same(tj.sweep(area, SIDES, store=path, resume=resume), tj.sweep(area, SIDES))
        # it has left what the first was making
        assert os.path.exists(made)
        rename(made, place)

    monkeypatch.setattr(os, "rename", late)
    if resume:
        same(tj.sweep(area, SIDES, store=path, resume=True), tj.sweep(area, SIDES))
    else:
        with pytest.raises(ValueError, match="which another process has created since"):
            tj.sweep(area, SIDES, store=path)
    assert [file.name for file in tmp_path.iterdir()] == ["s.zarr"]
    assert os.rename is rename


CREATING = (
    HEAD
    + """
import os, signal
from test_sweeps import area, SIDES
import twistorjax as tj
def kill(*paths):
    os.kill(os.getpid(), signal.SIGKILL)
if sys.argv[2] == "killed":
    os.rename = kill
elif sys.argv[2] == "paused":
    import time
    rename = os.rename
    def late(made, path):
        print("made", flush=True)
        sys.stdin.readline()
        rename(made, path)
    os.rename = late
tj.sweep(area, SIDES, store=sys.argv[1], resume=True)
print("done", flush=True)
"""
)


@pytest.mark.slow
def test_folders_of_killed_creators_go_and_those_of_others_stay(tmp_path):
    path = tmp_path / "s.zarr"
    process = python(CREATING, path, "killed")
    process.communicate()
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".s.zarr.")
    # as that of a process of another machine, which cannot be asked
    machine, rest = left.name.removeprefix(".s.zarr.").split("-", 1)
    elsewhere = tmp_path / f".s.zarr.{int(machine, 16) ^ 1:08x}-{rest}"
    old, other = tmp_path / f".s.zarr.00000000-{rest}", tmp_path / ".s.zarr.backup"
    shutil.copytree(left, elsewhere)
    for folder in (old, other):
        folder.mkdir()
        os.utime(folder, (0, 0))

    with contextlib.ExitStack() as stack:
        slow = python(CREATING, path, "paused", stdin=-1)
        stack.callback(slow.kill)
        assert "made" in slow.stdout.readline(), slow.stderr.read()
        assert not left.exists() and not old.exists()
        assert elsewhere.exists() and other.exists()
        same(tj.sweep(area, SIDES, store=path), tj.sweep(area, SIDES))
        output, errors = slow.communicate("go on\n", timeout=100)
        assert "done" in output, errors
    names = sorted(folder.name for folder in tmp_path.iterdir())
    assert names == sorted([elsewhere.name, other.name, "s.zarr"])


def test_parts_that_another_process_writes_now_stay(tmp_path):
    path = tmp_path / "s.zarr"
    tj.sweep(area, SIDES, store=path)
    now, long_ago = (path / "area" / "c" / f"0.{n}.partial" for n in range(2))
    for part in (now, long_ago):
        part.write_bytes(b"half")
    os.utime(long_ago, (time.time() - 1e4, time.time() - 1e4))
    tj.sweep(area, SIDES, store=path, resume=True)
    assert now.exists() and not long_ago.exists()


@contextlib.contextmanager
def largest_file(size):
    """As if the disk were full: no file can grow beyond this; bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def long(design):
    return {"long": jnp.sin(design["a"] * jnp.arange(1e3))}


def clear_error(error, path):
    assert f"The store {str(path)!r} cannot be written: " in str(error.value)
    assert len(str(error.value).splitlines()) == 1
    assert error.value.__cause__ is None
    assert error.value.__context__ is None or error.value.__suppress_context__


@pytest.mark.parametrize("size", [100, 4000])
def test_a_full_disk_is_one_clear_error(tmp_path, size):
    """Met while the store is created, or by the first chunk."""
    path = tmp_path / "s.zarr"
    with largest_file(size), pytest.raises(OSError, match="File too large") as error:
        tj.sweep(long, {"a": ONE}, chunk=2, store=path)
    clear_error(error, path)
    assert [file.name for file in tmp_path.iterdir()] == ["s.zarr"][: size > 100]
    assert not list(tmp_path.rglob("*.partial"))
    kept = tj.sweep(long, {"a": ONE}, chunk=2, store=path, resume=True)
    same(kept, tj.sweep(long, {"a": ONE}, chunk=2))


def test_a_read_only_folder_is_refused_before_any_work(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write anywhere
    path = tmp_path / "new" / "s.zarr"
    with pytest.raises(PermissionError, match="is read-only") as error:
        tj.sweep(never, {"a": ONE}, store=path)
    clear_error(error, path)
    assert not list(tmp_path.iterdir())


def test_a_place_that_is_no_folder_is_refused_before_any_work(tmp_path):
    (tmp_path / "file").touch()
    path = tmp_path / "file" / "s.zarr"
    with pytest.raises(NotADirectoryError, match="is not a folder") as error:
        tj.sweep(never, {"a": ONE}, store=path)
    clear_error(error, path)


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_a_folder_that_takes_no_files_is_one_clear_error():
    path = pathlib.Path("/proc/s.zarr")
    with pytest.raises(OSError) as error:
        tj.sweep(area, SIDES, store=path)
    clear_error(error, path)


def test_a_finished_store_that_is_read_only_is_continued(tmp_path, monkeypatch):
    path = tmp_path / "s.zarr"
    kept = tj.sweep(area, SIDES, store=path)
    with largest_file(0):
        same(tj.sweep(area, SIDES, store=path, resume=True), kept)


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
    monkeypatch.setattr("twistorjax.sweeps.executor.Program._compile", never)
    with pytest.raises(ValueError) as error:
        tj.sweep(lambda d: d["a"] * jnp.ones(2**27), large(2**20), chunk=1)
    assert "1,048,576 designs needs at least 1.05e+06 GiB" in str(error.value)


def test_where_the_memory_is_not_known_its_end_is_a_clear_error(monkeypatch):
    monkeypatch.setattr("twistorjax.sweeps.memory._memory", lambda: None)
    with pytest.raises(ValueError, match="the memory of this machine cannot hold"):
        tj.sweep(area, {name: np.broadcast_to(1.0, 2**46) for name in "ab"})


@pytest.mark.parametrize("method", ["sobol", "latin", "random"])
def test_more_samples_than_the_memory_holds_are_refused(method):
    with pytest.raises(ValueError, match=r"at least 1\.49e\+06 GiB"):
        tj.sweeps.sample_designs(
            {"a": tj.sweeps.Uniform([0.0, 0.0], 1.0)}, 10**14, method=method
        )
    with pytest.raises(ValueError, match=r"at least 1\.49e\+06 GiB"):
        spread = {"a": tj.sweeps.Uniform([0.0, 0.0], 1.0)}
        tj.sweeps.tolerances(never, spread, count=10**14, method=method)


def test_more_designs_than_can_be_numbered_are_refused():
    grid = tj.Grid({name: np.linspace(0.0, 1.0, 10**5) for name in "abcd"})
    with pytest.raises(ValueError, match=r"a grid of 1e\+20 designs, but at most 9.22e"):
        tj.sweep(never, grid)
