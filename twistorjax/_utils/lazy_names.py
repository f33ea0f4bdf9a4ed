"""Names of packages, which are imported from their modules at their first use.

Some of these modules import packages that take long to load.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import lazy_loader


def attach(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__`, and `__all__` of the names in its stub file."""
    imported, listed, names = lazy_loader.attach_stub(package, file)

    def get(name: str) -> Any:
        try:
            return imported(name)
        except AttributeError:
            # An error while a module is imported
            if name in names or name.startswith("__"):
                raise
        from difflib import get_close_matches

        known = {each: each for each in names}
        for folder in set(names) & {path.name for path in Path(file).parent.iterdir()}:
            public = [each for each in dir(imported(folder)) if each[0] != "_"]
            known = {each: f"{folder}.{each}" for each in public} | known
        message = f"The module {package!r} has no attribute {name!r}."
        if similar := get_close_matches(name, known, 1):
            message += f" Did you mean {known[similar[0]]!r}?"
        raise AttributeError(message, name=name)

    return get, listed, names
