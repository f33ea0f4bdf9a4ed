"""JSON files: validation of every entry, and writing without partly written files."""

import codecs
import contextlib
import json
import os
import secrets
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from .validation import shorten


MAX_DEPTH = 200  # levels of lists and objects; a sum of energies needs two
TOO_DEEP = f"is nested too deeply: at most {MAX_DEPTH} levels are allowed."
_MAX_INTEGER_DIGITS = 18  # An integer with more digits is read as a float.

Keys = tuple[str | int, ...]


class _ObjectWithDuplicateField(dict[str, Any]):
    """An object of a file in which a field occurs more than once."""

    field: str


def read_json(path: str | Path) -> Any:
    """Read a JSON file and check that its numbers are finite and its text is valid.

    An integer of more than 18 digits becomes a float. Messages name the file and the
    entry.
    """
    try:
        text = decode_text(Path(path).read_bytes())
        if not text.strip():
            raise ValueError(f"{path} is empty, but must be a JSON file.")
        tree = json.loads(text, object_pairs_hook=_object, parse_int=_integer)
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is damaged or not a JSON file: {error}.") from error
    except RecursionError:
        raise ValueError(f"{path} {TOO_DEEP}") from None
    if problem := find_invalid_entry(tree):
        raise ValueError(f"{path}: {problem}")
    return tree


def decode_text(data: bytes) -> str:
    """Decode the content of a text file: UTF-8, or UTF-16 with a byte order mark.

    Programs of Windows add a byte order mark; it is removed.
    """
    is_utf16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return data.decode("utf-16" if is_utf16 else "utf-8-sig")


def write_json(path: str | Path, tree: Any) -> None:
    """Write a JSON file; replace an existing file only when the new one is complete.

    The tree has no invalid entry; see `find_invalid_entry`.
    """
    text = json.dumps(tree, indent=1, allow_nan=False) + "\n"
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():  # a device, a pipe or a folder
        target.write_text(text, encoding="utf-8")
        return
    temporary = target.with_name(f".{secrets.token_hex(8)}.tmp")
    try:
        with temporary.open("x", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        if target.exists():
            shutil.copymode(target, temporary)
        temporary.replace(target)
    except OSError as error:
        # The message shows the path that the user gave, not that of the temporary file.
        raise type(error)(error.errno, error.strerror, str(path)) from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def find_invalid_entry(tree: Any) -> str | None:
    """Return a sentence about the first entry that is invalid in a file of any layout."""
    for keys, value in _entries(tree):
        if problem := _problem(keys, value):
            where = f"the entry `{entry_name(keys)}`" if keys else "the file"
            return f"{where} {problem}"
    return None


def _problem(keys: Keys, value: Any) -> str | None:
    """Describe why an entry is invalid in a file of any layout; None if it is valid."""
    if len(keys) > MAX_DEPTH:
        return TOO_DEEP
    if isinstance(value, _ObjectWithDuplicateField):
        return f"has the field {describe_value(value.field)} more than once."
    if isinstance(value, float) and not abs(value) < float("inf"):
        return f"is {describe_value(value)}, but must be finite: at most 1.79e308."
    strings = value if isinstance(value, dict) else (value,)
    for text in strings:
        if isinstance(text, str) and not _encodable(text):
            return (
                f"has the text {describe_value(text)}, which has half of a surrogate "
                "pair and cannot be written as UTF-8."
            )
    return None


def entry_name(keys: Sequence[str | int]) -> str:
    """Return the name of an entry, such as `bodies[0].reference[2]`.

    The middle part of a name of more than 16 keys is left out.
    """
    words = [
        f".{key}"
        if isinstance(key, str) and key.isidentifier()
        else f"[{describe_value(key)}]"
        for key in (keys if len(keys) <= 16 else (*keys[:8], *keys[-8:]))
    ]
    if len(keys) > 16:
        words.insert(8, "...")
    return "".join(words).removeprefix(".")


def describe_value(value: Any) -> str:
    """Return the JSON text of a value, shortened, or the number of entries of a list."""
    if isinstance(value, list | tuple):
        return f"a list of {len(value)} {'entry' if len(value) == 1 else 'entries'}"
    if isinstance(value, dict):
        return "an object"
    return shorten(json.dumps(value))


def _entries(tree: Any) -> Iterator[tuple[Keys, Any]]:
    """Iterate over all entries and their keys, in the order of the file."""
    stack: list[tuple[Keys, Any]] = [((), tree)]
    while stack:
        keys, value = stack.pop()
        yield keys, value
        children: Any = ()
        if isinstance(value, dict):
            children = value.items()
        elif isinstance(value, list | tuple):
            children = enumerate(value)
        stack.extend(reversed([((*keys, key), child) for key, child in children]))


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Make an object of its fields, and mark it if a field occurs more than once."""
    fields = dict(pairs)
    if len(fields) == len(pairs):
        return fields
    names = [name for name, _ in pairs]
    marked = _ObjectWithDuplicateField(fields)
    marked.field = next(name for name in fields if names.count(name) > 1)
    return marked


def _integer(digits: str) -> int | float:
    """Convert an integer; one of many digits becomes a float, infinite above 1.8e308."""
    return int(digits) if len(digits) <= _MAX_INTEGER_DIGITS else float(digits)


def _encodable(text: str) -> bool:
    """Return whether a text can be written as UTF-8."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True
