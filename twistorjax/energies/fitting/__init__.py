"""Linear least-squares fits of energies to measured displacements and wrenches.

Start reading in `polynomial`, which contains `fit_energy`, the fit of polynomial and
mixed energies. `rational` contains the fit of rational energies, `trials` the measured
data, and `report` the result of a fit. All fits use the solvers in `least_squares`.
"""

from .polynomial import fit_energy as fit_energy
from .rational import fit_rational as fit_rational, RationalFit as RationalFit
from .report import EnergyFit as EnergyFit
from .trials import read_trials as read_trials, Trials as Trials
