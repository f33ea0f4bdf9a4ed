"""Folder of files that a program trusts: complete, unchanged, and written by its user."""

import contextlib
import hashlib
import math
import os
import re
import stat
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from .._utils.validation import warn


_DIGEST_SIZE = hashlib.sha256().digest_size
_KEY = re.compile("[0-9a-f]{64}")
_TEMPORARY = re.compile(r"tmp\w{8}")  # of `tempfile.mkstemp`
_OLD = 3600.0  # age of a temporary file whose process was killed; s
_warned = False


def _open_at_once(path: str, flags: int) -> int:
    """Open a file. A pipe in its place does not wait for somebody who writes to it."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


@dataclass(frozen=True)
class TraceFolder:
    """Folder with one file for each key.

    A file begins with a digest of its key and content, so that a damaged file is not
    read. The digest does not protect against somebody who may write the file: therefore
    it is read only if nobody but the user may change it or its folder, unless the folder
    is shared. No method raises an `OSError`.
    """

    path: Path  # The folder
    # Largest total size of its files; infinite without a limit; bytes
    size: int | float = math.inf
    shared: bool = False  # Whether files are read that other users may have written

    def read(self, key: str) -> bytes | None:
        """Return the content of a file; None if it is missing, damaged, or unsafe."""
        path = self.path / key
        try:
            with open(path, "rb", opener=_open_at_once) as file:
                status = os.fstat(file.fileno())
                is_regular = stat.S_ISREG(status.st_mode)
                if not (is_regular and self._trusts(status) and self._is_trusted()):
                    return None
                digest, content = file.read(_DIGEST_SIZE), file.read()
        except OSError:
            return None
        if digest != _digest(key, content):
            return None
        with contextlib.suppress(OSError):  # The folder may be read-only.
            os.utime(path)
        return content

    def write(self, key: str, content: bytes) -> None:
        """Write a file, and delete those that have not been used for the longest time.

        Nothing is written to a read-only folder. The first failure in a process is a
        warning.
        """
        try:
            self._create()
            if not os.access(self.path, os.W_OK):
                return
            if not self._is_trusted():
                _warn_once(
                    f"Traced functions are not stored in {str(self.path)!r}, because "
                    "another user owns this folder or may write into it. Remove the "
                    "permission, or use `tj.configure(shared_cache=True)` if you trust "
                    "these users as you trust the programs that you install."
                )
            elif self._make_room(_DIGEST_SIZE + len(content)):
                self._write_whole(key, _digest(key, content) + content)
                self._make_room(0)  # Other processes may have written at the same time.
        except OSError as error:
            _warn_once(
                f"A traced function was not stored in {str(self.path)!r}: {error}. Later "
                "processes trace it again. `tj.configure(cache=...)` sets another folder."
            )

    def _trusts(self, status: os.stat_result) -> bool:
        """Decide whether only this user may change a file or a folder."""
        if self.shared or not hasattr(os, "geteuid"):  # Windows has other permissions.
            return True
        return status.st_uid == os.geteuid() and not status.st_mode & 0o022

    def _is_trusted(self) -> bool:
        return self._trusts(self.path.stat())

    def _create(self) -> None:
        """Create the folder; others may write into a shared one as into its parent."""
        if self.path.is_dir():
            return
        self.path.mkdir(0o755, parents=True, exist_ok=True)
        if self.shared:
            with contextlib.suppress(PermissionError):
                self.path.chmod(self.path.parent.stat().st_mode & 0o7777)

    def _write_whole(self, key: str, content: bytes) -> None:
        """Write a file under a temporary name, and rename it when it is complete."""
        handle, name = tempfile.mkstemp(dir=self.path)
        temporary = Path(name)
        try:
            with open(handle, "wb") as file:
                file.write(content)
            # Whoever may read the folder may read the file.
            temporary.chmod(self.path.stat().st_mode & 0o444 | 0o600)
            temporary.replace(self.path / key)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise

    def _make_room(self, needed: int) -> bool:
        """Delete old files until there is room for so many bytes; False if there is none.

        Only files of this class are deleted or counted.
        """
        found = []
        for path in self.path.iterdir():
            is_temporary = bool(_TEMPORARY.fullmatch(path.name))
            if not (is_temporary or _KEY.fullmatch(path.name)):
                continue
            with contextlib.suppress(OSError):  # Another process may have deleted it.
                status = path.lstat()
                if is_temporary and time.time() - status.st_mtime > _OLD:
                    path.unlink()
                else:
                    found.append((is_temporary, status.st_mtime, status.st_size, path))
        total = needed + sum(size for _, _, size, _ in found)
        for is_temporary, _, size, path in sorted(found):
            if total <= self.size or is_temporary or needed > self.size:
                break
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)
                total -= size
        return total <= self.size


def _digest(key: str, content: bytes) -> bytes:
    return hashlib.sha256(key.encode() + content).digest()


def _warn_once(message: str) -> None:
    """Warn, if this process has not warned yet."""
    global _warned
    if not _warned:
        _warned = True
        warn(message)
