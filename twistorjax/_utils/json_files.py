"""JSON files that are checked entry by entry, and replaced as a whole."""

import contextlib
import json
import os
import secrets
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from .validation import shorten


DEEPEST = 200  # levels of lists and objects; a sum of energies takes two
_LONGEST = 18  # digits of a whole number that is kept as one

Keys = tuple[str | int, ...]


class EntryError(ValueError):
    """What is wrong with an entry of a file; the message names the entry."""


class _Doubled(dict[str, Any]):
    """An object of a file that has a field twice."""

    field: str


def read_json(path: str | Path) -> Any:
    """Read a JSON file of finite numbers and text that can be encoded.

    Args:
        path: Path of the file.

    Returns:
        The objects, lists and values of the file. A whole number of more than 18 digits
        is a float.

    Raises:
        ValueError: The file is not UTF-8 or not JSON, is nested too deeply, or has an
            entry that is not finite, that cannot be encoded, or that is there twice. The
            message names the file and the entry.
        OSError: The file cannot be read.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
        if not text.strip():
            raise ValueError(f"{path} is empty, but must be a JSON file.")
        tree = json.loads(text, object_pairs_hook=_fields, parse_int=_integer)
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is damaged or not a JSON file: {error}.") from error
    except RecursionError:
        raise ValueError(f"{path} {_TOO_DEEP}") from None
    if fault := fault_of(tree):
        raise ValueError(f"{path}: {fault}")
    return tree


def write_json(path: str | Path, tree: Any) -> None:
    """Write a JSON file, and replace an older one only when the new one is complete.

    Args:
        path: Path of the file.
        tree: Objects, lists and values without a fault; see `fault_of`.

    Raises:
        OSError: The file cannot be written.
    """
    text = json.dumps(tree, indent=1, allow_nan=False) + "\n"
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():  # a device or a pipe; or a folder
        target.write_text(text, encoding="utf-8")
        return
    beside = target.with_name(f".{secrets.token_hex(8)}.tmp")
    try:
        with beside.open("x", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        if target.exists():
            shutil.copymode(target, beside)
        beside.replace(target)
    except OSError as error:
        # the name that the user gave, not that of the temporary file
        raise type(error)(error.errno, error.strerror, str(path)) from None
    finally:
        with contextlib.suppress(OSError):
            beside.unlink()


def fault_of(tree: Any) -> str | None:
    """Find the first entry that a file must not have, whatever its layout.

    Args:
        tree: Objects, lists and values.

    Returns:
        A sentence that names the entry; `None` if there is no such entry.
    """
    for keys, value in _entries(tree):
        where = f"the entry `{entry(keys)}`" if keys else "the file"
        if len(keys) > DEEPEST:
            return f"{where} {_TOO_DEEP}"
        if isinstance(value, _Doubled):
            return f"{where} has the field {shown(value.field)} more than once."
        if isinstance(value, float) and not abs(value) < float("inf"):
            return f"{where} is {shown(value)}, but must be finite: at most 1.79e308."
        strings = value if isinstance(value, dict) else (value,)
        for text in strings:
            if isinstance(text, str) and not _encodable(text):
                return (
                    f"{where} has the text {shown(text)}, which has half of a surrogate "
                    "pair and cannot be written as UTF-8."
                )
    return None


def entry(keys: Sequence[str | int]) -> str:
    """The name of an entry, such as `bodies[0].reference[2]`, short also where it is deep."""
    words = [
        f".{key}" if isinstance(key, str) and key.isidentifier() else f"[{shown(key)}]"
        for key in (keys if len(keys) <= 16 else (*keys[:8], *keys[-8:]))
    ]
    if len(keys) > 16:
        words.insert(8, "...")
    return "".join(words).removeprefix(".")


def shown(value: Any) -> str:
    """A value of a file, in a few words."""
    if isinstance(value, list | tuple):
        return f"a list of {len(value)} {'entry' if len(value) == 1 else 'entries'}"
    if isinstance(value, dict):
        return "an object"
    return shorten(json.dumps(value))


def _entries(tree: Any) -> Iterator[tuple[Keys, Any]]:
    """Every entry with its keys, in the order of the file."""
    waiting: list[tuple[Keys, Any]] = [((), tree)]
    while waiting:
        keys, value = waiting.pop()
        yield keys, value
        inner: Any = ()
        if isinstance(value, dict):
            inner = value.items()
        elif isinstance(value, list | tuple):
            inner = enumerate(value)
        waiting.extend(reversed([((*keys, key), part) for key, part in inner]))


def _fields(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object, marked if it has a field twice."""
    fields = dict(pairs)
    if len(fields) == len(pairs):
        return fields
    names = [name for name, _ in pairs]
    doubled = _Doubled(fields)
    doubled.field = next(name for name in fields if names.count(name) > 1)
    return doubled


def _integer(digits: str) -> int | float:
    """A whole number; one of many digits as a float, which is infinite above 1.8e308."""
    return int(digits) if len(digits) <= _LONGEST else float(digits)


def _encodable(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


_TOO_DEEP = f"is nested too deeply: at most {DEEPEST} levels are allowed."
