"""Atomic creation of stores, safe with several processes."""

import contextlib
import errno
import os
import re
import shutil
import uuid
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..._utils.validation import require_package
from ...designs.designs import grid_chunk
from ..dataset import Layout, NOT_COMPUTED, RESULT_FLAGS
from .files import clear_errors, is_abandoned, MANIFEST, write_manifest


FORMAT = 4  # version of the layout of the files


def require_writable(path: Path) -> None:
    """Check, before any work is done, that a new store can be created."""
    parent = next(parent for parent in path.absolute().parents if parent.exists())
    if not parent.is_dir():
        number, reason = errno.ENOTDIR, "is not a folder"
    elif not os.access(parent, os.W_OK | os.X_OK):
        number, reason = errno.EACCES, "is read-only"
    else:
        return
    raise OSError(
        number,
        f"The store {str(path)!r} cannot be written: {str(parent)!r} {reason}. Use "
        "another path.",
    )


def create_store(path: Path, identity: Mapping[str, Any], layout: Layout) -> bool:
    """Create a store without outputs; return False if another process has created it.

    The store is created in a hidden folder beside `path`, which is then renamed.
    Therefore `path` never holds an incomplete store. If several processes create the same
    store at the same time, exactly one of them succeeds, and no locks are needed.
    """
    with clear_errors(path, "written"):
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_abandoned(path)
        block = None
        if layout.grid:
            block = grid_chunk(layout.designs.shape, identity["chunk_size"])
        with _temporary_store(path, identity, layout, block) as temporary:
            try:
                os.rename(temporary, path)
            except OSError:
                if not path.exists():
                    raise
                return False
    return True


def rewrite_static_files(
    path: Path, identity: Mapping[str, Any], layout: Layout, block: Sequence[int] | None
) -> None:
    """Write the coordinates, the labels and all metadata of a damaged store again.

    The arguments are those of `create_store` for the sweep that created the store, and
    the shape of its chunks; see `Store`. Chunks of outputs stay unchanged. The manifest
    is replaced last, so that the store counts as damaged until all files are intact.
    """
    temporary = _temporary_store(path, identity, layout, block)
    with clear_errors(path, "written"), temporary as new:
        files = [file.relative_to(new) for file in new.rglob("*") if file.is_file()]
        for file in sorted(files, key=lambda file: file == MANIFEST):
            (path / file).parent.mkdir(parents=True, exist_ok=True)
            os.replace(new / file, path / file)


def fill_value(name: str, dtype: np.dtype) -> Any:
    """Choose the value of an output that has not been computed, by its name and dtype.

    It is NaN for real and complex numbers, -1 for `result`, and otherwise zero.
    """
    return np.nan if dtype.kind in "fc" else NOT_COMPUTED if name == "result" else 0


@contextlib.contextmanager
def _temporary_store(
    path: Path, identity: Mapping[str, Any], layout: Layout, block: Sequence[int] | None
) -> Iterator[Path]:
    """Create a store in a hidden folder, which is removed unless it is renamed."""
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}")
    try:
        _write_store(temporary, identity, layout, block)
        yield temporary
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _write_store(
    folder: Path, identity: Mapping[str, Any], layout: Layout, block: Sequence[int] | None
) -> None:
    """Write all files of a store without outputs.

    The outputs of a grid have its axes if the chunks are blocks of this shape; otherwise
    they have the axis `design`.
    """
    chunk_size = identity["chunk_size"]
    group = require_package("zarr", "Stores", "data").open_group(folder, mode="w")
    labels = {}
    for name, column in (layout.parameters | layout.outputs).items():
        labels.update(column.labels)
        units = {"units": column.unit} if column.unit else {}
        attributes = units | RESULT_FLAGS.get(name, {})
        axes = column.axes
        if block is not None and name in layout.outputs:
            axes = (*layout.grid, *axes[1:])
        metadata = {"dimension_names": axes, "attributes": attributes}
        if name in layout.parameters:
            _write_static_array(group, name, np.asarray(column.values), **metadata)
            continue
        shape, dtype = column.values.shape, np.dtype(column.values.dtype)
        designs, chunk = shape[:1], (min(chunk_size, shape[0]),)
        if block is not None:
            designs, chunk = layout.designs.shape, block
        group.create_array(
            name,
            shape=(*designs, *shape[1:]),
            chunks=(*chunk, *(max(1, size) for size in shape[1:])),
            dtype=dtype,
            fill_value=fill_value(name, dtype),
            **metadata,
        )
    for axis, names in labels.items():
        array = np.array(names, dtype=np.dtypes.StringDType())
        _write_static_array(group, axis, array, dimension_names=(axis,))
    chunk_count = -(-len(layout.designs) // chunk_size)
    group.create_group("finished").create_array(
        "sums", shape=(chunk_count,), chunks=(1,), dtype="uint64", fill_value=0
    )
    group.attrs.update({**identity, **layout.attributes})
    contents = {
        "format": FORMAT,
        "identity": dict(identity),
        "grid": list(layout.grid),
        "block": None if block is None else list(block),
        "outputs": list(layout.outputs),
        "coordinates": dict(layout.coordinates),
    }
    write_manifest(folder, contents)


def _write_static_array(
    group: Any, name: str, values: np.ndarray, **metadata: Any
) -> None:
    """Write an array with a file for each chunk, so that a missing file is detected."""
    config = {"write_empty_chunks": True}
    group.create_array(name, data=values, config=config, **metadata)


def _remove_abandoned(path: Path) -> None:
    """Remove hidden folders of processes that were killed while they created a store.

    A recent folder stays, because a process may still be creating the store.
    """
    pattern = rf"\.{re.escape(path.name)}\.[0-9a-f]{{8}}"
    for folder in path.parent.iterdir():
        if re.fullmatch(pattern, folder.name) and is_abandoned(folder):
            shutil.rmtree(folder, ignore_errors=True)
