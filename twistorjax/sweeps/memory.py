"""Memory of the machine, and what a table needs of it."""

import contextlib
import os
from pathlib import Path


# `succeeded` and `result` of one design; bytes
LEAST = 5


def need_memory(count: int, needed: int) -> None:
    """Refuse a table that is larger than the memory of the machine.

    Args:
        count: Number of designs.
        needed: Size of the arrays that are held in memory; bytes.

    Raises:
        ValueError: The machine has less memory.
    """
    there = _memory()
    if there is not None and needed > there:
        raise too_large(count, needed, there)


def too_large(count: int, needed: int, there: int | None = None) -> ValueError:
    """Make the error for a table that does not fit the memory.

    Args:
        count: Number of designs.
        needed: Size of the arrays that are held in memory; bytes.
        there: Memory of the machine, if it is known; bytes.
    """
    has = "" if there is None else f" of {there / 2**30:,.3g} GiB"
    return ValueError(
        f"The table of {count:,} designs needs at least {needed / 2**30:,.3g} GiB, which "
        f"the memory of this machine{has} cannot hold. Use fewer designs, or split them "
        "into several sweeps."
    )


def _memory() -> int | None:
    """Memory that this process may use, as far as the system reports it; bytes."""
    found = []
    with contextlib.suppress(AttributeError, ValueError, OSError):  # as on Windows
        found.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    with contextlib.suppress(ValueError, OSError):  # limit of a container
        found.append(int(Path("/sys/fs/cgroup/memory.max").read_text()))
    return min((size for size in found if size > 0), default=None)
