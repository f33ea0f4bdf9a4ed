"""Three stiffnesses from a motion by EXUDYN, finite differences and SciPy least squares.

This is the identification of `identification.py` with a second simulator. Its parameters
are logarithms of the stiffnesses, as in twistorjax: otherwise SciPy tries negative
stiffnesses.
"""
# The stubs of EXUDYN contain wrong types.
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false

import time
from collections.abc import Iterator

import numpy as np

from . import peers_motion as linkage
from .identification import IDENTIFICATION
from .measure import Row


TRUE = np.array([linkage.ROTATION, linkage.ALONG_X, linkage.ALONG_Y])
# Ratios of the initial to the true values, as in twistorjax.
START_RATIOS = np.array([1.5, 0.5, 0.6])
END = 0.05  # s
# The smaller number of steps nearly reaches an error of 1e-6, the larger one does.
STEPS = (1000, 4000)
# Standard deviations of x, y and angle; m, m, rad.
STANDARD_DEVIATIONS = np.array([1e-6, 1e-6, 1e-5])


def run() -> Iterator[Row]:
    """Yield the rows of the table; there are none if a peer is not installed."""
    try:
        import exudyn
        from scipy.optimize import least_squares
    except ImportError:
        return
    del exudyn
    for steps in STEPS:
        build = linkage.exudyn_linkage
        system, simulate, connector = build(END, END / 100, steps, 1e-8, 1e-10)
        count = 0

        def predict(
            logarithms: np.ndarray, system=system, simulate=simulate, connector=connector
        ):
            nonlocal count
            count += 1
            rotation, along_x, along_y = TRUE * np.exp(logarithms)
            matrix = np.diag([along_x, along_y, 0, 0, 0, rotation])
            system.SetObjectParameter(connector, "stiffness", matrix)
            system.SetObjectParameter(connector, "damping", 1e-4 * matrix)
            return (simulate() / STANDARD_DEVIATIONS).ravel()

        data = predict(np.zeros(3))
        count = 0
        start = time.perf_counter()
        result = least_squares(
            lambda logarithms, predict=predict, data=data: predict(logarithms) - data,
            np.log(START_RATIOS),
            diff_step=1e-6,
            xtol=1e-12,
            ftol=1e-14,
            gtol=1e-14,
        )
        elapsed = time.perf_counter() - start
        what = f"EXUDYN ({steps} steps), finite differences, SciPy"
        yield Row(f"{what}: {IDENTIFICATION}", elapsed, "s")
        yield Row(f"{what}: simulations", count, "")
        error = float(np.abs(np.exp(result.x) - 1).max())
        yield Row(f"{what}: error of the estimates", error, "relative")
