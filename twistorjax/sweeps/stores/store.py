"""Stores: results of a sweep on disk, which remain if the process is killed."""

import contextlib
import hashlib
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool

from ..._utils.validation import require_package
from .creation import fill_value, FORMAT
from .files import (
    clear_errors,
    damage_error,
    damaged_files,
    is_abandoned,
    MANIFEST,
    read_manifest,
)


_FLAT_FORMAT = 3  # in which also the outputs of a grid have the axis `design`


class Store:
    """A folder of compressed arrays in zarr format, which is written chunk by chunk.

    The checksum of a chunk is written after all of its values, and each file is replaced
    as a whole. Therefore a process may be killed at any moment, and several processes may
    write the same chunks. Only the manifest is read until `open` is called.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        require_package("zarr", "Stores", "data")
        if not self.path.exists():
            raise FileNotFoundError(f"There is no store {str(path)!r}.")
        manifest = read_manifest(self.path)
        if manifest is None:
            raise ValueError(
                f"{str(path)!r} is not a store of a sweep, because it has no file "
                f"{MANIFEST.as_posix()!r}. Use another path."
            )
        if (version := manifest.get("format")) not in (_FLAT_FORMAT, FORMAT):
            raise ValueError(
                f"The store {str(path)!r} has format {version}, but this version of "
                f"twistorjax uses format {FORMAT}. Use another path, or the version that "
                "created the store."
            )
        self.identity: dict[str, Any] = manifest["identity"]
        self.grid = tuple(manifest["grid"])
        # Shape of a chunk of a grid; None if the outputs have the axis `design`
        self.block: list[int] | None = manifest.get("block")
        self.output_names = tuple(manifest["outputs"])
        self.coordinates: dict[str, str] = manifest["coordinates"]
        self._digests: dict[str, str] = manifest["files"]
        self._arrays: dict[str, Any] = {}
        self._checksums: Any = None

    def damaged_files(self) -> list[str]:
        """List the paths of damaged files of coordinates, labels and metadata."""
        return damaged_files(self.path, self._digests)

    def open(self, mode: Literal["r", "r+"] = "r+") -> "Store":
        """Verify coordinates, labels and metadata, and open the arrays of the outputs.

        The mode is "r" for reading, and "r+" for reading and writing. The store itself is
        returned.
        """
        if damaged := self.damaged_files():
            remedy = (
                "Repeat the sweep with `resume=True`, which writes it again, or delete "
                "the store."
            )
            raise damage_error(self.path, f"its file {damaged[0]!r}", remedy)
        with clear_errors(self.path, "read"):
            zarr = require_package("zarr", "Stores", "data")
            # Arrays of the older format may contain pickled objects, that is, programs.
            group = zarr.open_group(self.path, mode=mode, zarr_format=3)
            self._checksums = group["finished/sums"]
            self._arrays = {name: group[name] for name in self.output_names}
        return self

    def check_identity(self, identity: Mapping[str, Any]) -> None:
        """Check that this store belongs to the sweep that is resumed."""
        differences = [
            f"the {name}"
            if _is_digest(stored)
            else f"{name} ({stored} in the store, {identity.get(name)} now)"
            for name, stored in self.identity.items()
            if identity.get(name) != stored
        ]
        if differences:
            raise ValueError(
                f"`store` is {str(self.path)!r}, which another sweep created. It differs "
                f"in {', '.join(differences)}. Use another path, or repeat the same "
                "sweep."
            )

    def remove_partial_files(self) -> None:
        """Remove incomplete files of processes that were killed while they wrote them.

        A recent file stays, because a process may still be writing it.
        """
        for path in self.path.rglob("*.partial"):
            if is_abandoned(path):
                with contextlib.suppress(OSError):
                    path.unlink()

    def read(self, name: str, chunks: Bool[np.ndarray, " chunks"]) -> np.ndarray:
        """Read an output of all designs, with the axes of the array in the store.

        Chunks that are not read have the value of an output that has not been computed.
        """
        array = self._arrays[name]
        values = np.full(array.shape, fill_value(name, array.dtype), array.dtype)
        for chunk in np.flatnonzero(chunks).tolist():
            with clear_errors(self.path, "read"):
                values[self._part(chunk)] = array[self._part(chunk)]
        return values

    def written_chunks(self) -> Bool[np.ndarray, " chunks"]:
        """Determine whether each chunk has been written, without a verification."""
        return self._read_checksums() != 0

    def intact_chunks(
        self, among: Bool[np.ndarray, " chunks"] | None = None
    ) -> Bool[np.ndarray, " chunks"]:
        """Determine whether each chunk has been written and is unchanged since then.

        Chunks that are not `among` the given ones are not read.
        """
        checksums = self._read_checksums()
        intact = checksums != 0
        if among is not None:
            intact &= among
        for chunk in np.flatnonzero(intact).tolist():
            intact[chunk] = checksums[chunk] == self._compute_checksum(chunk)
        return intact

    def write(self, chunk: int, values: Mapping[str, np.ndarray]) -> None:
        """Write a chunk of outputs, and then its checksum."""
        part = self._part(chunk)
        shape = tuple(axis.stop - axis.start for axis in part)
        count = math.prod(shape)
        values = {name: np.ascontiguousarray(v[:count]) for name, v in values.items()}
        remedy = "Finished chunks remain; repeat the sweep with `resume=True`."
        # Success is written last, for those who read the store in the meantime.
        names = sorted(self._arrays, key=lambda name: name == "succeeded")
        with clear_errors(self.path, "written", remedy):
            for name in names:
                array = self._arrays[name]
                array[part] = values[name].reshape(*shape, *values[name].shape[1:])
            self._checksums[chunk] = _checksum(chunk, values)

    def _part(self, chunk: int) -> tuple[slice, ...]:
        """Return the range of the designs of a chunk along each of their axes."""
        size = self.identity["chunk_size"]
        block = [size] if self.block is None else self.block
        shape = next(iter(self._arrays.values())).shape[: len(block)]
        first = np.unravel_index(chunk * size, shape)
        return tuple(
            slice(int(start), min(int(start) + count, length))
            for start, count, length in zip(first, block, shape, strict=True)
        )

    def _read_checksums(self) -> np.ndarray:
        """Read the checksums of all chunks; zero for a checksum that cannot be read."""
        # A damaged file raises an error whose type depends on the kind of damage.
        with contextlib.suppress(Exception):
            return np.asarray(self._checksums[:])
        checksums = np.zeros(self._checksums.shape, self._checksums.dtype)
        for chunk in range(len(checksums)):
            with contextlib.suppress(Exception):
                checksums[chunk] = self._checksums[chunk]
        return checksums

    def _compute_checksum(self, chunk: int) -> int:
        """Compute the checksum of the files of a chunk; zero if one cannot be read."""
        part = self._part(chunk)
        try:
            values = {name: np.asarray(a[part]) for name, a in self._arrays.items()}
        except Exception:  # The type of the error depends on the kind of damage.
            return 0
        return _checksum(chunk, values)


def _checksum(chunk: int, values: Mapping[str, np.ndarray]) -> int:
    """Compute the checksum of a chunk, which is never zero: zero means not written."""
    digest = hashlib.blake2b(f"{chunk};".encode(), digest_size=8)
    for name in sorted(values):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(values[name]).tobytes())
    return int.from_bytes(digest.digest()) | 1


def _is_digest(value: Any) -> bool:
    return isinstance(value, str) and len(value) == 64
