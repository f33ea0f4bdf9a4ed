"""Elastic energies of a hinge as functions of the displacement of its two frames.

Start reading in `base`. A new energy is a subclass of `AbstractEnergy` with one method,
`stored_energy(displacement)`, and may be defined in any file. The energy is written with
`jax.numpy`, is twice differentiable, and its gradient is zero in the reference
configuration. `base` and `solver_protocols` contain the optional methods.

`quadratic`, `polynomial` (also rational energies), `mixed` (flexures), and
`point_charges` contain the energies of this library. `damping` contains viscous damping,
and `validity` the range in which an energy is valid. The package `fitting` determines
energies from measured wrenches. The other files contain the coordinates and polynomials
that they share.
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
from .fitting.trials import Errors as Errors
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
