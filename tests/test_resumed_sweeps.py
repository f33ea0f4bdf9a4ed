"""A store holds the same bits as a dataset in memory, and only its sweep resumes it."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from sweep_helpers import area, assert_same_dataset, SIDES

import twistorjax as tj


xarray = pytest.importorskip("xarray")
pytest.importorskip("zarr")


def modification_times(path):
    """When each file with outputs was written."""
    return {
        file: file.stat().st_mtime_ns
        for file in sorted(path.rglob("*"))
        if file.is_file() and "/c/" in str(file)
    }


def test_a_store_has_the_bits_of_a_dataset_and_is_not_computed_again(tmp_path):
    path, units = tmp_path / "s.zarr", {"a": "m"}
    in_memory = tj.sweep(area, SIDES, chunk_size=128, units=units)
    stored = tj.sweep(area, SIDES, chunk_size=128, units=units, store=path)
    assert_same_dataset(stored, in_memory)
    before = modification_times(path)
    resumed = tj.sweep(area, SIDES, units=units, store=path, resume=True)
    assert_same_dataset(resumed, in_memory)
    assert modification_times(path) == before


def test_xarray_reads_a_store_without_this_library(tmp_path):
    path = tmp_path / "s.zarr"
    tj.sweep(area, SIDES, chunk_size=128, units={"a": "m"}, store=path)
    table = xarray.open_zarr(path, consolidated=False)
    np.testing.assert_array_equal(table.twice, 2 * SIDES["a"])
    assert "a" in table.coords and table.a.attrs["units"] == "m"


GRID = tj.Grid({"b": [1.0, 2.0, 3.0], "a": np.linspace(0.5, 0.25, 4)})


@pytest.mark.parametrize("chunk_size", [None, 2, 8, 5])
def test_a_grid_in_a_store_is_opened_as_a_grid(tmp_path, chunk_size):
    """Also by xarray alone, unless the chunks are not blocks of the grid."""
    path = tmp_path / "s.zarr"
    stored = tj.sweep(area, GRID, chunk_size=chunk_size, units={"a": "m"}, store=path)
    assert stored.area.dims == ("b", "a")
    opened = tj.sweeps.open_sweep(path)
    assert_same_dataset(opened, tj.sweep(area, GRID))
    if chunk_size != 5:
        table = xarray.open_zarr(path, consolidated=False)
        assert_same_dataset(table[list(stored)], stored)
        expected = np.sin(GRID.values["a"]) * GRID.values["b"][:, None]
        np.testing.assert_allclose(table.area.transpose("b", "a"), expected)
        assert table.a.attrs["units"] == "m"
    (path / "area" / "c").rename(tmp_path / "lost")
    missing = tj.sweeps.open_sweep(path)
    assert np.isnan(missing.area).all() and missing.attrs["chunks_missing"] > 0
    resumed = tj.sweep(
        area, GRID, chunk_size=chunk_size, units={"a": "m"}, store=path, resume=True
    )
    assert_same_dataset(resumed, stored)


def test_a_flat_store_of_a_grid_is_still_continued(tmp_path, monkeypatch):
    """Earlier versions stored the outputs of a grid along one axis."""
    path = tmp_path / "s.zarr"
    with monkeypatch.context() as patch:
        patch.setattr("twistorjax.sweeps.stores.creation.FORMAT", 3)
        patch.setattr("twistorjax.sweeps.stores.creation.grid_chunk", lambda *_: None)
        stored = tj.sweep(area, GRID, chunk_size=4, store=path)
    assert xarray.open_zarr(path, consolidated=False).area.dims == ("design",)
    assert_same_dataset(tj.sweeps.open_sweep(path), stored)
    (path / "area" / "zarr.json").unlink()
    (path / "area" / "c" / "1").unlink()
    resumed = tj.sweep(area, GRID, store=path, resume=True)
    assert_same_dataset(resumed, stored)
    assert xarray.open_zarr(path, consolidated=False).area.dims == ("design",)


def test_the_chunks_of_a_large_grid_are_blocks(tmp_path):
    """The default size of the chunks is reduced, here from 4096 to 4080 designs."""
    sides = {"a": np.linspace(0.0, 1.0, 120), "b": np.linspace(1.0, 2.0, 60)}
    path = tmp_path / "s.zarr"
    tj.sweep(area, tj.Grid(sides), store=path)
    table = xarray.open_zarr(path, consolidated=False)
    np.testing.assert_array_equal(table.twice[:, 0], 2 * sides["a"])


@pytest.mark.parametrize("damage", ["truncated", "deleted", "exchanged"])
def test_only_a_damaged_chunk_is_computed_again(tmp_path, damage):
    path = tmp_path / "s.zarr"
    stored = tj.sweep(area, SIDES, chunk_size=128, store=path).load()
    chunk = path / "area" / "c" / "3"
    content = chunk.read_bytes()
    if damage == "truncated":
        chunk.write_bytes(content[: len(content) // 2])
    elif damage == "deleted":
        chunk.unlink()
    else:
        chunk.write_bytes((path / "area" / "c" / "4").read_bytes())
    before = modification_times(path)
    assert_same_dataset(tj.sweep(area, SIDES, store=path, resume=True), stored)
    after = modification_times(path)
    changed = {file.name for file in after if after[file] != before.get(file)}
    assert changed == {"3"}
    assert chunk.read_bytes() == content


def other_area(design):
    return {"area": jnp.cos(design["a"]) * design["b"], "twice": 2.0 * design["a"]}


@pytest.mark.parametrize(
    ("study", "designs", "options", "message"),
    [
        (
            other_area,
            SIDES,
            {},
            "differs in study (area in the store, other_area now), the program",
        ),
        (area, {**SIDES, "b": SIDES["b"] + 1}, {}, "differs in the designs"),
        (area, SIDES, dict(chunk_size=64), "chunk_size (128 in the store, 64 now)"),
        (
            area,
            SIDES,
            dict(settings={"by": "me"}),
            'settings ({} in the store, {"by": "me"} now)',
        ),
    ],
)
def test_a_store_of_another_sweep_is_rejected(tmp_path, study, designs, options, message):
    path = tmp_path / "s.zarr"
    tj.sweep(area, SIDES, chunk_size=128, store=path)
    before = modification_times(path)
    with pytest.raises(ValueError) as error:
        tj.sweep(study, designs, store=path, resume=True, **options)
    assert message in str(error.value)
    assert modification_times(path) == before


def test_a_store_is_rejected_if_a_constant_of_the_study_has_changed(tmp_path):
    def scaled(factor):
        return lambda design: design["a"] * factor

    path = tmp_path / "s.zarr"
    tj.sweep(scaled(jnp.arange(2000.0)), SIDES, chunk_size=128, store=path)
    changed = jnp.arange(2000.0).at[1234].set(0.0)
    with pytest.raises(ValueError, match="differs in the program"):
        tj.sweep(scaled(changed), SIDES, store=path, resume=True)


def test_a_store_is_rejected_if_a_value_that_the_study_uses_has_changed(tmp_path):
    factors = np.ones(2)

    def study(design):
        return design["a"] * factors[0]

    tj.sweep(study, SIDES, store=tmp_path / "s.zarr")
    tj.sweep(study, SIDES, store=tmp_path / "s.zarr", resume=True)
    factors[0] = 2.0
    with pytest.raises(ValueError, match="differs in the program"):
        tj.sweep(study, SIDES, store=tmp_path / "s.zarr", resume=True)


def test_a_store_is_rejected_if_units_have_changed(tmp_path):
    path = tmp_path / "s.zarr"
    tj.sweep(area, SIDES, store=path)
    with pytest.raises(ValueError, match="differs in units"):
        tj.sweep(area, SIDES, store=path, resume=True, units={"a": "m"})


def test_a_store_of_another_format_is_rejected(tmp_path, monkeypatch):
    path = tmp_path / "s.zarr"
    with monkeypatch.context() as patch:
        patch.setattr("twistorjax.sweeps.stores.creation.FORMAT", 2)
        patch.setattr("twistorjax.sweeps.stores.store.FORMAT", 2)
        tj.sweep(area, SIDES, store=path)
    before = modification_times(path)
    for use in (
        lambda: tj.sweeps.open_sweep(path),
        lambda: tj.sweep(area, SIDES, store=path, resume=True),
    ):
        with pytest.raises(ValueError) as error:
            use()
        assert f"The store '{path}' has format 2, but this version" in str(error.value)
        assert "Use another path, or the version that created" in str(error.value)
    assert modification_times(path) == before


def test_an_existing_store_is_not_overwritten(tmp_path):
    tj.sweep(area, SIDES, store=tmp_path / "s.zarr")
    with pytest.raises(ValueError, match="which already exists"):
        tj.sweep(area, SIDES, store=tmp_path / "s.zarr")
    (tmp_path / "other").mkdir()
    with pytest.raises((ValueError, OSError)):
        tj.sweep(area, SIDES, store=tmp_path / "other", resume=True)


def test_chunks_that_are_not_computed_are_marked(tmp_path):
    path = tmp_path / "s.zarr"
    tj.sweep(area, SIDES, chunk_size=128, store=path)
    (path / "finished" / "sums" / "c" / "2").unlink()
    table = tj.sweeps.open_sweep(path)
    assert table.attrs["chunks_missing"] == 1
    computed = np.arange(len(SIDES["a"])) // 128 != 2
    np.testing.assert_array_equal(table.succeeded, computed)
    np.testing.assert_array_equal(np.isfinite(table.area), computed)
    names = table.result.attrs["flag_meanings"].split()
    assert {names[code] for code in table.result.values[~computed]} == {"not_computed"}


@pytest.mark.parametrize("content", [b"", bytes(1000)])
def test_a_damaged_file_is_not_read_as_an_output(tmp_path, content):
    path = tmp_path / "s.zarr"
    stored = tj.sweep(area, SIDES, chunk_size=128, store=path).load()
    (path / "area" / "c" / "1").write_bytes(content)
    table = tj.sweeps.open_sweep(path)
    assert table.attrs["chunks_missing"] == 1
    assert not table.succeeded[128:256].any() and table.succeeded[256:].all()
    assert_same_dataset(tj.sweep(area, SIDES, store=path, resume=True), stored)


@pytest.mark.parametrize("resume", [False, True])
def test_a_folder_that_is_not_a_store_is_rejected(tmp_path, resume):
    with pytest.raises(ValueError, match="is not a store of a sweep"):
        tj.sweep(area, SIDES, store=tmp_path, resume=resume)
    with pytest.raises(ValueError, match="is not a store of a sweep"):
        tj.sweeps.open_sweep(tmp_path)
    with pytest.raises(FileNotFoundError, match="There is no store"):
        tj.sweeps.open_sweep(tmp_path / "nowhere")


def test_settings_are_attributes_in_json(tmp_path):
    settings = {"material": "6061", "temperature": 20.0}
    table = tj.sweep(area, SIDES, settings=settings, store=tmp_path / "s.zarr")
    assert json.loads(table.attrs["settings"]) == settings


def contents(path):
    """The bytes of each file of a store."""
    files = (file for file in path.rglob("*") if file.is_file())
    return {file.relative_to(path): file.read_bytes() for file in files}


@pytest.mark.parametrize("designs", [SIDES, GRID], ids=["designs", "grid"])
def test_parts_in_any_order_give_the_files_of_one_sweep(tmp_path, designs):
    size = 128 if designs is SIDES else 2
    whole, shared = tmp_path / "whole.zarr", tmp_path / "shared.zarr"
    tj.sweep(area, designs, chunk_size=size, store=whole)
    for k in (2, 3, 1):
        tj.sweep(area, designs, chunk_size=size, store=shared, part=(k, 3))
        written = {int(file.name) for file in shared.glob("finished/sums/c/*")}
        assert all((chunk + 1) % 3 == k % 3 or k != 2 for chunk in written)
    assert contents(shared) == contents(whole)


def test_a_repeated_part_computes_only_what_is_missing(tmp_path):
    path = tmp_path / "s.zarr"
    for _ in range(2):
        for k in (1, 2):
            tj.sweep(area, SIDES, chunk_size=128, store=path, part=(k, 2))
    before = modification_times(path)
    (path / "area" / "c" / "3").write_bytes(b"damaged")
    tj.sweep(area, SIDES, chunk_size=128, store=path, part=(1, 2))  # chunks 0, 2, 4, 6
    assert (path / "area" / "c" / "3").read_bytes() == b"damaged"
    tj.sweep(area, SIDES, chunk_size=128, store=path, part=(2, 2))
    after = modification_times(path)
    changed = {str(file) for file in before if after[file] != before[file]}
    assert changed and all(file.endswith("/c/3") for file in changed)


def test_default_chunks_give_work_to_all_parts(tmp_path):
    designs = {"a": np.linspace(0.0, 1.0, 64), "b": np.ones(64)}
    tj.sweep(area, designs, store=tmp_path / "s.zarr", part=(8, 8))
    assert len(list(tmp_path.glob("s.zarr/finished/sums/c/*"))) == 1


def test_a_part_reports_its_own_failures(tmp_path):
    def root(design):
        return {"root": jnp.sqrt(design["a"])}

    designs = {"a": np.array([1.0, -1.0, 4.0, -4.0, -9.0, 16.0])}
    for part, text in (((1, 2), "1 of 3 designs"), ((2, 2), "2 of 3 designs")):
        with pytest.warns(UserWarning, match=text):
            tj.sweep(root, designs, chunk_size=1, store=tmp_path / "s.zarr", part=part)


@pytest.mark.untyped
@pytest.mark.parametrize("part", [(0, 4), (5, 4), (1.5, 4), 3, (1, 2, 3)])
def test_an_impossible_part_is_rejected(tmp_path, part):
    with pytest.raises(ValueError, match="the k-th of n parts, with k from 1 to n"):
        tj.sweep(area, SIDES, store=tmp_path / "s.zarr", part=part)
    with pytest.raises(ValueError, match="no `store` for all parts"):
        tj.sweep(area, SIDES, part=part)
