"""Stores: what a sweep has found so far, in files that survive its end at any moment."""

import contextlib
import hashlib
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool

from .._utils.validation import require_package
from .store_creation import FORMAT, nothing
from .store_files import clear_errors, damage, damaged_files, MANIFEST, read_manifest


# a file is written within seconds, so an older part of one is of a killed process; s
_ABANDONED_AFTER = 3600.0


class Store:
    """A folder of compressed arrays, in zarr's format, written chunk by chunk.

    A chunk counts as finished once the checksum of its numbers has been written, after
    all of these; each file is replaced as a whole. So a process may be killed at any
    moment, and several processes may write the same chunks.

    Args:
        path: Folder of the store. Only its manifest is read, until `open` is called.

    Raises:
        ImportError: zarr is not installed.
        FileNotFoundError: The folder does not exist.
        ValueError: The folder is not a store of a sweep.
        OSError: The manifest cannot be read, or is damaged.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        require_package("zarr", "Stores", "data")
        if not self.path.exists():
            raise FileNotFoundError(f"There is no store {str(path)!r}.")
        manifest = read_manifest(self.path)
        if manifest is None or manifest.get("format") != FORMAT:
            lacks = (
                f"it has no file {MANIFEST.as_posix()!r}"
                if manifest is None
                else "another version of this library wrote it"
            )
            raise ValueError(
                f"{str(path)!r} is no store of a sweep: {lacks}. Give another path."
            )
        self.made_by: dict[str, Any] = manifest["made_by"]
        self.grid = tuple(manifest["grid"])
        self.names = tuple(manifest["answers"])
        self.places: dict[str, str] = manifest["places"]
        self._digests: dict[str, str] = manifest["files"]
        self._arrays: dict[str, Any] = {}
        self._sums: Any = None

    def damaged_files(self) -> list[str]:
        """List the damaged files of coordinates, labels and metadata.

        Raises:
            OSError: A file cannot be read.
        """
        return damaged_files(self.path, self._digests)

    def open(self, mode: Literal["r", "r+"] = "r+") -> "Store":
        """Verify coordinates, labels and metadata, and open the arrays of the answers.

        Args:
            mode: "r" to read only, "r+" to write as well.

        Returns:
            This store.

        Raises:
            OSError: A file is damaged or cannot be read.
        """
        if damaged := self.damaged_files():
            remedy = (
                "Repeat the sweep with `resume=True`, which writes it again, or delete "
                "the store."
            )
            raise damage(self.path, f"its file {damaged[0]!r}", remedy)
        with clear_errors(self.path, "read"):
            zarr = require_package("zarr", "Stores", "data")
            group = zarr.open_group(self.path, mode=mode)
            self._sums = group["finished/sums"]
            self._arrays = {name: group[name] for name in self.names}
        return self

    def check(self, made_by: Mapping[str, Any]) -> None:
        """Refuse to be continued by another sweep.

        Args:
            made_by: What identifies the sweep that is to continue this one.

        Raises:
            ValueError: Another sweep made the store; the message says what differs.
        """
        words = [
            f"{name} ({was} then, {made_by.get(name)} now)"
            if not _is_digest(was)
            else f"the {name}"
            for name, was in self.made_by.items()
            if made_by.get(name) != was
        ]
        if words:
            raise ValueError(
                f"`store` is {str(self.path)!r}, which another sweep made: it differs in "
                f"{', '.join(words)}. Give another path, or sweep what it was made for."
            )

    def clear(self) -> None:
        """Remove parts of files of processes that were killed while they wrote them.

        A recent part may belong to a process that is writing it now, and stays.
        """
        for path in self.path.rglob("*.partial"):
            with contextlib.suppress(OSError):
                if path.is_file() and (
                    time.time() - path.stat().st_mtime > _ABANDONED_AFTER
                ):
                    path.unlink()

    def known(self, name: str, chunks: Bool[np.ndarray, " chunks"]) -> np.ndarray:
        """Read an answer of all designs.

        Args:
            name: Name of the answer.
            chunks: Whether each chunk is read; the others are filled with the value of
                what has not been computed.
        """
        array, parts = self._arrays[name], []
        for chunk, known in enumerate(chunks):
            rows = self._rows(chunk)
            shape = (rows.stop - rows.start, *array.shape[1:])
            empty = np.full(shape, nothing(name, array.dtype), array.dtype)
            with clear_errors(self.path, "read"):
                parts.append(np.asarray(array[rows]) if known else empty)
        return np.concatenate(parts)

    def written(self) -> np.ndarray:
        """Whether each chunk has been written, damaged or not."""
        return self._read_sums() != 0

    def finished(self) -> np.ndarray:
        """Whether each chunk has been written and holds what was computed."""
        sums = self._read_sums()
        return np.array(
            [kept != 0 and kept == self._seen(k) for k, kept in enumerate(sums)]
        )

    def write(self, chunk: int, values: Mapping[str, np.ndarray]) -> None:
        """Write a chunk, and then its checksum.

        Args:
            chunk: Number of the chunk.
            values: The answers of its designs, by name.

        Raises:
            OSError: The store cannot be written.
        """
        rows = self._rows(chunk)
        count = rows.stop - rows.start
        kept = {name: np.ascontiguousarray(part[:count]) for name, part in values.items()}
        remedy = "Finished chunks are kept; repeat the sweep with `resume=True`."
        with clear_errors(self.path, "written", remedy):
            for name, array in self._arrays.items():
                array[rows] = kept[name]
            self._sums[chunk] = _checksum(chunk, kept)

    def _rows(self, chunk: int) -> slice:
        count = next(iter(self._arrays.values())).shape[0]
        size = self.made_by["chunk"]
        return slice(chunk * size, min((chunk + 1) * size, count))

    def _read_sums(self) -> np.ndarray:
        """Checksums of the chunks; zero for a chunk whose checksum cannot be read."""
        # a damaged file raises an error whose type depends on the kind of damage
        with contextlib.suppress(Exception):
            return np.asarray(self._sums[:])
        sums = np.zeros(self._sums.shape, self._sums.dtype)
        for chunk in range(len(sums)):
            with contextlib.suppress(Exception):
                sums[chunk] = self._sums[chunk]
        return sums

    def _seen(self, chunk: int) -> int:
        """Checksum of what the files of a chunk hold; zero if one cannot be read."""
        rows = self._rows(chunk)
        try:
            kept = {name: np.asarray(a[rows]) for name, a in self._arrays.items()}
        except Exception:  # its type depends on the kind of damage
            return 0
        return _checksum(chunk, kept)


def _checksum(chunk: int, values: Mapping[str, np.ndarray]) -> int:
    digest = hashlib.blake2b(f"{chunk};".encode(), digest_size=8)
    for name in sorted(values):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(values[name]).tobytes())
    return int.from_bytes(digest.digest()) | 1  # zero means not written


def _is_digest(value: Any) -> bool:
    return isinstance(value, str) and len(value) == 64
