"""The recipes of the page on clusters, run by workers of this machine."""

import os
import pathlib
import re
import subprocess
import sys
import time

import numpy as np
import pytest

import twistorjax as tj


pytest.importorskip("zarr")
MANUAL = pathlib.Path(__file__).parents[1] / "notebooks" / "manual"
pytestmark = pytest.mark.slow


@pytest.fixture
def start(tmp_path):
    """Write the files of the page, and start one of them as a process."""
    guide = re.findall(
        r"^```python\n(.*?)^```", (MANUAL / "start.md").read_text(), re.DOTALL | re.M
    )
    (tmp_path / "guide.py").write_text(guide[0])
    page = (MANUAL / "clusters.md").read_text()
    for name, code in re.findall(
        r'^```\w+ title="(.*?)"\n(.*?)^```', page, re.DOTALL | re.M
    ):
        (tmp_path / name).write_text(code)

    def start_file(*command, **variables):
        return subprocess.Popen(
            command,
            cwd=tmp_path,
            env={**os.environ, **variables},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    return start_file


def finish(process):
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    return output


def check_store(folder):
    """The store is complete, and the table moves as two guided leaves let it."""
    table = tj.sweeps.open_sweep(folder / "guide.zarr")
    assert table.attrs["chunks_missing"] == 0 and bool(table.succeeded.all())
    stiffness = 24 * 210e9 * 10e-3 * table.thickness**3 / 12 / 50e-3**3
    np.testing.assert_allclose(table.travel, 5.0 / stiffness, rtol=0.03)


def written(folder):
    return len(list(folder.glob("guide.zarr/finished/sums/c/*")))


def test_a_job_array_computes_a_sweep(start, tmp_path):
    for k in ("2", "1", "4", "3"):
        finish(start("bash", "array.sh", SLURM_ARRAY_TASK_ID=k))
    check_store(tmp_path)


def test_submitit_computes_a_sweep(start, tmp_path):
    pytest.importorskip("submitit")
    finish(start(sys.executable, "submit.py"))
    check_store(tmp_path)


def test_dask_repeats_the_part_of_a_killed_worker(start, tmp_path):
    psutil = pytest.importorskip("psutil")
    pytest.importorskip("distributed")
    driver = start(sys.executable, "workers.py")
    while not written(tmp_path) and driver.poll() is None:
        time.sleep(0.01)
    workers = [
        child
        for child in psutil.Process(driver.pid).children(recursive=True)
        if "spawn_main" in " ".join(child.cmdline())
    ]
    assert len(workers) >= 2
    workers[0].kill()
    finish(driver)
    check_store(tmp_path)


def test_parts_of_an_optimization_find_the_thickness(start, tmp_path):
    finish(start(sys.executable, "search.py", "2", "2"))
    printed = finish(start(sys.executable, "search.py", "1", "2"))
    thickness = (5.0 / 2e-3 * 50e-3**3 * 12 / (24 * 210e9 * 10e-3)) ** (1 / 3)
    assert "8 of 8 searches" in printed
    shown = float(re.findall(r"thickness\s+(\S+)", printed)[0])
    np.testing.assert_allclose(shown, thickness, rtol=0.01)
