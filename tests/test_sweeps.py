"""Many designs at once: as one by one, whatever chunks, devices and ends there are."""

import itertools
import json
import os
import pathlib
import random
import socket
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import twistorjax as tj
from twistorjax.examples import stage
from twistorjax.examples.sweep_studies import stage_gain


xarray = pytest.importorskip("xarray")
pytest.importorskip("zarr")


def spring(design):
    """A block on a spring that is pulled: its travel is force over stiffness."""
    stiffness = jnp.diag(jnp.stack([jnp.ones(()), design["k"], jnp.full((), 100.0)]))
    hinge = tj.Hinge("spring", "wall", "block", tj.Quadratic(stiffness), at=(0, 0, 0))
    return tj.Mechanism([tj.Body("wall"), tj.Body("block")], [hinge], fixed=["wall"])


def pulled(design):
    load = tj.Load("block", (0.0, design["force"], 0.0))
    solution = tj.equilibrium(spring(design), loads=[load], throw=False)
    return {"travel": solution.displacement("block")[1], "result": solution.result}


def area(design):
    """So cheap that a store's own ways are what takes the time."""
    return {"area": jnp.sin(design["a"]) * design["b"], "twice": 2.0 * design["a"]}


SIDES = {"a": np.linspace(0.0, 1.0, 1000), "b": np.linspace(1.0, 2.0, 1000)}


def test_each_design_is_as_if_it_were_alone():
    designs = {"k": np.linspace(50.0, 150.0, 7), "force": np.linspace(-0.2, 0.3, 7)}
    table = tj.sweep(pulled, designs, chunk=3)
    np.testing.assert_allclose(table.travel, designs["force"] / designs["k"], rtol=1e-9)
    assert table.travel.dims == ("design",)
    np.testing.assert_array_equal(table.k, designs["k"])
    assert bool(table.succeeded.all()) and not table.result.any()


def test_a_grid_has_all_combinations():
    grid = tj.Grid({"k": [50.0, 100.0, 200.0], "force": [1.0, 2.0]})
    table = tj.sweep(pulled, grid, chunk=4, units={"k": "N/m", "travel": "m"})
    assert table.travel.dims == ("k", "force")
    force, k = np.array([1.0, 2.0]), np.array([50.0, 100.0, 200.0])
    np.testing.assert_allclose(table.travel, force / k[:, None], rtol=1e-9)
    assert table.k.attrs["units"] == "N/m" and table.travel.attrs["units"] == "m"


def test_derivatives_come_with_the_answers():
    designs = {"k": np.array([50.0, 100.0]), "force": np.array([0.1, 0.3])}
    units = {"k": "N/m", "force": "N", "travel": "m"}
    table = tj.sweep(pulled, designs, derivatives=("travel",), units=units)
    np.testing.assert_allclose(table.travel_by_force, 1 / designs["k"], rtol=1e-9)
    slopes = -designs["force"] / designs["k"] ** 2
    np.testing.assert_allclose(table.travel_by_k, slopes, rtol=1e-9)
    assert table.travel_by_k.attrs["units"] == "m/(N/m)"
    assert table.travel_by_force.attrs["units"] == "m/N"


def test_many_parameters_are_differentiated_in_reverse():
    def study(design):
        return {"sum": jnp.sum(design["x"] ** 3), "pair": design["x"][:2] ** 2}

    x = np.arange(80.0).reshape(2, 40)
    table = tj.sweep(study, {"x": x}, derivatives=("sum", "pair"))
    np.testing.assert_allclose(table.sum_by_x, 3 * x**2)
    assert table.pair_by_x.dims == ("design", "pair_0", "x_0")
    np.testing.assert_allclose(table.pair_by_x[1, 1, 1], 2 * x[1, 1])


def test_a_design_without_an_answer_harms_no_other():
    """A spring that pushes has no equilibrium; NaN comes in with one load."""
    designs = {"k": np.array([100.0, -50.0, 100.0, 100.0]), "force": np.ones(4)}
    designs["force"][2] = np.nan
    with pytest.warns(UserWarning, match="2 of 4 designs have no answer"):
        table = tj.sweep(pulled, designs, derivatives=("travel",))
    assert table.succeeded.values.tolist() == [True, False, False, True]
    assert np.isnan(table.travel[1:3]).all() and np.isnan(table.travel_by_k[1:3]).all()
    np.testing.assert_array_equal(table.travel[[0, 3]], 0.01)
    names = table.result.attrs["flag_meanings"].split()
    told = [names[code] for code in table.result.values]
    assert told == ["successful", "unstable", "not_finite", "successful"]


def test_answers_of_the_library_tell_their_names_and_units():
    def study(design):
        solution = tj.equilibrium(
            spring(design), loads=[tj.Load("block", (0, 1, 0))], throw=False
        )
        return {"rest": solution, "stiff": tj.solve.Column(design["k"], unit="N/m")}

    table = tj.sweep(study, {"k": np.array([50.0, 100.0])})
    assert table["rest.x"].attrs["units"] == "m"
    np.testing.assert_allclose(table["rest.x"].sel(body="block"), [0.02, 0.01])
    assert table["stiff"].attrs["units"] == "N/m"


def test_times_of_motions_are_a_coordinate():
    def study(design):
        block = tj.Body("block", mass=1.0, inertia=1.0)
        stiffness = jnp.diag(jnp.stack([jnp.ones(()), design["k"], jnp.ones(())]))
        hinge = tj.Hinge("s", "wall", "block", tj.Quadratic(stiffness), at=(0, 0, 0))
        swing = tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])
        let_go = {"block": (0.0, 0.01, 0.0)}
        times = [0.0, 0.05, 0.1]
        return tj.simulate(swing, times, velocities=let_go, tolerance=1e-9, throw=False)

    k = np.array([100.0, 400.0])
    table = tj.sweep(study, {"k": k})
    np.testing.assert_array_equal(table.time, [0.0, 0.05, 0.1])
    assert table.x.dims == ("design", "time", "body")
    swings = 0.01 / np.sqrt(k) * np.sin(np.sqrt(k) * 0.1)
    np.testing.assert_allclose(table.x.sel(body="block")[:, -1], swings, rtol=1e-5)


def test_a_chunk_is_as_small_as_the_memory_asks():
    def wide(design):
        return {"sum": jnp.sum(jnp.sort(jnp.sin(design["a"] * jnp.arange(1000.0))))}

    table = tj.sweep(wide, {"a": np.linspace(0, 1, 600)}, memory=1e6)
    assert table.attrs["chunk"] < 600
    whole = tj.sweep(wide, {"a": np.linspace(0, 1, 600)})
    np.testing.assert_allclose(table["sum"], whole["sum"], rtol=1e-12)
    with pytest.raises(ValueError, match="`chunk` is 600, which takes"):
        tj.sweep(wide, {"a": np.linspace(0, 1, 600)}, memory=1e6, chunk=600)


def test_a_study_is_compiled_once():
    calls = []

    def study(design):
        calls.append(1)
        return design["a"]

    for start in (0.0, 1.0, 2.0):
        table = tj.sweep(study, {"a": np.linspace(start, 5, 10)})
        np.testing.assert_array_equal(table.answer, table.a)
    assert len(calls) == 1


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (dict(designs={"a": np.ones(3), "b": np.ones(2)}), "3 of a, 2 of b, but must"),
        (dict(designs={"a": 1.0, "b": np.ones(2)}), "has a of shape ()"),
        (dict(designs={}), "has no array"),
        (dict(derivatives=["areas"]), "can be differentiated is 'area', 'twice'"),
        (dict(units={"told": "mm"}, study=lambda d: {"told": tj.solve.Column(d["a"], (), "m")}),
         "`units` gives 'told' the unit 'mm', but the study tells it in 'm'"),
        (dict(study=lambda d: {"c": d["a"], "d": "word"}), "answers 'word' as 'd'"),
        (dict(study=3), "`study` is 3, but must be a function"),
        (dict(units={"c": "m"}), "`units` names 'c', but there are a, b, area, twice"),
        (dict(chunk=0), "`chunk` is 0"),
        (dict(resume=True), "`resume` is given, but no `store`"),
        (dict(study=lambda design: None), "but must answer an array"),
        (dict(study=lambda design: {"a": design["b"]}), "'a' is what the study answers"),
        (dict(study=lambda d: {"result": d["a"]}), "'result' is what the study answers"),
        (dict(settings={"f": np.sin}), "`settings` must be numbers, texts"),
        (dict(memory=8.0), "`chunk` is 1, which takes"),
        (dict(study=lambda design: float(design["a"])), "`study` is a function that"),
        (
            dict(study=lambda d: {"x": tj.solve.Column(jnp.ones(2), ("n",)),
                                  "y": tj.solve.Column(jnp.ones(3), ("n",))}),
            "'y' has 3 entries along 'n', where another has 2",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_swept_is_refused(arguments, message):
    with pytest.raises(ValueError) as error:
        tj.sweep(**{"study": area, "designs": SIDES, **arguments})
    assert message in str(error.value)


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("values", "message"),
    [({}, "`values` is empty"), ({"a": 1.0}, "must be a row of numbers")],
)
def test_what_is_no_grid_is_refused(values, message):
    with pytest.raises(ValueError, match=message):
        tj.Grid(values)


def same(one, other):
    xarray.testing.assert_identical(one.drop_attrs(), other.drop_attrs())


def files(path):
    """When each file of numbers was written."""
    return {
        file: file.stat().st_mtime_ns
        for file in sorted(path.rglob("*"))
        if file.is_file() and "/c/" in str(file)
    }


def test_a_store_has_the_same_bits_and_is_not_computed_again(tmp_path):
    plain = tj.sweep(area, SIDES, chunk=128, units={"a": "m"})
    kept = tj.sweep(area, SIDES, chunk=128, units={"a": "m"}, store=tmp_path / "s.zarr")
    same(kept, plain)
    before = files(tmp_path / "s.zarr")
    again = tj.sweep(
        area, SIDES, units={"a": "m"}, store=tmp_path / "s.zarr", resume=True
    )
    same(again, plain)
    assert files(tmp_path / "s.zarr") == before


def test_a_store_is_read_by_xarray_itself(tmp_path):
    tj.sweep(area, SIDES, chunk=128, units={"a": "m"}, store=tmp_path / "s.zarr")
    table = xarray.open_zarr(tmp_path / "s.zarr", consolidated=False)
    np.testing.assert_array_equal(table.twice, 2 * SIDES["a"])
    assert "a" in table.coords and table.a.attrs["units"] == "m"


def test_a_grid_in_a_store_is_opened_as_one(tmp_path):
    grid = tj.Grid({"b": [1.0, 2.0, 3.0], "a": [0.5, 0.25]})
    kept = tj.sweep(area, grid, chunk=4, store=tmp_path / "s.zarr")
    assert kept.area.dims == ("b", "a")
    same(tj.sweeps.open_sweep(tmp_path / "s.zarr"), tj.sweep(area, grid))


@pytest.mark.parametrize("harm", ["torn", "gone", "other"])
def test_a_torn_chunk_is_computed_again(tmp_path, harm):
    path = tmp_path / "s.zarr"
    kept = tj.sweep(area, SIDES, chunk=128, store=path).load()
    chunk = path / "area" / "c" / "3"
    whole = chunk.read_bytes()
    if harm == "torn":
        chunk.write_bytes(whole[: len(whole) // 2])
    elif harm == "gone":
        chunk.unlink()
    else:
        chunk.write_bytes((path / "area" / "c" / "4").read_bytes())
    before = files(path)
    same(tj.sweep(area, SIDES, store=path, resume=True), kept)
    after = files(path)
    changed = {file.name for file in after if after[file] != before.get(file)}
    assert changed == {"3"}
    assert chunk.read_bytes() == whole


def another(design):
    return {"area": jnp.cos(design["a"]) * design["b"], "twice": 2.0 * design["a"]}


@pytest.mark.parametrize(
    ("study", "designs", "settings", "message"),
    [
        (another, SIDES, {}, "differs in study (area then, another now), the program"),
        (area, {**SIDES, "b": SIDES["b"] + 1}, {}, "differs in the designs"),
        (area, SIDES, dict(chunk=64), "chunk (128 then, 64 now)"),
        (
            area,
            SIDES,
            dict(settings={"by": "me"}),
            'settings ({} then, {"by": "me"} now)',
        ),
    ],
)
def test_a_store_of_another_sweep_is_refused(tmp_path, study, designs, settings, message):
    path = tmp_path / "s.zarr"
    tj.sweep(area, SIDES, chunk=128, store=path)
    before = files(path)
    with pytest.raises(ValueError) as error:
        tj.sweep(study, designs, store=path, resume=True, **settings)
    assert message in str(error.value)
    assert files(path) == before


def test_a_constant_of_the_study_tells_stores_apart(tmp_path):
    def scaled(by):
        return lambda design: design["a"] * by

    path = tmp_path / "s.zarr"
    tj.sweep(scaled(jnp.arange(2000.0)), SIDES, chunk=128, store=path)
    changed = jnp.arange(2000.0).at[1234].set(0.0)
    with pytest.raises(ValueError, match="differs in the program"):
        tj.sweep(scaled(changed), SIDES, store=path, resume=True)


def test_a_store_that_is_there_is_not_written_over(tmp_path):
    tj.sweep(area, SIDES, store=tmp_path / "s.zarr")
    with pytest.raises(ValueError, match="which is there already"):
        tj.sweep(area, SIDES, store=tmp_path / "s.zarr")
    (tmp_path / "other").mkdir()
    with pytest.raises((ValueError, OSError)):
        tj.sweep(area, SIDES, store=tmp_path / "other", resume=True)


def test_what_is_not_there_yet_is_told(tmp_path):
    path = tmp_path / "s.zarr"
    tj.sweep(area, SIDES, chunk=128, store=path)
    (path / "finished" / "sums" / "c" / "2").unlink()
    seen = tj.sweeps.open_sweep(path)
    assert seen.attrs["chunks_missing"] == 1
    here = np.arange(len(SIDES["a"])) // 128 != 2
    np.testing.assert_array_equal(seen.succeeded, here)
    np.testing.assert_array_equal(np.isfinite(seen.area), here)
    names = seen.result.attrs["flag_meanings"].split()
    assert {names[code] for code in seen.result.values[~here]} == {"not_computed"}


@pytest.mark.parametrize("harm", [b"", bytes(1000)])
def test_a_damaged_file_is_not_read_as_an_answer(tmp_path, harm):
    path = tmp_path / "s.zarr"
    kept = tj.sweep(area, SIDES, chunk=128, store=path).load()
    (path / "area" / "c" / "1").write_bytes(harm)
    seen = tj.sweeps.open_sweep(path)
    assert seen.attrs["chunks_missing"] == 1
    assert not seen.succeeded[128:256].any() and seen.succeeded[256:].all()
    same(tj.sweep(area, SIDES, store=path, resume=True), kept)


@pytest.mark.parametrize("resume", [False, True])
def test_a_folder_that_is_no_store_is_told_so(tmp_path, resume):
    with pytest.raises(ValueError, match="is no store of a sweep"):
        tj.sweep(area, SIDES, store=tmp_path, resume=resume)
    with pytest.raises(ValueError, match="is no store of a sweep"):
        tj.sweeps.open_sweep(tmp_path)
    with pytest.raises(FileNotFoundError, match="There is no store"):
        tj.sweeps.open_sweep(tmp_path / "nowhere")


def test_units_are_part_of_a_store(tmp_path):
    path = tmp_path / "s.zarr"
    tj.sweep(area, SIDES, store=path)
    with pytest.raises(ValueError, match="differs in units"):
        tj.sweep(area, SIDES, store=path, resume=True, units={"a": "m"})


def test_lists_and_whole_numbers_are_taken():
    table = tj.sweep(area, {"a": [1.0, 2.0], "b": (3.0, 4.0)})
    np.testing.assert_array_equal(table.twice, [2.0, 4.0])
    table = tj.sweep(
        lambda d: {"square": d["n"] ** 2}, tj.Grid({"n": [1, 2]}), derivatives=["square"]
    )
    np.testing.assert_array_equal(table.square_by_n, [2.0, 4.0])


def test_a_study_that_raises_is_told_how_not_to():
    def study(design):
        spring = tj.Quadratic(jnp.diag(jnp.stack([1.0, design["k"], 1.0])))
        hinge = tj.Hinge("h", "a", "b", spring, at=(0.0, 0.0, 0.0))
        pair = tj.Mechanism([tj.Body("a"), tj.Body("b")], [hinge], fixed=["a"])
        return tj.equilibrium(pair, loads=[tj.Load("b", (0.0, 1.0, 0.0))]).energy

    with pytest.raises(RuntimeError, match="Call it with `throw=False`"):
        tj.sweep(study, {"k": np.array([1.0, -1.0])})


def test_tolerances_speak_of_the_parameters():
    """Their names and units, as in the table of a sweep; `answer` is what is asked."""
    spreads = {
        "leaf": {"t": tj.sweeps.Normal(np.ones(2), 0.1)},
        "w": tj.sweeps.Uniform(1.0, 2.0),
    }

    def study(design):
        return {"area": design["leaf"]["t"].sum() * design["w"]}

    units = {"leaf.t": "m", "w": "m", "area": "m2"}
    seen = tj.sweeps.tolerances(study, spreads, "area", units=units, count=64)
    assert seen.table["area_by_w"].attrs["units"] == "m2/m"
    assert seen.table["leaf.t"].shape == (64, 2)
    assert {share.name for share in seen.shares} == {"leaf.t[0]", "leaf.t[1]", "w"}
    with pytest.raises(ValueError, match="`answer` is 'volume', but what the study"):
        tj.sweeps.tolerances(study, spreads, "volume", count=64)
    with pytest.raises(ValueError, match="must be a whole number from 2"):
        tj.sweeps.tolerances(study, spreads, "area", count=1)


HEAD = """
import sys, time, jax
jax.config.update("jax_enable_x64", True)
"""
KILLED = (
    HEAD
    + """
import numpy as np
from test_sweeps import area
import twistorjax as tj
designs = {"a": np.linspace(0, 1, 4000), "b": np.linspace(1, 2, 4000)}
tj.sweep(area, designs, chunk=16, store=sys.argv[1], resume=True)
print("done", flush=True)
"""
)


def python(code, *arguments, **settings):
    """A process of its own, which finds the tests."""
    here = str(pathlib.Path(__file__).parent)
    environment = {**os.environ, "PYTHONPATH": here}
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        **settings,
    )


@pytest.mark.slow
def test_a_process_may_be_killed_at_any_moment(tmp_path):
    """250 chunks, and a process that is killed three times while it writes them."""
    path, chances = tmp_path / "s.zarr", random.Random(7)

    def written():
        return len(list(path.glob("finished/sums/c/*")))

    for _ in range(3):
        process = python(KILLED, path)
        goal = written() + chances.randint(5, 70)
        while written() < goal and process.poll() is None:
            time.sleep(0.001)
        assert process.poll() is None, process.stderr.read()
        process.kill()
        process.communicate()
        assert 0 < written() < 250
    for part in path.rglob("*.partial"):  # as if they had been killed long ago
        os.utime(part, (0, 0))
    output, errors = python(KILLED, path).communicate()
    assert "done" in output, errors
    sides = {"a": np.linspace(0, 1, 4000), "b": np.linspace(1, 2, 4000)}
    same(tj.sweeps.open_sweep(path), tj.sweep(area, sides, chunk=16))
    assert not list(path.rglob("*.partial"))


DEVICES = (
    HEAD
    + """
jax.config.update("jax_num_cpu_devices", 8)
import numpy as np
from test_sweeps import pulled
import twistorjax as tj
designs = {"k": np.linspace(50, 150, 1001), "force": np.linspace(-0.2, 0.3, 1001)}
mesh = jax.make_mesh((4, 2), ("rows", "columns"))
table = tj.sweep(pulled, designs, chunk=32, mesh=mesh, derivatives=("travel",))
table.to_netcdf(sys.argv[1])
tj.sweep(pulled, designs, chunk=32, derivatives=("travel",), store=sys.argv[2])
again = tj.sweep(pulled, designs, mesh=mesh, derivatives=("travel",), store=sys.argv[2],
                 resume=True)
print("done", flush=True)
"""
)


@pytest.mark.slow
def test_eight_devices_answer_as_one(tmp_path):
    process = python(DEVICES, tmp_path / "many.nc", tmp_path / "one.zarr")
    output, errors = process.communicate(timeout=300)
    assert "done" in output, errors
    many = xarray.load_dataset(tmp_path / "many.nc")
    one = tj.sweeps.open_sweep(tmp_path / "one.zarr").load()
    for name in ("travel", "travel_by_k", "travel_by_force"):
        np.testing.assert_allclose(many[name], one[name], rtol=1e-12, atol=0)
    np.testing.assert_array_equal(many.succeeded, one.succeeded)


PROCESSES = (
    HEAD
    + """
jax.config.update("jax_num_cpu_devices", 2)
address, number, path, out = sys.argv[1:]
jax.distributed.initialize(address, num_processes=2, process_id=int(number))
import numpy as np
from test_sweeps import pulled
import twistorjax as tj
designs = {"k": np.linspace(50, 150, 333), "force": np.linspace(-0.2, 0.3, 333)}
mesh = jax.make_mesh((jax.device_count(),), ("designs",))
assert jax.device_count() == 4
kept = tj.sweep(pulled, designs, chunk=32, mesh=mesh, store=path)
table = tj.sweep(pulled, designs, chunk=32, mesh=mesh)
np.testing.assert_array_equal(table.travel, kept.travel)
table.to_netcdf(out)
print("done", flush=True)
"""
)


@pytest.mark.slow
def test_two_processes_answer_as_one(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    store = tmp_path / "s.zarr"
    pair = [
        python(PROCESSES, address, number, store, tmp_path / f"{number}.nc")
        for number in range(2)
    ]
    for process in pair:
        output, errors = process.communicate(timeout=300)
        assert "done" in output, errors
    designs = {"k": np.linspace(50, 150, 333), "force": np.linspace(-0.2, 0.3, 333)}
    alone = tj.sweep(pulled, designs, chunk=32)
    for told in (
        tj.sweeps.open_sweep(store),
        *(xarray.load_dataset(tmp_path / f"{number}.nc") for number in range(2)),
    ):
        np.testing.assert_allclose(told.travel, alone.travel, rtol=1e-12, atol=0)
        assert bool(told.succeeded.all())


@pytest.mark.parametrize("method", ["sobol", "latin", "random"])
def test_designs_are_drawn_as_told(method):
    spreads = {
        "a": tj.sweeps.Normal(2.0, 0.1),
        "b": tj.sweeps.Uniform([0.0, 1.0], [1.0, 3.0]),
        "c": 7.0,
    }
    drawn = tj.sweeps.sample_designs(spreads, 4000, method=method, key=3)
    assert drawn["a"].shape == (4000,) and drawn["b"].shape == (4000, 2)
    np.testing.assert_array_equal(drawn["c"], 7.0)
    assert abs(drawn["a"].mean() - 2.0) < 0.006 and abs(drawn["a"].std() - 0.1) < 0.005
    for column, low, high in ((0, 0.0, 1.0), (1, 1.0, 3.0)):
        part = np.sort((drawn["b"][:, column] - low) / (high - low))
        assert np.abs(part - (np.arange(4000) + 0.5) / 4000).max() < 0.03
    again = tj.sweeps.sample_designs(spreads, 4000, method=method, key=3)
    np.testing.assert_array_equal(again["a"], drawn["a"])
    assert np.any(
        tj.sweeps.sample_designs(spreads, 4000, method=method, key=4)["a"] != drawn["a"]
    )


def test_correlations_are_kept():
    """Of normal numbers exactly; of ranks of others by Pearson's formula."""
    wanted = np.array([[1.0, 0.8, 0.0], [0.8, 1.0, 0.0], [0.0, 0.0, 1.0]])
    spreads = {
        "a": tj.sweeps.Normal([1.0, 2.0], [0.1, 0.5]),
        "b": tj.sweeps.Uniform(0.0, 1.0),
    }
    drawn = tj.sweeps.sample_designs(spreads, 8192, correlation=wanted)
    rows = np.column_stack([drawn["a"], drawn["b"]])
    np.testing.assert_allclose(np.corrcoef(rows.T), wanted, atol=0.01)
    both = tj.sweeps.sample_designs(
        {"b": tj.sweeps.Uniform(np.zeros(2), 1.0)}, 8192, correlation=wanted[:2, :2]
    )
    ranks = 6 / np.pi * np.arcsin(0.8 / 2)
    assert abs(np.corrcoef(both["b"].T)[0, 1] - ranks) < 0.01


def test_perfectly_correlated_parameters_move_as_one():
    drawn = tj.sweeps.sample_designs(
        {"a": tj.sweeps.Normal(np.zeros(2), 1.0)}, 64, correlation=np.ones((2, 2))
    )
    np.testing.assert_allclose(drawn["a"][:, 0], drawn["a"][:, 1], atol=1e-9)


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tj.sweeps.Normal(1.0, -0.1), "must not be negative"),
        (lambda: tj.sweeps.Normal([1.0, 2.0], [1.0, 2.0, 3.0]), "must be of one shape"),
        (lambda: tj.sweeps.Uniform(2.0, 1.0), "low is the lower"),
        (lambda: tj.sweeps.Uniform(0.0, np.inf), "must be finite"),
        (lambda: tj.sweeps.sample_designs({"a": 1.0}, 8), "Nothing spreads"),
        (
            lambda: tj.sweeps.sample_designs({"a": tj.sweeps.Normal(0, 1)}, 0),
            "`count` is 0",
        ),
        (
            lambda: tj.sweeps.sample_designs(
                {"a": tj.sweeps.Normal(0, 1)}, 8, method="halton"
            ),
            "'sobol'",
        ),
        (
            lambda: tj.sweeps.sample_designs(
                {"a": tj.sweeps.Normal([0, 0], 1)}, 8, correlation=np.eye(3)
            ),
            "must be a symmetric matrix with ones on its diagonal for a[0], a[1]",
        ),
        (
            lambda: tj.sweeps.sample_designs(
                {"a": tj.sweeps.Normal(np.zeros(3), 1)},
                8,
                correlation=1.9 * np.eye(3) - 0.9 * np.ones((3, 3)),
            ),
            "negative eigenvalue",
        ),
    ],
)
def test_spreads_that_make_no_sense_are_refused(call, message):
    with pytest.raises(ValueError) as error:
        call()
    assert message in str(error.value)


def test_tolerances_of_a_linear_answer_are_in_closed_form(validated):
    """c . x of correlated normal numbers: variance c^T S c, and no disagreement."""
    slopes = jnp.array([3.0, -2.0, 0.5])

    def study(design):
        return {"sum": slopes @ design["x"], "more": design["x"]}

    sizes, correlation = np.array([0.1, 0.2, 0.3]), np.eye(3)
    correlation[0, 1] = correlation[1, 0] = 0.5
    spreads = {"x": tj.sweeps.Normal([1.0, 2.0, 3.0], sizes)}
    seen = tj.sweeps.tolerances(study, spreads, "sum", correlation=correlation)
    covariance = np.outer(sizes, sizes) * correlation
    exact = np.sqrt(slopes @ covariance @ slopes)
    np.testing.assert_allclose(seen.deviation, exact, rtol=1e-12)
    np.testing.assert_allclose(seen.nominal, 0.5, rtol=1e-12)
    what = "deviation of a sum of three, first order"
    validated("Tolerances", what, seen.deviation, exact, "closed form")
    validated("Tolerances", "the same, 8,192 drawn", seen.spread, exact, "closed form")
    assert abs(seen.disagreement) < 0.005 and abs(seen.mean - 0.5) < 1e-3 * exact
    low, high = seen.interval
    np.testing.assert_allclose(
        [low, high], norm.ppf([0.025, 0.975], 0.5, exact), atol=0.01
    )
    shares = {share.name: share for share in seen.shares}
    moved = np.asarray(slopes) * sizes
    for name, part in zip(
        ("x[0]", "x[1]", "x[2]"), moved * (correlation @ moved), strict=True
    ):
        np.testing.assert_allclose(shares[name].first_order, part / exact**2, rtol=1e-9)
        np.testing.assert_allclose(shares[name].sampled, part / exact**2, atol=5e-3)
    assert "x[1]" in repr(seen)


def product(design):
    return design["modulus"] * design["web"]


def test_shares_do_not_depend_on_units():
    """A web in metres beside a modulus in pascals: variances of sums of small parts."""
    sizes = {"modulus": (70e9, 1e9), "web": (0.25e-3, 10e-6)}
    seen = tj.sweeps.tolerances(
        product, {name: tj.sweeps.Normal(*two) for name, two in sizes.items()}
    )
    parts = {name: (deviation / mean) ** 2 for name, (mean, deviation) in sizes.items()}
    for share in seen.shares:
        exact = parts[share.name] / sum(parts.values())
        np.testing.assert_allclose(share.first_order, exact, rtol=1e-9)
        np.testing.assert_allclose(share.sampled, exact, atol=5e-3)
    assert seen.nonlinear < 1e-3


@pytest.mark.parametrize("kinds", ["uu", "un", "nn"])
def test_uniform_numbers_are_correlated_less_than_those_they_are_made_of(kinds):
    """The difference of two, linear: both ways find the deviation by quadrature."""
    made, deviation = 0.9, 12**-0.5
    matrix = np.array([[1.0, made], [made, 1.0]])
    spread = {"u": tj.sweeps.Uniform(0.0, 1.0), "n": tj.sweeps.Normal(0.5, deviation)}
    sides = {name: spread[kind] for name, kind in zip("ab", kinds, strict=True)}
    seen = tj.sweeps.tolerances(lambda d: d["a"] - d["b"], sides, correlation=matrix)
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    z, w = np.meshgrid(nodes, nodes)
    both = np.outer(weights, weights) / (2 * np.pi)
    shape = {"u": lambda x: norm.cdf(x) - 0.5, "n": lambda x: deviation * x}
    apart = shape[kinds[0]](z) - shape[kinds[1]](made * z + np.sqrt(1 - made**2) * w)
    exact = np.sqrt(np.sum(both * apart**2))
    np.testing.assert_allclose(seen.deviation, exact, rtol=1e-4)
    np.testing.assert_allclose(seen.spread, exact, rtol=2e-3)
    assert seen.nonlinear < 1e-12


def test_what_is_not_linear_is_told():
    """a + 5 b^2 of standard normal numbers: a brings 1 of 51, and b nothing linear."""
    sides = {name: tj.sweeps.Normal(0.0, 1.0) for name in "ab"}
    seen = tj.sweeps.tolerances(lambda d: d["a"] + 5 * d["b"] ** 2, sides)
    shares = {share.name: share.sampled for share in seen.shares}
    np.testing.assert_allclose(shares["a"], 1 / 51, atol=5e-3)
    np.testing.assert_allclose(shares["b"], 0.0, atol=5e-3)
    np.testing.assert_allclose(seen.nonlinear, 50 / 51, atol=5e-3)
    assert "not linear" in repr(seen)


@pytest.mark.parametrize("method", ["sobol", "latin", "random"])
def test_standard_errors_are_those_that_are_met(method):
    """Against the scatter of the means over forty keys; of Sobol's, a hundredth."""
    side = {"x": tj.sweeps.Normal(1.0, 0.1)}
    found = [
        tj.sweeps.tolerances(cube, side, count=1024, method=method, key=key)
        for key in range(40)
    ]
    told = np.median([seen.mean_error for seen in found])
    met = np.std([seen.mean for seen in found], ddof=1)
    assert 0.6 < told / met < 1.6
    assert (met < 1e-3) == (method != "random")


def cube(design):
    return design["x"] ** 3


def test_no_number_is_infinitely_far_off():
    """Sobol's points have thirty bits, and one may be zero."""
    far = tj.sweeps.sample_designs(
        {"x": tj.sweeps.Normal(np.zeros(100), 1.0)}, 2**17, key=40
    )["x"]
    assert np.all(np.abs(far) < 8.3)


def test_single_precision_has_no_tolerances():
    with jax.enable_x64(False), pytest.raises(ValueError, match="double precision"):
        tj.sweeps.tolerances(cube, {"x": tj.sweeps.Normal(1.0, 0.1)})


def test_a_program_of_tolerances_is_compiled_once():
    """Of one study, wherever the means are."""
    calls = []

    def study(design):
        calls.append(design)
        return design["x"] * design["y"]

    for mean in (1.0, 2.0):
        tj.sweeps.tolerances(study, {"x": tj.sweeps.Normal(mean, 0.1), "y": 3.0})
        if mean == 1.0:
            first = len(calls)
    assert len(calls) == first


@pytest.mark.parametrize("size", [3, 40])
def test_complex_answers_are_differentiated_both_ways(size):
    """Forward for few numbers, in reverse for many."""
    x = np.linspace(0.1, 1.0, 2 * size).reshape(2, size)

    def study(design):
        return {"h": (jnp.sum(design["x"]).astype(complex) * (1 + 2j)) ** 2}

    table = tj.sweep(study, {"x": x}, derivatives=["h"])
    exact = 2 * (1 + 2j) ** 2 * x.sum(axis=1)
    np.testing.assert_allclose(table.h_by_x, np.tile(exact, (size, 1)).T, rtol=1e-12)


def test_an_answer_whose_derivative_is_not_finite_is_one():
    """A root at zero, whether it is differentiated or not."""
    for derivatives in ((), ("root",)):
        table = tj.sweep(
            lambda d: {"root": jnp.sqrt(d["x"])},
            {"x": np.array([0.0, 4.0])},
            derivatives=derivatives,
        )
        assert table.succeeded.all()
        np.testing.assert_array_equal(table.root, [0.0, 2.0])


def test_what_can_only_be_differentiated_in_reverse_is():
    """As motions, by default."""

    @jax.custom_vjp
    def square(x):
        return x**2

    square.defvjp(lambda x: (x**2, x), lambda x, slope: (2 * x * slope,))
    table = tj.sweep(
        lambda d: {"y": square(d["x"])}, {"x": np.arange(1.0, 4.0)}, derivatives=["y"]
    )
    np.testing.assert_allclose(table.y_by_x, [2.0, 4.0, 6.0])


def test_tolerances_show_what_first_order_misses():
    """The square of a normal number about zero: no slope, but a mean and a spread."""
    seen = tj.sweeps.tolerances(
        lambda design: design["x"] ** 2, {"x": tj.sweeps.Normal(0.0, 0.1)}
    )
    assert seen.deviation == 0.0
    np.testing.assert_allclose(seen.mean, 0.01, rtol=5e-3)
    np.testing.assert_allclose(seen.shift, 0.01, rtol=5e-3)
    np.testing.assert_allclose(seen.spread, np.sqrt(2) * 0.01, rtol=2e-2)


def test_designs_that_fail_take_no_part_in_tolerances():
    def study(design):
        return jnp.sqrt(design["x"])

    with pytest.warns(UserWarning, match="designs have no answer"):
        seen = tj.sweeps.tolerances(study, {"x": tj.sweeps.Normal(1.0, 0.5)}, count=1000)
    assert 10 < seen.failed < 50
    assert np.isfinite(seen.spread)
    assert "designs have no answer" in repr(seen)
    with pytest.raises(ValueError, match="at the means"):
        tj.sweeps.tolerances(study, {"x": tj.sweeps.Normal(-1.0, 0.1)}, count=8)


def test_a_vector_has_no_tolerance():
    with pytest.raises(ValueError, match="must be a number"):
        tj.sweeps.tolerances(
            lambda design: jnp.ones(2) * design["x"], {"x": tj.sweeps.Normal(0, 1.0)}
        )


def test_the_stage_is_swept_with_its_exact_derivative():
    webs = np.array([0.2e-3, 0.25e-3, 0.4e-3])
    table = tj.sweep(stage_gain, {"web": webs}, derivatives=("gain",))
    for web, gain, slope in zip(webs, table.gain, table.gain_by_web, strict=True):
        answer, exact = stage.amplify_by_web(web, stage.TRAVEL)
        np.testing.assert_allclose(gain, answer.gain, rtol=1e-11)
        np.testing.assert_allclose(slope, exact, rtol=1e-9)
    assert table.output.attrs["units"] == "m"


def test_webs_of_the_stage_may_differ():
    """Seven webs of one thickness are one; the slope by one is the sum of theirs."""
    alike = jax.jit(stage.microstage)(jnp.full(7, 0.25e-3))
    np.testing.assert_allclose(stage.amplify(alike).gain, 27.628043685, rtol=1e-10)
    with pytest.raises(ValueError, match="one for each of the hinges a, b"):
        stage.microstage(np.full(3, 0.25e-3))


@pytest.mark.slow
def test_tolerances_of_the_webs_spread_the_gain():
    """The slopes by each web sum to that by all; their squares are the variance."""
    webs = {"web": tj.sweeps.Normal(np.full(7, 0.25e-3), 10e-6)}
    seen = tj.sweeps.tolerances(stage_gain, webs, "gain", count=4096)
    slopes = [share.slope for share in seen.shares]
    np.testing.assert_allclose(sum(slopes), -50661.2107, rtol=1e-6)
    np.testing.assert_allclose(seen.deviation, 10e-6 * np.hypot.reduce(slopes), rtol=1e-9)
    assert abs(seen.disagreement) < 0.005


def test_json_of_settings_is_kept(tmp_path):
    settings = {"material": "6061", "temperature": 20.0}
    table = tj.sweep(area, SIDES, settings=settings, store=tmp_path / "s.zarr")
    assert json.loads(table.attrs["settings"]) == settings


def test_a_tree_of_parameters_is_called_by_its_paths():
    designs = {
        "leaf": {"length": np.ones(4), "sides": np.ones((4, 2))},
        "k": np.arange(4),
    }

    def study(design):
        return jnp.where(design["k"] > 1, design["leaf"]["length"], 0.0)

    table = tj.sweep(study, designs)
    np.testing.assert_array_equal(table.answer, [0.0, 0.0, 1.0, 1.0])
    assert table["leaf.sides"].dims == ("design", "leaf.sides_0")
    assert set(itertools.chain(table.coords)) == {"leaf.length", "leaf.sides", "k"}
