"""Three stiffnesses from a motion by EXUDYN, finite differences, SciPy least squares.

The identification of `identification.py`, by a second simulator. Its parameters are
logarithms, as ours: with the stiffnesses themselves SciPy tries negative ones.
"""
# EXUDYN's stubs are wrong
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false

import time
from collections.abc import Iterator

import numpy as np

from . import peers_motion as linkage
from .measure import Row


TRUE = np.array([linkage.ROTATION, linkage.ALONG_X, linkage.ALONG_Y])
GUESS = np.array([1.5, 0.5, 0.6])  # as ours
END = 0.05
# Of the step counts that meet 1e-6 the least, and one that nearly does
STEPS = (1000, 4000)
# Standard deviations of (x, y, angle)
UNITS = np.array([1e-6, 1e-6, 1e-5])


def run() -> Iterator[Row]:
    """The rows of the table; none where a peer is not installed."""
    try:
        import exudyn
        from scipy.optimize import least_squares
    except ImportError:
        return
    del exudyn
    for steps in STEPS:
        build = linkage.exudyn_linkage
        system, moved, connector = build(END, END / 100, steps, 1e-8, 1e-10)
        count = 0

        def read(place: np.ndarray, system=system, moved=moved, at=connector):
            nonlocal count
            count += 1
            rotation, along_x, along_y = TRUE * np.exp(place)
            matrix = np.diag([along_x, along_y, 0, 0, 0, rotation])
            system.SetObjectParameter(at, "stiffness", matrix)
            system.SetObjectParameter(at, "damping", 1e-4 * matrix)
            return (moved() / UNITS).ravel()

        data = read(np.zeros(3))
        count = 0
        start = time.perf_counter()
        found = least_squares(
            lambda place, read=read, data=data: read(place) - data,
            np.log(GUESS), diff_step=1e-6, xtol=1e-12, ftol=1e-14, gtol=1e-14,
        )  # fmt: skip
        taken = time.perf_counter() - start
        what = f"EXUDYN, {steps} steps, differences, SciPy"
        yield Row(f"{what}: three stiffnesses", taken, "s")
        yield Row(f"{what}: simulations", count, "")
        error = float(np.abs(np.exp(found.x) - 1).max())
        yield Row(f"{what}: error of the estimates", error, "relative")
