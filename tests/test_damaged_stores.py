"""A damaged store gives correct numbers, missing chunks, or one clear error."""

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

# Ten designs in chunks of four, so that the last chunk is smaller.
DESIGNS = {
    "a": np.linspace(0.0, 1.0, 10),
    "pair": np.column_stack([np.arange(10.0), np.zeros(10)]),
    "zero": np.zeros(10),
}
CHUNK_SIZE = 4
UNITS = {"a": "m", "sine": "N"}


def study(design):
    """Outputs of all kinds: with labels, with values along an axis, complex."""
    labels = (("side", ("left", "right")),)
    return {
        "sine": jnp.sin(design["a"]) + design["zero"],
        "sides": tj.solve.Column(design["pair"] * 3.0, ("side",), "m", labels),
        "time": tj.solve.Column(jnp.array([0.0, 0.5, 2.0]), ("time",), "s"),
        "motion": tj.solve.Column(design["a"] * jnp.array([1.0, 2.0, 3.0]), ("time",)),
        "wave": jax.lax.complex(design["a"], design["pair"][1]),
    }


GRID = tj.Grid({"a": np.linspace(0.0, 1.0, 5), "b": [0.0, 2.0]})


def grid_study(design):
    return {"sum": design["a"] + design["b"]}


def run_sweep(path=None, *, grid=False, resume=False):
    if grid:
        return tj.sweep(
            grid_study, GRID, chunk_size=CHUNK_SIZE, store=path, resume=resume
        )
    return tj.sweep(
        study, DESIGNS, units=UNITS, chunk_size=CHUNK_SIZE, store=path, resume=resume
    )


class Template:
    """A complete store, which is copied for each damage."""

    def __init__(self, folder, grid):
        self.path, self.grid = folder / "template.zarr", grid
        run_sweep(self.path, grid=grid)
        self.table = tj.sweeps.open_sweep(self.path).load()
        # The store contains the same values as a sweep without a store.
        xarray.testing.assert_identical(
            self.table.drop_attrs(), run_sweep(grid=grid).drop_attrs()
        )
        files = (file for file in self.path.rglob("*") if file.is_file())
        self.files = sorted(file.relative_to(self.path).as_posix() for file in files)

    def check(self, path):
        """Compare what is opened and resumed from a damaged copy with the template."""

        def open_copy():
            self.check_masked(tj.sweeps.open_sweep(path).load())

        def resume_copy():
            self.check_complete(run_sweep(path, grid=self.grid, resume=True))

        allow_clear_error(path, open_copy)
        allow_clear_error(path, resume_copy)

    def check_complete(self, table):
        """All chunks have the same bits as in the template."""
        xarray.testing.assert_identical(table.load(), self.table)

    def check_masked(self, table):
        """Each chunk is as in the template, or missing as a whole."""
        axes = table.succeeded.ndim
        missing = ~np.asarray(table.succeeded).ravel()
        chunks = {design // CHUNK_SIZE for design in np.flatnonzero(missing)}
        expected = self.table.copy(deep=True).assign_attrs(chunks_missing=len(chunks))
        for name, values in expected.items():
            flat = values.values.reshape(missing.size, *values.shape[axes:])
            kind = flat.dtype.kind
            flat[missing] = np.nan if kind in "fc" else -1 if name == "result" else 0
            expected[name] = values.copy(data=flat.reshape(values.shape))
        if missing.all() and not self.grid:  # The times are unknown, too.
            table = table.drop_vars("time_coordinate").assign_coords(time=expected.time)
        xarray.testing.assert_identical(table, expected)


def allow_clear_error(path, use):
    """Use a store, which may raise only one clear error that names the store."""
    try:
        use()
    except (OSError, ValueError) as error:
        assert str(path) in str(error)
        assert len(str(error).splitlines()) <= 2
        assert error.__cause__ is None


@pytest.fixture(scope="module", params=["designs", "grid"])
def template(request, tmp_path_factory):
    return Template(tmp_path_factory.mktemp("template"), request.param == "grid")


def flip(content, position, number):
    """Change one bit."""
    position %= max(1, len(content))
    flipped = bytes([content[position] ^ (1 << number % 8)]) if content else b""
    return content[:position] + flipped + content[position + 1 :]


def overwrite(content, position, number):
    """Replace up to forty bytes by random ones."""
    position %= max(1, len(content))
    random = np.random.default_rng(number).bytes(1 + number % 40)
    changed = content[:position] + random + content[position + len(random) :]
    return changed[: len(content)]


DAMAGES = {
    "flip": flip,
    "overwrite": overwrite,
    "truncate": lambda content, position, _: content[: position % max(1, len(content))],
    "empty": lambda *_: b"",
    "zeros": lambda content, *_: bytes(len(content)),
    "lengthen": lambda content, count, number: content + bytes([number % 256]) * count,
}


def damage(path, files, kind, file, position, number):
    """Damage one file of a store, or delete its folder."""
    target = path / files[file % len(files)]
    if not target.exists():  # an earlier damage has deleted it
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
        target.write_bytes(DAMAGES[kind](target.read_bytes(), position, number))


damages = st.lists(
    st.tuples(
        st.sampled_from(["delete", "delete folder", "exchange", *DAMAGES]),
        st.integers(0, 2**16),
        st.integers(0, 2**11),
        st.integers(0, 2**16),
    ),
    min_size=1,
    max_size=3,
)


def check_random_damage(template, count):
    set_hypothesis_home_dir(template.path.parent)  # instead of the working directory

    # Examples are not shrunk, because each has at most three damages.
    @settings(
        max_examples=count, derandomize=True, database=None, deadline=None,
        phases=[Phase.generate],
    )  # fmt: skip
    @given(damages)
    def check_example(example):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "s.zarr"
            shutil.copytree(template.path, path)
            for each in example:
                damage(path, template.files, *each)
            template.check(path)

    check_example()


@pytest.mark.slow
def test_random_damage_never_gives_wrong_numbers(template):
    check_random_damage(template, 50)


@pytest.mark.release
def test_much_random_damage_never_gives_wrong_numbers(template):
    check_random_damage(template, 1500)


def static_files(template):
    """The files that a sweep never changes, without the manifest."""
    outputs = {*template.table.data_vars, "time_coordinate"}
    return [
        file
        for file in template.files
        if file.endswith("zarr.json")
        or not {*pathlib.PurePath(file).parts} & {*outputs, "finished"}
    ]


@pytest.mark.slow
def test_damaged_coordinates_labels_and_metadata_are_reported_and_repaired(
    template, tmp_path
):
    """One bit of each such file is changed, or the file is deleted."""
    files = static_files(template)
    assert len(files) > 8
    path = tmp_path / "s.zarr"
    shutil.copytree(template.path, path)
    for number, file in enumerate(files):
        content = (path / file).read_bytes()
        if number % 2:
            (path / file).unlink()
        else:
            (path / file).write_bytes(flip(content, 2 * len(content) // 3, number))
        for verify in (True, False):
            with pytest.raises(OSError) as error:
                tj.sweeps.open_sweep(path, verify=verify)
            assert f"'{path}' is damaged: its file '{file}'" in str(error.value)
        template.check_complete(run_sweep(path, grid=template.grid, resume=True))
        assert (path / file).read_bytes() == content
    template.check_complete(tj.sweeps.open_sweep(path))


def test_a_damaged_store_of_another_sweep_is_not_repaired(template, tmp_path):
    path = tmp_path / "s.zarr"
    shutil.copytree(template.path, path)
    (path / "a" / "zarr.json").unlink()
    with pytest.raises(ValueError, match="which another sweep created"):
        tj.sweep(grid_study, {"a": np.ones(3), "b": np.ones(3)}, store=path, resume=True)
    assert not (path / "a" / "zarr.json").exists()


def test_a_damaged_manifest_is_one_clear_error(template, tmp_path):
    path = tmp_path / "s.zarr"
    shutil.copytree(template.path, path)
    manifest = path / "finished" / "sums" / "manifest.json"
    content = manifest.read_bytes()
    changed = content.replace(b'"chunk_size": 4', b'"chunk_size": 5')
    assert changed != content
    manifest.write_bytes(changed)
    for use in (tj.sweeps.open_sweep, lambda path: run_sweep(path, resume=True)):
        with pytest.raises(OSError, match="Delete the store and sweep again"):
            use(path)


def test_damage_without_verification_is_one_clear_error(template, tmp_path):
    """For outputs that are read when the store is opened; others are read later."""
    path = tmp_path / "s.zarr"
    shutil.copytree(template.path, path)
    name = "sum" if template.grid else "time_coordinate"
    file = next(file for file in template.files if file.startswith(f"{name}/c/"))
    (path / file).write_bytes(b"")
    with pytest.raises(OSError, match="Open it with `verify=True`"):
        tj.sweeps.open_sweep(path, verify=False)
    assert tj.sweeps.open_sweep(path).attrs["chunks_missing"] == 1


@pytest.mark.parametrize("content", [b"", b"\x01", bytes(17), bytes(1000)])
def test_only_the_chunk_of_a_damaged_checksum_is_missing(template, tmp_path, content):
    path = tmp_path / "s.zarr"
    shutil.copytree(template.path, path)
    (path / "finished" / "sums" / "c" / "1").write_bytes(content)
    for verify in (True, False):
        table = tj.sweeps.open_sweep(path, verify=verify)
        assert table.attrs["chunks_missing"] == 1
        computed = np.asarray(table.succeeded).ravel()
        np.testing.assert_array_equal(np.flatnonzero(~computed), [4, 5, 6, 7])
    before = {file: (path / file).stat().st_mtime_ns for file in template.files}
    template.check_complete(run_sweep(path, grid=template.grid, resume=True))
    for file, time in before.items():
        changed = (path / file).stat().st_mtime_ns != time
        assert not changed or "/c/1" in file


def test_a_store_of_the_older_zarr_format_is_refused(tmp_path):
    """Its arrays may contain pickled objects, which are programs."""
    import zarr

    from twistorjax.sweeps.stores.creation import FORMAT
    from twistorjax.sweeps.stores.files import write_manifest

    path = tmp_path / "s.zarr"
    group = zarr.open_group(path, mode="w", zarr_format=2)
    group.create_array("sum", shape=(1,), chunks=(1,), dtype="f8")
    sums = group.create_group("finished").create_array(
        "sums", shape=(1,), chunks=(1,), dtype="uint64"
    )
    sums[0] = 1
    keys = {"identity": {"chunk_size": 1}, "grid": [], "coordinates": {}}
    write_manifest(path, {"format": FORMAT, "outputs": ["sum"], **keys})
    with pytest.raises(OSError, match="cannot be read"):
        tj.sweeps.open_sweep(path)
