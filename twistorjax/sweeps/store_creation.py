"""Creation of a store: as a whole or not at all, also by several processes at once."""

import contextlib
import errno
import hashlib
import os
import platform
import re
import shutil
import time
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._utils.validation import require_package
from .dataset import Layout, OUTCOMES, UNKNOWN
from .store_files import clear_errors, MANIFEST, write_manifest


FORMAT = 2  # version of the layout of the files
# a folder of an unfinished creation is removed after this time in any case; s
_ABANDONED_AFTER = 24 * 3600.0


def need_writable(path: Path) -> None:
    """Refuse a place for a new store that cannot be written, before any work is done.

    Args:
        path: Folder of the store, which does not exist.

    Raises:
        OSError: The folder in which it is to be created is read-only, or no folder.
    """
    place = next(parent for parent in path.absolute().parents if parent.exists())
    if not place.is_dir():
        number, reason = errno.ENOTDIR, "is not a folder"
    elif not os.access(place, os.W_OK | os.X_OK):
        number, reason = errno.EACCES, "is read-only"
    else:
        return
    raise OSError(
        number,
        f"The store {str(path)!r} cannot be written: {str(place)!r} {reason}. Give "
        "another path.",
    )


def create_store(
    path: Path, made_by: Mapping[str, Any], layout: Layout, chunk: int
) -> bool:
    """Create a store without answers.

    The store is built in a hidden folder beside `path`, which is then renamed. So `path`
    never holds a part of a store, and of several processes that create the same store
    at the same time exactly one succeeds, without locks.

    Args:
        path: Folder of the store.
        made_by: What identifies the sweep.
        layout: Names, axes and units of all that the store will hold.
        chunk: Number of designs of a chunk.

    Returns:
        True, or False if another process has created `path` in the meantime.

    Raises:
        OSError: The store cannot be written.
    """
    with clear_errors(path, "written"):
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_abandoned(path)
        with _built(path, made_by, layout, chunk) as built:
            try:
                os.rename(built, path)
            except OSError:
                if not path.exists():
                    raise
                return False
    return True


def rewrite_fixed_files(
    path: Path, made_by: Mapping[str, Any], layout: Layout, chunk: int
) -> None:
    """Write the coordinates, the labels and all metadata of a damaged store again.

    Chunks of answers stay as they are. The manifest is replaced last, so that the store
    counts as damaged until all files are whole.

    Args:
        path: Folder of the store, which the same sweep made.
        made_by: What identifies the sweep.
        layout: Names, axes and units of all that the store holds.
        chunk: Number of designs of a chunk.

    Raises:
        OSError: The store cannot be written.
    """
    with (
        clear_errors(path, "written"),
        _built(path, made_by, layout, chunk) as built,
    ):
        files = (file.relative_to(built) for file in built.rglob("*") if file.is_file())
        for file in sorted(files, key=lambda file: file == MANIFEST):
            (path / file).parent.mkdir(parents=True, exist_ok=True)
            os.replace(built / file, path / file)


def nothing(name: str, kind: np.dtype) -> Any:
    """Value of an answer that has not been computed.

    Args:
        name: Name of the answer.
        kind: Type of its numbers.
    """
    return np.nan if kind.kind in "fc" else UNKNOWN if name == "result" else 0


@contextlib.contextmanager
def _built(
    path: Path, made_by: Mapping[str, Any], layout: Layout, chunk: int
) -> Iterator[Path]:
    """A new store in a hidden folder, which is removed unless it has been renamed."""
    built = path.with_name(
        f".{path.name}.{_machine()}-{os.getpid()}-{uuid.uuid4().hex[:8]}"
    )
    try:
        _build(built, made_by, layout, chunk)
        yield built
    finally:
        shutil.rmtree(built, ignore_errors=True)


def _build(folder: Path, made_by: Mapping[str, Any], layout: Layout, chunk: int) -> None:
    """Write all files of a store without answers."""
    group = require_package("zarr", "Stores", "data").open_group(folder, mode="w")
    labels = {}
    for name, column in (layout.fixed | layout.by_design).items():
        labels.update(column.labels)
        units = {"units": column.unit} if column.unit else {}
        attributes = units | OUTCOMES.get(name, {})
        known = {"dimension_names": column.axes, "attributes": attributes}
        if name in layout.fixed:
            _write_fixed(group, name, np.asarray(column.values), **known)
            continue
        shape, kind = column.values.shape, np.dtype(column.values.dtype)
        group.create_array(
            name,
            shape=shape,
            chunks=(min(chunk, shape[0]), *(max(1, size) for size in shape[1:])),
            dtype=kind,
            fill_value=nothing(name, kind),
            **known,
        )
    for axis, names in labels.items():
        words = np.array(names, dtype=np.dtypes.StringDType())
        _write_fixed(group, axis, words, dimension_names=(axis,))
    count = len(layout.designs)
    group.create_group("finished").create_array(
        "sums", shape=(-(-count // chunk),), chunks=(1,), dtype="uint64", fill_value=0
    )
    group.attrs.update({**made_by, **layout.attributes})
    contents = {
        "format": FORMAT,
        "made_by": dict(made_by),
        "grid": list(layout.grid),
        "answers": list(layout.by_design),
        "places": dict(layout.places),
    }
    write_manifest(folder, contents)


def _write_fixed(group: Any, name: str, values: np.ndarray, **settings: Any) -> None:
    """Write an array of which all chunks are files, so that a missing one is noticed."""
    config = {"write_empty_chunks": True}
    group.create_array(name, data=values, config=config, **settings)


def _remove_abandoned(path: Path) -> None:
    """Remove hidden folders of processes that were killed while they created this store.

    A folder of a process that runs must stay. Its name has the number of its process,
    which tells this on the same machine, even where a process is killed without notice.
    Elsewhere the age decides: creation takes seconds.
    """
    pattern = rf"\.{re.escape(path.name)}\.([0-9a-f]{{8}})-(\d+)-[0-9a-f]{{8}}"
    for folder in path.parent.iterdir():
        if not (match := re.fullmatch(pattern, folder.name)):
            continue
        with contextlib.suppress(OSError):  # another process removed or renamed it
            old = time.time() - folder.stat().st_mtime > _ABANDONED_AFTER
            if old or (match[1] == _machine() and not _runs(int(match[2]))):
                shutil.rmtree(folder, ignore_errors=True)


def _machine() -> str:
    """What distinguishes machines that share a folder, and containers on one machine."""
    processes = ""
    with contextlib.suppress(OSError):
        processes = os.readlink("/proc/self/ns/pid")
    text = f"{platform.node()} {processes}"
    return hashlib.blake2b(text.encode(), digest_size=4).hexdigest()


def _runs(process: int) -> bool:
    """Whether a process of this machine runs; True if that cannot be known."""
    if os.name != "posix":
        return True  # on Windows this call would end the process
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # a process of another user
        return True
    return True
