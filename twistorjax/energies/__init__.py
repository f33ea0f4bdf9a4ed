"""Elastic energies of a hinge as functions of the displacement of its two frames.

Start reading in `base`, which contains `AbstractEnergy`: a new energy is a subclass with
one method. `polynomial` contains polynomial and rational energies, and `mixed` those of
flexures. `damping` contains viscous damping, and `validity` the range in which an energy
is valid. The package `fitting` determines energies from measured wrenches.
"""

from .base import AbstractEnergy as AbstractEnergy
from .damping import ViscousDamping as ViscousDamping
from .fitting import (
    EnergyFit as EnergyFit,
    fit_energy as fit_energy,
    fit_rational as fit_rational,
    RationalFit as RationalFit,
    read_trials as read_trials,
    Trials as Trials,
)
from .mixed import MixedEnergy as MixedEnergy
from .monomials import monomials as monomials
from .point_charges import PointCharges as PointCharges
from .polynomial import (
    Polynomial as Polynomial,
    Rational as Rational,
    SumOfSquares as SumOfSquares,
)
from .quadratic import CoordinateEnergy as CoordinateEnergy, Quadratic as Quadratic
from .validity import WithValidityRange as WithValidityRange
