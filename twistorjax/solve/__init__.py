"""Statics, linearization, vibrations, frequency response, and motion of a mechanism.

Start reading in `statics`. `equilibrium` assembles the equations of a `Mechanism`, its
loads, prescribed displacements, and constraints (`system`), and solves them by Newton's
method in load increments (`newton`). If an increment does not converge, or may contain a
fold, the solver returns to the last equilibrium and tries a shorter one, until the
increment is too short or `max_steps` is reached. Then `equilibrium` raises an error, or
with `throw=False` returns NaN with derivatives of zero, the reason (`results`), and the
last equilibrium (`fraction`, `reached`). A gain or another quantity is computed from the
displacements; see `amplification` in `examples.stage`.

`implicit_derivatives` differentiates an equilibrium by the implicit function theorem,
with one linear solve and not through the Newton steps.
`linearization`, `vibrations`, and `frequency_response` use the same `system` about an
equilibrium. `tangent_stiffness`, `factorization`, and `block_factorization` contain its
matrices. `dynamics` integrates the equations of motion (`motion_system`) by the solvers
in `collocation` or those of diffrax. `tables` converts solutions to xarray datasets.
"""

from .collocation import Gauss as Gauss, Radau as Radau
from .dynamics import simulate as simulate
from .frequency_response import (
    frequency_response as frequency_response,
    FrequencyResponse as FrequencyResponse,
)
from .linearization import Linearization as Linearization, linearize as linearize
from .motion import Energies as Energies, Motion as Motion
from .progress import ProgressBar as ProgressBar
from .results import result_names as result_names, RESULTS as RESULTS
from .statics import Equilibrium as Equilibrium, equilibrium as equilibrium
from .tables import Column as Column
from .vibrations import Vibrations as Vibrations, vibrations as vibrations
