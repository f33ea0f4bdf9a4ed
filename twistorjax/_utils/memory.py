"""Checks that a result fits the memory of the machine."""

import contextlib
import os
from pathlib import Path


def require_memory(count: int, needed: int) -> None:
    """Check that the machine has the memory for the arrays of a dataset; bytes.

    The check is skipped if the system does not report its memory.
    """
    available = _machine_memory()
    if available is not None and needed > available:
        raise memory_error(count, needed, available)


def memory_error(count: int, needed: int, available: int | None = None) -> ValueError:
    """Create the error for a dataset that does not fit into the memory.

    The arrays need `needed` bytes; the machine has `available` bytes, if this is known.
    """
    memory = "" if available is None else f" ({available / 2**30:,.3g} GiB)"
    return ValueError(
        f"The dataset of {count:,} designs needs at least {needed / 2**30:,.3g} GiB, "
        f"which is more than the memory of this machine{memory}. Use fewer designs, or "
        "split them into several sweeps."
    )


def _machine_memory() -> int | None:
    """Read the memory that this process may use; bytes, or `None` if it is unknown."""
    sizes = []
    with contextlib.suppress(AttributeError, ValueError, OSError):  # missing on Windows
        sizes.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    with contextlib.suppress(ValueError, OSError):  # memory limit of a container
        sizes.append(int(Path("/sys/fs/cgroup/memory.max").read_text()))
    return min((size for size in sizes if size > 0), default=None)
