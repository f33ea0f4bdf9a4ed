"""Files of a store: digests of the files that never change, and file system errors."""

import contextlib
import errno
import hashlib
import json
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal


# The manifest is in the folder of an array, because zarr warns about unknown files in the
# folders of its groups.
MANIFEST = Path("finished", "sums", "manifest.json")
# Age at which an incomplete file or folder is removed; writing one takes seconds; s
_ABANDONED_AFTER = 3600.0


def write_manifest(folder: Path, contents: Mapping[str, Any]) -> None:
    """Write the manifest of a new store, with a digest of each file of the store.

    These files hold the coordinates, the labels and all metadata. They never change. The
    files of outputs are written later and have checksums of their own. JSON can represent
    the contents.
    """
    files = {
        path.relative_to(folder).as_posix(): _file_digest(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
    manifest = {**contents, "files": files}
    text = json.dumps({"digest": _manifest_digest(manifest), "manifest": manifest})
    (folder / MANIFEST).write_text(text, encoding="utf-8")


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Read the entries of the manifest of a store; None if there is no manifest."""
    try:
        with clear_errors(folder, "read"):
            content = (folder / MANIFEST).read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return None
    with contextlib.suppress(ValueError, KeyError, TypeError, RecursionError):
        document = json.loads(content)
        if document["digest"] == _manifest_digest(document["manifest"]):
            return document["manifest"]
    name = MANIFEST.as_posix()
    raise damage_error(folder, f"its file {name!r}", "Delete the store and sweep again.")


def damaged_files(folder: Path, digests: Mapping[str, str]) -> list[str]:
    """List the files that are missing or have changed since they were written."""
    damaged = []
    for name, digest in digests.items():
        try:
            with clear_errors(folder, "read"):
                intact = _file_digest(folder / name) == digest
        except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
            intact = False
        if not intact:
            damaged.append(name)
    return damaged


def damage_error(folder: Path, what: str, remedy: str) -> OSError:
    """Create the error for a store with a damaged file.

    `what` is damaged, such as "its file 'zarr.json'"; the remedy is a sentence.
    """
    return OSError(
        errno.EIO,
        f"The store {str(folder)!r} is damaged: {what} is missing, or has changed since "
        f"it was written. {remedy}",
    )


def is_abandoned(path: Path) -> bool:
    """Decide whether the process that wrote an incomplete file or folder is gone."""
    with contextlib.suppress(OSError):  # Another process removed or renamed it.
        return time.time() - path.stat().st_mtime > _ABANDONED_AFTER
    return False


@contextlib.contextmanager
def clear_errors(
    path: Path, action: Literal["read", "written"], remedy: str = ""
) -> Iterator[None]:
    """Replace a file system error in the block by a short one that names the store.

    The errors of zarr contain neither the store nor a remedy, and have long tracebacks.
    The remedy is a sentence that says what the user can do.
    """
    try:
        yield
    except OSError as error:
        # Python selects the subclass, such as PermissionError, by the error number.
        number, reason = error.errno or errno.EIO, error.strerror or str(error)
        text = f"The store {str(path)!r} cannot be {action}: {reason}. {remedy}"
        raise OSError(number, text.rstrip()) from None


def _file_digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _manifest_digest(manifest: Any) -> str:
    text = json.dumps(manifest, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
