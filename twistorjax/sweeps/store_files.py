"""Files of a store: digests of those that never change, and errors of the file system."""

import contextlib
import errno
import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal


# within an array of zarr, because zarr warns about foreign files in its groups
MANIFEST = Path("finished", "sums", "manifest.json")


def write_manifest(folder: Path, contents: Mapping[str, Any]) -> None:
    """Record what a new store is, with a digest of every file that it has so far.

    These files hold the coordinates, the labels and all metadata; none of them changes
    later. Files of answers are written later, and have checksums of their own.

    Args:
        folder: Folder of the store, without a manifest.
        contents: Further entries; anything that JSON can represent.
    """
    files = {
        path.relative_to(folder).as_posix(): _file_digest(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
    manifest = {**contents, "files": files}
    text = json.dumps({"digest": _digest_of(manifest), "manifest": manifest})
    (folder / MANIFEST).write_text(text, encoding="utf-8")


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Read the manifest of a store.

    Args:
        folder: Folder of the store.

    Returns:
        Its entries, or `None` if there is no manifest.

    Raises:
        OSError: The manifest cannot be read, or is damaged.
    """
    try:
        with clear_errors(folder, "read"):
            content = (folder / MANIFEST).read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return None
    with contextlib.suppress(ValueError, KeyError, TypeError, RecursionError):
        whole = json.loads(content)
        if whole["digest"] == _digest_of(whole["manifest"]):
            return whole["manifest"]
    name = MANIFEST.as_posix()
    raise damage(folder, f"its file {name!r}", "Delete the store and sweep again.")


def damaged_files(folder: Path, digests: Mapping[str, str]) -> list[str]:
    """List the files that are missing or do not hold what was written.

    Args:
        folder: Folder of the store.
        digests: Digest of each file, by its path within the folder.
    """
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


def damage(folder: Path, what: str, remedy: str) -> OSError:
    """Make the error for a store with a damaged file.

    Args:
        folder: Folder of the store.
        what: What is damaged, such as "its file 'zarr.json'".
        remedy: What the user can do; a sentence.
    """
    return OSError(
        errno.EIO,
        f"The store {str(folder)!r} is damaged: {what} is missing or does not hold what "
        f"was written. {remedy}",
    )


@contextlib.contextmanager
def clear_errors(
    path: Path, action: Literal["read", "written"], remedy: str = ""
) -> Iterator[None]:
    """Replace an error of the file system by a short one that names the store.

    The errors of zarr name neither the store nor a remedy, and end long tracebacks.

    Args:
        path: Folder of the store.
        action: What is done with the store.
        remedy: What the user can do; a sentence.
    """
    try:
        yield
    except OSError as error:
        # with a number, Python chooses the subclass, such as PermissionError
        number, reason = error.errno or errno.EIO, error.strerror or str(error)
        text = f"The store {str(path)!r} cannot be {action}: {reason}. {remedy}"
        raise OSError(number, text.rstrip()) from None


def _file_digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _digest_of(manifest: Any) -> str:
    text = json.dumps(manifest, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
