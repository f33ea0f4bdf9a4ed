"""Statics, linearization, vibrations, frequency response, and motion of a mechanism.

Start reading in `statics`. A gain is computed along this path: the loads and prescribed
displacements of a `Mechanism` become a system of equations, `newton` solves it in load
increments, and `results` and `tables` report the solution. The implicit function theorem
gives its derivatives. `dynamics` integrates the same forces in time by the solvers in
`collocation` or those of diffrax.
"""

from .collocation import Gauss as Gauss, Radau as Radau
from .dynamics import simulate as simulate
from .frequency_response import (
    frequency_response as frequency_response,
    FrequencyResponse as FrequencyResponse,
)
from .linear import Linearization as Linearization, linearize as linearize
from .motion import Motion as Motion
from .progress import ProgressBar as ProgressBar
from .results import result_names as result_names, RESULTS as RESULTS
from .statics import Equilibrium as Equilibrium, equilibrium as equilibrium
from .tables import Column as Column
from .vibrations import Vibrations as Vibrations, vibrations as vibrations
