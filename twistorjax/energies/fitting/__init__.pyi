from .polynomial import fit_energy as fit_energy
from .rational import fit_rational as fit_rational, RationalFit as RationalFit
from .report import EnergyFit as EnergyFit
from .trials import read_trials as read_trials, Trials as Trials
