"""Damaged stores: right numbers, chunks that are reported missing, or one clear error."""

import pathlib
import shutil
import tempfile

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, Phase, settings, strategies as st
from hypothesis.configuration import set_hypothesis_home_dir

import twistorjax as tj


xarray = pytest.importorskip("xarray")
pytest.importorskip("zarr")

# ten designs in chunks of four, so that the last one is not full
DESIGNS = {
    "a": np.linspace(0.0, 1.0, 10),
    "pair": np.column_stack([np.arange(10.0), np.zeros(10)]),
    "zero": np.zeros(10),
}
CHUNK = 4
UNITS = {"a": "m", "sine": "N"}


def study(design):
    """Numbers of all kinds: with labels, with values along an axis, complex ones."""
    labels = (("side", ("left", "right")),)
    return {
        "sine": jnp.sin(design["a"]) + design["zero"],
        "sides": tj.solve.Column(design["pair"] * 3.0, ("side",), "m", labels),
        "time": tj.solve.Column(jnp.array([0.0, 0.5, 2.0]), ("time",), "s"),
        "course": tj.solve.Column(design["a"] * jnp.array([1.0, 2.0, 3.0]), ("time",)),
        "wave": jax.lax.complex(design["a"], design["pair"][1]),
    }


GRID = tj.Grid({"a": np.linspace(0.0, 1.0, 5), "b": [0.0, 2.0]})


def of_grid(design):
    return {"sum": design["a"] + design["b"]}


def swept(path=None, *, grid=False, resume=False):
    what = (of_grid, GRID) if grid else (study, DESIGNS)
    units = {} if grid else UNITS
    return tj.sweep(*what, chunk=CHUNK, units=units, store=path, resume=resume)


class Template:
    """A finished store, which is copied for each damage."""

    def __init__(self, folder, grid):
        self.path, self.grid = folder / "template.zarr", grid
        swept(self.path, grid=grid)
        self.table = tj.sweeps.open_sweep(self.path).load()
        # what was computed, and not only what was written
        xarray.testing.assert_identical(
            self.table.drop_attrs(), swept(grid=grid).drop_attrs()
        )
        files = (file for file in self.path.rglob("*") if file.is_file())
        self.files = sorted(file.relative_to(self.path).as_posix() for file in files)

    def check(self, path):
        """Compare what a damaged copy gives with what it should."""
        check(path, lambda: self.check_masked(tj.sweeps.open_sweep(path).load()))
        check(path, lambda: self.check_whole(swept(path, grid=self.grid, resume=True)))

    def check_whole(self, table):
        xarray.testing.assert_identical(table.load(), self.table)

    def check_masked(self, table):
        """Each chunk as it was, or missing as a whole."""
        lost = table.attrs.pop("chunks_missing", 0)
        axes = table.succeeded.ndim
        lacks = ~np.asarray(table.succeeded).ravel()
        assert len({row // CHUNK for row in np.flatnonzero(lacks)}) == lost
        expected = self.table.copy(deep=True)
        for name, values in expected.items():
            flat = values.values.reshape(lacks.size, *values.shape[axes:])
            kind = flat.dtype.kind
            flat[lacks] = np.nan if kind in "fc" else -1 if name == "result" else 0
            expected[name] = values.copy(data=flat.reshape(values.shape))
        if lacks.all() and not self.grid:  # then the times are not known either
            table = table.drop_vars("time_places").assign_coords(time=expected.time)
        xarray.testing.assert_identical(table, expected)


def check(path, use):
    """Use a store, which may raise nothing but one clear error that names it."""
    try:
        use()
    except (OSError, ValueError) as error:
        assert str(path) in str(error)
        assert len(str(error).splitlines()) <= 2
        assert error.__cause__ is None


@pytest.fixture(scope="module", params=["designs", "grid"])
def template(request, tmp_path_factory):
    return Template(tmp_path_factory.mktemp("template"), request.param == "grid")


def flip(content, place, number):
    place %= max(1, len(content))
    flipped = bytes([content[place] ^ (1 << number % 8)]) if content else b""
    return content[:place] + flipped + content[place + 1 :]


def overwrite(content, place, number):
    place %= max(1, len(content))
    more = np.random.default_rng(number).bytes(1 + number % 40)
    return (content[:place] + more + content[place + len(more) :])[: len(content)]


HARMS = {
    "flip": flip,
    "overwrite": overwrite,
    "truncate": lambda content, place, _: content[: place % max(1, len(content))],
    "empty": lambda *_: b"",
    "zeros": lambda content, *_: bytes(len(content)),
    "lengthen": lambda content, place, number: content + bytes([number % 256]) * place,
}


def harm(path, files, kind, file, place, number):
    target = path / files[file % len(files)]
    if not target.exists():  # damaged before
        return
    if kind == "delete":
        target.unlink()
    elif kind == "delete folder":
        shutil.rmtree(target.parent)
    elif kind == "exchange":
        other = path / files[number % len(files)]
        if other.exists():
            target.write_bytes(other.read_bytes())
    else:
        target.write_bytes(HARMS[kind](target.read_bytes(), place, number))


harms = st.lists(
    st.tuples(
        st.sampled_from(["delete", "delete folder", "exchange", *HARMS]),
        st.integers(0, 2**16),
        st.integers(0, 2**11),
        st.integers(0, 2**16),
    ),
    min_size=1,
    max_size=3,
)


def damaged_at_random(template, count):
    set_hypothesis_home_dir(template.path.parent)  # rather than the working directory

    # not shrunk: an example has three damages at most
    @settings(
        max_examples=count, derandomize=True, database=None, deadline=None,
        phases=[Phase.generate],
    )  # fmt: skip
    @given(harms)
    def check_one(several):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "s.zarr"
            shutil.copytree(template.path, path)
            for one in several:
                harm(path, template.files, *one)
            template.check(path)

    check_one()


def test_random_damage_never_gives_wrong_numbers(template):
    damaged_at_random(template, 50)


@pytest.mark.release
def test_much_random_damage_never_gives_wrong_numbers(template):
    damaged_at_random(template, 1500)


def fixed(template):
    """The files that a sweep never changes, but for the manifest."""
    answers = {*template.table.data_vars, "time_places"}
    return [
        file
        for file in template.files
        if file.endswith("zarr.json")
        or not {*pathlib.PurePath(file).parts} & {*answers, "finished"}
    ]


def test_damaged_coordinates_labels_and_metadata_are_reported_and_repaired(
    template, tmp_path
):
    """One bit of each such file, or each such file deleted."""
    assert len(fixed(template)) > 8
    path = tmp_path / "s.zarr"
    shutil.copytree(template.path, path)
    for number, file in enumerate(fixed(template)):
        content = (path / file).read_bytes()
        if number % 2:
            (path / file).unlink()
        else:
            (path / file).write_bytes(flip(content, 2 * len(content) // 3, number))
        for verify in (True, False):
            with pytest.raises(OSError) as error:
                tj.sweeps.open_sweep(path, verify=verify)
            assert f"'{path}' is damaged: its file '{file}'" in str(error.value)
        template.check_whole(swept(path, grid=template.grid, resume=True))
        assert (path / file).read_bytes() == content
    template.check_whole(tj.sweeps.open_sweep(path))


def test_a_damaged_store_of_another_sweep_is_not_repaired(template, tmp_path):
    path = tmp_path / "s.zarr"
    shutil.copytree(template.path, path)
    (path / "a" / "zarr.json").unlink()
    with pytest.raises(ValueError, match="which another sweep made"):
        tj.sweep(of_grid, {"a": np.ones(3), "b": np.ones(3)}, store=path, resume=True)
    assert not (path / "a" / "zarr.json").exists()


def test_a_damaged_manifest_is_one_clear_error(template, tmp_path):
    path = tmp_path / "s.zarr"
    shutil.copytree(template.path, path)
    manifest = path / "finished" / "sums" / "manifest.json"
    manifest.write_bytes(manifest.read_bytes().replace(b'"chunk": 4', b'"chunk": 5'))
    for use in (tj.sweeps.open_sweep, lambda path: swept(path, resume=True)):
        with pytest.raises(OSError, match="Delete the store and sweep again"):
            use(path)


def test_damage_that_is_met_without_verification_is_one_clear_error(template, tmp_path):
    """What is read as the store is opened; other numbers are read as they are used."""
    path = tmp_path / "s.zarr"
    shutil.copytree(template.path, path)
    name = "sum" if template.grid else "time_places"
    file = next(file for file in template.files if file.startswith(f"{name}/c/"))
    (path / file).write_bytes(b"")
    with pytest.raises(OSError, match="Open it with `verify=True`"):
        tj.sweeps.open_sweep(path, verify=False)
    assert tj.sweeps.open_sweep(path).attrs["chunks_missing"] == 1


@pytest.mark.parametrize("harm", [b"", b"\x01", bytes(17), bytes(1000)])
def test_a_damaged_checksum_costs_one_chunk(template, tmp_path, harm):
    path = tmp_path / "s.zarr"
    shutil.copytree(template.path, path)
    (path / "finished" / "sums" / "c" / "1").write_bytes(harm)
    for verify in (True, False):
        table = tj.sweeps.open_sweep(path, verify=verify)
        assert table.attrs["chunks_missing"] == 1
        known = np.asarray(table.succeeded).ravel()
        np.testing.assert_array_equal(np.flatnonzero(~known), [4, 5, 6, 7])
    before = {file: (path / file).stat().st_mtime_ns for file in template.files}
    template.check_whole(swept(path, grid=template.grid, resume=True))
    for file, time in before.items():
        changed = (path / file).stat().st_mtime_ns != time
        assert not changed or "/c/1" in file
