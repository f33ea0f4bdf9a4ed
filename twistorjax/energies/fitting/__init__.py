"""Linear least-squares fits of energies to measured displacements and wrenches.

Start reading in `polynomial`, which contains `fit_energy`, the fit of polynomial and
mixed energies. `rational` contains the fit of rational energies, `trials` the measured
data, and `report` the result of a fit. All fits use the solvers in `least_squares`.
"""

from ..._utils.lazy_names import attach


# The names are imported at their first use. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = attach(__name__, __file__)
