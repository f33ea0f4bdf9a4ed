"""Linear least-squares fits of energies to measured displacements and wrenches.

Start reading in `polynomial`, which contains `fit_energy`, the fit of polynomial and
mixed energies. `rational` contains the fit of rational energies, `trials` the measured
data, and `report` the result of a fit. All fits use the solvers in `least_squares`.
"""

import lazy_loader


# The names are imported from their modules at their first use, because some of these
# modules import packages that take long to load. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
