"""Tests run in double precision, with nothing promoted silently, and compile fast.

What they find can be kept for the manual's report.
"""

import json
import os


# most of their time is compilation, of programs that run once
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false",
)

import jax
import numpy as np
import pytest


jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")


@pytest.fixture
def validated(record_property):
    """Keeps what was found beside what it should be, for `notebooks/validation.py`."""

    def keep(part, what, found, exact, oracle):
        found, exact = np.asarray(found, float), np.asarray(exact, float)
        error = np.max(np.abs(found - exact)) / np.max(np.abs(exact))
        row = {"part": part, "what": what, "error": float(error), "oracle": oracle}
        record_property("validated", json.dumps(row))

    return keep
