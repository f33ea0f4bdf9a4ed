"""Settings of JAX for all tests: double precision, and fast compilation.

Implicit promotion of dtypes and ranks is an error. The fixtures `validated` and
`pictured` record the errors and the figures of the validation page of the manual.
"""

import contextlib
import ctypes
import gc
import importlib.metadata
import itertools
import json
import mmap
import os
import pathlib


# Most of the time of the tests is compilation, because a program runs only once.
_XLA_FLAGS = (
    "--xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1"
    " --xla_disable_hlo_passes=reshape-mover,while-loop-invariant-code-motion"
    " --xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000"
)
if importlib.metadata.version("jaxlib").startswith("0.10."):  # not in later versions
    _XLA_FLAGS += " --xla_cpu_use_fusion_emitters=false"
os.environ.setdefault("XLA_FLAGS", _XLA_FLAGS)
# Threads of OpenBLAS wait actively for a processor that the other process uses.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# The processes of the tests, and the next run, share the compiled programs.
_PROGRAMS = pathlib.Path(__file__).parents[1] / ".pytest_cache" / "programs"
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(_PROGRAMS))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")

import jax
import jaxtyping
import numpy as np
import pytest


gc.set_threshold(1_000_000, 20, 20)  # the default takes a fifth of the time of tracing
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")


# Each compiled program takes several memory maps, of which Linux allows 65,530 for each
# process. XLA crashes if there are no more.
_MOST_MAPS = 57_000
# Traces and programs of all tests would take 12 GiB in each of the processes.
_MOST_MEMORY = 4 * 2**30
_PROCESS = pathlib.Path("/proc/self")
_tests = itertools.count(1)


# Examples of docstrings that are slow tests.
_SLOW_EXAMPLES = (
    "examples.four_bar.driven_motion",
    "examples.four_bar_models.compare",
    "examples.identification.identify_hinge_a",
    "examples.parallelogram.study",
    "examples.stage_motion.transient_response",
    "examples.truss.plot",
    "examples.truss.study",
    "flexures.compound.chain.chain",
    "flexures.condensed.Condensed",
    "flexures.compound.guides.double_parallelogram",
    "flexures.compound.guides.folded_beam",
    "flexures.compound.pivots.cartwheel_pivot",
    "flexures.surrogates.surrogate.surrogate",
    "identification.experiment_design.rank_experiments",
    "plotting.animation.animate",
    "plotting.oblique.draw_out_of_plane",
    "plotting.path_plots.draw_path",
    "plotting.port_plots.draw_port_motion",
    "plotting.port_plots.draw_stiffness",
    "plotting.wave_plots.draw_dispersion",
    "solve.bistability.bistability",
    "solve.fatigue.fatigue",
    "solve.port_motion.port_motion",
    "solve.range_of_motion.range_of_motion",
    "solve.stroke_stiffness.stiffness_over_stroke",
)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark the slow examples of docstrings."""
    slow = {f"twistorjax.{name}" for name in _SLOW_EXAMPLES}
    for item in items:
        if item.name in slow:
            item.add_marker(pytest.mark.slow)


def pytest_collection_finish():
    """Spare the collections of garbage all that was imported."""
    gc.freeze()


@pytest.fixture(autouse=True)
def _programs_are_dropped():
    """Drop all compiled programs before they take too much memory or too many maps."""
    yield
    if next(_tests) % 15 == 0 and _PROCESS.exists():
        memory = int((_PROCESS / "statm").read_text().split()[1]) * mmap.PAGESIZE
        maps = (_PROCESS / "maps").read_bytes().count(b"\n")
        if memory > _MOST_MEMORY or maps > _MOST_MAPS:
            jax.clear_caches()
            gc.collect()
            _return_free_memory()


def _return_free_memory():
    """Return freed memory to Linux, which the C library would keep."""
    with contextlib.suppress(AttributeError):  # not every C library has this function
        ctypes.CDLL(None).malloc_trim(0)


@pytest.fixture(autouse=True)
def _annotations_are_checked(request):
    """Check annotations at run time, except in tests that pass what these forbid."""
    untyped = request.node.get_closest_marker("untyped") is not None
    jaxtyping.config.update("jaxtyping_disable", untyped)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture
def validated(record_property):
    """Record a result and its reference value, for `notebooks/validation.py`."""

    def record(part, what, found, exact, oracle):
        found, exact = np.asarray(found, float), np.asarray(exact, float)
        error = np.max(np.abs(found - exact)) / np.max(np.abs(exact))
        row = {"part": part, "what": what, "error": float(error), "oracle": oracle}
        record_property("validated", json.dumps(row))

    return record


@pytest.fixture
def pictured(record_property):
    """Record results (lines) and references (points), for `notebooks/validation.py`.

    Both are dictionaries of labels, and of values along x and y. Several tests may add to
    one figure. A line is dashed, and the y axis logarithmic, if the label says so.
    """

    def record(part, name, caption, axes, results, references):
        figure = {"part": part, "name": name, "caption": caption, "axes": axes}
        for kind, curves in (("results", results), ("references", references)):
            figure[kind] = {
                label: [
                    [float(f"{value:.5g}") for value in np.ravel(axis)] for axis in xy
                ]
                for label, xy in curves.items()
            }
        record_property("pictured", json.dumps(figure))

    return record
