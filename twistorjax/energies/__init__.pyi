from .axial_spring import AxialSpring as AxialSpring
from .base import AbstractEnergy as AbstractEnergy
from .beam_column import BeamColumn as BeamColumn
from .contact import CornerContact as CornerContact, Stop as Stop
from .damping import ViscousDamping as ViscousDamping
from .fitting import (
    EnergyFit as EnergyFit,
    fit_energy as fit_energy,
    fit_rational as fit_rational,
    RationalFit as RationalFit,
    read_trials as read_trials,
    Trials as Trials,
)
from .fitting.trials import Errors as Errors
from .mixed import MixedEnergy as MixedEnergy
from .monomials import monomials as monomials
from .one_freedom import OneFreedomEnergy as OneFreedomEnergy
from .point_charges import PointCharges as PointCharges
from .polynomial import (
    Polynomial as Polynomial,
    Rational as Rational,
    SumOfSquares as SumOfSquares,
)
from .quadratic import CoordinateEnergy as CoordinateEnergy, Quadratic as Quadratic
from .validity import WithValidityRange as WithValidityRange
