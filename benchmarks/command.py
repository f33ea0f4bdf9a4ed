"""The command line's time, in processes of their own."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator

from .measure import at_most, Row


def run() -> Iterator[Row]:
    """A first call with nothing cached, and a second one."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "XDG_CACHE_HOME": cache}
        # as installed by pip, which compiles Python's own files too
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        for what, bound in (("first call", 6.0), ("second call", 3.0)):
            start = time.perf_counter()
            subprocess.run(
                [sys.executable, "-m", "twistorjax", "stage"],
                env=environment,
                check=True,
                stdout=subprocess.DEVNULL,
            )
            elapsed = time.perf_counter() - start
            yield at_most(f"`twistorjax stage`: {what}", elapsed, "s", bound)
