"""What a sweep has found so far, in files that survive its end at any moment."""

import contextlib
import glob
import hashlib
import os
import shutil
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool

from .._checks import package
from .layout import Layout, OUTCOMES, UNKNOWN


# of a chunk: of what its files hold
_SUMS = "finished"
_FORMAT = 1


class Store:
    """A folder of compressed arrays, in zarr's format, written chunk by chunk.

    A chunk counts as finished once the sum of its arrays is written, after all of these;
    each file is replaced as a whole. So a process may be killed anywhere.

    Args:
        path: of the folder.
        mode: whether it is only read, or written to as well.
    """

    def __init__(self, path: str | Path, mode: Literal["r", "r+"] = "r+"):
        self.path, zarr = Path(path), _zarr()
        if not self.path.exists():
            raise FileNotFoundError(f"There is no store {str(path)!r}.")
        told: Any = None
        group: Any = None
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            group = zarr.open_group(self.path, mode=mode)
            told = group.attrs.get("sweep")
        if told is None or told["format"] != _FORMAT:
            raise ValueError(
                f"{str(path)!r} is no store of a sweep, or of another version of them. "
                "Give another path."
            )
        self.made_by: dict[str, Any] = told["made_by"]
        self.grid = tuple(told["grid"])
        self._sums = group[f"{_SUMS}/sums"]
        self.names = tuple(told["by_design"])
        self._arrays: dict[str, Any] = {name: group[name] for name in self.names}

    @classmethod
    def create(
        cls, path: str | Path, made_by: Mapping[str, Any], layout: Layout, chunk: int
    ) -> None:
        """Makes a new one, which is there as a whole or not at all.

        Args:
            path: of the folder, which must not be there.
            made_by: what another sweep is told apart by.
            layout: what will be in it.
            chunk: how many designs a chunk has.
        """
        path, zarr = Path(path), _zarr()
        path.parent.mkdir(parents=True, exist_ok=True)
        for left in path.parent.glob(f".{glob.escape(path.name)}.{8 * '[0-9a-f]'}"):
            shutil.rmtree(left)  # by a process that was killed here
        made = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}")
        group = zarr.open_group(made, mode="w")
        labels = {}
        for name, column in (layout.fixed | layout.by_design).items():
            labels.update(column.labels)
            told = {"units": column.unit} if column.unit else {}
            attributes = told | OUTCOMES.get(name, {})
            known = {"dimension_names": column.axes, "attributes": attributes}
            if name in layout.fixed:
                group.create_array(name, data=np.asarray(column.values), **known)
                continue
            shape, kind = column.values.shape, np.dtype(column.values.dtype)
            group.create_array(
                name,
                shape=shape,
                chunks=(min(chunk, shape[0]), *(max(1, size) for size in shape[1:])),
                dtype=kind,
                fill_value=_nothing(name, kind),
                **known,
            )
        for axis, names in labels.items():
            words = np.array(names, dtype=np.dtypes.StringDType())
            group.create_array(axis, data=words, dimension_names=(axis,))
        count = len(layout.lanes)
        group.create_group(_SUMS).create_array(
            "sums", shape=(-(-count // chunk),), chunks=(1,), dtype="uint64", fill_value=0
        )
        told = {"made_by": dict(made_by), "grid": list(layout.grid), "format": _FORMAT}
        told["by_design"] = list(layout.by_design)
        group.attrs.update({**made_by, **layout.attributes, "sweep": told})
        os.rename(made, path)

    def check(self, made_by: Mapping[str, Any]) -> None:
        """Refuses to be continued by another sweep.

        Raises:
            ValueError: it was made by one; the text says what differs.
        """
        words = [
            f"{name} ({was} then, {made_by.get(name)} now)"
            if not _is_sum(was)
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
        """Removes files that were not written to their end."""
        for path in self.path.rglob("*.partial"):
            path.unlink()

    def known(self, name: str, chunks: Bool[np.ndarray, " chunks"]) -> np.ndarray:
        """The numbers of some name, with nothing in the chunks that are not known."""
        array, parts = self._arrays[name], []
        for chunk, known in enumerate(chunks):
            rows = self._rows(chunk)
            shape = (rows.stop - rows.start, *array.shape[1:])
            nothing = np.full(shape, _nothing(name, array.dtype), array.dtype)
            parts.append(np.asarray(array[rows]) if known else nothing)
        return np.concatenate(parts)

    def written(self) -> np.ndarray:
        """Whether each chunk has been written, whole or not."""
        return np.asarray(self._sums[:]) != 0

    def finished(self) -> np.ndarray:
        """Whether each chunk is there and whole."""
        sums = np.asarray(self._sums[:])
        return np.array(
            [told != 0 and told == self._seen(k) for k, told in enumerate(sums)]
        )

    def write(self, chunk: int, values: Mapping[str, np.ndarray]) -> None:
        """Keeps a chunk, and then that it is there."""
        rows = self._rows(chunk)
        count = rows.stop - rows.start
        kept = {name: np.ascontiguousarray(part[:count]) for name, part in values.items()}
        for name, array in self._arrays.items():
            array[rows] = kept[name]
        self._sums[chunk] = _sum(kept)

    def _rows(self, chunk: int) -> slice:
        count = next(iter(self._arrays.values())).shape[0]
        size = self.made_by["chunk"]
        return slice(chunk * size, min((chunk + 1) * size, count))

    def _seen(self, chunk: int) -> int:
        """The sum of what the files of a chunk hold; zero where one cannot be read."""
        rows = self._rows(chunk)
        try:
            kept = {name: np.asarray(a[rows]) for name, a in self._arrays.items()}
        except Exception:  # of a kind that depends on what is broken, and how
            return 0
        return _sum(kept)


def _nothing(name: str, kind: np.dtype) -> Any:
    """What stands where nothing has been computed."""
    return np.nan if kind.kind in "fc" else UNKNOWN if name == "result" else 0


def _sum(values: Mapping[str, np.ndarray]) -> int:
    digest = hashlib.blake2b(digest_size=8)
    for name in sorted(values):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(values[name]).tobytes())
    return int.from_bytes(digest.digest()) | 1


def _is_sum(value: Any) -> bool:
    return isinstance(value, str) and len(value) == 64


def _zarr() -> Any:
    return package("zarr", "Stores", "data")
