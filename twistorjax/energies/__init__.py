"""Elastic energies of a hinge as functions of the displacement of its two frames.

Start reading in `base`, which holds `AbstractEnergy`: a new energy is a subclass with one
method. The energies have one file each. `damping` holds viscous damping, and `validity`
the range in which an energy holds. The package `fitting` identifies energies from
measured wrenches.
"""

from .base import (
    AbstractEnergy as AbstractEnergy,
    CoordinateEnergy as CoordinateEnergy,
    Quadratic as Quadratic,
)
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
from .validity import WithValidityRange as WithValidityRange
