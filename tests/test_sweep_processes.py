"""Sweeps on several devices, by several processes, and by processes that are killed."""

import os
import random
import socket
import time

import numpy as np
import pytest
from sweep_helpers import (
    area,
    assert_same_dataset,
    PREAMBLE,
    pulled_block,
    start_process,
)

import twistorjax as tj


xarray = pytest.importorskip("xarray")
pytest.importorskip("zarr")


KILLED = (
    PREAMBLE
    + """
import numpy as np
from sweep_helpers import area
import twistorjax as tj
designs = {"a": np.linspace(0, 1, 4000), "b": np.linspace(1, 2, 4000)}
tj.sweep(area, designs, chunk_size=16, store=sys.argv[1], resume=True)
print("done", flush=True)
"""
)


@pytest.mark.release
def test_a_process_may_be_killed_at_any_moment(tmp_path):
    """A process is killed three times while it writes the 250 chunks of a store."""
    path, generator = tmp_path / "s.zarr", random.Random(7)

    def written():
        return len(list(path.glob("finished/sums/c/*")))

    for _ in range(3):
        process = start_process(KILLED, path)
        assert process.stderr is not None
        goal = written() + generator.randint(5, 70)
        while written() < goal and process.poll() is None:
            time.sleep(0.001)
        assert process.poll() is None, process.stderr.read()
        process.kill()
        process.communicate()
        assert 0 < written() < 250
    for part in path.rglob("*.partial"):  # so that their writers seem to be gone
        os.utime(part, (0, 0))
    output, errors = start_process(KILLED, path).communicate()
    assert "done" in output, errors
    sides = {"a": np.linspace(0, 1, 4000), "b": np.linspace(1, 2, 4000)}
    assert_same_dataset(tj.sweeps.open_sweep(path), tj.sweep(area, sides, chunk_size=16))
    assert not list(path.rglob("*.partial"))


DEVICES = (
    PREAMBLE
    + """
jax.config.update("jax_num_cpu_devices", 8)
import numpy as np
from sweep_helpers import pulled_block
import twistorjax as tj
designs = {"k": np.linspace(50, 150, 1001), "force": np.linspace(-0.2, 0.3, 1001)}
mesh = jax.make_mesh((4, 2), ("rows", "columns"))
table = tj.sweep(pulled_block, designs, chunk_size=32, mesh=mesh, derivatives=("travel",))
table.to_netcdf(sys.argv[1])
tj.sweep(pulled_block, designs, chunk_size=32, derivatives=("travel",),
         store=sys.argv[2])
resumed = tj.sweep(pulled_block, designs, mesh=mesh, derivatives=("travel",),
                   store=sys.argv[2], resume=True)
print("done", flush=True)
"""
)


@pytest.mark.release
def test_eight_devices_compute_the_same_as_one(tmp_path):
    process = start_process(DEVICES, tmp_path / "many.nc", tmp_path / "one.zarr")
    output, errors = process.communicate(timeout=300)
    assert "done" in output, errors
    many = xarray.load_dataset(tmp_path / "many.nc")
    one = tj.sweeps.open_sweep(tmp_path / "one.zarr").load()
    for name in ("travel", "travel_by_k", "travel_by_force"):
        np.testing.assert_allclose(many[name], one[name], rtol=1e-12, atol=0)
    np.testing.assert_array_equal(many.succeeded, one.succeeded)


PROCESSES = (
    PREAMBLE
    + """
jax.config.update("jax_num_cpu_devices", 2)
address, number, path, out = sys.argv[1:]
jax.distributed.initialize(address, num_processes=2, process_id=int(number))
import numpy as np
from sweep_helpers import pulled_block
import twistorjax as tj
designs = {"k": np.linspace(50, 150, 333), "force": np.linspace(-0.2, 0.3, 333)}
mesh = jax.make_mesh((jax.device_count(),), ("designs",))
assert jax.device_count() == 4
stored = tj.sweep(pulled_block, designs, chunk_size=32, mesh=mesh, store=path)
table = tj.sweep(pulled_block, designs, chunk_size=32, mesh=mesh)
np.testing.assert_array_equal(table.travel, stored.travel)
table.to_netcdf(out)
print("done", flush=True)
"""
)


@pytest.mark.release
def test_two_processes_compute_the_same_as_one(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    store = tmp_path / "s.zarr"
    pair = [
        start_process(PROCESSES, address, number, store, tmp_path / f"{number}.nc")
        for number in range(2)
    ]
    for process in pair:
        output, errors = process.communicate(timeout=300)
        assert "done" in output, errors
    designs = {"k": np.linspace(50, 150, 333), "force": np.linspace(-0.2, 0.3, 333)}
    single = tj.sweep(pulled_block, designs, chunk_size=32)
    tables = [tj.sweeps.open_sweep(store)]
    tables += [xarray.load_dataset(tmp_path / f"{number}.nc") for number in range(2)]
    for table in tables:
        np.testing.assert_allclose(table.travel, single.travel, rtol=1e-12, atol=0)
        assert bool(table.succeeded.all())
