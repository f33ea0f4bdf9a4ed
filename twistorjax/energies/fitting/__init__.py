"""Linear least-squares fits of energies to measured displacements and wrenches.

Start reading in `polynomial`, which holds `fit_energy`. `trials` holds the measured data,
`report` the result of a fit, and `rational` fits of quotients of polynomials.
"""

from .polynomial import fit_energy as fit_energy
from .rational import fit_rational as fit_rational, RationalFit as RationalFit
from .report import EnergyFit as EnergyFit
from .trials import read_trials as read_trials, Trials as Trials
