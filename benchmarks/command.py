"""Time of the command `twistorjax stage`, which includes the start of Python and JAX."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator

from .measure import at_most, Row


def run() -> Iterator[Row]:
    """Measure a call without cached programs, and a second call that uses the cache."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "XDG_CACHE_HOME": cache}
        # An installation by pip contains compiled Python files, so let Python write them.
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        for call, bound in (("first call", 6.0), ("second call", 3.0)):
            start = time.perf_counter()
            subprocess.run(
                [sys.executable, "-m", "twistorjax", "stage"],
                env=environment,
                check=True,
                stdout=subprocess.DEVNULL,
            )
            elapsed = time.perf_counter() - start
            yield at_most(f"`twistorjax stage`: {call}", elapsed, "s", bound)
